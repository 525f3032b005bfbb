"""Casts on an emulated drive in real time: as planned, in closed loop, and after three casts that were learned from.

python -m benchmarks.hand planned/*.toml            plans of hyperflex cast
python -m benchmarks.hand planned/*.toml --motor emulator:dynamixel

Planner and drive are separate processes. The rope in the emulator is 1.5 % longer and heavier than the planner's and
has 10 % more friction; its links are cut as in a verified run. The motor acts 15 ms late, and the target is 1 cm aside.
The closed loop and the learning get the true state of the emulated rope: there is no camera in the loop.
"""

import argparse
import json
import platform
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import hyperflex as hf
from hyperflex.errors import DriveError
from hyperflex.execution import (
    CastRun,
    EmulatedRope,
    LearningOptions,
    RunOptions,
    emulator_of,
    learn_cast,
    open_drive,
    run_plan,
)
from hyperflex.hardware import MotorModel
from hyperflex.motion import Motion
from hyperflex.planning import CastPlan, FollowOptions, read_plan, scaled_rope

LENGTH, MASS, FRICTION = 1.015, 1.015, 1.1  # of the planner's
LATE, ASIDE = 0.015, 0.01  # s, m
QUICK = RunOptions(wait=30.0, countdown=0.0)


def carry_out(plan: CastPlan, motor: str, motion: Motion | None = None, follow: bool = False) -> CastRun:
    """Carry a plan out on a new emulated drive with the other rope."""
    other = replace(plan, problem=replace(plan.problem, rope=scaled_rope(plan.problem.rope, LENGTH, MASS, FRICTION)))
    peg, rope = replace(plan.target, x=plan.target.x + ASIDE), other.setup().rope
    model = MotorModel(latency=LATE, extrapolates=motor.endswith("moteus"))
    make, emulator = emulator_of(plan, motor, model, rope=rope, obstacles=(peg,))
    with emulator:
        source = EmulatedRope(emulator, plan.problem.rope, rope, plan.problem.arm)
        connect = partial(open_drive, f"{make}:{emulator.port}", plan.problem.limits, None, 0.5)
        closed = FollowOptions(decision_time=0.3) if follow else None
        return run_plan(plan, connect, motion=motion, source=source, follow=closed, options=QUICK)


def row(path: Path, motor: str) -> dict[str, Any]:
    """Return what became of a plan in each way."""
    plan = read_plan(path)
    assert isinstance(plan, CastPlan)
    runs: list[CastRun] = []

    def tried(motion: Motion | None = None, follow: bool = False) -> bool:
        try:
            runs.append(carry_out(plan, motor, motion, follow))
        except DriveError as error:  # before the cast
            sys.stderr.write(f"{error}\n")
            return False
        return runs[-1].success

    nominal, closed = tried(), tried(follow=True)
    decided = runs[-1].follow if runs else None

    def once(motion: Motion) -> Any:
        runs.append(carry_out(plan, motor, motion))
        return runs[-1].cast_log()

    learned = learn_cast(plan, once, attempts=3, options=LearningOptions(wins=3))
    last = tried(learned.motion)
    cycles = sum(len(each.log.rows) for each in runs)
    return {
        "plan": path.stem,
        "nominal": nominal,
        "closed": closed,
        "decisions": [] if decided is None else [each.action for each in decided.decisions],
        "learned": last,
        "turns": [each.turns for each in runs],
        "stopped": [each.stopped for each in runs],
        "cycles": cycles,
        "missed": sum(each.log.missed for each in runs),
        "late": sum(each.late for each in runs),
    }


def main() -> None:
    """Carry out, and print a line for each plan."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plans", type=Path, nargs="+")
    parser.add_argument("--motor", default="emulator:moteus")
    parser.add_argument("--out", type=Path, help="JSON lines")
    options = parser.parse_args()
    rows = []
    for path in options.plans:
        begin = time.monotonic()
        rows.append({**row(path, options.motor), "seconds": time.monotonic() - begin})
        line = json.dumps(rows[-1])
        print(line, flush=True)
        if options.out is not None:
            with options.out.open("a") as file:
                file.write(line + "\n")
    won = {way: sum(each[way] for each in rows) for way in ("nominal", "closed", "learned")}
    missed, cycles = (sum(each[name] for each in rows) for name in ("missed", "cycles"))
    sys.stdout.write(f"{len(rows)} plans on {options.motor}: {won}; {missed} of {cycles} cycles missed\n")
    sys.stdout.write(f"python {platform.python_version()}, hyperflex {hf.__version__}\n")


if __name__ == "__main__":
    main()
