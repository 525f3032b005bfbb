"""Errors of single steps against the allowed ones: chains without friction whose links rotate fast."""

from typing import NamedTuple

import numpy as np

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.integrate.step_size import STEP_SIZE
from hyperflex.simulation.rollouts import Rollout, lever

TIGHT = 1e-11  # m, so that the error of the comparison is a millionth of that of the steps


class Step(NamedTuple):
    """A step of a run: its begin and end, s, and the states there, angles above rates and sums."""

    t: float
    y: Array
    end: float
    reached: Array


def wild(seed: int, n: int, tol: float, *, stiff: bool = False) -> hf.Setup:
    """A chain of n unlike links, thrown out of a random posture; `stiff`: with springs in its joints."""
    rng = np.random.default_rng(seed)
    length, mass = rng.uniform(0.05, 0.6, n), rng.uniform(5e-3, 0.1, n)
    com, inertia = length * rng.uniform(0.15, 0.8, n), mass * length**2 * rng.uniform(5e-3, 0.12, n)
    q0, qd0 = rng.normal(0.0, 1.2, n), rng.normal(0.0, 3.0, n)
    stiffness = rng.uniform(2e-3, 0.02, n) if stiff else 0.0
    rope = hf.Rope(length=length, mass=mass, com=com, inertia=inertia, friction=0.0, stiffness=stiffness)
    return hf.Setup(rope, q0=q0, qd0=qd0, tol=tol, duration=0.8)


def steps(setup: hf.Setup) -> list[Step]:
    """The steps of a run."""
    run, found = Rollout(setup, np.array([0.0, setup.duration])), list[Step]()
    run.limits = run.limits._replace(budget=1)
    while run.time < setup.duration:
        t, y = run.time, run.progress.y.copy()
        run.advance()
        if run.time > t:
            found.append(Step(t, y, run.time, run.progress.y.copy()))
    return found


def error(setup: hf.Setup, step: Step) -> float:
    """Error of a step in units of the allowed error: of the joints' positions, or of their velocities over their
    duration."""
    n, size = setup.rope.n_links, step.end - step.t
    exact = Rollout(setup.replace(tol=TIGHT), np.array([step.t, step.end]), (step.y[:n], step.y[n : 2 * n]))
    exact.complete()
    place, speed = apart(setup, step.reached, exact.y[-1])
    lasting = np.sqrt(size * max(size, STEP_SIZE.share))
    return float(max(place, lasting * speed)) / (setup.tol * min(1.0, size / STEP_SIZE.share))


def apart(setup: hf.Setup, y: Array, other: Array) -> Array:
    """Distances of the worst joint (2,), m, and of its velocities, m/s, of two states that are near each other."""
    n = setup.rope.n_links
    off = (other - y)[: 2 * n].reshape(2, n, 1) * lever(setup.chain())[:, None]
    joints = np.cumsum(off * np.stack([np.cos(y[:n]), np.sin(y[:n])], axis=1), axis=1)
    return np.asarray(np.linalg.norm(joints, axis=2).max(axis=1))
