"""Casts to extreme targets: a plan or a clear reason, in time, on a busy machine.

python -m benchmarks.hard_targets                each case with a time budget of 0.5 s and of 20 s; ten minutes
python -m benchmarks.hard_targets --budgets 0.5 --busy 0 --out -    short; writes nothing

Targets inside the arm's circle, behind a wall, on the floor, at the shaft, out of reach, of radius 2 mm and 300 mm;
ropes of 1 to 400 links, and one whose centres of mass are not in the middle. The page reports by how much a call
exceeds its budget while `--busy` other processes run, and its result. A call that is refused or out of reach makes no
search and can hardly be late, so calls that search are counted separately. Each case is called once before timing, to
compile kernels; an internal error ends the benchmark. All simulated.
"""

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import HyperflexError
from hyperflex.paper import casting_arm
from hyperflex.planning import plan_cast

RESULTS = Path(__file__).parent / "results"
ALLOWED = 1.0  # s beyond the budget
PEG = hf.Peg(0.6, -1.1, 0.03, 0.3)
INSIDE = hf.Peg(0.1, -0.12, 0.02, 0.3)  # of the circle of an arm of 0.3 m


def cable(links: int = 50, **more: Any) -> hf.Rope:
    """Return a cable as long and heavy as the paper's, in so many links, with the same friction per length."""
    return hf.Rope.uniform(2.0, 0.125, links, 0.0025, friction=5e-4 * links / 50.0, **more)


def cases() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of each case and its arguments of ``plan_cast``."""
    usual = {"rope": cable(), "arm": casting_arm(), "target": PEG}
    yield "inside the arm's circle", usual | {"arm": hf.Arm(length=0.3), "target": INSIDE}
    yield "at the shaft", usual | {"target": hf.Peg(0.0, 0.0, 0.02, 0.3)}
    yield "out of reach", usual | {"target": hf.Peg(3.0, 0.0, 0.03, 0.3)}
    yield "behind a wall", usual | {"obstacles": [hf.Wall(0.45, -1.6, 0.45, -0.9)]}
    yield "behind a wall that hides it", usual | {"obstacles": [hf.Wall(0.45, -2.5, 0.45, 0.3)]}
    yield "on a floor in which the rope begins", usual | {"obstacles": [hf.Ground(0.0, PEG.y - PEG.radius)]}
    low = usual | {"obstacles": [hf.Ground(0.0, -2.01)]}
    yield "on a floor below the rope", low | {"target": hf.Peg(0.3, -1.98, 0.03, 0.3)}
    yield "on a block on that floor", low | {"target": hf.Peg(0.5, -1.5, 0.03, 0.3)}
    yield "radius 2 mm", usual | {"target": hf.Peg(0.6, -1.1, 0.002, 0.3)}
    yield "radius 300 mm", usual | {"target": hf.Peg(0.6, -1.1, 0.3, 0.3)}
    for links in (1, 2, 3, 10, 100, 200, 400):
        yield f"{links} link{'s' * (links > 1)}", usual | {"rope": cable(links)}
    for part in (0.25, 0.75):
        length = np.full(50, 0.04)
        yield f"centres of mass at {part:g} of the links", usual | {"rope": cable(com=part * length)}


def called(arguments: dict[str, Any], budget: float) -> dict[str, Any]:
    """Plan once; return the result, and by how much the call exceeded its budget, s."""
    begin, planned, runs = time.perf_counter(), False, 0
    try:
        plan = plan_cast(**arguments, time_budget=budget, options=hf.SearchOptions(seed=1))
        planned, runs, told = plan.success, plan.runs, "wound and held" if plan.success else plan.message
    except HyperflexError as error:
        told = str(error)
    over = time.perf_counter() - begin - budget
    return {"budget": budget, "over": over, "planned": planned, "searched": runs > 0, "told": told}


def spin() -> None:
    """Keep a processor busy."""
    while True:
        sum(range(10**6))


def main() -> None:
    """Call each case, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--budgets", type=float, nargs="+", default=[0.5, 20.0], help="s (0.5 and 20)")
    parser.add_argument(
        "--busy", type=int, default=os.cpu_count(), help="other busy processes (one for each processor)"
    )
    parser.add_argument("--out", default=str(RESULTS / "hard-targets.json"), help="- writes nothing")
    options = parser.parse_args()
    about = machine.describe()
    for _, arguments in cases():
        called(arguments, 2.0)
    others = [multiprocessing.Process(target=spin, daemon=True) for _ in range(options.busy)]
    for one in others:
        one.start()
    try:
        rows = []
        for name, arguments in cases():
            for budget in options.budgets:
                rows.append({"case": name, **called(arguments, budget)})
                print(line(rows[-1]), flush=True)
    finally:
        for one in others:
            one.terminate()
    text = page(rows, options.busy) + f"\n{machine.sentence(about)}\n"
    print(text)
    if options.out != "-":
        path = Path(options.out)
        files.write_text(path, json.dumps({"machine": about, "busy": options.busy, "rows": rows}, indent=1) + "\n")
        files.write_text(path.with_suffix(".md"), text)


def line(row: dict[str, Any]) -> str:
    """Return a row of the table."""
    return f"| {row['case']} | {row['budget']:g} | {row['over']:+.2f} | {row['told']} |"


def page(rows: list[dict[str, Any]], busy: int) -> str:
    """Return the results as Markdown."""
    late, silent = sum(row["over"] > ALLOWED for row in rows), sum(not row["told"] for row in rows)
    most = max(row["over"] for row in rows)
    how = f"the latest ends {most:.2f} s after it" if most > 0.0 else "none is late"
    told = (
        f"{len(rows)} calls, {sum(row['searched'] for row in rows)} of which search, while {busy} other processes keep "
        f"the processors busy. {late} calls exceed their budget by more than {ALLOWED:g} s (goal 0; {how}), {silent} "
        f"give neither a plan nor a reason (goal 0), and {sum(row['planned'] for row in rows)} give a plan."
    )
    head = ("# Casts to extreme targets", "", told, "", "| case | budget, s | excess, s | outcome |")
    again = "Reproduce: `python -m benchmarks.hard_targets`"
    return "\n".join([*head, "|---|---|---|---|", *map(line, rows), "", again, ""])


if __name__ == "__main__":
    main()
