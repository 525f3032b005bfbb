"""Whips to 30 random switches behind the edge of a wall, checked with finer links.

python -m benchmarks.switches               results in benchmarks/results/switches.json and .md; the same command
                                            continues an interrupted run (switches.jsonl)
python -m benchmarks.switches --count 12    the first ones only
python -m benchmarks.switches --only 7      one of them again
python -m benchmarks.switches --switches 8  draws new walls and switches, with seed 8

A rope of 1 m and 32 links, the paper's motor. A wall next to the motor ends at an edge; the switch is 5 to 20 cm behind
it and 3 to 20 cm below the edge. A switch is kept if, in one of 1,024 random swings that the planner does not use, the
tip reaches it at a peak of its speed while the rope stays 15 mm away from the wall. The required speed of the tip is
that of this swing less a fifth. A switch is struck if, with 2.5 times the links and a fifth of the tolerance, the tip
comes within 10 mm and is the first part of the rope that touches anything, a peg of 10 mm at the switch. All simulated.
"""

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.targets import Benchmark, markdown

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.model import obstacle_gaps
from hyperflex.planning import Conditions, MotorLimits, Problem, TipTarget, WhipPlan, plan_whip, simulate_impact
from hyperflex.planning.clearance import obstacle_clearance, samples_clear_of_arm
from hyperflex.planning.tasks.insert import finer_rope
from hyperflex.planning.tasks.tip import OPTIONS, Flights, random_swings
from hyperflex.planning.tasks.whip import find_peaks, verify_whip

SWITCHES = Path(__file__).parent / "switch-targets.json"
ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=32, radius=0.0025, friction=2e-4)
ARM, LIMITS, TIME = hf.Arm(length=0.105), MotorLimits(), 5.6  # s, until the strike
COUNT, SWINGS = 30, 1024
WALLS, EDGES, FLOOR = (0.25, 0.7), (-1.0, -0.3), -1.5  # m: next to the motor; of upper and lower ends
BEHIND, BELOW, APART = (0.05, 0.2), (0.03, 0.2), 0.015  # m
SLOWEST, SLOWER = 1.5, 0.8  # m/s, of a swing; required fraction of its speed
TIME_BUDGET, TOL, FINER = 30.0, 2e-8, 2.5  # s of processor time; m, tolerance of the check; times the links
SWITCH = 0.01  # m, radius of the peg, and greatest miss


def switches() -> list[dict[str, float]]:
    """The committed walls and switches."""
    rows: list[dict[str, float]] = json.loads(SWITCHES.read_text())
    return rows


def draw(seed: int) -> list[dict[str, float]]:
    """Walls and switches that a random swing strikes without touching the wall."""
    problem, rng = Problem(ROPE, ARM, LIMITS, TIME), np.random.default_rng(seed)
    swings = random_swings(problem, 2 * SWINGS)[SWINGS:]  # the planner uses the first ones
    flights = Flights(problem, swings, np.arange(0.0, problem.time, OPTIONS.sample_time), Budget())
    peaks = find_peaks(flights.t, flights.joints[:, :, -1], flights.velocity)
    last = samples_clear_of_arm(ROPE, ARM, flights.q, flights.joints[:, :, 0], 0.0)
    found, taken = list[dict[str, float]](), set[int]()
    while len(found) < COUNT:
        x, edge = rng.uniform(*WALLS) * rng.choice([-1.0, 1.0]), rng.uniform(*EDGES)
        wall = hf.Wall(x, FLOOR, x, edge)
        behind, below = np.sign(x) * (peaks.place[:, 0] - x), edge - peaks.place[:, 1]
        right = (peaks.speed > SLOWEST) & (behind > BEHIND[0]) & (behind < BEHIND[1])
        kept = []
        for k in np.flatnonzero(right & (below > BELOW[0]) & (below < BELOW[1])):
            row, until = peaks.row[k], int(peaks.t[k] / OPTIONS.sample_time) + 2
            joints = flights.joints[row, :until]
            if (
                k not in taken
                and until <= last[row]
                and obstacle_gaps((wall,), joints[:, :-1], joints[:, 1:]).min() > APART
            ):
                kept.append(int(k))
        if kept:
            taken.add(k := int(rng.choice(kept)))
            row = {"wall": x, "edge": edge, "x": peaks.place[k, 0], "y": peaks.place[k, 1]}
            row["speed"] = SLOWER * peaks.speed[k]
            found.append({name: round(float(value), 4) for name, value in row.items()})
    return found


def check(plan: WhipPlan) -> str:
    """The reason why a plan does not strike its switch with a finer rope, or an empty text."""
    assert plan.outcome is not None
    assert plan.motion is not None
    finer = replace(plan.problem, rope=finer_rope(ROPE))
    seen = verify_whip(finer, plan.target, plan.motion, plan.outcome.t, tol=TOL)
    if seen is None:
        return "no peak there"
    if seen.refused or seen.miss > SWITCH:
        return seen.refused or f"misses by {1e3 * seen.miss:.1f} mm"
    direction = float(np.arctan2(*seen.velocity[::-1]))
    return simulate_impact(finer, plan.target.point, direction, plan.motion, seen.t, radius=SWITCH, mu=0.3).message


def measure(index: int, mark: dict[str, float]) -> dict[str, Any]:
    """Plan and check a whip to a switch."""
    wall = hf.Wall(mark["wall"], FLOOR, mark["wall"], mark["edge"])
    plan = plan_whip(
        ROPE,
        ARM,
        TipTarget(mark["x"], mark["y"], least_speed=mark["speed"]),
        conditions=Conditions(time_limit=TIME, obstacles=(wall,)),
        time_budget=Budget(TIME_BUDGET, threads=1, clock=time.process_time),
    )
    row: dict[str, Any] = {"index": index, "kernels": SOURCE_HASH, "success": plan.success, "reason": plan.message}
    row |= {"seconds": plan.seconds, "runs": plan.runs}
    if plan.success and plan.outcome is not None:
        seen = plan.outcome
        assert seen.run is not None
        gap = obstacle_clearance(seen.run, [wall], seen.t).value
        row |= {"gap": gap, "speed": seen.speed, "t": seen.t, "judged": check(plan)}
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The numbers of switches, plans and strikes."""
    return {
        "switches": len(rows),
        "planned": sum(row["success"] for row in rows),
        "struck": sum(row.get("judged") == "" for row in rows),
        "median seconds": float(np.median([row["seconds"] for row in rows])),
    }


def page(found: dict[str, Any]) -> str:
    """The results as Markdown."""
    told = found["summary"]
    lines = ["| switch | behind, cm | below, cm | outcome | nearest to the wall, mm | speed, m/s | seconds |"]
    lines.append("|---" * 7 + "|")
    for row, mark in zip(found["rows"], switches(), strict=False):
        outcome, parts = row["reason"], ["", ""]
        if row["success"]:
            outcome = row["judged"] or "struck"
            parts = [f"{1e3 * row['gap']:.0f}", f"{row['speed']:.1f}"]
        place = f"{1e2 * abs(mark['x'] - mark['wall']):.0f} | {1e2 * (mark['edge'] - mark['y']):.0f}"
        lines.append(f"| {row['index']} | {place} | {outcome} | {' | '.join(parts)} | {row['seconds']:.0f} |")
    text = (
        f"A rope of 1 m with {ROPE.n_links} links, the paper's motor, a wall next to it, and a switch behind its upper "
        f"edge; a random swing that the planner does not use strikes each. {told['planned']} of {told['switches']} "
        f"switches are planned within {TIME_BUDGET:g} s of processor time (median {told['median seconds']:.0f} s), and "
        f"{told['struck']} are struck in the independent check ({FINER:g} times the links, a fifth of the tolerance): "
        f"the tip comes within {1e3 * SWITCH:g} mm and is the first part of the rope that touches anything, a peg at "
        "the switch."
    )
    return markdown("Switches behind an edge", text, lines, found["machine"], "switches")


BENCHMARK = Benchmark("switches", SWITCHES, "switch", "switches", draw, switches)

if __name__ == "__main__":
    BENCHMARK.run(__doc__, measure, summary, page)
