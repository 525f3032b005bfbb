"""The paper's cast in MuJoCo: plain hinges, relative angles, arm driven through a huge armature."""

from __future__ import annotations

import math

import mujoco
import numpy as np

import hyperflex as hf

ARMATURE = 1e5  # kg m^2: the rope's pull (about 1 N m) then disturbs the arm's acceleration by 1e-5 rad/s^2


def model(rope: hf.Rope, arm: hf.Arm, integrator: str, step: float) -> mujoco.MjModel:
    """Return a model of a uniform rope on an arm; angles about -y so that they agree with hyperflex's."""
    link = (
        '<body pos="0 0 {drop}"><joint type="hinge" axis="0 -1 0" damping="{damping}"/>'
        '<inertial pos="0 0 {com}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>'
    )
    bodies, drop = "", -arm.length
    for i in range(rope.n_links):
        bodies += link.format(
            drop=drop,
            damping=rope.friction[i],
            com=-rope.com[i],
            mass=rope.mass[i],
            inertia=rope.inertia[i],
        )
        drop = -rope.length[i]
    bodies += f'<site name="tip" pos="0 0 {drop}"/>' + "</body>" * rope.n_links
    xml = f"""<mujoco><option integrator="{integrator}" timestep="{step!r}" gravity="0 0 {rope.gravity[1]}">
      <flag contact="disable" constraint="disable"/></option><worldbody><body>
      <joint name="arm" type="hinge" axis="0 -1 0" armature="{ARMATURE}"/>
      <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>{bodies}</body></worldbody></mujoco>"""
    return mujoco.MjModel.from_xml_string(xml)


def cast(compiled: mujoco.MjModel, motion: hf.Motion, times: np.ndarray) -> np.ndarray:
    """Run the cast from rest and return the tip (T, 2) at `times`; switches must fall on whole steps."""
    data = mujoco.MjData(compiled)
    step = compiled.opt.timestep
    start = float(motion.angle(0.0))
    data.qpos[0] = start
    data.qpos[1] = -start  # relative angle: the rope hangs
    site = compiled.site("tip").id
    steps = [round(t / step) for t in times]
    middle = (np.arange(steps[-1]) + 0.5) * step
    force = ARMATURE * motion.acceleration(middle)
    tips, done = [], 0
    for last in steps:
        while done < last:
            data.qfrc_applied[0] = force[done]
            mujoco.mj_step(compiled, data)
            done += 1
        mujoco.mj_kinematics(compiled, data)
        x, _, z = data.site_xpos[site]
        tips.append((x, z))
    if not math.isfinite(tips[-1][0]):
        return np.full((len(steps), 2), np.nan)
    return np.array(tips)
