"""The capstan's rope in MuJoCo: the same chain of hinges, its links as capsules on a fixed cylinder.

The pull of 1 N at its tip is an external force; the other end is on a slider that is pulled. Three measures were needed
to hold a load near the limit. They determine the settings below:

- Friction acts on the capsules' surface but the tension on their axes, so a rope of finite radius holds less than
  exp(mu theta). The capsules are a tenth of the rope's radius thick and the peg is thicker by the rest, so that the
  axis keeps its place; an error of 1.0 % remains for half a turn at mu = 0.3.
- Links of 6 mm have such small moments of inertia that they chatter on the peg, and the rope creeps at half the limit:
  by 0.1 mm/s, and by 3 to 7 mm/s if capsules are as thick as the rope. An armature of 1e-5 kg m^2 at each hinge,
  thousands of times the links' own moments, prevents this.
- Elliptic cones and a high impratio: with pyramidal ones the rope slips by 1 mm at 0.8 of the limit.

The corners of the polygon are not corrected by a factor; links of 0.3 and 0.6 radii lose 1.1 and 4.0 % in half a turn.
"""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import hyperflex as hf
from tests.reference.wrapping import laid

RADIUS, ROPE, DENSITY = 0.02, 0.0025, 0.0625  # m, m, kg/m
AXIS = RADIUS + ROPE
THIN = 0.1 * ROPE  # m, radius of the capsules
BEGIN, HOLD = 0.5, 4.0  # s, until the pull is there, and for how long it is held
FROM, TO, RAMP = 0.6, 1.15, 8.0  # of the limit; s
SLIP, RATE = 1e-3, 1e-4  # m, m/s
MEAN = 0.05  # s, over which rates are taken
GONE = 0.05  # m, slip at which a run ends
SETTINGS = [  # l/R, cone, impratio, step, armature
    (0.3, "elliptic", 1.0, 5e-4, 0.0),
    (0.6, "pyramidal", 1.0, 5e-4, 0.0),
    (0.6, "elliptic", 1.0, 5e-4, 0.0),
    (0.6, "elliptic", 100.0, 5e-4, 0.0),
    (0.6, "elliptic", 100.0, 2e-4, 0.0),
    (0.3, "elliptic", 1.0, 5e-4, 1e-5),
    (0.3, "elliptic", 100.0, 5e-4, 1e-5),
    (0.3, "elliptic", 100.0, 2e-4, 1e-5),
]
NOTE = [
    "MuJoCo: the same chain as thin capsules, half a turn at mu = 0.3. Armature: inertia added to each hinge,",
    "without which short links chatter and the rope creeps, as the first row shows. Onset: slip of 1 mm beyond",
    "its position at four fifths of the limit, and a rate of 0.1 mm/s. Creep: the last 2 of 4 s at 0.5 and 0.95",
    "of it. inf: the rope runs off. Without a factor for its corners, the polygon should hold 0.979 and 0.950 with",
    "links of 0.3 and 0.6.",
    "",
    "| link / radius | cone | impratio | step, s | armature, kg m^2 | onset, 1 mm | 0.1 mm/s | creep, mm/s | 0.95 |",
    "|---|---|---|---|---|---|---|---|---|",
]


def rope(turns: float, mu: float, ratio: float) -> tuple[hf.Rope, hf.Peg]:
    """The paper's cable, as long as it must be, with links of `ratio` radii where it may wind."""
    peg, length = hf.Peg(0.0, 0.0, RADIUS, mu), 0.25 + 2.0 * math.pi * turns * AXIS
    coarse = hf.Rope.uniform(length, DENSITY * length, math.ceil(length / 0.04), ROPE, friction=5e-4, gravity=(0, 0))
    return hf.refine_rope(coarse, [peg], arm=hf.Arm(length=0.3, pivot=(-AXIS - 0.3, 0.1)), ratio=ratio), peg


def model(cable: hf.Rope, mu: float, swept: float, cone: str, impratio: float, step: float, armature: float) -> Any:
    """The compiled model: capsules laid round the cylinder, the first joint on a slider."""
    import mujoco

    axis = AXIS * (1.0 + 1e-6)
    q = laid(cable.length, (-axis, 0.1), axis, swept)
    solid = f'friction="{mu!r} 0 0" condim="3" solref="{4 * step!r} 1" solimp="0.99 0.999 0.0001"'
    bodies, before, drop = "", 0.0, 0.0
    for i in range(cable.n_links):
        size, mass, inertia = (float(getattr(cable, name)[i]) for name in ("length", "mass", "inertia"))
        bodies += (
            f'<body pos="0 0 {-drop!r}" euler="0 {-(float(q[i]) - before)!r} 0"><joint type="hinge" axis="0 -1 0" '
            f'damping="{float(cable.friction[i])!r}" armature="{armature!r}"/><inertial pos="0 0 {-0.5 * size!r}" '
            f'mass="{mass!r}" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 {-size!r}" size="{THIN!r}" contype="1" conaffinity="2" {solid}/>'
        )
        before, drop = float(q[i]), size
    bodies += f'<site name="tip" pos="0 0 {-drop!r}"/>' + "</body>" * cable.n_links
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 0" timestep="{step!r}" cone="{cone}" '
        f'impratio="{impratio!r}" integrator="implicitfast" iterations="200" tolerance="1e-12"/><worldbody>'
        f'<geom type="cylinder" fromto="0 -0.1 0 0 0.1 0" size="{AXIS - THIN!r}" contype="2" conaffinity="1" {solid}/>'
        f'<body pos="{-axis!r} 0 0.1"><joint name="pull" type="slide" axis="0 0 1" damping="0.1"/>'
        f'<inertial pos="0 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/>{bodies}</body></worldbody></mujoco>'
    )


def pulled(compiled: Any, swept: float, last: float, force: Callable[[float], float]) -> np.ndarray:
    """Displacement (steps,) of the tip against its pull of 1 N, m, while the slider is pulled by `force` (of time),
    N."""
    import mujoco

    data, tip = mujoco.MjData(compiled), compiled.site("tip").id
    pull, step = np.array([math.sin(swept), 0.0, -math.cos(swept)]), compiled.opt.timestep
    way = np.zeros(round(last / step))
    for k in range(way.size):
        data.qfrc_applied[:] = 0.0
        where = data.site_xpos[tip]
        mujoco.mj_applyFT(compiled, data, pull, np.zeros(3), where, compiled.nbody - 1, data.qfrc_applied)
        data.qfrc_applied[0] += force(k * step)
        mujoco.mj_step(compiled, data)
        way[k] = -float(data.site_xpos[tip] @ pull)
        if k > 10 and abs(way[k] - way[10]) > GONE:
            return way[: k + 1]
    return way


def held(compiled: Any, swept: float, limit: float, part: float) -> float:
    """Creep at a part of the limit over the last half of HOLD, mm/s; infinite if the rope runs off."""
    way = pulled(compiled, swept, HOLD, lambda t: 1.0 + (limit * part - 1.0) * min(1.0, t / BEGIN))
    steps = round(HOLD / compiled.opt.timestep)
    return 1e3 * abs(float(way[-1] - way[steps // 2])) / (0.5 * HOLD) if way.size == steps else math.inf


def measure(mu: float, turns: float, ratio: float, cone: str, impratio: float, step: float, armature: float) -> Any:
    """Onset in a ramp and creep of holds, for one setting."""
    swept, begin = 2.0 * math.pi * turns, time.process_time()
    limit, (cable, _) = math.exp(mu * swept), rope(turns, mu, ratio)
    compiled = model(cable, mu, swept, cone, impratio, step, armature)
    times, parts = [0.0, BEGIN, 2.0 * BEGIN, 2.0 * BEGIN + RAMP], [1.0 / limit, FROM, FROM, TO]
    way = pulled(compiled, swept, times[-1], lambda t: limit * float(np.interp(t, times, parts)))
    part = np.interp(np.arange(way.size) * step, times, parts)
    window = round(MEAN / step)
    begun = int(2.0 * BEGIN / step)
    rate = (way[window:] - way[:-window]) / MEAN
    fast = np.flatnonzero(rate[begun:] > RATE)
    eighty = int(np.searchsorted(part, 0.8))
    far = np.flatnonzero(way[eighty:] - way[min(eighty, way.size - 1)] > SLIP)
    return {
        "mu": mu,
        "turns": turns,
        "l/R": ratio,
        "cone": cone,
        "impratio": impratio,
        "step": step,
        "armature": armature,
        "onset over exp(mu theta)": float(part[eighty + far[0]]) if far.size else float(part[-1]),
        "at 0.1 mm/s": float(part[begun + window + fast[0]]) if fast.size else math.nan,
        "creep at 0.5, mm/s": held(compiled, swept, limit, 0.5),
        "creep at 0.95, mm/s": held(compiled, swept, limit, 0.95),
        "us a step": 1e6 * (time.process_time() - begin) / (times[-1] + 2.0 * HOLD) * step,
    }
