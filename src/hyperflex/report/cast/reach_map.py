"""Figure of a reach map: what is wound and how far round, what is not, and what is out of reach."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning import ReachMap
from hyperflex.report.strobe import draw_obstacles
from hyperflex.report.style import BLUE, GREY, INK, RED, legend, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_OUT, _FAILED = "#e3e6ea", "#f0b7b0"


def reach_figure(reach: ReachMap) -> "Figure":
    """Draw a reach map to scale: angle covered of the targets that are wound, the others by the reason."""
    arm = reach.problem.arm
    far = arm.length + reach.problem.rope.total_length
    edges = [_edges(reach.x), _edges(reach.y)]
    width, height = (float(np.ptp(each)) for each in edges)
    tall = float(np.clip(6.0 * height / width, 3.0, 8.0))
    with new_figure(max(5.6, min(9.0, tall * width / height) + 2.6), tall + 1.0) as figure:
        axis: Any = figure.subplots()
        axis.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]])
        failed = ~(reach.wound | reach.infeasible) & (reach.status >= 0)
        _cells(axis, edges, reach.infeasible, _OUT, "not feasible, not searched")
        _cells(axis, edges, failed, _FAILED, "feasible, but no cast found in the time")
        if not reach.complete:
            _cells(axis, edges, reach.status < 0, "white", "not planned: interrupted")
        if reach.wound.any():
            degrees = np.ma.masked_invalid(np.degrees(reach.contact_angle))
            mesh = axis.pcolormesh(*edges, degrees, cmap="YlGnBu", vmin=0.0, vmax=max(360.0, float(degrees.max())))
            figure.colorbar(mesh, ax=axis, label="wound: angle of the target covered, degrees", shrink=0.8)
        angle = np.linspace(0.0, 2.0 * np.pi, 361)
        for radius, colour, words in ((far, GREY, "the rope's end comes no farther"), (arm.length, BLUE, "arm's tip")):
            circle = [middle + radius * turn(angle) for middle, turn in zip(arm.pivot, (np.cos, np.sin), strict=True)]
            axis.plot(*circle, color=colour, ls="--", lw=1.1, label=words)
        draw_obstacles(axis, reach.problem.obstacles, 4.0 * far)
        axis.plot(*arm.pivot, "o", color=INK, ms=5.0, label="motor's shaft")
        axis.set(xlabel="x, m", ylabel="y, m (up)", aspect="equal", title=_title(reach))
        legend(figure, axis, place="lower center", columns=2)
    return figure


def _title(reach: ReachMap) -> str:
    searched = int((~reach.infeasible & (reach.status >= 0)).sum())
    rope, radius = reach.problem.rope, 1e3 * reach.radius
    return (
        f"Rope of {rope.total_length:.3g} m, {1e3 * rope.total_mass:.3g} g; targets of {radius:.3g} mm radius\n"
        f"{int(reach.wound.sum())} of {searched} feasible ones wound, {reach.time_budget:g} s each (simulated)"
    )


def _cells(axis: Any, edges: list[Array], where: Any, colour: str, label: str) -> None:
    """Fill the cells of a kind; a mark in the legend stands for them."""
    from matplotlib.colors import ListedColormap

    if where.any():
        axis.pcolormesh(*edges, np.ma.masked_where(~where, np.ones(where.shape)), cmap=ListedColormap([colour]))
        axis.plot([], [], "s", color=colour, mec=RED if colour == _FAILED else GREY, mew=0.5, ms=9.0, label=label)


def _edges(places: Array) -> Array:
    """Return the edges (K + 1,) of cells about places (K,), m."""
    if places.size == 1:
        return np.asarray(places[0] + np.array([-0.05, 0.05]))
    between = 0.5 * (places[1:] + places[:-1])
    return np.concatenate([[2.0 * places[0] - between[0]], between, [2.0 * places[-1] - between[-1]]])
