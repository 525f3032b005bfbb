"""Planned casts in MuJoCo: an independent model, with its own contacts, joint limits and steps.

python -m benchmarks.casts_mujoco FOLDER [FOLDER ...]    every set-up of a plan (``cast.toml``) in them
python -m benchmarks.casts_mujoco FOLDER --out -         writes nothing
python -m benchmarks.casts_mujoco FOLDER --workers 8     8 casts at a time; each takes minutes

The chain is that of the plan, with its divided links near the target: hinges with the same damping, stiffness and
limits, links as capsules as thick as the rope, the target as a fixed capsule across the plane. Friction cones are
elliptic, impratio 100, and each hinge has an armature of 1e-6 kg m^2, without which short links chatter. The arm is
heavy and follows the motion step by step. Free flight is integrated by Runge-Kutta (RK4) until the first touch, then
with implicitfast: implicitfast alone, with steps of 0.2 ms, displaces the tip of a weighted rope by 120 mm after 9 s of
strokes, RK4 by 20 mm, which is due to the armature. Air drag acts across each link as in hyperflex: the forces at the
beginning of a step are applied to the bodies.

A run ends when the turns have stayed within 0.02 for 1.5 s after the arm came to rest, or when the planned run ends. A
cast winds if its turns are then at least the required ones, in the direction of the plan; the models agree if their
turns differ by less than 0.25. If they do not, MuJoCo's step is halved once. The casts are in random order, so that an
interrupted run is a fair sample; the same command continues it. All simulated.
"""

import argparse
import json
import math
import random
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log as lines
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.checks import Array
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.planning import WindCriteria

RESULTS = Path(__file__).parent / "results"
ARM = 1e5  # kg m^2, armature of the arm: the rope then disturbs it by 1e-5 rad/s^2
ARMATURE = 1e-6  # kg m^2, of each hinge
STEP = 2e-4  # s
NEAR = 0.25  # turns
LAST = 0.5  # s at the end over which turns are averaged
STILL, WITHIN = 1.5, 0.02  # s, and turns: a run ends when the turns have stayed within this range for this long
LOOK = 0.01  # s between two samples of the rope
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)  # along a link, at which air drag is summed


def model(setup: hf.Setup, step: float, spatial: bool = False) -> Any:
    """Return the compiled model of a set-up: hinges turn about -y, so that angles agree with hyperflex's.

    In space each joint has a second hinge, about x, and links are thin rods.
    """
    import mujoco

    rope, arm = setup.rope, setup.arm
    assert arm is not None
    solid = f'condim="3" solref="{4.0 * step!r} 1" solimp="0.99 0.999 0.0001"'
    bodies, drop = "", -arm.length
    for i in range(rope.n_links):
        size, mass, com, inertia, most = (
            float(getattr(rope, name)[i]) for name in ("length", "mass", "com", "inertia", "max_bend")
        )
        rest = float(rope.rest_angle[i])
        limit = f'limited="true" range="{rest - most!r} {rest + most!r}"' if math.isfinite(most) else 'limited="false"'
        law = f'damping="{float(rope.friction[i])!r}" stiffness="{float(rope.stiffness[i])!r}" armature="{ARMATURE!r}"'
        across = f'<joint type="hinge" axis="1 0 0" {law}/>' if spatial else ""
        about = (1e-3 if spatial else 1.0) * inertia
        bodies += (
            f'<body pos="0 0 {drop!r}"><joint type="hinge" axis="0 -1 0" {law} springref="{rest!r}" {limit}/>{across}'
            f'<inertial pos="0 0 {-com!r}" mass="{mass!r}" diaginertia="{inertia!r} {inertia!r} {about!r}"/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 {-size!r}" size="{rope.radius!r}" contype="1" conaffinity="2" '
            f'friction="{max(peg.mu for peg in setup.round_pegs)!r} 0 0" {solid}/>'
        )
        drop = -size
    if rope.tip_mass:
        point = f'<inertial pos="0 0 0" mass="{rope.tip_mass!r}" diaginertia="1e-9 1e-9 1e-9"/>'
        bodies += f'<body pos="0 0 {drop!r}">{point}</body>'
    bodies += f'<site name="tip" pos="0 0 {drop!r}"/>' + "</body>" * rope.n_links
    pegs = "".join(
        f'<geom type="capsule" fromto="{peg.x!r} -0.5 {peg.y!r} {peg.x!r} 0.5 {peg.y!r}" size="{peg.radius!r}" '
        f'contype="2" conaffinity="1" friction="{peg.mu!r} 0 0" {solid}/>'
        for peg in setup.round_pegs
    )
    x, y = arm.pivot
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 {float(rope.gravity[1])!r}" timestep="{step!r}" '
        'cone="elliptic" impratio="100" integrator="implicitfast" jacobian="dense" iterations="100" tolerance="1e-8"/>'
        f'<size memory="64M"/><worldbody>{pegs}<body pos="{x!r} 0 {y!r}"><joint type="hinge" axis="0 -1 0" '
        f'armature="{ARM!r}"/><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>{bodies}</body>'
        "</worldbody></mujoco>"
    )


def thrown(setup: hf.Setup, step: float) -> tuple[Array, Array]:
    """Return times (T,), s, and the turns about the target (T,), 100 a second."""
    import mujoco

    compiled, peg = model(setup, step), setup.round_pegs[0]
    data, motion = mujoco.MjData(compiled), setup.motion
    assert motion is not None
    steps, every = round(setup.duration / step), round(LOOK / step)
    t = step * np.arange(steps + 1)
    angle, rate, pull = motion.angle(t), motion.rate(t), ARM * motion.acceleration(t + 0.5 * step)
    q, qd = setup.start()
    data.qpos[:] = np.diff(np.concatenate([[0.0, float(angle[0])], q]))
    data.qvel[:] = np.diff(np.concatenate([[0.0, float(rate[0])], qd]))
    tip, links = compiled.site("tip").id, slice(2, 2 + setup.rope.n_links)
    airy = bool(setup.rope.drag.any())
    still, stopped = round(STILL / LOOK), float(motion.breaks[-1])
    times: list[float] = []
    turns: list[float] = []
    compiled.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    for k in range(steps):
        if k % every == 0:
            mujoco.mj_kinematics(compiled, data)
            times.append(float(t[k]))
            turns.append(float(swept_turns(np.vstack([data.xpos[links], data.site_xpos[tip]])[:, [0, 2]], peg)))
            if t[k] > stopped + STILL and np.ptp(turns[-still:]) < WITHIN:
                break
        data.qpos[0], data.qvel[0], data.qfrc_applied[0] = angle[k], rate[k], pull[k]
        if airy:
            data.xfrc_applied[links] = air(setup, data.qpos, data.qvel)
        mujoco.mj_step(compiled, data)
        if data.ncon:
            compiled.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return np.array(times), np.array(turns)


def air(setup: hf.Setup, q: Array, qd: Array) -> Array:
    """Return the air's forces and torques (n, 6) on the links at their centres of mass, from relative angles and rates.

    Across a link the force on a length ds is drag |u| u ds, where u is the speed there.
    """
    rope, arm = setup.rope, setup.arm
    assert arm is not None
    phi, rate = np.cumsum(q), np.cumsum(qd)
    across = np.stack([np.cos(phi), np.sin(phi)], axis=1)  # arm and links, x and z
    ends = np.concatenate([[arm.length], rope.length])[:, None] * rate[:, None] * across
    speed = (np.cumsum(ends, axis=0)[:-1] * across[1:]).sum(axis=1)  # of each link's first joint, across it
    place = 0.5 * rope.length[:, None] * (1.0 + POINTS)
    u = speed[:, None] + rate[1:, None] * place
    force = -0.5 * (rope.drag * rope.length)[:, None] * WEIGHTS * np.abs(u) * u
    found = np.zeros((rope.n_links, 6))
    found[:, [0, 2]] = force.sum(axis=1)[:, None] * across[1:]
    found[:, 4] = -(force * (place - rope.com[:, None])).sum(axis=1)
    return found


def entry(path: Path, name: str, step: float) -> dict[str, Any]:
    """Return the results of the two models for one cast."""
    begin, setup = time.process_time(), hf.Setup.from_toml(path)
    t = LOOK * np.arange(math.floor(setup.duration / LOOK + 1e-9) + 1.0)
    mine = late(t, swept_turns(hf.simulate(setup, t_eval=t).joints, setup.round_pegs[0]))
    other = late(*thrown(setup, step))
    if abs(mine - other) > NEAR:
        step *= 0.5
        other = late(*thrown(setup, step))
    return {
        "name": name,
        "links": setup.rope.n_links,
        "turns": mine,
        "turns in MuJoCo": other,
        "step": step,
        "winds": bool(abs(other) >= WindCriteria.turns and mine * other > 0.0),
        "agrees": bool(abs(mine - other) <= NEAR),
        "seconds": time.process_time() - begin,
        "kernels": SOURCE_HASH,
    }


def late(t: Array, turns: Array) -> float:
    """Return the mean over the end of the run."""
    return float(turns[t > t[-1] - LAST].mean())


def swept_turns(joints: Array, peg: hf.Peg) -> Array:
    """Return the turns (...) about a peg from the rope's first joint to its end; `joints` are (..., n + 1, 2)."""
    away = joints - np.array([peg.x, peg.y])
    angle = np.unwrap(np.arctan2(away[..., 1], away[..., 0]), axis=-1)
    return np.asarray(angle[..., -1] - angle[..., 0]) / (2.0 * np.pi)


def main() -> None:
    """Simulate, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="folders to search, or set-ups of plans")
    parser.add_argument("--step", type=float, default=STEP, help=f"of MuJoCo, s ({STEP:g})")
    parser.add_argument("--workers", type=int, default=1, help="casts at a time, each in a process (1)")
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    options = parser.parse_args()
    log = None if options.out == "-" else Path(options.out) / "casts-mujoco.jsonl"
    about, rows, paths = machine.describe(), lines.read(log), dict(plans(options.folders))
    lines.warn_of_others(rows)
    todo = sorted(paths.keys() - {row["name"] for row in rows})
    random.Random(0).shuffle(todo)
    for row in done([(paths[name], name, options.step) for name in todo], options.workers):
        rows.append(row)
        print(line(row), flush=True)
        if log is not None:
            lines.append(log, row)
    rows.sort(key=lambda row: str(row["name"]))
    wound, agreed = (sum(row[key] for row in rows) for key in ("winds", "agrees"))
    told = f"{len(rows)} planned casts: {wound} wind in MuJoCo too; the turns of {agreed} agree within {NEAR:g}."
    page = "\n".join(
        [
            "# Planned casts in MuJoCo",
            "",
            told,
            "",
            "| cast | links | turns | in MuJoCo | its step, s | winds | agrees |",
            "|---|---|---|---|---|---|---|",
            *map(line, rows),
            "",
            f"{machine.sentence(about)} {lines.made(rows)}",
            "",
            "Reproduce: `python -m benchmarks.casts_mujoco FOLDER`",
            "",
        ]
    )
    print(page)
    if log is not None:
        data = json.dumps({"machine": about, "rows": rows}, indent=1) + "\n"
        files.write_text(log.with_name("casts-mujoco.json"), data)
        files.write_text(log.with_name("casts-mujoco.md"), page)


def plans(folders: Iterable[Path]) -> Iterator[tuple[str, Path]]:
    """Name and path of each plan of a cast in folders, or of given files."""
    for path in [p for given in folders for p in ([given] if given.is_file() else sorted(given.rglob("*.toml")))]:
        setup = hf.Setup.from_toml(path)
        if setup.round_pegs and setup.motion is not None and setup.arm is not None:
            yield f"{path.parent.name}/{path.stem}", path


def done(todo: list[tuple[Path, str, float]], workers: int) -> Iterator[dict[str, Any]]:
    """Rows as they are done."""
    if workers == 1:
        yield from (entry(*each) for each in todo)
        return
    with ProcessPoolExecutor(workers) as pool:
        for each in as_completed([pool.submit(entry, *each) for each in todo]):
            yield each.result()


def line(row: dict[str, Any]) -> str:
    """Return a row of the page."""
    yes = {True: "yes", False: "no"}
    told = (row["name"], row["links"], f"{row['turns']:.2f}", f"{row['turns in MuJoCo']:.2f}", f"{row['step']:g}")
    return f"| {' | '.join(map(str, told))} | {yes[row['winds']]} | {yes[row['agrees']]} |"


if __name__ == "__main__":
    main()
