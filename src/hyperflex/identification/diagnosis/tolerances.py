"""What 1 % of a centre of mass moves, and whether a longer and slower rope moves alike: what no motion can test."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyperflex.identification.diagnosis.score_tests import ScoreTest
from hyperflex.identification.model.plant import Plant
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.identification.uncertainty.ratios import ratio_gradients, ratio_spread, ratios
from hyperflex.model import RESISTANCES

PER_CENT = 0.01  # relative: the change that people think in


def moves_alike(plant: Plant) -> bool:
    """Tell whether a longer and slower rope moves exactly alike: nothing but gravity and the lengths has a scale.

    With times x a and lengths x a^2 gravity stays. A drive, a torque, and inertias or resistances that are held do not
    go along.
    """
    if plant.motion is not None or plant.motor is not None or not plant.parameters.guess.gravity.any():
        return False
    names = {each.name for each in plant.parameters.all}
    held = [each.name for each in RESISTANCES if each.name not in names]
    return "inertia" in names and not any(getattr(plant.parameters.guess, name).any() for name in held)


def with_ratio_sensitivity(basis: Basis, tests: Sequence[ScoreTest]) -> tuple[ScoreTest, ...]:
    """Return the tests, that of com with what 1 % moves beyond standard deviations that count the model's errors."""
    return tuple(
        replace(each, ratio_sensitivity=_ratio_sensitivity(basis, each))
        if each.name == "com" and not each.freed_with
        else each
        for each in tests
    )


def _ratio_sensitivity(basis: Basis, test: ScoreTest) -> float:
    """Return by what part 1 % of what was held moves a ratio that is said to be known better; 0 for none."""
    parameters, information = basis.plant.parameters, basis.information
    gradients, known = ratio_gradients(parameters, information.x), ratios(parameters.rope(information.x))
    stds, worst = ratio_spread(parameters, information), 0.0
    for name in ("J/p1", "p/p1"):
        moved = np.max(np.abs(gradients[name] @ (test.rate * np.abs(test.values))), axis=1) * PER_CENT
        std = stds[name]
        beyond = (moved > 2.0 * std) & (std > 0.0)
        worst = max(worst, float(np.max(moved / np.abs(known[name]), where=beyond, initial=0.0)))
    return worst
