"""Simulated runs of a finer rope, seen by its markers, and how far a filter is off."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.estimate import Change, ChangeTests, EstimatedParameter, Observations, RopeFilter
from hyperflex.estimate.parameters import ParameterStates
from hyperflex.estimate.process import Disturbances, Process
from hyperflex.sensors import lever_arms
from hyperflex.simulation import Rollout
from hyperflex.simulation.sensitivity import AngleJacobian

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
    """A swing from 1.2 m off its rest position, randomly bent."""
    rng, s = np.random.default_rng(seed), np.linspace(0.0, 1.0, FINE)
    bend = 0.15 * rng.normal() * np.sin(np.pi * s) + 0.1 * rng.normal() * np.sin(2.0 * np.pi * s)
    q0 = np.arcsin(1.2 / LENGTH) + bend
    return hf.simulate(rope(FINE), duration=duration, q0=q0, t_eval=np.arange(0.0, duration, 1.0 / RATE))


@functools.cache
def pumped(duration: float = 9.0) -> hf.Trajectory:
    """The paper's swings, up to 15 m/s at the tip."""
    return hf.simulate(rope(FINE), SWINGS, arm=ARM, duration=duration, t_eval=np.arange(0.0, duration, 1.0 / RATE))


@dataclass(frozen=True)
class Truth:
    """A run in several pieces: what :func:`track` needs of a trajectory."""

    t: Array
    q: Array
    qd: Array
    joints: Array
    tip_velocity: Array


def pushed_rates(cable: hf.Rope, q: Array, arc: float, impulse: tuple[float, float]) -> Array:
    """Change of the links' rates by an impulse, N s, at an arc length: M^-1 J' p."""
    ends = np.cumsum(cable.length)
    arms = np.clip(arc - (ends - cable.length), 0.0, cable.length)
    return np.asarray(
        np.linalg.solve(hf.mass_matrix(cable, q), arms * (np.cos(q) * impulse[0] + np.sin(q) * impulse[1]))
    )


def disturbed(
    *,
    moved: bool = False,
    n: int = FINE,
    duration: float = 6.0,
    at: float = 3.0,
    tip_mass: float = 0.0,
    change: dict[str, float] | None = None,
    touch: tuple[float, float, float, float] | None = None,
    noise: Sequence[float] = (),
    seed: int = 0,
    rate: float = RATE,
) -> Truth:
    """A swing, free or pumped, to which something happens.

    Parameters
    ----------
    at : when, s
    tip_mass, change : kg more at the tip; properties of the rope and by what they are multiplied
    touch : arc length, m, force along x and y, N, and how long, s
    noise : densities of disturbances at every frame (30 a second) that are those that a filter assumes
    """
    rng, s = np.random.default_rng((seed, 3)), np.linspace(0.0, 1.0, n)
    bend = 0.15 * rng.normal() * np.sin(np.pi * s) + 0.1 * rng.normal() * np.sin(2.0 * np.pi * s)
    q, qd = (0.3 * bend if moved else bend + np.arcsin(1.2 / LENGTH)), np.zeros(n)
    cable = rope(n)
    changed = cable.replace(tip_mass=tip_mass, **{k: getattr(cable, k) * v for k, v in (change or {}).items()})
    t = np.arange(round(duration * rate) + 1) / rate
    process = Process(cable, ParameterStates((), cable))
    frames = np.arange(round(0.1 * rate), t.size, round(rate / 30.0))
    cuts = [0, t.size - 1, round(min(at, duration) * rate)]
    if touch is not None:
        cuts += range(round(at * rate), round((at + touch[3]) * rate))
    if noise:
        cuts += frames.tolist()
    setup = hf.Setup(cable, SWINGS if moved else None, ARM if moved else None)
    drive, rows = setup.drive(), [np.concatenate([q, qd])[None]]
    cuts = sorted(set(cuts))
    for first, last in pairwise(cuts):
        now = changed if t[first] >= at - 1e-9 else cable
        if noise and first in frames:
            kicks = process.noise(1.0 / 30.0, noise)
            q, qd = np.split(np.concatenate([q, qd]) + rng.normal(size=len(kicks)) @ kicks, 2)
            rows[-1][-1] = np.concatenate([q, qd])
        if touch is not None and at - 1e-9 <= t[first] < at + touch[3] - 1e-9:
            qd = qd + pushed_rates(now, q, touch[0], (touch[1] / rate, touch[2] / rate))
        run = Rollout(setup, t[first : last + 1], (q, qd), chain=now.chain(), drive=drive)
        run.complete()
        rows.append(run.y[1:, : 2 * n])
        q, qd = rows[-1][-1, :n].copy(), rows[-1][-1, n:].copy()
    y = np.concatenate(rows)
    base = np.zeros((t.size, 2)) if not moved else ARM.tip(SWINGS.angle(t))
    speed = np.gradient(base, t, axis=0, edge_order=2)
    across = np.stack([np.cos(y[:, :n]), np.sin(y[:, :n])], axis=1)
    velocity = speed + np.matmul(across, (cable.length * y[:, n:])[:, :, None])[:, :, 0]
    return Truth(t, y[:, :n], y[:, n:], cable.joints(y[:, :n], base), velocity)


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
    seen: list[dict[str, tuple[Array, Array]]] = field(default_factory=list)
    whitened: list[Array] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)

    def rms(self, name: str, since: float = 1.0, until: float = np.inf) -> float:
        """Root mean square of one of the lists between two times."""
        used = [value for t, value in zip(self.t, getattr(self, name), strict=True) if since <= t < until]
        return float(np.sqrt(np.mean([np.sum(np.square(value)) for value in used])))


def track(
    run: hf.Trajectory | Truth,
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
    tests: ChangeTests | None = None,
    moved: bool = False,
    seed: int = 0,
    seen: bool = False,
    view: Callable[[float, Array], Array] | None = None,
    process_noise: float = 1.0,
) -> Tracked:
    """Let a filter with n links follow a run of the finer rope; the picture is late, rolled or read row by row."""
    rng = np.random.default_rng((seed, 7))
    arcs = np.linspace(LENGTH / markers, LENGTH, markers) - (0.0 if on_tip else 0.5 * LENGTH / markers)
    joints, links = np.asarray(run.joints), np.asarray(run.q).shape[1]
    ends = np.linspace(0.0, LENGTH, links + 1)
    base = {"motion": SWINGS, "arm": ARM} if moved else {}
    tracker = RopeFilter(
        rope(n, scale),
        arcs * scale,
        parameters=parameters,
        tests=tests,
        readout=known_readout,
        process_noise=process_noise,
        **base,
    )
    result, rows = Tracked(tracker), np.linspace(-0.5, 0.5, markers)
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    for i in range(int(0.1 * RATE), run.t.size - int(0.1 * RATE), round(RATE / frames)):
        t = float(run.t[i])
        at = np.clip(t - delay + rows * readout, 0.0, run.t[-1]) * RATE
        low = np.minimum(at.astype(int), run.t.size - 2)
        part = at - low
        shapes = [np.stack([_at(joints[k], ends, s) for s, k in zip(arcs, low + d, strict=True)]) for d in (0, 1)]
        places = (1.0 - part)[:, None] * shapes[0] + part[:, None] * shapes[1]
        if view is not None:
            places = view(t, places)
        places = (places + noise * rng.normal(size=places.shape)) @ turn.T
        places[rng.random(markers) < occluded] = np.nan
        if blackout[0] <= t < blackout[1]:
            places[:] = np.nan
        if tracker.t is not None:
            tracker.predict_to(t)
        result.foretold.append(tip_of(tracker)[0] - joints[i, -1] if tracker.t is not None else np.full(2, np.nan))
        tracker.update(Observations(t, places, noise, rows if readout else None))
        place, speed, covariance = tip_of(tracker)
        j = round(tracker.state.t * RATE)  # of an estimated delay
        q, qd = np.asarray(run.q[j]), np.asarray(run.qd[j])
        true_speed = np.asarray(run.tip_velocity[j])
        error = place - joints[j, -1] - (tracker.state.t - run.t[j]) * true_speed
        result.t.append(t)
        result.tip.append(error)
        result.velocity.append(speed - true_speed)
        result.true_velocity.append(true_speed)
        result.rates.append(tracker.state.qd - qd.reshape(n, -1).mean(axis=1))
        result.true_rates.append(qd.reshape(n, -1).mean(axis=1))
        result.nees.append(float(error @ np.linalg.solve(covariance, error)) / 2.0)
        result.changes += tracker.changes
        if tracker.innovation is not None:
            result.whitened.append(tracker.innovation.whitened)
        if seen:
            truth = np.concatenate([joints[i], _velocities(q, qd, joints[i], run, i)], axis=1)
            result.seen.append(seen_errors(tracker, arcs, ends, truth))
        assert np.isfinite(q).all()
    return result


def _velocities(q: Array, qd: Array, joints: Array, run: hf.Trajectory | Truth, i: int) -> Array:
    """Velocities of the joints (links + 1, 2), m/s, back from the tip's."""
    length = np.linalg.norm(np.diff(joints, axis=0), axis=1)
    own = np.stack([np.cos(q), np.sin(q)], axis=1) * (length * qd)[:, None]
    beyond = np.concatenate([np.cumsum(own[::-1], axis=0)[::-1], np.zeros((1, 2))])
    return np.asarray(np.asarray(run.tip_velocity[i]) - beyond)


def seen_errors(tracker: RopeFilter, arcs: Array, ends: Array, truth: Array) -> dict[str, tuple[Array, Array]]:
    """Errors of the markers' places and velocities (k, 2), and covariances of these (k, 2, 2), by name."""
    state = tracker.state
    assert state.covariance is not None
    arms = tracker.model.arms
    along, across = np.stack([np.sin(state.q), -np.cos(state.q)]), np.stack([np.cos(state.q), np.sin(state.q)])
    slope = arms[:, None, :] * across  # (K, 2, n)
    base = tracker.process.base(state.t)
    found = np.concatenate([base[0] + arms @ along.T, base[1] + slope @ state.qd], axis=1)
    turned = np.concatenate([-(arms[:, None, :] * along) * state.qd, slope], axis=2)
    by_state = np.concatenate([np.concatenate([slope, np.zeros_like(slope)], axis=2), turned], axis=1)  # (K, 4, 2 n)
    true = np.stack([np.interp(arcs, ends, truth[:, c]) for c in range(4)], axis=1)
    error = found - true
    covariance = by_state @ state.covariance @ by_state.transpose(0, 2, 1)  # (K, 4, 4)
    places, velocities = (error[:, :2], covariance[:, :2, :2]), (error[:, 2:], covariance[:, 2:, 2:])
    return {
        "places": places,
        "velocities": velocities,
        "tip": (places[0][-1:], places[1][-1:]),
        "tip velocity": (velocities[0][-1:], velocities[1][-1:]),
    }


def _at(joints: Array, ends: Array, s: float) -> Array:
    """Return the place (2,) at an arc length."""
    return np.array([np.interp(s, ends, joints[:, c]) for c in range(2)])


def tip_of(tracker: RopeFilter) -> tuple[Array, Array, Array]:
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


def friction_bound(truth: Truth, moved: bool, noise: float, frames: float = 30.0) -> float:
    """Cramer-Rao bound of the relative friction, with the filter's prior of the start."""
    n, cable = truth.q.shape[1], rope(truth.q.shape[1])
    first = int(0.1 * RATE)
    at = np.arange(first, truth.t.size - first, round(RATE / frames))
    setup = hf.Setup(cable, SWINGS if moved else None, ARM if moved else None, tol=1e-6)
    run = AngleJacobian(setup, ["q0", "qd0", {"friction": {"friction": cable.friction}}])
    q, _, dq, _ = run(truth.t[at], truth.q[at[0]].copy(), truth.qd[at[0]].copy())
    arms = lever_arms(cable, np.linspace(LENGTH / 10, LENGTH, 10))[1]
    slope = arms[None, :, None, :] * np.stack([np.cos(q), np.sin(q)], axis=1)[:, None]  # (T, K, 2, n)
    jacobian = np.matmul(slope.reshape(len(at), -1, n), dq).reshape(-1, 2 * n + 1) / noise
    information = jacobian.T @ jacobian
    assumed = Disturbances()
    shapes = assumed.shapes(cable, assumed.start_correlation)
    for k, size in enumerate((assumed.bend, assumed.speed * np.sqrt(9.81 / LENGTH))):
        prior = size**2 * (shapes.T @ shapes + 0.01 * np.eye(n))
        information[k * n : (k + 1) * n, k * n : (k + 1) * n] += np.linalg.inv(prior)
    left = information[-1, -1] - information[-1, :-1] @ np.linalg.solve(information[:-1, :-1], information[:-1, -1])
    return float(1.0 / np.sqrt(left))
