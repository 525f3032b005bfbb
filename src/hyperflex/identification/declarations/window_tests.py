"""Tests by what windows leave: a clock that drifts, links that are too long, and estimates that scatter."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.declarations.held import CLOCK, DRIFT, FEW_LINKS, LINKS
from hyperflex.identification.declarations.score_tests import (
    TESTING,
    Scores,
    ScoreTest,
    fit_with,
    part_of,
    within,
)
from hyperflex.identification.fit import Window, fit
from hyperflex.identification.model import Plant
from hyperflex.identification.uncertainty.covariance import Basis, ratio_gradients, ratio_spread, ratios
from hyperflex.identification.uncertainty.noise import CHANCE
from hyperflex.model import Rope
from hyperflex.sensors import Angles


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
    if found is None or CLOCK not in found.groups or len(basis.windows) < WINDOWED.least:
        return ()
    from scipy.special import stdtrit

    (gravity,), count = found.groups[CLOCK], basis.fit.x.size
    middle = np.array([0.5 * (window.t[0] + window.t[-1]) for window in basis.windows])
    place = (middle - middle.mean()) / np.ptp(middle)
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
    moves is the cluster-robust covariance (Liang and Zeger 1986, doi:10.1093/biomet/73.1.13). Over the variance by
    noise it is chi-squared with one degree of freedom less than there are windows, if these differ by noise alone. Told
    is what is rarer than CHANCE, shared by all ratios.
    """
    count = basis.fit.x.size
    if found is None or len(basis.windows) < WINDOWED.least:
        return (), np.zeros((count, count))
    from scipy.special import gammaincc

    windows = len(found.score)
    moves = found.score @ found.inverse(found.free)[:, :count] / found.scale[:count]
    covariance = moves.T @ moves * windows / (windows - 1.0)
    parameters, information = basis.plant.parameters, basis.information
    stated, known = ratio_spread(parameters, information), ratios(parameters.rope(information.x), parameters.names)
    scattered, tested = [], sum(int((np.isfinite(each) & (each > 0.0)).sum()) for each in stated.values())
    for name, slopes in ratio_gradients(parameters, information.x).items():
        shown = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))
        for k in np.flatnonzero(np.isfinite(stated[name]) & (stated[name] > 0.0) & (known[name] != 0.0)):
            times = float(shown[k] / stated[name][k])
            if gammaincc(0.5 * (windows - 1.0), 0.5 * (windows - 1.0) * times**2) < CHANCE / tested:
                scattered.append(Scatter(f"{name}[{k}]", times, float(shown[k] / abs(known[name][k]))))
    return tuple(sorted(scattered, key=lambda each: -each.times)), covariance


UNSURE, ELSE = 0.25, 2.0  # of the pattern's amplitude (1: finer links): its least deviation, and that of other causes
PIECES = 4  # that each link is cut into: errors go with a link's length squared, so that a 16th of them is left


def link_test(basis: Basis, others: Sequence[ScoreTest] = ()) -> tuple[ScoreTest, ...]:
    """Return the test of a rope's links, or nothing where they cannot be cut, or where few leave no more than noise.

    Links of a rope of many have to be alike; few may each have values of their own, with their mass in their middle. If
    one of the `others` explains much, what it leaves is tested: a fit with it free as well.

    Notes
    -----
    Indirect inference: the rope as fitted, its links cut into PIECES, is simulated, and the fit repeated on what the
    same sensor would see of that. The parameters' change is the error that too long links make; the residuals are its
    pattern. How much of it the residuals hold is 1 of the finer rope and 0 of a chain that has just these links; see
    :func:`_probability`.
    """
    name = next((each.name for each in others if each.masks), "")
    richer = fit_with(basis, name)
    if richer is not None:
        return tuple(within(each, basis.fit.x.size, [name]) for each in link_test(richer))
    plant, x, some = basis.plant, basis.fit.x, part_of(basis)
    n, parameters, loss, states = plant.parameters.guess.n_links, plant.parameters.all, some.fit.loss, some.fit.states
    own = any(0 < len(p.links) < n for p in parameters if p.kind.owner == "link")
    if n == 1 or plant.motor is not None or (basis.information.whiteness >= CHANCE if n <= FEW_LINKS else own):
        return ()
    try:
        finer = plant.cut(x, PIECES)
        seen = [_seen(plant.parameters.rope(x), finer, *each) for each in zip(some.windows, states, strict=True)]
        again = fit(plant, seen, x, states, loss=loss, rounds=TESTING.rounds)
    except InvalidInput:  # links that are not uniform, or that cannot be simulated
        return ()
    pairs = list(zip(some.fit.residuals, again.residuals, strict=True))
    before, after = (sum(map(loss.cost, each)) for each in (some.fit.residuals, [r - pattern for r, pattern in pairs]))
    shift, std = again.x - x, np.sqrt(np.diag(basis.information.covariance))
    now, then = map(plant.parameters.values, (x, again.x))
    parts = np.abs(np.divide(then - now, now, out=np.zeros(x.size), where=now > 0.0))
    test = ScoreTest(
        LINKS,
        max(before - after, 0.0) / before if before > 0.0 else 0.0,
        np.array([float(n * PIECES)]),
        shift=shift,
        excess_gain=_probability(basis, pairs),
        ratio_sensitivity=float(np.max(parts, where=np.abs(shift) > 2.0 * std, initial=0.0)),
    )
    return (test,)


def _probability(basis: Basis, pairs: list[tuple[Array, Array]]) -> float:
    """Return the probability of the finer rope, by windows' residuals and patterns [((m C,), (m C,)), ..].

    The amplitude of the pattern is fitted to the residuals; its standard deviation follows from the noise, and from how
    the windows scatter. Where residuals are not white it is UNSURE at least, and the amplitude may come from anything
    else that the model omits, which makes it as large as ELSE.
    """
    dots, sizes = np.array([(pattern @ residual, pattern @ pattern) for residual, pattern in pairs]).T
    total = float(sizes.sum())
    if total <= 0.0:
        return 0.0
    amplitude, count = float(dots.sum()) / total, len(pairs)
    variance = basis.information.variance * basis.information.correlation / total
    if count > 1:
        scatter = float(((dots - amplitude * sizes) ** 2).sum()) / total**2 * count / (count - 1.0)
        variance = max(variance, scatter)
    from scipy.special import softmax

    white = basis.information.whiteness >= CHANCE
    std = max(float(np.sqrt(variance + UNSURE**2 * (not white))), 1e-12)
    # of the pattern's amplitude if the rope has finer links, has just these, or the model omits something else
    means, stds = np.array([1.0, 0.0, 0.0]), np.array([std, std, ELSE])
    logs = -0.5 * ((amplitude - means) / stds) ** 2 - np.log(stds)
    return float(softmax(logs[: 2 if white else 3])[0])


def _seen(rope: Rope, finer: Plant, window: Window, state: Array) -> Window:
    """Return a window with what the sensor sees of the finer rope from a smooth shape like `state` (2n,)."""
    from scipy.interpolate import make_interp_spline

    n, fine = rope.n_links, finer.parameters.guess
    places, old = (np.cumsum(each.length) - 0.5 * each.length for each in (fine, rope))
    # along the rope, straight lines continue beyond the ends
    start = make_interp_spline(old, state.reshape(2, n).T, k=1)(places).T.ravel()
    y = finer.predict(np.zeros(0), window.t, start)
    if y is None:
        raise InvalidInput("the finer rope cannot be simulated")
    if isinstance(finer.sensor, Angles):
        y = _chords(y.reshape(y.shape[0], n, PIECES), fine.length.reshape(n, PIECES))
    return replace(window, y=np.where(window.weight > 0.0, y, 0.0))


def _chords(q: Array, length: Array) -> Array:
    """Return the directions (m, n) of the chords of links cut into pieces (m, n, p), rad."""
    mean = np.mean(q, axis=2)
    off = q - mean[:, :, None]
    across, along = (length * np.sin(off)).sum(axis=2), (length * np.cos(off)).sum(axis=2)
    return np.asarray(mean + np.arctan2(across, along))
