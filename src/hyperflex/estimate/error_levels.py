"""How large the errors of a run's markers are: by what a smoother of the whole run finds that no rope could do."""

from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from hyperflex.checks import Array, Integers
from hyperflex.errors import SimulationError
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.changes import Change
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.interval import Smoothed, smooth_linear
from hyperflex.estimate.moving_horizon import jump_rows
from hyperflex.estimate.noise import MOST, QUIET
from hyperflex.estimate.observations import Observations, whitening
from hyperflex.estimate.parameters import BASE_KINDS, PLANE_KINDS
from hyperflex.estimate.process import BEYOND, DISTURBANCES
from hyperflex.status import Status

LINEARISED, ROUNDS = 3, 6  # rounds: about new states; of all levels, before a last one of the markers' alone
LONGEST = 300  # frames that are smoothed together: some 100 MB with 50 links
PRIOR_COUNT = 10.0  # observations that count for "a marker's errors are like those of the others"
GAUSSIAN = 100.0  # degrees of freedom from which Student's distribution is as good as Gaussian


class RunErrors(NamedTuple):
    """What a whole run tells of its measurements and of its rope.

    Attributes
    ----------
    covariances : (T, K, 2, 2) float64
        Of the places of the markers, in the unit of the observations squared, with what is not known of the picture's
        scale, roll and offset.
    level : float
        Errors of the markers over those of detection, without the shift.
    shift : float
        Standard deviation of a motion of all markers of a frame together: of the picture, same unit.
    density : (2,) float64
        Of disturbances of the whole rope and of its end, as of :meth:`Process.noise`.
    correlated : float
        Number of frames over which the residuals are alike, at least 1.
    values : (T, P) float64
        Parameters of the estimator at each frame.
    estimates : dict of str to (float, float)
        Value and standard deviation of each that is not fixed, in the end.
    """

    covariances: Array
    level: float
    shift: float
    density: Array
    correlated: float
    values: Array
    estimates: dict[str, tuple[float, float]]


class _Levels(NamedTuple):
    """Standard deviations of the three kinds of errors.

    Attributes
    ----------
    marker : (K,) float64
        Of each marker, over those of the detector.
    shift : (2,) float64
        Of a motion of all markers of a frame together, in the unit of the observations.
    density : (2,) float64
        Of disturbances, as of :meth:`Process.noise`.
    jump : float
        Of the changes that were noticed, over what was noticed: 0 if there was none.
    freedom : float
        Degrees of freedom of Student's distribution of a marker's errors: few if some errors are far larger.
    """

    marker: Array
    shift: Array
    density: Array
    jump: float = 1.0
    freedom: float = GAUSSIAN


class _Linear(NamedTuple):
    """A frame's observations, linearised: values (m,) = slope (m, N) x + std (m,) e, m measured directions of markers.

    Attributes
    ----------
    marker, axis : (m,) int64
        Whose each value is, and which of its two directions.
    ways : (m, 2) float64
        The directions.
    values : (m,) float64
    slope : (m, N) float64
    std : (m,) float64
        Of the detector.
    """

    marker: Integers
    axis: Integers
    ways: Array
    values: Array
    slope: Array
    std: Array

    def whitened(self, covariance: Array) -> tuple[Array, Array]:
        """Return values and slopes with errors of variance 1, for errors of a covariance (m, m)."""
        lower = np.linalg.cholesky(covariance)
        return np.linalg.solve(lower, self.values), np.linalg.solve(lower, self.slope)

    def covariance(self, levels: _Levels, weights: Array) -> Array:
        """Return the covariance (m, m) of errors of `weights` (K,)."""
        own = (self.std * levels.marker[self.marker]) ** 2 / weights[self.marker]
        return np.asarray(self.ways * levels.shift**2 @ self.ways.T + np.diag(own))


def run_errors(
    estimator: RopeFilter,
    seen: Sequence[Observations],
    states: Array,
    begun: Sequence[int] = (),
    changes: Sequence[Change] = (),
    alike: float = 1.0,
) -> RunErrors:
    """Find the errors of a run's observations, and its parameters, by smoothing it.

    Parameters
    ----------
    estimator : RopeFilter
        After the run.
    seen : sequence of T Observations
        Those that it used.
    states : (T, N) float64
        Its estimates: the equations are linearised about them at first.
    begun : sequence of int
        Frames in which it started anew.
    changes : sequence of Change
        Those that were noticed: there the state may jump.
    alike : float
        Observations, of neighbours and of frames, whose errors are alike: they count as one, and the covariances of all
        are stated so many times as large.

    Notes
    -----
    Errors have three parts: of each marker, a shift of the whole picture, and disturbances of the rope. Those of a
    marker are alike along u and v: its constant length shows an error along the rope, but the rope's motion may explain
    one across it. The variances are the likeliest ones, by expectation maximisation (Shumway and Stoffer 1982, J. Time
    Series Analysis 3(4), 253), for disturbances in the faster form of MacKay (1992, Neural Computation 4(3), 415).
    Errors that continue from frame to frame (a swing out of the plane) determine the states less well than independent
    ones: in the last round the information of the observations is divided by the number of frames over which residuals
    are alike, or by `alike`, if it is more: the states take up a part of such errors, so that residuals lack it.
    Errors of a marker may be far larger at times (something of its colour touches it): they have Student's distribution
    with the likeliest degrees of freedom: an error that is seen to be large is stated as large, and counts less.
    Where the rope's equations cannot follow the estimates, the estimator's own levels remain.
    """
    parameters, first = estimator.parameters, 2 * estimator.n_links
    prior, values, covariances = (parameters.start, np.diag(parameters.std)), states[:, first:].copy(), []
    windows = [
        part
        for run in np.split(np.arange(len(seen)), [k for k in begun if k])
        for part in np.array_split(run, -(-run.size // LONGEST))
    ]
    solved = []
    for part in windows:
        own = slice(part[0], part[-1] + 1)
        window = _Window(estimator, seen[own], states[own], prior, changes, alike)
        with suppress(SimulationError, np.linalg.LinAlgError):
            window.solve()
        if window.smoothed:
            values[own] = window.states[:, first:]
            prior = values[own][-1], sr.triangular(window.smoothed[-1].rows[:, first:])
        covariances += window.stated()
        solved.append(window)

    def mean(squares: list[Any]) -> Array:
        return np.asarray(np.sqrt(np.average(squares, axis=0, weights=[part.size for part in windows])))

    return RunErrors(
        np.array(covariances),
        float(np.sqrt(alike) * mean([np.mean(each.levels.marker**2) for each in solved])),
        float(mean([np.mean(each.levels.shift**2) for each in solved])),
        mean([each.levels.density**2 for each in solved]),
        float(mean([np.square(each.correlated) for each in solved])),
        values,
        parameters.estimates(np.append(np.zeros(first), values[-1]), np.pad(prior[1], ((0, 0), (first, 0)))),
    )


class _Window:
    """Frames that are smoothed together, and the levels of their errors."""

    def __init__(
        self,
        estimator: RopeFilter,
        seen: Sequence[Observations],
        states: Array,
        prior: tuple[Array, Array],
        changes: Sequence[Change],
        alike: float,
    ) -> None:
        self.alike = alike
        self.estimator, self.process, self.seen, self.states = estimator, estimator.process, seen, states
        rope, first, many = self.process.rope, 2 * estimator.n_links, len(estimator.parameters)
        self.mean = np.concatenate([states[0, :first], prior[0]])
        free = DISTURBANCES.starting_rows(rope, np.zeros(many))
        self.rows = np.concatenate([free[: len(free) - many], np.pad(prior[1], ((0, 0), (first, 0)))])
        level = estimator.measurement_noise.value
        there = [np.linalg.eigvalsh(each.covariances[each.seen])[:, 0].mean() for each in seen if each.seen.any()]
        moves = not BASE_KINDS.keys().isdisjoint(estimator.parameters.names)
        self.dark, detected = not there, float(np.median(there or [0.0]))
        self.levels = _Levels(
            np.full(len(seen[0].places), level),
            np.full(2, 0.0 if moves else 0.5 * level * np.sqrt(detected)),  # of all markers: either moves them
            np.asarray(estimator.process_noise.value),
        )
        self.weights = np.ones((len(seen), len(seen[0].places)))
        self.plane = [first + k for k, name in enumerate(estimator.parameters.names) if name in PLANE_KINDS]
        self.linear: list[_Linear] = []
        self.gaps = np.diff([each.t for each in seen]).tolist()
        self.jumps = jump_rows(estimator, changes, [each.t for each in seen], list(states))
        self.smoothed: list[Smoothed] = []
        self.correlated = 1.0

    def solve(self) -> None:
        """Smooth, and find the levels."""
        first = 2 * self.estimator.n_links
        for k in range(0 if self.dark else ROUNDS + 1):
            if k < LINEARISED:
                steps, self.linear = self._linearised()
            noises = [self.process.noise(gap, self.levels.density) for gap in self.gaps]
            moves = [
                (*step, np.concatenate([noise, *(self.levels.jump * each for each in jumps)]))
                for step, noise, jumps in zip(steps, noises, self.jumps, strict=True)
            ]
            wide = [each.covariance(self.levels, own) for each, own in zip(self.linear, self.weights, strict=True)]
            count = 1.0 if k < ROUNDS else max(self.correlated, self.alike)
            self.smoothed = smooth_linear(
                self.mean,
                self.rows,
                moves,
                [each.whitened(count * own) for each, own in zip(self.linear, wide, strict=True)],
            )
            self.states = np.array([each.mean for each in self.smoothed])
            self.states[:, first:] = self.estimator.parameters.possible(self.states[:, first:])
            residuals = self._learn(wide, k < ROUNDS)
            if k == ROUNDS - 1:
                self.correlated = correlation_time(residuals * (np.sqrt(self.weights) / self.levels.marker)[:, :, None])

    def stated(self) -> list[Array]:
        """Return the covariances (K, 2, 2) of the places in each frame."""
        wide = [
            (self.levels.marker**2 / own)[:, None, None] * each.covariances + np.diag(self.levels.shift**2)
            for each, own in zip(self.seen, self.weights, strict=True)
        ]
        if self.smoothed:
            rows = self.smoothed[-1].rows[:, self.plane]
            for each, linear in zip(wide, self.linear, strict=True):
                moves = np.zeros((len(each), 2, len(rows)))
                np.add.at(
                    moves, linear.marker, linear.ways[:, :, None] * (linear.slope[:, self.plane] @ rows.T)[:, None]
                )
                each += moves @ moves.transpose(0, 2, 1)
        return wide

    def _linearised(self) -> tuple[list[tuple[Array, Array]], list[_Linear]]:
        """Return transitions and offsets of the steps, and the observations, about the states."""
        steps, linear = [], []
        for k, (x, seen) in enumerate(zip(self.states, self.seen, strict=True)):
            if k < len(self.gaps):
                found = self.process.predict(x, seen.t, self.seen[k + 1].t)
                if not (np.abs(found.x).max() < BEYOND and np.abs(found.transition).max() < BEYOND**2):
                    raise SimulationError("The state is not finite.", status=Status.NOT_FINITE, time=seen.t)
                steps.append((found.transition, found.x - found.transition @ x))
            used = np.flatnonzero(seen.seen)
            at, slope = self.estimator.model.predict(
                x, self.process.base(seen.t, x), seen.rows, self.process.accelerations(x, seen.t)
            )
            axes, measured = whitening(seen.covariances[used])
            (own, axis), std = np.nonzero(measured), 1.0 / np.linalg.norm(axes[measured], axis=1)
            marker, ways = used[own], axes[measured] * std[:, None]
            flat = np.einsum("mc,mcn->mn", ways, slope[marker])
            values = (ways * (seen.places - at)[marker]).sum(axis=1) + flat @ x
            linear.append(_Linear(marker, axis, ways, values, flat, std))
        return steps, linear

    def _learn(self, wide: list[Array], everything: bool) -> Array:
        """Set the levels by the smoothed states; return the residuals (T, K, 2) over the detector's errors.

        If not `everything`, those of the markers alone.
        """
        shifts, residuals = np.zeros(2), np.full((*self.weights.shape, 2), np.nan)
        squares = residuals.copy()
        variance = np.diag(self.levels.shift**2)
        for k, (each, smoothed, covariance) in enumerate(zip(self.linear, self.smoothed, wide, strict=True)):
            if not each.marker.size:
                continue
            off, moves = each.values - each.slope @ smoothed.mean, smoothed.rows @ each.slope.T
            errors = np.outer(off, off) + moves.T @ moves
            gain = np.linalg.solve(covariance, each.ways @ variance).T  # of the shift, from the errors
            doubt, own = variance - gain @ each.ways @ variance, np.eye(off.size) - each.ways @ gain
            shifts += np.diag(gain @ errors @ gain.T + doubt)
            errors = own @ errors @ own.T + each.ways @ doubt @ each.ways.T
            squares[k, each.marker, each.axis] = np.diag(errors) / each.std**2
            residuals[k, each.marker, each.axis] = off / each.std
        directions = np.isfinite(squares).sum(axis=2)
        squares = np.where(directions, np.nansum(squares, axis=2), np.nan)
        distances = squares / self.levels.marker**2
        freedom = likeliest_freedom(distances, directions)
        self.weights = np.where(directions, (freedom + directions) / (freedom + np.nan_to_num(distances)), 1.0)
        counts, weighted = directions.sum(axis=0), np.nansum(self.weights * squares, axis=0)
        marker = np.sqrt((weighted + PRIOR_COUNT * weighted.sum() / counts.sum()) / (counts + PRIOR_COUNT))
        self.levels = self.levels._replace(marker=marker, freedom=freedom)
        if everything:
            frames, (density, jump) = sum(each.marker.size > 0 for each in self.linear), self._disturbed()
            self.levels = self.levels._replace(shift=np.sqrt(shifts / frames), density=density, jump=jump)
        return residuals

    def _disturbed(self) -> tuple[Array, float]:
        """Return the likeliest density of disturbances and level of the changes.

        The squares of a kind are compared with the number of them that the run determines.
        """
        kinds, levels, steps = np.append(0, self.process.noise_ends), self.levels, self.smoothed[:-1]
        most = self.process.noise(1.0, 1.0).shape[0]  # rows of a step, before those of changes

        def factor(first: int, end: int | None) -> float:
            squares = sum(float(np.sum(each.noise[first:end] ** 2)) for each in steps)
            known = sum(float(np.sum(1.0 - each.noise_variance[first:end])) for each in steps)
            return float(np.sqrt((1.0 + squares) / (1.0 + known)))

        density = levels.density * [factor(first, end) for first, end in pairwise(kinds.tolist())]
        first = self.estimator.process_noise.first
        return np.clip(density, QUIET * first, MOST * first), levels.jump * factor(most, None)


def likeliest_freedom(distances: Array, directions: Integers) -> float:
    """Return the likeliest degrees of freedom, 1 to GAUSSIAN, of Student's distribution in one or two dimensions.

    `distances` (...) are squared Mahalanobis distances d, NaN if not seen, in `directions` (...) dimensions D; the
    density is proportional to ``(1 + d / freedom)^(-(freedom + D) / 2)``.
    """
    from scipy.optimize import minimize_scalar
    from scipy.special import gammaln

    there = np.isfinite(distances)
    seen, sizes = distances[there], directions[there]

    def unlikely(log: float) -> float:
        freedom = np.exp(log)
        constant = gammaln(0.5 * freedom) - gammaln(0.5 * (freedom + sizes)) + 0.5 * sizes * log
        return float((constant + 0.5 * (freedom + sizes) * np.log1p(seen / freedom)).mean())

    return float(np.exp(minimize_scalar(unlikely, bounds=(0.0, np.log(GAUSSIAN)), method="bounded").x))


def correlation_time(residuals: Array) -> float:
    """Return the number of frames (T, ...) over which residuals are alike, at least 1: 1 + 2 sum of correlations.

    NaN: not seen. The sum ends at a correlation of less than two standard deviations of that of independent residuals.
    """
    known, there = np.nan_to_num(residuals), np.isfinite(residuals)
    variance, frames = (known**2).sum() / max(there.sum(), 1), 1.0
    if variance == 0.0:
        return frames
    for lag in range(1, len(known) // 2):
        pairs = max(int(np.count_nonzero(there[lag:] & there[:-lag])), 1)
        likeness = (known[lag:] * known[:-lag]).sum() / pairs / variance
        if likeness < 2.0 / np.sqrt(pairs):
            break
        frames += 2.0 * likeness
    return float(frames)
