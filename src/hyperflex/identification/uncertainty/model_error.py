"""What a model leaves out, as an error of its parameters."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.clock import CLOCK, DRIFT, SCALES
from hyperflex.identification.declarations.link_test import LINKS
from hyperflex.identification.declarations.registry import LAWS
from hyperflex.identification.declarations.resistances import is_uneven, uneven_shift
from hyperflex.identification.declarations.score_tests import ScoreTest
from hyperflex.identification.model import Parameters, lumped, scale_words
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.identification.uncertainty.noise import CHANCE

ASKED = 0.67  # part of a gain, 1 - 1 / chi^2: chi^2 = 3, one in 25 right fits of a law, which cannot be negative
CLOCK_POWER = {"N m s/rad": -0.5, "N m": -1.0, "N m/rad": -1.0}  # of gravity's factor, in resistances: by their unit
FLOOR = 5e-4  # relative, of a value: no clock, length or weight is known better; 6e-4 was seen of a good pendulum


def with_model_error(basis: Basis, tests: Sequence[ScoreTest], scale_std: Array, scatter: Array | None = None) -> Basis:
    """Return a fit whose information counts what the model leaves out, and what was declared, beside noise.

    Links that are too long, and each resistance that was left out and that the data ask for, would move the parameters
    by their `shift`, and leave them less known: that is taken as a standard deviation, in proportion to how far noise
    does not explain what it gains. Where residuals are white, or much goes away, everything else that was held or
    declared counts as well; where they are not, resistances count the size of :func:`law_error` at least, and no value
    is taken as known better than FLOOR. All lengths of links may be off by one factor, the arm's by another, all times
    and all torques as well, see :func:`_scale_error`. `scatter` (P, P) is what windows that disagree show.
    """
    information, x = basis.information, basis.fit.x
    model, white = np.zeros((x.size, x.size)), information.whiteness >= CHANCE
    counted = False
    for each in tests:
        if each.name == SCALES or (is_uneven(each.name) and not each.significant):
            continue
        asked = (
            white or each.law or each.significant or each.suspected or each.name == DRIFT
        )  # which has a std of its own
        counts = asked and each.excess_gain > ASKED and not (each.slight and each.freed_with)
        if counts or each.name == LINKS:  # whose excess_gain is a probability
            shift = uneven_shift(each.name, each.values, each.shift, basis.plant.parameters, x)
            model += each.excess_gain * (np.outer(shift, shift) + (each.added if each.law else 0.0))
            counted = counted or each.name == "gravity_scale"
    if not white:
        model += np.diag(np.maximum(_law_errors(basis, tests)[0] ** 2 - np.diag(model), 0.0))
        model += np.diag(_floor(basis.plant.parameters, x) ** 2)
    if scatter is not None:
        model += scatter
    gravity = next((float(each.values[0]) for each in tests if each.name == "gravity_scale"), 1.0)
    driven = basis.plant.motion is not None
    told = driven or (not counted and (white or abs(np.log(max(gravity, 1e-9))) > CLOCK.slight))
    scales, error = _scale_error(basis, tests, scale_std, told=told)
    return replace(basis, information=replace(information, model=model, scales=scales, scale_error=error))


def _scale_error(basis: Basis, tests: Sequence[ScoreTest], std: Array, *, told: bool) -> tuple[Array, Array]:
    """Return how x (P, 4) goes with the logarithms of the factors of SCALES, and the covariance (4, 4) of these.

    Known before to `std` (4,), of gravity twice that of a clock. A clock changes frictions, and torques, by its own
    factor besides. What the data tell are some combinations, as a rule: the posterior covariance keeps the width of
    `std` where they tell nothing. It is about what was declared: what the data say counts as an error if `told`, of
    one of them, for a slip is of one. Not where gravity counts already; nor, where residuals of a free swing are not
    white, within what a ruler errs, for a law that was left out makes it seem so. A drive has its own
    lengths and times, by which the data determine those of the rope.
    """
    parameters, x = basis.plant.parameters, basis.fit.x
    rate, known, step = np.zeros((x.size, std.size)), np.zeros((std.size, std.size)), np.zeros(std.size)
    for each in tests:
        if each.name == SCALES:
            which = list(scale_words(basis.plant))[: each.rate.shape[1]]
            rate[:, which], known[np.ix_(which, which)] = each.rate, each.information
            step[which] = np.log(np.clip(each.values, 1e-9, 1e9))  # of what is not told it is any number
    if not rate.any():
        return rate, known
    for k, free in enumerate(parameters.all):
        power = (
            CLOCK_POWER.get(free.kind.unit, 0.0) if free.name in LAWS and free.law not in ("taper", "pivot") else 0.0
        )
        rate[k, 1] += power * free.value(float(x[k])) / free.derivative(float(x[k]))
    rate[:, 1] -= rate[:, 3]  # where times are multiplied by a, gravity is by 1 / a^2, torque by a^2
    std = np.where(rate.any(axis=0), std, 0.0)
    prior = np.diag(std**2)
    error = np.linalg.solve(np.eye(std.size) + prior @ known, prior)
    moved = error @ known @ step
    share = std**2 / max(float(std @ std), 1e-300)  # of the one cause, the probability
    causes = np.diag(moved**2 / np.where(share > 0.0, share, np.inf))
    return rate, 0.5 * (error + error.T) + told * causes


def _floor(parameters: Parameters, x: Array) -> Array:
    """Return the changes of x (P,) that move moments, masses or lengths by the part FLOOR."""
    rope = parameters.rope(x)
    moments, inertia = lumped(rope)
    places = np.abs(moments) / np.where(rope.mass > 0.0, rope.mass, np.inf)
    sizes = {"inertia": inertia, "com": places, "mass": rope.mass, "length": rope.length}
    moved = np.zeros(x.size)
    for k, each in enumerate(parameters.all):
        if each.name in sizes and each.law == "own":
            moved[k] = FLOOR * sizes[each.name][list(each.links)].mean() / each.derivative(float(x[k]))
    return moved


def law_error(basis: Basis, tests: Sequence[ScoreTest]) -> tuple[float, str]:
    """Return by what part of its value a free resistance may change if another one is free too, and that one's name.

    (0, "") where residuals are white, no resistance is free or none was tested.
    """
    if basis.information.whiteness >= CHANCE:
        return 0.0, ""
    sizes, names = _law_errors(basis, tests)
    parts = sizes / np.where(sizes > 0.0, basis.fit.x, 1.0)
    worst = int(np.argmax(parts))
    return float(parts[worst]), names[worst]


def _law_errors(basis: Basis, tests: Sequence[ScoreTest]) -> tuple[Array, list[str]]:
    """Return by how much free resistances, of x (P,), may change if another one is free too, and which one it is.

    The size of the shift, with the standard deviation that comes on top since both are hard to tell apart. One that
    differs along the rope counts only if that is believed: what little is known of it would leave nothing known.
    """
    parameters, x = basis.plant.parameters, basis.fit.x
    own = np.array([p.name in LAWS and p.kind.unit != "N m/rad" for p in parameters.all]) & (x > parameters.lower)
    sizes, names = np.zeros(x.size), [""] * x.size
    for each in tests:
        if each.law and each.shift.size and (each.significant or not is_uneven(each.name)):
            shift = uneven_shift(each.name, each.values, each.shift, parameters, x)
            size = np.sqrt(shift**2 + np.maximum(np.diag(each.added), 0.0)) * own
            names = [each.name if more else name for more, name in zip(size > sizes, names, strict=True)]
            sizes = np.maximum(sizes, size)
    return sizes, names
