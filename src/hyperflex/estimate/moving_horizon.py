"""Moving-horizon estimator and smoother: Gauss-Newton over the last frames, or over all of a recording."""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri
from scipy.stats import qmc

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.changes import MISFIT, TOUCH, Change, Found
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.interval import Interval
from hyperflex.estimate.observations import InputFrame, Observations
from hyperflex.interfaces import RopeState
from hyperflex.interruption import interruptible
from hyperflex.model import Rope
from hyperflex.sensors import lever_arms

SAME_FIT = 0.1  # of a standard deviation, largest difference of two fits that count as one


class MovingHorizon(RopeFilter):
    """Estimates a rope's state from its markers in the last frames, all fitted at once.

    It is used like the filter. The filter corrects the last state alone, with derivatives that were taken at worse
    estimates; the horizon corrects the states of the last frames together, and takes all derivatives again. Earlier
    observations remain as the prior of the first of them (arrival cost), from the same square-root factorisation.

    Parameters
    ----------
    rope : Rope
    arc_lengths : (K,) array_like
        How far along the rope each marker is, m from the first joint.
    frames : int
        Number of frames that are fitted together, at least 2.
    starts : int
        Largest number of start states that are tried if the state may have several explanations: after the first frame,
        and after a blackout. Each is fitted to the next frames; the estimate is the most likely one, and others are
        dropped as they become unlikely. 1: only the expected one.
    **options
        As of :class:`RopeFilter`.

    Attributes
    ----------
    begun : (N,) float64 and (r, N) float64, or None
        Prior of the first frame since the horizon started (anew): its mean, and rows whose squares are its covariance.
    changed : bool
        Whether the last update adopted a change, or a touch continues: the horizon starts after it.

    Notes
    -----
    The prior of the second frame when the first leaves is the filter's, linearised at the horizon's estimate (Rao,
    Rawlings and Mayne 2003, IEEE Trans. Automatic Control 48(2), 246; smoothing update). Cost: some ROUNDS times
    `frames` times that of the filter.

    Noise levels are adapted once an explanation has been valid for a whole horizon, or if none ever is. If all
    explanations fit badly (a wrong start is off by hundreds of standard deviations after two or three frames), the
    estimator starts anew at the frame, with the parameters before.

    While there are several explanations, the covariance is that of their mixture about the most likely one.
    """

    ROUNDS, FIRST_ROUNDS, START_ROUNDS = 3, 12, 6  # of Gauss-Newton: at each frame, at the first, from other starts
    AMBIGUOUS = 0.5  # rad: a larger standard deviation of a link's angle allows several explanations
    DIMENSIONS = 4  # in which starts differ
    REPEATED = 5  # starts in a row that lead to known explanations, after which no more are tried
    NEGLIGIBLE = 7.0  # difference of the log-likelihood from the best one's, beyond which an explanation is dropped
    LOST = 10.0  # ratio of the squares to those of a right model, from which no explanation is right
    PATIENT = 8  # starts without a valid explanation, after which the noise levels must have been too low

    def __init__(
        self, rope: Rope, arc_lengths: ArrayLike, *, frames: int = 8, starts: int = 16, **options: Any
    ) -> None:
        super().__init__(rope, arc_lengths, **options)
        self.frames = checks.count("frames", frames, least=2)
        self.starts = checks.count("starts", starts)
        self._explanations: list[Interval] = []
        self.begun: tuple[Array, Array] | None = None
        self.changed = False
        # values of the parameters when an explanation was valid, and starts since
        self._trusted, self._given_up = self.x[2 * self.n_links :].copy(), 0

    @property
    def horizon(self) -> Interval | None:
        """The frames of the horizon, as the most likely explanation fits them; None before anything was seen."""
        return self._explanations[0] if self._explanations else None

    @property
    def smoothed(self) -> tuple[RopeState, ...]:
        """The states of the frames of the horizon, with covariances, the oldest first."""
        return () if self.horizon is None else self.horizon.rope_states

    @property
    def explanations(self) -> Array:
        """Weights of the explanations, the most likely first; their sum is 1."""
        if not self._explanations:
            return np.zeros(0)
        known = np.array([each.log_likelihood for each in self._explanations])
        weights = np.exp(known - known[0])
        return np.asarray(weights / weights.sum())

    def update(self, seen: Observations) -> None:
        """Predict and correct, as the filter does; each frame is later than the one before."""
        if self.horizon is not None and self.t is not None and seen.t == self.horizon.frames[-1].seen.t:
            allowed = f"more than {seen.t} s, the time of the frame before"
            raise InvalidInput("two frames are of one time", got=seen.t, allowed=allowed, fix="Join their observations")
        super().update(seen)

    def restart(self) -> None:
        """Forget the state; parameters and noise levels remain as first guesses."""
        super().restart()
        self._explanations = []

    def _correct(self, seen: Observations, *, first: bool) -> None:
        """Let the filter reject markers and notice changes, and fit the horizon."""
        prior, self.changed = (self.x.copy(), self.factor), False
        unsure = np.linalg.norm(self.factor[:, : self.n_links], axis=0).max() > self.AMBIGUOUS
        super()._correct(seen, first=first)
        used, known = self.used, self._explanations
        noise = np.zeros((0, self.x.size))
        if known:
            noise = self.process.noise(seen.t - known[0].frames[-1].seen.t, self.process_noise.value)
        frame = InputFrame(seen, used, self.measurement_noise.value, noise)
        if not known:
            self.begun = prior
            self._explanations = [Interval(self.process, self.model, *prior, frame, self._qdd)]
            self._fit(self.FIRST_ROUNDS)
        elif self.changed:  # earlier observations are of another rope, or of one that was not touched
            self._explanations = [self._beginning(seen, self.x, self.factor, self._qdd)]
            return
        else:
            if unsure and self.starts > 1 and self._given_up <= self.PATIENT and used.any() and len(known) == 1:
                self._explanations = self._started(frame)
                self._fit(0)
            else:
                self._explanations = [each for each in known if each.append(frame)]
                self._fit(self.ROUNDS if used.any() else 0)
            if used.any() and (not self._explanations or self._explanations[0].misfit > self.LOST):
                self._begin_anew(seen)
            elif self._settled():
                self._trusted, self._given_up = self.x[2 * self.n_links :].copy(), 0
        if self._explanations:
            self._take()

    def _adopt(self, found: Found) -> None:
        """Adopt a change, as the filter does; the horizon starts after it."""
        super()._adopt(found)
        self.changed = True

    @property
    def _adapts(self) -> bool:
        return self._settled() or self._given_up > self.PATIENT

    def _settled(self) -> bool:
        """Return whether one explanation has been valid for a whole horizon."""
        return len(self._explanations) == 1 and len(self._explanations[0].frames) == self.frames

    def _begin_anew(self, seen: Observations) -> None:
        """Start anew at this frame, with the parameters from when an explanation was valid."""
        self.restart()
        self._given_up += 1
        self.x[2 * self.n_links :] = self._trusted
        self._begin(seen)

    def _started(self, frame: InputFrame) -> list[Interval]:
        """Return fits from several starts, spread in the directions in which the expected angles are uncertain."""
        last = self._explanations[0]
        begun = self._beginning(last.frames[-1].seen, last.x, last.factor, last.qdd)
        if not begun.append(frame):
            return []
        angles = last.factor @ begun.nodes[-1].predicted.transition[: self.n_links].T
        ways, sizes, _ = np.linalg.svd(angles, full_matrices=False)
        ways, fresh = ways[:, sizes > self.AMBIGUOUS][:, : self.DIMENSIONS], copy(begun)
        begun.solve(self.FIRST_ROUNDS)
        found, repeated = [begun], 0
        if not ways.size:
            return found
        for point in ndtri(qmc.Halton(ways.shape[1], rng=0).random(self.starts - 1)):
            twin = copy(fresh)
            if twin.move(ways @ point):
                twin.solve(self.START_ROUNDS)
            if twin.misfit < self.LOST and not any(_alike(twin, each) for each in found):
                found, repeated = [*found, twin], 0
            else:
                repeated += 1
            if repeated == self.REPEATED:
                break
        return found

    def _beginning(self, seen: Observations, x: Array, factor: Array, qdd: Array) -> Interval:
        """Return an interval that starts with the estimate after a frame."""
        nothing = InputFrame(seen, np.zeros(len(seen.places), dtype=bool), 1.0, np.zeros((0, x.size)))
        return Interval(self.process, self.model, x.copy(), factor, nothing, qdd)

    def _fit(self, rounds: int) -> None:
        """Improve all explanations, order them, and drop those that are negligible or alike."""
        for each in self._explanations:
            each.solve(rounds)
            while len(each.frames) > self.frames:
                each.forget()
        kept: list[Interval] = []
        for each in sorted(self._explanations, key=lambda one: -one.log_likelihood):
            unlikely = kept and each.log_likelihood < kept[0].log_likelihood - self.NEGLIGIBLE
            if not unlikely and not any(_alike(each, other) for other in kept):
                kept.append(each)
        self._explanations = kept

    def _take(self) -> None:
        """Make the most likely explanation the estimate, with the covariance of the mixture."""
        best, mixture = self._explanations[0], zip(np.sqrt(self.explanations), self._explanations, strict=True)
        rows = [weight * np.concatenate([each.factor, (each.x - best.x)[None]]) for weight, each in mixture]
        self.factor = sr.compressed(np.concatenate(rows), self._least)
        first = 2 * self.n_links
        self.x, self._qdd = best.x.copy(), best.qdd
        self.x[first:] = self.parameters.possible(self.x[first:])


def _alike(one: Interval, other: Interval) -> bool:
    """Return whether two fits have converged to the same path."""
    paths = [[each.start, *(node.noise for node in each.nodes)] for each in (one, other)]
    alike = (np.abs(a - b).max(initial=0.0) < SAME_FIT for a, b in zip(*paths, strict=False))
    return len(paths[0]) == len(paths[1]) and all(alike)


WHOLE_ROUNDS = 30  # of Gauss-Newton
EARLIER = 0.1  # s by which a change may have happened before its most likely moment


@dataclass(frozen=True, eq=False)
class SmoothedTrack:
    """The states of all frames, each given the observations of all (the result of :func:`smooth`).

    Attributes
    ----------
    states : tuple of RopeState
        Of each frame, with its covariance.
    places : (T, K, 2) float64
        Where the markers are, m or px, also if they were not seen.
    values : dict of str to (float, float)
        Each estimated parameter's value and standard deviation, at the end.
    log_likelihood : float
        Of all observations.
    """

    states: tuple[RopeState, ...]
    places: Array
    values: dict[str, tuple[float, float]]
    log_likelihood: float


@interruptible()
def smooth(estimator: MovingHorizon, observations: Iterable[Observations]) -> SmoothedTrack:
    """Estimate the states of all frames of a recording from all of it.

    The estimator processes the recording; then Gauss-Newton over all frames starts from its estimates, with its final
    noise levels. If it had to start anew, the result starts there. If it noticed a change or a touch, the parameter or
    the rates may jump in any frame from shortly before the most likely moment until it was noticed.

    Parameters
    ----------
    estimator : MovingHorizon
        That has not begun.
    observations : iterable of Observations
        In the order of time.

    Raises
    ------
    InvalidInput
        If nothing is seen in any of them, or the estimator has begun.
    SimulationError
        If the rope's equations cannot be integrated along the estimates.

    Notes
    -----
    Maximum a posteriori, with covariances of Laplace's approximation; cost O(T) per round (see :func:`smooth_linear`).
    """
    if estimator.smoothed:
        fix = "Give a new estimator, or restart() it"
        raise InvalidInput("the estimator has begun", got=f"t = {estimator.t} s", fix=fix)
    frames, states, changes = list[InputFrame](), list[tuple[Array, Array]](), list[Change]()
    for seen in observations:
        begun = estimator.begun
        estimator.update(seen)
        horizon = estimator.horizon
        if horizon is None:
            continue
        if estimator.begun is not begun:
            frames, states, changes = [], [], []
        frames.append(replace(horizon.frames[-1], used=estimator.used))
        known = zip(horizon.states, (each.rows for each in horizon.smoothed), strict=True)
        states.append((horizon.x, horizon.factor))
        recent = list(known)[-len(states) :]
        states[-len(recent) :] = recent
        touches = [change for change in changes if change.name == TOUCH]
        changes += estimator.changes
        if estimator.changed and not estimator.changes and touches and len(frames) > 1:  # the touch continues
            between = 0.5 * (frames[-2].seen.t + seen.t)
            changes.append(replace(touches[-1], time=between + EARLIER, noticed=seen.t))
    if estimator.begun is None:
        raise InvalidInput("no marker was seen", allowed="observations of at least one")
    level, density, process = estimator.measurement_noise.value, estimator.process_noise.value, estimator.process
    times, names = [each.seen.t for each in frames], estimator.parameters.names
    jumps = jump_rows(estimator, changes, times, [x for x, _ in states])
    frames = [replace(each, level=level) for each in frames]
    for k, (before, now) in enumerate(pairwise(times)):
        noise = np.concatenate([process.noise(now - before, density), *jumps[k]])
        frames[k + 1] = replace(frames[k + 1], noise=noise)
    for change in changes:  # a parameter has changed before it was noticed
        for k, t in enumerate(times):
            if change.name in names and change.time < t < change.noticed:
                states[k][0][2 * estimator.n_links + names.index(change.name)] += change.size
    whole = Interval(process, estimator.model, *estimator.begun, frames[0], np.zeros(estimator.n_links))
    if len(frames) > 1:
        whole.follow(frames[1:], states)
    whole.solve(WHOLE_ROUNDS)
    rows = np.zeros(len(estimator.model.arc_lengths))
    places = [
        estimator.model.predict(x, process.base(frame.seen.t, x), rows)[0]
        for x, frame in zip(whole.states, whole.frames, strict=True)
    ]
    values = estimator.parameters.estimates(whole.x, whole.factor)
    return SmoothedTrack(whole.rope_states, np.array(places), values, whole.log_likelihood)


def jump_rows(
    estimator: RopeFilter, changes: Sequence[Change], times: Sequence[float], states: Sequence[Array]
) -> list[list[Array]]:
    """Return rows (r, N) by which the noise of each step allows for changes: in which one each happened is left open.

    The steps are those between frames at some times, s, in states (N,).
    """
    n, process, jumps = estimator.n_links, estimator.process, list[list[Array]]()
    for x, (before, now) in zip(states, pairwise(times), strict=False):
        jumps.append([])
        for change in changes:
            if change.name == MISFIT or not change.time - EARLIER < now <= change.noticed:
                continue
            size = abs(change.size) + change.std
            if change.arc_length is None:
                column = 2 * n + estimator.parameters.names.index(change.name)
                jumps[-1].append(size * (np.arange(x.size) == column)[None])
                continue
            arms = lever_arms(process.rope, np.array([change.arc_length]))[1]
            turned = size * np.abs(process.kicks(x[:n], arms)).max()
            jumps[-1].append(process.noise(now - before, turned / np.sqrt(now - before)))
    return jumps
