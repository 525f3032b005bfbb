"""Stroboscopic pictures: many instants of one motion in one frame."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.model import Obstacle, Peg, Wall
from hyperflex.report.shapes import NO_TARGETS, Shapes, ground_corners, shapes, span, view, wall_ends
from hyperflex.report.style import new_figure
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NIGHT, PALE, PEG, GROUND, OBSTACLE = "#0c1322", "#aab6c8", "#d65c46", "#1c263a", "#a07be0"
_COLOURS = ("#27406b", "#2f7fb5", "#4fc3c0", "#f2d479", "#ff8a4c")  # first instant to last
_TRAIL_POINTS = 800


def strobe_figure(
    run: Trajectory,
    *,
    start: float | None = None,
    end: float | None = None,
    count: int = 48,
    title: str = "",
    width: float = 9.0,
    targets: Array | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> "Figure":
    """Draw the rope at `count` instants of a run, early ones dark, late ones bright, with the path of the tip.

    A bar of the colours in the lower left corner says from when to when.

    Parameters
    ----------
    run, title
        What to show, and what to write in the upper left corner.
    start, end : float, optional
        First and last instant, s; the whole run by default. InvalidInput if they are not in it.
    count : int
        Number of instants, at least 2.
    width : float
        Width of the picture, inches; the height follows from the rope's reach.
    targets : (k, 2) float64, optional
        Points to mark with a ring, m.
    obstacles : sequence of Peg, Wall, Ground, optional
        Those of the set-up that the rope must not touch: violet, which the title then says.
    """
    count = checks.count("count", count, least=2)
    first, last = span(run, start, end)
    targets = NO_TARGETS if targets is None else targets
    drawn = shapes(run, np.linspace(first, last, count))
    trail = shapes(run, np.linspace(first, last, _TRAIL_POINTS)).joints[:, -1]
    low, high = view(run, np.concatenate([drawn.joints.reshape(-1, 2), trail, drawn.pivots, targets]), above=1.5)
    with new_figure(width, width * (high[1] - low[1]) / (high[0] - low[0]), layout=None) as figure:
        figure.set_facecolor(NIGHT)
        axis: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), facecolor=NIGHT)
        axis.set_axis_off()
        _draw_ropes(axis, drawn.joints, trail)
        for obstacle in run.setup.pegs:
            colour = OBSTACLE if obstacle in obstacles else PEG
            _draw(axis, obstacle, 10.0 * float(np.ptp([low, high], axis=0).max()), colour)
        axis.plot(*targets.T, "o", ms=15.0, mfc="none", mec=PEG, mew=1.8, zorder=7)
        _draw_arm(axis, drawn, run.setup.arm is not None)
        _draw_scale(axis, low, high)
        _draw_key(axis, first, last)
        words = f"{title}; violet: obstacles" if obstacles else title
        axis.text(
            0.018, 0.965, words, transform=axis.transAxes, color="white", fontsize=11, va="top", fontweight="bold"
        )
    return figure


def _dusk() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("dusk", _COLOURS)


def _draw_ropes(axis: Any, ropes: Array, trail: Array) -> None:
    from matplotlib.collections import LineCollection

    dusk = _dusk()
    colours = dusk(np.linspace(0.0, 1.0, len(ropes)))[:, :3]
    fade = np.linspace(0.35, 1.0, len(ropes)) ** 1.5
    for glow, opacity in ((5.5, 0.07), (3.0, 0.16), (1.4, 1.0)):
        shades = np.column_stack([colours, opacity * fade])
        axis.add_collection(LineCollection(list(ropes), colors=shades, linewidths=glow, capstyle="round"))
    steps = list(np.stack([trail[:-1], trail[1:]], axis=1))
    shades = dusk(np.linspace(0.0, 1.0, len(steps)))
    axis.add_collection(LineCollection(steps, colors=shades, linewidths=0.7, alpha=0.55))
    axis.scatter(*ropes[:, -1].T, s=7.0, c=colours, zorder=3, lw=0)


def _draw_arm(axis: Any, drawn: Shapes, with_arm: bool) -> None:
    from matplotlib.collections import LineCollection

    tips, pivots = drawn.joints[:, 0], drawn.pivots
    if not with_arm:
        axis.plot(*tips[-1], "o", color=PALE, ms=4, zorder=5)
        return
    axis.add_collection(LineCollection(list(np.stack([pivots, tips], axis=1)), colors=PALE, linewidths=1.0, alpha=0.12))
    axis.plot(*np.stack([pivots[-1], tips[-1]], axis=1), color="white", lw=2.6, zorder=5, solid_capstyle="round")
    axis.plot(*pivots[-1], "o", color="white", ms=5.5, mec=NIGHT, mew=1.2, zorder=6)


def draw_obstacles(
    axis: Any, obstacles: Sequence[Obstacle], far: float, *, origin: npt.ArrayLike = (0.0, 0.0), scale: float = 1.0
) -> None:
    """Draw what the rope must not touch into a plot whose limits stand; its legend names what lies within them.

    Of grounds the part within `far`, m, of their points is drawn. The plot is that of places less its `origin` (2,), m,
    times `scale`.
    """
    from matplotlib.transforms import Affine2D

    x, y = np.asarray(origin, dtype=np.float64)
    seen, shown = Affine2D().translate(-x, -y).scale(scale), []
    for each in obstacles:
        patch = _draw(axis, each, far, OBSTACLE)
        outline = patch.get_path().transformed(seen)
        patch.set_path(outline)
        if outline.intersects_bbox(axis.viewLim, filled=not isinstance(each, Wall)):
            shown.append(type(each).__name__.lower())
    for kind in sorted(set(shown)):
        face = GROUND if kind == "ground" else OBSTACLE
        axis.plot([], [], "s", color=face, mec=OBSTACLE, mew=1.5, ms=6.0, label=f"{kind}, an obstacle")


def _draw(axis: Any, obstacle: Obstacle, far: float, colour: str) -> Any:
    """Draw a peg, wall or ground and return it; of a ground an obstacle's colour shows the surface alone."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    if isinstance(obstacle, Peg):
        outline = Path.circle((obstacle.x, obstacle.y), obstacle.radius)
        look: Any = {"facecolor": colour, "lw": 0, "zorder": 1}  # below the wraps
    elif isinstance(obstacle, Wall):
        outline, look = Path(wall_ends(obstacle)), {"edgecolor": colour, "lw": 2.2, "zorder": 4}
    else:
        outline = Path(ground_corners(obstacle, far)[[0, 1, 2, 3, 0]], closed=True)
        look = {"facecolor": GROUND, "edgecolor": colour if colour == OBSTACLE else GROUND, "lw": 2.2, "zorder": 0}
    return axis.add_patch(PathPatch(outline, **look))


def _draw_scale(axis: Any, low: Array, high: Array) -> None:
    """Draw a bar of a round length in the lower right corner."""
    length = 10.0 ** np.floor(np.log10(0.4 * (high[0] - low[0])))
    x, y = high[0] - 0.03 * (high[0] - low[0]), low[1] + 0.045 * (high[1] - low[1])
    axis.plot([x - length, x], [y, y], color=PALE, lw=1.2)
    text = f"{length:g} m"
    axis.text(x - 0.5 * length, y + 0.012 * (high[1] - low[1]), text, color=PALE, fontsize=8, ha="center", va="bottom")


def _draw_key(axis: Any, first: float, last: float) -> None:
    """Draw the colours from the first instant to the last, s, with both, in the lower left corner."""
    from matplotlib.collections import LineCollection

    x, y = np.linspace(0.03, 0.19, 65), np.full(65, 0.045)
    pieces = list(np.stack([np.stack([x[:-1], y[:-1]], axis=1), np.stack([x[1:], y[1:]], axis=1)], axis=1))
    colours = _dusk()(np.linspace(0.0, 1.0, 64))
    key = LineCollection(
        pieces, colors=colours, linewidths=5.0, transform=axis.transAxes, label="key", antialiaseds=False
    )
    axis.add_collection(key, autolim=False)
    for place, t, side in ((x[0], first, "left"), (x[-1], last, "right")):
        style: Any = {
            "color": PALE,
            "fontsize": 8,
            "ha": side,
            "va": "bottom",
            "transform": axis.transAxes,
            "zorder": 5,
        }
        axis.text(place, y[0] + 0.012, f"{t:.2f} s", **style)
