"""Choice of free parameters by what a recording tells, where the user names none."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperflex.identification.declarations.clock import DRIFT
from hyperflex.identification.declarations.held import FEW_LINKS
from hyperflex.identification.declarations.registry import LAWS
from hyperflex.identification.declarations.resistances import is_uneven
from hyperflex.identification.declarations.score_tests import TESTING, ScoreTest
from hyperflex.identification.declarations.window_tests import Scatter, WindowScores
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.model.plant import ANGLES
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.interruption import stoppable
from hyperflex.model import Rope

MOST = 3  # parameters that are added at most: each costs a fit
# Of what was held, what a user is likely not to know: the likeliest first
ALLOWED = ("com", "gravity_angle", "delay", *LAWS)


def first_choice(guess: Rope) -> list[str]:
    """Return what is free at first: inertia and friction; of a rope of many links one value each, of stiffness if any.

    A rope of many links that are not alike in the guess keeps its taper: what is free is a factor on all.
    """
    if guess.n_links <= FEW_LINKS:
        return ["inertia", "friction"]
    words = ["friction", "stiffness"] if guess.stiffness.any() else ["inertia", "friction"]
    return [f"{word}:{'shared' if np.ptp(getattr(guess, word)) == 0.0 else 'factor'}" for word in words]


@dataclass
class Trial:
    """A fit with what was free in it: of noise alone (`plain`), and with all that its deviations count.

    Then the settings that it used, its score tests, and how its windows agree.
    """

    free: list[str]
    plain: Basis
    basis: Basis
    settings: dict[str, Any]
    tests: tuple[ScoreTest, ...] = ()
    scores: WindowScores | None = None
    scatter: tuple[Scatter, ...] = ()


def choose_parameters(fit: Callable[[Sequence[str]], Trial], guess: Rope) -> tuple[Trial, list[Finding]]:
    """Return the fit with parameters chosen one by one, and the choice as a finding.

    `fit` gets what is free. What the score tests of a fit require is freed as well, as long as that makes a fit that
    converges: of what explains the same, to EQUAL, the first of ALLOWED. An interrupted fit is the last.
    """
    trial, added = fit(first_choice(guess)), list[str]()
    usual = trial.free
    for _ in range(MOST):
        mistakes = [each.gain for each in trial.tests if each.significant and each.name in (DRIFT, ANGLES)]
        least = max(mistakes, default=0.0) + TESTING.equal
        required = [each for each in trial.tests if _required(each, trial.free, guess) and each.gain > least]
        if not required or not trial.basis.fit.converged or trial.basis.fit.status is not None:
            break
        equals = [each for each in required if each.gain > required[0].gain - TESTING.equal]
        chosen = min(equals, key=lambda each: ALLOWED.index(each.name.partition(":")[0]))
        richer: Trial | None = None
        with stoppable() as stop:
            richer = fit(_with_word(trial.free, chosen.name))
        status = stop.status if richer is None else richer.basis.fit.status
        if richer is None or status is not None:
            trial.basis.fit.status = status  # what has converged and was tested is worth more
            break
        if not richer.basis.fit.converged:
            break
        trial = richer
        added.append(f"{chosen.name} ({100.0 * chosen.gain:.3g} % of the residuals' squares)")
    return trial, [Finding(Kind.CHOSEN, Severity.NOTE, {"usual": usual, "added": added})]


def _required(test: ScoreTest, free: Sequence[str], guess: Rope) -> bool:
    name = test.name.partition(":")[0]
    if is_uneven(test.name) and not (f"{name}:shared" in free and np.all(getattr(guess, name) > 0.0)):
        return False  # of a factor on a guess that is not alike, or on nothing
    return test.significant and name in ALLOWED and not test.freed_with and (name != "com" or test.matters)


def _with_word(free: Sequence[str], word: str) -> list[str]:
    """Return `free` with a word more; what was one value of all gives way to what it is made of then."""
    name, _, law = word.partition(":")
    parts = {"taper": [f"{name}:factor", word], "pivot": [f"{name}[0]", f"{name}:inner"]}.get(law)
    if parts is None or f"{name}:shared" not in free:
        return [*free, word]
    return [*[each for each in free if each != f"{name}:shared"], *parts]
