"""A planned whip in words: target, strokes, peak, miss, impact, or why it fails."""

from __future__ import annotations

import math

import numpy as np

from hyperflex.planning import Impact, Lash, Mark, WhipPlan
from hyperflex.planning.whip.aim import FRICTION, LENGTH, TIMING
from hyperflex.planning.whip.impact import BLOW, RADIUS
from hyperflex.report.page import TextTable
from hyperflex.report.plan import counted, source

FINER_NOTE = (
    "The second run makes the same strokes with a rope cut twice as finely: its miss is the error that cutting into "
    "links makes at a fast tip. It may be as large as the uncertainty of the plan itself, and 3 mm in any case; where "
    "that matters, plan with shorter links."
)


def lead(plan: WhipPlan) -> str:
    """Return what the plan is about, and where it comes from."""
    whipped = "is whipped" if plan.success else "is to be whipped"
    return (
        f"A rope that hangs from a motor-driven arm {whipped}, so that its tip passes a point at a peak of its speed. "
        f"{source(plan)}"
    )


def target_words(mark: Mark) -> str:
    """Return where the target is, and direction and speed that are needed there."""
    return f"x = {mark.x:.3g} m, y = {mark.y:.3g} m, {direction_words(mark)}, at {mark.speed:.3g} m/s or more"


def direction_words(mark: Mark) -> str:
    """Return in which direction the tip must pass."""
    if mark.anyhow:
        return "in any direction"
    asked = np.degrees(mark.direction)
    return f"within {np.degrees(mark.within):.3g} degrees of the direction {asked:.3g} degrees (0 is +x, 90 up)"


def strokes_words(plan: WhipPlan) -> str:
    """Return how many strokes the arm makes."""
    return counted(0 if plan.strokes is None else plan.strokes.ends.size, "stroke")


def verdict(plan: WhipPlan) -> str:
    """Return in a sentence whether the whip succeeds."""
    if plan.success and plan.lash is not None:
        return (
            f"The tip passes the target at {plan.lash.speed:.1f} m/s, {1e3 * plan.lash.miss:.2g} mm off, in simulation."
        )
    return f"No whip that meets the target was found: {plan.reason}."


def tiles(plan: WhipPlan, impact: Impact | None) -> tuple[tuple[str, str], ...]:
    """Return the key figures."""
    mark, seen = plan.mark, plan.lash
    shown = [(f"{mark.x:.3g}, {mark.y:.3g} m", "target: x and y (up) from the motor's shaft")]
    if plan.strokes is not None:
        shown.append((strokes_words(plan), "of the arm to and fro"))
    if seen is not None:
        shown.append((f"{seen.speed:.1f} m/s", f"speed of the tip at its peak; {mark.speed:.3g} are needed"))
        shown.append((f"{1e3 * seen.miss:.2g} mm", "miss: from the target to the tip at its peak"))
        if not mark.anyhow:
            allowed = f"{np.degrees(mark.within):.3g}"
            shown.append((f"{np.degrees(seen.off):.1f} degrees", f"off the direction needed; {allowed} allowed"))
        shown.append((f"{seen.t:.2f} s", "after the start the tip's speed peaks"))
    if impact is not None and math.isfinite(impact.t):
        shown.append(
            (
                f"{1e3 * impact.impulse:.1f} mN s",
                f"impulse of the impact on a small peg of {1e3 * RADIUS:g} mm at the target",
            )
        )
    return tuple(shown)


def story(plan: WhipPlan, impact: Impact | None) -> tuple[str, ...]:
    """Return what happens, in order."""
    lines = [f"Target: {target_words(plan.mark)}."]
    if plan.strokes is None:
        return tuple(lines)
    limits = plan.thrower.limits
    starts, angles = plan.strokes.starts(limits), np.degrees(plan.strokes.angles(limits))
    to = ", ".join(f"{end:.0f} degrees from {start:.2f} s on" for start, end in zip(starts, angles[1:], strict=True))
    lines.append(
        f"The rope hangs at rest from the arm at {angles[0]:.0f} degrees (0 hangs down). The arm makes "
        f"{strokes_words(plan)}: to {to}."
    )
    if plan.lash is not None:
        lines.append(_peak(plan, plan.lash))
    if impact is not None:
        lines.append(_impact(impact))
    if math.isfinite(plan.doubt):
        lines.append(
            f"Uncertainty: the place of the peak has a standard deviation of {1e3 * plan.doubt:.0f} mm if friction is "
            f"known to {100 * FRICTION:g} %, length to {100 * LENGTH:g} % and each rest of the arm to "
            f"{1e3 * TIMING:g} ms."
        )
    return tuple(lines)


def _peak(plan: WhipPlan, seen: Lash) -> str:
    way = np.degrees(np.arctan2(*seen.velocity[::-1]))
    before = (
        "it was slower at all times before" if seen.before <= seen.speed else f"it reached {seen.before:.1f} before"
    )
    return (
        f"At {seen.t:.2f} s the tip's speed peaks at {seen.speed:.2f} m/s ({before}), {1e3 * seen.miss:.2g} mm from "
        f"the target, in the direction {way:.0f} degrees."
    )


def _impact(impact: Impact) -> str:
    if not math.isfinite(impact.t):
        return "A small peg behind the target is not touched by the rope."
    return (
        f"Impact: a fixed peg of {1e3 * RADIUS:g} mm radius just behind the target, struck by the rope's link "
        f"{impact.link + 1}, takes up {1e3 * impact.impulse:.1f} mN s in {1e3 * BLOW:g} ms "
        f"({1e3 * impact.along:.1f} mN s in the tip's direction), and the rope loses {1e3 * impact.energy:.0f} mJ."
    )


def checks_table(plan: WhipPlan) -> TextTable:
    """Return what the verified runs say, with the links and with links of half the length."""
    rows = []
    for name, seen in (("as planned", plan.lash), ("links of half the length", plan.finer)):
        if seen is None:
            rows.append((name, "no peak there", "", "", "", ""))
            continue
        off = "any" if plan.mark.anyhow else f"{np.degrees(seen.off):.1f} degrees"
        links = str(seen.run.q.shape[1])
        rows.append((name, links, f"{seen.t:.3f} s", f"{seen.speed:.2f} m/s", f"{1e3 * seen.miss:.2g} mm", off))
    return TextTable(("run", "links", "peak", "speed", "misses by", "off the direction"), tuple(rows))
