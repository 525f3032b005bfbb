"""Casts with random ropes: share of the targets called in reach that are planned and held, and planning times.

python -m benchmarks.random_ropes --seed 10                 20 ropes, 5 targets each; an hour
python -m benchmarks.random_ropes --seed 10 --targets 1     a sample: the first target of each rope
python -m benchmarks.random_ropes --seed 10 --rows 4        the first four rows that are missing

Ropes are 0.5 to 4 m long, weigh 10 to 150 g/m, taper from 1:1 to 10:1 in mass, carry up to 40 % of their mass at the
tip, bend with and without stiffness, have up to 5e-4 N m of dry friction at each joint, and hang from an arm of 5 to 15
% of their length. Targets are uniform in area within reach, 20 to 50 mm in radius, and pass the feasibility check. Each
plan gets 40 s of processor time. A cast is held if it succeeds in an independent run with 2.5 times the links, half the
contact step and a fifth of the tolerance. The first targets of all ropes come first. Rows are kept in
random-ropes-seed-N.jsonl: the same command continues an interrupted run. All simulated.
"""

import argparse
import math
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log as lines
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.budget import Budget
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL
from hyperflex.planning import Accuracy, MotorLimits, Problem, check_feasibility, plan_cast, verify_cast

RESULTS = Path(__file__).parent / "results"
SECONDS = 40.0  # s of processor time for a plan
FINER = 2.5  # times the links in the independent run


def rope_and_arm(seed: int, number: int, finer: float = 1.0) -> tuple[hf.Rope, hf.Arm]:
    """Draw rope `number` of a seed, and its arm; with `finer` times as many links.

    Damping and stiffness are per length of rope, except those of the hinge at the arm, as in
    :func:`hyperflex.model.divided`; dry friction is a bending moment, equal at each joint. The mass per length is a
    line along the rope through the taper's values at the middles of its first and last drawn link.
    """
    rng = np.random.default_rng([seed, number])

    def log_uniform(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    length, density, taper = rng.uniform(0.5, 4.0), log_uniform(0.01, 0.15), log_uniform(1.0, 10.0)
    n, tip = int(rng.integers(25, 61)), rng.uniform(0.0, 0.4)
    bending, damping = log_uniform(1e-6, 3e-4) * rng.integers(2), log_uniform(3e-6, 3e-5)  # N m^2, N m^2 s
    dry, arm = rng.uniform(0.0, 5e-4), rng.uniform(0.05, 0.15)
    drawn, n = n, round(finer * n)
    link, mass = length / n, length * density
    way = ((np.arange(n) + 0.5) * drawn / n - 0.5) / (drawn - 1)  # 0 at the first drawn link's middle, 1 at the last's
    share = 1.0 + way * (1.0 / taper - 1.0)
    share *= n / share.sum()
    rope = hf.Rope.uniform(length, mass, n, math.sqrt(density / (1000.0 * math.pi)), tip_mass=tip * mass, friction=0.0)
    hinge = np.arange(n) == 0
    rope = rope.replace(
        mass=share * rope.mass,
        inertia=share * rope.inertia,
        friction=np.where(hinge, damping * drawn / length, damping / link),
        stiffness=np.where(hinge, 0.0, bending / link),
        dry_friction=np.full(n, dry),
    )
    return rope, hf.Arm(length=arm * length)


def drawn(seed: int, number: int, rope: hf.Rope, arm: hf.Arm, count: int) -> Iterator[tuple[hf.Peg, bool]]:
    """Draw targets, and return whether each is called in reach."""
    rng, problem = np.random.default_rng([seed, number, 1]), Problem(rope, arm, MotorLimits())
    reach = rope.total_length + arm.length
    for _ in range(count):
        far, angle = reach * math.sqrt(rng.uniform()), rng.uniform(-math.pi, math.pi)
        peg = hf.Peg(far * math.sin(angle), -far * math.cos(angle), float(rng.uniform(0.02, 0.05)), 0.3)
        yield peg, check_feasibility(problem, peg).feasible


def targets(seed: int, number: int, rope: hf.Rope, arm: hf.Arm, count: int) -> Iterator[hf.Peg]:
    """Draw targets in reach of a rope."""
    return islice((peg for peg, feasible in drawn(seed, number, rope, arm, 10_000) if feasible), count)


def held(seed: int, number: int, peg: hf.Peg, plan: hf.CastPlan) -> bool:
    """Whether a plan succeeds in the independent run."""
    finer = Problem(*rope_and_arm(seed, number, FINER), MotorLimits())
    motion = plan.required(plan.motion, "motion")
    outcome = verify_cast(finer, peg, motion, accuracy=Accuracy(0.2 * DEFAULT_TOL, 0.5 * DEFAULT_CONTACT_STEP))
    return outcome.success


def row(seed: int, number: int, k: int, seconds: float) -> dict[str, Any]:
    """Plan a cast for target k of a rope and check it."""
    rope, arm = rope_and_arm(seed, number)
    peg = list(targets(seed, number, rope, arm, k + 1))[k]
    begin = time.process_time()
    plan = plan_cast(rope, arm, peg, time_budget=Budget(seconds, threads=1, clock=time.process_time))
    spent = time.process_time() - begin
    about = {"rope": number, "target": k, "length": rope.total_length, "mass": rope.total_mass, "arm": arm.length}
    about |= {"x": peg.x, "y": peg.y, "radius": peg.radius, "seconds": spent, "runs": plan.runs, "limit": seconds}
    good = plan.success and held(seed, number, peg, plan)
    by = {"kernels": SOURCE_HASH, "planner": lines.planner()}
    return about | {"planned": plan.success, "held": good, "reason": plan.message} | by


def page(seed: int, ropes: int, rows: list[dict[str, Any]], about: dict[str, str]) -> str:
    """Return the results as Markdown."""
    seconds = np.array([each["seconds"] if each["held"] else math.inf for each in rows])
    planned, good = (sum(each[name] for each in rows) for name in ("planned", "held"))
    some = [each for number in range(ropes) for each in drawn(seed, number, *rope_and_arm(seed, number), 200)]
    share = np.mean([feasible for _, feasible in some])
    text = (
        f"# Casts with random ropes: seed {seed}\n\nTargets called in reach, the first of each rope first: "
        f"{len(rows)}. Planned in {rows[0]['limit']:g} s of processor time: {planned}. Held in an independent run: "
        f"{good}; the goal is 90 %. Median time, infinite for those not held: {np.median(seconds):.1f} s. The "
        f"feasibility check calls {100 * share:.0f} % of {len(some)} targets drawn for these ropes in reach. All "
        "simulated.\n\n| rope | length, m | mass, g | arm, mm | target | x, m | y, m | radius, mm | planned | held | "
        "s | why not |\n"
    )
    text += "|---" * 12 + "|\n"
    for each in rows:
        sizes = f"{each['length']:.2f}", f"{1e3 * each['mass']:.0f}", f"{1e3 * each['arm']:.0f}"
        place = f"{each['x']:.2f}", f"{each['y']:.2f}", f"{1e3 * each['radius']:.0f}"
        found = each["planned"], each["held"], f"{each['seconds']:.0f}", each["reason"]
        text += f"| {' | '.join(map(str, (each['rope'], *sizes, each['target'], *place, *found)))} |\n"
    text += f"\n{lines.made(rows)} {lines.made(rows, 'planner')} {machine.sentence(about)}\n\n"
    return f"{text}Reproduce: `python -m benchmarks.random_ropes --seed {seed}`\n"


def main() -> None:
    """Plan, check, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ropes", type=int, default=20)
    parser.add_argument("--targets", type=int, default=5, help="targets of each rope")
    parser.add_argument("--rows", type=int, default=100_000, help="rows to add at most")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of processor time for each plan")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder")
    options = parser.parse_args()
    about, log = machine.describe(), options.out / f"random-ropes-seed-{options.seed}.jsonl"
    marks = [(number, k) for k in range(options.targets) for number in range(options.ropes)]
    marks = marks[: len(lines.read(log)) + options.rows]
    rows = lines.go_on(log, marks, lambda _, mark: row(options.seed, *mark, options.seconds))
    files.write_text(options.out / "random-ropes.md", page(options.seed, options.ropes, rows, about))


if __name__ == "__main__":
    main()
