"""Gauss-Newton over the frames of an interval; each step is a linear fixed-interval smoother."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.observations import InputFrame, MarkerModel
from hyperflex.estimate.process import BEYOND, Prediction, Process
from hyperflex.estimate.square_root import CLOSE
from hyperflex.interfaces import RopeState
from hyperflex.status import Status


class Step(NamedTuple):
    """From one frame to the next: ``x+ = F x + c + N^T w`` with w of mean 0 and covariance 1.

    Attributes
    ----------
    transition : (N, N) float64
        F.
    offset : (N,) float64
        c.
    noise : (r, N) float64
        N.
    """

    transition: Array
    offset: Array
    noise: Array


class Measurement(NamedTuple):
    """What is seen in a frame: ``z = H x + e`` with e of mean 0 and covariance 1; m may be 0.

    Attributes
    ----------
    z : (m,) float64
    jacobian : (m, N) float64
        H.
    """

    z: Array
    jacobian: Array


class Smoothed(NamedTuple):
    """The posterior of all frames, given all measurements.

    Attributes
    ----------
    means : (T, N) float64
    rows : list of (r, N) float64
        Of each frame; their squares are its covariance.
    priors : list of tuple of (N,) float64 and (r, N) float64
        Mean and rows of each frame, given those before it alone.
    coordinates : list of (r,) float64
        v of each state over its prior: ``x = mean + rows^T v``.
    noises : list of (r,) float64
        Of the steps: w.
    log_likelihoods : (T,) float64
        Of each frame's measurement, given those before.
    """

    means: Array
    rows: list[Array]
    priors: list[tuple[Array, Array]]
    coordinates: list[Array]
    noises: list[Array]
    log_likelihoods: Array

    def without_first(self) -> "Smoothed":
        """Return the same of all frames but the first."""
        priors, coordinates = self.priors[1:], self.coordinates[1:]
        return Smoothed(self.means[1:], self.rows[1:], priors, coordinates, self.noises[1:], self.log_likelihoods[1:])


class _Filtered(NamedTuple):
    """The filter's pass at one frame: x = mean + rows^T v, v normal with mean `at` and rows `spread`."""

    mean: Array
    rows: Array
    at: Array
    spread: Array


def smooth_linear(mean: Array, rows: Array, steps: Sequence[Step], measurements: Sequence[Measurement]) -> Smoothed:
    """Return the posterior of the states of T frames.

    Parameters
    ----------
    mean, rows : (N,), (r, N) float64
        Prior of the first state: its mean, and rows whose squares are its covariance, which may be singular.
    steps : sequence of T - 1 Step
        Their noise may be singular, too.
    measurements : sequence of T Measurement

    Notes
    -----
    The states are written in coordinates v that are standard normal before their frame is seen, x = m + R^T v. One QR
    factorisation a frame, ``[L R F^T; N] = Q [R+; 0]``, takes the coordinates that are left (z, w) to those of the next
    frame and a rest e that no later frame tells of: (z, w) = Q (v+, e). Backwards the same Q gives the smoothed z and w
    of v+. No covariance is inverted. The result is that of Rauch, Tung and Striebel (1965, AIAA Journal 3(8), 1445), by
    the elimination of Paige and Saunders (1977, SIAM J. Numer. Anal. 14(2), 180); cost O(T N^3).
    """
    passes: list[_Filtered] = []
    turns: list[Array] = []
    likelihoods = np.zeros(len(measurements))
    for k, seen in enumerate(measurements):
        at, spread, likelihoods[k] = _updated(mean, rows, seen)
        passes.append(_Filtered(mean, rows, at, spread))
        if k < len(steps):
            step = steps[k]
            mean = step.transition @ (mean + rows.T @ at) + step.offset
            turn, upper = np.linalg.qr(np.concatenate([spread @ rows @ step.transition.T, step.noise]), mode="complete")
            rows = upper[: min(upper.shape)]
            turns.append(turn)
    return _backward(passes, turns, likelihoods)


def _updated(mean: Array, rows: Array, seen: Measurement) -> tuple[Array, Array, float]:
    """Return mean and rows of v after a measurement, and the measurement's log-likelihood."""
    r, m = len(rows), len(seen.z)
    if not m:
        return np.zeros(r), np.eye(r), 0.0
    both = np.eye(m + r)
    both[m:, :m] = rows @ seen.jacobian.T
    upper = sr.triangular(both)
    whitened = solve_triangular(upper[:m, :m], seen.z - seen.jacobian @ mean, trans="T", check_finite=False)
    size = math.log(2.0 * math.pi) * m + 2.0 * np.log(np.abs(np.diag(upper)[:m])).sum()
    return upper[:m, m:].T @ whitened, upper[m:, m:], float(-0.5 * (whitened @ whitened + size))


def _backward(passes: list[_Filtered], turns: list[Array], likelihoods: Array) -> Smoothed:
    """Go back from the last frame, of which all is known, to the first."""
    v, spread = passes[-1].at, passes[-1].spread
    coordinates, means, rows, noises = [v], [_mean(passes[-1], v)], [spread @ passes[-1].rows], []
    for each, turn in zip(passes[-2::-1], turns[::-1], strict=True):
        left, known = len(each.spread), v.size
        noises.append(turn[left:, :known] @ v)
        rest = np.concatenate([spread @ turn[:left, :known].T, turn[:left, known:].T])
        v, spread = each.at + each.spread.T @ (turn[:left, :known] @ v), sr.triangular(rest @ each.spread)
        coordinates.append(v)
        means.append(_mean(each, v))
        rows.append(spread @ each.rows)
    priors = [(each.mean, each.rows) for each in passes]
    return Smoothed(np.array(means[::-1]), rows[::-1], priors, coordinates[::-1], noises[::-1], likelihoods)


def _mean(each: _Filtered, v: Array) -> Array:
    return each.mean + each.rows.T @ v


SHORTEST = 1.0 / 64.0  # part of a Gauss-Newton step that is tried
ROOM = 6  # squares that are allowed in addition to one for each measurement
RIDGE = 1e-9  # of a covariance's diagonal, added to it when it is inverted


@dataclass(frozen=True, eq=False)
class Path:
    """States that follow from a start by the process and noise, linearised.

    Attributes
    ----------
    start : (r,) float64
        The first state over the factor of its prior.
    noises : list of (r,) float64
        Of the steps, of variance 1.
    x : list of (N,) float64
    predictions : list of Prediction
        To each frame from the one before.
    measurements : list of Measurement
        Residuals of the observations, whitened, and their derivatives.
    """

    start: Array
    noises: list[Array] = field(default_factory=list)
    x: list[Array] = field(default_factory=list)
    predictions: list[Prediction] = field(default_factory=list)
    measurements: list[Measurement] = field(default_factory=list)

    def copy(self) -> "Path":
        """Return a copy that can be extended."""
        return Path(self.start, [*self.noises], [*self.x], [*self.predictions], [*self.measurements])

    @property
    def cost(self) -> float:
        """Twice the negative logarithm of the posterior's density, but for a constant."""
        return float(
            self.start @ self.start
            + sum(w @ w for w in self.noises)
            + sum(each.z @ each.z for each in self.measurements)
        )


class Interval:
    """Fits the states of all frames of an interval at once (maximum a posteriori).

    Parameters
    ----------
    process, model : Process, MarkerModel
    mean, rows : (N,), (r, N) float64
        Prior of the first frame's state: its mean, and rows whose squares are its covariance. In a moving horizon it
        is the arrival cost.
    first : InputFrame
    qdd : (n,) float64
        Angular accelerations at the first frame, rad/s^2, for markers read before or after its time.

    Attributes
    ----------
    smoothed : Smoothed
        The last Gauss-Newton step: deviations from `path`, and the covariances of all frames.

    Notes
    -----
    The cost is ``|u|^2 + sum |w|^2 + sum |z|^2``, of the start u, the process noise w and the residuals z of the
    measurements, all of variance 1. A path has no defects: each state follows from the one before and the noise. Each
    step is that of :func:`smooth_linear`: an iterated Kalman smoother is Gauss-Newton (Bell 1994, SIAM J. Optim. 4(3),
    626). Shooting alone would fail where motion is chaotic, so the noise of a trial steers the path to the states of
    the linear step, as far as their covariances do not allow for the difference. To first order that changes nothing.
    A step that does not lessen the cost is halved.
    """

    def __init__(
        self, process: Process, model: MarkerModel, mean: Array, rows: Array, first: InputFrame, qdd: Array
    ) -> None:
        self.process, self.model = process, model
        self.mean, self.rows, self.frames, self._qdd = mean, rows, [first], qdd
        self.smoothed: Smoothed
        self.path = Path(np.zeros(len(rows)))
        self.path.x.append(mean.copy())
        self.path.measurements.append(self._measurement(first, mean, qdd))
        self._forgotten = 0.0
        self._smoothe()

    @property
    def x(self) -> Array:
        """The last frame's state (N,)."""
        return np.asarray(self.states[-1])

    @property
    def factor(self) -> Array:
        """Rows (r, N) whose squares are its covariance."""
        return self.smoothed.rows[-1]

    @property
    def qdd(self) -> Array:
        """The last frame's angular accelerations (n,), rad/s^2."""
        return self.path.predictions[-1].qdd if self.path.predictions else self._qdd

    @property
    def states(self) -> Array:
        """The states of all frames (T, N)."""
        x = np.array(self.path.x)
        return x + self.smoothed.means if self._largest(self.smoothed) < CLOSE else x

    @property
    def rope_states(self) -> tuple[RopeState, ...]:
        """The same as states of the rope, with covariances, each at the time of its picture less an estimated delay."""
        return tuple(
            self.process.rope_state(x, rows, frame.seen.t)
            for frame, x, rows in zip(self.frames, self.states, self.smoothed.rows, strict=True)
        )

    @property
    def log_likelihood(self) -> float:
        """Of all that was seen since the interval began, about the best path (Laplace's approximation)."""
        known = float(self.smoothed.log_likelihoods.sum())
        return self._forgotten + known + sum(frame.log_determinant for frame in self.frames)

    @property
    def misfit(self) -> float:
        """The posterior's squares over those of a right model: about 1, with some room."""
        return self.path.cost / (ROOM + sum(len(each.z) for each in self.path.measurements))

    def append(self, frame: InputFrame) -> bool:
        """Add a frame; its state is at first the predicted one. Return False if it cannot be predicted."""
        path = self.path.copy()
        try:
            self._extend(path, frame, self.frames[-1], np.zeros(len(frame.noise)))
        except SimulationError:
            return False
        self.path, self.frames = path, [*self.frames, frame]
        self._smoothe()
        return True

    def follow(self, frames: Sequence[InputFrame], states: Sequence[tuple[Array, Array]]) -> None:
        """Add all further frames, on a path near states that are known to about their covariances.

        Parameters
        ----------
        frames : sequence of InputFrame
        states : sequence of tuple of (N,) float64 and (r, N) float64
            Of the first frame and all further ones: means, and rows whose squares are the covariances.

        Raises
        ------
        SimulationError
            If the rope's equations cannot be integrated along them.
        """
        start = np.asarray(np.linalg.lstsq(self.rows.T, states[0][0] - self.mean, rcond=RIDGE)[0])
        self.frames = [*self.frames[:1], *frames]
        found = self._run(start, None, states)
        if found is None:
            raise SimulationError("No rope moves along these states.", status=Status.NOT_FINITE, time=frames[0].seen.t)
        self.path = found
        self._smoothe()

    def forget(self) -> None:
        """Drop the first of two or more frames: its information remains in the prior of the second."""
        self._forgotten += float(self.smoothed.log_likelihoods[0]) + self.frames[0].log_determinant
        self.smoothed, path = self.smoothed.without_first(), self.path
        mean, rows = self.smoothed.priors[0]
        self.mean, self.rows, self._qdd = path.x[1] + mean, rows, path.predictions[0].qdd
        # before convergence, the path's start is not the smoothed one
        start = self.smoothed.coordinates[0] - np.linalg.lstsq(rows.T, self.smoothed.means[0], rcond=RIDGE)[0]
        self.path = Path(start, path.noises[1:], path.x[1:], path.predictions[1:], path.measurements[1:])
        self.frames = self.frames[1:]

    def solve(self, rounds: int) -> None:
        """Improve the path by at most `rounds` steps of Gauss-Newton."""
        for _ in range(rounds):
            if self._largest(self.smoothed) < CLOSE:
                return
            part, found = 1.0, None
            while found is None and part >= SHORTEST:
                found = self._steered(part)
                part *= 0.5
            if found is None:
                return
            gained = self.path.cost - found.cost
            self.path = found
            self._smoothe()
            if gained < CLOSE**2:
                return

    def begin_at(self, start: Array) -> bool:
        """Go to the path without noise from a start (r,) over the prior's factor; return whether there is one."""
        path = self._run(start, None, None)
        if path is None:
            return False
        self.path = path
        self._smoothe()
        return True

    def _smoothe(self) -> None:
        """Find the next Gauss-Newton step, and the covariances about the path."""
        path = self.path
        steps = [
            Step(found.transition, -frame.noise.T @ w, frame.noise)
            for found, w, frame in zip(path.predictions, path.noises, self.frames[1:], strict=True)
        ]
        self.smoothed = smooth_linear(-self.rows.T @ path.start, self.rows, steps, path.measurements)

    def _largest(self, step: Smoothed) -> float:
        """Return by how many standard deviations a step moves a noise or the start at most."""
        changes = [step.coordinates[0] - self.path.start, *map(np.subtract, step.noises, self.path.noises)]
        return max(float(np.abs(each).max(initial=0.0)) for each in changes)

    def _steered(self, part: float) -> Path | None:
        """Return the path a part of a Gauss-Newton step away, or None if it is none, or no better one."""
        step, path = self.smoothed, self.path
        noises = [w + part * (new - w) for w, new in zip(path.noises, step.noises, strict=True)]
        states = [(x + part * change, rows) for x, change, rows in zip(path.x, step.means, step.rows, strict=True)]
        return self._run(path.start + part * (step.coordinates[0] - path.start), noises, states, path.cost)

    def _run(
        self,
        start: Array,
        noises: Sequence[Array] | None,
        states: Sequence[tuple[Array, Array]] | None,
        limit: float = np.inf,
    ) -> Path | None:
        """Return the path from a start that noises near the given ones steer along states.

        None if there is none, or its cost is not below the limit.
        """
        path, first = Path(start), self.frames[0]
        path.x.append(self.mean + self.rows.T @ start)
        path.measurements.append(self._measurement(first, path.x[0], self._qdd))
        for k, frame in enumerate(self.frames[1:], start=1):
            if not path.cost < limit:
                return None
            w = np.zeros(len(frame.noise)) if noises is None else noises[k - 1]
            try:
                self._extend(path, frame, self.frames[k - 1], w, None if states is None else states[k])
            except SimulationError:
                return None
        return path if path.cost < limit else None

    def _extend(
        self, path: Path, frame: InputFrame, last: InputFrame, w: Array, target: tuple[Array, Array] | None = None
    ) -> None:
        """Add to a path the state that follows from the last frame's with noise w, steered towards a target."""
        found = self._predicted(path.x[-1], last.seen.t, frame.seen.t)
        if target is not None:
            w = w + _gain(frame.noise, target[1]) @ (target[0] - found.x - frame.noise.T @ w)
        path.predictions.append(found)
        path.noises.append(w)
        path.x.append(found.x + frame.noise.T @ w)
        path.measurements.append(self._measurement(frame, path.x[-1], found.qdd))

    def _predicted(self, x: Array, t: float, until: float) -> Prediction:
        """Return the state that follows from x between the times of two frames, s."""
        first = 2 * self.process.rope.n_links
        possible = np.concatenate([x[:first], self.process.parameters.possible(x[first:])])
        found = self.process.predict(possible, t, until)
        if not (np.abs(found.x).max() < BEYOND and np.abs(found.transition).max() < BEYOND**2):
            raise SimulationError("The state is not finite.", status=Status.NOT_FINITE, time=until)
        return found._replace(x=np.concatenate([found.x[:first], x[first:]]))

    def _measurement(self, frame: InputFrame, x: Array, qdd: Array) -> Measurement:
        """Return what is left of a frame's measurements, over their standard deviation, and its derivatives."""
        seen = frame.seen
        if not frame.used.any():
            return Measurement(np.zeros(0), np.zeros((0, x.size)))
        predicted = self.model.predict(x, self.process.base(seen.t, x), seen.rows, qdd)
        return Measurement(*frame.residuals(*predicted))


def _gain(noise: Array, rows: Array) -> Array:
    """Return N (N^T N + P)^-1, (r, N): how much noise answers a difference of states whose covariance is P."""
    wide = noise.T @ noise + rows.T @ rows
    size = np.sqrt(np.maximum(np.diag(wide), np.finfo(float).tiny))
    even = wide / size / size[:, None] + RIDGE * np.eye(len(wide))
    return np.asarray(np.linalg.solve(even, (noise / size).T).T / size)
