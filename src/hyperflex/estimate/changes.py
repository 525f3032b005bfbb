"""Tests for changes of a named parameter and for a touch: generalised likelihood ratios of a filter's innovations."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import log_ndtr

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.noise import NoiseLevel
from hyperflex.estimate.parameters import NAMES, ROPE_KINDS, ParameterStates, kind
from hyperflex.estimate.process import Process
from hyperflex.model import Rope
from hyperflex.sensors import lever_arms

TOUCH, MISFIT = "touch", "misfit"
WEIGHT_TOLERANCE = 1e-3  # of the rope's weight: force of a touch that does not count


@dataclass(frozen=True)
class ChangeTests:
    """The changes that are tested for, and the rate of false alarms.

    Parameters
    ----------
    names : tuple of str, optional
        Parameters as in :class:`EstimatedParameter`, estimated or not, and ``"touch"``: an external force for a moment.
        By default ``"length"``, ``"tip_mass"``, ``"friction"`` and ``"drag"`` of a rope that has any, and ``"touch"``.
    false_alarm_interval : float
        Least mean time between two false alarms of all tests together, s, if the filter's model is right.
    tolerances : mapping of str to float
        Sizes that do not count as a change, in each parameter's unit; of a touch its force, N. By default: 0.2 % of
        lengths, 30 % of friction and drag, 0.4 % of the rope's mass at the tip, 0.1 % of its weight, ...
    settle_time : float
        Time after the first frame from which on is tested, s.
    history, touch_history : float
        Age of the oldest moment at which a parameter may have changed, and a touch may have begun, s.
    touch_places : int
        Number of places along the rope at which a touch is tested.
    """

    names: tuple[str, ...] | None = None
    false_alarm_interval: float = 600.0
    tolerances: Mapping[str, float] = field(default_factory=dict)
    settle_time: float = 1.0
    history: float = 10.0
    touch_history: float = 0.35
    touch_places: int = 10

    def __post_init__(self) -> None:
        """Check the values."""
        for name in (*(self.names or ()), *self.tolerances):
            if name != TOUCH and kind(name) is None:
                allowed = ", ".join((*NAMES, TOUCH))
                raise InvalidInput("there is no test for a change of this", got=name, allowed=allowed)
        for name, value in self.tolerances.items():
            checks.number(f"tolerance of {name}", value, sign="nonnegative")
        for name in ("false_alarm_interval", "settle_time", "history", "touch_history"):
            checks.number(name, getattr(self, name), sign="positive", unit="s")
        checks.count("touch_places", self.touch_places)

    def names_for(self, rope: Rope) -> tuple[str, ...]:
        """Return what is tested of a rope."""
        if self.names is not None:
            return tuple(dict.fromkeys(self.names))
        always = ("length", "tip_mass", TOUCH)
        return tuple(name for name in (*ROPE_KINDS, TOUCH) if name in always or getattr(rope, name).any())

    def parameters_for(self, rope: Rope) -> tuple[str, ...]:
        """Return which parameters of a rope are tested: all but touches."""
        return tuple(name for name in self.names_for(rope) if name != TOUCH)

    def tolerance(self, name: str, rope: Rope) -> float:
        """Return the largest size of a parameter's change, or of a touch's force, that does not count."""
        known = kind(name)
        if known is None:
            default = WEIGHT_TOLERANCE * rope.total_mass * math.hypot(*rope.gravity)
        else:
            default = known.tolerance * (rope.total_mass if name == "tip_mass" else 1.0)
        return self.tolerances.get(name, default)


@dataclass(frozen=True)
class Change:
    """A change that was noticed.

    Attributes
    ----------
    name : str
        Of the parameter, or ``"touch"``; or ``"misfit"``: the errors of the markers are larger than declared, and no
        other change explains it. The rope swings out of its plane, for example, or the camera has moved.
    noticed, time : float
        When it was noticed, and when it most likely happened (began), s.
    size, std : float
        Change of the parameter and its standard deviation, in its unit; of a touch its impulse until it was noticed,
        N s; of a misfit the markers' noise over the declared one.
    probability : float
        That it is this and none of the other changes that are tested for, all names equally likely before.
    log_false_alarm : float
        Logarithm of the probability of such a clear sign, in this test at one time, if nothing has changed.
    arc_length : float or None
        Of a touch: about where along the rope, m from the first joint.
    impulse : (float, float) or None
        Of a touch: its x and y, N s.
    """

    name: str
    noticed: float
    time: float
    size: float
    std: float
    probability: float
    log_false_alarm: float
    arc_length: float | None = None
    impulse: tuple[float, float] | None = None

    def __str__(self) -> str:
        """Return a sentence."""
        if self.name == MISFIT:
            ratio = f"{self.size:.2g} times the declared ones"
            return f"misfit: errors of the markers are {ratio}, noticed at {self.noticed:.2f} s"
        known = kind(self.name)
        what = f"{self.name}: {self.size:+.3g}" if known else f"{self.name} at {self.arc_length:.2f} m: {self.size:.3g}"
        return (
            f"{what} ± {self.std:.2g} {known.unit if known else 'N s'}".rstrip()
            + f", since {self.time:.2f} s, noticed at {self.noticed:.2f} s, {100.0 * self.probability:.0f} % sure"
        )


class Found(NamedTuple):
    """The sign of a change in a frame.

    Attributes
    ----------
    change : Change or None
        None for a touch that continues.
    moved : (N,) float64
        Effect on the mean of the state.
    rows : (r, N) float64
        Rows that widen its covariance.
    """

    change: Change | None
    moved: Array
    rows: Array


class _Signatures:
    """Effects of possible changes on the state, and the sums of their effects on the innovations.

    Parameters
    ----------
    size : int
        Of the state, N.
    places, axes : int
        At how many places a change is possible, and along how many axes: P and a. Sums over w changes of different
        moments are kept for each place alone.

    Attributes
    ----------
    states : (N, w P a) float64
        Errors of the state, per unit of each change: moment by moment, in these place by place.
    information : (P, w a, w a), score : (P, w a) float64
    """

    def __init__(self, size: int, places: int = 1, axes: int = 1) -> None:
        self._places, self._axes = places, axes
        self.states, self.information, self.score = np.zeros((size, 0)), np.zeros((places, 0, 0)), np.zeros((places, 0))

    def add(self, columns: Array) -> None:
        """Add changes (N, P a) that begin."""
        more = ((0, 0), (0, self._axes))
        self.states = np.concatenate([self.states, columns], axis=1)
        self.information, self.score = np.pad(self.information, (*more, more[1])), np.pad(self.score, more)

    def keep(self, good: npt.NDArray[np.bool_]) -> None:
        """Keep the changes of some moments (w,)."""
        if not good.all():
            own = np.flatnonzero(np.repeat(good, self._axes))
            self.states = self.states[:, np.repeat(good, self._places * self._axes)]
            self.information, self.score = self.information[:, own[:, None], own], self.score[:, own]

    def update(self, jacobian: Array, gain: Array, upper: Array, whitened: Array) -> None:
        """Add the effects on an innovation, and correct the errors as the filter does its own."""
        seen = jacobian @ self.states
        shape = self.score.shape[1] // self._axes, self._places, self._axes, len(seen)
        by_moment = sr.solved(upper, seen, transposed=True).T.reshape(shape)
        effect = by_moment.swapaxes(0, 1).reshape(*self.score.shape, len(seen))
        self.score = self.score + effect @ whitened
        self.information = self.information + effect @ effect.transpose(0, 2, 1)
        self.states = self.states - gain @ seen


class ChangeDetector:
    """Tests the innovations of a filter for the effects of changes.

    Parameters
    ----------
    tests : ChangeTests
    process : Process
    states : ParameterStates
        All tested parameters are among them.

    Notes
    -----
    A change of size theta moves the mean of the whitened innovations by ``G theta``, where G is propagated through the
    filter: an error d of the prediction becomes ``F (I - K H) d`` in the next one (Willsky and Jones 1976, IEEE
    Transactions on Automatic Control 21, 108-112). A parameter jumps at one of some moments in its history, denser the
    later; a touch is a force along x and y at one of some places, in one interval between two frames or from then until
    now. With the sums ``A = G' G`` and ``b = G' nu``, theta is ``A^-1 b`` of covariance ``A^-1``, and
    ``(|theta| - tolerance)^2 A`` is at most a chi square if nothing more than the tolerance has changed.
    A sign counts as an alarm if its probability is less than 1 / (false alarms allowed per frame x number of tests),
    by Bonferroni's bound; the tests are correlated, so that false alarms are rarer than stated.
    """

    MISFIT_TIME = 2.0  # s that a misfit lasts until it is reported: noise levels remember a touch for about as long
    MISFIT_LEVEL = 1.25  # times the declared noise of the markers that does not count
    GAP, LONGER_GAP = (
        0.25,
        2.5,
    )  # s without any marker, and times the usual frame interval, after which tests start anew
    SPACING, TOUCH_SPACING = 0.1, 0.03  # s between the moments at which a parameter may change, and a touch may begin
    PER_DOUBLING = 4  # moments until their spacing grows with their age
    LIKELY_MASS = 0.04  # of the rope's mass: size of a mass at the tip for which its effect is computed
    SHARED = 0.25  # s after a touch was noticed in which it may still turn out to be the change of a parameter
    CALM = 0.5  # s without a sign of a touch, after which the next one is another touch
    SHORT_TOUCH = 0.1  # s: in a shorter touch the force that does not count is larger, with the same impulse
    POSSIBLE = 2.0  # standard deviations by which a size may be beyond what a rope can have
    DOUBT = 2.0  # factor of the standard deviation of a noticed change: its moment was selected among many

    def __init__(self, tests: ChangeTests, process: Process, states: ParameterStates) -> None:
        rope = process.rope
        self.tests, self._process, self.names = tests, process, tests.parameters_for(rope)
        self._n, self._size = rope.n_links, 2 * rope.n_links + len(states)
        own = [states.names.index(name) for name in self.names]
        self._columns = [2 * self._n + k for k in own]
        self._heavier, self._mass = process.copy(), self.LIKELY_MASS * rope.total_mass
        self._tolerances = np.array([tests.tolerance(name, rope) for name in self.names])
        self._least = states.possible(np.full(len(states), -np.inf))[own]
        self._values = np.zeros(len(self.names))
        count = tests.touch_places if TOUCH in tests.names_for(rope) else 0
        self.places: Array = np.arange(1.0, count + 1.0) * (rope.total_length / tests.touch_places)
        self._arms = lever_arms(rope, self.places)[1]
        self._force_tolerance = tests.tolerance(TOUCH, rope)
        self._latest = self._touched = -math.inf  # time of the last frame, and of the last sign of a touch, s
        self._interval = self._usual = self._shared_until = self._fitted = math.inf
        self._misfits = False
        self.begin(math.inf)

    def begin(self, t: float) -> None:
        """Test nothing before `t`, s."""
        self._since = t
        self._parameters = [_Signatures(self._size) for _ in self.names]
        self._touches = _Signatures(self._size, len(self.places), 2)
        self._moments, self._indices, self._begun = np.zeros(0), np.zeros(0, dtype=int), np.zeros(0)
        self._kicks: Array | None = None
        self._count, self._spaced = 0, -math.inf

    def settle(self, t: float) -> None:
        """Test nothing until the filter, which started at `t`, s, has settled."""
        self.begin(t + self.tests.settle_time)

    def predict(self, x: tuple[Array, Array], t: float, until: float, transition: Array) -> None:
        """Predict from time t, s, to `until`.

        Parameters
        ----------
        x : (N,), (N,) float64
            States at both times.
        t, until : float
        transition : (N, N) float64
            Derivatives of the latter state by the former.
        """
        if t < self._since:
            return
        self._values = x[1][self._columns]
        for name, column, each in zip(self.names, self._columns, self._parameters, strict=True):
            begun, moved = transition[:, [column]], transition @ each.states
            if name == "tip_mass":
                begun, moved = self._with_mass(x, t, until, transition, column, each.states)
            each.states = moved
            each.add(begun)
        lasting = t >= self._spaced + self.SPACING * (1.0 - 1e-6)
        self._moments = np.append(self._moments, t)
        self._indices = np.append(self._indices, self._count if lasting else -1)
        if lasting:
            self._spaced, self._count = t, self._count + 1
        self._touches.states = transition @ self._touches.states
        if not self.places.size:
            return
        dt, n = until - t, self._n
        before = self._process.kicks(x[0][:n], self._arms) if self._kicks is None else self._kicks
        self._kicks = after = self._process.kicks(x[1][:n], self._arms)
        pushed = 0.5 * dt * (transition[:, n : 2 * n] @ before)
        pushed[n : 2 * n] += 0.5 * dt * after
        if not self._begun.size or t >= self._begun[-1] + self.TOUCH_SPACING * (1.0 - 1e-6):
            self._touches.add(pushed)
            self._begun = np.append(self._begun, t)
        else:
            self._touches.states[:, -pushed.shape[1] :] += pushed

    def update(self, t: float, jacobian: Array, gain: Array, upper: Array, whitened: Array) -> Found | None:
        """Add an innovation; return the change of which it is a sign, and its effect on the state.

        Parameters
        ----------
        t : float
        jacobian : (m, N) float64
            Derivatives H of the whitened observations.
        gain : (N, m) float64
            K, by which the state was corrected.
        upper : (m, m) float64
            Factor of the innovation's covariance.
        whitened : (m,) float64
            The innovation over its standard deviation.
        """
        latest, usual, self._latest = self._latest, self._usual, t
        self._interval = t - latest
        if 0.0 < self._interval < math.inf:
            self._usual = min(1.1 * usual, self._interval)
        if t < self._since:
            return None
        if self._interval > max(self.GAP, self.LONGER_GAP * usual):
            self.begin(t)
            return None
        for each in (*self._parameters, self._touches):
            each.update(jacobian, gain, upper, whitened)
        self._kicks = None  # the state has changed
        found = self._evaluate(t)
        good = self._kept_moments(t)
        if self._touched == latest:  # the touch is over
            self._shared_until = t
        if self._shared_until <= t:  # it was a touch: its effect on the innovations is not that of a parameter
            good[:], self._shared_until = False, math.inf
        for each in self._parameters:
            each.keep(good)
        self._moments, self._indices = self._moments[good], self._indices[good]
        good = self._begun > t - self.tests.touch_history
        self._touches.keep(good)
        self._begun = self._begun[good]
        if found is not None and found.moved.any():
            self.begin(t)
        return found

    def misfit(self, t: float, noise: NoiseLevel) -> tuple[Change, ...]:
        """Return whether the errors of the markers are larger than declared, by the level of their noise.

        No other test explains that: the rope swings out of its plane, the camera has moved, or the noise is not as
        declared. It is reported once, after two seconds, until it is over.
        """
        excess = (math.log(noise.value) - math.log(self.MISFIT_LEVEL)) / noise.log_std
        log_p = float(log_ndtr(-excess))
        clear = self._interval > 0.0 and log_p < math.log(self._interval / self.tests.false_alarm_interval)
        if excess < 0.0 or t < self._since:
            self._fitted, self._misfits = t, False
        if not clear or self._misfits or t - self._fitted < self.MISFIT_TIME:
            return ()
        self._misfits = True
        return (Change(MISFIT, t, self._fitted, noise.value, noise.value * noise.log_std, 1.0, log_p),)

    def _with_mass(
        self, x: tuple[Array, Array], t: float, until: float, transition: Array, column: int, states: Array
    ) -> tuple[Array, Array]:
        """Return the effect (N, 1) of a mass at the tip, and errors (N, c) of the state as they move with it.

        A mass soon exceeds that of the last link many times, so that its effect is far from linear. With one, an error
        d of the state becomes ``F d`` and the effect of the mass itself, F being that of the heavier rope.
        """
        start, others = x[0].copy(), states.T.copy()
        start[column] += self._mass
        others[:, column] = 0.0
        try:
            end, rows = self._heavier.carry(start, others, t, until)
        except SimulationError:
            return transition[:, [column]], transition @ states
        begun = ((end - x[1]) / self._mass)[:, None]
        begun[2 * self._n :] = 0.0
        begun[column] = 1.0
        return begun, rows.T + begun * states[column]

    def _kept_moments(self, t: float) -> npt.NDArray[np.bool_]:
        """Return which moments at which parameters may have changed are kept: the older, the farther apart."""
        age = t - self._moments
        doublings = np.floor(np.log2(np.maximum(age / (self.PER_DOUBLING * self.SPACING), 1.0))).astype(int)
        spaced = (self._indices >= 0) & (self._indices % 2**doublings == 0)
        return np.asarray((age < self.tests.history) & (spaced | (age < self.SPACING)))

    def _evaluate(self, t: float) -> Found | None:
        """Return the clearest sign of a change, if it is clear enough."""
        scores, theta = self._parameter_scores()
        touch, forces = self._touch_scores()
        count = scores.size + 2 * touch.size
        if not count or not self._interval:
            return None
        log_p = [log_ndtr(-each) + math.log(2.0) for each in scores.T]
        if touch.size:
            log_p.append(-0.5 * touch.ravel() ** 2)
        least = np.array([each.min(initial=0.0) for each in log_p])
        if not least.min() < math.log(self._interval / self.tests.false_alarm_interval / count):
            return None
        evidence = -least - np.log([max(each.size, 1) for each in log_p])
        k = int(evidence.argmax())
        sure, alarm = 1.0 / float(np.exp(evidence - evidence[k]).sum()), float(least[k])
        best = int(log_p[k].argmin())
        if k < len(self.names):
            bank, size = self._parameters[k], float(theta[best, k])
            std, effect = self.DOUBT / math.sqrt(bank.information[0, best, best]), bank.states[:, best]
            change = Change(self.names[k], t, float(self._moments[best]), size, std, sure, alarm)
            return Found(change, size * effect, std * effect[None])
        again, self._touched = t - self._touched < self.CALM, t
        if not again:
            self._shared_until = t + self.SHARED
        change, whole, last = self._touch(best, forces, t, sure, alarm)
        return Found(None if again else change, np.zeros(self._size), last if again else whole)

    def _parameter_scores(self) -> tuple[Array, Array]:
        """Return by how many standard deviations each parameter (p) has changed since each moment (w, p), and sizes."""
        shape = len(self.names), self._moments.size
        information = np.array([np.diag(each.information[0]) for each in self._parameters]).reshape(shape).T
        information = np.maximum(information, 1e-300)
        theta = np.array([each.score[0] for each in self._parameters]).reshape(shape).T / information
        std = 1.0 / np.sqrt(information)
        score = np.maximum(np.abs(theta) - self._tolerances, 0.0) / std
        score[self._values + theta + self.POSSIBLE * std < self._least] = 0.0
        return score, theta

    def _touch_scores(self) -> tuple[Array, tuple[Array, Array]]:
        """Return by how many standard deviations each touch (2, w, places) differs from none, and its forces.

        The first of 2 lasts a single interval, the second until now. Of the forces come sizes (2, w, places, 2), N, and
        their information (2, w, places, 2, 2), 1/N^2.
        """
        bank, p, w = self._touches, self.places.size, self._begun.size
        if not w:
            return np.zeros((2, 0, p)), (np.zeros((2, 0, p, 2)), np.zeros((2, 0, p, 2, 2)))
        every = bank.information.reshape(p, w, 2, w, 2)
        lasting = every[:, ::-1, :, ::-1].cumsum(axis=1).cumsum(axis=3)[:, ::-1, :, ::-1]
        score = bank.score.reshape(p, w, 2).transpose(1, 0, 2)
        b = np.stack([score, score[::-1].cumsum(axis=0)[::-1]])
        a = np.stack([np.moveaxis(np.diagonal(each, axis1=1, axis2=3), -1, 0) for each in (every, lasting)])
        a += ((1e-9 * np.trace(a, axis1=-2, axis2=-1) + 1e-300)[..., None, None]) * np.eye(2)
        (xx, xy, yy), (x, y) = (a[..., 0, 0], a[..., 0, 1], a[..., 1, 1]), (b[..., 0], b[..., 1])
        determinant = np.maximum(xx * yy - xy * xy, 1e-300)
        force = np.stack([yy * x - xy * y, xx * y - xy * x], axis=-1) / determinant[..., None]
        size = np.hypot(force[..., 0], force[..., 1])
        clear = np.sqrt(np.maximum(force[..., 0] * x + force[..., 1] * y, 0.0))
        lasted = np.stack([self._ends - self._begun, self._latest - self._begun])
        allowed = self._force_tolerance * np.maximum(self.SHORT_TOUCH / lasted, 1.0)
        return clear * np.maximum(1.0 - allowed[:, :, None] / np.maximum(size, 1e-300), 0.0), (force, a)

    @property
    def _ends(self) -> Array:
        """Ends of the intervals in which touches may be (w,), s."""
        return np.append(self._begun[1:], self._latest)

    def _touch(
        self, best: int, forces: tuple[Array, Array], t: float, sure: float, alarm: float
    ) -> tuple[Change, Array, Array]:
        """Return a touch, and rows that widen the covariance: by all of it, and by its last interval."""
        w, p = self._begun.size, self.places.size
        lasting, since, place = np.unravel_index(best, (2, w, p))
        force, covariance = forces[0][lasting, since, place], np.linalg.inv(forces[1][lasting, since, place])
        begun = float(self._begun[since])
        lasted = (t if lasting else float(self._ends[since])) - begun
        size = float(np.linalg.norm(force))
        std = math.sqrt(force @ covariance @ force) / size
        impulse, at = (float(force[0] * lasted), float(force[1] * lasted)), float(self.places[place])
        change = Change(TOUCH, t, begun, size * lasted, std * lasted, sure, alarm, at, impulse)
        effects = self._touches.states.reshape(-1, w, p, 2)[:, :, place]
        whole = effects[:, since:].sum(axis=1) if lasting else effects[:, since]
        return change, size * whole.T, size * effects[:, -1].T
