"""Resistances that are fitted as alike along the rope, and differ."""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.diagnosis.score_tests import ScoreTest
from hyperflex.identification.model.parameters import Parameters
from hyperflex.model import DAMPING

LARGEST = 3.0  # logarithm of a factor, as far as it counts: 20 times; to first order it may be any number


def is_uneven(test: ScoreTest) -> bool:
    """Whether it is of the growth of a resistance along the rope, or of the first joint's own."""
    name, _, law = test.name.partition(":")
    return law in ("taper", "pivot") and name in DAMPING


def uneven_shift(test: ScoreTest, parameters: Parameters, x: Array) -> Array:
    """Return the `shift` of a test at x (P,); of what is one value of all links as far as the farthest link's is off.

    A resistance that differs along the rope changes what is alike in the fit, and each link's own on top.
    """
    if not is_uneven(test) or not test.shift.size:
        return test.shift
    name, _, law = test.name.partition(":")
    value = float(test.values[0])
    size = np.log(max(value, 1e-9)) if law == "pivot" else value
    steps = np.clip(size, -LARGEST, LARGEST) * parameters.shape("pivot" if law == "pivot" else "taper")
    shift = test.shift.copy()
    for k, each in enumerate(parameters.all):
        if each.name == name and each.law in ("own", "factor") and len(each.links) == steps.size:
            moved = x[k] + shift[k]
            off = moved + steps - x[k] if each.form == "log" else moved * np.exp(steps) - x[k]
            shift[k] = off[np.argmax(np.abs(off))]
    return shift


def uneven(tests: Sequence[ScoreTest], told: ScoreTest | None = None) -> list[str]:
    """Return of which resistances that differ along the rope the data are sure, in words; not of what is `told`."""
    found = [each for each in tests if is_uneven(each) and each.believed and not each.matters and each is not told]
    return [f"{uneven_words(each)} Standard deviations hold that." for each in found[:1]]


def uneven_words(test: ScoreTest) -> str:
    """Return how a resistance differs, in words, and what to do; nothing of other tests."""
    if not is_uneven(test):
        return ""
    name, _, law = test.name.partition(":")
    value, words = float(test.values[0]), name.replace("_", " ")
    part = f"{100.0 * test.gain:.3g} % of the residuals' sum of squares go away"
    if law == "pivot":
        return (
            f"{words} of the first joint is not that of the others: {part} if it is {value:.2g} times theirs. Put "
            f"'{name}[0]' and '{name}:inner' into free."
        )
    return (
        f"{words} differs along the rope: {part} if it is {np.exp(value):.2g} times as large at the tip as at the "
        f"first joint. Put '{name}:factor' and '{name}:taper' into free."
    )
