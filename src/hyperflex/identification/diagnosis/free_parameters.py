"""Choice of free parameters by what a recording tells, where the user names none."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from hyperflex.identification.diagnosis.score_tests import EQUAL, LAWS, ScoreTest
from hyperflex.identification.diagnosis.tested_words import FEW_LINKS
from hyperflex.identification.diagnosis.uneven import is_uneven
from hyperflex.identification.diagnosis.window_tests import DRIFT, Scatter, WindowScores
from hyperflex.identification.model.plant import ANGLES
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.interruption import catch_interrupt
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


class Trial(NamedTuple):
    """A fit with what was free in it, its score tests, the settings that it used, and how its windows agree."""

    free: list[str]
    basis: Basis
    tests: tuple[ScoreTest, ...]
    settings: dict[str, Any]
    scores: WindowScores | None = None
    scatter: tuple[Scatter, ...] = ()


def choose_parameters(fit: Callable[[Sequence[str]], Trial], guess: Rope) -> tuple[Trial, str]:
    """Return the fit with parameters chosen one by one, and the choice in words.

    `fit` gets what is free. What the score tests of a fit ask for is freed as well, as long as that makes a fit that
    converges: of what explains the same, to EQUAL, the first of ALLOWED. An interrupted fit is the last.
    """
    trial, why = fit(first_choice(guess)), []
    usual = ", ".join(trial.free)
    for _ in range(MOST):
        slips = [each.gain for each in trial.tests if each.believed and each.name in (DRIFT, ANGLES)]
        asked = [
            each
            for each in trial.tests
            if _asked(each, trial.free, guess) and each.gain > max(slips, default=0.0) + EQUAL
        ]
        if not asked or not trial.basis.fit.converged or trial.basis.fit.interrupted:
            break
        equals = [each for each in asked if each.gain > asked[0].gain - EQUAL]
        chosen = min(equals, key=lambda each: ALLOWED.index(each.name.partition(":")[0]))
        with catch_interrupt() as stop:
            richer = fit(_with_word(trial.free, chosen.name))
        if stop.received or richer.basis.fit.interrupted:
            trial.basis.fit.interrupted = True  # what has converged and was tested is worth more
            break
        if not richer.basis.fit.converged:
            break
        trial = richer
        why.append(f"{chosen.name} (it takes away {100.0 * chosen.gain:.3g} % of the residuals' sum of squares)")
    added = f", and by what the recording tells {', '.join(why)}" if why else ""
    return trial, f"Free were {usual} by default{added}; name others with free."


def _asked(test: ScoreTest, free: Sequence[str], guess: Rope) -> bool:
    name = test.name.partition(":")[0]
    if is_uneven(test) and not (f"{name}:shared" in free and np.all(getattr(guess, name) > 0.0)):
        return False  # of a factor on a guess that is not alike, or on nothing
    return test.believed and name in ALLOWED and not test.freed_with and (name != "com" or test.matters)


def _with_word(free: Sequence[str], word: str) -> list[str]:
    """Return `free` with a word more; what was one value of all gives way to what it is made of then."""
    name, _, law = word.partition(":")
    parts = {"taper": [f"{name}:factor", word], "pivot": [f"{name}[0]", f"{name}:inner"]}.get(law)
    if parts is None or f"{name}:shared" not in free:
        return [*free, word]
    return [*[each for each in free if each != f"{name}:shared"], *parts]
