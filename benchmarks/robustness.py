"""Random ropes of every kind: does each run keep its tolerance, or end in an error that names the reason?

python -m benchmarks.robustness                      2,000 ropes, an hour or two; results in benchmarks/results/
python -m benchmarks.robustness --count 100 --out -  a look; nothing is written
python -m benchmarks.robustness --only-index 42      one of them again, in words

What is drawn stands in tests/reference/random_ropes.py, what is promised, and how it is measured, in judging.py there.
The exit code is 1 if a run was silently wrong, or errors were more than allowed.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine
from rich.console import Console
from rich.progress import Progress

from hyperflex import files
from hyperflex.errors import SimulationError
from tests.reference.judging import USUAL, Verdict, drift, judge
from tests.reference.random_ropes import Case, draw, draw_stuck

RESULTS = Path(__file__).parent / "results"
PATIENCE = 120  # s of wall time for a run and its tighter ones
ALLOWED_FAILURES = 0.01
ALLOWED_DRIFT = 1e-6  # rad in 10 s, of a joint whose dry friction bears more than it must
STICKING = 10  # one rope that should stick for so many others
SLOWEST = 8
ORDINARY = "at most 100 links, eta / (m l^2) within two decades of the paper's"
PROMISE = """\
A run has **met** its tolerance if, inside the horizon, it stays within `3 tol (1 + t / 20 ms) growth` of a run with
a hundredth of that tolerance; `growth` is that of two nudged runs, one in the angles and one in the rates. It is
**wrong** if it does not and does not say so. **Unchecked**: it ended well, a tighter one did not. **Failed**: it ended
in an error."""


class OutOfPatience(Exception):
    """A case takes longer than PATIENCE."""


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="number of ropes (2000)")
    parser.add_argument("--seed", type=int, default=1, help="of all draws (1)")
    parser.add_argument("--only-index", type=int, metavar="INDEX", help="run this rope alone and show all about it")
    parser.add_argument("--out", default=str(RESULTS), metavar="FOLDER", help="for JSON and Markdown; - writes nothing")
    return parser.parse_args()


def main() -> int:
    options = parse()
    signal.signal(signal.SIGALRM, _out_of_patience)
    if options.only_index is not None:
        sys.stdout.write(json.dumps(plain(examine(draw(options.seed, options.only_index))), indent=1) + "\n")
        return 0
    about, rows = machine.describe(), []
    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("ropes", total=options.count)
        for number in range(options.count):
            rows.append(examine(draw(options.seed, number)))
            bar.update(task, advance=1, description=summary(rows))
    stuck = [stay(draw_stuck(options.seed, number)) for number in range(options.count // STICKING)]
    about["load after"] = machine.load()
    page = f"# Random ropes\n\n{text(rows, options.seed)}\n{sticking(stuck)}\n\n{machine.sentence(about)}\n"
    print(page)
    if options.out != "-":
        folder = Path(options.out)
        folder.mkdir(parents=True, exist_ok=True)
        data = {"machine": about, "seed": options.seed, "rows": [plain(row) for row in rows], "stuck": stuck}
        files.write_text(folder / "robustness.json", json.dumps(data, indent=None) + "\n")
        files.write_text(folder / "robustness.md", page)
    return int(not (passed(rows) and all(row["outcome"] == "met" for row in stuck)))


def stay(case: Case) -> dict[str, Any]:
    """Whether a rope that should stick does."""
    try:
        turned = drift(case.setup)
    except SimulationError as error:
        return {"number": case.number, "links": case.kind["links"], "outcome": "failed", "reason": error.status}
    outcome = "met" if turned <= ALLOWED_DRIFT else "wrong"
    return {"number": case.number, "links": case.kind["links"], "outcome": outcome, "drift": turned}


def sticking(rows: list[dict[str, Any]]) -> str:
    """What became of the ropes that should stick, in a sentence."""
    if not rows:
        return ""
    most = max((row["drift"] for row in rows if "drift" in row), default=math.nan)
    return (
        f"{len(rows)} more ropes, bent and at rest, whose dry friction bears what their weight asks: {summary(rows)} "
        f"(drift of at most {ALLOWED_DRIFT:g} rad in 10 s); the greatest drift is {most:.2g} rad."
    )


def _out_of_patience(*_: Any) -> None:
    raise OutOfPatience


def examine(case: Case) -> dict[str, Any]:
    """Judge one case within PATIENCE."""
    signal.alarm(PATIENCE)
    try:
        verdict = judge(case.setup, case.number)
    except OutOfPatience:
        none = float("nan")
        verdict = Verdict("failed", f"slower than {PATIENCE} s", *[none] * 5, False, none, float(PATIENCE))
    finally:
        signal.alarm(0)
    return {"number": case.number, "ordinary": case.ordinary, **case.kind, **verdict._asdict()}


def plain(row: dict[str, Any]) -> dict[str, Any]:
    """Numbers that JSON knows, four digits of each."""
    return {name: _short(value) for name, value in row.items()}


def _short(value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return float(f"{value:.4g}") if math.isfinite(value) else None


def summary(rows: list[dict[str, Any]]) -> str:
    return ", ".join(f"{count} {outcome}" for outcome, count in Counter(row["outcome"] for row in rows).most_common())


def passed(rows: list[dict[str, Any]]) -> bool:
    """Nothing silently wrong; few errors, and none of an ordinary rope."""
    outcomes = Counter(row["outcome"] for row in rows)
    ordinary = any(row["ordinary"] and row["outcome"] == "failed" for row in rows)
    return outcomes["wrong"] == 0 and not ordinary and outcomes["failed"] <= ALLOWED_FAILURES * len(rows)


def text(rows: list[dict[str, Any]], seed: int) -> str:
    """Results as Markdown."""
    good = [row for row in rows if row["outcome"] in ("met", "wrong")]
    ordinary = [row for row in rows if row["ordinary"]]
    factor, promise = (np.array([row[name] for row in good]) for name in ("factor", "promise"))
    reached = np.array([row["horizon"] / row["duration"] for row in good])
    shares = f"{np.mean(factor <= USUAL):.1%} stay below {USUAL:g} tol growth."
    checked = f"{sum(row['checked'] for row in good)} were checked against Runge and Kutta's method as well."
    lines = [
        f"{len(rows)} ropes, seed {seed}: {summary(rows)}.",
        f"Of these {len(ordinary)} are ordinary ({ORDINARY}): {summary(ordinary)}.",
        "",
        PROMISE,
        "",
        "| | median | 90 % | 99 % | greatest |",
        "|---|---|---|---|---|",
        quantiles("error / what is promised", promise),
        quantiles("error / (tol growth)", factor),
        quantiles("horizon / duration", reached),
        quantiles("wall time of a run, ms", 1e3 * np.array([row["seconds"] for row in rows])),
        "",
        f"{shares} {checked}",
        "",
        *listing("Wrong", [row for row in rows if row["outcome"] == "wrong"]),
        *listing("Failed", [row for row in rows if row["outcome"] == "failed"]),
        *listing("Unchecked", [row for row in rows if row["outcome"] == "unchecked"]),
        *listing("Slowest", sorted(rows, key=lambda row: -row["seconds"])[:SLOWEST]),
    ]
    return "\n".join(lines)


def quantiles(name: str, values: Any) -> str:
    cells = np.quantile(values, [0.5, 0.9, 0.99, 1.0]) if values.size else [math.nan] * 4
    return f"| {name} | " + " | ".join(f"{value:.2g}" for value in cells) + " |"


def listing(title: str, rows: list[dict[str, Any]]) -> list[str]:
    """A table of single cases; nothing if there are none."""
    names = ("number", "reason", "promise", "factor", "seconds", "links", "tol", "eta", "stiffness", "dry", "drive")
    if not rows:
        return []
    head = [f"## {title}", "", "| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    return [*head, *("| " + " | ".join(_cell(row[name]) for name in names) + " |" for row in rows), ""]


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main())
