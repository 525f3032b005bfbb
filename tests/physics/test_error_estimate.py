"""Errors of single steps against what the step control allows: chains without friction whose links turn wildly."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.integrate.step_size import STEP_SIZE
from hyperflex.simulation.rollouts import Rollout, lever

TIGHT = 1e-11  # m, so that the comparison is a millionth as wrong as the steps that it judges
TOL = 1e-4


def wild(seed: int, n: int) -> hf.Setup:
    """A chain of n unlike links, thrown out of a random posture."""
    rng = np.random.default_rng(seed)
    length, mass = rng.uniform(0.05, 0.6, n), rng.uniform(5e-3, 0.1, n)
    com, inertia = length * rng.uniform(0.15, 0.8, n), mass * length**2 * rng.uniform(5e-3, 0.12, n)
    rope = hf.Rope(length=length, mass=mass, com=com, inertia=inertia, friction=0.0)
    return hf.Setup(rope, q0=rng.normal(0.0, 1.2, n), qd0=rng.normal(0.0, 3.0, n), tol=TOL, duration=0.8)


def steps(setup: hf.Setup) -> list[tuple[float, Array, float, Array]]:
    """Begin and end, s, of each step of a run, with the states there."""
    run, found = Rollout(setup, np.array([0.0, setup.duration])), []
    run.limits = run.limits._replace(budget=1)
    while run.time < setup.duration:
        t, y = run.time, run.progress.y.copy()
        run.advance()
        if run.time > t:
            found.append((t, y, run.time, run.progress.y.copy()))
    return found


def error(setup: hf.Setup, t: float, y: Array, end: float, reached: Array) -> float:
    """Error of a step in units of what is allowed: of the joints' positions, or of their velocities while they last."""
    n, step = setup.rope.n_links, end - t
    exact = Rollout(setup.replace(tol=TIGHT), np.array([t, end]), (y[:n], y[n : 2 * n]))
    exact.complete()
    off = (exact.y[-1] - reached)[: 2 * n].reshape(2, n, 1) * lever(setup.chain())[:, None]
    joints = np.cumsum(off * np.stack([np.cos(reached[:n]), np.sin(reached[:n])], axis=1), axis=1)
    place, speed = np.linalg.norm(joints, axis=2).max(axis=1)
    lasting = np.sqrt(step * max(step, STEP_SIZE.share))
    return float(max(place, lasting * speed)) / (setup.tol * min(1.0, step / STEP_SIZE.share))


@pytest.mark.parametrize(("seed", "n"), [(304, 2), (349, 3), (283, 5)])
def test_no_step_errs_by_much_more_than_is_allowed(seed: int, n: int) -> None:
    setup = wild(seed, n)
    # The estimate is that of a result of an order less. Steps too long for their series may err by more, a few times;
    # without the trend from order to order one of each of these runs erred by 9 to 56 times as much as allowed.
    assert max(error(setup, *each) for each in steps(setup)) < 6.0
