"""Pumping the paper's cable to |x| = 1.8 m: the paper's rest, constant rests, the paper's timing rule, ours, a search.

python -m benchmarks.pumping             some minutes; results in benchmarks/results/
python -m benchmarks.pumping --search    repeats the search for rests; minutes for each path on an idle machine

All half turns of the arm are equal: stroke pi, 0.73 s, bang-bang. The first starts at t = 0 with the rope hanging at
rest. Physical friction; the arm moves through the bottom or over the top. Simulated.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine
from benchmarks.pumping_cases import BEST, LONGEST, WANTED, arrival, caster, closed_loop, constant_arrivals, motion_of

from hyperflex import files
from hyperflex.control import CrossingRule, PumpingRule, SimulatedCamera, TrueState, optimize_pumping, run_closed_loop
from hyperflex.paper import T_REST, cable, casting_arm

PATHS = ("under", "over")
CONSTANTS = np.round(np.arange(0.30, 0.70, 0.002), 3)  # s; outside none is among the best
LEADS = (-0.35, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)  # s; the paper has no negative ones
NOTE = """ All half turns of the arm are equal (stroke, speed, acceleration); the search varies the rests only. It finds
nothing 5 % faster than the best constant rest through the bottom: see [the bound](pumping-bound.md).

t_b is that of the paper: the arm starts t_b before the tip crosses x = 0. With a negative t_b, which the paper did not
try, it starts after the crossing, also after one that happens while the arm still moves. If the crossing must follow
the arm's stop instead, a negative t_b pumps worse than 0 through the bottom."""
ROPES = 8  # true ropes seen by the simulated camera


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--search", action="store_true", help="repeat the search for rests")
    parser.add_argument("--ropes", type=int, default=ROPES, help="true ropes for the camera")
    parser.add_argument("--out", default=str(Path(__file__).parent / "results"), help="folder, or - for none")
    options = parser.parse_args()
    about = machine.describe()
    rows = {path: measure(path, options.search, options.ropes) for path in PATHS}
    page = f"# Pumping to |x| = {WANTED:g} m\n\n{text(rows)}\n{machine.sentence(about)}\n"
    print(page)
    if options.out != "-":
        folder = Path(options.out)
        files.write_text(folder / "pumping.json", json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")
        files.write_text(folder / "pumping.md", page)


def measure(path: Any, search: bool, ropes: int) -> dict[str, Any]:
    """Times of arrival, s, of each pumping method; None if the tip does not arrive."""
    times = constant_arrivals(path, CONSTANTS)
    best = int(np.argmin(times))
    rope, arm, model = cable(), casting_arm(), caster(path)
    own = float(constant_arrivals(path, np.array([T_REST["success"]]))[0])
    row: dict[str, Any] = {"0.53 s": own, "constant": float(CONSTANTS[best]), "best constant": float(times[best])}
    for lead in LEADS:
        swung = run_closed_loop(TrueState(rope, arm), CrossingRule(model, lead), model, duration=LONGEST)
        row[f"t_b = {lead:g} s"] = known(arrival(swung.motion))
    greedy = run_closed_loop(TrueState(rope, arm), PumpingRule(model, WANTED), model, duration=LONGEST - 4.0)
    row["looking ahead"] = known(arrival(greedy.motion))
    row["rests"] = list(BEST[path])
    row["search"] = arrival(motion_of(path, BEST[path]))
    if search:
        found = optimize_pumping(model, WANTED)
        row["search anew"], row["rests anew"] = found.arrival_time, [round(float(r), 4) for r in found.rests]
    row["closed loop"] = known(arrival(closed_loop(path, TrueState(rope, arm))))
    row["camera"] = [camera(path, seed) for seed in range(ropes)]
    return row


def camera(path: Any, seed: int) -> dict[str, float | None]:
    """Arrival, s, of a rope that differs from the model with delayed, noisy measurements; and of the plan in open
    loop."""
    rope, arm = cable(), casting_arm()
    length, mass, friction = 1.0 + np.array([0.01, 0.02, 0.2]) * np.random.default_rng(seed).standard_normal(3)
    true = rope.replace(
        length=length * rope.length, com=length * rope.com, mass=mass * rope.mass, friction=friction * rope.friction
    )
    loop = closed_loop(path, SimulatedCamera(TrueState(true, arm), rope, arm, seed=seed))
    return {
        "closed loop": known(arrival(loop, rope=true)),
        "open loop": known(arrival(motion_of(path, BEST[path]), rope=true)),
    }


def known(time: float) -> float | None:
    """Return a time, or None where it is not finite."""
    return time if np.isfinite(time) else None


def text(rows: dict[str, dict[str, Any]]) -> str:
    """Return the table, and the results with the camera, as Markdown."""
    skip = ("constant", "rests", "rests anew", "camera")
    names = [name for name in rows["under"] if name not in skip]
    lines = ["| way | under, s | over, s |", "|---|---|---|"]
    for name in names:
        label = (
            f"{name}, {rows['under']['constant']:g} and {rows['over']['constant']:g} s"
            if name.startswith("best")
            else name
        )
        lines.append(f"| {label} | {shown(rows['under'][name])} | {shown(rows['over'][name])} |")
    lines.append(NOTE)
    for path, row in rows.items():
        for kind in ("closed loop", "open loop"):
            times = [each[kind] for each in row["camera"]]
            lines += ["", f"Camera, {path}, {kind}: {', '.join(map(shown, times))} s."]
    return "\n".join(lines) + "\n"


def shown(time: float | None) -> str:
    """Return a time with two digits."""
    return "not reached" if time is None else f"{time:.2f}"


if __name__ == "__main__":
    main()
