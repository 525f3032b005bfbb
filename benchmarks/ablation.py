"""What each option of the search of a cast gives: the same targets with one option switched off at a time.

python -m benchmarks.ablation --seed 1 --ropes 10           ropes and targets of benchmarks.random_ropes
python -m benchmarks.ablation --seed 1 --ropes 4 --only as-is,no-variation

``cem`` is a baseline without any of them: the cross-entropy method over five parameters of a swing.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.random_ropes import rope_and_arm, targets

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.planning.ensemble import verify_members
from hyperflex.planning.feasibility import search_time
from hyperflex.planning.moves import Moves
from hyperflex.planning.planner import Candidate
from hyperflex.planning.rollouts import RolloutBatch, winding_scores
from hyperflex.planning.tasks.wind import viscous

VARIANTS: dict[str, dict[str, Any]] = {
    "as-is": {},
    "no-variation": {"members": 0},
    "no-predictability": {"deviations": (math.inf, math.inf)},
    "full-speed": {"speeds": (1.0,)},
    "narrow-beam": {"width": 3},
    "one-finish": {"finishes": 1},
    "coarse-contact": {"coarse": math.inf},
    "halves": {"pieces": 2},
}


def cem(rope: hf.Rope, arm: hf.Arm, peg: hf.Peg, budget: Budget) -> bool:
    """Plan by the cross-entropy method over stroke, step, number of strokes, end and rest of the last move."""
    rng, problem = np.random.default_rng(0), hf.Problem(rope, arm)
    problem = hf.Problem(rope, arm, time=search_time(problem, peg))
    model, towards = viscous(problem)[0], math.copysign(1.0, peg.x)
    mean, std = np.array([2.8, 0.54, 5.0, 0.0, 0.3]), np.array([0.3, 0.06, 2.0, 1.0, 0.3])
    while not budget.expired:
        x = mean + std * rng.standard_normal((32, 5))
        moves = []
        for k, (stroke, step, count, end, rest) in enumerate(x):
            side, count = (-1, 1)[k % 2], max(1, round(count))
            ends = 0.5 * side * math.pi - side * stroke * (np.arange(count) % 2 == 0)
            rests = np.full(count, max(0.0, step * problem.period - problem.limits.fastest_moves([stroke])[0][0]))
            moves.append(Moves(side, np.append(ends, towards * end), np.append(rests, abs(rest) * problem.period)))
        motions = [each.motion(problem.limits) for each in moves]
        batch = RolloutBatch.from_start(model, [model.rope] * 32, [peg] * 32, motions)
        found = winding_scores(model, batch, budget)
        best = np.argsort(-found.score)[:8]
        mean, std = 0.3 * mean + 0.7 * x[best].mean(axis=0), 0.3 * std + 0.7 * x[best].std(axis=0)
        for k in best[found.turns[best] >= problem.criteria.turns][:1]:
            one = Candidate(moves[k], float(found.score[k]), 0.0, True)
            if not verify_members(problem, [model.cut(3)], peg, one, budget).message:
                return True
    return False


def main() -> None:
    """Plan with each variant and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ropes", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=40.0, help="of processor time for each plan")
    parser.add_argument("--only", default=",".join([*VARIANTS, "cem"]), help="variants, separated by commas")
    parser.add_argument("--out", type=Path, help="JSON lines")
    options = parser.parse_args()
    names, seconds = options.only.split(","), dict[str, list[float]]()
    for number in range(options.ropes):
        rope, arm = rope_and_arm(options.seed, number)
        for peg in targets(options.seed, number, rope, arm, 1):
            for name in names:
                budget = Budget(options.seconds, threads=1, clock=time.process_time)
                if name == "cem":
                    success = cem(rope, arm, peg, budget)
                else:
                    search = hf.SearchOptions(threads=1, **VARIANTS[name])
                    success = hf.plan_cast(rope, arm, peg, time_budget=budget, options=search).success
                seconds.setdefault(name, []).append(budget.elapsed if success else math.inf)
                line = json.dumps({"rope": number, "variant": name, "success": success, "seconds": budget.elapsed})
                sys.stdout.write(line + "\n")
                sys.stdout.flush()
                if options.out is not None:
                    with options.out.open("a") as file:
                        file.write(line + "\n")
    sys.stdout.write("| variant | planned | median, s of processor time |\n|---|---|---|\n")
    for name, spent in seconds.items():
        planned, median = int(np.isfinite(spent).sum()), float(np.median(spent))
        sys.stdout.write(f"| {name} | {planned} of {len(spent)} | {median:.1f} |\n")


if __name__ == "__main__":
    main()
