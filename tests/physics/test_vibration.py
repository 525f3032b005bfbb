"""Fast undamped vibration: hundreds of short steps, whose errors last, must not add up to more than `tol` allows."""

from __future__ import annotations

import numpy as np
import pytest

import hyperflex as hf

N, DURATION, SHARE = 8, 0.1, 0.02
START = np.sin(2.1 * np.arange(1, N + 1))


@pytest.mark.parametrize(("stiffness", "size"), [(5.0, 0.05), (50.0, 0.1)])
@pytest.mark.parametrize("tol", [1e-5, 1e-6])
def test_errors_of_short_steps_do_not_add_up(stiffness: float, size: float, tol: float) -> None:
    rope = hf.Rope.uniform(length=0.3, mass=0.1, n_links=N, stiffness=stiffness)
    how = {"duration": DURATION, "q0": size * START, "t_eval": np.linspace(0.01, DURATION, 10)}
    truth = hf.simulate(rope, tol=tol / 300, **how)
    # What nudges of these runs grow to stays below 1. So: tol in each of 5 shares of 20 ms, all errors of one sign.
    bound = tol * DURATION / SHARE
    assert np.linalg.norm(hf.simulate(rope, tol=tol, **how).joints - truth.joints, axis=2).max() < bound
    batch = hf.simulate_batch(rope, tol=tol, keep=["tip"], **how)
    assert np.linalg.norm(batch.tip[0] - truth.tip, axis=1).max() < bound
