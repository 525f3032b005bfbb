"""Smoother of a whole recording: each frame's state, given what was seen in all frames."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.estimate.observations import Observations
from hyperflex.estimate.smoothing.interval import InputFrame, Interval
from hyperflex.estimate.smoothing.moving_horizon import MovingHorizon
from hyperflex.interfaces import RopeState

WHOLE_ROUNDS = 30  # of Gauss-Newton


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
        Each estimated parameter's value and standard deviation.
    log_likelihood : float
        Of all that was seen.
    """

    states: tuple[RopeState, ...]
    places: Array
    values: dict[str, tuple[float, float]]
    log_likelihood: float


def smooth(estimator: MovingHorizon, observations: Iterable[Observations]) -> SmoothedTrack:
    """Estimate the states of all frames of a recording from all of it.

    The estimator goes through the recording; then Gauss-Newton over all frames begins at what it found, with the levels
    of noise that it learnt. Where it had to begin anew, the result begins there.

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
    frames: list[InputFrame] = []
    states: list[tuple[Array, Array]] = []
    for seen in observations:
        begun = estimator.begun
        estimator.update(seen)
        if estimator.horizon is None:
            continue
        if estimator.begun is not begun:
            frames, states = [], []
        found = estimator.horizon
        frames.append(found.frames[-1])
        states.append((found.x, found.factor))
        known = min(len(found.frames), len(states))
        states[-known:] = zip(found.states[-known:], found.smoothed.rows[-known:], strict=True)
    if estimator.begun is None:
        raise InvalidInput("no marker was seen", allowed="observations of at least one")
    level, density = estimator.measurement_noise.value, estimator.process_noise.value
    times = [each.seen.t for each in frames]
    frames = [replace(each, level=level) for each in frames]
    for k, gap in enumerate(np.diff(times).tolist(), start=1):
        frames[k] = replace(frames[k], noise=estimator.process.noise(gap, density))
    prior = estimator.begun
    whole = Interval(estimator.process, estimator.model, prior.mean, prior.rows, frames[0], np.zeros(estimator.n_links))
    if len(frames) > 1:
        whole.follow(frames[1:], states)
    whole.solve(WHOLE_ROUNDS)
    return _track(whole, estimator)


def _track(whole: Interval, estimator: MovingHorizon) -> SmoothedTrack:
    """Return what a fit of all frames says."""
    n, model, process = estimator.n_links, estimator.model, estimator.process
    qdds = [np.zeros(n), *(each.qdd for each in whole.path.predictions)]
    places = [
        model.predict(x, process.base(frame.seen.t, x), np.zeros(len(model.arc_lengths)), qdd)[0]
        for x, frame, qdd in zip(whole.states, whole.frames, qdds, strict=True)
    ]
    last, std = whole.x[2 * n :], np.linalg.norm(whole.factor[:, 2 * n :], axis=0)
    values = {
        name: (float(value), float(each))
        for name, value, each in zip(estimator.parameters.names, last, std, strict=True)
        if name in estimator.values
    }
    return SmoothedTrack(whole.rope_states, np.array(places), values, whole.log_likelihood)
