"""Tests of whether all windows of a recording tell the same: a drifting clock, and estimates that scatter."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.held import CLOCK, DRIFT
from hyperflex.identification.declarations.score_tests import TESTING, Scores, ScoreTest, scores
from hyperflex.identification.uncertainty.covariance import Basis
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


def window_scores(basis: Basis, beside: Sequence[str] = ()) -> Scores | None:
    """Return the scores of a fit's windows about what was free and gravity's scale; None of too few windows.

    `beside`: words of what was held and explains so much that a drift may seem to be there for it.
    """
    parameters = basis.plant.parameters
    held = bool(np.any(parameters.guess.gravity)) and CLOCK not in parameters.labels
    return scores(basis, [*[CLOCK] * held, *beside]) if len(basis.windows) >= WINDOWED.least else None


def drift_test(basis: Basis, found: Scores | None) -> tuple[ScoreTest, ...]:
    """Return the score test of a gravity that seems to grow with time, as a clock that drifts makes it; or nothing.

    Notes
    -----
    The derivative of the residuals by the drift is that by gravity's scale times the window's place in the recording,
    -1/2 to 1/2; what is free and the mean scale are eliminated. Its standard deviation is that of the windows' scores
    about the trend (cluster-robust), and that of the noise at least. `values` is the change of gravity from the first
    window to the last, `moved` what ratios of inertia move by to either side of the middle; NaN where it may be
    chance and explains little. The windows' scores are those at the linear model's optimum with what stands beside.
    """
    if found is None or CLOCK not in found.plant.parameters.labels:
        return ()
    from scipy.special import stdtrit

    gravity, count = found.plant.parameters.labels.index(CLOCK), basis.fit.x.size
    middle = np.array([0.5 * (window.t[0] + window.t[-1]) for window in basis.windows])
    place = (middle - middle.mean()) / np.ptp(middle)
    others = [k for k in range(count, found.x.size) if k != gravity]
    mixed = place[:, None] * found.information[:, gravity]
    inverse = found.inverse(sorted({*found.free, gravity, *others}))
    across = inverse @ mixed.sum(axis=0)
    own = place**2 * found.information[:, gravity, gravity] - 2.0 * mixed @ across
    own += np.einsum("i,wij,j->w", across, found.information, across)
    score, total = found.score, found.total
    if others:
        step = -inverse @ score.sum(axis=0)
        total += float(score.sum(axis=0) @ step)
        score = score + found.information @ step
    each = place * score[:, gravity] - score @ across
    information = float(own.sum())
    if information <= TESTING.tiny * float(mixed[:, gravity] @ place):
        return ()
    drift = -float(each.sum()) / information
    gain = min(drift**2 * information / total, 1.0)
    scatter = float(np.sum((each + own * drift) ** 2)) * place.size / (place.size - 2.0)
    noise = float(np.sqrt(basis.information.variance * total / found.total * (1.0 - gain) / information))
    std, least = float(np.sqrt(scatter)) / information, float(stdtrit(place.size - 2.0, 1.0 - 0.5 * WINDOWED.rare))
    sure = abs(drift) > max(least * std, WINDOWED.beyond * noise)
    by_gravity = found.inverse(found.free)[:count] @ found.information.sum(axis=0)[:, gravity] / found.scale[:count]
    std = max(std, noise)
    excess_gain = max(0.0, 1.0 - (std / drift) ** 2) if drift else 0.0
    moved = 0.5 * abs(drift) / found.scale[gravity] if sure or gain > TESTING.explains else np.nan
    values, std = np.array([drift]) / found.scale[gravity], std / float(found.scale[gravity])
    shift = -0.5 * drift * by_gravity
    return (ScoreTest(DRIFT, gain, values, moved, std=std, shift=shift, excess_gain=excess_gain, sure=sure),)


class Scatter(NamedTuple):
    """A ratio whose windows disagree: its label, and the standard deviation that they show, over that of noise.

    part: that standard deviation as a part of the ratio.
    """

    label: str
    times: float
    part: float


def scatter_test(basis: Basis, found: Scores | None) -> tuple[tuple[Scatter, ...], Array]:
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
    if found is None:
        return (), np.zeros((count, count))
    from scipy.special import gammaincc

    windows = len(found.score)
    moves = found.score @ found.inverse(found.free)[:, :count] / found.scale[:count]
    covariance = moves.T @ moves * windows / (windows - 1.0)
    parameters, information = basis.plant.parameters, basis.information
    stated, known = ratio_spread(parameters, information), ratios(parameters.rope(information.x), parameters.names)
    scattered, tested = [], sum(int((np.isfinite(each) & (each > 0.0)).sum()) for each in stated.values())
    for name, slopes in ratio_gradients(parameters, information.x).items():
        seen = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))
        for k, (std, shown, value) in enumerate(zip(stated[name], seen, known[name], strict=True)):
            if not (np.isfinite(std) and std > 0.0 and value != 0.0):
                continue
            times = float(shown / std)
            if gammaincc(0.5 * (windows - 1.0), 0.5 * (windows - 1.0) * times**2) < CHANCE / tested:
                scattered.append(Scatter(f"{name}[{k}]", times, float(shown / abs(value))))
    return tuple(sorted(scattered, key=lambda each: -each.times)), covariance
