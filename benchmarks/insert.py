"""Insertions: 30 random slots in reach, planned, checked with finer links, and tried in fresh scenarios.

python -m benchmarks.insert               results in benchmarks/results/insert.json and .md; the same command
                                          continues an interrupted run (insert.jsonl)
python -m benchmarks.insert --count 12    the first ones only
python -m benchmarks.insert --only 7      one of them again
python -m benchmarks.insert --slots 5     draws new slots, with seed 5

The paper's cable and motor. Slots of 15 to 30 mm are uniform over the region that the rope could touch, in any
direction, between walls of 0.1 m; those called in reach are kept. The tip must enter by 50 mm before the rope touches a
wall. The goals: 85 % of the slots; a stated mean success probability within 8 points of the observed one in fresh
scenarios. The independent check has 4 times the links, a tenth of the tolerance and half the contact step; the
planner's own second run has 2.5 times the links. All simulated.
"""

import json
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.targets import Benchmark, markdown

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.control import swing_period
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.planning import InsertOutcome, InsertPlan, MotorLimits, Problem, Slot, plan_insert
from hyperflex.planning.tasks.insert import (
    InsertTask,
    finer_rope,
    insert_scenarios,
    usual_uncertainty,
    verify_insert,
)
from hyperflex.planning.tasks.tip import OPTIONS, Flights, random_swings

SLOTS = Path(__file__).parent / "insert-slots.json"
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
ARM = hf.Arm(length=0.105)
NEAR = 0.2  # m, from the gap; a tip that never comes this near does not enter
COUNT, WIDTHS, DEPTH = 30, (0.015, 0.03), 0.05  # m
TIME_BUDGET = 60.0  # s of processor time, on one thread
TIGHTER = 10.0  # than the library's, tolerance of the check
PERIODS, FINER = 2.0, 4.0  # of the swing, within which the tip enters; times the links, of the check
SCENARIOS, FRESH = 25, 1  # of each plan; their seed (the plan's seed is 0)
GOAL, AGREE = 0.85, 0.08


def slots() -> list[Slot]:
    """The committed slots."""
    return [Slot(**row) for row in json.loads(SLOTS.read_text())]


def draw(seed: int) -> list[dict[str, float]]:
    """Slots in reach: at least one of the planner's random swings comes near each."""
    problem = Problem(CABLE, ARM, MotorLimits(), PERIODS * swing_period(CABLE))
    swings, runs = random_swings(problem, OPTIONS.swings), list[Flights]()
    t = np.arange(0.0, problem.time, OPTIONS.sample_time)
    for low in range(0, OPTIONS.swings, OPTIONS.batch):
        runs.append(Flights(problem, swings[low : low + OPTIONS.batch], t, Budget()))
    rng, far, found = np.random.default_rng(seed), CABLE.total_length + ARM.length, list[dict[str, float]]()
    while len(found) < COUNT:
        r, a, direction = far * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
        row = {"x": r * np.cos(a), "y": r * np.sin(a), "direction": direction, "width": rng.uniform(*WIDTHS)}
        slot = Slot(**{name: round(value, 4) for name, value in row.items()}, depth=DEPTH)
        task = InsertTask(problem, slot)
        near = [each for each in runs if np.nanmin(np.linalg.norm(each.joints[:, :, -1] - slot.point, axis=2)) < NEAR]
        if any(cost < OPTIONS.max_cost for each in near for cost, _ in task.score(each)):
            found.append(asdict(slot))
    return found


def check(plan: InsertPlan, rope: hf.Rope, slot: Slot, motion: hf.Motion) -> InsertOutcome | None:
    """Simulate a motion near a slot with a rope of more links."""
    assert plan.outcome is not None
    finer = replace(plan.problem, rope=rope)
    return verify_insert(finer, slot, motion, plan.outcome.t, tighter=TIGHTER)


def entered(seen: InsertOutcome | None) -> bool:
    """Whether the tip reached its depth without a contact."""
    return seen is not None and not seen.message


def measure(index: int, slot: Slot) -> dict[str, Any]:
    """Plan and check one slot."""
    plan = plan_insert(CABLE, ARM, slot, time_budget=Budget(TIME_BUDGET, threads=1, clock=time.process_time))
    row: dict[str, Any] = {"index": index, "kernels": SOURCE_HASH, "success": plan.success, "reason": plan.message}
    row |= {"cost": plan.feasibility.cost, "seconds": plan.seconds}
    if plan.moves is None or plan.outcome is None or plan.motion is None or not plan.success:
        return row
    seen = plan.outcome
    row |= {
        "depth": seen.depth,
        "gap": seen.wall_clearance,
        "speed": seen.speed,
        "inside": seen.time_inside,
        "t": seen.t,
    }
    row["judged"] = entered(check(plan, finer_rope(CABLE, FINER), slot, plan.motion))
    stated = plan.success_probability
    row["stated"] = stated.estimate if stated is not None and stated.samples else None
    drawn = insert_scenarios(plan.problem, slot, plan.moves, usual_uncertainty(), SCENARIOS, [FRESH])
    row["observed"] = float(np.mean([entered(check(plan, *each)) for each in drawn]))
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Number of entered slots, and the difference between stated and observed success."""
    good = [row for row in rows if row.get("judged") and row["stated"] is not None]
    stated, observed = (float(np.mean([row[name] for row in good])) for name in ("stated", "observed"))
    return {
        "slots": len(rows),
        "entered": sum(bool(row.get("judged")) for row in rows),
        "stated": stated,
        "observed": observed,
        "greatest difference": max(abs(row["stated"] - row["observed"]) for row in good),
        "median seconds": float(np.median([row["seconds"] for row in rows])),
    }


def page(found: dict[str, Any]) -> str:
    """The results as Markdown."""
    told = found["summary"]
    lines = [
        "| slot | width, mm | outcome | clear of the walls, mm | speed, m/s | stated | observed |",
        "|---" * 7 + "|",
    ]
    for row, slot in zip(found["rows"], slots(), strict=False):
        if row.get("judged"):
            parts = [f"{1e3 * row['gap']:.1f}", f"{row['speed']:.2f}", f"{row['stated']:.0%}", f"{row['observed']:.0%}"]
        else:
            parts = 4 * [""]
        outcome = "entered" if row.get("judged") else row["reason"] or "not in the check"
        lines.append(f"| {row['index']} | {1e3 * slot.width:.1f} | {outcome} | {' | '.join(parts)} |")
    text = (
        f"The paper's cable and motor; slots of {1e3 * WIDTHS[0]:g} to {1e3 * WIDTHS[1]:g} mm between walls of 0.1 m, "
        "uniform over the region that the rope could touch, in any direction; those called in reach are kept. The tip "
        f"must enter by {1e3 * DEPTH:g} mm without a contact. In the independent check ({FINER:g} times the links, a "
        f"tenth of the tolerance, joint limits on) {told['entered']} of {told['slots']} slots are entered; the goal is "
        f"{GOAL:.0%}.\n\nWith standard deviations of 2 mm of the slot's position and 2 ms of each stroke's start, the "
        f"stated success probability is {told['stated']:.0%} on average, the observed one {told['observed']:.0%} in "
        f"{SCENARIOS} fresh scenarios for each plan, in the independent check; the goal is a difference of "
        f"{100 * AGREE:g} points. The greatest difference of one plan is {100 * told['greatest difference']:.0f} "
        f"points ({SCENARIOS} draws determine a probability of one half to 10 points, one standard deviation). "
        f"Planning took {told['median seconds']:.1f} s of processor time in the median, {TIME_BUDGET:g} s at most."
    )
    return markdown("Insertions", text, lines, found["machine"], "insert")


BENCHMARK = Benchmark("insert", SLOTS, "slot", "slots", draw, slots)

if __name__ == "__main__":
    BENCHMARK.run(__doc__, measure, summary, page)
