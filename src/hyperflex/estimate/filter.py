"""Iterated square-root extended Kalman filter of a rope seen by its markers."""

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, Flags
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.changes import Change, ChangeDetector, ChangeTests, Found
from hyperflex.estimate.noise import AT_REST, QUIET, NoiseDerivatives, NoiseLevel
from hyperflex.estimate.observations import InputFrame, MarkerModel, Observations, polyline_angles
from hyperflex.estimate.parameters import EstimatedParameter, ParameterStates
from hyperflex.estimate.process import BEYOND, DISTURBANCES, Process
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope, unit_across, unit_along
from hyperflex.motion import Motion
from hyperflex.status import Status
from hyperflex.vision import Camera


class ValidationGate:
    """Decides which of K places are near enough to their predictions.

    Notes
    -----
    If most of several places are outside of their gates, all are accepted, and so is a place that has been outside for
    some frames: then it is the state that is wrong (Bar-Shalom, Fortmann, *Tracking and Data Association*, 1988). One
    or two places alone do not tell which of both is wrong: they are rejected at first.
    """

    GATE = 23.0  # squared Mahalanobis distance, exceeded once in 100,000 (chi square, 2 degrees of freedom)
    PERSISTENT = 2  # frames in a row outside of its gate, after which a place is accepted
    ENOUGH = 3  # places seen: if most of them are outside, all are accepted

    def __init__(self, count: int) -> None:
        self._outside = np.zeros(count, dtype=np.int64)

    def accepted(self, off: Array, covariances: Array) -> Flags:
        """Return which places are accepted (K,), from differences (K, 2), NaN: not seen, and their covariances."""
        seen, known = ~np.isnan(off[:, 0]), np.nan_to_num(off)
        far = np.einsum("kc,kc->k", known, np.linalg.solve(covariances, known[:, :, None])[:, :, 0])
        good = far < self.GATE
        self._outside = np.where(good | ~seen, 0, self._outside + 1)
        good |= self._outside >= self.PERSISTENT
        outside = int((seen & ~good).sum())
        return np.ones_like(good) if seen.sum() >= self.ENOUGH and 2 * outside > seen.sum() else good


class RopeFilter:
    """Estimates a rope's state from the places of its markers, frame by frame.

    Parameters
    ----------
    rope : Rope
    arc_lengths : (K,) array_like
        How far along the rope each marker is, m from the first joint.
    motion, arm : Motion, Arm, optional
        Of the first joint; by default it is fixed.
    camera : Camera, optional
        With it, places are in pixels; by default in metres of the rope's plane.
    parameters : sequence of EstimatedParameter
        Estimated beside the state.
    process_noise : float
        First guess of how much the links' accelerations differ from the model's, rad/s^2 per square root of Hz; it is
        adapted to the observations.
    readout : float
        Known time from the first row of a picture to the last, s, if there is no `camera`.
    tests : ChangeTests, optional
        Tests for changes; by default none. When the change of a parameter is noticed, the state is corrected by its
        effect since it happened, and the parameter is estimated from then on.

    Attributes
    ----------
    changes : tuple of Change
        Those that the last update noticed.

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

    UPDATE_ROUNDS, START_UPDATE_ROUNDS = 4, 30  # of Gauss-Newton in an update, and at the start
    ROUGHLY = 6.0  # factor of what a covariance omits, for derivatives by noise levels: they need less accuracy

    def __init__(
        self,
        rope: Rope,
        arc_lengths: ArrayLike,
        *,
        motion: Motion | None = None,
        arm: Arm | None = None,
        camera: Camera | None = None,
        parameters: Sequence[EstimatedParameter] = (),
        process_noise: float = 1.0,
        readout: float = 0.0,
        tests: ChangeTests | None = None,
    ) -> None:
        tested = () if tests is None else tests.parameters_for(rope)
        self.parameters = ParameterStates(parameters, rope, tested, motion is not None)
        self.process = Process(rope, self.parameters, motion, arm)
        self.model = MarkerModel(
            rope, arc_lengths, self.parameters, camera, readout if camera is None else camera.readout
        )
        density = checks.number("process_noise", process_noise, sign="positive")
        self.process_noise = NoiseLevel(np.full(2, density), least=QUIET)
        self.measurement_noise = NoiseLevel(1.0, doubt=0.7, least=AT_REST)
        self.t: float | None = None
        self.age, self.log_likelihood = 0.0, 0.0
        self.used = np.zeros(len(self.model.arc_lengths), dtype=bool)  # which markers the last update used
        self.innovation: sr.Innovation | None = None
        n = rope.n_links
        self.x = np.concatenate([np.zeros(2 * n), self.parameters.start])
        self.factor = np.diag(np.concatenate([np.zeros(2 * n), self.parameters.std]))
        self.changes: tuple[Change, ...] = ()
        self._detector = None if tests is None else ChangeDetector(tests, self.process, self.parameters)
        self._std = self.parameters.std.copy()
        self._qdd = np.zeros(n)
        self._least = self.process.least(self.x)
        self._by_noise = NoiseDerivatives(2, self.x.size)

    @property
    def n_links(self) -> int:
        """Number of the rope's links."""
        return self.process.rope.n_links

    @property
    def state(self) -> RopeState:
        """The state at the time of the last picture less an estimated delay, with its covariance."""
        return self.process.rope_state(self.x, self.factor, self._now)

    @property
    def values(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of each parameter that is estimated, or whose change was noticed."""
        return self.parameters.estimates(self.x, self.factor)

    def predict(self, dt: float) -> None:
        """Predict the state `dt`, s, ahead.

        Raises
        ------
        InvalidInput
            If nothing has been seen yet, or dt is negative.
        SimulationError
            If the rope's equations cannot be integrated from this state; :meth:`update` then starts anew.
        """
        self.predict_to(self._now + checks.number("dt", dt, sign="nonnegative", unit="s"))

    def predict_to(self, t: float) -> None:
        """Predict the state at time t, s."""
        if self.t is None or t < self.t:
            raise InvalidInput("time goes backwards", got=t, allowed=f"at least {self.t} s")
        if t == self.t:
            return
        before, start = self.x, self.t
        transitions = [self._step(begin, end) for begin, end in self.process.steps(start, t)]
        if self._detector is not None:
            self._detector.predict((before, self.x), start, t, reduce(lambda first, then: then @ first, transitions))
        self._qdd = self.process.accelerations(self.x, t)

    def _step(self, begin: float, end: float) -> Array:
        """Predict one step; return its transition (N, N) if changes are tested for."""
        carried = [self.factor, *self._by_noise.rows]
        with np.errstate(over="ignore", invalid="ignore"):
            if self._detector is None:
                shares, transition = self._by_noise.shares(self.factor, self._least), np.zeros((0, 0))
                x, moved = self.process.carry(self.x, self.factor, begin, end)
                rows = np.concatenate([moved, shares @ moved])
            else:
                x, columns = self.process.carry(self.x, np.eye(self.x.size), begin, end)
                transition, rows = columns.T, np.concatenate(carried) @ columns
        if not (np.abs(rows).max() < BEYOND and np.abs(x).max() < BEYOND):
            raise SimulationError("The state is not finite.", status=Status.NOT_FINITE, time=end)
        factor, *by_noise = np.split(rows, np.cumsum([len(each) for each in carried])[:-1])
        noise = self.process.noise(end - begin, self.process_noise.value)
        self.factor = sr.compressed(np.concatenate([factor, noise]), self._least)
        self._by_noise.predict(by_noise, np.split(noise, self.process.noise_ends)[:2], self.ROUGHLY * self._least)
        self.age += end - begin
        self.x, self.t = x, end
        return transition

    def state_at(self, t: float) -> RopeState:
        """Return the state predicted for a time t, s, not earlier than the last; the filter does not change.

        Raises
        ------
        SimulationError
            If the rope's equations cannot be integrated from this state.
        """
        return self.process.state_at(self.x, self.factor, self._now, t, self.process_noise.value)

    def joints(self, state: RopeState) -> tuple[Array, Array]:
        """Return joints and tip (n + 1, 2) in a state, m, and their derivatives (n + 1, 2, n) by the angles."""
        lengths = self.process.rope.length * (1.0 + self.parameters.value("length", self.x[2 * self.n_links :]))
        before = np.tril(np.ones((lengths.size + 1, lengths.size)), -1)
        first = self.process.base(state.t)[0] + self.parameters.base_offset(self.x[2 * self.n_links :])
        places = first + before @ (lengths[:, None] * unit_along(state.q))
        return places, before[:, None, :] * (lengths * unit_across(state.q, 0))

    def tip(self, state: RopeState) -> tuple[Array, Array]:
        """Return the place (2,) of the tip in a state, m, and its covariance (2, 2)."""
        places, slopes = self.joints(state)
        return places[-1], spread(slopes[-1:], state.covariance)[0]

    def markers(self) -> tuple[Array, Array]:
        """Return where the markers are expected (K, 2), and the covariances (K, 2, 2), without a detector's noise."""
        places, joint, _ = self.expected()
        return places, each_covariance(joint)

    def expected(self, rows: Array | None = None) -> tuple[Array, Array, Array]:
        """Return where the markers are expected (K, 2), the covariance (2 K, 2 K) of all of them, and their speeds.

        The speeds (K,) are in px/s or m/s; `rows` (K,) are those of :class:`Observations`.
        """
        base = self.base
        rows = np.zeros(len(self.model.arc_lengths)) if rows is None else rows
        places, slope = self.model.predict(self.x, base, rows, self._qdd)
        n, camera = self.n_links, self.model.camera
        moved = base[1] if camera is None else camera.linearize(base[:1])[1][0] @ base[1]
        velocity = slope[:, :, :n] @ self.x[n : 2 * n] + moved
        return places, self._joint_covariance(slope), np.hypot(velocity[:, 0], velocity[:, 1])

    def pixels_of(self, model: MarkerModel, rows: Array) -> Array:
        """Return where points of another model of this rope (P, 2) are expected; `rows` (P,) are its own."""
        return model.predict(self.x, self.base, rows, self._qdd)[0]

    def readout_shift(self, rows: Array) -> tuple[Array, Array]:
        """Return how far markers move until they are read (K, 2), and the covariances (K, 2, 2) of that.

        `rows` (K,) are those of :class:`Observations`.
        """
        if not self.model.reads_rows:
            return np.zeros((len(rows), 2)), np.zeros((len(rows), 2, 2))
        base = self.base
        late, now = (self.model.predict(self.x, base, each, self._qdd) for each in (rows, np.zeros_like(rows)))
        return late[0] - now[0], each_covariance(self._joint_covariance(late[1] - now[1]))

    def _joint_covariance(self, slopes: Array) -> Array:
        """Return the covariance (2 K, 2 K) of K places with derivatives (K, 2, N) by the state."""
        moves = self.factor @ slopes.reshape(-1, self.x.size).T
        return moves.T @ moves

    @property
    def _now(self) -> float:
        if self.t is None:
            raise InvalidInput("nothing has been seen yet", allowed="update(observations) first")
        return self.t

    @property
    def base(self) -> Array:
        """Place, velocity and acceleration (3, 2) of the first joint now, m, m/s, m/s^2."""
        return self.process.base(self._now, self.x)

    def update(self, seen: Observations) -> None:
        """Predict to the time of the observations, and correct. The first call starts the estimate.

        Markers that are not seen (NaN), and those that are rejected, have no effect.

        Raises
        ------
        InvalidInput
            If their number is another one, or they are earlier than those before.
        """
        if len(seen.places) != len(self.model.arc_lengths):
            allowed = f"{len(self.model.arc_lengths)} markers"
            raise InvalidInput("observations are of another number of markers", got=len(seen.places), allowed=allowed)
        self.changes = ()
        if self.t is not None:
            try:
                self.predict_to(seen.t)
            except SimulationError:  # wrong observations have led to an impossible state
                self.restart()
        if self.t is None:
            self._begin(seen)
        else:
            self._correct(seen, first=False)

    def restart(self) -> None:
        """Forget the state; parameters and noise levels remain as first guesses."""
        self.t = None
        self.x[: 2 * self.n_links] = 0.0
        self._qdd[:] = 0.0

    def _begin(self, seen: Observations) -> None:
        """Start from the line through the markers."""
        n, rope = self.n_links, self.process.rope
        if not seen.seen.any():
            return
        self.t = seen.t
        base, camera = self.process.base(seen.t, self.x), self.model.camera
        in_metres = seen.places if camera is None else camera.locate(seen.places)
        self.x[:n] = polyline_angles(
            rope, self.model.arc_lengths, in_metres, base[0] + self.parameters.base_offset(self.x[2 * n :])
        )
        self.factor = sr.compressed(DISTURBANCES.starting_rows(rope, self._std), self._least)
        self._by_noise = NoiseDerivatives(2, self.x.size)
        self._gate = ValidationGate(len(seen.places))
        if self._detector is not None:
            self._detector.begin(seen.t + self._detector.SETTLE_TIME)
        self._correct(seen, first=True)

    def _correct(self, seen: Observations, *, first: bool) -> None:
        """Correct by Gauss-Newton on the posterior, and the covariance about its mode."""

        def predicted(x: Array) -> tuple[Array, Array]:
            return self.model.predict(x, self.process.base(seen.t, x), seen.rows, self._qdd)

        places, slope = predicted(self.x)
        used, level = seen.seen & self.model.possible(seen.places, self.base), self.measurement_noise.value
        if not first:
            wide = each_covariance(self._joint_covariance(slope)) + level**2 * seen.covariances
            used &= self._gate.accepted(seen.places - places, wide)
        self.used = used
        if not used.any():
            return
        self.age, found = 0.0, None
        frame = InputFrame(seen, used, level)
        residual, jacobian = frame.residuals(places, slope)
        across, upper = sr.innovation_factor(self.factor, jacobian)
        # noise levels and tests use the innovation before the state is corrected
        self.innovation = sr.compared(upper, residual)
        self.log_likelihood += self.innovation.log_likelihood + frame.log_determinant
        innovation = jacobian, self.factor.T @ sr.weighted(upper, across.T).T, upper, self.innovation.whitened
        if not first:
            self._learn(*innovation)
        if self._detector is not None:
            found = self._detector.update(seen.t, *innovation)
            self.changes = self._detector.misfit(seen.t, self.measurement_noise)
        rounds = self.START_UPDATE_ROUNDS if first else self.UPDATE_ROUNDS
        self.x, self.factor = sr.iterated_update(
            self.x, self.factor, lambda x: frame.residuals(*predicted(x)), rounds, (residual, jacobian, across, upper)
        )
        own = 2 * self.n_links
        self.x[own:] = self.parameters.possible(self.x[own:])
        if found is not None:
            self._adopt(found)

    def _adopt(self, found: Found) -> None:
        """Correct the state by the effect of a change; a changed parameter is estimated from then on."""
        self.factor = sr.compressed(np.concatenate([self.factor, found.rows]), self._least)
        if found.change is None:
            return
        self.changes = (*self.changes, found.change)
        if found.change.name in self.parameters.names:
            k, first = self.parameters.names.index(found.change.name), 2 * self.n_links
            self._std[k] = max(self._std[k], abs(found.change.size))
            self.x = self.x + found.moved
            self.x[first:] = self.parameters.possible(self.x[first:])
            self._least[first + k] = self.process.least(self.x)[first + k]

    @property
    def _adapts(self) -> bool:
        """Whether noise levels are adapted."""
        return True

    def _learn(self, jacobian: Array, gain: Array, upper: Array, whitened: Array) -> None:
        """Adapt the levels of process and measurement noise to the innovation."""
        derivatives = self._by_noise.update(jacobian, gain, upper, whitened)
        if self._adapts:
            half = sr.solved(upper, np.eye(len(upper)), transposed=True)
            self.process_noise.see(whitened, *derivatives)
            self.measurement_noise.see(whitened, (half @ half.T)[None])


def spread(slopes: Array, covariance: Array | None) -> Array:
    """Return covariances (K, 2, 2) of places with derivatives (K, 2, n) by the first n values of a state.

    `covariance` (N, N) is the state's; None: 0.
    """
    n = slopes.shape[2]
    wide = np.zeros((n, n)) if covariance is None else covariance[:n, :n]
    return slopes @ wide @ slopes.transpose(0, 2, 1)


def each_covariance(joint: Array) -> Array:
    """Return the covariance (K, 2, 2) of each of K points from that of all together (2 K, 2 K)."""
    count = len(joint) // 2
    each = np.arange(count)
    return joint.reshape(count, 2, count, 2)[each, :, each]
