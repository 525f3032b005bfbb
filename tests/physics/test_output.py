"""What is written between steps is as good as the steps: every quantity, also just after the arm's motion switches."""

import numpy as np
import pytest

import hyperflex as hf

# every 2.5 ms, and right behind the switches at 0, 0.365, 0.73, 1.26 s
T = np.sort(np.concatenate([np.arange(0.0, 1.5, 0.0025), [1e-4, 0.3651, 0.7301, 0.7302, 1.2601]]))
T = T[np.append(True, np.diff(T) > 1e-9)]


def cast(n: int, tol: float) -> hf.Trajectory:
    rope = hf.Rope.uniform(length=2.0, mass=0.125, n_links=n, radius=0.0025, friction=5e-4)
    return hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.105), duration=1.5, t_eval=T, tol=tol)


# A hundredfold margin over the step's 1e-7 m (of which some forty add up) in position; rates and accelerations follow
# from the fastest friction mode, 4 eta / J = 6e3 /s at n = 50, 64 times that at n = 200; the torque's size is 0.2 N m.
@pytest.mark.parametrize(("n", "qd", "qdd", "torque"), [(50, 1e-3, 1.0, 1e-5), (200, 3e-3, 100.0, 2e-4)])
def test_every_quantity_between_steps(n, qd, qdd, torque):
    fine, run = cast(n, 1e-10), cast(n, 1e-7)
    np.testing.assert_allclose(run.tip, fine.tip, rtol=0, atol=1e-5)
    np.testing.assert_allclose(run.qd, fine.qd, rtol=0, atol=qd)
    np.testing.assert_allclose(run.qdd, fine.qdd, rtol=0, atol=qdd)
    np.testing.assert_allclose(run.motor_torque, fine.motor_torque, rtol=0, atol=torque)
    assert np.abs(run.energy_error).max() < 1e-6  # J, of 0.5 J


def test_samples_do_not_change_the_run():
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=10, friction=1e-4)
    many = hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(0.1), duration=1.5, t_eval=T)
    few = hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(0.1), duration=1.5, t_eval=T[[0, -1]])
    np.testing.assert_array_equal(many.state.q, few.state.q)
