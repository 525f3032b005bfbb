"""Wild chains without friction: are errors of steps within the allowed ones, and do they fall with the tolerance?

python -m benchmarks.step_errors                  3,000 chains, an hour; benchmarks/results/step-errors.md
python -m benchmarks.step_errors --count 100      the first ones; rows are kept in step-errors.jsonl

Chains of two to eight unlike links, half of them with springs, thrown out of random postures for 0.8 s at four
tolerances. Each step is compared with a run at 1e-11 m from where it began, and the end of each run with Dormand and
Prince's method (scipy's DOP853 at 1e-12). Errors are in units of the error that the step control allows.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log, machine
from scipy.integrate import solve_ivp

import hyperflex as hf
from hyperflex import files
from hyperflex.checks import Array
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.core.chain.drive import segment
from hyperflex.core.integrate.steps import rates
from hyperflex.errors import SimulationError
from tests.reference.step_errors import apart, error, steps, wild

RESULTS = Path(__file__).parent / "results"
COUNT, SEED = 3000, 100_000  # of the first chain; the seeds of tests are others
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7)  # m
EXCESS = (1.0, 2.0, 4.0, 8.0)  # times the allowed error
SMALL = 0.01  # of the chain's length: beyond, errors no longer grow in proportion


def measure(index: int, seed: int) -> dict[str, Any]:
    """The steps and the end of one chain's runs."""
    n, stiff = 2 + seed % 7, bool(seed // 7 % 2)
    setup = wild(seed, n, TOLERANCES[0], stiff=stiff)
    exact = dormand_prince(setup)
    row: dict[str, Any] = {"index": index, "seed": seed, "kernels": SOURCE_HASH, "links": n, "stiff": stiff}
    row |= {"length": setup.rope.total_length, "worst": [], "mean": [], "steps": [], "end": []}
    for tol in TOLERANCES:
        tried = setup.replace(tol=tol)
        try:
            taken = steps(tried)
            errors = [error(tried, each) for each in taken]
        except SimulationError as fault:
            return row | {"failed": str(fault)}
        row["worst"].append(float(f"{max(errors):.4g}"))
        row["mean"].append(float(f"{np.mean(errors):.4g}"))
        row["steps"].append([len(errors), *(sum(each > limit for each in errors) for limit in EXCESS)])
        row["end"].append(float(f"{apart(tried, taken[-1].reached, exact)[0]:.4g}"))
    return row


def dormand_prince(setup: hf.Setup, tol: float = 1e-12) -> Array:
    """The state at the end of a run by Dormand and Prince's method, with the accelerations of the kernels."""
    chain, drive, n = setup.chain(), setup.drive(), setup.rope.n_links
    part, slip, work = segment(drive, 0.0), np.ones(n), np.empty(6 * n)

    def rate(t: float, y: Array) -> Array:
        dy = np.empty_like(y)
        rates(chain, drive, part, t, y, slip, dy, work)
        return dy

    start = np.concatenate([*setup.start(), np.zeros(2)])
    found = solve_ivp(rate, (0.0, setup.duration), start, method="DOP853", rtol=tol, atol=tol)
    return np.asarray(found.y[:, -1])


def page(rows: list[dict[str, Any]]) -> str:
    """The results as Markdown."""
    good = [row for row in rows if "failed" not in row]
    lines = [f"| tol, m | steps | {' | '.join(f'beyond {each:g}' for each in EXCESS)} | greatest | chains beyond 4 |"]
    lines.append("|---" * (4 + len(EXCESS)) + "|")
    for k, tol in enumerate(TOLERANCES):
        count = np.sum([row["steps"][k] for row in good], axis=0)
        worst = np.array([row["worst"][k] for row in good])
        shares = [f"{each / count[0]:.1e}" for each in count[1:]]
        lines.append(f"| {tol:g} | {count[0]} | {' | '.join(shares)} | {worst.max():.1f} | {np.sum(worst > 4.0)} |")
    ends, small = np.array([row["end"] for row in good]), SMALL * np.array([row["length"] for row in good])
    falls = ["| tol, m | ends compared | median ratio of the errors | ends whose error grows |", "|---" * 4 + "|"]
    for k in range(1, len(TOLERANCES)):
        pair = ends[ends[:, k - 1] < small, k - 1 : k + 1]
        ratio = pair[:, 0] / pair[:, 1]
        grown = f"{np.mean(ratio < 1.0):.2%}, tenfold {np.mean(ratio < 0.1):.2%}"
        falls.append(f"| {TOLERANCES[k - 1]:g} to {TOLERANCES[k]:g} | {len(pair)} | {np.median(ratio):.1f} | {grown} |")
    every = np.sum([each for row in good for each in row["steps"]], axis=0)
    repeated = sum(np.sum(np.array(row["worst"]) > EXCESS[2]) > 1 for row in good)
    beyond, much, chains = (
        f"{every[1] / every[0]:.1%}",
        f"{every[3]} exceed it more than {EXCESS[2]:g} times",
        len(rows),
    )
    text = (
        f"{chains} chains of 2 to 8 links without friction; the comparison failed for {chains - len(good)}. Of "
        f"{every[0]} steps {beyond} exceed the allowed error, {much}; {repeated} chains have such steps at two "
        "tolerances. The first table gives shares of all steps, in units of the allowed error; the second compares "
        "errors at the end of 0.8 s against DOP853, if the looser run is within a hundredth of the chain's length. An "
        "error that grows when the tolerance falls means that the looser run's error was small by chance."
    )
    return "\n".join(["# Errors of steps", "", text, "", *lines, "", *falls, ""])


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT, metavar="N", help="the first chains alone")
    parser.add_argument("--out", default=str(RESULTS / "step-errors.md"), metavar="FILE")
    options = parser.parse_args()
    about = machine.describe()
    marks = list(range(SEED, SEED + options.count))
    rows = log.go_on(Path(options.out).with_suffix(".jsonl"), marks, measure)
    text = f"{page(rows)}\n{machine.sentence(about)}\n\nReproduce: `python -m benchmarks.step_errors`\n"
    files.write_text(options.out, text)
    print(text)


if __name__ == "__main__":
    main()
