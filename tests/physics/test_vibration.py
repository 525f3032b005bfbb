"""Fast undamped vibration: hundreds of short steps, whose errors last, must not add up to more than `tol` allows."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from tests.reference.random_ropes import draw

N, DURATION, SHARE = 8, 0.1, 0.02
START = np.sin(2.1 * np.arange(1, N + 1))


@pytest.mark.parametrize(("stiffness", "size"), [(5.0, 0.05), (50.0, 0.1)])
@pytest.mark.parametrize("tol", [1e-5, 1e-6])
def test_errors_of_short_steps_do_not_add_up(stiffness, size, tol):
    rope = hf.Rope.uniform(length=0.3, mass=0.1, n_links=N, stiffness=stiffness, friction=0.0)
    how = {"duration": DURATION, "q0": size * START, "t_eval": np.linspace(0.01, DURATION, 10)}
    truth = hf.simulate(rope, tol=tol / 300, **how)
    # Perturbations of these runs do not grow. So: tol in each of 5 shares of 20 ms, all errors of one sign.
    bound = tol * DURATION / SHARE
    assert np.linalg.norm(hf.simulate(rope, tol=tol, **how).joints - truth.joints, axis=2).max() < bound
    batch = hf.simulate_batch(rope, tol=tol, keep=["tip"], **how)
    assert np.linalg.norm(batch.tip[0] - truth.tip, axis=1).max() < bound


def test_friction_that_settles_at_once_is_no_hindrance_at_a_tight_tolerance():
    """Relative rates die within a microsecond: there the share of `tol` that a step may err by is below rounding."""
    setup = replace(draw(1, 9).setup, duration=0.1)  # 48 tapered links, up to 4 eta / J = 3e7 /s
    run, fine = (hf.simulate(replace(setup, tol=tol), t_eval=[0.05, 0.1]) for tol in (1e-8, 1e-9))
    # Five shares of 20 ms, in each of which joints may err by tol.
    assert np.linalg.norm(run.joints - fine.joints, axis=2).max() < 5 * 1e-8
