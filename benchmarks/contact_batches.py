"""Simulated seconds per second of batches in contact with a peg.

python -m benchmarks.contact_batches              results in benchmarks/results/contact-batches.json and .md
python -m benchmarks.contact_batches --out -      writes nothing

The paper's cable, released from 24 directions above a peg of 30 mm, 1.5 s each: with and without links divided for the
peg, at the default tolerance and at that of a search, on one and two threads. Kernels are compiled before timing.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex import files

RESULTS = Path(__file__).parent / "results"
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
PEG = hf.Peg(0.0, -0.7, 0.03, 0.3)
MEMBERS, DURATION = 24, 1.5  # s
SEARCH = {"tol": 1e-3, "contact_step": 1e-3}
CASES = [(refine, search, threads) for refine in (False, True) for search in (True, False) for threads in (1, 2)]


def rate(refine: bool, search: bool, threads: int, members: int) -> dict[str, Any]:
    """Simulated seconds of all members per elapsed second."""
    q0 = np.linspace(1.3, 2.1, members)[:, None] + np.zeros(CABLE.n_links)
    how: dict[str, Any] = {"pegs": [PEG], "refine": refine, **(SEARCH if search else {})}
    hf.simulate_batch(CABLE, q0=q0[:2], duration=0.01, threads=threads, **how)
    begin = time.perf_counter()
    batch = hf.simulate_batch(CABLE, q0=q0, duration=DURATION, threads=threads, keep=("turns",), **how)
    spent = time.perf_counter() - begin
    return {
        "refined": refine,
        "search": search,
        "threads": threads,
        "members": members,
        "failed": len(batch.failed),
        "wound, median turns": float(np.median(np.abs(batch.turns[:, -1, 0]))),
        "simulated s per s": members * DURATION / spent,
    }


def page(found: dict[str, Any]) -> str:
    """The results as Markdown."""
    rows = [
        f"| {'divided for the peg' if r['refined'] else '50'} | {'1e-3' if r['search'] else '1e-5'} | {r['threads']} | "
        f"{r['simulated s per s']:.2f} | {r['failed']} |"
        for r in found["rates"]
    ]
    return "\n".join(
        [
            "# Batches in contact with a peg",
            "",
            f"The paper's cable falls on a peg of 30 mm from {found['rates'][0]['members']} directions, {DURATION:g} s",
            "each; simulated. With a tolerance of 1e-3 the longest step is 1 ms.",
            "",
            "| links | tol, m | threads | simulated s per s | failed |",
            "|---|---|---|---|---|",
            *rows,
            "",
            f"Load of the machine before and after: {found['load']}. {machine.sentence(found['machine'])}",
            "",
            "Reproduce: `python -m benchmarks.contact_batches`",
            "",
        ]
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, default=MEMBERS)
    parser.add_argument("--out", default=str(RESULTS / "contact-batches.json"), metavar="FILE", help="- writes nothing")
    options = parser.parse_args()
    found: dict[str, Any] = {"machine": machine.describe(), "load": [round(os.getloadavg()[0], 1)], "rates": []}
    for refine, search, threads in CASES:
        found["rates"].append(rate(refine, search, threads, options.members))
        print(json.dumps(found["rates"][-1]), flush=True)
    found["load"].append(round(os.getloadavg()[0], 1))
    if options.out != "-":
        files.write_text(options.out, json.dumps(found, indent=1) + "\n")
        files.write_text(str(Path(options.out).with_suffix(".md")), page(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
