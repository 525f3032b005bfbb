"""A planned whip in words: target, strokes, peak, miss, blow, or why it fails."""

from __future__ import annotations

import math

import numpy as np

from hyperflex.planning import (
    FRICTION_STD,
    IMPACT_RADIUS,
    IMPACT_TIME,
    LENGTH_STD,
    TIMING_STD,
    Impact,
    TipStrike,
    TipTarget,
    WhipPlan,
)
from hyperflex.report.cast.words import source
from hyperflex.report.cast_setup_words import arm_words, rope_words
from hyperflex.report.tables import TextTable

Tiles = tuple[tuple[str, str], ...]


def lead(plan: WhipPlan) -> str:
    """Return what this is about, and where it comes from."""
    whipped = "is whipped" if plan.success else "is to be whipped"
    return (
        f"A rope that hangs from a motor-driven arm {whipped}, so that its tip passes a point at a peak of its speed. "
        f"{source(plan)}; nothing here was measured."
    )


def target_words(mark: TipTarget) -> str:
    """Return where the target is and what is asked there."""
    return f"x = {mark.x:.3g} m, y = {mark.y:.3g} m, {direction_words(mark)}, at {mark.speed:.3g} m/s or more"


def direction_words(mark: TipTarget) -> str:
    """Return in which direction the tip shall pass."""
    if mark.any_direction:
        return "in any direction"
    asked = np.degrees(mark.direction)
    return f"within {np.degrees(mark.angle_tolerance):.3g} degrees of the direction {asked:.3g} (0 is +x, 90 up)"


def strokes_words(plan: WhipPlan) -> str:
    """Return how many strokes the arm makes."""
    count = 0 if plan.strokes is None else plan.strokes.ends.size
    return f"{count} stroke{'' if count == 1 else 's'}"


def verdict(plan: WhipPlan) -> str:
    """Return in a sentence whether the whip stands."""
    if plan.success and (seen := plan.outcome) is not None:
        return f"The tip passes the target at {seen.speed:.1f} m/s, {1e3 * seen.miss:.2g} mm off, in simulation."
    return f"No whip that meets the target was found: {plan.message}."


def tiles(plan: WhipPlan, blow: Impact | None) -> Tiles:
    """Return the key figures."""
    mark, seen = plan.target, plan.outcome
    shown = [(f"{mark.x:.3g}, {mark.y:.3g} m", "target: x and y (up) from the motor's shaft")]
    if plan.strokes is not None:
        shown.append((strokes_words(plan), "of the arm to and fro"))
    if seen is not None:
        shown.append((f"{seen.speed:.1f} m/s", f"speed of the tip at its peak; {mark.speed:.3g} are asked"))
        shown.append((f"{1e3 * seen.miss:.2g} mm", "miss: from the target to the tip at its peak"))
        if not mark.any_direction:
            allowed = f"{np.degrees(mark.angle_tolerance):.3g}"
            shown.append((f"{np.degrees(seen.angle_error):.1f} degrees", f"off the direction asked; {allowed} allowed"))
        shown.append((f"{seen.t:.2f} s", "after the start the tip's speed peaks"))
    if blow is not None and math.isfinite(blow.t):
        shown.append(
            (f"{1e3 * blow.impulse:.1f} mN s", f"blow on a small peg of {1e3 * IMPACT_RADIUS:g} mm at the target")
        )
    return tuple(shown)


def story(plan: WhipPlan, blow: Impact | None) -> tuple[str, ...]:
    """Return what happens, in order."""
    told = [f"Target: {target_words(plan.target)}."]
    if plan.strokes is None:
        return tuple(told)
    limits = plan.cast_setup.limits
    starts, angles = plan.strokes.starts(limits), np.degrees(plan.strokes.angles(limits))
    to = ", ".join(f"{end:.0f} degrees from {start:.2f} s on" for start, end in zip(starts, angles[1:], strict=True))
    told.append(
        f"The rope hangs at rest from the arm at {angles[0]:.0f} degrees (0 hangs down). The arm makes "
        f"{strokes_words(plan)}: to {to}."
    )
    if plan.outcome is not None:
        told.append(_peak(plan, plan.outcome))
    if blow is not None:
        told.append(_blow(blow))
    if math.isfinite(plan.position_std):
        told.append(
            f"How sure: the place of the peak has a standard deviation of {1e3 * plan.position_std:.0f} mm if friction "
            f"is known to {100 * FRICTION_STD:g} %, length to {100 * LENGTH_STD:g} % and each rest of the arm to "
            f"{1e3 * TIMING_STD:g} ms."
        )
    return tuple(told)


def _peak(plan: WhipPlan, seen: TipStrike) -> str:
    way = np.degrees(np.arctan2(*seen.velocity[::-1]))
    before = (
        "it was slower at all times before"
        if seen.earlier_speed <= seen.speed
        else f"it reached {seen.earlier_speed:.1f} before"
    )
    return (
        f"At {seen.t:.2f} s the tip's speed peaks at {seen.speed:.2f} m/s ({before}), {1e3 * seen.miss:.2g} mm from "
        f"the target, in the direction {way:.0f} degrees."
    )


def _blow(blow: Impact) -> str:
    if not math.isfinite(blow.t):
        return "A small peg behind the target is not touched by the rope."
    return (
        f"Blow: a fixed peg of {1e3 * IMPACT_RADIUS:g} mm radius just behind the target, struck by the rope's link "
        f"{blow.link + 1}, takes up {1e3 * blow.impulse:.1f} mN s in {1e3 * IMPACT_TIME:g} ms "
        f"({1e3 * blow.impulse_along:.1f} mN s in the tip's direction), and the rope loses {1e3 * blow.energy:.0f} mJ."
    )


def checks_table(plan: WhipPlan) -> TextTable:
    """Return what the verified runs say, with the links and with links of half the length."""
    rows = []
    for name, seen in (("as planned", plan.outcome), ("links of half the length", plan.finer_outcome)):
        if seen is None:
            rows.append((name, "no peak there", "", "", "", ""))
            continue
        off = "any" if plan.target.any_direction else f"{np.degrees(seen.angle_error):.1f} degrees"
        links = str(seen.n_links)
        rows.append((name, links, f"{seen.t:.3f} s", f"{seen.speed:.2f} m/s", f"{1e3 * seen.miss:.2g} mm", off))
    return TextTable(("run", "links", "peak", "speed", "misses by", "off the direction"), tuple(rows))


def finer_words() -> str:
    """Return what the run with finer links says."""
    return (
        "The second run makes the same strokes with a rope cut twice as finely: its miss is what cutting into links "
        "does to a fast tip. It may be as large as what the plan itself leaves in doubt, and 3 mm in any case; where "
        "that matters, plan with shorter links."
    )


def setup_words(plan: WhipPlan) -> tuple[str, ...]:
    """Return rope, arm and target as they were given."""
    cast_setup = plan.cast_setup
    return (f"{rope_words(cast_setup)}. {arm_words(cast_setup)} Target: {target_words(plan.target)}.",)
