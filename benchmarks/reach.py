"""Accuracy of the reachability check: random targets in reach and out of reach, each searched for a throw.

python -m benchmarks.reach                       the paper's cable, 16 targets of each kind out of reach; 1.5 hours
python -m benchmarks.reach --rope weighted       with 20 g at the tip
python -m benchmarks.reach --count 4 --out -     short; writes nothing

Targets are those of ``benchmarks.casting`` from number 300 on, which that benchmark does not use. They are sorted by
the result of the check, and casts are planned for the first ones of each kind; a target is windable if a plan succeeds
(wound and held, also with shorter links). The share of each kind is counted on 10,000 targets, which gives the share of
windable targets that are called out of reach. A search's time is processor time on one thread, so that other programs
do not matter. Rows are kept in reach.jsonl: the same command continues an interrupted run. All simulated.
"""

import argparse
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log as lines
from benchmarks import machine
from benchmarks.casting import RESULTS, TIP, problem, target

from hyperflex import files
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.planning import Feasibility, SearchOptions, check_feasibility, plan_cast
from hyperflex.planning.feasibility import SWING as MODEL

FIRST, COUNTED = 300, 10_000
TIME_BUDGET, COUNT = 110.0, 16  # s, targets of a kind
DRAWS = 10_000  # of the interval of the share called out of reach
IN, ROPE, SWING, HIGH, NEVER = (
    "in reach",
    "too little rope",
    "too little energy",
    "higher than it swings",
    "impossible",
)
KINDS = (ROPE, SWING, IN, HIGH)  # that are searched


def kind(told: Feasibility) -> str:
    """The result of the check in one word; of two reasons the stronger one."""
    if told.impossible:
        return NEVER
    if told.feasible:
        return IN
    if told.energy_ratio < 0.0:
        return HIGH
    return SWING if told.energy_ratio < MODEL.energy_ratio else ROPE


def main() -> None:
    """Plan, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rope", choices=sorted(TIP), default="nominal")
    parser.add_argument("--count", type=int, default=COUNT, help=f"targets of each kind ({COUNT})")
    parser.add_argument(
        "--time-budget", type=float, default=TIME_BUDGET, help=f"s of searching a target ({TIME_BUDGET:g})"
    )
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    options = parser.parse_args()
    time.monotonic = time.process_time  # a search's clock
    about, log = machine.describe(), None if options.out == "-" else Path(options.out) / "reach.jsonl"
    kinds = {
        number: kind(check_feasibility(problem(options.rope), target(number)))
        for number in range(FIRST, FIRST + COUNTED)
    }
    known = read(log, options.rope, options.time_budget)
    lines.warn_of_others(known.values(), planned=True)
    asked = wanted(kinds, options.count)
    for number in asked:
        if number not in known:
            known[number] = planned(options.rope, number, options.time_budget)
            print(kinds[number], known[number], flush=True)
            if log is not None:
                lines.append(log, known[number])
    rows = {number: known[number] for number in asked}
    by = f"{machine.sentence(about)} {lines.made(rows.values(), 'planner')}"
    page = f"# Reach: {options.rope}\n\n{text(kinds, rows, options)}\n{by}\n"
    print(page)
    if log is not None:
        files.write_text(log.with_name(f"reach-{options.rope}.md"), page)


def wanted(kinds: dict[int, str], count: int) -> list[int]:
    """The first numbers of each kind, by turns."""
    each = [[number for number, told in kinds.items() if told == one][: _many(one, count)] for one in KINDS]
    return [numbers[k] for k in range(count) for numbers in each if k < len(numbers)]


def _many(one: str, count: int) -> int:
    """Targets of a kind; fewer if the answer is nearly certain, or known from the benchmark."""
    return math.ceil(count / {IN: 2}.get(one, 1))


def read(log: Path | None, rope: str, time_budget: float) -> dict[int, dict[str, Any]]:
    """Rows of the same search by number."""
    same = (rope, time_budget)
    return {row["number"]: row for row in lines.read(log) if (row["rope"], row["time_budget"]) == same}


def planned(rope: str, number: int, time_budget: float) -> dict[str, Any]:
    """A row: the result of a search for a target."""
    who = problem(rope)
    plan = plan_cast(
        who.rope,
        who.arm,
        target(number),
        time_budget=time_budget,
        options=SearchOptions(skip_feasibility=True, seed=number, threads=1),
    )
    return {
        "kernels": SOURCE_HASH,
        "planner": lines.planner(),
        "rope": rope,
        "number": number,
        "time_budget": time_budget,
        "success": plan.success,
        "wound": plan.outcome is not None and plan.outcome.wound,
        "turns": 0.0 if plan.outcome is None else round(plan.outcome.turns, 3),
        "seconds": round(plan.seconds, 1),
        "reason": plan.message,
    }


def text(kinds: dict[int, str], rows: dict[int, dict[str, Any]], options: argparse.Namespace) -> str:
    """Results as Markdown."""
    shares = {one: sum(told == one for told in kinds.values()) / len(kinds) for one in (*KINDS, NEVER)}
    lines = ["| called | of all targets | searched | windable | wound, at least once |", "|---|---|---|---|---|"]
    counts = {}
    for one in KINDS:
        found = [row for number, row in rows.items() if kinds[number] == one]
        counts[one] = (sum(row["success"] for row in found), len(found))
        wound = sum(row["wound"] for row in found)
        lines.append(f"| {one} | {shares[one]:.1%} | {len(found)} | {counts[one][0]} | {wound} |")
    lines.append(f"| {NEVER} | {shares[NEVER]:.1%} | 0 | | |")
    part, low, high = missed(shares, counts)
    lines += ["", f"{part:.1%} of the targets that a search winds are called out of reach"]
    lines[-1] += f" (95 % interval {low:.1%} to {high:.1%}); the goal is at most 10 %."
    lines += [
        f"A search takes at most {options.time_budget:g} s on one processor; those of benchmarks.casting 60 s on two.",
        "",
    ]
    lines += ["| number | called | room | needed | energy | success | turns | s | why not |", "|" + "---|" * 9]
    for number, row in sorted(rows.items(), key=lambda pair: (KINDS.index(kinds[pair[0]]), pair[0])):
        told = check_feasibility(problem(options.rope), target(number))
        cells = [
            number,
            kinds[number],
            f"{told.available_turns:.2f}",
            f"{told.needed_turns:.2f}",
            f"{told.energy_ratio:.2f}",
        ]
        cells += [row["success"], row["turns"], f"{row['seconds']:.0f}", row["reason"]]
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def missed(shares: dict[str, float], counts: dict[str, tuple[int, int]]) -> tuple[float, float, float]:
    """Share of the windable targets that are called out of reach, and a 95 % interval (Jeffreys, kind by kind)."""
    random = np.random.default_rng(0)
    drawn = {k: shares[k] * random.beta(won + 0.5, of - won + 0.5, DRAWS) for k, (won, of) in counts.items()}
    part = 1.0 - drawn[IN] / sum(drawn.values())
    expected = {k: shares[k] * won / max(of, 1) for k, (won, of) in counts.items()}
    found = sum(expected.values())
    return 1.0 - expected[IN] / found if found else np.nan, *(float(v) for v in np.quantile(part, (0.025, 0.975)))


if __name__ == "__main__":
    main()
