"""Random set-ups that MuJoCo can say, and their tips there: for the test of MJCF files and its benchmark."""

import math
from pathlib import Path

import mujoco
import numpy as np

import hyperflex as hf
from hyperflex.simulation.rollouts import runge_kutta_limit
from tests.reference.dense import Real

DURATION = 2.0  # s


def draw(index: int, links: int) -> hf.Setup:
    """A rope without two equal links on an arm that moves, or follows a torque, or on a wall."""
    rng = np.random.default_rng(index)
    length, mass = rng.uniform(0.5, 1.5, (2, links)) / links
    rope = hf.Rope(
        length=length,
        mass=0.1 * mass,
        com=rng.uniform(0.3, 0.7, links) * length,
        friction=rng.uniform(0.5, 1.5, links) * 2e-3 / links,
        stiffness=rng.uniform(0.0, 1e-3, links),
        rest_angle=rng.uniform(-0.1, 0.1, links),
        tip_mass=0.02 * float(rng.integers(2)),
        gravity=(rng.uniform(-1.0, 1.0), -9.81),
        radius=0.003,
    )
    q0 = np.full(links, rng.uniform(-0.5, 0.5))
    place = (rng.uniform(-1.0, 1.0), rng.uniform(0.0, 1.0))
    if index % 3 == 0:
        motion = hf.move_arm(0.0, rng.uniform(-1.0, 1.0), 0.5)
        return hf.Setup(rope, motion, hf.Arm(length=0.1, pivot=place), q0=q0, duration=DURATION, tol=1e-7)
    if index % 3 == 1:
        arm = hf.Arm(length=0.2, inertia=2e-3, mass=0.1, com=0.05, friction=0.01, pivot=place)
        torque = hf.torque_profile([0.0, 2.0], [0.1, -0.1])
        return hf.Setup(
            rope, arm=arm, torque=torque, q0=q0, arm_angle0=0.2, arm_rate0=-0.1, tol=1e-7, duration=DURATION
        )
    return hf.Setup(rope, q0=q0, qd0=rng.uniform(-1.0, 1.0, links), duration=DURATION, tol=1e-7)


def load(path: Path) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The compiled model of a file, and its state at the start."""
    model = mujoco.MjSpec.from_file(str(path)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    return model, data


def tip(setup: hf.Setup, path: Path) -> Real:
    """Where MuJoCo has the tip (2,) at the end, m, with Runge-Kutta steps that no switch of the motion cuts."""
    model, data = load(path)
    longest = min(1e-3, 0.8 * runge_kutta_limit(setup.chain()))
    steps = 4 * math.ceil(0.25 * DURATION / longest)  # a switch at a quarter falls on a step
    model.opt.timestep, model.opt.integrator = DURATION / steps, mujoco.mjtIntegrator.mjINT_RK4
    middles = (np.arange(steps) + 0.5) * model.opt.timestep
    control = np.zeros(steps)
    if setup.motion is not None:
        control = setup.motion.acceleration(middles)
    elif setup.torque is not None:
        control = setup.torque.torque(middles)
    for value in control:
        if model.nu:
            data.ctrl[0] = value
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    return data.site("tip").xpos[[0, 2]].copy()
