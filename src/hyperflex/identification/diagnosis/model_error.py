"""What a model leaves out, as an error of its parameters."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.diagnosis.link_test import LINKS
from hyperflex.identification.diagnosis.misdeclared import UNTESTED
from hyperflex.identification.diagnosis.score_tests import LAWS, LENGTHS, SLIGHT, ScoreTest
from hyperflex.identification.diagnosis.window_tests import DRIFT
from hyperflex.identification.model.parameters import Parameters, lumped
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.identification.uncertainty.whiteness import CHANCE

ASKED = 0.67  # part of a gain, 1 - 1 / chi^2: chi^2 = 3, one in 25 right fits of a law, which cannot be negative
CLOCK = 0.01  # standard deviation of gravity's factor, of a clock 0.5 % off; parts of IBM 06 and 16 fit to 1.00 +- 0.01
FLOOR = 5e-4  # relative, of a value: no clock, length or weight is known better; 6e-4 was seen of a good pendulum


def with_model_error(
    basis: Basis, tests: Sequence[ScoreTest], length_std: float, scatter: Array | None = None
) -> Basis:
    """Return a fit whose information counts what the model leaves out, and errors of lengths, beside noise.

    Links that are too long, and each resistance that was left out and that the data ask for, would move the parameters
    by their `shift`: that is taken as a standard deviation, in proportion to how far noise does not explain what it
    gains. Where residuals are white, or much goes away, everything else that was held or declared counts as well; where
    they are not, a clock that is off counts as far as the recording cannot exclude it (:func:`_clock_error`), and no
    value is taken as known better than FLOOR. All lengths may be off by one factor, of the relative standard deviation
    `length_std`, as far as the motion does not tell it. `scatter` (P, P) is what windows that disagree show.
    """
    information, x = basis.information, basis.fit.x
    model, white = np.zeros((x.size, x.size)), information.whiteness >= CHANCE
    clock = False
    for each in tests:
        if each.name == LENGTHS:
            continue
        law = each.name.partition(":")[0] in LAWS
        asked = white or law or each.believed or each.suspected or each.name == DRIFT  # which has a std of its own
        counts = asked and each.excess_gain > ASKED and not (each.slight and each.freed_with)
        if counts or each.name == LINKS:  # whose excess_gain is a probability
            model += each.excess_gain * np.outer(each.shift, each.shift)
            clock = clock or each.name == "gravity_scale"
        elif each.name == "gravity_scale" and not white:
            model += _clock_error(each) ** 2 * np.outer(each.rate[:, 0], each.rate[:, 0])
    if not white:
        model += np.diag(_floor(basis.plant.parameters, x) ** 2)
    if scatter is not None:
        model += scatter
    lengths = next((each for each in tests if each.name == LENGTHS), None)
    length_error = 0.0 if lengths is None else _length_error(lengths, length_std, told=white and not clock)
    by_length = np.zeros(x.size) if lengths is None else length_error * lengths.rate[:, 0]
    return replace(basis, information=replace(information, model=model, lengths=by_length, length_error=length_error))


def _clock_error(test: ScoreTest) -> float:
    """Return how far gravity's scale may be off unseen, where residuals are not white: its root mean square.

    Known before to CLOCK, and told by the data to `test.std`; what they say of it counts beyond SLIGHT, for a law that
    was left out makes it seem off by so much. 0 where the motion does not test it: then the grade says that times and
    lengths are taken as declared.
    """
    factor = float(test.values[0])
    if test.std > UNTESTED or factor <= 0.0:
        return 0.0
    weight = CLOCK**2 / (CLOCK**2 + test.std**2)
    told = abs(np.log(factor)) > SLIGHT
    return float(np.hypot(np.sqrt(weight) * test.std, weight * np.log(factor) * told))


def _length_error(test: ScoreTest, std: float, *, told: bool) -> float:
    """Return the standard deviation of a factor of all lengths, known before to `std`, that the data leave.

    About the lengths as they were declared: what the data say of them, weighted with `std`, counts as an error if
    `told`. Not where residuals are not white, for that is not the lengths' alone, nor where gravity's scale counts,
    which tells the same.
    """
    factor = float(test.values[0])
    if not (np.isfinite(test.std) and 0.0 < factor < np.inf):
        return std
    weight = std**2 / max(std**2 + test.std**2, 1e-300)
    return float(np.hypot(np.sqrt(weight) * test.std, weight * np.log(factor) * told))


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

    The size of the shift, with the standard deviation that comes on top since both are hard to tell apart. (0, "")
    where residuals are white, no resistance is free or none was tested.
    """
    parameters, information = basis.plant.parameters, basis.information
    own = [k for k, each in enumerate(parameters.all) if each.name in LAWS and basis.fit.x[k] > parameters.lower[k]]
    own = [k for k in own if parameters.all[k].kind.unit != "N m/rad"]
    if not own or information.whiteness >= CHANCE:
        return 0.0, ""
    x = basis.fit.x[own]
    parts = [
        (float(np.max(np.hypot(each.shift, each.std_added)[own] / x)), each.name)
        for each in tests
        if each.name.partition(":")[0] in LAWS and each.shift.size
    ]
    return max(parts, default=(0.0, ""))
