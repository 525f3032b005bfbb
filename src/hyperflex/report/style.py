"""The style of all figures, their legends and titles, and writing them as PNG."""

import io
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hyperflex import files

if TYPE_CHECKING:
    from matplotlib import axes, figure

    Axes = axes.Axes
    Figure = figure.Figure
else:  # Matplotlib is loaded only to draw
    Axes = Figure = Any

BLUE, RED, GREEN, GREY, INK = "#1f5fa8", "#d1483a", "#3b8f6b", "#8a93a0", "#1d2733"
OUTCOME_COLOUR = {"success": BLUE, "failure": RED}

_STYLE = Path(__file__).parent / "figure.mplstyle"


def style_context() -> "AbstractContextManager[None]":
    """Return a block in which Matplotlib's settings are the package's."""
    import matplotlib as mpl

    return mpl.rc_context(fname=_STYLE)


@contextmanager
def new_figure(
    width: float, height: float, title: str = "", *, layout: Literal["constrained"] | None = "constrained"
) -> "Iterator[Figure]":
    """Give an empty figure that needs no screen, and that pyplot does not know, in the package's style.

    Matplotlib's own settings are back after the block, in which everything must be drawn. Width and height are in
    inches, `layout` is Matplotlib's layout engine.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with style_context():
        figure = Figure(figsize=(width, height), layout=layout)
        FigureCanvasAgg(figure)
        vars(figure)["_repr_png_"] = partial(png, figure, dpi=100)  # a notebook shows it, with or without pyplot
        if title:
            figure.suptitle(title, x=0.01, ha="left")
        yield figure


def legend(figure: "Figure", *axes: Any, place: str = "upper right", columns: int = 4) -> None:
    """Put one legend outside the axes, of everything that is labelled in `axes`."""
    entries = [entry for axis in axes for entry in zip(*axis.get_legend_handles_labels(), strict=True)]
    handles, labels = zip(*entries, strict=True)
    where: Any = f"outside {place}"
    figure.legend(handles, labels, loc=where, ncols=columns)


def png(figure: "Figure", *, dpi: int | Literal["figure"] = 160) -> bytes:
    """Return a figure as PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": "hyperflex"})
    return buffer.getvalue()


def save_png(figure: "Figure", path: str | Path, *, dpi: int = 160) -> None:
    """Write a figure to a PNG file, wholly or not at all."""
    files.write_bytes(path, png(figure, dpi=dpi))
