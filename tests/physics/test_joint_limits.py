"""Joint limits: closed forms of impacts and rest, momentum, energy, the hand-over to free flight, MuJoCo, refusals."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import SimulationError
from tests.core.helpers import rise
from tests.refusals import refuses

PASSED = 1e-3  # rad, the project's goal


def past(run: hf.Trajectory) -> float:
    """By how much a joint is past its limit at most, at the samples, rad."""
    rope = run.setup.rope
    bend = np.diff(run.q, axis=1, prepend=run.arm_angle[:, None]) - rope.rest_angle
    return float((np.abs(bend) - rope.max_bend).max())


def test_a_rod_that_falls_on_its_limit_stays_there():
    """It loses all it has, in one impact: half its weight times the height by which its end fell."""
    rod = hf.Rope(length=[1.0], mass=[0.1], rest_angle=0.5, max_bend=0.3)
    run = hf.simulate(rod, duration=1.0, q0=[0.75])
    fallen = 0.5 * 0.1 * 9.81 * (math.cos(0.2) - math.cos(0.75))
    assert run.contact_loss[-1] == pytest.approx(fallen, rel=1e-5)  # the flight's tolerance
    # J of the whole rod is 1/30 kg m^2: the rate that is left would be 1e-9 rad/s for 1e-6 of a micrometre a second.
    assert run.q[-1, 0] == pytest.approx(0.2, abs=1e-7)
    assert abs(run.qd[-1, 0]) < 1e-8
    assert run.attrs["contact_impacts"] == 1
    # It comes to the limit after 0.35 s: until then it is a rod without limits, except for the length of the last step.
    free = hf.simulate(rod.replace(max_bend=np.inf), duration=1.0, q0=[0.75], tol=1e-6)
    np.testing.assert_allclose(run.q[:30], free.q[:30], rtol=0, atol=1e-6)


def test_a_fold_that_snaps_keeps_its_angular_momentum():
    """Two links on a hinge, without weight: the impact leaves both turning as one, at L over the inertia of both."""
    rope = hf.Rope(length=[0.5, 0.3], mass=[0.1, 0.2], max_bend=[np.inf, 0.5], gravity=(0.0, 0.0))
    start, rates = np.array([0.0, 0.0]), np.array([1.0, 6.0])

    def inertia(bend):
        cross = 0.2 * 0.5 * 0.15 * math.cos(bend)
        own = rope.inertia + rope.mass * rope.com**2
        return np.array([[own[0] + 0.2 * 0.25, cross], [cross, own[1]]])

    momentum = (inertia(0.0) @ rates).sum()
    energy = 0.5 * rates @ inertia(0.0) @ rates
    run = hf.simulate(rope, duration=0.5, q0=start, qd0=rates)
    locked = momentum / inertia(0.5).sum()
    assert run.attrs["contact_impacts"] >= 1
    # The impact is the only one: then the turning pulls the fold open. The flight is right to 1e-5 m a step.
    assert run.contact_loss[-1] == pytest.approx(energy - 0.5 * momentum * locked, rel=1e-4)
    bends = run.q[:, 1] - run.q[:, 0]
    assert bends.max() == pytest.approx(0.5, abs=5e-3)  # at a sample, up to 5 ms from the impact
    kept = [(inertia(bend) @ w).sum() for bend, w in zip(bends, run.qd, strict=True)]
    np.testing.assert_allclose(kept, momentum, rtol=1e-5)


@pytest.mark.parametrize("n", [5, 20, 50])
def test_a_chain_dropped_on_its_limits_loses_energy_and_passes_none(n):
    """From the horizontal, with joints that bend by as much as makes half a circle of all of it."""
    limit = np.append(1.2, np.full(n - 1, math.pi / (2.0 * n)))
    rope = hf.Rope.uniform(1.0, 0.06, n, friction=2e-4, max_bend=limit, rest_angle=np.append(0.9, np.zeros(n - 1)))
    run = hf.simulate(rope, duration=1.0, q0=np.full(n, 1.5), qd0=np.linspace(0.0, -3.0, n))
    assert run.attrs["contact_impacts"] > 5
    assert run.contact_loss[-1] > 1e-3  # J, of 0.3 J that it falls by
    assert max(past(run), run.attrs["limit_passed"]) < PASSED
    assert rise(run.energy_error) < 1e-5
    assert rise(-run.contact_loss) < 1e-5
    assert run.attrs["contact_unsolved"] <= 0.005 * run.attrs["contact_steps"]


def test_a_cast_with_limits_and_pegs_keeps_the_goals():
    cable = hf.Rope.uniform(2.0, 0.125, 25, 0.0025, friction=5e-4).with_bend_radius(0.08)
    start, peg = np.linspace(1.2, 2.0, 25), hf.Peg(0.3, -0.9, 0.03, 0.3)
    motion = hf.arm_swings(t_move=0.73, t_rest=0.53)
    fine = hf.refine_rope(cable, [peg], arm=hf.Arm(length=0.105))
    run = hf.simulate(cable, motion, arm=hf.Arm(length=0.105), duration=1.5, pegs=[peg], q0=start)
    assert run.setup.rope == fine
    assert np.abs(run.contact_force).max() > 0.1  # it meets the peg
    assert run.contact_loss[-1] > 0.0
    assert max(past(run), run.attrs["limit_passed"]) < PASSED
    assert run.attrs["contact_deepest"] < 2e-4
    assert rise(run.energy_error) < 1e-5
    assert run.attrs["contact_unsolved"] <= 0.005 * run.attrs["contact_steps"]


def test_limits_that_are_not_reached_change_nothing():
    cable = hf.Rope.uniform(2.0, 0.125, 20, 0.0025, friction=5e-4)
    how = {"arm": hf.Arm(length=0.105), "duration": 3.0}
    free = hf.simulate(cable, hf.arm_swings(), **how)
    limited = hf.simulate(cable.replace(max_bend=np.append(np.inf, np.full(19, 3.0))), hf.arm_swings(), **how)
    assert limited.attrs["contact_steps"] == 0
    # The same steps by the same kernels. What lies within a step is read off it by free runs, and stepped to beside
    # limits: they differ by a part of the tolerance, 1e-5 m.
    np.testing.assert_allclose(limited.state.q, free.state.q, rtol=0, atol=1e-10)
    np.testing.assert_allclose(limited.joints, free.joints, rtol=0, atol=2e-6)


def test_a_bend_radius_stays_when_links_are_cut():
    rope = hf.Rope.uniform(1.0, 0.06, 10, friction=0.0).with_bend_radius(0.05)
    np.testing.assert_allclose(rope.max_bend[1:], 2.0 * math.atan(0.1 / 0.1), rtol=1e-14)
    fine = hf.refine_rope(rope, [hf.Peg(0.5, -0.5, 0.02)])
    again = fine.replace(max_bend=np.inf).with_bend_radius(0.05)
    np.testing.assert_allclose(fine.max_bend, again.max_bend, rtol=1e-12)
    assert fine.n_links > 50
    # Bent as far as it goes, a polygon's sides touch the circle of the bend radius in their middles.
    assert fine.length[20] / (2.0 * math.tan(0.5 * fine.max_bend[20])) == pytest.approx(0.05, rel=1e-12)


def test_a_batch_with_limits_is_the_runs_one_by_one():
    rope = hf.Rope.uniform(0.5, 0.03, 6, friction=1e-3, max_bend=np.append(np.inf, np.full(5, 0.2)))
    starts = np.array([np.full(6, 1.5), np.linspace(1.0, 1.8, 6)])
    batch = hf.simulate_batch(rope, duration=0.5, q0=starts, keep=("q",))
    for q0, q in zip(starts, batch.q, strict=True):
        run = hf.simulate(rope, duration=0.5, q0=q0, t_eval=[0.5])
        np.testing.assert_array_equal(run.q[-1], q[-1])


def test_a_stepper_and_a_torque_callback_meet_limits_too():
    rod = hf.Rope(length=[1.0], mass=[0.1], rest_angle=0.5, max_bend=0.3)
    setup = hf.Setup(rod, q0=[0.75], arm=hf.Arm(length=0.1))
    stepper = hf.Stepper(setup, command="acceleration")
    state = stepper.start()
    for _ in range(30):
        state = stepper.step(state, 0.0, dt=0.02)
    run = hf.simulate(setup, duration=0.6)
    np.testing.assert_allclose(state.q, run.q[-1], rtol=0, atol=1e-7)
    assert run.q[-1, 0] == pytest.approx(0.2, abs=1e-7)
    how = {"arm": hf.Arm(length=0.1, mass=1.0, inertia=1e5), "duration": 0.6, "q0": [0.75]}
    driven = hf.simulate(rod, torque=lambda *_: 0.0, control_rate=50.0, **how)
    np.testing.assert_allclose(driven.q[-1], run.q[-1], rtol=0, atol=1e-5)  # the arm yields a little
    refuses("joint limits", stepper.linearize, state, 0.0, dt=0.02)


def test_methods_without_impacts_report_it():
    rod = hf.Rope(length=[1.0], mass=[0.1], max_bend=0.6)
    refuses("joint 0 is bent", hf.simulate, rod, duration=1.0, q0=[0.7])
    refuses("acts on both links", hf.simulate, rod.replace(friction_model="printed"), duration=1.0, q0=[0.5])
    with pytest.raises(SimulationError, match="max_bend"):
        hf.sensitivities(rod.replace(rest_angle=0.4), wrt=["mass"], duration=1.0, q0=[0.9])
    with pytest.raises(SimulationError, match="max_bend"):
        hf.simulate(rod.replace(rest_angle=0.4), duration=1.0, q0=[0.9], until=hf.angle_reached(-1.0, 0))
    short = hf.sensitivities(rod, wrt=["mass"], duration=0.1, q0=[0.5])  # the limit is not reached
    assert np.isfinite(short.dq).all()
