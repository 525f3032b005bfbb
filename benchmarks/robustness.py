"""Random ropes of every kind: does each run keep its tolerance, or end in an error that names the reason?

python -m benchmarks.robustness --workers 2          2,000 ropes, an hour or two; results in benchmarks/results/
python -m benchmarks.robustness --time-budget 900       repeats ropes that were too slow for a smaller budget
python -m benchmarks.robustness --count 100 --out -  short; writes nothing
python -m benchmarks.robustness --only-index 42      one of them again, in detail

tests/reference/random_ropes.py defines the draws, tests/reference/judging.py the bound and its measurement. Each row is
kept in robustness.jsonl at once: the same command continues an interrupted run. The exit code is 1 if a run was wrong
without a warning, or there were more errors than allowed.
"""

import argparse
import json
import math
import multiprocessing
import signal
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log as lines
from benchmarks import machine
from rich.console import Console
from rich.progress import Progress

import hyperflex as hf
from hyperflex import files
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.errors import SimulationError
from tests.reference.event_times import LOCATED
from tests.reference.judging import USUAL, OutOfPatience, drift, judge
from tests.reference.random_ropes import Case, draw, draw_stuck

RESULTS = Path(__file__).parent / "results"
TIME_BUDGET = 120.0  # s of processor time for a run and its tighter ones by default
ALLOWED_FAILURES, MOST = 0.01, 0.99  # shares of all ropes: errors, and errors within USUAL tol growth
ALLOWED_DRIFT = 1e-6  # rad in 10 s, of a joint whose dry friction exceeds its load
STICKING = 10  # other ropes for each rope that should stick
SLOWEST = 8
SLOW = OutOfPatience.status
TrackingTask = tuple[str, int, int, float]  # "rope" or "stuck", seed, number, time_budget
ORDINARY = "at most 100 links, eta / (m l^2) within two decades of the paper's"
ACCURACY = """\
A run is **accurate** if, within the horizon, it stays within `3 tol (1 + t / 20 ms) growth` of a run with a hundredth
of its tolerance; `growth` is that of two perturbed runs, one in the angles and one in the rates. It is **wrong** if it
does not and gives no warning. **Unchecked**: the run succeeded, but one with a tighter tolerance did not, or not in
time. **Failed**: it ended with an error, or took too long."""


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="number of ropes (2000)")
    parser.add_argument("--first", type=int, default=0, help="number of the first one (0)")
    parser.add_argument("--workers", type=int, default=1, help="processes (1)")
    parser.add_argument("--seed", type=int, default=1, help="of all draws (1)")
    parser.add_argument("--time-budget", type=float, default=TIME_BUDGET, help="s of processor time for a rope (120)")
    parser.add_argument("--only-index", type=int, metavar="INDEX", help="run this rope only and show its details")
    parser.add_argument("--out", default=str(RESULTS), metavar="FOLDER", help="for JSON and Markdown; - writes nothing")
    return parser.parse_args()


def main() -> int:
    options = parse()
    if options.only_index is not None:
        be_ready()
        sys.stdout.write(
            json.dumps(plain(examine(options.seed, options.only_index, options.time_budget)), indent=1) + "\n"
        )
        return 0
    about = machine.describe()
    numbers = range(options.first, options.first + options.count)
    rows, stuck = sweep(options, numbers)
    about["load after"] = machine.load()
    page = f"# Random ropes\n\n{text(rows, options.seed, numbers)}\n{sticking(stuck)}\n\n{machine.sentence(about)}\n"
    print(page)
    if options.out != "-":
        data = {"machine": about, "seed": options.seed, "rows": table(rows), "stuck": table(stuck)}
        files.write_text(Path(options.out) / "robustness.json", json.dumps(data, indent=None) + "\n")
        files.write_text(Path(options.out) / "robustness.md", page)
    return int(not (passed(rows) and all(row["outcome"] == "accurate" for row in stuck)))


def sweep(options: argparse.Namespace, numbers: range) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows of the ropes and of the stuck ones, kept or new; Ctrl-C keeps the finished ones."""
    log, unkept = Path(options.out) / "robustness.jsonl", options.out == "-"
    known = {} if unkept else read(log, options.seed, options.time_budget)
    jobs = [(what, number) for number in numbers for what in kinds(number) if (what, number) not in known]
    tasks = [(what, options.seed, number, options.time_budget) for what, number in jobs]
    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("ropes", total=len(tasks))
        try:
            for row in done(tasks, options.workers):
                known[row["what"], row["number"]] = row
                if not unkept:
                    lines.append(log, {"seed": options.seed, "kernels": SOURCE_HASH, **row})
                bar.update(task, advance=1, description=summary(known.values()))
        except KeyboardInterrupt:
            bar.console.print("interrupted; the finished rows follow")
    rows = [known[key] for key in sorted(known) if key[1] in numbers]
    return [row for row in rows if row["what"] == "rope"], [row for row in rows if row["what"] == "stuck"]


def kinds(number: int) -> list[str]:
    return ["rope", "stuck"] if number % STICKING == 0 else ["rope"]


def done(tasks: list[TrackingTask], workers: int) -> Iterator[dict[str, Any]]:
    """Rows in order of completion, from this process or from several."""
    if workers == 1:
        be_ready()
        yield from map(work, tasks)
        return
    with multiprocessing.get_context("spawn").Pool(workers, be_ready) as pool:
        yield from pool.imap_unordered(work, tasks)


def work(task: TrackingTask) -> dict[str, Any]:
    what, seed, number, time_budget = task
    row = examine(seed, number, time_budget) if what == "rope" else stay(draw_stuck(seed, number), time_budget)
    return {"what": what, "time_budget": time_budget, **plain(row)}


def be_ready() -> None:
    """Compile for both friction models before timing."""
    signal.signal(signal.SIGVTALRM, _out_of_time)
    for model in ("relative", "printed"):
        rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=2, friction_model=model)
        hf.simulate(rope, duration=0.01)


def read(log: Path, seed: int, time_budget: float) -> dict[tuple[str, int], dict[str, Any]]:
    """Rows of an earlier sweep with the same seed and kernels, except those that a larger budget may change."""
    same = [row for row in lines.read(log) if row.pop("seed") == seed and row.pop("kernels") == SOURCE_HASH]
    latest = {(row["what"], row["number"]): row for row in same}
    hasty = [
        key for key, row in latest.items() if row.get("reason") == SLOW and row.get("time_budget", 0.0) < time_budget
    ]
    return {key: row for key, row in latest.items() if key not in hasty}


def table(rows: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """Rows as columns, so that each quantity is named once."""
    return {name: [row.get(name) for row in rows] for name in dict.fromkeys(name for row in rows for name in row)}


def stay(case: Case, time_budget: float) -> dict[str, Any]:
    """Whether a rope that should stick does."""
    try:
        signal.setitimer(signal.ITIMER_VIRTUAL, time_budget)
        turned = drift(case.setup)
    except (SimulationError, OutOfPatience) as error:
        return {"number": case.number, "links": case.kind["links"], "outcome": "failed", "reason": error.status}
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    outcome = "accurate" if turned <= ALLOWED_DRIFT else "wrong"
    return {"number": case.number, "links": case.kind["links"], "outcome": outcome, "drift": turned}


def sticking(rows: list[dict[str, Any]]) -> str:
    """Describe the results of the ropes that should stick."""
    if not rows:
        return ""
    most = max((row["drift"] for row in rows if "drift" in row), default=math.nan)
    return (
        f"{len(rows)} more ropes, bent and at rest, whose dry friction carries their weight: {summary(rows)} (drift of "
        f"at most {ALLOWED_DRIFT:g} rad in 10 s); the greatest drift is {most:.2g} rad."
    )


def _out_of_time(*_: Any) -> None:
    raise OutOfPatience


def examine(seed: int, number: int, time_budget: float) -> dict[str, Any]:
    """Check the case of a seed and a number with a time budget, s."""
    case = draw(seed, number)
    signal.setitimer(signal.ITIMER_VIRTUAL, time_budget)
    try:
        verdict = judge(case.setup, case.number)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    return {"number": case.number, "ordinary": case.ordinary, **case.kind, **verdict._asdict()}


def plain(row: dict[str, Any]) -> dict[str, Any]:
    """Numbers for JSON, with four digits."""
    return {name: _short(value) for name, value in row.items()}


def _short(value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return float(f"{value:.4g}") if math.isfinite(value) else None


def summary(rows: Iterable[dict[str, Any]]) -> str:
    return ", ".join(f"{count} {outcome}" for outcome, count in Counter(row["outcome"] for row in rows).most_common())


def passed(rows: list[dict[str, Any]]) -> bool:
    """No wrong run without a warning; few errors or unchecked runs, and none of an ordinary rope.

    The bound is wide, so that no rope exceeds it by chance; nearly all ropes must also stay far below it.
    """
    outcomes = Counter(row["outcome"] for row in rows)
    ordinary = any(row["ordinary"] and row["outcome"] != "accurate" for row in rows)
    open_ones = outcomes["failed"] + outcomes["unchecked"]
    near = np.mean([row["factor"] <= USUAL for row in rows if row["outcome"] in ("accurate", "wrong")])
    return outcomes["wrong"] == 0 and not ordinary and open_ones <= ALLOWED_FAILURES * len(rows) and near >= MOST


def text(rows: list[dict[str, Any]], seed: int, numbers: range) -> str:
    """Results as Markdown, of the ropes of these numbers that have rows."""
    good = [row for row in rows if row["outcome"] in ("accurate", "wrong")]
    missing = sorted(set(numbers) - {row["number"] for row in rows})
    ordinary = [row for row in rows if row["ordinary"]]
    factor, promise = (np.array([row[name] for row in good]) for name in ("factor", "promise"))
    reached = np.array([row["horizon"] / row["duration"] for row in good])
    timed = Counter(row["event"] for row in good if row["event"])
    events = ", ".join(f"{count} {name}" for name, count in sorted(timed.items()))
    shares = f"{np.mean(factor <= USUAL):.1%} stay below {USUAL:g} tol growth."
    checked = f"{sum(row['checked'] for row in good)} were also checked against the Runge-Kutta method."
    lines = [
        f"{len(rows)} random ropes, seed {seed}: {summary(rows)}.",
        *([f"The sweep was stopped; missing: {span(missing)}."] if missing else []),
        f"{len(ordinary)} of them are ordinary ({ORDINARY}): {summary(ordinary)}.",
        "",
        ACCURACY,
        "",
        "| | median | 90 % | 99 % | greatest |",
        "|---|---|---|---|---|",
        quantiles("error / bound", promise),
        quantiles("error / (tol growth)", factor),
        quantiles("horizon / duration", reached),
        quantiles("error of an event's time / bound", column(good, "lateness")),
        quantiles("error of an event's time, s", column(good, "late")),
        quantiles("processor time of a run, ms", 1e3 * column(rows, "seconds")),
        "",
        f"{shares} {checked}",
        f"Runs that ended at an event: {events}; bound of its time: effect of the state's bound + {LOCATED:g} s.",
        "",
        *listing("Wrong", [row for row in rows if row["outcome"] == "wrong"]),
        *listing("Failed", [row for row in rows if row["outcome"] == "failed"]),
        *listing("Unchecked", [row for row in rows if row["outcome"] == "unchecked"]),
        *listing("Slowest", sorted(rows, key=lambda row: -row["seconds"])[:SLOWEST]),
    ]
    return "\n".join(lines)


def span(numbers: list[int]) -> str:
    """Describe a range of numbers."""
    return ", ".join(map(str, numbers)) if len(numbers) <= SLOWEST else f"{len(numbers)} from number {numbers[0]} on"


def column(rows: list[dict[str, Any]], name: str) -> Any:
    """Numbers that have rows."""
    return np.array([row[name] for row in rows if row[name] is not None])


def quantiles(name: str, values: Any) -> str:
    cells = np.quantile(values, [0.5, 0.9, 0.99, 1.0]) if values.size else [math.nan] * 4
    return f"| {name} | " + " | ".join(f"{value:.2g}" for value in cells) + " |"


def listing(title: str, rows: list[dict[str, Any]]) -> list[str]:
    """A table of single cases; empty without cases."""
    names = ("number", "reason", "promise", "factor", "seconds", "links", "tol", "eta", "stiffness", "dry", "drive")
    if not rows:
        return []
    titles = " | ".join(names).replace("promise", "error / bound")
    head = [f"## {title}", "", f"| {titles} |", "|" + "---|" * len(names)]
    return [*head, *("| " + " | ".join(_cell(row[name]) for name in names) + " |" for row in rows), ""]


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main())
