"""The motion of rope and parameters from one time to another, with its derivatives and its noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.estimate.parameters import ParameterStates
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope, Setup
from hyperflex.motion import Motion
from hyperflex.simulation import Propagator

PRECISION = 1e-5  # tolerance of a prediction over the rope's length: far below any marker's noise
CORRELATION = 0.15  # of the rope's length, over which its disturbances are alike
NEGLIGIBLE = 1e-4  # of the largest principal part of the disturbances


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
        setup = Setup(rope, motion, arm, tol=PRECISION * rope.total_length)
        self._run = Propagator(setup, parameters.directions(), 2 * rope.n_links + len(parameters) + 1)
        self._rope, self._at = rope, np.zeros(len(parameters))
        self._walk = np.array([each.walk for each in parameters.all])
        self._shapes = self._disturbances(rope)

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
            Changes of x, r <= N: with the transition F they become rows F^T.
        t, until : float

        Raises
        ------
        SimulationError
            If the rope's motion cannot be computed.
        """
        n = self.rope.n_links
        rope, dynamic = self._rope_at(x[2 * n :]), [2 * n + k for k in self.parameters.dynamic]
        q, qd, moved, by_parameters = self._run(t, until, x[:n], x[n : 2 * n], rows[:, : 2 * n], rope)
        result = rows.copy()
        result[:, : 2 * n] = moved
        if dynamic:
            result[:, : 2 * n] += rows[:, dynamic] @ by_parameters
        return np.concatenate([q, qd, x[2 * n :]]), result

    def state_at(self, x: Array, rows: Array, t: float, until: float, density: float) -> RopeState:
        """Return the state expected at `until`, s, with its covariance, of what is known at time t.

        Parameters
        ----------
        x, rows : (N,), (r, N) float64
            State, and rows whose squares are its covariance.
        t, until : float
        density : float
            As in :meth:`noise`.

        Raises
        ------
        SimulationError
            If the rope's motion cannot be computed.
        """
        size = 2 * self.rope.n_links
        if until > t:
            x, rows = self.carry(x, rows, t, until)
            rows = np.concatenate([rows, self.noise(until - t, density)])
        return RopeState(until, x[: size // 2].copy(), x[size // 2 : size].copy(), rows[:, :size].T @ rows[:, :size])

    def accelerations(self, x: Array, t: float) -> Array:
        """Return the links' accelerations (n,), rad/s^2, in the state x (N,) at time t, s."""
        n = self.rope.n_links
        return self._run.accelerations(t, x[:n], x[n : 2 * n])

    def set_motion(self, motion: Motion) -> None:
        """Let the arm move in another way from now on."""
        self._run.set_motion(motion)

    def noise(self, dt: float, density: float) -> Array:
        """Return rows (r, N) whose squares are the covariance that `dt` seconds of disturbances add.

        Parameters
        ----------
        dt : float
        density : float
            Of the links' angular accelerations, rad/s^2 per square root of Hz.
        """
        n, r = self.rope.n_links, len(self._shapes)
        shapes = density * np.sqrt(dt) * self._shapes
        rows = np.zeros((2 * r + self._walk.size, 2 * n + self._walk.size))
        rows[:r, :n], rows[:r, n : 2 * n] = 0.5 * dt * shapes, shapes
        rows[r : 2 * r, :n] = dt / np.sqrt(12.0) * shapes
        rows[2 * r :, 2 * n :] = np.diag(self._walk * np.sqrt(dt))
        return rows[: 2 * r] if not self._walk.any() else rows

    def base(self, t: float) -> Array:
        """Return place, velocity and acceleration (3, 2) of the first joint, m, m/s and m/s^2."""
        drive, now = self._run.drive, np.empty(9)
        base_state(drive, segment(drive, t), t, now)
        return np.array([now[7:9], now[5:7], now[0:2]])

    def _rope_at(self, values: Array) -> Rope:
        """Return the rope with its estimated values, made anew only when they have changed."""
        dynamic = self.parameters.dynamic
        if dynamic and not np.array_equal(values[dynamic], self._at[dynamic]):
            self._rope, self._at = self.parameters.rope_at(values), values.copy()
        return self._rope

    def _disturbances(self, rope: Rope) -> Array:
        """Return the principal shapes (r, n) of disturbances that are alike where links are near one another."""
        return smooth_shapes(rope, CORRELATION)


def smooth_shapes(rope: Rope, correlation: float) -> Array:
    """Return rows (r, n) whose squares are a correlation of links: 1 of each, less the further they are apart.

    Parameters
    ----------
    rope : Rope
    correlation : float
        Distance, as a part of the rope's length, over which it falls to exp(-1/2).
    """
    middle = (np.cumsum(rope.length) - 0.5 * rope.length) / rope.total_length
    likeness = np.exp(-0.5 * ((middle[:, None] - middle) / correlation) ** 2)
    values, vectors = np.linalg.eigh(likeness)
    large = values > NEGLIGIBLE * values[-1]
    return np.asarray(np.sqrt(values[large])[:, None] * vectors[:, large].T)
