"""Speed and accuracy of hyperflex and its peers on one rope, in one run on one machine.

pip install -e '.[bench]'        the peers; missing ones are omitted and reported
python benchmarks/run.py         everything, about ten minutes; results in benchmarks/results/
python benchmarks/run.py --quick less than a minute; writes nothing
python benchmarks/run.py --only work-precision accelerations
"""

import argparse
import importlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
PARTS = {
    "work-precision": "The paper's cast: error against time",
    "accelerations": "One acceleration against the number of links",
    "scaling": "A simulated second against the number of links",
    "costs": "The paper's cast with one thing changed: cost and error",
    "batches": "Many ropes at once: throughput at settings checked for every member",
    "stepper": "Stepwise runs: cost of a step, and agreement with one run",
    "gradients": "Cost of exact derivatives in units of a plain rollout",
    "identification": "From a recording to a rope: time and error",
    "starting": "Imports, compilation and first calls",
}
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
PEERS = ("hyperflex", "scipy", "mujoco", "pinocchio", "drake")


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--peers", nargs="+", choices=PEERS[1:], default=PEERS[1:], metavar="PEER", help="which peers")
    parser.add_argument("--repeats", type=int, help="rounds of timing (5, quick: 3)")
    parser.add_argument("--quick", action="store_true", help="few settings, nothing written unless --out is given")
    parser.add_argument("--out", type=Path, help=f"folder for JSON, Markdown and PNG (benchmarks/{RESULTS.name})")
    return parser.parse_args()


def main() -> None:
    """Measure, print and write."""
    options = parse()
    repeats = options.repeats or (3 if options.quick else 5)
    if options.only != ["identification"]:  # which sets its own threads, and is timed as for a user
        for name in THREADS:  # read by the linear algebra library on import
            os.environ[name] = "1"
    import machine

    found, missing = machine.installed(["hyperflex", *options.peers])
    skipped = [f"Not installed, omitted: {name} ({why})." for name, why in missing.items()]
    print("\n".join(skipped), end="\n" if skipped else "")
    out = options.out or (None if options.quick else RESULTS)
    for part in options.only:
        begin, about = time.perf_counter(), machine.describe()
        module = importlib.import_module(part.replace("-", "_"))
        rows = module.measure(options.quick, repeats, found)
        about["load after"] = machine.load()
        page = "\n\n".join([f"# {PARTS[part]}", module.text(rows, found), *skipped, machine.sentence(about)])
        print(f"{page}\n\n({part}: {time.perf_counter() - begin:.0f} s)\n", flush=True)
        if out is not None:
            write(
                out, part, page, {"machine": about, "left_out": missing, "rows": rows}, getattr(module, "figure", None)
            )


def write(folder: Path, part: str, page: str, data: dict[str, Any], draw: Callable[[Any, Path], None] | None) -> None:
    """Write part.json, part.md and part.png."""
    from hyperflex import files

    folder.mkdir(parents=True, exist_ok=True)
    files.write_text(folder / f"{part}.json", json.dumps(data, indent=1) + "\n")
    if draw is not None:
        draw(data["rows"], folder / f"{part}.png")
        page += f"\n\n![{PARTS[part]}]({part}.png)"
    files.write_text(folder / f"{part}.md", page + "\n")


if __name__ == "__main__":
    main()
