"""Ablation of the cast planner's search options: the same targets with one option changed at a time.

python -m benchmarks.ablation --seed 613              three targets of each rope of benchmarks.casting; hours
python -m benchmarks.ablation --seed 613 --targets 1 --only as-is,no-variation --out -    short; writes nothing
python -m benchmarks.ablation --seed 31 --random 2,3    three targets of each of two ropes of benchmarks.random_ropes

Random ropes are hard: the variants are tried only on targets that the unchanged planner plans. Each search ends with
the first plan that succeeds, or after 40 s of processor time. Targets are within reach, with a seed on which no option
was tuned. ``cem`` is a baseline without any of the options: the cross-entropy method over five parameters of a swing.
Rows are kept in ablation.jsonl: the same command continues an interrupted run. All simulated.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import casting, machine, random_ropes
from benchmarks import log as lines

import hyperflex as hf
from hyperflex import files
from hyperflex.budget import Budget
from hyperflex.planning.ensemble import verify_members
from hyperflex.planning.feasibility import search_time
from hyperflex.planning.moves import Moves
from hyperflex.planning.planner import Candidate
from hyperflex.planning.rollouts import MODEL, RolloutBatch, winding_scores

RESULTS = Path(__file__).parent / "results"
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "as-is": ("all options as they are", {}),
    "no-variation": ("no variations of the best moves", {"members": 0}),
    "no-predictability": ("unpredictable swings are continued as well", {"deviations": (math.inf, math.inf)}),
    "full-speed": ("strokes at the motor's full speed alone", {"speeds": (1.0,)}),
    "narrow-beam": ("3 swings from each side are continued, not 12", {"width": 3}),
    "many-siblings": ("all swings that are continued may differ in the last stroke alone", {"siblings": 12}),
    "two-rests": ("2 rests are tried after a stroke, not 5", {"rests": 2}),
    "one-finish": ("last moves are tried one at a time, not 3 at once", {"finishes": 1}),
    "coarse-contact": ("links near the target are not cut in rollouts", {"coarse": math.inf}),
    "halves": ("halves of links in verifications, not thirds", {"pieces": 2}),
    "restart-anywhere": ("a new pass may begin at any stroke", {"back": 100}),
    "no-priority": ("near misses in turns wait for their turn", {"nearly": 100.0}),
    "small-batch": ("2 swings at once are tried in contact, not 8", {"batch": 2}),
}
VARIANTS["plain"] = (
    "no variations, one speed, no limit of siblings, one last move at a time, coarse links, no priority",
    {
        name: value
        for each in ("no-variation", "full-speed", "many-siblings", "one-finish", "coarse-contact", "no-priority")
        for name, value in VARIANTS[each][1].items()
    },
)
VARIANTS["lean"] = (
    "one speed, no limit of siblings, one last move at a time, no priority",
    {
        name: value
        for each in ("full-speed", "many-siblings", "one-finish", "no-priority")
        for name, value in VARIANTS[each][1].items()
    },
)
GONE = "an option that was removed, as it gave nothing"
CEM = "the cross-entropy method over five parameters of a swing, in place of the search"


def cem(rope: hf.Rope, arm: hf.Arm, peg: hf.Peg, budget: Budget) -> bool:
    """Plan by the cross-entropy method over stroke, step, number of strokes, end and rest of the last move."""
    rng, problem = np.random.default_rng(0), hf.Problem(rope, arm)
    problem = hf.Problem(rope, arm, time=search_time(problem, peg))
    towards = math.copysign(1.0, peg.x)
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
        batch = RolloutBatch.from_start(problem, [problem.rope] * 32, [peg] * 32, motions, MODEL.stiction)
        found = winding_scores(problem, batch, budget)
        best = np.argsort(-found.score)[:8]
        mean, std = 0.3 * mean + 0.7 * x[best].mean(axis=0), 0.3 * std + 0.7 * x[best].std(axis=0)
        for k in best[found.turns[best] >= problem.criteria.turns][:1]:
            one = Candidate(moves[k], float(found.score[k]), 0.0, True)
            if not verify_members(problem, [problem.cut(3)], peg, one, budget).message:
                return True
    return False


def targets(options: argparse.Namespace) -> Iterator[tuple[str, int, hf.Rope, hf.Arm, hf.Peg]]:
    """Return the targets in reach with their ropes' names and their numbers, the first target of each rope first."""
    seed, drawn = options.seed, list[list[tuple[str, int, hf.Rope, hf.Arm, hf.Peg]]]()
    for number in map(int, options.random.split(",") if options.random else ()):
        rope, arm = random_ropes.rope_and_arm(seed, number)
        pegs = random_ropes.targets(seed, number, rope, arm, options.targets)
        drawn.append([(f"random {number}", k, rope, arm, peg) for k, peg in enumerate(pegs)])
    for name in () if options.random else casting.ROPES:
        known, numbers = casting.problem(name), casting.targets(name, options.targets, seed=seed)
        drawn.append([(name, k, known.rope, known.arm, casting.target(k, name, seed)) for k in numbers])
    for some in zip_longest(*drawn):
        yield from filter(None, some)


def tried(rope: hf.Rope, arm: hf.Arm, peg: hf.Peg, name: str, seconds: float) -> dict[str, Any]:
    """Plan for a target with a variant, until a plan succeeds."""
    budget = Budget(seconds, threads=1, clock=time.process_time)
    if name == "cem":
        success = cem(rope, arm, peg, budget)
    else:
        search = hf.SearchOptions(threads=1, **VARIANTS[name][1])
        plan = hf.plan_cast(rope, arm, peg, time_budget=budget, options=search, on_plan=lambda _: True)
        success = plan.success
    return {"success": success, "seconds": budget.elapsed, "planner": lines.planner()}


def page(rows: list[dict[str, Any]], about: dict[str, str]) -> str:
    """Return a table for each set of targets as Markdown."""
    text = (
        "# Ablation of the cast planner's search options\n\nEach search ends with the first plan that succeeds within "
        "the limit of processor time, on one thread. Gained: targets that only the variant plans. Lost: targets that "
        "only the planner without the variant plans. Ratio: median, over targets planned by both, of the time with the "
        "variant over the time without it.\n"
    )
    sets = dict[tuple[Any, ...], list[dict[str, Any]]]()
    for row in rows:
        sets.setdefault((row["rope"].startswith("random"), row["seed"], row["limit"]), []).append(row)
    for (random, seed, limit), some in sets.items():
        ropes = "random ropes, variants on targets that as-is plans" if random else "the five ropes"
        text += f"\n## Seed {seed}, {ropes}, {limit:g} s\n\n{table(some)}\n{lines.made(some, 'planner')}\n"
    return f"{text}\n{machine.sentence(about)}\n\nReproduce: `python -m benchmarks.ablation`\n"


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of all variants on a set of targets."""
    text = (
        "| variant | what is changed | planned | gained | lost | median, s | ratio |\n|---|---|---|---|---|---|---|\n"
    )
    spent = dict[str, dict[Any, float]]()
    for row in rows:
        found = row["seconds"] if row["success"] else math.inf
        spent.setdefault(row["variant"], {})[row["rope"], row["target"]] = found
    usual = spent.get("as-is", {})
    for name, times in spent.items():
        both = [(times[one], usual[one]) for one in times if one in usual]
        ratios = [one / other for one, other in both if math.isfinite(one) and math.isfinite(other)]
        gained = sum(math.isfinite(one) and not math.isfinite(other) for one, other in both)
        lost = sum(math.isfinite(other) and not math.isfinite(one) for one, other in both)
        planned = sum(map(math.isfinite, times.values()))
        ratio = f"{np.median(ratios):.2f}" if ratios else ""
        what = CEM if name == "cem" else VARIANTS.get(name, (GONE, {}))[0]
        median = float(np.median(list(times.values())))
        cells = [name, what, f"{planned} of {len(times)}", gained, lost, f"{median:.1f}", ratio]
        text += "| " + " | ".join(map(str, cells)) + " |\n"
    return text


def main() -> None:
    """Plan with each variant, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=613, help="of the targets (613)")
    parser.add_argument("--targets", type=int, default=3, help="of each rope (3)")
    parser.add_argument("--random", default="", help="numbers of ropes drawn at random, in place of the five")
    parser.add_argument("--seconds", type=float, default=40.0, help="of processor time for each plan (40)")
    parser.add_argument("--only", default=",".join([*VARIANTS, "cem"]), help="variants, separated by commas")
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    options = parser.parse_args()
    about, log = machine.describe(), None if options.out == "-" else Path(options.out) / "ablation.jsonl"
    known = lines.read(log)
    lines.warn_of_others(known, planned=True)
    for rope, number, *about_it in targets(options):
        for name in options.only.split(","):
            marks = {"rope": rope, "target": number, "seed": options.seed, "limit": options.seconds, "variant": name}
            row = next((one for one in known if marks.items() <= one.items()), None)
            if row is None:
                row = marks | tried(*about_it, name, options.seconds)
                print(json.dumps(row), flush=True)
                known.append(row)
                if log is not None:
                    lines.append(log, row)
            if options.random and name == "as-is" and not row["success"]:
                break
    text = page(known, about)
    print(text)
    if log is not None:
        files.write_text(log.with_name("ablation.md"), text)


if __name__ == "__main__":
    main()
