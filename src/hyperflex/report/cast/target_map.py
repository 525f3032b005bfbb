"""A map of the target: arm, rope, target and the rope's reach, to scale, without a run."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Peg
from hyperflex.planning import CastPlan
from hyperflex.report.strobe import draw_obstacles
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, legend, new_figure
from hyperflex.report.units import length

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST = 0.012  # of the picture's width, to which small pegs are widened so that they can be seen
_MARGIN = 1.08


def target_map(plan: CastPlan) -> "Figure":
    """Draw the target, the arm with its rope at rest, and the circle beyond which the rope does not come."""
    arm, far = plan.problem.arm, plan.problem.arm.length + plan.problem.rope.total_length
    pivot: Array = np.array(arm.pivot, dtype=np.float64)
    pegs = [plan.target] if plan.fallback is None else [plan.target, plan.fallback.target]
    corners = [pivot - far, pivot + far]
    corners += [np.array([peg.x, peg.y]) + side * peg.radius for peg in pegs for side in (-1.0, 1.0)]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    middle, half = 0.5 * (low + high), 0.5 * _MARGIN * (high - low)
    with new_figure(8.6, 6.4) as figure:
        axis: Any = figure.subplots()
        axis.set(xlim=(middle - half)[0] + np.array([0.0, 2.0 * half[0]]), aspect="equal")
        axis.set(ylim=(middle - half)[1] + np.array([0.0, 2.0 * half[1]]))
        _circle(axis, pivot, far, GREY, f"the rope's end comes no farther than {far:.3g} m")
        _circle(axis, pivot, arm.length, BLUE, "circle of the arm's tip")
        tip, end = _at_rest(plan)
        axis.plot(*np.stack([tip, end], axis=1), color="#d99a1c", lw=2.0, label="rope, hanging at rest")
        axis.plot(*np.stack([pivot, tip], axis=1), color=INK, lw=3.0, label="arm", solid_capstyle="round")
        axis.plot(*pivot, "o", color=INK, ms=5.0, label="motor's shaft")
        draw_obstacles(axis, plan.problem.obstacles, 8.0 * far)
        for k, each in enumerate(plan.problem.behind):
            _peg(axis, each, 2.0 * half[0], INK, "" if k else "peg that the rope is to run behind")
        _peg(axis, plan.target, 2.0 * half[0], RED, "target")
        if plan.fallback is not None:
            _peg(
                axis,
                plan.fallback.target,
                2.0 * half[0],
                GREEN,
                f"{_kind(plan)}, {length(plan.fallback.distance, small='cm')} away",
            )
        axis.set(xlabel="x, m", ylabel="y, m (up)")
        legend(figure, axis, place="lower center", columns=2)
    return figure


def target_map_caption(plan: CastPlan) -> str:
    """Return the caption of :func:`target_map`."""
    near = "" if plan.fallback is None else f" Green: {_kind(plan)}."
    return f"Arm and rope as they begin, and the target (red), to scale; a drawing, nothing of it was simulated.{near}"


def _kind(plan: CastPlan) -> str:
    """Return in words what the fallback target is."""
    if plan.fallback is not None and plan.fallback.plan is not None:
        return "nearest target that works"
    return f"nearest target that should be {'easier' if plan.feasibility.feasible else 'in reach'}"


def _at_rest(plan: CastPlan) -> tuple[Array, Array]:
    """Places (2,) of the arm's tip and the rope's end at the start, m; the arm to the left where there is no throw."""
    arm, limits, gravity = plan.problem.arm, plan.problem.limits, np.array(plan.problem.rope.gravity)
    angle = float(np.clip(-0.5 * np.pi, *limits.angles) if plan.throw is None else plan.throw.angles(limits)[0])
    tip: Array = np.array(arm.pivot) + arm.length * np.array([math.sin(angle), -math.cos(angle)])
    return tip, tip + plan.problem.rope.total_length * gravity / np.hypot(*gravity)


def _circle(axis: Any, centre: Array, radius: float, colour: str, label: str) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    x, y = centre[0] + radius * np.sin(angle), centre[1] - radius * np.cos(angle)
    axis.plot(x, y, color=colour, ls="--", lw=1.1, label=label)


def _peg(axis: Any, peg: Peg, width: float, colour: str, label: str) -> None:
    from matplotlib.patches import Circle

    shown = max(peg.radius, 0.5 * _LEAST * width)
    axis.add_patch(Circle((peg.x, peg.y), shown, facecolor=colour, edgecolor="white", lw=0.6, zorder=4))
    axis.plot([], [], "o", color=colour, label=label)
