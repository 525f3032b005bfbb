"""Tests of windows against each other: a drift over the recording, and ratios that scatter more than by noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.held import CLOCK, DRIFT
from hyperflex.identification.declarations.score_tests import TESTING, Scores, ScoreTest
from hyperflex.identification.uncertainty.covariance import Basis, ratio_gradients, ratio_spread, ratios
from hyperflex.identification.uncertainty.noise import CHANCE


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


def drift_test(basis: Basis, found: Scores | None, tests: Sequence[ScoreTest]) -> tuple[ScoreTest, ...]:
    """Return the score test of a gravity that seems to grow with time, as a clock that drifts makes it; or nothing.

    Notes
    -----
    The derivative of the residuals by the drift is that by gravity's scale times the window's place in the recording,
    -1/2 to 1/2; what is free and the mean scale are eliminated. Its standard deviation is that of the windows' scores
    about the trend (cluster-robust), and that of the noise at least. `values` is the change of gravity from the first
    window to the last, `moved` what ratios of inertia move by to either side of the middle; NaN where it may be
    chance and explains little. Quantities that mask others are freed first: the windows' scores are those at the linear
    model's optimum with these.
    """
    if found is None or CLOCK not in found.groups or len(found.score) < WINDOWED.least:
        return ()
    from scipy.special import stdtrit

    (gravity,), count = found.groups[CLOCK], basis.fit.x.size
    place = (found.middle - found.middle.mean()) / np.ptp(found.middle)
    others = [k for each in tests if each.masks and not each.law for k in found.groups.get(each.name, [])]
    mixed = place[:, None] * found.information[:, gravity]
    inverse = found.inverse(sorted({*found.free, gravity, *others}))
    across = inverse @ mixed.sum(axis=0)
    own = place**2 * found.information[:, gravity, gravity] - 2.0 * mixed @ across
    own += np.einsum("i,wij,j->w", across, found.information, across)
    score, total, information = found.score, found.total, float(own.sum())
    if information <= TESTING.tiny * float(mixed[:, gravity] @ place):
        return ()
    if others:
        step = -inverse @ score.sum(axis=0)
        total += float(score.sum(axis=0) @ step)
        score = score + found.information @ step
    each = place * score[:, gravity] - score @ across
    drift = -float(each.sum()) / information
    gain = min(drift**2 * information / total, 1.0)
    scatter = float(np.sum((each + own * drift) ** 2)) * place.size / (place.size - 2.0)
    noise = float(np.sqrt(basis.information.variance * total / found.total * (1.0 - gain) / information))
    std, least = float(np.sqrt(scatter)) / information, float(stdtrit(place.size - 2.0, 1.0 - 0.5 * WINDOWED.rare))
    sure = abs(drift) > max(least * std, WINDOWED.beyond * noise)
    by_gravity = found.inverse(found.free) @ found.information.sum(axis=0)[:, gravity]
    std, unit = max(std, noise), float(found.scale[gravity])
    test = ScoreTest(
        DRIFT,
        gain,
        np.array([drift / unit]),
        moved=0.5 * abs(drift) / unit if sure or gain > TESTING.explains else np.nan,
        std=std / unit,
        shift=-0.5 * drift * (by_gravity / found.scale)[:count],
        excess_gain=max(0.0, 1.0 - (std / drift) ** 2) if drift else 0.0,
        sure=sure,
    )
    return (test,)


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
    moves is the cluster-robust covariance (Liang and Zeger 1986, doi:10.1093/biomet/73.1.13). If windows differ by
    noise alone, that sum is about chi-squared, see :meth:`Scores.moves`. Told is what is rarer than CHANCE, shared by
    all ratios.
    """
    count = basis.fit.x.size
    if found is None or len(found.score) < WINDOWED.least:
        return (), np.zeros((count, count))
    from scipy.special import gammaincc

    windows = len(found.score)
    inverse = found.inverse(found.free)
    moves = found.score @ inverse[:, :count] / found.scale[:count]
    covariance = moves.T @ moves * windows / (windows - 1.0)
    parameters, information = basis.plant.parameters, basis.information
    stated, known = ratio_spread(parameters, information), ratios(parameters.rope(information.x), parameters.names)
    scattered, tested = [], sum(int((np.isfinite(each) & (each > 0.0)).sum()) for each in stated.values())
    for name, slopes in ratio_gradients(parameters, information.x).items():
        for k in np.flatnonzero(np.isfinite(stated[name]) & (stated[name] > 0.0) & (known[name] != 0.0)):
            each, expected, freedom = found.moves(slopes[k], inverse)
            if expected <= TESTING.tiny:  # one window determines it alone
                continue
            shown = float(np.sqrt(each @ each / expected))
            times = shown / float(stated[name][k])
            if gammaincc(0.5 * freedom, 0.5 * freedom * times**2) < CHANCE / tested:
                scattered.append(Scatter(f"{name}[{k}]", times, shown / float(abs(known[name][k]))))
    return tuple(sorted(scattered, key=lambda each: -each.times)), covariance
