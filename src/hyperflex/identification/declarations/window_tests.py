"""Tests of whether all windows of a recording tell the same: a drifting clock, and estimates that scatter."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.clock import DRIFT
from hyperflex.identification.declarations.score_tests import TESTING, ScoreTest
from hyperflex.identification.fit import linearise
from hyperflex.identification.model import extended
from hyperflex.identification.uncertainty.covariance import UNKNOWN, Basis
from hyperflex.identification.uncertainty.noise import CHANCE
from hyperflex.identification.uncertainty.ratios import ratio_gradients, ratio_spread, ratios


@dataclass(frozen=True)
class WindowTestLimits:
    """Thresholds of the tests of drift and scatter."""

    # windows: a trend takes two degrees of freedom, and its scatter needs two more
    least: int = 4
    # probability, by Student's t of the windows' own scatter, of such a drift where there is none
    rare: float = 0.01
    # standard deviations of the noise that a drift exceeds as well: few windows may scatter little by chance
    beyond: float = 4.0


WINDOWED = WindowTestLimits()
SMALL = UNKNOWN**2  # part of the largest eigenvalue of scaled information below which a direction is unknown


@dataclass(frozen=True, eq=False)
class WindowScores:
    """What each of W windows says of K numbers: the P that were free, and gravity's scale if that was held.

    Then come numbers of what was held and explains much. score (W, K): derivative of half its sum of squares by each,
    its state eliminated. information (W, K, K). middle (W,): s. gravity: which of the numbers is gravity's scale; None
    without gravity. widths (K,): comparable changes. free: which of the P are not at a bound. total: sum of squares.
    """

    score: Array
    information: Array
    middle: Array
    gravity: int | None
    widths: Array
    free: list[int]
    total: float

    def inverse(self, which: list[int]) -> Array:
        """Return the inverse (K, K) of the information of all windows about `which` numbers, 0 elsewhere."""
        part, width = np.ix_(which, which), self.widths[which]
        scale = np.outer(width, width)
        result: Array = np.zeros(self.information.shape[1:])
        matrix = self.information.sum(axis=0)[part] * scale
        result[part] = np.linalg.pinv(matrix, rcond=SMALL, hermitian=True) * scale
        return result


def window_scores(basis: Basis, beside: Sequence[str] = ()) -> WindowScores | None:
    """Return the scores of a fit's windows, at the cost of one round of it; None of too few windows.

    `beside`: words of what was held and explains so much that a drift may seem to be there for it.
    """
    if len(basis.windows) < WINDOWED.least:
        return None
    plant, count = basis.plant, basis.fit.x.size
    heavy = bool(np.any(plant.parameters.guess.gravity))
    labels = [each.name for each in plant.parameters.all]
    held = heavy and "gravity_scale" not in labels
    model, x, _ = extended(plant, basis.fit.x, [*["gravity_scale"] * held, *beside])
    scores, matrices, total = [], [], 0.0
    for window, state, residual in zip(basis.windows, basis.fit.states, basis.fit.residuals, strict=True):
        slopes, left = linearise(model, window, x, state, residual, basis.fit.loss).reduced()
        scores.append(slopes.T @ left)
        matrices.append(slopes.T @ slopes)
        total += float(left @ left)
    if not (np.isfinite(matrices).all() and total > 0.0):
        return None
    middle = np.array([0.5 * (window.t[0] + window.t[-1]) for window in basis.windows])
    gravity = count if held else labels.index("gravity_scale") if heavy else None
    free = [k for k in range(count) if x[k] > plant.parameters.lower[k]]
    return WindowScores(np.array(scores), np.array(matrices), middle, gravity, model.parameters.widths, free, total)


def drift_test(basis: Basis, scores: WindowScores | None) -> tuple[ScoreTest, ...]:
    """Return the score test of a gravity that seems to grow with time, as a clock that drifts makes it; or nothing.

    Notes
    -----
    The derivative of the residuals by the drift is that by gravity's scale times the window's place in the recording,
    -1/2 to 1/2; what is free and the mean scale are eliminated. Its standard deviation is that of the windows' scores
    about the trend (cluster-robust), and that of the noise at least. `values` is the change of gravity from the first
    window to the last, `moved` what ratios of inertia move by to either side of the middle; NaN where it may be
    chance and explains little. The windows' scores are those at the linear model's optimum with what stands beside.
    """
    if scores is None or scores.gravity is None:
        return ()
    from scipy.special import stdtrit

    gravity, count = scores.gravity, basis.fit.x.size
    place = (scores.middle - scores.middle.mean()) / np.ptp(scores.middle)
    others = [k for k in range(count, scores.widths.size) if k != gravity]
    nuisance = sorted({*scores.free, gravity, *others})
    mixed = place[:, None] * scores.information[:, gravity]
    inverse = scores.inverse(nuisance)
    across = inverse @ mixed.sum(axis=0)
    own = place**2 * scores.information[:, gravity, gravity] - 2.0 * mixed @ across
    own += np.einsum("i,wij,j->w", across, scores.information, across)
    score, total = scores.score, scores.total
    if others:
        step = -inverse @ score.sum(axis=0)
        score = score + scores.information @ step
        total += float(scores.score.sum(axis=0) @ step)
    each = place * score[:, gravity] - score @ across
    information = float(own.sum())
    if information <= SMALL * float(mixed[:, gravity] @ place):
        return ()
    drift = -float(each.sum()) / information
    gain = min(drift**2 * information / total, 1.0)
    scatter = float(np.sum((each + own * drift) ** 2)) * place.size / (place.size - 2.0)
    noise = float(np.sqrt(basis.information.variance * total / scores.total * (1.0 - gain) / information))
    std, least = float(np.sqrt(scatter)) / information, float(stdtrit(place.size - 2.0, 1.0 - 0.5 * WINDOWED.rare))
    sure = abs(drift) > max(least * std, WINDOWED.beyond * noise)
    by_gravity = scores.inverse(scores.free)[:count] @ scores.information.sum(axis=0)[:, gravity]
    std = max(std, noise)
    excess_gain = max(0.0, 1.0 - (std / drift) ** 2) if drift else 0.0
    moved = 0.5 * abs(drift) if sure or gain > TESTING.explains else np.nan
    shift = -0.5 * drift * by_gravity
    values = np.array([drift])
    return (ScoreTest(DRIFT, gain, values, moved, std=std, shift=shift, excess_gain=excess_gain, sure=sure),)


class Scatter(NamedTuple):
    """A ratio whose windows disagree: its label, and the standard deviation that they show, over that of noise.

    part: that standard deviation as a part of the ratio.
    """

    label: str
    times: float
    part: float


def scatter_test(basis: Basis, scores: WindowScores | None) -> tuple[tuple[Scatter, ...], Array]:
    """Return the ratios that scatter more between windows than by noise, most first, and x's covariance by that (P, P).

    `basis` is without errors of the model.

    Notes
    -----
    Each window moves the estimate by its score through the inverse of all information; the sum of squares of these
    moves is the cluster-robust covariance (Liang and Zeger 1986, doi:10.1093/biomet/73.1.13). Over the variance by
    noise it is chi-squared with one degree of freedom less than there are windows, if these differ by noise alone. Told
    is what is rarer than CHANCE, shared by all ratios.
    """
    count = basis.fit.x.size
    if scores is None:
        return (), np.zeros((count, count))
    from scipy.special import gammaincc

    windows = len(scores.score)
    moves = scores.score @ scores.inverse(scores.free)[:, :count]
    covariance = moves.T @ moves * windows / (windows - 1.0)
    parameters, information = basis.plant.parameters, basis.information
    stated, known = ratio_spread(parameters, information), ratios(parameters.rope(information.x), parameters.names)
    found, tested = [], sum(int((np.isfinite(each) & (each > 0.0)).sum()) for each in stated.values())
    for name, slopes in ratio_gradients(parameters, information.x).items():
        seen = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))
        for k, (std, shown, value) in enumerate(zip(stated[name], seen, known[name], strict=True)):
            if not (np.isfinite(std) and std > 0.0 and value != 0.0):
                continue
            times = float(shown / std)
            if gammaincc(0.5 * (windows - 1.0), 0.5 * (windows - 1.0) * times**2) < CHANCE / tested:
                found.append(Scatter(f"{name}[{k}]", times, float(shown / abs(value))))
    return tuple(sorted(found, key=lambda each: -each.times)), covariance
