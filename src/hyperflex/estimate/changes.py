"""Tests for changes of a named parameter and for a touch: generalised likelihood ratios of a filter's innovations."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from hyperflex import checks
from hyperflex.checks import Array, Flags
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
    """

    names: tuple[str, ...] | None = None
    false_alarm_interval: float = 600.0
    tolerances: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the values."""
        for name in (*(self.names or ()), *self.tolerances):
            if name != TOUCH and kind(name) is None:
                allowed = ", ".join((*NAMES, TOUCH))
                raise InvalidInput("there is no test for a change of this", got=name, allowed=allowed)
        for name, value in self.tolerances.items():
            checks.number(f"tolerance of {name}", value, sign="nonnegative")
        checks.number("false_alarm_interval", self.false_alarm_interval, sign="positive", unit="s")

    def names_for(self, rope: Rope) -> tuple[str, ...]:
        """Return what is tested of a rope."""
        if self.names is not None:
            return tuple(dict.fromkeys(self.names))
        always = ("length", "tip_mass", TOUCH)
        return tuple(name for name in (*ROPE_KINDS, TOUCH) if name in always or getattr(rope, name, np.zeros(1)).any())

    def parameters_for(self, rope: Rope) -> tuple[str, ...]:
        """Return which parameters of a rope are tested: all but touches."""
        return tuple(name for name in self.names_for(rope) if name != TOUCH)

    def tolerance(self, name: str, rope: Rope) -> float:
        """Return the largest size of a parameter's change, or of a touch's force, that does not count."""
        known = kind(name)
        if known is None:
            default = WEIGHT_TOLERANCE * rope.total_mass * rope.g
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
        size = f"{what} {known.unit if known else 'N s'}".rstrip()
        when = f"since {self.time:.2f} s, noticed at {self.noticed:.2f} s"
        return f"{size} (std {self.std:.2g}), {when}, {100.0 * self.probability:.0f} % sure"


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


class Bank:
    """Changes that may have begun at some moments: their effects on the state, and what innovations tell of them.

    Each of K kinds of change has a size of D components. It acts in V ways: since its moment, or only until the next
    moment if V is 2.

    Attributes
    ----------
    moments : (W,) float64
        s.
    effects : (N, W, K, D) float64
        Errors of the state by a unit of each change.
    score, information : (V, W, K, D), (V, W, K, D, D) float64
        Sums ``b = G' nu`` and ``A = G' G``, G: effects on the whitened innovations nu.
    """

    def __init__(self, states: int, kinds: int, components: int, ways: int) -> None:
        self.moments, self.effects = np.zeros(0), np.zeros((states, 0, kinds, components))
        self.score = np.zeros((ways, 0, kinds, components))
        self.information = np.zeros((ways, 0, kinds, components, components))

    @property
    def flat(self) -> Array:
        """The effects as columns (N, W K D)."""
        return self.effects.reshape(len(self.effects), -1)

    def add(self, t: float, effects: Array) -> None:
        """Add a moment t, s, with effects (N, K, D)."""
        self.moments = np.append(self.moments, t)
        self.effects = np.concatenate([self.effects, effects[:, None]], axis=1)
        self.score, self.information = (
            np.concatenate([each, np.zeros_like(each, shape=(len(each), 1, *each.shape[2:]))], axis=1)
            for each in (self.score, self.information)
        )

    def keep(self, kept: Flags) -> None:
        """Drop the other moments."""
        self.moments, self.effects = self.moments[kept], self.effects[:, kept]
        self.score, self.information = self.score[:, kept], self.information[:, kept]

    def see(self, jacobian: Array, gain: Array, upper: Array, whitened: Array) -> None:
        """Add an innovation; see :meth:`ChangeDetector.update`."""
        seen = jacobian @ self.flat
        self.effects = (self.flat - gain @ seen).reshape(self.effects.shape)
        moved = sr.solved(upper, seen, transposed=True).T.reshape(*self.score.shape[1:], whitened.size)
        ways = np.stack([moved, moved[::-1].cumsum(axis=0)[::-1]][: len(self.score)])
        self.score = self.score + ways @ whitened
        self.information = self.information + ways @ ways.swapaxes(-1, -2)

    def sizes(self, allowed: Array | float) -> tuple[Array, Array, Array]:
        """Return precisions (V, W, K, D, D), sizes (V, W, K, D), and how clear these are, in standard deviations.

        `allowed` (V, W, K) are sizes that do not count.
        """
        ridge = 1e-9 * np.trace(self.information, axis1=-2, axis2=-1) + 1e-150
        precision = self.information + ridge[..., None, None] * np.eye(self.score.shape[-1])
        size = np.linalg.solve(precision, self.score[..., None])[..., 0]
        clear = np.sqrt(np.maximum((size * self.score).sum(axis=-1), 0.0))
        length = np.maximum(np.linalg.norm(size, axis=-1), 1e-300)
        return precision, size, clear * np.maximum(1.0 - allowed / length, 0.0)


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
    later; a touch is a force along x and y at one of some places, in one interval between two moments or from then
    until now. With the sums ``A = G' G`` and ``b = G' nu``, theta is ``A^-1 b`` of covariance ``A^-1``, and
    ``(|theta| - tolerance)^2 A`` is at most a chi square if nothing more than the tolerance has changed.
    A sign counts as an alarm if its probability is less than 1 / (false alarms allowed per frame x number of tests),
    by Bonferroni's bound; the tests are correlated, so that false alarms are rarer than stated.
    """

    SETTLE_TIME = 1.0  # s after the first frame, from which on is tested
    HISTORY, TOUCH_HISTORY = 10.0, 0.35  # s, age of the oldest moment of a change of a parameter, and of a touch
    TOUCH_PLACES = 10  # along the rope, at which a touch is tested
    MISFIT_TIME = 2.0  # s that a misfit lasts until it is reported: noise levels remember a touch for about as long
    MISFIT_LEVEL = 1.25  # times the declared noise of the markers that does not count
    GAP, LONGER_GAP = 0.25, 2.5  # s without any marker, and usual frame intervals, after which tests start anew
    SPACING, SHARE = 0.1, 0.25  # s, and of their age: largest spacing to which moments of changes are thinned out
    TOUCH_SPACING = 0.03  # s between the moments at which a touch may begin
    LIKELY_MASS = 0.04  # of the rope's mass: size of a mass at the tip for which its effect is computed
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
        count = self.TOUCH_PLACES if TOUCH in tests.names_for(rope) else 0
        self.places: Array = np.arange(1.0, count + 1.0) * (rope.total_length / self.TOUCH_PLACES)
        self._arms = lever_arms(rope, self.places)[1]
        self._force_tolerance = tests.tolerance(TOUCH, rope)
        self._latest = self._touched = -math.inf  # time of the last frame, and of the last sign of a touch, s
        self._interval = self._usual = self._fitted = math.inf
        self._misfits = False
        self.begin(math.inf)

    def begin(self, t: float) -> None:
        """Test nothing before `t`, s."""
        self._since = t
        self.jumps, self.touches = Bank(self._size, len(self.names), 1, 1), Bank(self._size, self.places.size, 2, 2)

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
        self._values, begun = x[1][self._columns], transition[:, self._columns]
        before = self.jumps.effects
        for bank in (self.jumps, self.touches):
            bank.effects = (transition @ bank.flat).reshape(bank.effects.shape)
        if "tip_mass" in self.names:
            k = self.names.index("tip_mass")
            begun[:, k], self.jumps.effects[:, :, k, 0] = self._with_mass(x, t, until, transition, before[:, :, k, 0])
        self.jumps.add(t, begun[:, :, None])
        if not self.places.size:
            return
        dt, n = until - t, self._n
        first, last = (self._process.kicks(each[:n], self._arms) for each in x)
        pushed = 0.5 * dt * (transition[:, n : 2 * n] @ first)
        pushed[n : 2 * n] += 0.5 * dt * last
        pushed = pushed.reshape(self._size, -1, 2)
        moments = self.touches.moments
        if not moments.size or t >= moments[-1] + self.TOUCH_SPACING * (1.0 - 1e-6):
            self.touches.add(t, pushed)
        else:
            self.touches.effects[:, -1] += pushed

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
        for bank in (self.jumps, self.touches):
            bank.see(jacobian, gain, upper, whitened)
        found = self._evaluate(t)
        self.jumps.keep(self._kept_moments(t))
        self.touches.keep(self.touches.moments > t - self.TOUCH_HISTORY)
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
        self, x: tuple[Array, Array], t: float, until: float, transition: Array, effects: Array
    ) -> tuple[Array, Array]:
        """Return the effect (N,) of a mass at the tip, and errors (N, W) of the state as they move with it.

        A mass soon exceeds that of the last link many times, so that its effect is far from linear. With one, an error
        d of the state becomes ``F d`` and the effect of the mass itself, F being that of the heavier rope.
        """
        column = self._columns[self.names.index("tip_mass")]
        start, others = x[0].copy(), effects.T.copy()
        start[column] += self._mass
        others[:, column] = 0.0
        try:
            end, rows = self._heavier.carry(start, others, t, until)
        except SimulationError:
            return transition[:, column], transition @ effects
        begun = (end - x[1]) / self._mass
        begun[2 * self._n :] = 0.0
        begun[column] = 1.0
        return begun, rows.T + np.outer(begun, effects[column])

    def _kept_moments(self, t: float) -> Flags:
        """Return which moments at which parameters may have changed are kept: the older, the farther apart."""
        moments = self.jumps.moments
        age = t - moments
        kept = age < self.HISTORY
        crowded = (age[1:-1] > self.SPACING) & (
            moments[2:] - moments[:-2] <= np.maximum(self.SPACING, self.SHARE * age[1:-1]) + 1e-6
        )
        kept[1:-1][np.flatnonzero(crowded)[:1]] = False
        return kept

    def _evaluate(self, t: float) -> Found | None:
        """Return the clearest sign of a change, if it is clear enough."""
        information, theta, clear = (each[0] for each in self.jumps.sizes(self._tolerances))
        std, theta = 1.0 / np.sqrt(information[:, :, 0, 0]), theta[:, :, 0]  # (W, K)
        clear[self._values + theta + self.POSSIBLE * std < self._least] = 0.0
        begun = self.touches.moments
        ends = np.append(begun[1:], t)[: begun.size]
        lasted = np.stack([ends - begun, t - begun])
        allowed = self._force_tolerance * np.maximum(self.SHORT_TOUCH / lasted, 1.0)
        precisions, forces, touch = self.touches.sizes(allowed[:, :, None])
        log_p = [*(log_ndtr(-clear) + math.log(2.0)).T, *([-0.5 * touch.ravel() ** 2] if touch.size else [])]
        count = clear.size + 2 * touch.size
        if not count or not self._interval:
            return None
        least = np.array([each.min(initial=0.0) for each in log_p])
        if not least.min() < math.log(self._interval / self.tests.false_alarm_interval / count):
            return None
        evidence = -least - np.log([max(each.size, 1) for each in log_p])
        k = int(evidence.argmax())
        sure, alarm = 1.0 / float(np.exp(evidence - evidence[k]).sum()), float(least[k])
        best = int(log_p[k].argmin())
        if k < len(self.names):
            size, doubt = float(theta[best, k]), self.DOUBT * float(std[best, k])
            effect = self.jumps.effects[:, best, k, 0]
            change = Change(self.names[k], t, float(self.jumps.moments[best]), size, doubt, sure, alarm)
            return Found(change, size * effect, doubt * effect[None])
        way, since, place = at = np.unravel_index(best, touch.shape)
        force, effects = forces[at], self.touches.effects[:, :, place]
        size = float(np.linalg.norm(force))
        again, self._touched = t - self._touched < self.CALM, t
        if again:
            return Found(None, np.zeros(self._size), size * effects[:, -1].T)
        touch_std = math.sqrt(force @ np.linalg.solve(precisions[at], force)) / size
        duration = float(lasted[way, since])
        impulse, arc = (float(force[0] * duration), float(force[1] * duration)), float(self.places[place])
        change = Change(TOUCH, t, float(begun[since]), size * duration, touch_std * duration, sure, alarm, arc, impulse)
        whole = effects[:, since:].sum(axis=1) if way else effects[:, since]
        return Found(change, np.zeros(self._size), size * whole.T)
