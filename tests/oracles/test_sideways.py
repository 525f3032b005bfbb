"""A cast begun out of its plane, in MuJoCo: pairs of hinges as in the model, and ball joints, free to twist."""

import math

import mujoco
import numpy as np
import pytest

import hyperflex as hf
from tests.reference.sideways import hinges

ARM = 1e5  # kg m^2: the rope then disturbs the arm by 1e-5 rad/s^2
STEP = 2.5e-4  # s, of Runge-Kutta's method


def flown(setup: hf.Setup, tilt: float, ball: bool) -> np.ndarray:
    """Tips (T, 3), m, every 0.1 s."""
    rope, arm = setup.rope, setup.arm
    bodies, drop = "", -arm.length
    for length, mass, com, inertia, friction in zip(
        rope.length, rope.mass, rope.com, rope.inertia, rope.friction, strict=True
    ):
        kinds = ['type="ball"'] if ball else ['type="hinge" axis="0 -1 0"', 'type="hinge" axis="1 0 0"']
        joints = "".join(f'<joint {kind} damping="{friction}"/>' for kind in kinds)
        thin = f'diaginertia="{inertia} {inertia} {(0.1 if ball else 1e-3) * inertia}"'  # friction makes spin stiff
        bodies += f'<body pos="0 0 {drop}">{joints}<inertial pos="0 0 {-com}" mass="{mass}" {thin}/>'
        drop = -length
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 -9.81" timestep="{STEP}" integrator="RK4"/><worldbody><body>'
        f'<joint type="hinge" axis="0 -1 0" armature="{ARM}"/><inertial pos="0 0 0" mass="1e-6" '
        f'diaginertia="1e-9 1e-9 1e-9"/>{bodies}<site name="tip" pos="0 0 {drop}"/>'
        f"{'</body>' * rope.n_links}</body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    steps = round(setup.duration / STEP)
    t = STEP * np.arange(steps + 1)
    angle, rate = setup.motion.angle(t), setup.motion.rate(t)
    pull = ARM * setup.motion.acceleration(t + 0.5 * STEP)
    first, second = hinges(angle[0], np.zeros(1), np.array([tilt]))[0]
    place = [first, second]
    if ball:  # the turn of the first hinge, then that of the second
        turns = np.zeros((2, 4)), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turns[0][0], np.array([0.0, -1.0, 0.0]), first)
        mujoco.mju_axisAngle2Quat(turns[0][1], np.array([1.0, 0.0, 0.0]), second)
        mujoco.mju_mulQuat(turns[1], *turns[0])
        place = turns[1].tolist()
    data.qpos[1 : 1 + len(place)] = place
    found = []
    for k in range(steps + 1):
        data.qpos[0], data.qvel[0], data.qfrc_applied[0] = angle[k], rate[k], pull[k]
        if k % round(0.1 / STEP) == 0:
            mujoco.mj_kinematics(model, data)
            found.append(data.site("tip").xpos.copy())
        mujoco.mj_step(model, data)
    return np.array(found)


@pytest.mark.parametrize("ball", [False, True])
def test_a_cast_of_twelve_links(ball):
    rope = hf.Rope.uniform(length=1.2, mass=0.07, n_links=12, radius=0.0025, friction=5e-4)
    t, tilt = 0.01 * np.arange(401), math.radians(0.5)
    setup = hf.Setup(rope, hf.arm_swings(t_move=0.6, t_rest=0.35), hf.Arm(length=0.105), duration=4.0)
    run = hf.simulate(setup, t_eval=t)
    want, got = flown(setup, tilt, ball), hf.sideways(run, tilt=tilt).tip[::10]
    np.testing.assert_allclose(run.tip[::10], want[:, [0, 2]], atol=2e-3)  # the planar runs agree
    # The angles' squares are left out (2 % of the greatest here), and with balls the joints may twist.
    np.testing.assert_allclose(got, want[:, 1], atol=(0.08 if ball else 0.04) * np.abs(want[:, 1]).max())
    assert np.abs(run.tip[:, 0]).max() > 0.6
