"""What a model leaves out, as an error of its parameters."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.held import CLOCK, DRIFT, LAWS, LINKS, QUANTITIES, SCALES, base
from hyperflex.identification.declarations.score_tests import TESTING, ScoreTest
from hyperflex.identification.model import scale_words
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.model import PROPERTIES

SHOWN = 0.67  # part of a gain, 1 - 1 / chi^2: chi^2 = 3, one in 25 right fits of a law, which cannot be negative
# standard deviations of a moment or inertia: what moves it, or leaves it less known, by more acts nearly as it does,
# and would leave nothing known by a size that chance can give it; so it counts only if it is sure. A spring acts so,
# and a string's inertia.
OVERWHELMING = 10.0
CLOCK_POWER = {"N m s/rad": -0.5, "N m": -1.0, "N m/rad": -1.0}  # of gravity's factor, in resistances: by their unit
LARGEST = 3.0  # logarithm of a factor, as far as it counts: 20 times; to first order it may be any number


def with_model_error(basis: Basis, tests: Sequence[ScoreTest], scale_std: Array, scatter: Array | None = None) -> Basis:
    """Return a fit whose information counts errors of the model and of what was declared, in addition to noise.

    Links that are too long, and each omitted resistance that the data show, would move the parameters by their `shift`,
    and leave them less known: that is taken as a standard deviation, in proportion to the part of the gain that noise
    does not explain. Where residuals are white, or the gain is large, all other quantities that were fixed or declared
    count as well; where residuals are not white, resistances count the size of :func:`law_error` at least. All lengths
    of links may be off by one factor, the arm's by another, all times and all torques as well, see
    :func:`_scale_error`. `scatter` (P, P) is the covariance that disagreeing windows show.
    """
    information, x = basis.information, basis.fit.x
    model, white = np.zeros((x.size, x.size)), information.white
    counted = False
    resists = np.array([each.name in LAWS for each in basis.plant.parameters.all])
    known = np.where(resists, np.inf, np.diag(information.covariance))
    for each in tests:
        if each.name == SCALES or (each.uneven and not each.significant):
            continue
        own = each.law or each.name == DRIFT  # which has a separate std
        shown = white or own or each.significant or each.suspected
        counts = shown and each.excess_gain > SHOWN and not (each.slight and each.freed_with)
        error = _error(each, basis)
        if each.std == np.inf or (np.diag(error) > OVERWHELMING**2 * known).any():
            counts = counts and each.excess_gain > TESTING.sure
        if counts or each.name == LINKS:  # whose excess_gain is a probability
            model += each.excess_gain * error
            counted = counted or each.name == CLOCK
    if not white:
        model += np.diag(np.maximum(_law_errors(basis, tests)[0] ** 2 - np.diag(model), 0.0))
    if scatter is not None:
        model += scatter
    gravity = next((float(each.values[0]) for each in tests if each.name == CLOCK), 1.0)
    driven = basis.plant.driven
    believed = driven or white or abs(np.log(max(gravity, 1e-9))) > QUANTITIES[CLOCK].slight
    observed = driven or (not counted and believed)
    scaled = _scale_error(basis, tests, scale_std, believed=believed, observed=observed)
    return replace(basis, information=replace(information, model=model, scaled=scaled))


def with_prediction_error(basis: Basis, factor: float) -> Basis:
    """Return a fit whose standard deviations are `factor` times as large, as predictions have shown that they are."""
    information = basis.information
    more = (factor**2 - 1.0) * information.total
    return replace(basis, information=replace(information, model=information.model + more))


def _damps(name: str) -> bool:
    """Whether a property is a resistance that takes energy."""
    return name in LAWS and PROPERTIES[name].unit != "N m/rad"


def _error(test: ScoreTest, basis: Basis) -> Array:
    """Return the covariance (P, P) of x by what a test has held: its shift, and what a law leaves less known.

    A law that takes energy leaves the others less to take: no more of a resistance is in doubt than it is, or moves by.
    """
    shift = _shift(test, basis)
    error: Array = np.outer(shift, shift) + (test.added if test.law else 0.0)
    if not _damps(base(test.name)):
        return error
    std = np.sqrt(np.maximum(np.diag(error), 0.0))
    damped = np.array([_damps(each.name) for each in basis.plant.parameters.all])
    most = np.where(damped, np.maximum(np.abs(shift), basis.fit.x - basis.plant.parameters.lower), np.inf)
    part = np.divide(most, std, out=np.ones(std.size), where=std > most)
    return np.asarray(error * np.outer(part, part))


def _shift(test: ScoreTest, basis: Basis) -> Array:
    """Return the `shift` of a test; of what is one value of all links as far as the farthest link's is off.

    A resistance that differs along the rope changes what is alike in the fit, and each link's own in addition.
    """
    parameters, x, shift = basis.plant.parameters, basis.fit.x, test.shift
    if not test.uneven or not shift.size:
        return shift
    law = test.name.partition(":")[2]
    size = np.log(max(float(test.values[0]), 1e-9)) if law == "pivot" else float(test.values[0])
    steps, shift = np.clip(size, -LARGEST, LARGEST) * parameters.shape(law), shift.copy()
    for k, each in enumerate(parameters.all):
        if each.name == base(test.name) and each.law in ("own", "factor") and len(each.links) == steps.size:
            moved = x[k] + shift[k]
            off = moved + steps - x[k] if each.form == "log" else moved * np.exp(steps) - x[k]
            shift[k] = off[np.argmax(np.abs(off))]
    return shift


def _scale_error(basis: Basis, tests: Sequence[ScoreTest], std: Array, *, believed: bool, observed: bool) -> Array:
    """Return the covariance (P + 1, P + 1) of x and a length factor's logarithm by errors of the factors of SCALES.

    The prior deviations are `std` (4,), of gravity twice that of a clock. A clock also changes frictions and torques by
    its own factor. The data determine some combinations, as a rule: the posterior covariance keeps the width of
    `std` where they determine nothing. It is about what was declared: what the data show counts as an error if
    `observed`, of one of the factors, since a mistake is of one. Not where gravity counts already; nor, where residuals
    of a free swing are not white, within what a ruler errs, since an omitted law looks the same: then the data are not
    `believed`, and tell the factors no better than these seem off (Birge's ratio). A drive has its own lengths and
    times, by which the data determine those of the rope.
    """
    parameters, x = basis.plant.parameters, basis.fit.x
    rate, known, step = np.zeros((x.size, std.size)), np.zeros((std.size, std.size)), np.zeros(std.size)
    for each in tests:
        if each.name == SCALES:
            which = list(scale_words(basis.plant))[: each.rate.shape[1]]
            rate[:, which], known[np.ix_(which, which)] = each.rate, each.information
            step[which] = np.log(np.clip(each.values, 1e-9, 1e9))  # what is not determined may be any number
    for k, free in enumerate(parameters.all):
        power = (
            CLOCK_POWER.get(free.kind.unit, 0.0) if free.name in LAWS and free.law not in ("taper", "pivot") else 0.0
        )
        rate[k, 1] += power * free.value(float(x[k])) / free.derivative(float(x[k]))
    rate[:, 1] += rate[:, 3]  # where times are multiplied by a, gravity is by 1 / a^2, and so torque over its reading
    std = np.where(rate.any(axis=0), std, 0.0)
    prior = np.diag(std**2)
    if not believed:
        known /= max(1.0, float(step @ known @ step))
    error = np.linalg.solve(np.eye(std.size) + prior @ known, prior)
    moved = error @ known @ step
    share = std**2 / max(float(std @ std), 1e-300)  # of the one cause, the probability
    causes = np.diag(moved**2 / np.where(share > 0.0, share, np.inf))
    acting = np.vstack([rate, np.eye(std.size)[:1]])
    return np.asarray(acting @ (0.5 * (error + error.T) + observed * causes) @ acting.T)


def law_error(basis: Basis, tests: Sequence[ScoreTest]) -> tuple[float, str, bool]:
    """Return by what part of its value a free resistance may change if another one is free too, and that one's name.

    And whether its standard deviation includes that. (0, "", True) where no resistance is free or none was tested. Of
    white residuals the other one takes energy as well: a spring in the noise says nothing.
    """
    white = basis.information.white
    sizes, names = _law_errors(basis, [each for each in tests if _damps(base(each.name)) or not white])
    parts = sizes / np.where(sizes > 0.0, basis.fit.x, 1.0)
    worst = int(np.argmax(parts))
    model = np.diag(basis.information.total - basis.information.covariance)
    return float(parts[worst]), names[worst], bool(model[worst] >= SHOWN * sizes[worst] ** 2)


def _law_errors(basis: Basis, tests: Sequence[ScoreTest]) -> tuple[Array, list[str]]:
    """Return by how much free resistances, of x (P,), may change if another one is free too, and which one it is.

    The size of the shift, with the standard deviation that comes on top since both act alike. One that
    differs along the rope counts only if that is believed: what little is known of it would leave nothing known.
    """
    parameters, x = basis.plant.parameters, basis.fit.x
    own = np.array([_damps(p.name) for p in parameters.all]) & (x > parameters.lower)
    sizes, names = np.zeros(x.size), [""] * x.size
    for each in tests:
        if each.law and each.shift.size and (each.significant or not each.uneven):
            size = np.sqrt(np.maximum(np.diag(_error(each, basis)), 0.0)) * own
            names = [each.name if more else name for more, name in zip(size > sizes, names, strict=True)]
            sizes = np.maximum(sizes, size)
    return sizes, names
