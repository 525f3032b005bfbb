"""MuJoCo: plain hinges in relative angles, contacts and constraints off."""

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from cast import Cast, Contestant

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.exchange.mjcf import ROTOR
from hyperflex.simulation.rollouts import runge_kutta_limit

NAME = "MuJoCo"
ARM = (
    f"a hinge with an armature of {ROTOR:g} kg m^2 and the torque that gives it the arm's acceleration, constant "
    "between switches; every switch falls on a whole step, and one call takes all steps up to the next"
)
DRIVE = "torque on a heavy rotor"
# Sparse or dense Jacobian and the other disable flags changed nothing; `implicit` took six times as long as these.
FIRST_ORDER = (("implicitfast", 1e-3), ("Euler", 1.93e-4), ("implicitfast", 1.93e-4), ("implicitfast", 4.8e-5))


def model(rope: hf.Rope, arm: hf.Arm | None, integrator: str, step: float) -> mujoco.MjModel:
    """Return a model of a rope on an arm, or on a wall, contacts and constraints off."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rope.xml"
        hf.write_mjcf(hf.Setup(rope, arm=arm), path, timestep=step)
        compiled = mujoco.MjModel.from_xml_path(str(path))
    compiled.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    compiled.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return compiled


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
        data.ctrl[0] = part.acceleration
        mujoco.mj_step(compiled, data, nstep=steps)
        if part.output:
            mujoco.mj_kinematics(compiled, data)
            x, _, z = data.site_xpos[site]
            tips.append((x, z))
    return np.array(tips)


def contestants(cast: Cast, quick: bool) -> Iterator[Contestant]:
    """RK4 at its stability limit, and the first-order integrators with steps that friction does not limit."""
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
