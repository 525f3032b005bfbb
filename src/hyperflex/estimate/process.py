"""The motion of rope and parameters from one time to another, with its derivatives and its noise."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dposv

from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import mass_matrix
from hyperflex.core.chain.drive import motion_at
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.parameters import NEGLIGIBLE, ParameterStates
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope, Setup, swing_rate, unit_across
from hyperflex.motion import Motion
from hyperflex.simulation import AngleJacobian, link_accelerations

PRECISION = 1e-5  # tolerance of a prediction relative to the rope's length: far below any marker's noise
BEYOND = 1e6  # rad, rad/s: a larger state or uncertainty is not a rope's
LONGEST = 0.04  # s, of a step: disturbances within one are not carried through the rope's equations


@dataclass(frozen=True)
class Disturbances:
    """What a filter assumes of the rope before anything is seen, and of the disturbances of its motion.

    Lengths are relative to the rope's. Towards the free end the tension falls to nothing and motion is fast: there
    rigid links represent a rope worst, so that disturbances of the end are separate. They fall with the distance d to
    the tip as ``(end / (d + end))^1.5``.

    Attributes
    ----------
    correlation, end_correlation, start_correlation : float
        Distance over which disturbances of the whole rope, those of the end, and the first shape are alike.
    end : float
        Extent of the end.
    negligible : float
        Principal parts of a covariance that are omitted, relative to the largest.
    bend : float
        Standard deviation of a link's angle about the line through the markers at the start, rad.
    speed : float
        Standard deviation of its rate, in units of sqrt(g / L).
    """

    correlation: float = 0.15
    end_correlation: float = 0.05
    start_correlation: float = 0.1
    end: float = 0.08
    negligible: float = 1e-4
    bend: float = 0.6
    speed: float = 6.0

    def shapes(self, rope: Rope, correlation: float, size: ArrayLike = 1.0) -> Array:
        """Return rows (r, n) whose squares are a covariance of links that falls with the distance between them.

        Parameters
        ----------
        rope : Rope
        correlation : float
            Distance relative to the rope's length over which it falls to exp(-1/2).
        size : (n,) array_like or float
            Standard deviation of each link.
        """
        middle = rope.link_middles / rope.total_length
        likeness = np.exp(-0.5 * ((middle[:, None] - middle) / correlation) ** 2)
        scale = np.broadcast_to(size, middle.shape)
        values, vectors = np.linalg.eigh(scale[:, None] * likeness * scale)
        large = values > self.negligible * values[-1]
        return np.asarray(np.sqrt(values[large])[:, None] * vectors[:, large].T)

    def of(self, rope: Rope) -> tuple[Array, Array]:
        """Return the shapes (r, n) of disturbances along the whole rope, and of those at its free end."""
        beyond = (np.cumsum(rope.length[::-1])[::-1] - 0.5 * rope.length) / rope.total_length
        end = (self.end / (beyond + self.end)) ** 1.5
        return self.shapes(rope, self.correlation), self.shapes(rope, self.end_correlation, end)

    def starting_rows(self, rope: Rope, parameter_std: Array) -> Array:
        """Return rows whose squares are the covariance of angles, rates and parameters before anything was seen."""
        n, shapes = rope.n_links, self.shapes(rope, self.start_correlation)
        sizes = np.array([self.bend, self.speed * swing_rate(rope)])
        alike = np.pad(np.kron(np.diag(sizes), shapes), ((0, 0), (0, len(parameter_std))))
        return np.concatenate([alike, np.diag(np.concatenate([np.repeat(0.1 * sizes, n), parameter_std]))])


DISTURBANCES = Disturbances()


class StatePrediction(NamedTuple):
    """The state x = (q, qd, parameters) at a later time.

    Attributes
    ----------
    x : (N,) float64
    transition : (N, N) float64
        Its derivatives with respect to x before.
    qdd : (n,) float64
        Angular accelerations at the end, rad/s^2.
    """

    x: Array
    transition: Array
    qdd: Array


class Process:
    """Predicts the state of a rope whose arm's motion is known.

    Parameters
    ----------
    rope : Rope
    parameters : ParameterStates
    motion, arm : Motion, Arm, optional
        Of the first joint; by default it is fixed.
    """

    def __init__(
        self,
        rope: Rope,
        parameters: ParameterStates,
        motion: Motion | None = None,
        arm: Arm | None = None,
    ) -> None:
        self.rope, self.parameters = rope, parameters
        self._arm = arm
        self._rope, self._at = rope, np.zeros(len(parameters))
        self.set_motion(motion)
        self._walk = parameters.walk
        kinds, spare = DISTURBANCES.of(rope), len(parameters)
        self.noise_ends = np.cumsum([2 * len(shapes) for shapes in kinds])
        self._kind = np.repeat([0, 1], [2 * len(shapes) for shapes in kinds])
        # White accelerations of a shape move, in dt, the rates and half of the angles together, and the rest of the
        # angles alone: rows A + dt B, times sqrt(dt).
        rates = [np.kron([[0.0, 1.0], [0.0, 0.0]], shapes) for shapes in kinds]
        angles = [np.kron([[0.5, 0.0], [1.0 / math.sqrt(12.0), 0.0]], shapes) for shapes in kinds]
        self._rates, self._angles = (np.pad(np.concatenate(rows), ((0, 0), (0, spare))) for rows in (rates, angles))

    def copy(self) -> "Process":
        """Return another process of the same rope, for other values of the parameters."""
        return Process(self.rope, self.parameters, self._motion, self._arm)

    def predict(self, x: Array, t: float, until: float) -> StatePrediction:
        """Return the state at `until`, s, that follows from x (N,) at time t.

        Raises
        ------
        SimulationError
            If the rope's motion cannot be computed.
        """
        x, rows = self.carry(x, np.eye(x.size), t, until)
        return StatePrediction(x, rows.T, self.accelerations(x, until))

    def carry(self, x: Array, rows: Array, t: float, until: float) -> tuple[Array, Array]:
        """Return the state at `until`, s, that follows from x (N,) at time t, and the changes of it.

        Parameters
        ----------
        x : (N,) float64
        rows : (r, N) float64
            Changes of x: with the transition F they become rows F^T.
        t, until : float
            Of pictures, s.

        Raises
        ------
        SimulationError
            If the rope's motion cannot be computed.
        """
        n = self.rope.n_links
        rope, dynamic = self._rope_at(x[2 * n :]), [2 * n + k for k in self.parameters.dynamic]
        late = self.parameters.value("delay", x[2 * n :])
        times, changes = np.array([t - late, until - late]), rows[:, : 2 * n]
        q, qd, dq, dqd = self._run(times, x[:n], x[n : 2 * n], rope, changes, until - t)
        moved, count = np.concatenate([dq[-1], dqd[-1]]).T, len(self._run.names)
        result = rows.copy()
        result[:, : 2 * n] = moved[count:]
        if dynamic:
            result[:, : 2 * n] += rows[:, dynamic] @ moved[:count]
        return np.concatenate([q[-1], qd[-1], x[2 * n :]]), result

    def steps(self, t: float, until: float) -> list[tuple[float, float]]:
        """Return begin and end of the steps in which a prediction from t to `until`, s, is made."""
        count = math.ceil((until - t) / LONGEST - 1e-6)
        return list(pairwise(np.linspace(t, until, max(count, 1) + 1).tolist()))

    def least(self, x: Array) -> Array:
        """Return the standard deviations (N,) that a covariance omits, > 0."""
        n = self.rope.n_links
        rest = np.full(n, NEGLIGIBLE * swing_rate(self.rope)), self.parameters.least(x[2 * n :])
        return np.concatenate([np.full(n, NEGLIGIBLE), *rest])

    def rope_state(self, x: Array, rows: Array, t: float) -> RopeState:
        """Return the rope's state, with its covariance and what the rows omit of it, for a picture at t, s.

        Parameters
        ----------
        x, rows : (N,), (r, N) float64
            State, and rows whose squares are its covariance.
        t : float
        """
        n = self.rope.n_links
        part = rows[:, : 2 * n]
        covariance = part.T @ part
        covariance.flat[:: 2 * n + 1] += self.least(x)[: 2 * n] ** 2
        moment = t - self.parameters.value("delay", x[2 * n :])
        return RopeState(moment, x[:n].copy(), x[n : 2 * n].copy(), covariance)

    def state_at(self, x: Array, rows: Array, t: float, until: float, density: ArrayLike) -> RopeState:
        """Return the state predicted for a picture at `until`, s, with its covariance, from the state at time t.

        Parameters
        ----------
        x, rows : (N,), (r, N) float64
            State, and rows whose squares are its covariance.
        t, until : float
        density : (2,) array_like or float
            As in :meth:`noise`.

        Raises
        ------
        SimulationError
            If the rope's motion cannot be computed.
        """
        for k, (begin, end) in enumerate(self.steps(t, until) if until > t else []):
            if k:
                rows = sr.compressed(rows, self.least(x))
            x, rows = self.carry(x, rows, begin, end)
            rows = np.concatenate([rows, self.noise(end - begin, density)])
        return self.rope_state(x, rows, until)

    def accelerations(self, x: Array, t: float) -> Array:
        """Return the links' accelerations (n,), rad/s^2, in the state x (N,) at time t, s."""
        n = self.rope.n_links
        moment = t - self.parameters.value("delay", x[2 * n :])
        return link_accelerations(self._run.chain, self._run.drive, moment, x[:n], x[n : 2 * n])

    def set_motion(self, motion: Motion | None) -> None:
        """Change the arm's motion."""
        self._motion = motion
        setup = Setup(self._rope, motion, self._arm, tol=PRECISION * self.rope.total_length)
        most = 3 * (2 * self.rope.n_links + len(self.parameters) + 1)
        self._run = AngleJacobian(setup, self.parameters.directions(), most)

    def noise(self, dt: float, density: ArrayLike) -> Array:
        """Return rows (r, N) whose squares are the covariance that `dt` seconds of disturbances add.

        Parameters
        ----------
        dt : float
        density : (2,) array_like or float
            Of the links' angular accelerations, rad/s^2 per square root of Hz: of disturbances along the whole rope,
            and of those at its free end (one number: for both). The rows of both end at `noise_ends`.
        """
        last = self.noise_ends[-1]
        level = math.sqrt(dt) * (np.asarray(density) * np.ones(2))[self._kind]
        disturbed = level[:, None] * (self._rates + dt * self._angles)
        if not self._walk.any():
            return np.asarray(disturbed)
        rows = np.concatenate([disturbed, np.zeros((self._walk.size, disturbed.shape[1]))])
        np.fill_diagonal(rows[last:, 2 * self.rope.n_links :], self._walk * math.sqrt(dt))
        return rows

    def kicks(self, q: Array, arms: Array) -> Array:
        """Return by how much unit impulses change the links' rates, (n, 2 P), rad/s per N s.

        Parameters
        ----------
        q : (n,) float64
            Angles, rad.
        arms : (P, n) float64
            How much of each link lies between the first joint and the point that is pushed, m; the columns are of
            impulses along x and y at the first point, at the second, and so on.
        """
        mass = np.empty((q.size, q.size))
        mass_matrix(self._run.chain, q, mass)
        moments = (arms[:, None, :] * unit_across(q, 0)).reshape(-1, q.size)
        return np.asarray(dposv(mass, moments.T)[1])

    def base(self, t: float, x: Array | None = None) -> Array:
        """Return place, velocity and acceleration (3, 2) of the first joint, m, m/s and m/s^2.

        Parameters
        ----------
        t : float
            Of a picture, s.
        x : (N,) float64, optional
            State with the pictures' delay; by default the delay is 0.
        """
        moment = t if x is None else t - self.parameters.value("delay", x[2 * self.rope.n_links :])
        now = np.empty(9)
        motion_at(self._run.drive, moment, now)
        return now[[[7, 8], [5, 6], [0, 1]]]

    def _rope_at(self, values: Array) -> Rope:
        """Return the rope with its estimated values; it is created only when they have changed."""
        own = self.parameters.of_rope
        if not np.array_equal(values[own], self._at[own]):
            self._rope, self._at = self.parameters.rope_at(values), values.copy()
        return self._rope
