"""Smoother of a whole recording: each frame's state, given what was seen in all frames."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.estimate.changes import MISFIT, TOUCH, Change
from hyperflex.estimate.observations import InputFrame, Observations
from hyperflex.estimate.smoothing.interval import Interval
from hyperflex.estimate.smoothing.moving_horizon import MovingHorizon
from hyperflex.interfaces import RopeState
from hyperflex.interruption import interruptible
from hyperflex.sensors import lever_arms

WHOLE_ROUNDS = 30  # of Gauss-Newton
EARLIER = 0.1  # s by which a change may have happened before the moment that was told


@dataclass(frozen=True, eq=False)
class SmoothedTrack:
    """The states of all frames, each given what was seen in all (made by :func:`smooth`).

    Attributes
    ----------
    states : tuple of RopeState
        Of each frame, with its covariance.
    places : (T, K, 2) float64
        Where the markers are seen, m or px, also where they were not.
    values : dict of str to (float, float)
        Each estimated parameter's value and standard deviation, at the end.
    log_likelihood : float
        Of all that was seen.
    """

    states: tuple[RopeState, ...]
    places: Array
    values: dict[str, tuple[float, float]]
    log_likelihood: float


@interruptible()
def smooth(estimator: MovingHorizon, observations: Iterable[Observations]) -> SmoothedTrack:
    """Estimate the states of all frames of a recording from all of it.

    The estimator goes through the recording; then Gauss-Newton over all frames begins at what it found, with the levels
    of noise that it learnt. Where it had to begin anew, the result begins there. Where it noticed a change or a touch,
    the parameter or the rates may jump in any frame from shortly before the moment it told until it noticed.

    Parameters
    ----------
    estimator : MovingHorizon
    observations : iterable of Observations
        In the order of time.

    Raises
    ------
    InvalidInput
        If nothing is seen in any of them.
    SimulationError
        If no rope can move along what was found.

    Notes
    -----
    Maximum a posteriori, with covariances of Laplace's approximation; cost O(T) per round (see :func:`smooth_linear`).
    """
    found = _Collected()
    for seen in observations:
        begun = estimator.begun
        estimator.update(seen)
        if estimator.horizon is None:
            continue
        if estimator.begun is not begun:
            found = _Collected()
        found.add(estimator, estimator.horizon)
    if estimator.begun is None:
        raise InvalidInput("no marker was seen", allowed="observations of at least one")
    frames, prior = found.with_noise(estimator), estimator.begun
    whole = Interval(estimator.process, estimator.model, prior.mean, prior.rows, frames[0], np.zeros(estimator.n_links))
    if len(frames) > 1:
        whole.follow(frames[1:], found.states)
    whole.solve(WHOLE_ROUNDS)
    return _track(whole, estimator)


class _Collected:
    """What an estimator found on its way, frame by frame, and where what it noticed may have changed the rope."""

    def __init__(self) -> None:
        self.states: list[tuple[Array, Array]] = []
        self._frames: list[InputFrame] = []
        self._jumps: list[list[Array]] = []  # rows by which each frame's noise is wider
        self._touch: Change | None = None

    def add(self, estimator: MovingHorizon, horizon: Interval) -> None:
        """Take the last frame, with the states of the horizon's frames."""
        self._frames.append(replace(horizon.frames[-1], used=estimator.used))
        self._jumps.append([])
        self.states.append((horizon.x, horizon.factor))
        known = min(len(horizon.frames), len(self.states))
        self.states[-known:] = zip(horizon.states[-known:], horizon.smoothed.rows[-known:], strict=True)
        noticed = [change for change in estimator.changes if change.name != MISFIT]
        for change in noticed:
            self._touch = change if change.name == TOUCH else self._touch
            self._widen(estimator, change, change.time - EARLIER)
        if estimator.changed and not noticed and self._touch is not None and len(self._frames) > 1:
            self._widen(estimator, self._touch, self._frames[-2].seen.t)

    def _widen(self, estimator: MovingHorizon, change: Change, since: float) -> None:
        """Allow for a change from a time on until now: in which of the frames it happened is left to the fit."""
        n, size = estimator.n_links, abs(change.size) + change.std
        if change.arc_length is not None:
            arms = lever_arms(estimator.process.rope, np.array([change.arc_length]))[1]
        for k in range(1, len(self._frames)):
            if self._frames[k].seen.t <= since:
                continue
            x, factor = self.states[k]
            if change.arc_length is None:
                rows, column = np.zeros((1, x.size)), 2 * n + estimator.parameters.names.index(change.name)
                rows[0, column] = size
                if k < len(self._frames) - 1 and self._frames[k].seen.t > change.time:
                    x = x.copy()
                    x[column] += change.size
                    self.states[k] = x, factor
            else:
                gap = self._frames[k].seen.t - self._frames[k - 1].seen.t
                turned = size * np.abs(estimator.process.kicks(x[:n], arms)).max()
                rows = estimator.process.noise(gap, turned / np.sqrt(gap))
            self._jumps[k].append(rows)

    def with_noise(self, estimator: MovingHorizon) -> list[InputFrame]:
        """Return the frames with the levels of noise that were learnt in the end."""
        level, density = estimator.measurement_noise.value, estimator.process_noise.value
        frames = [replace(each, level=level) for each in self._frames]
        for k in range(1, len(frames)):
            noise = estimator.process.noise(frames[k].seen.t - frames[k - 1].seen.t, density)
            frames[k] = replace(frames[k], noise=np.concatenate([noise, *self._jumps[k]]))
        return frames


def _track(whole: Interval, estimator: MovingHorizon) -> SmoothedTrack:
    """Return what a fit of all frames says."""
    n, model, process = estimator.n_links, estimator.model, estimator.process
    qdds = [np.zeros(n), *(each.qdd for each in whole.path.predictions)]
    places = [
        model.predict(x, process.base(frame.seen.t, x), np.zeros(len(model.arc_lengths)), qdd)[0]
        for x, frame, qdd in zip(whole.states, whole.frames, qdds, strict=True)
    ]
    values = estimator.parameters.estimates(whole.x, whole.factor)
    return SmoothedTrack(whole.rope_states, np.array(places), values, whole.log_likelihood)
