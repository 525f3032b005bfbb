"""Random throws of a cable at pegs, arm at rest: does energy grow, does the rope enter a peg, are steps left unsolved?

python -m benchmarks.throws                      1,000 throws; results in benchmarks/results/throws.json
python -m benchmarks.throws --count 50 --out -   a look; nothing is written
python -m benchmarks.throws --only 17            one of them again

Half of the throws have joint friction from 1e-4 to 5e-3 N m s/rad, half from 0 to 1e-4. The goals: total energy
(mechanical plus dissipated) rises by at most 1e-5 J and 1e-3 J, penetration stays below 0.2 mm, unsolved steps below
0.5 %. Contact must not give energy back either: what it has taken may fall by no more than that.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import SimulationError

RESULTS = Path(__file__).parent / "results"
LINKS, LENGTH, MASS, RADIUS = 50, 2.0, 0.125, 0.0025
DURATION = 2.0  # s
ROOM = 0.03  # m, least distance from the pegs at the start
ALLOWED = {"rubbed": 1e-5, "free": 1e-3}  # J
PENETRATION, UNSOLVED = 2e-4, 0.005  # m; part of the steps of a throw


def draw(index: int) -> tuple[str, hf.Rope, dict[str, Any]]:
    """A cable and how it is thrown: pegs, angles and rates at the start."""
    rng = np.random.default_rng([1, index])
    kind = "rubbed" if index % 2 == 0 else "free"
    if kind == "rubbed":
        friction = 10.0 ** rng.uniform(-4.0, math.log10(5e-3))
    else:
        friction = float(rng.choice([0.0, 10.0 ** rng.uniform(-6.0, -4.0)]))
    tip = float(rng.choice([0.0, 0.02]))
    rope = hf.Rope.uniform(LENGTH, MASS, LINKS, RADIUS, friction=friction, tip_mass=tip)
    mu, count = rng.uniform(0.0, 1.0), rng.integers(1, 4)
    angle, far, radius = rng.uniform(-1.5, 1.5, count), rng.uniform(0.3, 1.6, count), rng.uniform(0.02, 0.05, count)
    pegs = [
        hf.Peg(float(d * np.sin(a)), float(-d * np.cos(a)), float(r), float(mu))
        for a, d, r in zip(angle, far, radius, strict=True)
    ]
    along = np.linspace(0.0, 1.0, LINKS)
    while True:
        q0 = rng.uniform(-2.8, 2.8) + rng.normal() * along
        joints = np.cumsum(rope.length[:, None] * np.stack([np.sin(q0), -np.cos(q0)], axis=1), axis=0)
        if all(np.hypot(*(joints - [p.x, p.y]).T).min() > p.radius + RADIUS + ROOM for p in pegs):
            break
    qd0 = rng.normal(0.0, 3.0) + rng.normal(0.0, 5.0) * along
    return kind, rope, {"pegs": pegs, "q0": q0, "qd0": qd0, "duration": DURATION}


def rise(values: np.ndarray) -> float:
    return float((values - np.minimum.accumulate(values)).max())


def throw(index: int, fine: bool) -> dict[str, Any]:
    kind, rope, how = draw(index)
    begin = time.perf_counter()
    found: dict[str, Any] = {"index": index, "kind": kind, "friction": float(rope.friction[0]), "mu": how["pegs"][0].mu}
    try:
        run = hf.simulate(rope, refine=fine, **how)
    except SimulationError as error:
        return found | {"status": error.status}
    facts = run.attrs
    return found | {
        "status": run.status,
        "rise": rise(run.energy_error),
        "given": rise(-run.contact_loss),
        "peak": float(run.kinetic_energy.max()),
        "taken": float(run.contact_loss[-1]),
        "deepest": facts["contact_deepest"],
        "steps": facts["contact_steps"],
        "unsolved": facts["contact_unsolved"],
        "impacts": facts["contact_impacts"],
        "seconds": time.perf_counter() - begin,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Worst values of each kind, and how many throws break a goal."""
    result: dict[str, Any] = {"throws": len(rows), "failed": [r["index"] for r in rows if r["status"] != "ok"]}
    for kind, allowed in ALLOWED.items():
        those = [r for r in rows if r["kind"] == kind and r["status"] == "ok"]
        touched = [r for r in those if r["taken"] != 0.0]
        result[kind] = {
            "throws": len(those),
            "that touch a peg": len(touched),
            "worst rise, J": max((r["rise"] for r in those), default=0.0),
            "most that contact gave, J": max((r["given"] for r in those), default=0.0),
            "above the goal": [r["index"] for r in those if max(r["rise"], r["given"]) > allowed],
            "deepest, mm": 1e3 * max((r["deepest"] for r in those), default=0.0),
            "too deep": [r["index"] for r in those if r["deepest"] > PENETRATION],
            "unsolved part": sum(r["unsolved"] for r in those) / max(1.0, sum(r["steps"] for r in those)),
            "too many unsolved": [r["index"] for r in those if r["unsolved"] > UNSOLVED * r["steps"]],
            "median peak energy, J": float(np.median([r["peak"] for r in those])) if those else 0.0,
            "simulated s per s of one core": DURATION * len(those) / max(1e-9, sum(r["seconds"] for r in those)),
        }
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--only", type=int, metavar="INDEX", help="this throw alone")
    parser.add_argument("--coarse", action="store_true", help="leave the 40 mm links as they are")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", default=str(RESULTS / "throws.json"), metavar="FILE", help="- writes nothing")
    options = parser.parse_args()
    if options.only is not None:
        print(json.dumps(throw(options.only, not options.coarse), indent=1))
        return 0
    rows = [throw(0, not options.coarse)]  # compiles
    with ThreadPoolExecutor(options.threads) as pool:
        for row in pool.map(lambda k: throw(k, not options.coarse), range(1, options.count)):
            rows.append(row)
            print(json.dumps(row), flush=True)
    found = {"machine": machine.describe(), "links": "40 mm" if options.coarse else "refined", "summary": summary(rows)}
    print(json.dumps(found["summary"], indent=1))
    if options.out != "-":
        files.write_text(options.out, json.dumps(found | {"throws": rows}, indent=1) + "\n")
    broken = [found["summary"][kind][key] for kind in ALLOWED for key in ("above the goal", "too deep")]
    return 1 if any(broken) or found["summary"]["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
