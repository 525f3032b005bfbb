"""Tests of what a fit has held and of what was declared: scores of its windows, and refits of what explains much.

And tests of windows against each other: a drift over the recording, and ratios that scatter more than by noise.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.identification.declarations.held import (
    CLOCK,
    DRIFT,
    LAWS,
    MASSES,
    QUANTITIES,
    SCALES,
    HeldQuantity,
    base,
    words_for_tests,
)
from hyperflex.identification.findings import Kind
from hyperflex.identification.fit import Window, linearise
from hyperflex.identification.model import Parameter, Plant, extended, scale_words
from hyperflex.identification.uncertainty.covariance import Basis, ratio_gradients, ratio_spread, ratios, widening
from hyperflex.identification.uncertainty.noise import CHANCE
from hyperflex.model import RESISTANCES


@dataclass(frozen=True)
class ScoreTestOptions:
    """Thresholds of the score tests, and how far they refit."""

    # part of the sum of squares, to first order, from which a refit is made: less than what is believed
    suspect: float = 0.3
    # the same of a resistance, whose derivative at 0 shows less: that of drag grows from there
    law: float = 0.15
    # refits at most: for time
    refits: int = 3
    # part of a gain, 1 - 1 / chi^2: chi^2 = 14, one in 6000 right fits
    sure: float = 0.93
    # part of the sum of squares: what takes away most of it is believed whatever the noise
    explains: float = 0.5
    # part of the sum of squares: gains that differ by less explain the same
    equal: float = 0.05
    # relative, of ratios: independent fits of real pendulums differ by so much
    moves: float = 0.01
    # standard deviations: the 95 % intervals reach so far, and hold smaller moves
    covered: float = 2.0
    # refits that are tested again, each with one thing more freed: the triple pendulum needs two, drag and dry
    hiding: int = 2
    # probability of finer links: more likely than not; part of a test's gain that these show as well at least
    likely: float = 0.5
    seeming: float = 0.5
    # of information about a number that alone has 1, or part of the largest eigenvalue: about the root of rounding
    tiny: float = 1e-08
    # windows that are compared: a trend takes two degrees of freedom, and its scatter needs two more
    windows: int = 4
    # probability, by Student's t of the windows' own scatter, of such a drift where there is none
    rare: float = 0.01
    # standard deviations of the noise that a drift exceeds as well: few windows may scatter little by chance
    beyond: float = 4.0


TESTING = ScoreTestOptions()


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """What the data show of a quantity that was fixed in a fit.

    Attributes
    ----------
    name : str
        As in ``free``: ``com``, or ``gravity_scale``, which a wrong clock or wrong lengths move; ``angle_factor``, by
        which angles are read too large; ``mass:taper``, the logarithm of the mass's growth along a rope of many links;
        ``clock_drift``, by which gravity seems to grow over the recording; ``links``,
        which may be too long.
    gain : float
        Part of the residuals' sum of squares that freeing it takes away: by a refit, or to first order.
    values : (k,) float64
        Its values then, SI units.
    moved : float
        Largest relative change of J/p1 and p/p1 that a refit finds; NaN without one.
    beyond : float
        The same in standard deviations that noise gives these ratios, wider by Student's quantile where the residuals
        hold few values; the largest, inf of one that was held.
    std : float
        Greatest standard deviation that they would have.
    shift : (P,) float64
        Change of the fit's x that freeing it makes, to first order.
    added : (P, P) float64
        Covariance of x that freeing it adds.
    rate : (P, k) float64
        Change of the fit's x per unit of the quantity's x.
    excess_gain : float
        Part of the gain that noise does not explain, 0 to 1; of links the probability that the rope has finer ones.
    sure : bool
        Whether residuals are white, as they are or with it free, so that noise is known.
    ratio_sensitivity : float
        Of links: largest relative change of a parameter by finer links, of those beyond twice their standard deviation.
    freed_with : tuple of str
        What had to be free as well before the data showed this.
    information : (k, k) float64
        Of its own x, in units of the noise's variance.
    declared_std : float
        Of gravity_scale: relative standard deviation by lengths and times as declared; else 0.
    explains : tuple of str
        Of links: tests that a rope of finer links would make seem as significant.
    """

    name: str
    gain: float
    values: Array
    moved: float = np.nan
    beyond: float = np.inf
    std: float = np.inf
    shift: Array = field(default_factory=lambda: np.zeros(0))
    added: Array = field(default_factory=lambda: np.zeros((0, 0)))
    rate: Array = field(default_factory=lambda: np.zeros((0, 0)))
    excess_gain: float = 0.0
    sure: bool = False
    ratio_sensitivity: float = 0.0
    freed_with: tuple[str, ...] = ()
    information: Array = field(default_factory=lambda: np.zeros((0, 0)))
    declared_std: float = 0.0
    explains: tuple[str, ...] = ()

    @property
    def quantity(self) -> HeldQuantity:
        """What it is about."""
        return QUANTITIES.get(self.name, MASSES)

    @property
    def law(self) -> bool:
        """Whether it is a resistance that was omitted."""
        return base(self.name) in LAWS

    @property
    def uneven(self) -> bool:
        """Whether it is of the growth of a resistance along the rope, or of the first joint's own."""
        return self.quantity.kind is Kind.UNEVEN_RESISTANCE

    @property
    def refitted(self) -> bool:
        """Whether a refit has confirmed it."""
        return not np.isnan(self.moved)

    @property
    def significant(self) -> bool:
        """Whether something else than what was held or declared fits: it takes most away, or more than noise can."""
        return self.refitted and (self.gain > TESTING.explains or (self.sure and self.excess_gain > TESTING.sure))

    @property
    def size(self) -> float:
        """How far its value is from what was held; see :meth:`HeldQuantity.size`."""
        return self.quantity.size(float(self.values[0]))

    @property
    def possible(self) -> bool:
        """Whether something can be held or declared so wrongly."""
        return bool(self.size <= np.log(self.quantity.farthest))

    @property
    def slight(self) -> bool:
        """Whether it is no farther off than instruments err, or than lengths and times as declared explain."""
        declared = TESTING.covered * np.hypot(self.declared_std, self.std) if self.declared_std > 0.0 else 0.0
        least = max(self.quantity.slight, declared)
        return bool(self.refitted and 0.0 < least >= self.size)

    @property
    def matters(self) -> bool:
        """Whether ratios would move by more than is negligible and noise may move them, or it is large by itself."""
        moves = self.moved > TESTING.moves and self.beyond > TESTING.covered
        return self.possible and not self.slight and (self.size > self.quantity.enough or moves)

    @property
    def covered(self) -> bool:
        """Whether something else seems to fit, and moves ratios, but by no more than noise may."""
        moves = self.significant and self.moved > TESTING.moves
        return moves and self.possible and not (self.slight or self.matters)

    @property
    def suspected(self) -> bool:
        """Whether what was held or declared may be off: a refit takes much away and moves ratios, not significantly."""
        return self.refitted and not self.law and self.gain > TESTING.suspect and self.matters and not self.significant

    @property
    def masks(self) -> bool:
        """Whether a refit explains so much by what changes no conclusion that it may hide other causes."""
        if self.law:
            return self.refitted and self.gain > TESTING.suspect
        return self.significant and not self.matters and self.name not in (CLOCK, DRIFT)


def by_gain(tests: Iterable[ScoreTest]) -> tuple[ScoreTest, ...]:
    """Return tests, the one that explains most first."""
    return tuple(sorted(tests, key=lambda each: -each.gain))


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of W parts of the windows about K numbers: the P that were free, and those of words that were fixed.

    All are in units of `scale` (K,), the change of x that each makes a cost of 1; inf of what does not act. score
    (W, K): derivative of half the sum of squares of a part by each, its window's state eliminated. information
    (W, K, K). middle (W,): of each part, s. total: sum of squares. plant, x (K,): with all of them free. groups:
    numbers of each word. free: which of the P are not at a bound.
    """

    plant: Plant
    x: Array
    groups: dict[str, list[int]]
    free: list[int]
    scale: Array
    score: Array
    information: Array
    middle: Array
    total: float

    def inverse(self, which: Sequence[int]) -> Array:
        """Return the inverse (K, K) of the information of all windows about `which` numbers, 0 elsewhere."""
        part, matrix = np.ix_(which, which), self.information.sum(axis=0)
        result: Array = np.zeros(matrix.shape)
        result[part] = np.linalg.pinv(matrix[part], rcond=TESTING.tiny, hermitian=True)
        return result

    def moves(self, slope: Array, inverse: Array) -> tuple[Array, float, float]:
        """Return by how much each part moves a value (W,), the expected sum of squares, and its degrees of freedom.

        slope (P,): derivative of the value by x. inverse (K, K): of all information. expected: by noise alone, over the
        value's variance by noise.

        Notes
        -----
        With noise of variance 1, I_w the information, H its sum's inverse and g_w the score of part w at the optimum,
        cov(g_v, g_w) = I_w [v = w] - I_v H I_w. So the moves a^T H g_w have the covariance C = diag(h^T I_w h) -
        (h^T I_v) H (I_w h), h = H a. Their sum of squares, times its freedom over tr C, is about chi-squared with
        (tr C)^2 / tr C^2 degrees of freedom (Satterthwaite 1946, doi:10.2307/3002019): W - 1 of equal parts, fewer
        where some tell more than others.
        """
        along = inverse[:, : slope.size] @ (slope / self.scale[: slope.size])
        pulls = self.information @ along
        covariance = np.diag(pulls @ along) - pulls @ inverse @ pulls.T
        expected = float(np.trace(covariance))
        freedom = expected**2 / max(float((covariance**2).sum()), 1e-300)
        return self.score @ along, expected / max(float((pulls @ along).sum()), 1e-300), freedom


def scores(basis: Basis, words: Sequence[str]) -> Scores | None:
    """Return the scores of a fit, at the cost of one round of it; None where they are not finite."""
    plant, x, held = extended(basis.plant, basis.fit.x, words)

    def reduced(window: Window, state: Array, residual: Array) -> Iterator[tuple[Array, Array, float, float]]:
        slopes, left = linearise(plant, window, x, state, residual, basis.fit.loss).reduced()
        span, channels = float(window.t[-1] - window.t[0]), window.weight.shape[1]
        parts = max(1, round(span / basis.usual))
        which = np.minimum(((window.t - window.t[0]) * parts / max(span, 1e-300)).astype(int), parts - 1)
        rows = np.append(np.repeat(which, channels), np.zeros(left.size - residual.size, dtype=int))  # then the prior
        for part in range(parts):
            some, own = slopes[rows == part], left[rows == part]
            yield some.T @ own, some.T @ some, float(own @ own), float(window.t[which == part].mean())

    each_window = zip(basis.windows, basis.fit.states, basis.fit.residuals, strict=True)
    every = zip(*(part for each in each_window for part in reduced(*each)), strict=True)
    score, matrices, totals, middle = (np.array(each) for each in every)
    prior, count = basis.fit.noise * plant.parameters.prior, len(score)  # each part has its part of it
    score += prior.T @ (basis.fit.noise * plant.parameters.prior_residual(x)) / count
    matrices += prior.T @ prior / count
    if not (np.isfinite(matrices).all() and totals.sum() > 0.0):
        return None
    first, groups = basis.fit.x.size, dict[str, list[int]]()
    free = np.flatnonzero(x[:first] > plant.parameters.lower[:first]).tolist()
    for word, group in held.items():
        groups[word] = list(range(first, first := first + len(group)))
    scale = np.sqrt(np.diag(matrices.sum(axis=0)))
    scale[scale == 0.0] = np.inf
    score, matrices = score / scale, matrices / np.outer(scale, scale)
    return Scores(plant, x, groups, free, scale, score, matrices, middle, float(totals.sum()))


def score_tests(basis: Basis, declared_std: float, budget: Budget) -> tuple[tuple[ScoreTest, ...], Scores | None]:
    """Test what a fit has held, and what was declared; return tests and the windows' scores.

    The test with the greatest gain comes first.

    Lengths and times as declared give gravity a relative standard deviation of `declared_std`.

    Notes
    -----
    Rao's score test, or Lagrange multiplier test (Rao 1948, doi:10.1017/S0305004100023987): with S the derivatives of
    the residuals r by what is free and what is held, less what the windows' states absorb, the score of what is held is
    ``S_h' r``, its information the Schur complement of ``S' S``. In place of a probability the part of the sum of
    squares that it explains is returned: residuals of real recordings are model errors, which have no noise level.
    It costs one round of a fit, with more columns. Resistances that would have to be negative explain nothing. Up to
    three that explain much are fitted along, in some of the windows.
    """
    found, by_window = _refitted_tests(basis, budget)
    every = {each.name: each for each in found}
    scales = scores(basis, list(scale_words(basis.plant).values()))
    if scales is not None and scales.groups:
        every[SCALES] = _test(basis, scales, SCALES, list(range(basis.fit.x.size, scales.x.size)))
    if CLOCK in every:
        every[CLOCK] = replace(every[CLOCK], declared_std=declared_std)
    return by_gain(every.values()), by_window


def hidden_tests(basis: Basis, tests: Sequence[ScoreTest], budget: Budget) -> tuple[ScoreTest, ...]:
    """Return the `tests` of a fit with those in place that show only where others are free as well.

    A resistance that explains much, or anything that explains most and changes no ratio, may hide what else is wrong: a
    fit with it free is tested again. So may a mass or the like where residuals are no noise and nothing alone explains
    them.
    """
    every, freed, seen, now = {each.name: each for each in tests}, list[str](), tests, basis
    for _ in range(TESTING.hiding):
        hiding = _hiding(seen, coloured=not now.information.white)
        richer = now.refit(hiding, covariance=True) if hiding else None
        if richer is None:
            break
        now = richer
        freed.append(hiding)
        seen, _ = _refitted_tests(now, budget)
        for each in seen:
            if each.significant and (each.matters or each.slight) and not each.law:
                known = every.get(each.name, each)
                if not (known.significant or known.freed_with):
                    later = within(each, basis.fit.x.size, freed)
                    every[each.name] = replace(later, declared_std=known.declared_std)
    return by_gain(every.values())


def _hiding(tests: Sequence[ScoreTest], *, coloured: bool) -> str:
    """Return what is to be free for others to show; "" for nothing.

    A mass and a clock that are both wrong explain little one by one: the mass, or the like, with the greatest gain, if
    residuals are not noise and nothing is known to be wrong.
    """
    masking = next((each.name for each in tests if each.masks), "")
    if masking or not coloured or any(each.significant and each.matters for each in tests):
        return masking
    held = (each.name for each in tests if each.gain > TESTING.equal and each.name in MASSES.words)
    return next(held, "")


def within(test: ScoreTest, size: int, freed: Sequence[str]) -> ScoreTest:
    """Return a test of a fit with more parameters, `freed`, as one of a fit with `size`."""
    shift, added, rate = test.shift[:size], test.added[:size, :size], test.rate[:size]
    return replace(test, shift=shift, added=added, rate=rate, freed_with=tuple(freed))


def _refitted_tests(basis: Basis, budget: Budget) -> tuple[tuple[ScoreTest, ...], Scores | None]:
    """Return the tests of a fit, the greatest gain first, and the windows' scores.

    Tests that explain much are returned with what a refit finds.
    """
    every = [scores(basis, words) for words in words_for_tests(basis.plant)]
    tests = (_test(basis, each, *group) for each in every if each is not None for group in each.groups.items())
    found = list(by_gain(tests))
    mended = [each for each in found[TESTING.refits :] if each.quantity.enough < np.inf]  # that are easily mended
    laws = [each for each in found[TESTING.refits :] if each.law][:1]
    for each in [*found[: TESTING.refits], *mended, *laws]:
        if each.gain > (TESTING.law if each.law else TESTING.suspect) or each.excess_gain > TESTING.sure:
            budget.check()
            found[found.index(each)] = _refitted(basis, each)
    return by_gain(found), every[0]


def _test(basis: Basis, found: Scores, name: str, own: list[int]) -> ScoreTest:
    """Return the test of numbers that were held, to first order."""
    count, scale = basis.fit.x.size, found.scale
    matrix, score = found.information.sum(axis=0), found.score.sum(axis=0)
    parameters: list[Parameter] = [found.plant.parameters.all[k] for k in own]
    across = matrix[own] @ found.inverse(found.free)
    information, slope = matrix[np.ix_(own, own)] - across @ matrix[:, own], score[own] - across @ score
    sizes, directions = np.linalg.eigh(information)
    information = (directions * np.where(sizes > TESTING.tiny, sizes, 0.0)) @ directions.T  # less is rounding
    rate = -(across.T / scale[:, None])[:count]
    shift, step, gain = _bounded_step(found, count, own, slope)
    noise = basis.information.variance * basis.information.correlation
    chance = noise * max(1, int(np.count_nonzero(step)))
    with np.errstate(over="ignore"):
        moved = found.x[own] + step / scale[own]
        values = np.array([each.value(x) for each, x in zip(parameters, moved, strict=True)])
    acting = np.where(np.isfinite(scale[own]), scale[own], 0.0)
    inverse = np.linalg.pinv(information, rcond=1e-6, hermitian=True)
    std = np.sqrt(noise * np.maximum(np.diag(inverse), 0.0)) * [each.scale for each in parameters] / scale[own]
    return ScoreTest(
        name,
        min(gain, 1.0),
        values,
        std=float(std.max()) if sizes[0] > TESTING.tiny else np.inf,
        shift=shift,
        added=noise * rate @ inverse @ rate.T,
        excess_gain=max(0.0, 1.0 - chance / (gain * found.total)) if gain > 0.0 else 0.0,
        rate=rate * acting,
        information=information * np.outer(acting, acting) / max(noise, 1e-300),
    )


def determined(information: Array) -> bool:
    """Whether information (k, k) tells each of k numbers from the others: no direction is as small as rounding."""
    size = np.sqrt(np.diag(information))
    if not (np.isfinite(information).all() and size.min(initial=np.inf) > 0.0):
        return False
    return bool(np.linalg.eigvalsh(information / np.outer(size, size))[0] > TESTING.tiny)


def _bounded_step(found: Scores, size: int, own: list[int], slope: Array) -> tuple[Array, Array, float]:
    """Return the shift of x (`size`,), the step (k,) of what was held, and its part of the squares, to first order.

    Neither it nor what is free passes its bound: where little tells resistances apart, what one explains by making
    another negative is noise. slope (k,): score of its own numbers, what is free eliminated.
    """
    from scipy.optimize import lsq_linear

    which, count = [*found.free, *own], len(found.free)
    matrix = found.information.sum(axis=0)[np.ix_(which, which)]
    # Without the identity, rounding would choose the step along directions that the data do not determine
    root = np.linalg.cholesky(matrix + TESTING.tiny * np.eye(len(which)))
    score = np.append(np.zeros(count), slope)
    scale, above = found.scale[which], (found.x - found.plant.parameters.lower)[which]
    room = np.multiply(above, scale, out=np.full(scale.size, np.inf), where=np.isfinite(scale))
    step = lsq_linear(root.T, -np.linalg.solve(root, score), (-np.maximum(room, 0.0), np.inf), method="bvls").x
    shift = np.zeros(size)
    shift[found.free] = step[:count] / scale[:count]
    return shift, step[count:], max(0.0, -float(step @ (2.0 * score + matrix @ step)) / found.total)


def _refitted(basis: Basis, test: ScoreTest) -> ScoreTest:
    """Return a test with what a fit finds, compared with one without it, of the same windows."""
    before, after = basis.refit(), basis.refit(test.name)
    if before is None or after is None:
        return replace(test, gain=0.0, excess_gain=0.0)
    parameters = after.plant.parameters
    x = parameters.rounded(after.fit.x)
    spread = ratio_spread(before.plant.parameters, before.information)
    then, now = ratios(parameters.rope(x)), ratios(before.plant.parameters.rope(before.fit.x))
    # that of a resistance that is held, where the moment is free
    own = next((f"{each.symbol}/p1" for each in RESISTANCES if each.name == base(test.name) and not test.uneven), "")
    stated = spread.get(own, np.zeros(0)) > 0.0
    later, size, std = (
        np.concatenate([each["J/p1"], each["p/p1"], each.get(own, stated)[stated]]) for each in (then, now, spread)
    )
    gain = 1.0 - after.fit.cost / before.fit.cost if before.fit.cost > 0.0 else 0.0
    excess_gain = max(0.0, 1.0 - (1.0 - test.excess_gain) * test.gain / gain) if gain > 0.0 else 0.0
    noise, sure = before.information, before.information.white
    if not sure and (excess_gain > TESTING.sure or gain > TESTING.suspect):  # it may be all that colours the residuals
        mended = (basis.refit(test.name, covariance=True) or after).information
        sure = mended.white
        if sure:  # then what it leaves is the noise
            share = mended.variance * mended.correlation / max(noise.variance * noise.correlation, 1e-300)
            std, excess_gain = std * np.sqrt(share), 1.0 - (1.0 - excess_gain) * min(share, 1.0)
    std = std * widening(noise.freedom)  # of few values little is known
    step = np.abs(later / size - 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):  # what was held has no deviation: inf if it moves
        beyond = np.where(step > TESTING.tiny, np.abs(later - size) / std, 0.0)
    return replace(
        test,
        gain=gain,
        values=parameters.values(x)[before.fit.x.size :],
        moved=float(step.max()),
        beyond=float(beyond.max()),
        excess_gain=excess_gain,
        sure=sure,
    )


def drift_test(basis: Basis, found: Scores | None) -> tuple[ScoreTest, ...]:
    """Return the score test of a gravity that seems to grow with time, as a clock that drifts makes it; or nothing.

    Notes
    -----
    The derivative of the residuals by the drift is that by gravity's scale times the window's place in the recording,
    -1/2 to 1/2; what is free and the mean scale are eliminated. Its standard deviation is that of the windows' scores
    about the trend (cluster-robust), and that of the noise at least. `values` is the change of gravity from the first
    window to the last, `moved` what ratios of inertia move by to either side of the middle; NaN where it may be
    chance and explains little.
    """
    if found is None or CLOCK not in found.groups or len(found.score) < TESTING.windows:
        return ()
    from scipy.special import stdtrit

    (gravity,), count = found.groups[CLOCK], basis.fit.x.size
    place = (found.middle - found.middle.mean()) / np.ptp(found.middle)
    mixed = place[:, None] * found.information[:, gravity]
    inverse = found.inverse([*found.free, gravity])
    along = np.tile(-inverse @ mixed.sum(axis=0), (place.size, 1))
    along[:, gravity] += place
    own = np.einsum("wi,wij,wj->w", along, found.information, along)
    information = float(own.sum())
    if information <= TESTING.tiny * float(mixed[:, gravity] @ place):
        return ()
    each = (found.score * along).sum(axis=1)
    drift = -float(each.sum()) / information
    gain = min(drift**2 * information / found.total, 1.0)
    scatter = float(np.sum((each + own * drift) ** 2)) * place.size / (place.size - 2.0)
    noise = float(np.sqrt(basis.information.variance * (1.0 - gain) / information))
    std, least = float(np.sqrt(scatter)) / information, float(stdtrit(place.size - 2.0, 1.0 - 0.5 * TESTING.rare))
    sure = abs(drift) > max(least * std, TESTING.beyond * noise)
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
    if found is None or len(found.score) < TESTING.windows:
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
