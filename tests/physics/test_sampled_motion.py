"""A motion through samples is smooth to the eye only: between two of them it is another polynomial."""

import numpy as np
import pytest

import hyperflex as hf

ROPE = hf.Rope.uniform(length=1.0, mass=0.1, n_links=3, friction=2e-3)
T = np.arange(0.0, 1.51, 0.05)


def noise(size: float) -> np.ndarray:
    return size * np.random.default_rng(3).uniform(-1.0, 1.0, T.size)


MOTIONS = {
    "sampled": (hf.sampled_motion(T, np.sin(5.0 * T) + noise(0.02)), hf.Arm(length=0.2)),
    "moving-point": (hf.moving_pivot(T, 0.2 * np.sin(5.0 * T) + noise(4e-3), noise(4e-3)), None),
}


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("tol", [1e-5, 1e-7])
def test_steps_do_not_run_across_samples(name, tol):
    motion, arm = MOTIONS[name]
    how = {"arm": arm, "duration": 1.5, "t_eval": [0.5, 1.0, 1.5]}
    run = hf.simulate(ROPE, motion, tol=tol, **how)
    # Runge and Kutta's step of 0.1 ms errs by some h^3 / 6 of the jump in the third derivative, 1e4 m/s^3: 2e-9 m.
    check = hf.simulate(ROPE, motion, step=1e-4, **how)
    # 75 shares of 20 ms, each of which may err by tol; in fact some ten times tol. A step across a sample: thousands.
    assert np.abs(run.joints - check.joints).max() < 75 * tol
