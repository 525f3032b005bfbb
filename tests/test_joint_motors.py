"""Motors in the joints of a rope: at the first joint, with an arm, and in inner joints."""

from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from tests.frozen import check
from tests.reference.motors import Pendulum, single
from tests.refusals import refuses

T = np.linspace(0.0, 2.0, 41)
TORQUES = np.stack([0.15 * np.sin(4.0 * T), 0.08 * np.cos(3.0 * T)], axis=1)  # N m
TWO = Pendulum((0.3, 0.25), (0.3, 0.2), (0.16, 0.12), (2e-3, 1e-3), (2e-3, 1e-3))
START: dict[str, Any] = {"q0": [0.4, -0.3], "qd0": [0.5, -1.0]}


def rope_of(pendulum: Pendulum, n: int = 2, **changes: Any) -> hf.Rope:
    names = {"length": "length", "mass": "mass", "com": "com", "inertia": "inertia", "friction": "viscous"}
    given = {name: getattr(pendulum, field)[:n] for name, field in names.items()}
    return hf.Rope(**{**given, **changes})


def torque_at(t: float) -> np.ndarray:
    return np.array([np.interp(t, T, column) for column in TORQUES.T])


def test_motors_in_both_joints():
    """Against equations in closed form; 1e-8: the reference's steps of 0.5 ms err by less, the run by its tolerance."""
    run = hf.simulate(rope_of(TWO), torque=hf.torque_profile(T, TORQUES), duration=2.0, t_eval=T, tol=1e-11, **START)
    want = TWO.run(T, torque_at, np.array(START["q0"]), np.array(START["qd0"]), 5e-4)
    np.testing.assert_allclose(np.column_stack([run.q, run.qd]), want, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.motor_torque[:-1], TORQUES[:-1, 0], atol=1e-12)  # which is 0 after its last sample
    gained = run.kinetic_energy + run.potential_energy - run.motor_work + run.dissipated_energy
    np.testing.assert_allclose(gained, gained[0], rtol=0, atol=1e-8)
    fixed = hf.simulate(rope_of(TWO), torque=hf.torque_profile(T, TORQUES), duration=2.0, t_eval=T, step=1e-3, **START)
    np.testing.assert_allclose(fixed.q, want[:, :2], rtol=0, atol=1e-7)


def test_a_motor_at_the_first_joint_needs_no_arm():
    rod = single(0.5, 0.6, 0.4, 0.01, viscous=0.02)
    push = hf.torque_profile(T, 5.0 * TORQUES[:, 0])
    run = hf.simulate(rope_of(rod, 1), torque=push, duration=2.0, t_eval=T, q0=[0.2], tol=1e-11)
    want = rod.run(T, lambda t: np.append(5.0 * torque_at(t)[0], 0.0), np.array([0.2, 0.0]), np.zeros(2), 5e-4)
    np.testing.assert_allclose(run.q[:, 0], want[:, 0], rtol=0, atol=1e-8)
    assert hf.Setup.loads(run.setup.dumps()).torque == run.setup.torque
    constant = hf.simulate(rope_of(rod, 1), torque=1.0, duration=0.5, tol=1e-9)
    assert constant.q[-1, 0] > 0.1


def test_the_arm_is_the_first_link():
    """A driven arm with a motor in the rope's first joint is a rope with a link more."""
    arm = hf.Arm(length=0.3, mass=0.3, com=0.16, inertia=2e-3, friction=2e-3)
    last = hf.Rope(length=[0.25], mass=[0.2], com=[0.12], inertia=[1e-3], friction=[1e-3])
    push, how = hf.torque_profile(T, TORQUES), {"duration": 2.0, "t_eval": T, "tol": 1e-11}
    one = hf.simulate(last, arm=arm, torque=push, q0=[-0.3], qd0=[-1.0], arm_angle0=0.4, arm_rate0=0.5, **how)
    two = hf.simulate(rope_of(TWO), torque=push, **START, **how)
    np.testing.assert_allclose(np.column_stack([one.arm_angle, one.q]), two.q, rtol=0, atol=1e-9)


def test_a_stuck_joint_transmits_what_its_motor_does_not_move():
    """Below its dry friction a motor in the second joint moves nothing, and above it does."""
    rods = rope_of(TWO, dry_friction=[0.0, 0.05], gravity=(0.0, 0.0))
    for size, moves in ((0.049, False), (0.051, True)):
        push = hf.torque_profile([0.0, 1.0], [[0.0, size], [0.0, size]])
        run = hf.simulate(rods, torque=push, duration=1.0, q0=[0.0, 0.0])
        assert bool(np.abs(run.q).max() > 1e-3) is moves


def setup(scale: float = 1.0, **rope: Any) -> hf.Setup:
    rods = rope_of(TWO, **rope)
    return hf.Setup(rods, torque=hf.torque_profile(T, scale * TORQUES), duration=1.5, tol=1e-5, **START)


@pytest.mark.parametrize("more", [{}, {"drag": [0.3, 0.2]}, {"dry_friction": [0.02, 0.01]}])
def test_derivatives(more):
    """By the constant of both motors, their delay, and friction: frozen steps, see tests/frozen.py."""
    whole = setup(**more).torque
    assert whole is not None
    check(lambda x: setup(1.0 + x, **more), {"constant": {"coef": whole.coef}}, 1e-5)
    if "drag" not in more:  # whose second derivative jumps, as differences feel
        check(lambda x: setup(**more, friction=[2e-3 + x, 1e-3]), "friction[0]", 1e-6)
    if not more:  # frozen steps end where the switches were
        check(lambda x: setup().replace(torque=whole.shifted(0.05 + x)), "torque.delay", 1e-5)


def test_refused():
    push = hf.torque_profile(T, TORQUES)
    rods = rope_of(TWO)
    refuses("more columns than there are joints", hf.Setup, rope_of(TWO, 1), torque=push)
    refuses("know the motor of the first joint alone", hf.Setup, rods, torque=push, pegs=[hf.Peg(0.5, -0.5, 0.1)])
    refuses("a torque callback needs an arm", hf.Setup, rods, torque=lambda *now: 0.0, control_rate=100.0)
    refuses(
        "a batch knows the motor of the first joint alone", hf.simulate_batch, [rods] * 2, torque=push, duration=0.1
    )
    refuses("joint", push.torque, 0.0, joint=2)
    refuses("motors in the rope's joints", hf.exchange.write_mjcf, hf.Setup(rods, torque=push), "never.xml")
