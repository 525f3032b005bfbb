"""A soak test: resources left by a thousand calls or more of simulate, identify, plan_cast and others in one process.

python benchmarks/soak.py                          ten minutes; the page goes to benchmarks/results/soak.md
python benchmarks/soak.py --calls 200 --minutes 0  shorter; prints only
"""

import argparse
import gc
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import machine
import numpy as np

import hyperflex as hf

PAGE = Path(__file__).parent / "results" / "soak.md"
CALLS, MINUTES = 1000, 10.0  # at least
WARM, ALLOWED = 100, 20.0  # earlier calls that fill caches; growth of memory, MB
CABLE = hf.Rope.uniform(length=1.0, mass=0.05, n_links=12, radius=0.0025, friction=5e-4)
ARM, PEG = hf.Arm(length=0.1), hf.Peg(-0.4, -0.5, 0.03)
ROD = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)


def free(folder: Path, seed: int) -> None:
    """A run, written and read."""
    run = hf.simulate(CABLE, hf.arm_swings(t_rest=0.4 + 0.001 * seed), arm=ARM, duration=2.0)
    run.to_netcdf(folder / "run.nc")
    hf.read_trajectory(folder / "run.nc")


def contact(_: Path, seed: int) -> None:
    """A run in contact with a peg."""
    hf.simulate(CABLE, hf.arm_swings(t_rest=0.4 + 0.001 * seed), arm=ARM, pegs=[PEG], duration=0.5, tol=1e-3)


def batch(_: Path, seed: int) -> None:
    """A batch on threads."""
    rests = 0.4 + 0.01 * np.random.default_rng(seed).random(16)
    hf.simulate_batch(CABLE, [hf.arm_swings(t_rest=rest) for rest in rests], arm=ARM, duration=1.0)


def refused(folder: Path, _: int) -> None:
    """A run that fails, and a file that cannot be written."""
    for call in (
        lambda: hf.simulate(CABLE, hf.arm_swings(), arm=ARM, duration=1.0, tol=1e-30),
        lambda: CABLE.to_toml(folder / "no" / "rope.toml"),
    ):
        try:
            call()
        except hf.HyperflexError:
            continue
        raise AssertionError


def fit(_: Path, seed: int) -> None:
    """An identification with its intervals."""
    swing = hf.simulate(ROD, duration=3.0, q0=[0.8])
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, swing.q.shape)
    hf.identify(hf.Recording(swing.t, swing.q + noise), ROD.replace(friction=4e-4), ["inertia", "friction"])


def plan(_: Path, seed: int) -> None:
    """A short search for a cast."""
    hf.plan_cast(CABLE, ARM, PEG, time_budget=0.2, options=hf.SearchOptions(seed=seed))


ROUND: tuple[Callable[[Path, int], None], ...] = (free, contact, batch, free, refused, contact, free, batch, fit, plan)


def held() -> dict[str, float]:
    """Memory, MB, and the numbers of threads, open files, and temporary files and folders."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return {
        "memory, MB": pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        "threads": len(list(Path("/proc/self/task").iterdir())),
        "open files": len(list(Path("/proc/self/fd").iterdir())) - 1,
        "temporaries": len(list(Path(tempfile.gettempdir()).rglob("*"))),
    }


def soak(calls: int, minutes: float) -> list[tuple[int, dict[str, float]]]:
    """Make at least `calls` calls until the time is over; return the resources of the process after each tenth."""
    rows: list[tuple[int, dict[str, float]]] = []
    part, begin, number = max(1, calls // 10), time.monotonic(), 0
    with tempfile.TemporaryDirectory(prefix="hyperflex-soak-") as folder:
        tempfile.tempdir = folder  # leaks of any kind are detected
        os.environ["TMPDIR"] = folder
        while not rows or rows[-1][0] < calls or time.monotonic() < begin + 60.0 * minutes:
            ROUND[number % len(ROUND)](Path(folder), number)
            number += 1
            if number >= WARM and (number - WARM) % part == 0:
                rows.append((number - WARM, held()))
                print(*rows[-1], flush=True)
        tempfile.tempdir = None
    return rows


def text(rows: list[tuple[int, dict[str, float]]], seconds: float) -> str:
    """Return the page."""
    names = list(rows[0][1])
    lines = ["# Resources after a thousand calls in one process", "", "| calls | " + " | ".join(names) + " |"]
    lines += ["|" + "---|" * (len(names) + 1)]
    lines += [f"| {calls} | " + " | ".join(f"{row[name]:.4g}" for name in names) + " |" for calls, row in rows]
    grown = rows[-1][1]["memory, MB"] - rows[0][1]["memory, MB"]
    shares = {each.__name__: 10 * ROUND.count(each) for each in ROUND}
    lines += [
        "",
        f"Memory grew by {grown:.1f} MB ({ALLOWED:g} allowed) in {seconds / 60.0:.0f} minutes, after {WARM} calls that "
        "filled the caches of the process. Calls of each kind per hundred: "
        + ", ".join(f"{share} `{name}`" for name, share in shares.items())
        + " (see `benchmarks/soak.py`). Temporaries: files and folders in the folder of temporary files; the one that "
        "remains is the run that `free` overwrites.",
        "",
        machine.sentence(machine.describe()),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Soak, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=CALLS)
    parser.add_argument("--minutes", type=float, default=MINUTES)
    chosen, begin = parser.parse_args(), time.monotonic()
    calls = chosen.calls
    rows = soak(calls, chosen.minutes)
    page = text(rows, time.monotonic() - begin)
    print(page)
    if calls >= CALLS:
        PAGE.write_text(page, "utf-8")
    first, last = rows[0][1], rows[-1][1]
    assert last["memory, MB"] - first["memory, MB"] < ALLOWED, "memory grows"
    assert all(last[name] <= first[name] for name in first if name != "memory, MB"), "resources were not released"


if __name__ == "__main__":
    main()
