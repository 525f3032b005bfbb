"""The motion of rope and parameters from one time to another, with its derivatives and its noise."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dposv

from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import mass_matrix
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.parameters import LEFT_OUT, ParameterStates
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope, Setup
from hyperflex.motion import Motion
from hyperflex.simulation import Propagator

PRECISION = 1e-5  # tolerance of a prediction over the rope's length: far below any marker's noise
CORRELATION = 0.15  # of the rope's length, over which its disturbances are alike
# Towards the free end the tension falls to nothing and motion is quick: there rigid links are least true to a rope.
END = 0.08  # of the rope's length: disturbances of the end fall with the distance d to the tip as (END / (d + END))^1.5
END_CORRELATION = 0.05
NEGLIGIBLE = 1e-4  # of the largest principal part of the disturbances
BEND = 0.6  # rad, standard deviation of a link's angle about the line through the markers, before any is seen
SPEED = 6.0  # rad/s, of its rate, in units of sqrt(g / L)
START_CORRELATION = 0.1  # of the rope's length
LONGEST = 0.04  # s, of a step: what disturbs the rope within one is not carried through its equations


class Prediction(NamedTuple):
    """Where the state x = (q, qd, parameters) comes to.

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
    """Predicts the state of a rope whose arm moves as it is known to.

    Parameters
    ----------
    rope : Rope
    parameters : ParameterStates
    motion, arm : Motion, Arm, optional
        What the first joint does; by default it hangs from a fixed point.
    """

    def __init__(
        self, rope: Rope, parameters: ParameterStates, motion: Motion | None = None, arm: Arm | None = None
    ) -> None:
        self.rope, self.parameters = rope, parameters
        self._motion, self._arm = motion, arm
        setup = Setup(rope, motion, arm, tol=PRECISION * rope.total_length)
        self._run = Propagator(setup, parameters.directions(), 3 * (2 * rope.n_links + len(parameters) + 1))
        self._rope, self._at = rope, np.zeros(len(parameters))
        self._walk = parameters.walk
        self._moment, self._base = np.nan, np.zeros((3, 2))  # when the first joint was looked at last, and where it was
        beyond = (np.cumsum(rope.length[::-1])[::-1] - 0.5 * rope.length) / rope.total_length
        end = (END / (beyond + END)) ** 1.5
        shapes = smooth_shapes(rope, CORRELATION), smooth_shapes(rope, END_CORRELATION, end)
        self.noise_ends = np.cumsum([2 * len(each) for each in shapes])
        self._kind = np.repeat([0, 1], [2 * len(each) for each in shapes])
        self._turning, self._moving = _disturbances(shapes, 2 * rope.n_links + len(parameters))

    def copy(self) -> "Process":
        """Return another one, for other values of the parameters."""
        return Process(self.rope, self.parameters, self._motion, self._arm)

    def predict(self, x: Array, t: float, until: float) -> Prediction:
        """Return the state at `until`, s, that comes of x (N,) at time t.

        Raises
        ------
        SimulationError
            If the rope's motion cannot be computed.
        """
        x, rows = self.carry(x, np.eye(x.size), t, until)
        return Prediction(x, rows.T, self.accelerations(x, until))

    def carry(self, x: Array, rows: Array, t: float, until: float) -> tuple[Array, Array]:
        """Return the state at `until`, s, that comes of x (N,) at time t, and what becomes of changes of it.

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
        q, qd, moved, by_parameters = self._run(t - late, until - late, x[:n], x[n : 2 * n], rows[:, : 2 * n], rope)
        result = rows.copy()
        result[:, : 2 * n] = moved
        if dynamic:
            result[:, : 2 * n] += rows[:, dynamic] @ by_parameters
        return np.concatenate([q, qd, x[2 * n :]]), result

    def steps(self, t: float, until: float) -> list[tuple[float, float]]:
        """Return begin and end of the steps in which a prediction from t to `until`, s, is made."""
        count = math.ceil((until - t) / LONGEST - 1e-6)
        return list(pairwise(np.linspace(t, until, max(count, 1) + 1).tolist()))

    def least(self, x: Array) -> Array:
        """Return the standard deviations (N,) that a covariance leaves out, > 0."""
        n = self.rope.n_links
        rest = np.full(n, LEFT_OUT * turning_rate(self.rope)), self.parameters.least(x[2 * n :])
        return np.concatenate([np.full(n, LEFT_OUT), *rest])

    def rope_state(self, x: Array, rows: Array, t: float) -> RopeState:
        """Return the rope's state, with its covariance and what that leaves out, for a picture at t, s.

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

    def state_at(self, x: Array, rows: Array, t: float, until: float, density: npt.ArrayLike) -> RopeState:
        """Return the state expected for a picture at `until`, s, with its covariance, of what is known at time t.

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
        return self._run.accelerations(t - self.parameters.value("delay", x[2 * n :]), x[:n], x[n : 2 * n])

    def set_motion(self, motion: Motion) -> None:
        """Let the arm move in another way from now on."""
        self._motion, self._moment = motion, np.nan
        self._run.set_motion(motion)

    def noise(self, dt: float, density: npt.ArrayLike) -> Array:
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
        disturbed = level[:, None] * (self._turning + dt * self._moving)
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
        across = np.stack([np.cos(q), np.sin(q)])
        moments = (arms[:, None, :] * across).reshape(-1, q.size)
        return np.asarray(dposv(mass, moments.T)[1])

    def base(self, t: float, x: Array | None = None) -> Array:
        """Return place, velocity and acceleration (3, 2) of the first joint, m, m/s and m/s^2.

        Parameters
        ----------
        t : float
            Of a picture, s.
        x : (N,) float64, optional
            State with the pictures' delay; by default there is none.
        """
        moment = t if x is None else t - self.parameters.value("delay", x[2 * self.rope.n_links :])
        if moment != self._moment:
            drive, now = self._run.drive, np.empty(9)
            base_state(drive, segment(drive, moment), moment, now)
            self._moment, self._base = moment, np.array([now[7:9], now[5:7], now[0:2]])
        return self._base.copy()

    def _rope_at(self, values: Array) -> Rope:
        """Return the rope with its estimated values, made anew only when they have changed."""
        if not self.parameters.same_rope(values, self._at):
            self._rope, self._at = self.parameters.rope_at(values), values.copy()
        return self._rope


def smooth_shapes(rope: Rope, correlation: float, size: npt.ArrayLike = 1.0) -> Array:
    """Return rows (r, n) whose squares are a covariance of links that are the less alike the further they are apart.

    Parameters
    ----------
    rope : Rope
    correlation : float
        Distance, as a part of the rope's length, over which it falls to exp(-1/2).
    size : (n,) array_like or float
        Standard deviation of each link.
    """
    middle = (np.cumsum(rope.length) - 0.5 * rope.length) / rope.total_length
    likeness = np.exp(-0.5 * ((middle[:, None] - middle) / correlation) ** 2)
    scale = np.broadcast_to(size, middle.shape)
    values, vectors = np.linalg.eigh(scale[:, None] * likeness * scale)
    large = values > NEGLIGIBLE * values[-1]
    return np.asarray(np.sqrt(values[large])[:, None] * vectors[:, large].T)


def _disturbances(kinds: Sequence[Array], size: int) -> tuple[Array, Array]:
    """Return rows A, B (r, size): A + dt B, times sqrt(dt), is what white accelerations of each shape do in dt.

    Of each shape (n,) there are two rows, those of all shapes of a kind (s, n) one after the other: of the rates and
    the half of the angles that goes with them, and of the rest of the angles.
    """
    turning, moving = np.zeros((2, 2 * sum(map(len, kinds)), size))
    first = 0
    for shapes in kinds:
        middle, n = first + len(shapes), shapes.shape[1]
        turning[first:middle, n : 2 * n], moving[first:middle, :n] = shapes, 0.5 * shapes
        moving[middle : middle + len(shapes), :n] = shapes / math.sqrt(12.0)
        first = middle + len(shapes)
    return turning, moving


def turning_rate(rope: Rope) -> float:
    """Return sqrt(g / L), rad/s: how fast a rope swings, about."""
    return float(np.sqrt(np.hypot(*rope.gravity) / rope.total_length))


def starting_rows(rope: Rope, parameter_std: Array) -> Array:
    """Return rows whose squares are the covariance of angles, rates and parameters before anything was seen of them."""
    n, shapes = rope.n_links, smooth_shapes(rope, START_CORRELATION)
    rate, count = SPEED * turning_rate(rope), len(shapes)
    rows = np.zeros((2 * count + 2 * n + len(parameter_std), 2 * n + len(parameter_std)))
    rows[:count, :n], rows[count : 2 * count, n : 2 * n] = BEND * shapes, rate * shapes
    np.fill_diagonal(rows[2 * count :], np.concatenate([np.full(n, 0.1 * BEND), np.full(n, 0.1 * rate), parameter_std]))
    return rows
