"""The capstan: the pull at which a wound rope slips, compared with exp(mu theta).

python -m benchmarks.capstan              the whole table; results in benchmarks/results/capstan.json
python -m benchmarks.capstan --quick      one case of each kind; writes nothing

A rope without weight goes round a peg of 20 mm, 1 N at its tip. The pull at its other end grows steadily. The rope
slips when it has moved 1 mm farther than at four fifths of the limit. Its links are divided as the library divides
them.

The order of convergence requires a finer criterion than a millimetre: the pull grows a sixth as fast, the rope slips
when its rate reaches 0.1 mm/s, and links of one length are placed in six positions, a sixth of a corner apart, because
the error oscillates with the position of the first and the last corner.

MuJoCo's rope (--peers) is in capstan_mujoco.py.
"""

import argparse
import importlib.util
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import capstan_mujoco as peers
from benchmarks import machine
from benchmarks.capstan_mujoco import AXIS, rope

import hyperflex as hf
from hyperflex import files
from tests.reference.wrapping import capstan, slipped

RESULTS = Path(__file__).parent / "results"
SLIP = 1e-3  # m
RAMP = 8.0  # s
FROM, TO = 0.8, 1.15  # of the limit
CASES = [(mu, turns) for mu in (0.1, 0.3, 0.5) for turns in (0.5, 1.0, 2.0)]
RATIOS = (1.2, 0.6, 0.3, 0.15, 0.075)  # links in radii of the axis, for the order of convergence
POSITIONS = 6
RATE = 1e-4  # m/s, slip rate in the convergence study
SLOW = 0.0075  # 1/s, growth of the pull over the limit in the convergence study
NARROW, WIDE = (0.97, 1.03), (0.86, 1.06)  # of the limit, between which it grows; the second with links above LONG
LONG, ROUGH = 0.5, 0.8  # radii of the axis; links above ROUGH are omitted from the order


def onset(mu: float, turns: float, ratio: float) -> dict[str, Any]:
    """Pull at which the rope slips, over exp(mu theta)."""
    swept, begin = 2.0 * math.pi * turns, time.perf_counter()
    limit = math.exp(mu * swept)
    cable, peg = rope(turns, mu, ratio)
    times = np.array([0.0, 0.5, RAMP])
    run = hf.simulate(capstan(cable, peg, swept, times, limit * np.array([0.7, FROM, TO])))
    way = slipped(run, swept)
    way = way - way[60]
    gone = np.flatnonzero(way[60:] > SLIP)
    at = float(np.interp(run.t[60 + gone[0]], times, [0.7, FROM, TO])) if gone.size else math.nan
    return {
        "mu": mu,
        "turns": turns,
        "l/R": ratio,
        "links": cable.n_links,
        "onset over exp(mu theta)": at,
        "unsolved part": run.attrs["contact_unsolved"] / run.attrs["contact_steps"],
        "us a step": 1e6 * (time.perf_counter() - begin) / run.attrs["contact_steps"],
    }


def creep(mu: float, turns: float) -> dict[str, Any]:
    """Creep at 0.95 of the limit over 10 s."""
    swept = 2.0 * math.pi * turns
    cable, peg = rope(turns, mu, 0.3)
    ratios = 0.95 * math.exp(mu * swept) * np.array([0.8, 1.0, 1.0])
    way = slipped(hf.simulate(capstan(cable, peg, swept, np.array([0.0, 0.5, 11.0]), ratios)), swept)
    return {"mu": mu, "turns": turns, "creep, mm/s": 1e3 * float(abs(way[-1] - way[100])) / 10.0}


def sharp(mu: float, swept: float, ratio: float) -> tuple[float, hf.Rope]:
    """Pull over exp(mu theta) at which the rope slips faster than RATE, and the rope."""
    cable, peg = rope(swept / (2.0 * math.pi), mu, ratio)
    low, high = WIDE if ratio > LONG else NARROW
    times = np.array([0.0, 0.5, 1.0, 1.0 + (high - low) / SLOW])
    ratios = np.array([0.7, low, low, high])
    run = hf.simulate(capstan(cable, peg, swept, times, math.exp(mu * swept) * ratios))
    rate = np.diff(slipped(run, swept)) / np.diff(run.t)
    gone = np.flatnonzero((rate > RATE) & (run.t[1:] > times[2]))
    return float(np.interp(run.t[1 + gone[0]], times, ratios)) if gone.size else math.nan, cable


def converging(mu: float, turns: float, ratio: float) -> dict[str, Any]:
    """Errors of the onset with links of one length in several positions."""
    corner = 2.0 * math.atan(0.5 * ratio)
    found = [sharp(mu, 2.0 * math.pi * turns + corner * k / POSITIONS, ratio) for k in range(POSITIONS)]
    errors = np.array([at for at, _ in found]) - 1.0
    cable = found[0][1]
    return {
        "mu": mu,
        "turns": turns,
        "l/R": float(cable.length.min()) / AXIS,
        "links": cable.n_links,
        "errors of the onset": errors.tolist(),
        "rms error of the onset": float(np.sqrt(np.mean(errors**2))),
    }


def page(found: dict[str, Any]) -> str:
    """The results as Markdown."""
    creeps = {(row["mu"], row["turns"]): row["creep, mm/s"] for row in found["creep"]}
    ours = [
        f"| {r['mu']} | {r['turns']} | {r['links']} | {r['onset over exp(mu theta)']:.3f} | "
        f"{creeps[r['mu'], r['turns']]:.1e} | {100 * r['unsolved part']:.3f} |"
        for r in found["onset"]
    ]
    finer = [
        f"| {r['l/R']:.3f} | {r['links']} | {100 * r['rms error of the onset']:.3f} | "
        f"{100 * min(r['errors of the onset']):+.3f} | {100 * max(r['errors of the onset']):+.3f} |"
        for r in found["convergence"]
    ]
    peer = [
        f"| {r['l/R']} | {r['cone']} | {r['impratio']:g} | {r['step']:g} | {r['armature']:g} | "
        f"{r['onset over exp(mu theta)']:.3f} | {r['at 0.1 mm/s']:.3f} | {r['creep at 0.5, mm/s']:.1e} | "
        f"{r['creep at 0.95, mm/s']:.1e} |"
        for r in found["MuJoCo"]
    ]
    return "\n".join(
        [
            "# The capstan",
            "",
            "Pull at which a weightless wound rope with 1 N at its tip slips by 1 mm, divided by exp(mu theta), on a",
            "peg of 20 mm, with links divided by the library; and creep at 0.95 of the limit over 10 s.",
            "",
            "| mu | turns | links | onset / exp(mu theta) | creep, mm/s | unsolved, % of steps |",
            "|---|---|---|---|---|---|",
            *ours,
            "",
            f"One turn at mu = 0.3 with other link lengths, each in {POSITIONS} positions that differ by a part of a",
            "corner. Onset: a slip rate of 0.1 mm/s while the pull grows by 0.75 % of the limit per second. The",
            f"error of the onset depends on the position: rms, least, greatest. {order(found['convergence'])}",
            "",
            "| link / radius of the rope's axis | links | rms error, % | least, % | greatest, % |",
            "|---|---|---|---|---|",
            *finer,
            "",
            *(peers.NOTE if peer else ["No peer was measured."]),
            *peer,
            "",
            f"{machine.sentence(found['machine'])}",
            "",
            "Reproduce: `python -m benchmarks.capstan`",
            "",
        ]
    )


def order(rows: list[dict[str, Any]]) -> str:
    """The observed order of convergence, a line through all rms errors of links that are not rough, in words."""
    fine = [row for row in rows if row["l/R"] <= ROUGH]
    if len(fine) < 3:
        return ""
    steps, errors = (np.log([row[name] for row in fine]) for name in ("l/R", "rms error of the onset"))
    return f"Observed order, without the longest links: {np.polyfit(steps, errors, 1)[0]:.1f}."


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one case of each; writes nothing")
    parser.add_argument("--peers", action="store_true", help="MuJoCo as well")
    parser.add_argument("--out", default=str(RESULTS / "capstan.json"), metavar="FILE", help="- writes nothing")
    options = parser.parse_args()
    cases = CASES[4:5] if options.quick else CASES
    found: dict[str, Any] = {"machine": machine.describe(), "onset": [], "creep": [], "convergence": [], "MuJoCo": []}

    def add(part: str, row: dict[str, Any]) -> None:
        found[part].append(row)
        print(part, json.dumps(row), flush=True)

    for mu, turns in cases:
        add("onset", onset(mu, turns, 0.3))
        add("creep", creep(mu, turns))
    for ratio in RATIOS[2:3] if options.quick else RATIOS:
        add("convergence", converging(0.3, 1.0, ratio))
    if options.peers and importlib.util.find_spec("mujoco"):
        for setting in peers.SETTINGS[-1:] if options.quick else peers.SETTINGS:
            add("MuJoCo", peers.measure(0.3, 0.5, *setting))
    if options.out != "-" and not options.quick:
        files.write_text(options.out, json.dumps(found, indent=1) + "\n")
        files.write_text(str(Path(options.out).with_suffix(".md")), page(found))
    worst = max(abs(row["onset over exp(mu theta)"] - 1.0) for row in found["onset"])
    print(
        f"worst onset: {100 * worst:.1f} % off; worst creep: {max(r['creep, mm/s'] for r in found['creep']):.2g} mm/s"
    )
    return 0 if worst < 0.03 else 1


if __name__ == "__main__":
    sys.exit(main())
