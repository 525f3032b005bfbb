"""What an identification may be used for, and why."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from hyperflex.identification.diagnosis.link_test import LINKS
from hyperflex.identification.diagnosis.score_tests import EQUAL, EXPLAINS, MOVES, ScoreTest
from hyperflex.identification.diagnosis.window_tests import DRIFT, Scatter
from hyperflex.identification.model.parameters import lumped
from hyperflex.identification.prediction import HeldOut
from hyperflex.model import Rope

GradeName = Literal["usable", "usable for ratios", "do not use"]
UNTESTED = 0.05  # standard deviation of gravity's factor, if it were free
TESTED = 0.005  # the same: lengths that are 1 % off show
NEAR = 0.03  # of a factor by which frame rates are often wrong
AXES = 0.2  # rad, the same: more than any camera that was meant to be level
PERSISTENCE = 0.5  # of the error of a prediction that nothing moves on
FRICTION_MOVES = 0.1  # of a friction: by more than another law would change it, it is called a model error
INSIDE = 0.5  # part of the predicted values in the band that should hold 95 %
FORETOLD = 0.9  # the same: the error is as foretold, and what moves is hardly more than noise
NAMED = 4  # labels of what is hardly known
LIKELY = 0.5  # probability
LEFT_OUT = 0.2  # part of the windows
REACH = 2.0  # of a link's length, to which its mass may reach: real links have counterweights
MASSES = ("J/p1", "p/p1")  # ratios without friction and stiffness
TOLD = ("gravity_angle", "delay")  # believed, these are told with their value even where they hardly matter
DECLARED = ("gravity_scale", "gravity_angle", "delay")  # what stands for a recording that is not as declared
MEANT = {"gravity_scale": "times or lengths", "gravity_angle": "the zero of the angles", "delay": "the motion"}


class Grade(NamedTuple):
    """What an identification may be used for.

    Attributes
    ----------
    name : str
        ``usable``, ``usable for ratios`` (masses, inertias and frictions share an unknown factor), ``do not use``.
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
        return tuple(f"{text[0].upper()}{text[1:]}" for text in self.reasons[1:])

    def __str__(self) -> str:
        return f"{self.name.capitalize()}: {self.reasons[0]}" if self.reasons else f"{self.name.capitalize()}."


def grade(
    warnings: Sequence[str],
    rope: Rope,
    held_out: HeldOut | None,
    tests: Sequence[ScoreTest],
    *,
    identifiable: bool,
    scatter: Sequence[Scatter] = (),
    noise: str = "",
    scale: str = "",
    laws: tuple[float, str] = (0.0, ""),
    hardly: Sequence[str] = (),
    moved: float = 0.0,
    turned: float = 0.0,
    left_out: float = 0.0,
) -> Grade:
    """Return what a result may be used for.

    Parameters
    ----------
    warnings : sequence of str
        Of a fit that did not converge or leaves much of the motion; empty ones count as none.
    rope : Rope
        As identified.
    held_out : HeldOut or None
    tests : sequence of ScoreTest
    identifiable : bool
        Whether all free parameters are known.
    scatter : sequence of Scatter
        Ratios of which windows disagree.
    noise : str
        A doubt of the declared noise.
    scale : str
        What fixes the scale of the values, if they are known.
    laws : (float, str)
        By what part of its value friction may change if another law is free too, and which.
    hardly : sequence of str
        What is known to half of its value only, or worse.
    moved : float
        By what part the model's error may move ratios of moments and inertias.
    turned : float
        By which gravity was found to be turned, rad.
    left_out : float
        Part of the windows that was left out.
    """
    axes = bool(abs(turned) > AXES)
    disagree, differ = _disagreeing(scatter)
    odd = [*(each for each in warnings if each), *_mispredicted(held_out), *disagree]
    links, coarse = _finer(tests, odd=bool(odd))
    wrong = [*_impossible(rope), *links, *misdeclared(tests), *odd]
    suspicion = [*coarse, *_turned(turned), *_slightly(tests), *differ, *_untested(tests)]
    doubts = [*_doubts(laws, moved, left_out), *_changing(scatter)]
    if hardly:
        rest = "" if wrong else ", all else is" if identifiable else ", all other ratios are"
        suspicion.append(_not_known(hardly) + f"{rest}.")
    if noise:
        suspicion.insert(0, noise)
    if wrong:
        return Grade("do not use", (*wrong, *suspicion, *doubts), axes)
    if identifiable:
        scaled = [f"masses, inertias and frictions are in proportion to {scale}; no motion tests that."] * bool(scale)
        places = next((each.ratio_sensitivity for each in tests if each.name == "com"), 0.0)
        if scale and places > 0.0:
            scaled = [f"{scaled[0][:-1]}, and 1 % of a centre of mass moves ratios by up to {_percent(places)}."]
        return Grade("usable", (*suspicion, *scaled, *doubts), axes)
    common = "without a known force or torque, or a mass that is held, values share what this motion cannot tell."
    return Grade("usable for ratios", (*suspicion, common, *doubts), axes)


def _impossible(rope: Rope) -> list[str]:
    """Return what no rope can be.

    All mass of a link, and beyond, is between its joints or at the far one, so J <= l p (Cauchy-Schwarz); a real link
    may reach beyond its joint, and where the last one ends no angle tells.
    """
    p, inertia = lumped(rope)
    if np.any(rope.gravity) and p[0] <= 0.0:
        words = (
            "gravity would hold the rope up (its first moment p1 is negative). Check where the angles' zero is "
            "(zero='hanging' or 'up'), or where y points (y_axis='up' or 'down')."
        )
        return [words]
    reach = inertia[:-1] / np.where(p[:-1] > 0.0, p[:-1], np.inf) / rope.length[:-1]
    if np.any(reach > REACH):
        k = int(np.argmax(reach))
        words = (
            f"link {k} would have its mass {reach[k]:.3g} times as far from its joint as it is long (inertia over "
            "first moment). Check times, frame rate, scale, lengths and the order of the links."
        )
        return [words]
    return []


def _not_known(hardly: Sequence[str]) -> str:
    names = ", ".join(hardly[:NAMED]) + (f" and {len(hardly) - NAMED} more" if len(hardly) > NAMED else "")
    return (
        f"{names} {'is' if len(hardly) == 1 else 'are'} not known (the standard deviation is half of the value or more)"
    )


def misdeclared(tests: Sequence[ScoreTest]) -> list[str]:
    """Return what was declared or held, does not fit and matters; the one that explains most, with its equals."""
    believed = [each for each in tests if each.believed and each.matters]
    if not believed:
        return []
    first, equals = believed[0], [each.name for each in believed if each.gain > believed[0].gain - EQUAL]
    part = f"{100.0 * first.gain:.3g} % of the residuals' sum of squares"
    if first.freed_with:
        part += f" that is left with {' and '.join(repr(name) for name in first.freed_with)} free"
    value = float(first.values[0])
    names = " or ".join(f"'{name}'" for name in equals if name not in DECLARED)
    if first.name == "gravity_scale":
        clock = float(np.sqrt(value))
        said = (
            f"times or lengths are not as declared: {part} go away if times are multiplied by {clock:.3g}"
            f"{_frames(clock)}, or lengths divided by {value:.3g}. Check the clock or frame rate, the scale, and the "
            "lengths of the guess."
        )
    elif first.name == "gravity_angle":
        said = (
            f"the zero of the angles is off by {np.degrees(value):.3g} degrees: without that, {part} go away. Check "
            "the zero, level the camera, or put 'gravity_angle' into free."
        )
    elif first.name == DRIFT:
        said = (
            f"the clock drifts, or something changes over the recording: {part} go away if times run "
            f"{_percent(0.5 * abs(value))} {'slower' if value < 0.0 else 'faster'} at its end than at its beginning. "
            "Check the time stamps, or fit parts of the recording on their own."
        )
    elif first.name == "delay":
        said = f"the motion is {value:.3g} s off: without that, {part} go away. Put 'delay' into free."
    else:
        said = (
            f"what is held does not fit: with {names} free, {part} go away, and ratios move by up to "
            f"{_percent(first.moved)}. Put it into free."
        )
    return [said]


def _slightly(tests: Sequence[ScoreTest]) -> list[str]:
    """Return what seems declared wrongly, but so little that ratios hardly move or something else may explain it."""
    said = []
    for each in tests:
        if each.slight and each.believed:
            names = " and ".join(repr(name) for name in each.freed_with)
            beside = f", if {names} {'is' if len(each.freed_with) == 1 else 'are'} free as well" if names else ""
            said.append(
                f"lengths seem {100.0 * abs(float(each.values[0]) - 1.0):.2g} % off, or times half of that{beside}; "
                f"ratios would move by up to {_percent(each.moved)}."
            )
        if (each.suspected or (each.covered and each.name not in (*TOLD, DRIFT))) and not each.freed_with:
            said.append(
                f"{MEANT.get(each.name, repr(each.name))} may be off: if so, {100.0 * each.gain:.3g} % of the "
                f"residuals' sum of squares go away, and ratios move by up to {_percent(each.moved)}. Standard "
                "deviations hold that."
            )
        if each.name == DRIFT and each.refitted and not (each.believed and each.matters):
            said.append(
                f"the clock seems to drift by {_percent(0.5 * abs(float(each.values[0])))} over the recording; ratios "
                f"would move by up to {_percent(each.moved)}. Standard deviations hold that."
            )
        if not each.believed or each.matters or each.name not in TOLD:
            continue
        value, part = float(each.values[0]), f"{100.0 * each.gain:.3g} % of the residuals' sum of squares"
        what = f"the zero of the angles seems off by {np.degrees(value):.2g} degrees"
        if each.name == "delay":
            what = f"the motion seems {value:.2g} s off"
        said.append(f"{what}: without that, {part} go away. Put '{each.name}' into free.")
    return said


def _frames(factor: float) -> str:
    """Return what a factor of the times may come from."""
    for usual, words in ((2.0, "half"), (0.5, "twice")):
        if abs(factor / usual - 1.0) < NEAR:
            return f" (as if the frame rate were {words} of what was declared)"
    return ""


def _mispredicted(held_out: HeldOut | None) -> list[str]:
    """Return how predictions of what was not fitted fail."""
    if held_out is None:
        return []
    if held_out.failed.size:
        return [f"{held_out.failed.size} of {held_out.starts.size} predictions of what was not fitted failed."]
    error = float(np.sqrt(np.mean(held_out.rms**2)))
    still = held_out.persistence
    words = ""
    if error > PERSISTENCE * still > 0.0 and not held_out.inside >= FORETOLD:
        words = f"predictions of what was not fitted err by {100.0 * error / still:.3g} % of what keeping still would."
    elif held_out.inside < INSIDE:
        words = (
            f"only {100.0 * held_out.inside:.3g} % of what was not fitted lies where 95 % is expected: the model "
            "leaves something out, or the recording is not as declared, and intervals are far too small."
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
        f"with a standard deviation of {_percent(first.part)}. Something changes over the recording, or was left "
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
        f"deviation of {_percent(first.part)}: resistance changes, or is of another kind. Standard deviations hold it."
    )
    return [words]


def _untested(tests: Sequence[ScoreTest]) -> list[str]:
    """Return that this motion cannot show a wrong clock or wrong lengths, where it cannot."""
    scale = next((each for each in tests if each.name == "gravity_scale"), None)
    if scale is None or scale.std <= TESTED:
        return []
    if scale.std > UNTESTED:
        words = (
            "times and lengths are taken as declared: this motion cannot test them. If they are wrong, moments and "
            "inertias are as well (a clock 1 % off makes J/p1 2 % off)."
        )
    else:
        words = (
            "times and lengths are taken as exact, but for length_std: this motion shows no error below "
            f"{200.0 * scale.std:.2g} % of the lengths, and 1 % would move ratios by up to "
            f"{_percent(scale.ratio_sensitivity)}."
        )
    return [words] if scale.ratio_sensitivity > 0.0 else []


def _finer(tests: Sequence[ScoreTest], *, odd: bool) -> tuple[list[str], list[str]]:
    """Return that links are too long: as the cause of an `odd` fit, or as a suspicion."""
    each = next((each for each in tests if each.name == LINKS and each.excess_gain >= LIKELY), None)
    if each is None:
        return [], []
    words = f"use more links: this looks like a rope of finer links (probability {100.0 * each.excess_gain:.3g} %)"
    if odd and each.gain >= max(EXPLAINS, *(other.gain for other in tests)):
        return [f"{words}, which takes away {100.0 * each.gain:.3g} % of the residuals' sum of squares."], []
    off = f"a fit of so few to such a one is off by up to {_percent(each.ratio_sensitivity)} of a value"
    return [], [f"{words}, and {off}. Standard deviations hold that."] * (each.ratio_sensitivity > 0.0)


def _turned(angle: float) -> list[str]:
    """Return what a gravity far from where it was taken to be makes one suspect."""
    degrees = f"gravity is turned by {np.degrees(angle):.3g} degrees"
    words = f"{degrees}: were zero, y_axis and the order of the axes declared as they are?"
    return [words] if abs(angle) > AXES else []


def _doubts(laws: tuple[float, str], moved: float, left_out: float) -> list[str]:
    said = []
    part, name = laws
    if part > FRICTION_MOVES:
        size = f"up to {100.0 * part:.2g} %" if part < 1.0 else "as much as it is"
        said.append(
            "friction is a model error: it stands for all that brakes, and would change by "
            f"{size} if '{name}' were free as well."
            f"{' Ratios of moments and inertias hardly move.' if moved < MOVES else ''}"
        )
    if left_out > LEFT_OUT:
        said.append(
            f"{100.0 * left_out:.0f} % of the windows were left out: they have too few samples, or the rope could not "
            "be simulated from their states."
        )
    return said


def _percent(part: float) -> str:
    """Return a part in per cent: two digits, and no more than 1000 %, beyond which a number tells nothing."""
    return "1000 % and more" if part > 10.0 else f"{float(f'{100.0 * part:.2g}'):g} %"
