"""What an identification may be used for, and why."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from hyperflex.identification.diagnosis.link_test import LINKS
from hyperflex.identification.diagnosis.misdeclared import (
    explaining,
    misdeclared,
    percent,
    seems,
    slightly,
    undetectable,
    untested,
)
from hyperflex.identification.diagnosis.score_tests import EQUAL, EXPLAINS, MOVES, ScoreTest
from hyperflex.identification.diagnosis.tested_words import as_free
from hyperflex.identification.diagnosis.uneven import uneven
from hyperflex.identification.diagnosis.window_tests import Scatter
from hyperflex.identification.excitation import unlike_lengths
from hyperflex.identification.model.parameters import lumped
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.sentences import About, Sentence, capitalised
from hyperflex.model import Rope

GradeName = Literal["usable", "usable for ratios", "do not use"]
AXES = 0.2  # rad, of gravity's angle: 11 degrees, more than any camera that was meant to be level
PERSISTENCE = 0.5  # part of the error that keeping still would make: half of that predicts nothing of use
FRICTION_MOVES = 0.1  # part of a friction: by more than another law would change it, it is called a model error
INSIDE = 0.5  # part of predicted values within the band of 95 %: at 0.5 deviations are 2.9 times too small (normal law)
FORETOLD = (
    0.9  # part within the same band: nearly 0.95, so that the error is as foretold, and what moves is hardly noise
)
LIKELY = 0.5  # probability: more likely than not
NAMED = 4  # labels of what is hardly known that are named, for a line
LEFT_OUT = 0.2  # part of the windows: one in five
REACH = 2.0  # lengths of a link, to which its mass may reach; 1 is the most without counterweights (Cauchy-Schwarz)
HELD = (
    "masses, inertias and frictions are in proportion to masses and centres of mass as they were held, which no motion "
    "tests{}: use ratios alone, or weigh the links and find where each balances."
)
COMMON = (
    "masses, inertias and frictions share a factor that no free swing tells: use ratios alone, or weigh the links and "
    "leave 'mass' and 'com' out of free."
)
BY_TORQUE = (
    "masses, inertias and frictions are in proportion to the torque as it was measured: one 1 % too large makes them 1 "
    "% too large. Standard deviations hold torque_std: check its scale with a known weight."
)
COMPARE = "Look whether another model predicts better (compare_models), and check what was declared."
LOOSE = 0.15  # standard deviation as a part of a value or ratio: beyond, 95 % intervals reach farther than 30 %
FRICTION_LOOSE = 0.3  # the same of frictions and stiffnesses, which other laws change by much
NOTHING = (
    "no ratio of moments and inertias is known better than to {:g} % of itself. Record longer or larger swings, or "
    "more frames a second."
)
MASSES = ("J/p1", "p/p1")  # ratios without friction and stiffness


class Grade(NamedTuple):
    """What an identification may be used for.

    Attributes
    ----------
    name : str
        ``usable``, ``usable for ratios`` (masses, inertias and frictions share a factor that is unknown, or only held),
        ``do not use``.
    reasons : tuple of str
        Why it is no better, and what else is doubtful; the weightiest first.
    turned : bool
        Whether gravity was found so far from where it was taken to be that axes may have been declared wrongly.
    """

    name: GradeName
    reasons: tuple[str, ...]
    turned: bool = False

    @property
    def doubtful(self) -> bool:
        """Whether something may have been declared wrongly."""
        return self.name == "do not use" or self.turned

    @property
    def more(self) -> tuple[str, ...]:
        """All reasons but the first, as sentences."""
        return tuple(capitalised(text) for text in self.reasons[1:])

    def __str__(self) -> str:
        return f"{self.name.capitalize()}: {self.reasons[0]}" if self.reasons else f"{self.name.capitalize()}."


@dataclass(frozen=True, eq=False)
class Findings:
    """What was found of a fit, from which its grade follows.

    Attributes
    ----------
    rope : Rope
        As identified.
    identifiable : bool
        Whether all free parameters are known.
    warnings : sequence of str
        Of a fit that did not converge or leaves much of the motion; empty ones count as none.
    held_out : HeldOut or None
    tests : sequence of ScoreTest
    scatter : sequence of Scatter
        Ratios of which windows disagree.
    noise : str
        A doubt of the declared noise.
    held : bool
        Whether the scale of the values is that of masses and centres of mass as they were held, and no torque's.
    laws : (float, str)
        By what part of its value friction may change if another law is free too, and which.
    hardly : sequence of str
        What is hardly known, values and ratios, with standard deviations; see :func:`hardly`.
    unknown : bool
        Whether it is all ratios of moments and inertias that are free.
    moved : float
        By what part the model's error may move ratios of moments and inertias.
    turned : float
        By which gravity was found to be turned, rad.
    left_out : float
        Part of the windows that was left out.
    alike : bool
        Whether a longer and slower rope moves exactly alike.
    """

    rope: Rope
    identifiable: bool
    warnings: Sequence[str] = ()
    held_out: HeldOut | None = None
    tests: Sequence[ScoreTest] = ()
    scatter: Sequence[Scatter] = ()
    noise: str = ""
    held: bool = False
    laws: tuple[float, str] = (0.0, "")
    hardly: Sequence[str] = ()
    unknown: bool = False
    moved: float = 0.0
    turned: float = 0.0
    left_out: float = 0.0
    alike: bool = False


def grade(found: Findings) -> Grade:
    """Return what a result may be used for."""
    axes = bool(abs(found.turned) > AXES)
    wrong = _wrong(found)
    suspicion, doubts = _suspicions(found, wrong=bool(wrong)), _doubts(found)
    if wrong:
        return Grade("do not use", (*wrong, *suspicion, *doubts), axes)
    if found.identifiable and not found.held:
        return Grade("usable", (*suspicion, *doubts, BY_TORQUE), axes)
    places = next((each.ratio_sensitivity for each in found.tests if each.name == "com"), 0.0)
    moves = f" (1 % of a centre of mass moves ratios by up to {percent(places)})" if places > 0.0 else ""
    common = HELD.format(moves) if found.identifiable else COMMON
    return Grade("usable for ratios", (*suspicion, common, *doubts), axes)


def _wrong(found: Findings) -> list[str]:
    """Return why a result is not to be used."""
    odd = _odd(found)
    links, _ = _finer(found.tests, odd=bool(odd))
    cause = _cause(found)
    wrong = [*_impossible(found.rope), *links, *misdeclared(found.tests), *([seems(cause)] if cause else [])]
    wrong += [*_far(found.rope), *odd, *[NOTHING.format(100.0 * LOOSE)] * found.unknown]
    return [*_unlike(found.rope), *wrong] if wrong else []


def _cause(found: Findings) -> ScoreTest | None:
    """Return what explains most of an odd fit, or one that tells no ratio, where nothing else is said to be wrong."""
    odd = _odd(found)
    links, _ = _finer(found.tests, odd=bool(odd))
    said = [*_impossible(found.rope), *links, *misdeclared(found.tests)]
    return explaining(found.tests) if (odd or found.unknown) and not said else None


def _suspicions(found: Findings, *, wrong: bool) -> list[str]:
    """Return what may be wrong, or is not known; what makes a result `wrong` is not said again."""
    _, coarse = _finer(found.tests, odd=bool(_odd(found)))
    _, differ = _disagreeing(found.scatter)
    suspicion = [found.noise] if found.noise else []
    suspicion += [] if wrong else _unlike(found.rope)
    suspicion += [
        *coarse,
        *_turned(found.turned),
        *slightly(found.tests, _cause(found)),
        *uneven(found.tests, _cause(found)),
    ]
    suspicion += [*differ, *untested(found.tests)]
    if found.hardly:
        others = "all else is known better" if found.identifiable else "all other ratios are known better"
        rest = "" if wrong else f"; {others}"
        words = f"{_not_known(found.hardly)}{rest}. Record longer or larger swings, or hold what you know otherwise."
        suspicion.append(Sentence(words, About.NOT_KNOWN))
    return suspicion


def _odd(found: Findings) -> list[str]:
    """Return what is odd of a fit, whatever the cause."""
    disagree, _ = _disagreeing(found.scatter)
    return [*(each for each in found.warnings if each), *_mispredicted(found.held_out), *disagree]


def _unlike(rope: Rope) -> list[str]:
    """Return that a link is far longer than another."""
    words = unlike_lengths(rope)
    return [words] if words else []


def _impossible(rope: Rope) -> list[str]:
    """Return that no rope hangs upwards."""
    if not np.any(rope.gravity) or lumped(rope)[0][0] > 0.0:
        return []
    words = (
        "gravity would hold the rope up (its first moment p1 is negative). Check where the angles' zero is "
        "(zero='hanging' or 'up'), or where y points (y_axis='up' or 'down')."
    )
    return [words]


def _far(rope: Rope) -> list[str]:
    """Return that a link's mass lies far beyond the link.

    All mass of a link, and beyond, is between its joints or at the far one, so J <= l p (Cauchy-Schwarz); a real link
    may reach beyond its joint.
    """
    p, inertia = lumped(rope)
    reach = inertia / np.where(p > 0.0, p, np.inf) / rope.length
    k = int(np.argmax(reach))
    if reach[k] <= REACH:
        return []
    words = (
        f"link {k} would have its mass {reach[k]:.3g} times as far from its joint as it is long (inertia over "
        "first moment). Check times, frame rate, scale, lengths and the order of the links."
    )
    return [words]


def hardly(label: str, part: float) -> str:
    """Return the label of what is hardly known, with its standard deviation as a part of it."""
    return f"{label} (± {percent(part)})"


def _not_known(hardly: Sequence[str]) -> str:
    names = ", ".join(hardly[:NAMED]) + (f" and {len(hardly) - NAMED} more" if len(hardly) > NAMED else "")
    return f"{names} {'is' if len(hardly) == 1 else 'are'} hardly known"


def _mispredicted(held_out: HeldOut | None) -> list[str]:
    """Return how predictions of what was not fitted fail."""
    if held_out is None:
        return []
    if held_out.failed.size:
        starts = ", ".join(f"{start:.4g}" for start in held_out.failed)
        failed = f"{held_out.failed.size} of {held_out.starts.size} predictions of what was not fitted failed"
        words = (
            f"{failed} (from t = {starts} s): the identified rope cannot be simulated there. Look at the held-out part"
        )
        return [f"{words}, or leave it out (train=inf)."]
    held_out = held_out.foreseeable
    error = float(np.sqrt(np.mean(held_out.rms**2)))
    still = held_out.persistence
    words = ""
    if error > PERSISTENCE * still > 0.0 and not held_out.inside >= FORETOLD:
        part = f"{100.0 * error / still:.3g} % of what keeping still would"
        words = f"predictions of what was not fitted err by {part}. {COMPARE}"
    elif held_out.inside < INSIDE:
        words = (
            f"only {100.0 * held_out.inside:.3g} % of what was not fitted lies where 95 % is expected: the model "
            f"leaves something out, or the recording is not as declared, and intervals are far too small. {COMPARE}"
        )
    return [words] if words else []


def _disagreeing(scatter: Sequence[Scatter]) -> tuple[list[str], list[str]]:
    """Return that windows disagree: as what makes a result wrong, or, where it is little, as a suspicion.

    Frictions that change are told among the doubts, as a model error.
    """
    first = next((each for each in scatter if each.label.startswith(MASSES)), None)
    if first is None:
        return [], []
    words = (
        f"windows disagree: {first.label} scatters between them {first.times:.2g} times as much as noise makes it, "
        f"with a standard deviation of {percent(first.part)}. Something changes over the recording, or was left "
        "out: fit parts on their own."
    )
    return ([words], []) if first.part > MOVES else ([], [f"{words} Standard deviations hold that."])


def _changing(scatter: Sequence[Scatter]) -> list[str]:
    """Return that frictions or other resistances differ between windows."""
    first = next((each for each in scatter if not each.label.startswith(MASSES)), None)
    if first is None:
        return []
    words = (
        f"{first.label} scatters between windows {first.times:.2g} times as much as noise makes it, with a standard "
        f"deviation of {percent(first.part)}: resistance changes, or is of another kind. Standard deviations hold it."
    )
    return [words]


def _finer(tests: Sequence[ScoreTest], *, odd: bool) -> tuple[list[str], list[str]]:
    """Return that links are too long: as the cause of an `odd` fit, or as a suspicion; not beside a better cause."""
    likely = (each for each in tests if each.name == LINKS and each.excess_gain >= LIKELY and each.gain > EQUAL)
    each = next(likely, None)
    if each is None:
        return [], []
    better = [other for other in tests if other.believed and other.gain > each.gain + EQUAL]
    if any(other.name not in each.freed_with for other in better):
        return [], []
    beside = f" with {as_free(*each.freed_with)} free as well" if each.freed_with else ""
    words = f"use more links: this looks like a rope of finer links{beside}"
    words += f" (probability {100.0 * each.excess_gain:.3g} %)"
    if odd and each.gain >= max(EXPLAINS, *(other.gain for other in tests)):
        return [f"{words}, which takes away {100.0 * each.gain:.3g} % of the residuals' sum of squares."], []
    off = f"a fit of so few to such a one is off by up to {percent(each.ratio_sensitivity)} of a value"
    return [], [f"{words}, and {off}. Standard deviations hold that."] * (each.ratio_sensitivity > 0.0)


def _turned(angle: float) -> list[str]:
    """Return what a gravity far from where it was taken to be makes one suspect."""
    degrees = f"gravity is turned by {np.degrees(angle):.3g} degrees"
    words = f"{degrees}: were zero, y_axis and the order of the axes declared as they are?"
    return [words] if abs(angle) > AXES else []


def _doubts(found: Findings) -> list[str]:
    """Return what no motion tells, and what the model and the windows leave out."""
    said = undetectable(found.tests, alike=found.alike)
    part, name = found.laws
    if part > FRICTION_MOVES:
        size = f"up to {100.0 * part:.2g} %" if part < 1.0 else "as much as it is"
        words = (
            "friction is a model error: it stands for all that brakes, and would change by "
            f"{size} if {as_free(name)} were free as well."
            f"{' Ratios of moments and inertias hardly move.' if found.moved < MOVES else ''}"
        )
        said.append(Sentence(words, About.FRICTION))
    if found.left_out > LEFT_OUT:
        said.append(
            f"{100.0 * found.left_out:.0f} % of the windows were left out: they have too few samples, or the rope "
            "could not be simulated from their states."
        )
    return [*said, *_changing(found.scatter)]
