"""Maps to scale: a target with arm and rope, and the targets of a reach map."""

from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import unit_along
from hyperflex.planning import CastPlan, Problem, ReachMap
from hyperflex.report import units
from hyperflex.report.pictures import draw_obstacles
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, Figure, legend, new_figure


def target_map(plan: CastPlan, nearest: str) -> "Figure":
    """Draw the target, the arm with its rope at rest, and the circle of the rope's reach.

    `nearest` describes the nearest target, if the plan contains one.
    """
    from matplotlib.patches import Circle

    setup, fallback = plan.problem, plan.fallback
    arm, limits, gravity, length = setup.arm, setup.limits, np.array(setup.rope.gravity), setup.rope.total_length
    pegs = [(peg, INK, "peg that the rope must run behind") for peg in setup.criteria.behind]
    pegs.append((plan.target, RED, "target"))
    if fallback is not None:
        pegs.append((fallback.target, GREEN, f"{nearest}, {units.length(fallback.distance, small='cm')} away"))
    angle = float(np.clip(-0.5 * np.pi, *limits.angles) if plan.moves is None else plan.moves.angles(limits)[0])
    tip = arm.tip(np.array([angle]))[0]
    end = tip + length * gravity / np.hypot(*gravity)
    with new_figure(8.6, 6.4) as figure:
        axis: Any = figure.subplots()
        for peg, colour, label in pegs:
            radius = max(peg.radius, 0.013 * (arm.length + length))  # so that it can be seen
            style = {"facecolor": colour, "edgecolor": "white", "zorder": 4, "label": label}
            axis.add_patch(Circle((peg.x, peg.y), radius, **style))
        axis.plot(*np.stack([tip, end], axis=1), color="#d99a1c", lw=2.0, label="rope, hanging at rest")
        axis.plot(*np.stack([np.array(arm.pivot), tip], axis=1), color=INK, lw=3.0, label="arm")
        _draw_reach(figure, axis, setup)
    return figure


def reach_figure(reach: ReachMap) -> "Figure":
    """Draw a reach map to scale: contact angle of the targets that are wound, reason for the others."""
    from matplotlib.colors import ListedColormap

    edges = [_edges(reach.x), _edges(reach.y)]
    width, height = (float(np.ptp(each)) for each in edges)
    tall = float(np.clip(6.0 * height / width, 3.0, 8.0))
    with new_figure(max(5.6, min(9.0, tall * width / height) + 2.6), tall + 1.0) as figure:
        axis: Any = figure.subplots()
        axis.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]], title=_title(reach))
        failed = ~(reach.wound | reach.infeasible) & (reach.status >= 0)
        for where, colour, rim, label in (
            (reach.infeasible, "#e3e6ea", GREY, "not feasible, not searched"),
            (failed, "#f0b7b0", RED, "feasible, but no cast found in the time"),
            (reach.status < 0, "white", GREY, "not planned: interrupted"),
        ):
            if where.any():
                axis.pcolormesh(*edges, np.ma.masked_where(~where, np.ones(where.shape)), cmap=ListedColormap([colour]))
                axis.plot([], [], "s", color=colour, mec=rim, ms=9.0, label=label)
        if reach.wound.any():
            degrees = np.ma.masked_invalid(np.degrees(reach.contact_angle))
            mesh = axis.pcolormesh(*edges, degrees, cmap="YlGnBu", vmin=0.0, vmax=max(360.0, float(degrees.max())))
            figure.colorbar(mesh, ax=axis, label="wound: angle of the target covered, degrees", shrink=0.8)
        _draw_reach(figure, axis, reach.problem)
    return figure


def _title(reach: ReachMap) -> str:
    rope, radius = reach.problem.rope, 1e3 * reach.radius
    return (
        f"Rope of {rope.total_length:.3g} m, {1e3 * rope.total_mass:.3g} g; targets of {radius:.3g} mm radius\n"
        f"{reach.in_short()}; {reach.time_budget:g} s each (simulated)"
    )


def _edges(places: Array) -> Array:
    """Return the edges (K + 1,) of cells around positions (K,), m."""
    if places.size == 1:
        return np.asarray(places[0] + np.array([-0.05, 0.05]))
    between = 0.5 * (places[1:] + places[:-1])
    return np.concatenate([[2.0 * places[0] - between[0]], between, [2.0 * places[-1] - between[-1]]])


def _draw_reach(figure: "Figure", axis: Any, problem: Problem) -> None:
    """Draw shaft, circles of the arm's tip and of the rope's reach, and obstacles; label the map."""
    arm, pivot = problem.arm, np.array(problem.arm.pivot)[:, None]
    far, angle = arm.length + problem.rope.total_length, np.linspace(0.0, 2.0 * np.pi, 361)
    for radius, colour, label in (
        (far, GREY, f"the rope's end comes no farther than {far:.3g} m"),
        (arm.length, BLUE, "circle of the arm's tip"),
    ):
        circle = pivot + radius * unit_along(angle, 0)
        axis.plot(*circle, color=colour, ls="--", label=label)
    axis.plot(*pivot, "o", color=INK, label="motor's shaft")
    axis.set(xlim=axis.get_xlim(), ylim=axis.get_ylim(), aspect="equal", xlabel="x, m", ylabel="y, m (up)")
    draw_obstacles(axis, problem.obstacles, 8.0 * far)
    legend(figure, axis, place="lower center", columns=2)
