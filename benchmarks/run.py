"""Speed beside accuracy: the paper's cast in hyperflex and in MuJoCo, in one run on one machine.

    make bench            (or: python benchmarks/run.py)

Prints a table and writes benchmarks/results/cast.json and cast.md with the machine and the versions.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import mujoco_rope
import numpy as np

import hyperflex as hf
from hyperflex import files

RESULTS = Path(__file__).parent / "results"
ROPE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
ARM = hf.Arm(length=0.105)
MOTION = hf.swings(t_move=0.73, t_rest=0.53)
TIMES = np.array([2.0, 5.0, 10.0])  # errors are stated at the first two; the clock runs for all ten seconds
BASE_STEP = 0.005  # s; the motion's switches are whole multiples of it, so MuJoCo's steps are whole fractions


@dataclass
class Row:
    """One setting of one simulator."""

    simulator: str
    setting: str
    error_2s_mm: float
    error_5s_mm: float
    ms_per_simulated_s: float  # median
    spread_ms: tuple[float, float]


def reference() -> np.ndarray:
    """Tip (3, 2) from the explicit check integrator, which shares no step with what is measured."""
    return hf.simulate(ROPE, MOTION, arm=ARM, duration=float(TIMES[-1]), t_eval=TIMES, method="rk4", step=1e-4).tip


def measure(name: str, setting: str, run: Callable[[], np.ndarray], true: np.ndarray, repeats: int) -> Row:
    """Run once to warm up, then `repeats` times."""
    tip = run()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        seconds.append((time.perf_counter() - begin) * 1e3 / TIMES[-1])
    error = np.hypot(*(tip - true).T) * 1e3
    return Row(name, setting, error[0], error[1], statistics.median(seconds), (min(seconds), max(seconds)))


def hyperflex_run(tol: float) -> np.ndarray:
    """Return the tip at TIMES from the library as a user calls it: checks, output and energies included."""
    return hf.simulate(ROPE, MOTION, arm=ARM, duration=float(TIMES[-1]), t_eval=TIMES, tol=tol).tip


def contestants(repeats: int) -> Iterator[Row]:
    """Every simulator and setting."""
    true = reference()
    for tol in (1e-3, 1e-4, 1e-5, 1e-6, 1e-8):
        yield measure("hyperflex", f"tol {tol:g} m", lambda tol=tol: hyperflex_run(tol), true, repeats)
    for integrator, parts in (
        ("implicitfast", 13),
        ("implicitfast", 26),
        ("implicitfast", 104),
        ("RK4", 11),
        ("RK4", 13),
    ):
        compiled = mujoco_rope.model(ROPE, ARM, integrator, BASE_STEP / parts)
        setting = f"{integrator}, dt {BASE_STEP / parts:.2e} s"
        yield measure("MuJoCo", setting, lambda m=compiled: mujoco_rope.cast(m, MOTION, TIMES), true, min(repeats, 3))


def table(rows: list[Row]) -> str:
    """Rows as a Markdown table."""
    lines = [
        "| simulator | setting | error at 2 s, mm | at 5 s, mm | ms per simulated s (least-most) |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        low, high = row.spread_ms
        lines.append(
            f"| {row.simulator} | {row.setting} | {row.error_2s_mm:.2g} | {row.error_5s_mm:.2g} "
            f"| {row.ms_per_simulated_s:.3g} ({low:.3g}-{high:.3g}) |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each setting")
    repeats = parser.parse_args().repeats
    rows = []
    for row in contestants(repeats):
        rows.append(row)
        print(table([row]).splitlines()[-1], flush=True)
    good = [r for r in rows if max(r.error_2s_mm, r.error_5s_mm) < 1.0]
    best = {name: min(r.ms_per_simulated_s for r in good if r.simulator == name) for name in ("hyperflex", "MuJoCo")}
    verdict = (
        f"Fastest setting below 1 mm at 2 s and at 5 s: hyperflex {best['hyperflex']:.3g}, MuJoCo {best['MuJoCo']:.3g} "
        f"ms per simulated second: {best['MuJoCo'] / best['hyperflex']:.0f} times."
    )
    machine = {
        "processor": _processor(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("hyperflex", "numba", "numpy", "mujoco")},
    }
    RESULTS.mkdir(exist_ok=True)
    files.write_text(
        RESULTS / "cast.json", json.dumps({"machine": machine, "rows": [asdict(r) for r in rows]}, indent=1)
    )
    heading = (
        "# The paper's cast: speed beside accuracy\n\n50 links, 10 s of casting from rest, one core. Reference: "
        "explicit Runge-Kutta at 1e-4 s on the O(n) accelerations. MuJoCo: plain hinges, the arm's acceleration "
        f"prescribed through an armature of {mujoco_rope.ARMATURE:g} kg m^2, steps that hit every switch.\n\n"
    )
    about = "\n\nMachine: " + ", ".join(f"{k} {v}" for k, v in machine.items()) + ".\n"
    files.write_text(RESULTS / "cast.md", heading + table(rows) + "\n\n" + verdict + about)
    print(verdict)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


if __name__ == "__main__":
    main()
