"""Maps to scale: a target with arm and rope, and the targets of a reach map."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Arm, Peg
from hyperflex.planning import CastPlan, ReachMap
from hyperflex.report.pictures import draw_obstacles
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, legend, new_figure
from hyperflex.report.units import length

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def target_map(plan: CastPlan, nearest: str) -> "Figure":
    """Draw the target, the arm with its rope at rest, and the circle of the rope's reach.

    `nearest` describes the nearest target, if the plan contains one.
    """
    setup, fallback = plan.problem, plan.fallback
    arm, limits, gravity = setup.arm, setup.limits, np.array(setup.rope.gravity)
    far = arm.length + setup.rope.total_length
    pegs = [(peg, INK, "peg that the rope must run behind") for peg in setup.criteria.behind]
    pegs.append((plan.target, RED, "target"))
    if fallback is not None:
        pegs.append((fallback.target, GREEN, f"{nearest}, {length(fallback.distance, small='cm')} away"))
    angle = float(np.clip(-0.5 * np.pi, *limits.angles) if plan.moves is None else plan.moves.angles(limits)[0])
    tip = arm.tip(np.array([angle]))[0]
    end = tip + setup.rope.total_length * gravity / np.hypot(*gravity)
    with new_figure(8.6, 6.4) as figure:
        axis: Any = figure.subplots()
        _circles(axis, arm, far)
        axis.plot(*np.stack([tip, end], axis=1), color="#d99a1c", lw=2.0, label="rope, hanging at rest")
        axis.plot(*np.stack([np.array(arm.pivot), tip], axis=1), color=INK, lw=3.0, label="arm")
        axis.plot(*arm.pivot, "o", color=INK, ms=5.0, label="motor's shaft")
        for peg, colour, label in pegs:
            _peg(axis, peg, 0.013 * far, colour, label)
        axis.autoscale_view()
        axis.set(xlim=axis.get_xlim(), ylim=axis.get_ylim(), aspect="equal", xlabel="x, m", ylabel="y, m (up)")
        draw_obstacles(axis, setup.obstacles, 8.0 * far)
        legend(figure, axis, place="lower center", columns=2)
    return figure


def reach_figure(reach: ReachMap) -> "Figure":
    """Draw a reach map to scale: contact angle of the targets that are wound, reason for the others."""
    arm = reach.problem.arm
    far = arm.length + reach.problem.rope.total_length
    edges = [_edges(reach.x), _edges(reach.y)]
    width, height = (float(np.ptp(each)) for each in edges)
    tall = float(np.clip(6.0 * height / width, 3.0, 8.0))
    with new_figure(max(5.6, min(9.0, tall * width / height) + 2.6), tall + 1.0) as figure:
        axis: Any = figure.subplots()
        axis.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]])
        failed = ~(reach.wound | reach.infeasible) & (reach.status >= 0)
        _cells(axis, edges, reach.infeasible, "#e3e6ea", GREY, "not feasible, not searched")
        _cells(axis, edges, failed, "#f0b7b0", RED, "feasible, but no cast found in the time")
        if not reach.complete:
            _cells(axis, edges, reach.status < 0, "white", GREY, "not planned: interrupted")
        if reach.wound.any():
            degrees = np.ma.masked_invalid(np.degrees(reach.contact_angle))
            mesh = axis.pcolormesh(*edges, degrees, cmap="YlGnBu", vmin=0.0, vmax=max(360.0, float(degrees.max())))
            figure.colorbar(mesh, ax=axis, label="wound: angle of the target covered, degrees", shrink=0.8)
        _circles(axis, arm, far)
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


def _cells(axis: Any, edges: list[Array], where: Any, colour: str, rim: str, label: str) -> None:
    """Fill the cells of a kind; the legend shows them as a square."""
    from matplotlib.colors import ListedColormap

    if where.any():
        axis.pcolormesh(*edges, np.ma.masked_where(~where, np.ones(where.shape)), cmap=ListedColormap([colour]))
        axis.plot([], [], "s", color=colour, mec=rim, mew=0.5, ms=9.0, label=label)


def _edges(places: Array) -> Array:
    """Return the edges (K + 1,) of cells around positions (K,), m."""
    if places.size == 1:
        return np.asarray(places[0] + np.array([-0.05, 0.05]))
    between = 0.5 * (places[1:] + places[:-1])
    return np.concatenate([[2.0 * places[0] - between[0]], between, [2.0 * places[-1] - between[-1]]])


def _circles(axis: Any, arm: Arm, far: float) -> None:
    """Draw the circle of the arm's tip, and the one that the rope's end does not leave, of radius `far`, m."""
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    around = np.stack([np.sin(angle), -np.cos(angle)])
    for radius, colour, label in (
        (far, GREY, f"the rope's end comes no farther than {far:.3g} m"),
        (arm.length, BLUE, "circle of the arm's tip"),
    ):
        axis.plot(*(np.array(arm.pivot)[:, None] + radius * around), color=colour, ls="--", lw=1.1, label=label)


def _peg(axis: Any, peg: Peg, least: float, colour: str, label: str) -> None:
    """Draw a peg with a radius of `least`, m, or more, so that it can be seen."""
    from matplotlib.patches import Circle

    radius = max(peg.radius, least)
    axis.add_patch(Circle((peg.x, peg.y), radius, facecolor=colour, edgecolor="white", lw=0.6, zorder=4))
    axis.plot([], [], "o", color=colour, label=label)
