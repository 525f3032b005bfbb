"""Score tests of what a fit has held, and of what was declared of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.declarations.clock import SCALES
from hyperflex.identification.declarations.held import HeldQuantity
from hyperflex.identification.declarations.registry import LAWS, quantity, words_for_tests
from hyperflex.identification.fit import Fit, Window, fit, linearise
from hyperflex.identification.model import Mask, Plant, extended, scale_words
from hyperflex.identification.uncertainty.covariance import Basis, estimate_covariance
from hyperflex.identification.uncertainty.noise import CHANCE
from hyperflex.identification.uncertainty.ratios import ratio_spread, ratios


@dataclass(frozen=True)
class ScoreTestOptions:
    """Thresholds of the score tests, and how far they refit."""

    # part of the sum of squares, to first order, from which a refit is made: less than what is believed
    suspect: float = 0.3
    # the same of a resistance, whose derivative where there is none of it tells less: drag's grows from there
    law: float = 0.15
    # refits at most, rounds of each, and windows, spread over the recording: for time
    refits: int = 3
    rounds: int = 40
    windows: int = 12
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
    # part of the largest eigenvalue of scaled information: about the root of rounding
    tiny: float = 1e-08


TESTING = ScoreTestOptions()
CLOCK = "gravity_scale"  # what a wrong clock, or wrong lengths, move


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """What the data say of something that was held in a fit.

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
        The same in standard deviations that noise gives these ratios, the largest; inf of one that was held.
    std : float
        Greatest standard deviation that they would have.
    shift : (P,) float64
        Change of the fit's x that freeing it makes, to first order.
    added : (P, P) float64
        Covariance of x that freeing it adds.
    rate : (P, k) float64
        Change of the fit's x by each unit of its own x.
    excess_gain : float
        Part of the gain that noise does not explain, 0 to 1; of links the probability that the rope has finer ones.
    sure : bool
        Whether residuals are white, as they are or with it free, so that noise is known.
    ratio_sensitivity : float
        Of centres of mass: relative change of a ratio J/p1 or p/p1 by each 1 % of them, the greatest of those that are
        beyond twice their standard deviation; 0 where none is.
    freed_with : tuple of str
        What had to be free as well before the data asked for this.
    information : (k, k) float64
        Of its own x, in units of the noise's variance.
    declared_std : float
        Of gravity_scale: relative standard deviation by lengths and times as declared; else 0.
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

    @property
    def quantity(self) -> HeldQuantity:
        """What it is about."""
        return quantity(self.name)

    @property
    def law(self) -> bool:
        """Whether it is a resistance that was left out."""
        return self.name.partition(":")[0] in LAWS

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
        return self.quantity.farthest == np.inf or self.size <= np.log(self.quantity.farthest)

    @property
    def slight(self) -> bool:
        """Whether it is no farther off than instruments err."""
        return self.refitted and 0.0 < self.quantity.slight >= self.size

    @property
    def expected(self) -> bool:
        """Whether lengths and times that err as was declared explain it: standard deviations include that."""
        known = self.refitted and self.declared_std > 0.0
        return bool(known and self.size <= TESTING.covered * np.hypot(self.declared_std, self.std))

    @property
    def matters(self) -> bool:
        """Whether ratios would move by more than is negligible and noise may move them, or it is large by itself."""
        if not self.possible or self.slight or self.expected:
            return False
        return self.size > self.quantity.enough or (self.moved > TESTING.moves and self.beyond > TESTING.covered)

    @property
    def covered(self) -> bool:
        """Whether something else seems to fit, and moves ratios, but by no more than noise may."""
        return (
            self.significant and self.possible and not self.slight and self.moved > TESTING.moves and not self.matters
        )

    @property
    def suspected(self) -> bool:
        """Whether what was held or declared may be off: a refit takes much away and moves ratios, not significantly."""
        return self.refitted and not self.law and self.gain > TESTING.suspect and self.matters and not self.significant

    @property
    def masks(self) -> bool:
        """Whether a refit explains so much by what changes no conclusion that it may hide other causes."""
        if self.law:
            return self.refitted and self.gain > TESTING.suspect
        return self.significant and not self.matters and self.name != CLOCK


def score_tests(
    basis: Basis, declared_std: float = 0.0, *, angles: bool = False, budget: Budget | None = None
) -> tuple[ScoreTest, ...]:
    """Test what a fit has held, and `angles` if these were read off a sensor; the greatest gain comes first.

    Lengths and times as declared give gravity a relative standard deviation of `declared_std`.

    Notes
    -----
    Rao's score test, or Lagrange multiplier test (Rao 1948, doi:10.1017/S0305004100023987): with S the derivatives of
    the residuals r by what is free and what is held, less what the windows' states absorb, the score of what is held is
    ``S_h' r``, its information the Schur complement of ``S' S``. In place of a probability the part of the sum of
    squares is told that it explains, for residuals of real recordings are model errors, of which no noise level tells.
    It costs one round of a fit, with more columns. Resistances that would have to be negative explain nothing. Up to
    three that explain much are fitted along, in some of the windows. A resistance that explains much, or anything that
    explains most and changes no ratio, may hide what else is wrong: a fit with it free is tested again.
    """
    budget = budget or Budget()
    found, freed = _refitted_tests(basis, budget, angles=angles), list[str]()
    tests, later, now = found, dict[str, ScoreTest](), basis
    for _ in range(TESTING.hiding):
        hiding = next((each.name for each in tests if each.masks), "")
        richer = fit_with(now, hiding) if hiding else None
        if richer is None:
            break
        now = richer
        freed.append(hiding)
        tests = _refitted_tests(now, budget, angles=angles)
        for each in tests:
            each = within(each, basis.fit.x.size, freed)
            if each.significant and (each.matters or each.slight) and not each.law:
                later.setdefault(each.name, each)
    known = {each.name for each in found if each.significant}
    found = [each if each.name in known else later.pop(each.name, each) for each in found]
    found += [each for name, each in later.items() if name not in known]
    found = [replace(each, declared_std=declared_std) if each.name == CLOCK else each for each in found]
    return tuple(sorted(found, key=lambda each: -each.gain))


def within(test: ScoreTest, size: int, freed: Sequence[str]) -> ScoreTest:
    """Return a test of a fit with more parameters, `freed`, as one of a fit with `size`."""
    test = replace(test, shift=test.shift[:size], added=test.added[:size, :size], rate=test.rate[:size])
    return replace(test, freed_with=tuple(freed))


def _refitted_tests(basis: Basis, budget: Budget, *, angles: bool) -> list[ScoreTest]:
    """Return the tests of a fit, the greatest gain first; those that explain much with what a refit says."""
    found = [each for words in words_for_tests(basis.plant, angles=angles) for each in _tested(basis, words)]
    found += _tested(basis, list(scale_words(basis.plant).values()), SCALES)
    found.sort(key=lambda each: -each.gain)
    others = [k for k, each in enumerate(found) if each.name != SCALES]
    slips = [k for k in others[TESTING.refits :] if found[k].quantity.enough < np.inf]  # that are easily mended
    laws = [k for k in others[TESTING.refits :] if found[k].law][:1]
    for k in [*others[: TESTING.refits], *slips, *laws]:
        each = found[k]
        if each.gain > (TESTING.law if each.law else TESTING.suspect) or each.excess_gain > TESTING.sure:
            budget.check()
            found[k] = _refitted(basis, each)
    return sorted(found, key=lambda each: -each.gain)


def _tested(basis: Basis, words: Sequence[str], together: str = "") -> list[ScoreTest]:
    """Return the tests of these words, or one of all, by the name `together`."""
    plant, x, groups = extended(basis.plant, basis.fit.x, words)
    groups = [[each for group in groups for each in group]] if together and groups else groups
    size, total = x.size, 0.0
    matrix, score = np.zeros((size, size)), np.zeros(size)
    for window, state, residual in zip(basis.windows, basis.fit.states, basis.fit.residuals, strict=True):
        slopes, left = linearise(plant, window, x, state, residual, basis.fit.loss).reduced()
        matrix += slopes.T @ slopes
        score += slopes.T @ left
        total += float(left @ left)
    if not (np.isfinite(matrix).all() and total > 0.0):
        return []
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0.0] = np.inf
    matrix, score = matrix / np.outer(scale, scale), score / scale
    free = [k for k in range(basis.fit.x.size) if x[k] > plant.parameters.lower[k]]
    inner = np.linalg.pinv(matrix[np.ix_(free, free)], rcond=TESTING.tiny, hermitian=True)
    tests, first = [], basis.fit.x.size
    for word, group in zip((each[0].name for each in groups), groups, strict=True):
        own = list(range(first, first + len(group)))
        first += len(group)
        across = matrix[np.ix_(own, free)] @ inner
        information = matrix[np.ix_(own, own)] - across @ matrix[np.ix_(free, own)]
        step = _possible_step(information, score[own] - across @ score[free], x[own] <= plant.parameters.lower[own])
        gain = -float(step @ (score[own] - across @ score[free])) / total
        moved = x[own] + step / scale[own]
        shift = np.zeros(basis.fit.x.size)
        shift[free] = -across.T @ step / scale[free]
        shift = np.maximum(shift, plant.parameters.lower[: shift.size] - basis.fit.x)  # no resistance gets negative
        noise = basis.information.variance * basis.information.correlation
        chance = noise * max(1, int(np.count_nonzero(step)))
        excess_gain = max(0.0, 1.0 - chance / (gain * total)) if gain * total > 0.0 else 0.0
        added = np.zeros((basis.fit.x.size,) * 2)
        inverse = np.linalg.pinv(information, rcond=1e-6, hermitian=True)
        added[np.ix_(free, free)] = noise * across.T @ inverse @ across / np.outer(scale[free], scale[free])
        label = group[0].label if group[0].law != "own" or len(group[0].links) > 1 else word
        with np.errstate(over="ignore"):
            values = [parameter.value(each) for parameter, each in zip(group, moved, strict=True)]
        rate = np.zeros((basis.fit.x.size, len(own)))
        acting = np.where(np.isfinite(scale[own]), scale[own], 0.0)
        rate[free] = -across.T / scale[free, None] * acting
        each = ScoreTest(
            together or label,
            min(gain, 1.0),
            np.array(values),
            std=_std(information, noise, [p.scale for p in group] / scale[own]),
            shift=shift,
            added=added,
            excess_gain=excess_gain,
            rate=rate,
            information=information * np.outer(acting, acting) / max(noise, 1e-300),
        )
        tests.append(each)
    return tests


def _std(information: Array, noise: float, scale: Array) -> float:
    """Return the greatest standard deviation of values with an information matrix (k, k); inf where one has none."""
    size, directions = np.linalg.eigh(information)
    if size[0] <= TESTING.tiny:
        return np.inf
    return float(np.sqrt(np.max(noise * (directions**2 / size).sum(axis=1) * scale**2)))


def _possible_step(information: Array, score: Array, bounded: Mask) -> Array:
    """Return the step (k,) that the score asks for, 0 of what is at its bound and would pass it."""
    active, step = np.ones(score.size, dtype=bool), np.zeros(score.size)
    for _ in range(score.size):
        inner = np.linalg.pinv(information[np.ix_(active, active)], rcond=1e-6, hermitian=True)
        step[:] = 0.0
        step[active] = -inner @ score[active]
        passing = active & bounded & (step < 0.0)
        if not passing.any():
            break
        active &= ~passing
    return step


def fit_with(basis: Basis, name: str) -> Basis | None:
    """Return a fit of some windows with `name` free as well, and its covariance; None where none converges."""
    plant, x, _ = extended(basis.plant, basis.fit.x, [name])
    windows, states, _ = some_windows(basis)
    found = _fit(plant, windows, x, states, basis)
    return None if found is None else Basis(plant, windows, found, estimate_covariance(plant, windows, found))


def some_windows(basis: Basis) -> tuple[list[Window], list[Array], list[Array]]:
    """Return windows spread over the recording, their states, and their residuals."""
    every = -(-len(basis.windows) // TESTING.windows)
    return basis.windows[::every], basis.fit.states[::every], basis.fit.residuals[::every]


def _fit(plant: Plant, windows: list[Window], x: Array, states: list[Array], basis: Basis) -> Fit | None:
    try:
        return fit(plant, windows, x, states, loss=basis.fit.loss, rounds=TESTING.rounds)
    except InvalidInput:
        return None


def _refitted(basis: Basis, test: ScoreTest) -> ScoreTest:
    """Return a test with what a fit of some windows says."""
    plant, x, _ = extended(basis.plant, basis.fit.x, [test.name])
    windows, states, _ = some_windows(basis)
    before, after = _fit(basis.plant, windows, basis.fit.x, states, basis), _fit(plant, windows, x, states, basis)
    if before is None or after is None:
        return replace(test, gain=0.0, excess_gain=0.0)
    x = plant.parameters.rounded(after.x)
    names, spread = ("J/p1", "p/p1"), ratio_spread(basis.plant.parameters, basis.information)
    then, now = ratios(plant.parameters.rope(x)), ratios(basis.plant.parameters.rope(before.x))
    later, size, std = (np.concatenate([each[name] for name in names]) for each in (then, now, spread))
    step = np.abs(later / size - 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):  # what was held has no deviation: inf if it moves
        beyond = np.where(step > TESTING.tiny, np.abs(later - size) / std, 0.0)
    gain = 1.0 - after.cost / before.cost if before.cost > 0.0 else 0.0
    excess_gain = max(0.0, 1.0 - (1.0 - test.excess_gain) * test.gain / gain) if gain > 0.0 else 0.0
    values = plant.parameters.values(x)[basis.fit.x.size :]
    sure = basis.information.whiteness >= CHANCE
    if not sure and excess_gain > TESTING.sure:  # what is held may be all that colours the residuals
        sure = estimate_covariance(plant, windows, after).whiteness >= CHANCE
    moved, far = float(step.max()), float(beyond.max())
    return replace(test, gain=gain, values=values, moved=moved, beyond=far, excess_gain=excess_gain, sure=sure)
