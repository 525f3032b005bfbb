"""Dry friction against stiff scipy integration of the dense reference's law: signs change sharply, and may stick."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hyperflex as hf

DRY, LENGTH, MASS = 5e-3, 0.5, 0.1
T = np.linspace(0.0, 1.5, 16)


def pendulum(dry_rate: float) -> hf.Rope:
    return hf.Rope(length=[LENGTH], mass=[MASS], dry_friction=DRY, dry_rate=dry_rate)


def reference(dry_rate: float) -> np.ndarray:
    """Angles (16,) of the same rod, from its own equation of motion."""
    inertia = MASS * LENGTH**2 / 3.0

    def slope(_: float, y: np.ndarray) -> list[float]:
        torque = -0.5 * MASS * 9.81 * LENGTH * np.sin(y[0]) - DRY * np.tanh(y[1] / dry_rate)
        return [y[1], torque / inertia]

    run = solve_ivp(slope, (0.0, T[-1]), [1.0, 0.0], method="Radau", rtol=1e-10, atol=1e-12, t_eval=T)
    return np.asarray(run.y[0])


# The swing reverses four times, and each reversal may cost a step's tolerance twice (as the joint sticks, and as it
# comes loose); the rest is the usual growth. At the coarse tolerance a reversal takes one step or two.
@pytest.mark.parametrize("dry_rate", [1e-3, 2e-2])
@pytest.mark.parametrize(("tol", "bound"), [(1e-5, 2e-3), (1e-6, 5e-5), (1e-8, 5e-8)])
def test_single_run(dry_rate: float, tol: float, bound: float) -> None:
    run = hf.simulate(pendulum(dry_rate), duration=1.5, q0=[1.0], t_eval=T, tol=tol)
    np.testing.assert_allclose(run.q[:, 0], reference(dry_rate), rtol=0, atol=bound)


def test_batch() -> None:
    batch = hf.simulate_batch([pendulum(1e-3)] * 2, duration=1.5, q0=[1.0], t_eval=T[1:], tol=1e-8, keep=("q",))
    np.testing.assert_allclose(batch.q[1, :, 0], reference(1e-3)[1:], rtol=0, atol=5e-8)


def test_a_stuck_joint_creeps_at_its_share_of_the_dry_rate() -> None:
    rope = hf.Rope(length=[LENGTH], mass=[MASS], dry_friction=0.2, dry_rate=1e-3)
    run = hf.simulate(rope, duration=10.0, q0=[0.5])
    load = 0.5 * MASS * 9.81 * LENGTH * np.sin(0.5)
    creep = 1e-3 * np.arctanh(load / 0.2)  # rad/s, where the smoothed law balances the weight
    # the load falls by 1 % on the way
    assert run.q[0, 0] - run.q[-1, 0] == pytest.approx(10.0 * creep, rel=2e-2)
