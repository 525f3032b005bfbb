"""What reports of whips and insertions share: the arm's strokes in words and over time, and the path of the tip."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning import InsertPlan, WhipPlan
from hyperflex.report.plan import counted
from hyperflex.report.time_course import ArmMoves

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def stroke_count(plan: WhipPlan | InsertPlan) -> str:
    """Return how many strokes the arm makes."""
    return counted(0 if plan.strokes is None else plan.strokes.ends.size, "stroke")


def stroke_story(plan: WhipPlan | InsertPlan) -> str:
    """Return in words how the rope hangs at first, and what the arm does; empty without strokes."""
    if plan.strokes is None:
        return ""
    limits = plan.problem.limits
    starts, angles = plan.strokes.starts(limits), np.degrees(plan.strokes.angles(limits))
    to = ", ".join(f"{end:.0f} degrees from {start:.2f} s on" for start, end in zip(starts, angles[1:], strict=True))
    return (
        f"The rope hangs at rest from the arm at {angles[0]:.0f} degrees (0 hangs down, 90 points along +x). The arm "
        f"makes {stroke_count(plan)}: to {to}."
    )


def stroke_note(plan: WhipPlan | InsertPlan, t: float) -> str:
    """Return which stroke the arm makes at a time, s, or made last."""
    begun = 0 if plan.strokes is None else int((plan.strokes.starts(plan.problem.limits) <= t).sum())
    return f"arm: stroke {begun} of {stroke_count(plan)}" if begun else f"arm: {stroke_count(plan)} to come"


def stroke_moves(plan: WhipPlan | InsertPlan) -> ArmMoves | None:
    """Return the strokes that begin within the run."""
    if plan.strokes is None:
        return None
    limits = plan.problem.limits
    starts, angles = plan.strokes.starts(limits), plan.strokes.angles(limits)
    ends = np.minimum(
        starts + limits.fastest_moves(np.diff(angles))[0], plan.required(plan.motion, "motion").breaks[-1]
    )
    count = int((starts < plan.required(plan.run, "run").t[-1]).sum())
    return ArmMoves(starts[:count], ends[:count], angles[: count + 1], tuple(str(k + 1) for k in range(count)))


def draw_path(figure: "Figure", axis: Any, path: Array, speed: Array) -> None:
    """Draw the path of the tip (k, 2) in the colour of its speed (k,), m/s."""
    from matplotlib.collections import LineCollection

    steps = list(np.stack([path[:-1], path[1:]], axis=1))
    lines = LineCollection(steps, array=speed[:-1], cmap="viridis_r", linewidths=2.6)
    axis.add_collection(lines)
    figure.colorbar(lines, ax=axis, label="speed of the tip, m/s", shrink=0.8)
