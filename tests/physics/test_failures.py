"""Runs that cannot be trusted end in an error that says when, where and what to try, or hand over what holds."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput, SimulationError
from tests.refusals import fails, left_by, refuses

ARM = hf.Arm(length=0.105, inertia=1e-3)


def cable(**changes: object) -> hf.Rope:
    kept = {"length": 2.0, "mass": 0.125, "n_links": 10, "radius": 0.0025, "friction": 5e-4, **changes}
    return hf.Rope.uniform(**kept)


WILD = {
    "rates-beyond-number": {"qd0": np.full(10, 1e99)},
    "tolerance-beyond-rounding": {"qd0": np.linspace(-40, 40, 10), "tol": 1e-30},
}
COARSE = {"q0": np.linspace(3.0, 1.0, 10), "step": 0.03}  # stable for a hanging rope, not for a whip


@pytest.mark.parametrize("how", WILD.values(), ids=WILD.keys())
def test_a_hopeless_run_reports_when_where_and_what_to_try_or_returns_the_part_that_holds(how):
    with pytest.raises(SimulationError) as caught:
        hf.simulate(cable(), duration=1.0, **how)
    error = caught.value
    assert error.status == "step too small"
    assert 0.0 <= error.time < 1.0
    assert f"t = {error.time:.6g} s" in str(error)
    assert any(word in str(error) for word in ("Loosen", "Check", "Tighten"))
    run = hf.simulate(cable(), duration=1.0, throw=False, **how)
    assert run.status == "step too small"
    assert run.message
    assert run.t.size < 101
    assert np.isfinite(run.q).all()
    assert np.isfinite(run.qd).all()


def test_nothing_that_holds_is_an_empty_trajectory():
    run = hf.simulate(cable(), duration=1.0, qd0=np.full(10, 1e99), t_eval=[0.5], throw=False)
    assert run.t.shape == (0,)
    assert run.joints.shape == (0, 11, 2)
    assert run.energy_error.shape == (0,)
    assert "0 samples" in repr(run)


def test_a_run_that_gains_energy_is_refused():
    """RK4 inside its linear limit but far too coarse for a whip: the energy balance gives it away."""
    with pytest.raises(SimulationError, match="smaller step") as caught:
        hf.simulate(cable(friction=0.0), duration=10.0, **COARSE)
    part = hf.simulate(cable(friction=0.0), duration=10.0, throw=False, **COARSE)
    assert part.status == caught.value.status
    assert part.t.size < 1001
    scale = part.kinetic_energy.max() + np.ptp(part.potential_energy)
    assert np.abs(part.energy_error).max() < 0.1 * scale  # what is handed over keeps its balance
    assert part.state.t == part.t[-1]
    np.testing.assert_array_equal(part.state.q, part.q[-1])
    np.testing.assert_array_equal(part.state.qd, part.qd[-1])


@pytest.mark.parametrize("t_eval", [[0.65], [0.6, 0.65], None])
def test_energy_is_checked_whatever_output_is_requested(t_eval):
    rope = cable(friction=0.0)
    fails(SimulationError, "energy not balanced", hf.simulate, rope, duration=0.65, t_eval=t_eval, **COARSE)
    with pytest.raises(SimulationError):
        hf.simulate(rope, duration=10.0, t_eval=[10.0], **COARSE)  # fails before there is any output


def test_the_arm_of_a_failed_run_is_handed_over_too():
    kept = {"arm": ARM, "torque": 0.0, "duration": 0.1}
    part = hf.simulate(cable(), arm_angle0=0.7, arm_rate0=0.3, tol=1e-30, throw=False, **kept)
    assert part.status == "step too small"
    more = hf.simulate(cable(), state=part.state, **kept)
    assert (more.arm_angle[0], more.arm_rate[0]) == (part.arm_angle[-1], part.arm_rate[-1]) != (0.0, 0.0)


def test_fields_of_a_setup_are_replaced():
    setup = hf.Setup(cable(), arm=ARM, duration=1.0, q0=np.ones(10))
    run = hf.simulate(setup, hf.arm_swings(), duration=0.2, tol=1e-8)
    whole = hf.simulate(cable(), hf.arm_swings(), arm=ARM, duration=0.2, tol=1e-8, q0=np.ones(10))
    np.testing.assert_array_equal(run.q, whole.q)
    assert (run.setup.tol, run.setup.duration) == (1e-8, 0.2)
    refuses("a set-up does not know this key: got 'to1'", hf.simulate, setup, to1=1e-9)


def test_a_callback_that_returns_nonsense_is_named_with_its_time():
    def control(t, *_state):
        return float("nan") if t > 0.0495 else 0.0

    with pytest.raises(InvalidInput, match=r"torque callback at t = 0\.05 s.*nan"):
        hf.simulate(cable(), arm=ARM, torque=control, control_rate=100.0, duration=1.0)


def test_a_callback_needs_its_rate():
    refuses("control_rate", hf.simulate, cable(), arm=ARM, torque=lambda *_: 0.0, duration=1.0)
    refuses(r"control_rate.*-5", hf.simulate, cable(), arm=ARM, torque=lambda *_: 0.0, control_rate=-5.0, duration=1.0)


def test_the_torque_limit_is_kept():
    arm = hf.Arm(length=0.105, inertia=1e-3, torque_limit=0.02)
    asked = hf.simulate(cable(), arm=arm, torque=5.0, duration=0.5, tol=1e-8)
    held = hf.simulate(cable(), arm=hf.Arm(length=0.105, inertia=1e-3), torque=0.02, duration=0.5, tol=1e-8)
    np.testing.assert_allclose(asked.q, held.q, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(asked.motor_torque, 0.02)


def test_ctrl_c_without_throwing_keeps_what_was_done():
    def control(t, *_state):
        if t >= 0.3:
            raise KeyboardInterrupt
        return 0.0

    how = {"arm": ARM, "torque": control, "control_rate": 100.0, "duration": 1.0}
    run = hf.simulate(cable(), throw=False, **how)
    assert run.status == "interrupted"
    assert "0.3" in run.message
    assert run.t[-1] == pytest.approx(0.3, abs=0.011)  # the last sample of 10 ms before the key was pressed
    part = left_by(lambda: hf.simulate(cable(), **how))
    np.testing.assert_array_equal(part.q, run.q)
    assert part.status == "interrupted"


def test_the_callback_sees_the_state_and_its_torque_can_be_replayed():
    seen = []

    def control(t, angle, rate, q, qd):
        seen.append((t, angle, rate, q.copy(), qd.copy()))
        q[:] = np.nan  # the callback's copy: spoiling it must not spoil the run
        return 0.05 * np.sin(9.0 * t) - 0.01 * rate

    run = hf.simulate(cable(), arm=ARM, torque=control, control_rate=50.0, duration=1.0, t_eval=np.arange(51) * 0.02)
    assert len(seen) == 50
    for k in (0, 17, 49):
        assert seen[k][0] == pytest.approx(run.t[k], abs=1e-12)
        assert seen[k][1] == pytest.approx(run.arm_angle[k], abs=1e-12)
        np.testing.assert_allclose(seen[k][3], run.q[k], rtol=0, atol=1e-12)
    again = hf.simulate(run.setup, t_eval=run.t)
    # The same torques from a table: steps may differ where the run ends each period, so the tolerance sets this.
    np.testing.assert_allclose(again.tip, run.tip, rtol=0, atol=1e-4)
    np.testing.assert_allclose(again.motor_torque[:-1], run.motor_torque[:-1], rtol=0, atol=0)


def test_a_run_that_takes_too_long_is_ended():
    rope = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    still = {"duration": 1e4, "q0": np.full(50, 1.0), "t_eval": np.linspace(0.0, 1e4, 101)}
    with pytest.raises(SimulationError, match="out of time") as caught:
        hf.simulate(rope, time_budget=0.05, **still)
    assert 0.0 < caught.value.time < 1e4
    part = hf.simulate(rope, time_budget=0.05, throw=False, **still)
    assert part.status == "out of time"
    assert 0.0 < part.state.t < 1e4
    refuses("time_budget has the wrong sign", hf.simulate, rope, time_budget=0.0, **still)
