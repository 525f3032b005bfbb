"""MuJoCo: plain hinges in relative angles, contacts and constraints off."""

from __future__ import annotations

import math
from collections.abc import Iterator

import mujoco
import numpy as np
from cast import Cast, Contestant

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.simulation.stability import runge_kutta_limit

NAME = "MuJoCo"
ARMATURE = 1e5  # kg m^2: the rope's pull (about 1 N m) then disturbs the arm's acceleration by 1e-5 rad/s^2
ARM = (
    f"a hinge with an armature of {ARMATURE:g} kg m^2 and the torque that gives it the arm's acceleration, constant "
    "between switches; every switch falls on a whole step, and one call takes all steps up to the next"
)
DRIVE = "torque on a heavy rotor"
# Sparse or dense Jacobian and the other disable flags changed nothing; `implicit` took six times as long as these.
FIRST_ORDER = (("implicitfast", 1e-3), ("Euler", 1.93e-4), ("implicitfast", 1.93e-4), ("implicitfast", 4.8e-5))


def model(rope: hf.Rope, arm: hf.Arm | None, integrator: str, step: float) -> mujoco.MjModel:
    """Return a model of a rope on an arm, or on a wall; hinges turn about -y, so that angles agree with hyperflex's."""
    link = (
        '<body pos="0 0 {drop!r}"><joint type="hinge" axis="0 -1 0" damping="{damping!r}"/>'
        '<inertial pos="0 0 {com!r}" mass="{mass!r}" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
    )
    bodies, drop = "", 0.0 if arm is None else -arm.length
    for i in range(rope.n_links):
        bodies += link.format(
            drop=drop,
            damping=float(rope.friction[i]),
            com=-float(rope.com[i]),
            mass=float(rope.mass[i]),
            inertia=float(rope.inertia[i]),
        )
        drop = -float(rope.length[i])
    bodies += f'<site name="tip" pos="0 0 {drop!r}"/>' + "</body>" * rope.n_links
    if arm is not None:
        bodies = (
            f'<body><joint name="arm" type="hinge" axis="0 -1 0" armature="{ARMATURE}"/>'
            f'<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>{bodies}</body>'
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option integrator="{integrator}" timestep="{step!r}" gravity="0 0 {float(rope.gravity[1])!r}">'
        f'<flag contact="disable" constraint="disable"/></option><worldbody>{bodies}</worldbody></mujoco>'
    )


def run(cast: Cast, compiled: mujoco.MjModel, longest: float) -> Array:
    """Return the tip (T, 2), with equal steps of at most `longest`, s, between switches."""
    data = mujoco.MjData(compiled)
    data.qpos[0] = float(cast.motion.angle(0.0))
    data.qpos[1] = -data.qpos[0]  # relative angle: the rope hangs
    site = compiled.site("tip").id
    tips = []
    for part in cast.stretches():
        steps = math.ceil((part.end - part.start) / longest - 1e-9)
        compiled.opt.timestep = (part.end - part.start) / steps
        data.qfrc_applied[0] = ARMATURE * part.acceleration
        mujoco.mj_step(compiled, data, nstep=steps)
        if part.output:
            mujoco.mj_kinematics(compiled, data)
            x, _, z = data.site_xpos[site]
            tips.append((x, z))
    return np.array(tips)


def contestants(cast: Cast, quick: bool) -> Iterator[Contestant]:
    """RK4 at the edge of stability, and the first-order integrators with steps that friction does not limit."""
    edge = 0.99 * runge_kutta_limit(cast.rope.chain())
    settings = [("RK4", edge), ("RK4", 0.8 * edge), *FIRST_ORDER]
    for integrator, step in settings[:1] if quick else settings:
        compiled = model(cast.rope, cast.arm, integrator, step)
        yield Contestant(
            NAME,
            integrator,
            f"dt {step:.3g} s",
            lambda c=compiled, s=step: run(cast, c, s),
        )
