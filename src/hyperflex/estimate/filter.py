"""Iterated square-root extended Kalman filter of a rope seen by its markers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.noise import NoiseLevel
from hyperflex.estimate.observations import MarkerModel, Observations
from hyperflex.estimate.parameters import EstimatedParameter, ParameterStates
from hyperflex.estimate.process import Process, smooth_shapes
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.vision import Camera

BEND = 0.6  # rad, standard deviation of a link's angle about the line through the markers, before any is seen
SPEED = 6.0  # rad/s, of its rate, in units of sqrt(g / L)
START_CORRELATION = 0.1  # of the rope's length
ROUNDS = 4  # of Gauss-Newton in an update; more at the start
FIRST_ROUNDS = 30
SHORTEST = 1e-2  # part of a Gauss-Newton step
CLOSE = 0.03  # of a standard deviation: an update has converged
BEYOND = 1e6  # rad, rad/s: a state or an uncertainty that no rope has
GATE = 23.0  # squared Mahalanobis distance of a place, exceeded once in 100,000 (chi square, 2 degrees of freedom)


class RopeFilter:
    """Estimates a rope's state from the places of its markers, frame by frame.

    Parameters
    ----------
    rope : Rope
    arc_lengths : (K,) array_like
        How far along the rope each marker sits, m from the first joint.
    motion, arm : Motion, Arm, optional
        What the first joint does; by default it hangs from a fixed point.
    camera : Camera, optional
        Where places are seen in pixels; by default in metres of the rope's plane.
    parameters : sequence of EstimatedParameter
        What is estimated beside the state.
    process_noise : float
        First guess of how much the links' accelerations differ from the model's, rad/s^2 per square root of Hz; it is
        corrected by what is seen.
    readout : float
        Known time from the first row of a picture to the last, s, where there is no `camera` to say so.

    Examples
    --------
    >>> import numpy as np, hyperflex as hf
    >>> from hyperflex.estimate import Observations, RopeFilter
    >>> rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=10, radius=0.002, friction=1e-4)
    >>> run = hf.simulate(rope, duration=1.0, q0=np.full(10, 0.5))
    >>> tracker = RopeFilter(rope, [0.2, 0.5, 0.7, 1.0])
    >>> for t, joints in zip(run.t[::4], run.joints[::4]):
    ...     tracker.update(Observations(t, joints[[2, 5, 7, 10]], std=0.002))
    >>> bool(np.linalg.norm(tracker.markers()[0][-1] - joints[10]) < 0.005)
    True
    """

    def __init__(
        self,
        rope: Rope,
        arc_lengths: npt.ArrayLike,
        *,
        motion: Motion | None = None,
        arm: Arm | None = None,
        camera: Camera | None = None,
        parameters: Sequence[EstimatedParameter] = (),
        process_noise: float = 1.0,
        readout: float = 0.0,
    ) -> None:
        self.parameters = ParameterStates(parameters, rope)
        self.process = Process(rope, self.parameters, motion, arm)
        self.model = MarkerModel(
            rope, arc_lengths, self.parameters, camera, readout if camera is None else camera.readout
        )
        self.process_noise = NoiseLevel(checks.number("process_noise", process_noise, sign="positive"))
        self.measurement_noise = NoiseLevel(1.0, doubt=0.7)
        self.t: float | None = None
        self.age = 0.0
        self.log_likelihood = 0.0
        self.innovation: sr.Innovation | None = None
        n = rope.n_links
        self.x = np.concatenate([np.zeros(2 * n), [each.value for each in self.parameters.all]])
        self.factor = np.zeros((self.x.size, self.x.size))
        self._qdd = np.zeros(n)
        self._last: Array | None = None  # rows of the noise of the step before

    @property
    def n_links(self) -> int:
        """Number of the rope's links."""
        return self.process.rope.n_links

    @property
    def state(self) -> RopeState:
        """The state, with its covariance."""
        if self.t is None:
            raise InvalidInput("nothing has been seen yet", allowed="update(observations) first")
        n = self.n_links
        part = self.factor[:, : 2 * n]
        return RopeState(self.t, self.x[:n].copy(), self.x[n : 2 * n].copy(), part.T @ part)

    @property
    def values(self) -> dict[str, tuple[float, float]]:
        """Each estimated parameter's value and standard deviation."""
        first = 2 * self.n_links
        std = np.linalg.norm(self.factor[:, first:], axis=0)
        return {
            name: (float(value), float(each))
            for name, value, each in zip(self.parameters.names, self.x[first:], std, strict=True)
        }

    def predict(self, dt: float) -> None:
        """Go on by `dt`, s, without looking.

        Raises
        ------
        InvalidInput
            If nothing has been seen yet, or dt is negative.
        SimulationError
            If no rope can move on from this state; :meth:`update` begins anew then.
        """
        if self.t is None:
            raise InvalidInput("nothing has been seen yet", allowed="update(observations) first")
        self.predict_to(self.t + checks.number("dt", dt, sign="nonnegative", unit="s"))

    def predict_to(self, t: float) -> None:
        """Go on to time t, s."""
        if self.t is None or t < self.t:
            raise InvalidInput("time goes backwards", got=t, allowed=f"at least {self.t} s")
        if t == self.t:
            return
        found = self.process.predict(self.x, self.t, t)
        self._last = self.process.noise(t - self.t, self.process_noise.value)
        with np.errstate(over="ignore", invalid="ignore"):
            factor = sr.predicted(self.factor, found.transition, self._last)
        if not (np.abs(factor).max() < BEYOND and np.abs(found.x).max() < BEYOND):
            raise SimulationError("the state is beyond all numbers", status="not finite", time=t)
        self.factor = factor
        self.age += t - self.t
        self.x, self.t, self._qdd = found.x, t, found.qdd

    def markers(self, rows: Array | None = None) -> tuple[Array, Array]:
        """Return where the markers should be seen (K, 2), and the covariances (K, 2, 2) of those places.

        The covariances are of the places themselves: what a detector adds is not in them.
        """
        if self.t is None:
            raise InvalidInput("nothing has been seen yet", allowed="update(observations) first")
        rows = np.zeros(len(self.model.arc_lengths)) if rows is None else rows
        places, slope = self.model.predict(self.x, self.process.base(self.t), rows, self._qdd)
        spread = np.matmul(self.factor, slope.transpose(0, 2, 1))
        return places, np.matmul(spread.transpose(0, 2, 1), spread)

    def readout_shift(self, rows: Array) -> tuple[Array, Array]:
        """Return by how much markers move until they are read (K, 2), and the covariances (K, 2, 2) of that.

        `rows` (K,) are those of :class:`Observations`.
        """
        base = self.process.base(self.state.t)
        late, now = (self.model.predict(self.x, base, each, self._qdd) for each in (rows, np.zeros_like(rows)))
        spread = np.matmul(self.factor, (late[1] - now[1]).transpose(0, 2, 1))
        return late[0] - now[0], np.matmul(spread.transpose(0, 2, 1), spread)

    def speeds(self) -> Array:
        """Return how fast the markers should move (K,), px/s or m/s."""
        n = self.n_links
        base = self.process.base(self.state.t)
        _, slope = self.model.predict(self.x, base, np.zeros(len(self.model.arc_lengths)))
        turning = slope[:, :, :n] @ self.x[n : 2 * n]
        camera = self.model.camera
        moved = base[1] if camera is None else camera.linearize(base[:1]).by_point[0] @ base[1]
        return np.asarray(np.linalg.norm(turning + moved, axis=1))

    def update(self, seen: Observations) -> None:
        """Look: go on to the time of the observations, and correct.

        Markers that are not seen (NaN), and those that cannot be theirs, change nothing. The first call begins.

        Raises
        ------
        InvalidInput
            If they are of another number of markers, or earlier than those before.
        """
        if len(seen.places) != len(self.model.arc_lengths):
            allowed = f"{len(self.model.arc_lengths)} markers"
            raise InvalidInput("observations are of another number of markers", got=len(seen.places), allowed=allowed)
        if self.t is None:
            self._begin(seen)
            return
        try:
            self.predict_to(seen.t)
        except SimulationError:  # a state that no rope has comes of places that are no markers'
            self.restart()
            self._begin(seen)
            return
        self._correct(seen, ROUNDS)

    def restart(self) -> None:
        """Forget the state; what was learnt of parameters and noise stays as a first guess."""
        self.t, self._last = None, None
        self.x[: 2 * self.n_links] = 0.0
        self._qdd[:] = 0.0

    def _begin(self, seen: Observations) -> None:
        """Take the first shape from the line through the markers, and correct it by what was seen."""
        n, rope = self.n_links, self.process.rope
        if not seen.seen.any():
            return
        self.t = seen.t
        base, camera = self.process.base(seen.t), self.model.camera
        in_metres = seen.places if camera is None else camera.locate(seen.places)
        self.x[:n] = polyline_angles(rope, self.model.arc_lengths, in_metres, base[0])
        rate = SPEED * np.sqrt(np.hypot(*rope.gravity) / rope.total_length)
        shapes = smooth_shapes(rope, START_CORRELATION)
        rows = np.zeros((2 * len(shapes) + 2 * n + len(self.parameters), self.x.size))
        rows[: len(shapes), :n] = BEND * shapes
        rows[len(shapes) : 2 * len(shapes), n : 2 * n] = rate * shapes
        rest = rows[2 * len(shapes) :]
        np.fill_diagonal(rest[:n, :n], 0.1 * BEND)
        np.fill_diagonal(rest[n : 2 * n, n : 2 * n], 0.1 * rate)
        np.fill_diagonal(rest[2 * n :, 2 * n :], [each.std for each in self.parameters.all])
        self.factor = sr.triangular(rows)
        self._correct(seen, FIRST_ROUNDS)

    def _correct(self, seen: Observations, rounds: int) -> npt.NDArray[np.bool_]:
        """Correct by Gauss-Newton on the posterior, and the covariance about where that ends; return what was used."""
        base = self.process.base(seen.t)
        found = self.model.predict(self.x, base, seen.rows, self._qdd)
        good = seen.seen & (self._plausible(seen, *found) if rounds == ROUNDS else True)
        if not good.any():
            return good
        self.age = 0.0
        whiten = np.linalg.inv(np.linalg.cholesky(seen.covariances[good])) / self.measurement_noise.value

        def compared(found: tuple[Array, Array]) -> tuple[Array, Array]:
            """Return whitened differences (m,) from a prediction, and the whitened derivatives (m, N) of that."""
            left = whiten @ (seen.places[good] - found[0][good])[:, :, None]
            return left.ravel(), (whiten @ found[1][good]).reshape(left.size, -1)

        std = np.ones(2 * len(whiten))
        before, u, cost = self.x, np.zeros(self.x.size), np.inf  # the state is before + factor' u
        x, (left, jacobian) = before, compared(found)
        for turn in range(rounds):
            gain, upper = sr.whitened_gain(self.factor, jacobian, std)
            if turn == 0:
                self.innovation = sr.compared(upper, left)
                self.log_likelihood += self.innovation.log_likelihood + np.log(np.linalg.det(whiten)).sum()
                self._learn(self.innovation, jacobian, upper)
            step, part, now = gain @ (left + jacobian @ (x - before)) - u, 1.0, np.inf
            while True:
                tried = before + self.factor.T @ (u + part * step)
                left, jacobian = compared(self.model.predict(tried, base, seen.rows, self._qdd))
                now = float(((u + part * step) ** 2).sum() + (left**2).sum())
                if now <= cost or part < SHORTEST:
                    break
                part *= 0.5
            x, u, cost = tried, u + part * step, now
            if part * np.abs(step).max() < CLOSE:
                break
        self.factor = sr.updated(self.factor, jacobian, std)
        first = 2 * self.n_links
        x[first:] = self.parameters.possible(x[first:])
        self.x = x
        return good

    def _plausible(self, seen: Observations, places: Array, slope: Array) -> npt.NDArray[np.bool_]:
        """Return which places lie within their gates; all of them where hardly any does, for then it is the state."""
        spread = np.matmul(self.factor, slope.transpose(0, 2, 1))
        wide = np.matmul(spread.transpose(0, 2, 1), spread)
        wide += self.measurement_noise.value**2 * seen.covariances
        left = np.nan_to_num(seen.places - places)
        far = np.einsum("kc,kc->k", left, np.linalg.solve(wide, left[:, :, None])[:, :, 0])
        good = far < GATE
        return good if (good & seen.seen).sum() * 2 > seen.seen.sum() else np.ones_like(good)

    def _learn(self, innovation: sr.Innovation, jacobian: Array, upper: Array) -> None:
        """Correct the levels of process and measurement noise by the innovation."""
        if self._last is not None:
            half = solve_triangular(upper, jacobian @ self._last.T, trans="T", check_finite=False)
            self.process_noise.see(innovation.whitened, half @ half.T)
            half = solve_triangular(upper, np.eye(len(upper)), trans="T", check_finite=False)
            self.measurement_noise.see(innovation.whitened, half @ half.T)


def polyline_angles(rope: Rope, arc_lengths: Array, places: Array, base: Array) -> Array:
    """Return link angles (n,), rad, along the line from the first joint through markers, NaN where not seen."""
    seen = ~np.isnan(places[:, 0])
    arcs = np.concatenate([[0.0], arc_lengths[seen]])
    points = np.concatenate([base[None], places[seen]])
    order = np.argsort(arcs, kind="stable")
    arcs, points = arcs[order], points[order]
    apart = np.diff(arcs) > 1e-9
    ends, sides = arcs[1:][apart], np.diff(points, axis=0)[apart]
    if not len(sides):
        return np.full(rope.n_links, rope.hanging_angle)
    angles = np.unwrap(np.arctan2(sides[:, 0], -sides[:, 1]))
    middle = np.cumsum(rope.length) - 0.5 * rope.length
    return np.asarray(angles[np.minimum(np.searchsorted(ends, middle), len(angles) - 1)])
