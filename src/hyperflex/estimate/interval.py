"""Gauss-Newton over the frames of an interval; each step is a linear fixed-interval smoother."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.observations import InputFrame, MarkerModel
from hyperflex.estimate.process import BEYOND, Process, StatePrediction
from hyperflex.estimate.square_root import CLOSE, SHORTEST
from hyperflex.interfaces import RopeState
from hyperflex.status import Status

Step = tuple[Array, Array, Array]  # F (N, N), c (N,) and N (r, N) of x+ = F x + c + N^T w, w of mean 0, covariance 1
Measured = tuple[Array, Array]  # z (m,) and H (m, N) of z = H x + e, e of mean 0 and covariance 1; m may be 0


class Smoothed(NamedTuple):
    """The posterior of one frame, given all measurements.

    Attributes
    ----------
    mean : (N,) float64
    rows : (r, N) float64
        Their squares are its covariance.
    prior_mean, prior_rows : (N,), (r, N) float64
        The same, given the frames before it alone.
    v : (r,) float64
        The state over its prior: ``mean = prior_mean + prior_rows^T v``.
    noise, noise_variance : (r,) float64
        Of the step to the next frame: the mean of w, and its variances.
    log_likelihood : float
        Of the frame's measurement, given those before.
    """

    mean: Array
    rows: Array
    prior_mean: Array
    prior_rows: Array
    v: Array
    noise: Array
    noise_variance: Array
    log_likelihood: float


def smooth_linear(mean: Array, rows: Array, steps: Sequence[Step], measurements: Sequence[Measured]) -> list[Smoothed]:
    """Return the posterior of the state of each of T frames.

    Parameters
    ----------
    mean, rows : (N,), (r, N) float64
        Prior of the first state: its mean, and rows whose squares are its covariance, which may be singular.
    steps : sequence of T - 1 Step
        Their noise may be singular, too.
    measurements : sequence of T Measured

    Notes
    -----
    The states are written in coordinates v that are standard normal before their frame is seen, x = m + R^T v. One QR
    factorisation a frame, ``[L R F^T; N] = Q [R+; 0]``, takes the coordinates that are left (z, w) to those of the next
    frame and a rest e that no later frame tells of: (z, w) = Q (v+, e). Backwards the same Q gives the smoothed z and w
    of v+. No covariance is inverted. The result is that of Rauch, Tung and Striebel (1965, AIAA Journal 3(8), 1445), by
    the elimination of Paige and Saunders (1977, SIAM J. Numer. Anal. 14(2), 180); cost O(T N^3).
    """
    passes, turns = [], []
    for k, seen in enumerate(measurements):
        at, spread, likelihood = _updated(mean, rows, seen)
        passes.append((mean, rows, at, spread, likelihood))
        if k < len(steps):
            transition, offset, noise = steps[k]
            mean = transition @ (mean + rows.T @ at) + offset
            turn, upper = np.linalg.qr(np.concatenate([spread @ rows @ transition.T, noise]), mode="complete")
            rows = upper[: min(upper.shape)]
            turns.append(turn)
    v, wide = at, spread
    found = [Smoothed(mean + rows.T @ v, wide @ rows, mean, rows, v, np.zeros(0), np.zeros(0), likelihood)]
    for (mean, rows, at, spread, likelihood), turn in zip(passes[-2::-1], turns[::-1], strict=True):
        left, known = len(spread), v.size
        noise, unsure = turn[left:, :known] @ v, np.concatenate([wide @ turn[left:, :known].T, turn[left:, known:].T])
        rest = np.concatenate([wide @ turn[:left, :known].T, turn[:left, known:].T])
        v, wide = at + spread.T @ (turn[:left, :known] @ v), sr.triangular(rest @ spread)
        variance = np.einsum("ij,ij->j", unsure, unsure)
        found.append(Smoothed(mean + rows.T @ v, wide @ rows, mean, rows, v, noise, variance, likelihood))
    return found[::-1]


def _updated(mean: Array, rows: Array, seen: Measured) -> tuple[Array, Array, float]:
    """Return mean and rows of v after a measurement, and the measurement's log-likelihood."""
    (z, jacobian), r, m = seen, len(rows), len(seen[0])
    if not m:
        return np.zeros(r), np.eye(r), 0.0
    both = np.eye(m + r)
    both[m:, :m] = rows @ jacobian.T
    upper = sr.triangular(both)
    innovation = sr.compared(upper[:m, :m], z - jacobian @ mean)
    return upper[:m, m:].T @ innovation.whitened, upper[m:, m:], innovation.log_likelihood


ROOM = 6  # squares that are allowed in addition to one for each measurement
RIDGE = 1e-9  # of a covariance's diagonal, added to it when it is inverted


class Node(NamedTuple):
    """One frame of a path of states that follow from a start by the process and noise, linearised.

    Attributes
    ----------
    x : (N,) float64
    noise : (r,) float64
        Of the step from the frame before, of variance 1; empty in the first frame.
    predicted : StatePrediction
        From the frame before; of the first frame only its accelerations count.
    measurement : (m,), (m, N) float64
        Residuals of the observations, whitened, and their derivatives.
    """

    x: Array
    noise: Array
    predicted: StatePrediction
    measurement: Measured


def cost_of(start: Array, nodes: Sequence[Node]) -> float:
    """Return twice the negative logarithm of the posterior's density of a path, but for a constant."""
    terms = [start, *(node.noise for node in nodes), *(node.measurement[0] for node in nodes)]
    return float(sum(each @ each for each in terms))


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
    start : (r,) float64
        The first state over the factor of its prior.
    nodes : list of Node
        The path.
    smoothed : list of Smoothed
        The last Gauss-Newton step: deviations from the path, and the covariances of all frames.

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
        self.mean, self.rows, self.frames = mean, rows, [first]
        self.start, self._forgotten = np.zeros(len(rows)), 0.0
        self.smoothed: list[Smoothed] = []
        self.nodes = [self._node(first, StatePrediction(mean, np.zeros((0, 0)), qdd), np.zeros(0))]
        self._smoothe()

    @property
    def x(self) -> Array:
        """The last frame's state (N,)."""
        return self.nodes[-1].x

    @property
    def factor(self) -> Array:
        """Rows (r, N) whose squares are its covariance."""
        return self.smoothed[-1].rows

    @property
    def qdd(self) -> Array:
        """The last frame's angular accelerations (n,), rad/s^2."""
        return self.nodes[-1].predicted.qdd

    @property
    def states(self) -> Array:
        """The states of all frames (T, N)."""
        return np.array([node.x for node in self.nodes])

    @property
    def rope_states(self) -> tuple[RopeState, ...]:
        """The same as states of the rope, with covariances, each at the time of its picture less an estimated delay."""
        return tuple(
            self.process.rope_state(x, each.rows, frame.seen.t)
            for frame, x, each in zip(self.frames, self.states, self.smoothed, strict=True)
        )

    @property
    def log_likelihood(self) -> float:
        """Of all that was seen since the interval began, about the best path (Laplace's approximation)."""
        known = sum(each.log_likelihood for each in self.smoothed)
        return self._forgotten + known + sum(frame.log_determinant for frame in self.frames)

    @property
    def cost(self) -> float:
        """The path's :func:`cost_of`."""
        return cost_of(self.start, self.nodes)

    @property
    def misfit(self) -> float:
        """The posterior's squares over those of a right model: about 1, with some room."""
        return self.cost / (ROOM + sum(node.measurement[0].size for node in self.nodes))

    def append(self, frame: InputFrame) -> bool:
        """Add a frame; its state is at first the predicted one. Return False if it cannot be predicted."""
        try:
            node = self._next(self.nodes[-1].x, self.frames[-1], frame, np.zeros(len(frame.noise)))
        except SimulationError:
            return False
        self.nodes, self.frames = [*self.nodes, node], [*self.frames, frame]
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
        if not self.move(start, None, states):
            raise SimulationError("No rope moves along these states.", status=Status.NOT_FINITE, time=frames[0].seen.t)

    def forget(self) -> None:
        """Drop the first of two or more frames: its information remains in the prior of the second."""
        self._forgotten += self.smoothed[0].log_likelihood + self.frames[0].log_determinant
        self.frames, self.smoothed, (node, *rest) = self.frames[1:], self.smoothed[1:], self.nodes[1:]
        first = self.smoothed[0]
        self.mean, self.rows = node.x + first.prior_mean, first.prior_rows
        # before convergence, the path's start is not the smoothed one
        self.start = first.v - np.linalg.lstsq(self.rows.T, first.mean, rcond=RIDGE)[0]
        self.nodes = [node._replace(noise=np.zeros(0)), *rest]

    def solve(self, rounds: int) -> None:
        """Improve the path by at most `rounds` steps of Gauss-Newton."""
        for _ in range(rounds):
            before, part, moved = self.cost, 1.0, False
            if self._largest < CLOSE:
                return
            while not moved and part >= SHORTEST:
                moved = self._steer(part)
                part *= 0.5
            if not moved or before - self.cost < CLOSE**2:
                return

    def _smoothe(self) -> None:
        """Find the next Gauss-Newton step, and the covariances about the path."""
        steps = [
            (node.predicted.transition, -frame.noise.T @ node.noise, frame.noise)
            for node, frame in zip(self.nodes[1:], self.frames[1:], strict=True)
        ]
        measurements = [node.measurement for node in self.nodes]
        self.smoothed = smooth_linear(-self.rows.T @ self.start, self.rows, steps, measurements)

    @property
    def _largest(self) -> float:
        """By how many standard deviations the next step moves a noise or the start at most."""
        noises = zip(self.smoothed, self.nodes[1:], strict=False)
        changes = [self.smoothed[0].v - self.start, *(each.noise - node.noise for each, node in noises)]
        return max(float(np.abs(each).max(initial=0.0)) for each in changes)

    def _steer(self, part: float) -> bool:
        """Go to the path a part of a Gauss-Newton step away; return False if there is none, or no better one."""
        both = list(zip(self.nodes, self.smoothed, strict=True))
        states = [(node.x + part * step.mean, step.rows) for node, step in both]
        pairs = zip(self.nodes[1:], self.smoothed, strict=False)
        noises = [node.noise + part * (step.noise - node.noise) for node, step in pairs]
        return self.move(self.start + part * (self.smoothed[0].v - self.start), noises, states, self.cost)

    def move(
        self,
        start: Array,
        noises: Sequence[Array] | None = None,
        states: Sequence[tuple[Array, Array]] | None = None,
        limit: float = np.inf,
    ) -> bool:
        """Go to the path from a start (r,) over the prior's factor; return False, and stay, if there is none.

        Noises, those given or 0, are changed so that they steer the path along `states` (means and rows), if given.
        The path's cost must be below the limit.
        """
        first = self.nodes[0].predicted._replace(x=self.mean + self.rows.T @ start)
        nodes = [self._node(self.frames[0], first, np.zeros(0))]
        for k, frame in enumerate(self.frames[1:], start=1):
            if not cost_of(start, nodes) < limit:
                return False
            w = np.zeros(len(frame.noise)) if noises is None else noises[k - 1]
            target = None if states is None else states[k]
            try:
                nodes.append(self._next(nodes[-1].x, self.frames[k - 1], frame, w, target))
            except SimulationError:
                return False
        if not cost_of(start, nodes) < limit:
            return False
        self.start, self.nodes = start, nodes
        self._smoothe()
        return True

    def _next(
        self, x: Array, last: InputFrame, frame: InputFrame, w: Array, target: tuple[Array, Array] | None = None
    ) -> Node:
        """Return the node that follows from the last frame's state x with noise w, steered towards a target."""
        first = 2 * self.process.rope.n_links
        possible = np.concatenate([x[:first], self.process.parameters.possible(x[first:])])
        found = self.process.predict(possible, last.seen.t, frame.seen.t)
        if not (np.abs(found.x).max() < BEYOND and np.abs(found.transition).max() < BEYOND**2):
            raise SimulationError("The state is not finite.", status=Status.NOT_FINITE, time=frame.seen.t)
        found = found._replace(x=np.concatenate([found.x[:first], x[first:]]))
        if target is not None:
            w = w + _gain(frame.noise, target[1]) @ (target[0] - found.x - frame.noise.T @ w)
        return self._node(frame, found, w)

    def _node(self, frame: InputFrame, found: StatePrediction, w: Array) -> Node:
        """Return the node of a frame whose state is predicted up to the noise w."""
        x, seen = found.x + frame.noise[: w.size].T @ w, frame.seen
        residuals = np.zeros(0), np.zeros((0, x.size))
        if frame.used.any():
            residuals = frame.residuals(*self.model.predict(x, self.process.base(seen.t, x), seen.rows, found.qdd))
        return Node(x, w, found, residuals)


def _gain(noise: Array, rows: Array) -> Array:
    """Return N (N^T N + P)^-1, (r, N): how much noise answers a difference of states whose covariance is P."""
    wide = noise.T @ noise + rows.T @ rows
    size = np.sqrt(np.maximum(np.diag(wide), np.finfo(float).tiny))
    even = wide / size / size[:, None] + RIDGE * np.eye(len(wide))
    return np.linalg.solve(even, (noise / size).T).T / size
