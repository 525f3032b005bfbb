"""The capstan: at which pull does a wound rope slip? Beside exp(mu theta).

python -m benchmarks.capstan              the whole table; results in benchmarks/results/capstan.json
python -m benchmarks.capstan --quick      one case of each

A rope without weight goes round a peg of 20 mm, 1 N at its tip. The pull at its other end grows steadily, and slip is
1 mm beyond what it had moved at four fifths of the limit. The rope is cut as the library cuts it, and for the order
of convergence with links of other lengths as well.

MuJoCo's rope is the same chain of capsules on a cylinder, pyramidal or elliptic friction cones, with the pull of 1 N
at its tip as an external force and a ramp at the other end. As it creeps at any pull, slip is 1 mm in 1 s there, from
some pull on; its creep is the mean between 0.6 and 0.75 of the limit. Only with --peers: this model of it slips at any
pull, which others do not, so it is not to be trusted yet.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from tests.reference.wrapping import capstan, laid, slipped

RESULTS = Path(__file__).parent / "results"
RADIUS, ROPE, DENSITY = 0.02, 0.0025, 0.0625  # m, m, kg/m
AXIS = RADIUS + ROPE
SLIP = 1e-3  # m
RAMP = 8.0  # s
FROM, TO = 0.8, 1.15  # of the limit
CASES = [(mu, turns) for mu in (0.1, 0.3, 0.5) for turns in (0.5, 1.0, 2.0)]
RATIOS = (1.2, 0.6, 0.3, 0.15)  # links in radii of the axis, for the order of convergence


def rope(turns: float, mu: float, ratio: float) -> tuple[hf.Rope, hf.Peg]:
    """The paper's cable, as long as it must be, with links of `ratio` radii where it may wind."""
    peg, length = hf.Peg(0.0, 0.0, RADIUS, mu), 0.25 + 2.0 * math.pi * turns * AXIS
    coarse = hf.Rope.uniform(length, DENSITY * length, math.ceil(length / 0.04), ROPE, friction=5e-4, gravity=(0, 0))
    return hf.refined(coarse, [peg], arm=hf.Arm(length=0.3, pivot=(-AXIS - 0.3, 0.1)), ratio=ratio), peg


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


def mujoco_model(cable: hf.Rope, peg: hf.Peg, swept: float, cone: str, impratio: float, step: float) -> Any:
    """The same rope, its first joint on a slider that is pulled up; capsules on a fixed cylinder."""
    import mujoco

    axis = AXIS * (1.0 + 1e-6)
    q = laid(cable.length, (-axis, 0.1), axis, swept)
    solid = f'friction="{peg.mu!r} 0 0" condim="3" solref="{4 * step!r} 1" solimp="0.999 0.9999 0.0001"'
    bodies, before, drop = "", 0.0, 0.0
    for i in range(cable.n_links):
        size, mass, inertia = (float(getattr(cable, name)[i]) for name in ("length", "mass", "inertia"))
        bodies += (
            f'<body pos="0 0 {-drop!r}" euler="0 {-(float(q[i]) - before)!r} 0"><joint type="hinge" axis="0 -1 0" '
            f'damping="{float(cable.friction[i])!r}"/><inertial pos="0 0 {-0.5 * size!r}" mass="{mass!r}" '
            f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 {-size!r}" size="{ROPE!r}" contype="1" conaffinity="2" {solid}/>'
        )
        before, drop = float(q[i]), size
    bodies += f'<site name="tip" pos="0 0 {-drop!r}"/>' + "</body>" * cable.n_links
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 0" timestep="{step!r}" cone="{cone}" '
        f'impratio="{impratio!r}" integrator="implicitfast" iterations="200" tolerance="1e-12"/><worldbody>'
        f'<geom type="cylinder" fromto="0 -0.1 0 0 0.1 0" size="{RADIUS!r}" contype="2" conaffinity="1" {solid}/>'
        f'<body pos="{-axis!r} 0 0.1"><joint name="pull" type="slide" axis="0 0 1" damping="0.1"/>'
        f'<inertial pos="0 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/>{bodies}</body></worldbody></mujoco>'
    )


def mujoco_onset(mu: float, turns: float, cone: str, impratio: float, step: float, ramp: float) -> dict[str, Any]:
    import mujoco

    swept, begin = 2.0 * math.pi * turns, time.perf_counter()
    limit = math.exp(mu * swept)
    cable, peg = rope(turns, mu, 0.3)
    compiled = mujoco_model(cable, peg, swept, cone, impratio, step)
    data = mujoco.MjData(compiled)
    last, site = compiled.nbody - 1, compiled.site("tip").id
    pull = np.array([math.sin(swept), 0.0, -math.cos(swept)])
    steps = round(ramp / step)
    parts = np.interp(np.arange(steps) * step, [0.0, 0.1 * ramp, ramp], [0.5, 0.5, 1.3])
    way = np.zeros(steps)
    for k in range(steps):
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(compiled, data, pull, np.zeros(3), data.site_xpos[site], last, data.qfrc_applied)
        data.qfrc_applied[0] += limit * parts[k]
        mujoco.mj_step(compiled, data)
        way[k] = -float(data.site_xpos[site] @ pull)
        if way[k] - way[0] > 0.1:  # it is gone
            way = way[: k + 1]
            break
    window = round(1.0 / step)
    slow = np.flatnonzero(way[window:] - way[:-window] <= SLIP)  # windows of a second in which it does not slip
    at = float(parts[slow[-1] + 1]) if slow.size else math.nan
    calm = np.flatnonzero((parts[: way.size] > 0.6) & (parts[: way.size] < 0.75))
    creeping = 1e3 * (way[calm[-1]] - way[calm[0]]) / ((calm.size - 1) * step) if calm.size > window else math.nan
    return {
        "mu": mu,
        "turns": turns,
        "cone": cone,
        "impratio": impratio,
        "step": step,
        "onset over exp(mu theta)": at,
        "creep below three quarters of the limit, mm/s": float(creeping),
        "us a step": 1e6 * (time.perf_counter() - begin) / (k + 1),
    }


def page(found: dict[str, Any]) -> str:
    """The results as Markdown."""
    creeps = {(row["mu"], row["turns"]): row["creep, mm/s"] for row in found["creep"]}
    ours = [
        f"| {r['mu']} | {r['turns']} | {r['links']} | {r['onset over exp(mu theta)']:.3f} | "
        f"{creeps[r['mu'], r['turns']]:.1e} | {100 * r['unsolved part']:.3f} |"
        for r in found["onset"]
    ]
    finer = [f"| {r['l/R']} | {r['links']} | {r['onset over exp(mu theta)']:.4f} |" for r in found["convergence"]]
    peer = [
        f"| {r['cone']} | {r['impratio']:g} | {r['step']:g} | {r['onset over exp(mu theta)']:.3f} | "
        f"{r['creep below three quarters of the limit, mm/s']:.2g} |"
        for r in found["MuJoCo"]
    ]
    return "\n".join(
        [
            "# The capstan",
            "",
            "Pull at which a wound rope without weight slips by 1 mm, over exp(mu theta), with 1 N at its tip, on a",
            "peg of 20 mm, its links cut as the library cuts them; and its creep at 0.95 of the limit over 10 s.",
            "",
            "| mu | turns | links | onset / exp(mu theta) | creep, mm/s | unsolved, % of steps |",
            "|---|---|---|---|---|---|",
            *ours,
            "",
            f"One turn at mu = 0.3 with links of other lengths. {order(found['convergence'])}",
            "",
            "| link / radius of the rope's axis | links | onset / exp(mu theta) |",
            "|---|---|---|",
            *finer,
            "",
            "MuJoCo, the same chain, half a turn at mu = 0.3:" if peer else "No peer was measured.",
            "",
            *(
                ["| cone | impratio | step, s | onset / exp(mu theta) | creep below 0.75 of the limit, mm/s |"]
                if peer
                else []
            ),
            *(["|---|---|---|---|---|"] if peer else []),
            *peer,
            "",
            f"{machine.sentence(found['machine'])}",
            "",
            "Again: `python -m benchmarks.capstan`",
            "",
        ]
    )


def order(rows: list[dict[str, Any]]) -> str:
    """The observed order of convergence, between the onsets of three halvings of the links, in words."""
    onsets = [row["onset over exp(mu theta)"] for row in rows]
    steps = np.diff(onsets)
    if len(onsets) < 3 or not steps.all():
        return ""
    if len({float(np.sign(step)) for step in steps}) > 1:
        return "They do not come from one side, so no order of convergence can be read off."
    return f"Observed order: {', '.join(f'{np.log2(a / b):.1f}' for a, b in itertools.pairwise(steps))}."


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--peers", action="store_true", help="MuJoCo as well, whose model here is not checked yet")
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
        add("convergence", onset(0.3, 1.0, ratio))
    if options.peers and importlib.util.find_spec("mujoco"):
        settings = [("elliptic", 100.0, 2e-4)] if options.quick else [
            ("pyramidal", 1.0, 1e-3), ("elliptic", 1.0, 1e-3), ("elliptic", 100.0, 1e-3), ("elliptic", 100.0, 2e-4),
        ]  # fmt: skip
        for setting in settings:
            add("MuJoCo", mujoco_onset(0.3, 0.5, *setting, ramp=8.0))
    if options.out != "-":
        files.write_text(options.out, json.dumps(found, indent=1) + "\n")
        files.write_text(str(Path(options.out).with_suffix(".md")), page(found))
    worst = max(abs(row["onset over exp(mu theta)"] - 1.0) for row in found["onset"])
    print(
        f"worst onset: {100 * worst:.1f} % off; worst creep: {max(r['creep, mm/s'] for r in found['creep']):.2g} mm/s"
    )
    return 0 if worst < 0.03 else 1


if __name__ == "__main__":
    sys.exit(main())
