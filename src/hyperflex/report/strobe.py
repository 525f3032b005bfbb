"""Stroboscopic pictures: many instants of one motion in one frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.report.style import look, new_figure
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Indices = npt.NDArray[np.intp]

NIGHT, PALE = "#0c1322", "#aab6c8"
_COLOURS = ("#27406b", "#2f7fb5", "#4fc3c0", "#f2d479", "#ff8a4c")  # first instant to last


def strobe(
    run: Trajectory,
    *,
    start: float | None = None,
    end: float | None = None,
    count: int = 48,
    title: str = "",
    width: float = 9.0,
) -> Figure:
    """Draw the rope at `count` instants of a run, early ones dark, late ones bright, with the path of the tip.

    Parameters
    ----------
    run : Trajectory
        What to show; its samples should lie closer than the instants drawn.
    start, end : float, optional
        First and last instant, s; the whole run by default.
    count : int
        Number of instants, at least 2.
    title : str
        Written in the upper left corner.
    width : float
        Width of the picture, inches; the height follows from the rope's reach.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InvalidInput
        Fewer than 2 instants, or a span without samples.
    """
    count = checks.count("count", count, least=2)
    first = run.t[0] if start is None else checks.number("start", start, unit="s")
    last = run.t[-1] if end is None else checks.number("end", end, unit="s")
    span = np.flatnonzero((run.t >= first) & (run.t <= last))
    if span.size < 2:
        raise InvalidInput(
            "no samples between start and end", got=[first, last], allowed=f"within {run.t[0]:g} to {run.t[-1]:g} s"
        )
    instants = span[np.linspace(0, span.size - 1, min(count, span.size)).round().astype(int)]
    with look():
        return _draw(run, span, instants, title, width)


def _draw(run: Trajectory, span: Indices, instants: Indices, title: str, width: float) -> Figure:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    low, high = _frame(run, span)
    figure = new_figure(width, width * (high[1] - low[1]) / (high[0] - low[0]), layout=None)
    figure.set_facecolor(NIGHT)
    axis: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), facecolor=NIGHT)
    axis.set_axis_off()
    colours = LinearSegmentedColormap.from_list("dusk", _COLOURS)(np.linspace(0.0, 1.0, instants.size))
    fade = np.linspace(0.35, 1.0, instants.size) ** 1.5
    ropes = run.joints[instants]
    for glow, opacity in ((5.5, 0.07), (3.0, 0.16), (1.4, 1.0)):
        shades = np.column_stack([colours[:, :3], opacity * fade])
        axis.add_collection(LineCollection(list(ropes), colors=shades, linewidths=glow, capstyle="round"))
    trail = run.tip[span]
    shade = LinearSegmentedColormap.from_list("dusk", _COLOURS)(np.linspace(0.0, 1.0, span.size - 1))
    axis.add_collection(
        LineCollection(list(np.stack([trail[:-1], trail[1:]], axis=1)), colors=shade, linewidths=0.7, alpha=0.55)
    )
    axis.scatter(*ropes[:, -1].T, s=7.0, c=colours[:, :3], zorder=3, lw=0)
    _draw_arm(axis, run, instants)
    _draw_scale(axis, low, high)
    axis.text(0.018, 0.965, title, transform=axis.transAxes, color="white", fontsize=11, va="top", fontweight="bold")
    return figure


def _frame(run: Trajectory, span: Indices) -> tuple[Array, Array]:
    """Return lower left and upper right corner, m, with a margin."""
    points = run.joints[span].reshape(-1, 2)
    low, high = points.min(axis=0), np.maximum(points.max(axis=0), run.base.max(axis=0) + 0.05)
    margin = 0.06 * (high - low).max()
    low, high = low - margin, high + margin
    high[1] += 0.5 * margin
    return low, high


def _draw_arm(axis: Any, run: Trajectory, instants: Indices) -> None:
    from matplotlib.collections import LineCollection

    arm = run.setup.arm
    if arm is None:
        axis.plot(*run.base[instants[-1]], "o", color=PALE, ms=4, zorder=5)
        return
    tips = run.base[instants]
    direction = np.stack([np.sin(run.arm_angle[instants]), -np.cos(run.arm_angle[instants])], axis=1)
    pivots = tips - arm.length * direction
    axis.add_collection(LineCollection(list(np.stack([pivots, tips], axis=1)), colors=PALE, linewidths=1.0, alpha=0.12))
    axis.plot(*np.stack([pivots[-1], tips[-1]], axis=1), color="white", lw=2.6, zorder=5, solid_capstyle="round")
    axis.plot(*pivots[-1], "o", color="white", ms=5.5, mec=NIGHT, mew=1.2, zorder=6)


def _draw_scale(axis: Any, low: Array, high: Array) -> None:
    """Draw a bar of a round length in the lower right corner."""
    length = 10.0 ** np.floor(np.log10(0.4 * (high[0] - low[0])))
    x, y = high[0] - 0.03 * (high[0] - low[0]), low[1] + 0.045 * (high[1] - low[1])
    axis.plot([x - length, x], [y, y], color=PALE, lw=1.2)
    text = f"{length:g} m"
    axis.text(x - 0.5 * length, y + 0.012 * (high[1] - low[1]), text, color=PALE, fontsize=8, ha="center", va="bottom")
