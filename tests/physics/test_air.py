"""Air drag: closed forms, whole motions against the dense equations with quadrature, energy, derivatives, contact."""

from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from tests.reference.arm import bang_bang_swings, cast, links_of, still
from tests.reference.dense import Real

ARM = hf.Arm(length=0.105)


def airy(n: int = 3, **changes: object) -> hf.Rope:
    """A short chain of different links in dense air, which absorbs more energy than the joints."""
    grow = np.linspace(1.0, 1.6, n)
    rope = hf.Rope(
        length=0.25 * grow,
        mass=0.05 / grow,
        com=0.1 * grow,
        inertia=2e-4 * grow,
        friction=5e-4 * grow,
        stiffness=0.03 * grow,
        rest_angle=0.2 * grow,
        drag=0.02 * grow,
        tip_mass=0.02,
        gravity=(1.0, -9.0),
    )
    return rope.replace(**changes)


def test_a_link_slows_down_as_the_closed_form_says():
    """J w' = -c l^4 / 4 w^2 without gravity: w = w0 / (1 + c l^4 w0 t / 4 J), and q its integral."""
    length, mass, drag, w0 = 0.8, 0.1, 0.03, 7.0
    rope = hf.Rope(length=[length], mass=[mass], drag=drag, gravity=(0.0, 0.0))
    rate = drag * length**4 * w0 / (4.0 * mass * length**2 / 3.0)
    t = np.linspace(0.5, 5.0, 10)
    run = hf.simulate(rope, duration=5.0, qd0=[w0], t_eval=t, tol=1e-12)
    # 1e-12 m a step and some dozen steps; a thousandth of a turn would be another law.
    np.testing.assert_allclose(run.qd[:, 0], w0 / (1.0 + rate * t), rtol=1e-9, atol=0.0)
    np.testing.assert_allclose(run.q[:, 0], w0 / rate * np.log1p(rate * t), rtol=1e-9, atol=0.0)


def falling(speed: float) -> hf.Motion:
    """A point that falls at a constant speed, m/s, for 2 s."""
    coef = np.zeros((1, 4, 6))
    coef[0, 2, 1] = -speed
    return hf.Motion(np.array([0.0, 2.0]), coef, np.array([True, True]))


def test_a_level_rope_falls_at_its_terminal_velocity():
    """Air carries each link's weight at sqrt(m g / (c l)): the rope stays straight without a force at its end."""
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=8, friction=1e-4, drag=0.01)
    speed = float(np.sqrt(rope.mass[0] * 9.81 / (rope.drag[0] * rope.length[0])))
    t = np.linspace(0.0, 1.0, 5)
    fall = falling(speed)
    run = hf.simulate(rope, fall, duration=1.0, q0=np.full(8, np.pi / 2), t_eval=t, tol=1e-9)
    # An equilibrium that nothing holds: rounding of its weight, 1e-16 of 10 m/s^2, turns it and grows.
    np.testing.assert_allclose(run.q, np.pi / 2, rtol=0.0, atol=1e-11)
    fell = rope.total_mass * 9.81 * speed
    np.testing.assert_allclose(run.dissipated_energy, fell * t, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(run.motor_work, 0.0, rtol=0.0, atol=1e-11)
    ends = hf.simulate(rope, falling(0.9 * speed), duration=1.0, q0=np.full(8, np.pi / 2), t_eval=[0.05], tol=1e-9).q[0]
    assert ends[0] < np.pi / 2 - 1e-2  # too slow for the air to bear it, it falls ahead of its end


@pytest.mark.parametrize(("n", "friction_model"), [(1, "printed"), (3, "relative")])
def test_a_cast_in_air_is_that_of_the_dense_equations(n, friction_model):
    rope = airy(n, friction_model=friction_model)
    stretches = list(bang_bang_swings(0.4, 0.3, 1.7))
    want = cast(links_of(rope), 0.105, stretches, 0.3 * np.ones(n), np.zeros(n))
    times = np.array([stretch.end for stretch in stretches])
    run = hf.simulate(
        rope, hf.arm_swings(0.4, 0.3), arm=ARM, duration=1.7, q0=0.3 * np.ones(n), t_eval=times, tol=1e-11
    )
    # As without air: 1e-11 m a step, a few hundred steps, links of 0.25 m.
    np.testing.assert_allclose(run.q, want[:, :n], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(run.qd, want[:, n:], rtol=0.0, atol=1e-6)
    assert np.abs(run.energy_error).max() < 1e-8 * run.kinetic_energy.max()
    vacuum = hf.simulate(rope.replace(drag=0.0), hf.arm_swings(0.4, 0.3), arm=ARM, duration=1.7, q0=0.3 * np.ones(n))
    assert np.abs(vacuum.q[-1] - run.q[-1]).max() > 0.01  # the air is no trifle here
    steps = hf.simulate(
        rope, hf.arm_swings(0.4, 0.3), arm=ARM, duration=0.4, q0=0.3 * np.ones(n), step=2e-4, t_eval=[0.4]
    )
    # Runge and Kutta's own error at that step; to 1e-7 both integrate the same.
    np.testing.assert_allclose(steps.q[0], want[1, :n], rtol=0.0, atol=1e-7)


def test_a_batch_is_its_runs():
    """Members with and without air side by side: none feels the others'."""
    ropes = [airy(drag=drag) for drag in (0.0, 0.02, 0.05, 0.0, 0.01)]
    t = np.array([0.5, 1.2])
    options: dict[str, Any] = {"arm": ARM, "duration": 1.2, "t_eval": t, "tol": 1e-10}
    batch = hf.simulate_batch(ropes, hf.arm_swings(0.4, 0.3), keep=["q", "dissipated_energy"], **options)
    for m, rope in enumerate(ropes):
        run = hf.simulate(rope, hf.arm_swings(0.4, 0.3), **options)
        # Other orders and steps at the same tolerance.
        np.testing.assert_allclose(batch.q[m], run.q, rtol=0.0, atol=1e-7)
        np.testing.assert_allclose(batch.dissipated_energy[m], run.dissipated_energy, rtol=1e-6)
    alone = hf.simulate_batch(ropes[:1], hf.arm_swings(0.4, 0.3), keep=["q"], **options)
    np.testing.assert_array_equal(alone.q[0], batch.q[0])


@pytest.mark.nightly
def test_derivatives_are_those_of_the_dense_equations():
    rope, n = airy(), 3
    stretches = list(bang_bang_swings(0.4, 0.3, 0.4))

    def ends(drag=0.0, one=0.0, length=0.0, arm=0.0, q0=0.0):
        changed = rope.replace(drag=rope.drag + drag + one * np.eye(n)[1], length=rope.length + length)
        start = np.full(n, 0.3) + q0 * np.eye(n)[0]
        end: Real = cast(links_of(changed), 0.105 + arm, stretches, start, np.zeros(n), tol=1e-12)[-1]
        return end

    wrt = {"drag": "drag", "one": "drag[1]", "length": "length", "arm": "arm.length", "q0": "q0[0]"}
    how = {"arm": ARM, "duration": 0.4, "q0": np.full(n, 0.3), "t_eval": [0.4], "tol": 1e-11}
    run = hf.sensitivities(rope, hf.arm_swings(0.4, 0.3), wrt=wrt.values(), **how)
    for k, name in enumerate(wrt):
        gap = 2e-5
        want = (ends(**{name: gap}) - ends(**{name: -gap})) / (2.0 * gap)
        got = np.concatenate([run.dq[-1, :, k], run.dqd[-1, :, k]])
        # Truncation of the differences, (2e-5)^2 of the third derivative.
        np.testing.assert_allclose(got, want, rtol=0.0, atol=1e-6 * np.abs(want).max(), err_msg=name)


def test_derivatives_between_steps_and_with_respect_to_drag_where_there_is_none():
    """Along the run's own outputs, and at a drag of 0, towards more."""
    rope, t = airy(drag=0.0), np.linspace(0.0, 0.5, 8)
    options: dict[str, Any] = {"arm": ARM, "duration": 0.5, "t_eval": t, "tol": 1e-11}
    run = hf.sensitivities(rope, hf.arm_swings(0.4, 0.3), wrt=["drag", "motion.t_move"], **options)
    more = [hf.simulate(rope.replace(drag=gap), hf.arm_swings(0.4, 0.3), **options).q for gap in (1e-5, 2e-5)]
    none = hf.simulate(rope, hf.arm_swings(0.4, 0.3), **options).q
    want = (4.0 * more[0] - more[1] - 3.0 * none) / 2e-5
    # A one-sided difference of second order: (1e-5)^2 of the third derivative, and the run's 1e-10 over 1e-5. Steps of
    # a run without drag do not see where the wind on a link changes its sign: 4e-5 to 6e-5, with any gap and tolerance.
    np.testing.assert_allclose(run.dq[:, :, 0], want, rtol=0.0, atol=1e-4 * np.abs(want).max())


def test_a_driven_arm_feels_the_air_on_its_rope():
    """The torque accelerates the arm; the loss to the air closes the balance."""
    arm = hf.Arm(length=0.2, inertia=1e-3, mass=0.05, com=0.1)
    torque = hf.torque_profile([0.0, 0.5, 1.0], [0.05, -0.03, 0.02])
    run = hf.simulate(airy(), arm=arm, torque=torque, duration=1.0, tol=1e-10)
    # Between steps work and loss follow a polynomial of degree 5, 1e-7 off; at the end of the run there is none.
    assert np.abs(run.energy_error).max() < 1e-6 * run.kinetic_energy.max()
    assert abs(run.energy_error[-1]) < 1e-8 * run.kinetic_energy.max()
    assert run.dissipated_energy[-1] > 0.0


def test_contact_steps_take_the_same_air():
    """Beside a peg that nothing touches the other stepper is at work; its steps are of second order."""
    rope = airy(friction=2e-3, stiffness=0.0, rest_angle=0.0, radius=0.002)
    near = hf.Peg(x=0.0, y=-1.2, radius=0.05)
    motion = hf.arm_swings(0.4, 0.3)
    options: dict[str, Any] = {"arm": ARM, "duration": 0.5, "t_eval": [0.25, 0.5]}
    free = hf.simulate(rope, motion, tol=1e-10, **options)
    gaps = []
    for step in (2e-4, 1e-4):
        run = hf.simulate(rope, motion, pegs=[near], contact_step=step, **options)
        gaps.append(np.abs(run.q - free.q).max())
        assert np.abs(run.energy_error).max() < 1e-4 * run.kinetic_energy.max()
        np.testing.assert_allclose(run.dissipated_energy, free.dissipated_energy, rtol=1e-3)
    assert gaps[0] < 1e-3
    vacuum = hf.simulate(rope.replace(drag=0.0), motion, pegs=[near], **options)
    assert np.abs(vacuum.q - free.q).max() > 100.0 * gaps[0]


def test_a_link_falls_onto_the_ground_through_air():
    """No energy is gained: the link's energy is lost to the air, to its joint and to the ground."""
    rope = hf.Rope(length=[0.5, 0.5], mass=[0.05, 0.05], friction=1e-4, drag=0.05, radius=0.005)
    run = hf.simulate(rope, duration=1.5, q0=[np.pi / 2, np.pi / 2], pegs=[hf.Ground(x=0.0, y=-0.3)])
    energy = run.kinetic_energy + run.potential_energy
    assert run.dissipated_energy[-1] == pytest.approx(energy[0] - energy[-1], rel=1e-3)
    assert run.contact_loss is not None
    assert run.contact_loss[-1] > 0.0


def test_air_in_a_still_chain_is_nothing():
    run = hf.simulate(airy(rest_angle=0.0, gravity=(0.0, -9.81)), duration=0.5)
    np.testing.assert_array_equal(run.q, 0.0)
    np.testing.assert_array_equal(run.dissipated_energy, 0.0)
    want = cast(links_of(airy(2)), 0.0, still(0.5), np.array([1.0, -1.0]), np.zeros(2))
    got = hf.simulate(airy(2), duration=0.5, q0=[1.0, -1.0], t_eval=[0.5], tol=1e-11)
    np.testing.assert_allclose(got.q[0], want[-1, :2], rtol=0.0, atol=1e-8)
