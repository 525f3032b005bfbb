"""Two processes compared with one: speed-up of a batch with contact and of episodes.

python -m benchmarks.executor            a minute or two; to benchmarks/results/
python -m benchmarks.executor --out -    writes nothing

One process on one thread, and two workers of a ProcessPoolExecutor with loaded kernels. The gain is the processor time
of one process over that of the parent and the busier worker together, which is the gain in elapsed time on two idle
processors. The measured gain in elapsed time is reported as well. Results are compared bit by bit.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.envs import PumpingPolicy, score_policy

RESULTS = Path(__file__).parent / "results"
WORKERS, ROUNDS, AIM = 2, 2, 1.8
ROPE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=20, radius=0.0025, friction=2e-4)


def batch(executor: Executor | None) -> Any:
    """Members of a batch near a peg."""
    motions = [hf.arm_swings(t_rest=0.3 + 0.005 * k) for k in range(96)]
    given: dict[str, Any] = {"arm": hf.Arm(), "duration": 8.0, "pegs": [hf.Peg(0.5, -0.8, 0.05)], "threads": 1}
    return hf.simulate_batch(ROPE, motions, executor=executor, **given).tip


def episodes(executor: Executor | None) -> Any:
    """Episodes of a policy."""
    return score_policy(PumpingPolicy, "hyperflex/Swing-v0", seeds=range(8), executor=executor, chunk_size=1).returns


def spent(_: int) -> tuple[int, float]:
    """Process id and its processor time, s; slow enough that each worker answers."""
    time.sleep(0.3)
    return os.getpid(), time.process_time()


def measure(work: Callable[[Executor | None], Any], pool: Executor) -> dict[str, float]:
    """Times of one process and of two, the best of alternating rounds."""
    want, rows = work(None), []
    for _ in range(ROUNDS + 1):  # the first one loads what the workers need
        begin, processor = time.perf_counter(), time.process_time()
        work(None)
        one = time.process_time() - processor, time.perf_counter() - begin
        before = dict(pool.map(spent, range(2 * WORKERS)))
        begin, processor = time.perf_counter(), time.process_time()
        assert np.array_equal(work(pool), want, equal_nan=True)
        here, clock = time.process_time() - processor, time.perf_counter() - begin
        after = dict(pool.map(spent, range(2 * WORKERS)))
        each = [after[pid] - before[pid] for pid in after if pid in before]
        rows.append((one[0], here + max(each), one[1] / clock))
    rows = rows[1:]
    single, both = min(row[0] for row in rows), min(row[1] for row in rows)
    return {"one": single, "two": both, "gain": single / both, "clock": max(row[2] for row in rows)}


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    options = parser.parse_args()
    works = {"batch about a peg, 96 members": batch, "8 episodes": episodes}
    lines = ["| work | one process, s | two, s | gain | gain in elapsed time |", "|---" * 5 + "|"]
    with ProcessPoolExecutor(WORKERS, mp_context=multiprocessing.get_context("forkserver")) as pool:
        for name, work in works.items():
            row = measure(work, pool)
            lines.append(f"| {name} | {row['one']:.2f} | {row['two']:.2f} | {row['gain']:.2f} | {row['clock']:.2f} |")
            print(lines[-1], flush=True)
    note = (
        f"Best of {ROUNDS}. Aim: a gain of {AIM:g} on two processors. Times are processor times: of one process; of "
        "the parent and"
    )
    note += f" the busier of {WORKERS} workers. Elapsed time depends on other load on the machine."
    page = "\n".join(
        ["# Two processes compared with one", "", *lines, "", note, machine.sentence(machine.describe()), ""]
    )
    if options.out != "-":
        files.write_text(Path(options.out) / "executor.md", page)


if __name__ == "__main__":
    main()
