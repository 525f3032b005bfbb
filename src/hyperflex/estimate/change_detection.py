"""Tests for changes of a named parameter and for a touch: generalised likelihood ratios of a filter's innovations."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import log_ndtr

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.estimate.changes import MISFIT, TOUCH, Change, ChangeTests
from hyperflex.estimate.noise import NoiseLevel
from hyperflex.estimate.parameters import ParameterStates
from hyperflex.estimate.process import Process
from hyperflex.estimate.signatures import Signatures
from hyperflex.sensors import lever_arms

PLACES = 10  # along the rope, at which a touch is tried
SETTLED = 1.0  # s after the first frame from which on is tested
MISFIT_LONGEST = 2.0  # s that a misfit lasts until it is told: noise levels remember a touch for about as long
MISFITTING = 1.25  # times the declared noise of the markers that does not count
DARK = 0.25  # s without any marker after which all tests begin anew, where frames usually come faster
RARER = 2.5  # times the usual time between frames: the same of a camera that is slower than that
SPACING = 0.1  # s between the moments at which a parameter may have changed; until they are that old, all frames are
PER_DOUBLING = 4  # moments, from which on the spacing grows with their age
LONGEST = 10.0  # s, the oldest of them
TOUCH_SPACING = 0.03  # s between the moments at which a touch may have begun
TOUCH_LONGEST = 0.35  # s, the oldest of them
LIKELY_MASS = 0.04  # of the rope's mass: at what size the effect of a mass at the tip is computed
SHARED = 0.25  # s after a touch was noticed in which what was seen may yet turn out to be the change of a parameter
CALM = 0.5  # s without a sign of a touch after which the next one is another touch
POSSIBLE = 2.0  # standard deviations by which a size may lie beyond what a rope can have
DOUBT = 2.0  # by which the standard deviation of a noticed change is widened: its moment was chosen among many


class Found(NamedTuple):
    """What a frame showed.

    Attributes
    ----------
    change : Change or None
        None of a touch that goes on.
    moved : (N,) float64
        By how much the mean of the state moves.
    rows : (r, N) float64
        Rows that widen its covariance.
    """

    change: Change | None
    moved: Array
    rows: Array


class ChangeDetector:
    """Tests the innovations of a filter for what a change would leave in them.

    Parameters
    ----------
    tests : ChangeTests
    process : Process
    states : ParameterStates
        That hold all tested parameters.

    Notes
    -----
    A change of size theta moves the mean of the whitened innovations by ``G theta``, where G is carried through the
    filter: an error d of the prediction becomes ``F (I - K H) d`` in the next one (Willsky and Jones 1976, IEEE
    Transactions on Automatic Control 21, 108-112). A parameter jumps at one of some moments in the last 10 s, tighter
    the later; a touch is a force along x and y at one of some places, in one interval between two frames or from then
    until now. With the sums ``A = G' G`` and ``b = G' nu``, theta is ``A^-1 b`` of covariance ``A^-1``, and
    ``(|theta| - tolerance)^2 A`` is a chi square at most if nothing more than the tolerance has changed.
    A sign counts as an alarm if its probability is less than 1 / (false alarms allowed per frame x number of tests),
    by Bonferroni's bound; the tests are alike, so that false alarms are rarer than stated.
    """

    def __init__(self, tests: ChangeTests, process: Process, states: ParameterStates) -> None:
        rope = process.rope
        self.tests, self._process = tests, process
        first = 2 * rope.n_links
        self.names = tests.parameters_for(rope)
        self._columns = [first + states.names.index(name) for name in self.names]
        self._heavier, self._mass = process.copy(), LIKELY_MASS * rope.total_mass
        self._tolerances = np.array([tests.tolerance(name, rope) for name in self.names])
        least = states.possible(np.full(len(states), -np.inf))
        self._least = least[[states.names.index(name) for name in self.names]]
        self._values = np.zeros(len(self.names))
        self._size = first + len(states)
        self.places: Array = np.arange(1.0, (PLACES if TOUCH in tests.names_for(rope) else 0) + 1.0) * (
            rope.total_length / PLACES
        )
        self._arms = lever_arms(rope, self.places)[1]
        self._force_tolerance = tests.tolerance(TOUCH, rope)
        self._latest = self._touched = -math.inf
        self._interval = self._usual = math.inf
        self._shared_until = math.inf
        self._misfits, self._fitted = False, math.inf
        self.begin(math.inf)

    def begin(self, t: float) -> None:
        """Test nothing before `t`, s."""
        self._since = t
        self._parameters = [Signatures(self._size) for _ in self.names]
        self._touches = Signatures(self._size, len(self.places), 2)
        self._moments, self._indices, self._begun = np.zeros(0), np.zeros(0, dtype=int), np.zeros(0)
        self._kicks: Array | None = None
        self._count, self._spaced = 0, -math.inf

    def predict(self, x: tuple[Array, Array], t: float, until: float, transition: Array) -> None:
        """Go on from time t, s, to `until`.

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
        n = self._arms.shape[1]
        self._values = x[1][self._columns]
        lasting = t >= self._spaced + SPACING * (1.0 - 1e-6)
        for name, column, each in zip(self.names, self._columns, self._parameters, strict=True):
            begun = transition[:, [column]]
            if name == "tip_mass":
                each.states, begun = self._with_mass(x, t, until, transition, column, each.states)
            else:
                each.predict(transition)
            each.add(begun)
        self._moments = np.append(self._moments, t)
        self._indices = np.append(self._indices, self._count if lasting else -1)
        if lasting:
            self._spaced, self._count = t, self._count + 1
        self._touches.predict(transition)
        if not self.places.size:
            return
        dt = until - t
        before = self._process.kicks(x[0][:n], self._arms) if self._kicks is None else self._kicks
        self._kicks = after = self._process.kicks(x[1][:n], self._arms)
        pushed = 0.5 * dt * (transition[:, n : 2 * n] @ before)
        pushed[n : 2 * n] += 0.5 * dt * after
        if not self._begun.size or t >= self._begun[-1] + TOUCH_SPACING * (1.0 - 1e-6):
            self._touches.add(pushed)
            self._begun = np.append(self._begun, t)
        else:
            self._touches.states[:, -pushed.shape[1] :] += pushed

    def update(self, t: float, jacobian: Array, gain: Array, upper: Array, whitened: Array) -> Found | None:
        """Take in an innovation; returns what change it shows, and what that has done to the state.

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
        latest, self._latest = self._latest, t
        self._interval, usual = t - latest, self._usual
        if 0.0 < self._interval < math.inf:
            self._usual = min(1.1 * usual, self._interval)
        if t < self._since:
            return None
        if self._interval > max(DARK, RARER * usual):
            self.begin(t)
            return None
        for each in (*self._parameters, self._touches):
            each.update(jacobian, gain, upper, whitened)
        self._kicks = None  # the state has changed
        found = self._evaluate(t, self._interval)
        good = self._lasting(t)
        if self._touched == latest:  # it is over
            self._shared_until = t
        if self._shared_until <= t:  # it was a touch: what it did to the innovations is none of a parameter's doing
            good[:], self._shared_until = False, math.inf
        for each in self._parameters:
            each.keep(good)
        self._moments, self._indices = self._moments[good], self._indices[good]
        good = self._begun > t - TOUCH_LONGEST
        self._touches.keep(good)
        self._begun = self._begun[good]
        if found is not None and found.moved.any():
            self.begin(t)
        return found

    def misfit(self, t: float, noise: NoiseLevel) -> tuple[Change, ...]:
        """Return whether markers are off by more than they should, by the level of their noise that was found.

        Nothing that is tested for explains that: the rope swings out of its plane, the camera is not where it is taken
        to be, or the noise is not as declared. It is told once, after two seconds, until it is over.
        """
        excess = (math.log(noise.value) - math.log(MISFITTING)) / noise.log_std
        log_p = float(log_ndtr(-excess))
        clear = self._interval > 0.0 and log_p < math.log(self._interval / self.tests.false_alarm_interval)
        if excess < 0.0 or t < self._since:
            self._fitted, self._misfits = t, False
        if not clear or self._misfits or t - self._fitted < MISFIT_LONGEST:
            return ()
        self._misfits = True
        return (Change(MISFIT, t, self._fitted, noise.value, noise.value * noise.log_std, 1.0, log_p),)

    def _with_mass(
        self, x: tuple[Array, Array], t: float, until: float, transition: Array, column: int, states: Array
    ) -> tuple[Array, Array]:
        """Return errors (N, c) of the state as they are carried on with a mass at the tip, and (N, 1) what it does.

        A mass is soon many times that of the last link, so that its effect is far from linear. With one, an error d
        of the state becomes ``F d`` and what the mass itself does, F being that of the heavier rope.
        """
        start, others = x[0].copy(), states.T.copy()
        start[column] += self._mass
        others[:, column] = 0.0
        try:
            end, rows = self._heavier.carry(start, others, t, until)
        except SimulationError:
            return transition @ states, transition[:, [column]]
        begun = ((end - x[1]) / self._mass)[:, None]
        begun[2 * self._arms.shape[1] :] = 0.0
        begun[column] = 1.0
        return rows.T + begun * states[column], begun

    def _lasting(self, t: float) -> npt.NDArray[np.bool_]:
        """Return which moments at which parameters may have changed are kept: the older, the farther apart."""
        age = t - self._moments
        doublings = np.floor(np.log2(np.maximum(age / (PER_DOUBLING * SPACING), 1.0))).astype(int)
        spaced = (self._indices >= 0) & (self._indices % 2**doublings == 0)
        return np.asarray((age < LONGEST) & (spaced | (age < SPACING)))

    def _evaluate(self, t: float, dt: float) -> Found | None:
        """Return the clearest sign of a change, if it is clear enough."""
        scores, theta = self._parameter_scores()
        touch, forces = self._touch_scores()
        count = scores.size + 2 * touch.size
        if not count or not dt:
            return None
        log_p = [log_ndtr(-each) + math.log(2.0) for each in scores.T]
        if touch.size:
            log_p.append(-0.5 * touch.ravel() ** 2)
        least = np.array([each.min(initial=0.0) for each in log_p])
        if not least.min() < math.log(dt / self.tests.false_alarm_interval / count):
            return None
        evidence = -least - np.log([max(each.size, 1) for each in log_p])
        name = int(evidence.argmax())
        sure = 1.0 / float(np.exp(evidence - evidence[name]).sum())
        best = int(log_p[name].argmin())
        if name < len(self.names):
            return self._parameter_change(best, name, float(theta[best, name]), t, sure, float(least[name]))
        again, self._touched = t - self._touched < CALM, t
        if not again:
            self._shared_until = t + SHARED
        change, rows = self._touch_change(best, forces, t, sure, float(least[name]), again)
        return Found(None if again else change, np.zeros(self._size), rows)

    def _parameter_scores(self) -> tuple[Array, Array]:
        """Return by how many standard deviations each parameter (p) has changed since each moment (w, p), and sizes."""
        w, p = self._moments.size, len(self.names)
        information = np.array([np.diag(each.information[0]) for each in self._parameters]).reshape(p, w).T
        information = np.maximum(information, 1e-300)
        theta = np.array([each.score[0] for each in self._parameters]).reshape(p, w).T / information
        std = 1.0 / np.sqrt(information)
        score = np.maximum(np.abs(theta) - self._tolerances, 0.0) / std
        score[self._values + theta + POSSIBLE * std < self._least] = 0.0
        return score, theta

    def _touch_scores(self) -> tuple[Array, tuple[Array, Array]]:
        """Return the same of touches (2, w, places), the first of a single interval and then until now, with forces.

        Of the forces come sizes (2, w, places, 2), N, and their information (2, w, places, 2, 2), 1/N^2.
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
        part = np.maximum(1.0 - self._allowed_force()[:, :, None] / np.maximum(size, 1e-300), 0.0)
        return clear * part, (force, a)

    def _allowed_force(self) -> Array:
        """Return the tolerance of forces (2, w), N: as an impulse, that of 0.1 s at least."""
        ends = np.append(self._begun[1:], self._latest)
        lasted = np.stack([ends - self._begun, self._latest - self._begun])
        return np.asarray(self._force_tolerance * np.maximum(0.1 / lasted, 1.0))

    def _parameter_change(self, moment: int, k: int, theta: float, t: float, sure: float, log_p: float) -> Found:
        bank = self._parameters[k]
        std = DOUBT / math.sqrt(bank.information[0, moment, moment])
        change = Change(self.names[k], t, float(self._moments[moment]), theta, std, sure, log_p)
        return Found(change, theta * bank.states[:, moment], std * bank.states[:, moment][None])

    def _touch_change(
        self, best: int, forces: tuple[Array, Array], t: float, sure: float, log_p: float, again: bool
    ) -> tuple[Change, Array]:
        """Return a touch, and rows by which the covariance widens: by all of it, or `again` by its last interval."""
        w, p = self._begun.size, self.places.size
        lasting, since, place = np.unravel_index(best, (2, w, p))
        force, covariance = forces[0][lasting, since, place], np.linalg.inv(forces[1][lasting, since, place])
        begun = float(self._begun[since])
        lasted = (t if lasting else float(np.append(self._begun[1:], t)[since])) - begun
        size = float(np.linalg.norm(force))
        std = math.sqrt(force @ covariance @ force) / size
        impulse = float(force[0] * lasted), float(force[1] * lasted)
        change = Change(TOUCH, t, begun, size * lasted, std * lasted, sure, log_p, float(self.places[place]), impulse)
        of_interval = self._touches.states.reshape(-1, w, p, 2)[:, :, place]
        whole = of_interval[:, since:].sum(axis=1) if lasting else of_interval[:, since]
        return change, size * (of_interval[:, -1] if again else whole).T
