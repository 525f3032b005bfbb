"""One look for all pictures, and writing them whole or not at all."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hyperflex import files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, RED, GREEN, GREY, INK = "#1f5fa8", "#d1483a", "#3b8f6b", "#8a93a0", "#1d2733"
OUTCOME_COLOUR = {"success": BLUE, "failure": RED}

_LOOK: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#b9c0c9",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e9ee",
    "grid.linewidth": 0.8,
    "xtick.color": "#5a6472",
    "ytick.color": "#5a6472",
    "text.color": INK,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "figure.facecolor": "white",
    "figure.dpi": 110,
    "savefig.dpi": 160,
}


@contextmanager
def look() -> Iterator[None]:
    """Draw in the house style within this block; Matplotlib's own settings stand again afterwards."""
    import matplotlib as mpl

    with mpl.rc_context(_LOOK):
        yield


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """Return an empty figure of `width` by `height` inches that needs no screen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure, *, dpi: int = 160) -> bytes:
    """Return a figure as PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": "hyperflex"})
    return buffer.getvalue()


def save_png(figure: Figure, path: str | Path, *, dpi: int = 160) -> None:
    """Write a figure to a PNG file, whole or not at all."""
    content = png(figure, dpi=dpi)
    with files.atomic(path, "wb") as file:
        file.write(content)
