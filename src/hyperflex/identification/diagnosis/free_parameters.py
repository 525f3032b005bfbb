"""Choice of free parameters by what a recording tells, where the user names none."""

from collections.abc import Callable, Sequence

import numpy as np

from hyperflex.identification.diagnosis.grade import matters
from hyperflex.identification.diagnosis.score_tests import FEW, LAWS, ScoreTest
from hyperflex.identification.ending import INTERRUPTED
from hyperflex.identification.result import Identification
from hyperflex.model import Rope

MOST = 3  # that are added
ALLOWED = ("com", "gravity_angle", *LAWS)  # of what was held: what a user is likely not to know


def first_choice(guess: Rope) -> list[str]:
    """Return what is free at first: inertia and friction; of a rope of many links one value each, of stiffness if any.

    A rope of many links that are not alike in the guess keeps its taper: what is free is a factor on all.
    """
    if guess.n_links <= FEW:
        return ["inertia", "friction"]
    words = ["friction", "stiffness"] if guess.stiffness.any() else ["inertia", "friction"]
    return [f"{word}:{'shared' if np.ptp(getattr(guess, word)) == 0.0 else 'factor'}" for word in words]


def identify_chosen(fit: Callable[[Sequence[str], bool], Identification], guess: Rope) -> Identification:
    """Return the fit with parameters chosen one by one, and the choice in words as the first of its verdict.

    `fit` gets what is free, and whether it is a trial, without intervals. What the score tests of a fit ask for is
    freed as well, as long as that makes a fit that converges.
    """
    words, why = first_choice(guess), []
    trial = fit(words, True)
    if trial.message == INTERRUPTED:
        return trial
    for _ in range(MOST):
        asked = [each for each in trial.score_tests if _asked(each)]
        if not asked or not trial.success:
            break
        name = asked[0].name
        richer = fit([*words, name], True)
        if richer.message == INTERRUPTED:
            return richer
        if not richer.success:
            break
        words, trial = [*words, name], richer
        why.append(f"{name} (it takes away {100.0 * asked[0].gain:.3g} % of the residuals' sum of squares)")
    added = f", and by what the recording tells {', '.join(why)}" if why else ""
    usual = ", ".join(words[: len(words) - len(why)])
    return fit(words, False).with_remark(f"Free were {usual} by default{added}; name others with free.")


def _asked(test: ScoreTest) -> bool:
    name = test.name.partition(":")[0]
    return test.believed and name in ALLOWED and (name in LAWS or matters(test))
