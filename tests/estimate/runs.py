"""Simulated runs of a finer rope, seen by its markers, and how far a filter is off."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.estimate import EstimatedParameter, Observations, RopeFilter

LENGTH, FINE, RATE = 2.0, 100, 600.0  # m; links of the truth; samples a second
ARM = hf.Arm(length=0.105)
SWINGS = hf.arm_swings(t_move=0.73, t_rest=0.53)


def rope(n: int = 50, scale: float = 1.0) -> hf.Rope:
    """The paper's cable with n links: friction of the joints grows as there are more of them."""
    bending = 5e-4 * n / 50
    cable = hf.Rope.uniform(length=LENGTH, mass=0.125, n_links=n, radius=0.0025, friction=bending)
    cable = cable.replace(friction=np.append(5e-4, np.full(n - 1, bending)))
    sizes = {"length": cable.length * scale, "com": cable.com * scale, "inertia": cable.inertia * scale**2}
    return cable.replace(**sizes)


@functools.cache
def free_swing(seed: int, duration: float = 8.0) -> hf.Trajectory:
    """A swing from 1.2 m beside the rest, bent by chance."""
    rng, s = np.random.default_rng(seed), np.linspace(0.0, 1.0, FINE)
    bend = 0.15 * rng.normal() * np.sin(np.pi * s) + 0.1 * rng.normal() * np.sin(2.0 * np.pi * s)
    q0 = np.arcsin(1.2 / LENGTH) + bend
    return hf.simulate(rope(FINE), duration=duration, q0=q0, t_eval=np.arange(0.0, duration, 1.0 / RATE))


@functools.cache
def pumped(duration: float = 9.0) -> hf.Trajectory:
    """The paper's swings, up to 15 m/s at the tip."""
    return hf.simulate(rope(FINE), SWINGS, arm=ARM, duration=duration, t_eval=np.arange(0.0, duration, 1.0 / RATE))


@dataclass
class Tracked:
    """A filter's run: errors of the tip and its velocity, before and after each update."""

    tracker: RopeFilter
    t: list[float] = field(default_factory=list)
    tip: list[Array] = field(default_factory=list)
    foretold: list[Array] = field(default_factory=list)
    velocity: list[Array] = field(default_factory=list)
    rates: list[Array] = field(default_factory=list)
    true_velocity: list[Array] = field(default_factory=list)
    true_rates: list[Array] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)

    def rms(self, name: str, since: float = 1.0, until: float = np.inf) -> float:
        """Root mean square of one of the lists between two times."""
        used = [value for t, value in zip(self.t, getattr(self, name), strict=True) if since <= t < until]
        return float(np.sqrt(np.mean([np.sum(np.square(value)) for value in used])))


def track(
    run: hf.Trajectory,
    *,
    n: int = 50,
    frames: float = 7.5,
    noise: float = 0.0015,
    markers: int = 10,
    on_tip: bool = True,
    occluded: float = 0.0,
    blackout: tuple[float, float] = (np.inf, np.inf),
    scale: float = 1.0,
    delay: float = 0.0,
    roll: float = 0.0,
    readout: float = 0.0,
    known_readout: float = 0.0,
    parameters: Sequence[EstimatedParameter] = (),
    moved: bool = False,
    seed: int = 0,
) -> Tracked:
    """Let a filter with n links follow a run of the finer rope; the picture is late, rolled or read row by row."""
    rng = np.random.default_rng((seed, 7))
    arcs = np.linspace(LENGTH / markers, LENGTH, markers) - (0.0 if on_tip else 0.5 * LENGTH / markers)
    joints, ends = np.asarray(run.joints), np.linspace(0.0, LENGTH, FINE + 1)
    base = {"motion": SWINGS, "arm": ARM} if moved else {}
    tracker = RopeFilter(rope(n, scale), arcs * scale, parameters=parameters, readout=known_readout, **base)
    result, rows = Tracked(tracker), np.linspace(-0.5, 0.5, markers)
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    for i in range(int(0.1 * RATE), run.t.size - int(0.1 * RATE), round(RATE / frames)):
        t = float(run.t[i])
        at = np.clip(t - delay + rows * readout, 0.0, run.t[-1]) * RATE
        low = np.minimum(at.astype(int), run.t.size - 2)
        part = at - low
        shapes = [np.stack([_at(joints[k], ends, s) for s, k in zip(arcs, low + d, strict=True)]) for d in (0, 1)]
        places = (1.0 - part)[:, None] * shapes[0] + part[:, None] * shapes[1]
        places = (places + noise * rng.normal(size=places.shape)) @ turn.T
        places[rng.random(markers) < occluded] = np.nan
        if blackout[0] <= t < blackout[1]:
            places[:] = np.nan
        if tracker.t is not None:
            tracker.predict_to(t)
        result.foretold.append(_tip(tracker)[0] - joints[i, -1] if tracker.t is not None else np.full(2, np.nan))
        tracker.update(Observations(t, places, noise, rows if readout else None))
        place, speed, covariance = _tip(tracker)
        q, qd = np.asarray(run.q[i]), np.asarray(run.qd[i])
        true_speed = np.asarray(run.tip_velocity[i])
        error = place - joints[i, -1]
        result.t.append(t)
        result.tip.append(error)
        result.velocity.append(speed - true_speed)
        result.true_velocity.append(true_speed)
        result.rates.append(tracker.state.qd - qd.reshape(n, -1).mean(axis=1))
        result.true_rates.append(qd.reshape(n, -1).mean(axis=1))
        result.nees.append(float(error @ np.linalg.solve(covariance, error)) / 2.0)
        assert np.isfinite(q).all()
    return result


def _at(joints: Array, ends: Array, s: float) -> Array:
    """Return the place (2,) at an arc length."""
    return np.array([np.interp(s, ends, joints[:, c]) for c in range(2)])


def _tip(tracker: RopeFilter) -> tuple[Array, Array, Array]:
    """Place and velocity of the tip as a filter has them, and the covariance of the place."""
    state, assumed = tracker.state, tracker.process.rope
    values = {name: value for name, (value, _) in tracker.values.items()}
    length = assumed.length * (1.0 + values.get("length", 0.0))
    place, speed, _ = tracker.process.base(state.t)
    across = np.stack([np.cos(state.q), np.sin(state.q)])
    along = np.stack([np.sin(state.q), -np.cos(state.q)])
    slope = np.concatenate([across * length, np.zeros_like(across)], axis=1)
    assert state.covariance is not None
    return place + along @ length, speed + across @ (length * state.qd), slope @ state.covariance @ slope.T
