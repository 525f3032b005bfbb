"""What was declared or held, and does not fit or cannot be tested, in sentences."""

from collections.abc import Sequence

import numpy as np

from hyperflex.identification.diagnosis.score_tests import EQUAL, EXPLAINS, SCALES, SURE, ScoreTest
from hyperflex.identification.diagnosis.tested_words import ARCS, CURL, TAPER, as_free
from hyperflex.identification.diagnosis.uneven import is_uneven, uneven_words
from hyperflex.identification.diagnosis.window_tests import DRIFT
from hyperflex.identification.model.plant import ANGLES
from hyperflex.identification.sentences import About, Sentence

UNTESTED = 0.05  # standard deviation of gravity's factor: any ruler measures lengths better
SHORT = 0.004  # relative, of lengths: by less a ruler errs, even one that was read with care
CERTAIN = 3.0  # standard deviations: more than noise makes of 99.7 % of what is right
NEAR = 0.03  # relative, of a factor of the clock: rates twice or half of the declared ones were found within 0.01
TOLD = (
    "gravity_angle",
    "delay",
    "arm_inertia",
    "arm_friction",
    CURL,
    ARCS,
)  # believed, these are told with their value even where they hardly matter
DECLARED = ("gravity_scale", "gravity_angle", "delay", ANGLES)  # what stands for a recording that is not as declared
UNDETECTABLE_CLOCK = (
    "If they are wrong by more than clock_std, moments and inertias are as well (a clock 1 % off makes J/p1 2 % off): "
    "check the frame rate."
)
UNDETECTABLE_SCALE = Sentence(
    "times and lengths are tested against each other alone: with a clock 1 % off and all lengths 2 % off a rope moves "
    "exactly alike, and J/p1 is 2 % off. Standard deviations hold length_std and clock_std: check the frame rate, or "
    "one length.",
    About.UNDETECTABLE,
)
CHECK = {
    "gravity_scale": "check the frame rate, and one length",
    "gravity_angle": "level the camera, or put it into free",
    "delay": "put it into free",
    ANGLES: "check what an angle of the sensor is in radians",
}
MEANT = {
    "gravity_scale": "times or lengths",
    "gravity_angle": "the zero of the angles",
    "delay": "the motion",
    ANGLES: "the angles' scale",
    ARCS: "where the markers are",
}


def first_misdeclared(tests: Sequence[ScoreTest]) -> ScoreTest | None:
    """Return what was declared or held, does not fit and matters, and explains most; None where all fits."""
    return next((each for each in tests if each.believed and each.matters), None)


def _cause_beside(first: ScoreTest, tests: Sequence[ScoreTest]) -> ScoreTest | None:
    """Return what explains clearly more than `first`, though it would move ratios by no more than noise may."""
    return next((each for each in _causes(tests) if each.gain > first.gain + EQUAL), None)


def explaining(tests: Sequence[ScoreTest]) -> ScoreTest | None:
    """Return what explains most of a fit that is poor, though its ratios are not known well enough to move beyond."""
    told = [each for each in tests if each.believed and each.name in TOLD]
    causes = [each for each in (*_causes(tests), *told) if each.gain > EXPLAINS]
    return max(causes, key=lambda each: each.gain, default=None)


def _causes(tests: Sequence[ScoreTest]) -> list[ScoreTest]:
    """Return what is held and surely does not fit, though ratios move by no more than noise may, or not at all."""
    certain = (each for each in tests if each.believed and each.excess_gain > SURE)
    return [each for each in certain if (each.law and not each.matters) or _covered(each)]


def _covered(test: ScoreTest) -> bool:
    """Whether something that was held is believed not to fit, though ratios move by no more than noise may."""
    return test.covered and test.name not in (*TOLD, *DECLARED, DRIFT)


def misdeclared(tests: Sequence[ScoreTest]) -> list[str]:
    """Return what was declared or held, does not fit and matters, in words; what explains most, with its equals.

    What explains clearly more comes before it, see :func:`seems`.
    """
    first = first_misdeclared(tests)
    if first is None:
        return []
    cause = _cause_beside(first, tests)
    return [*([seems(cause)] if cause else []), _misfit(first, tests)]


def _misfit(first: ScoreTest, tests: Sequence[ScoreTest]) -> str:
    """Return that the `first` of what matters does not fit, and what explains as much, in words."""
    equals = [each.name for each in tests if each.believed and abs(each.gain - first.gain) < EQUAL]
    part = f"{100.0 * first.gain:.3g} % of the residuals' sum of squares"
    if first.freed_with:
        part += f" that is left with {as_free(*first.freed_with)} free"
    value = float(first.values[0])
    alike = "".join(f", or with {words}" for words in _alike(first, tests))
    if first.name == "gravity_scale":
        clock = float(np.sqrt(value))
        said = (
            f"times or lengths are not as declared: {part} go away if times are multiplied by {clock:.3g}"
            f"{_frames(clock)}, or lengths divided by {value:.3g}{alike}. Check the clock or frame rate, the scale, "
            "and the lengths of the guess."
        )
    elif first.name == "gravity_angle":
        said = (
            f"the zero of the angles is off by {np.degrees(value):.3g} degrees: without that, {part} go away. Check "
            "the zero, level the camera, or put 'gravity_angle' into free."
        )
    elif first.name == ANGLES:
        said = (
            f"angles are not as declared: {part} go away with angles multiplied by {1.0 / value:.3g}{alike}. Check "
            "what an angle of the sensor is in radians."
        )
    elif first.name == DRIFT:
        said = (
            f"the clock drifts, or something changes over the recording: {part} go away if times run "
            f"{percent(0.5 * abs(value))} {'slower' if value < 0.0 else 'faster'} at its end than at its beginning"
            f"{alike}. Check the time stamps, or fit parts of the recording on their own."
        )
    elif first.name == TAPER:
        said = (
            f"the rope's mass changes along it: {part} go away if that of its tip is {np.exp(value):.3g} times that of "
            f"its begin{alike}. Give the guess such masses, or put '{TAPER}' into free."
        )
    elif is_uneven(first):
        said = uneven_words(first)
    elif first.name == ARCS:
        said = (
            f"where the markers are does not fit: {part} go away if they are {_places(first)} along the rope{alike}, "
            f"or if a length is as far off, and ratios move by up to {percent(first.moved)}. Measure arc_lengths and "
            f"lengths again, or put '{ARCS}' into free."
        )
    elif first.name == "delay":
        said = f"the motion is {value:.3g} s off: without that, {part} go away. Put 'delay' into free."
    else:
        names = " or ".join(f"'{name}'" for name in equals if name not in (*DECLARED, DRIFT, TAPER))
        said = (
            f"what is held does not fit: with {names} free{alike}, {part} go away, and ratios move by up to "
            f"{percent(first.moved)}. Put it into free."
        )
    return said


def _alike(first: ScoreTest, tests: Sequence[ScoreTest]) -> list[str]:
    """Return what explains as much as `first`, in words.

    Angles read too large act like a spring, and while a swing dies out like a clock that drifts.
    """
    said = []
    for each in tests:
        if not each.believed or each.name == first.name or each.gain <= first.gain - EQUAL:
            continue
        if each.name == ANGLES:
            said.append(f"angles multiplied by {1.0 / each.values[0]:.3g}")
        elif each.name == TAPER:
            said.append(f"a tip whose mass is {np.exp(each.values[0]):.3g} times that of the rope's begin")
        elif each.name == "gravity_scale" and first.name == TAPER:
            said.append(f"times multiplied by {np.sqrt(each.values[0]):.3g}")
        elif each.name == DRIFT:
            said.append(f"a clock that drifts by {percent(0.5 * abs(float(each.values[0])))}")
        elif each.name.partition(":")[0] == "stiffness" and first.name in (ANGLES, DRIFT):
            said.append(f"'{each.name}' free")
    return said


def slightly(tests: Sequence[ScoreTest], cause: ScoreTest | None = None) -> list[str]:
    """Return what seems declared wrongly, but so little that ratios hardly move or something else may explain it.

    Of what is told as the `cause` of a poor fit already, see :func:`seems`, nothing.
    """
    said, first = _lengths(tests), first_misdeclared(tests)
    cause = cause or (first and _cause_beside(first, tests))
    equals = [] if first is None else [each for each in tests if abs(each.gain - first.gain) < EQUAL]
    for each in tests:
        if each is cause:
            continue
        if each.slight and each.believed:
            names = as_free(*each.freed_with)
            beside = f", if {names} {'is' if len(each.freed_with) == 1 else 'are'} free as well" if names else ""
            said.append(
                f"lengths seem {100.0 * abs(float(each.values[0]) - 1.0):.2g} % off, or times half of that{beside}: "
                f"measure a length, or the frame rate, again; ratios would move by up to {percent(each.moved)}."
            )
        covered = each.covered and each.name not in (*TOLD, DRIFT)
        if (each.suspected or covered) and (not each.freed_with or each.expected):
            said.append(
                f"{MEANT.get(each.name, repr(each.name))} may be off: if so, {100.0 * each.gain:.3g} % of the "
                f"residuals' sum of squares go away, and ratios move by up to {percent(each.moved)}. Standard "
                f"deviations hold that; {CHECK.get(each.name, 'measure it, or put it into free')}."
            )
        behind = first is not None and first.gain > each.gain  # which it seems to be, or is told of there
        if each.name == DRIFT and each.refitted and not (each.believed and each.matters) and not behind:
            said.append(
                f"the clock seems to drift by {percent(0.5 * abs(float(each.values[0])))} over the recording: check "
                f"the time stamps; ratios would move by up to {percent(each.moved)}. Standard deviations hold that."
            )
        left_out = (
            each.law and not (each.covered or is_uneven(each)) and each.gain > EXPLAINS and each.excess_gain > SURE
        )
        if each.believed and not each.matters and (each.name in TOLD or (left_out and each not in equals)):
            said.append(seems(each))
    return said


def seems(test: ScoreTest) -> str:
    """Return what a cause seems to be, in words."""
    value, part = float(test.values[0]), f"{100.0 * test.gain:.3g} % of the residuals' sum of squares"
    meant = {
        "gravity_angle": f"the zero of the angles seems off by {np.degrees(value):.2g} degrees",
        "delay": f"the motion seems {value:.2g} s off",
        "arm_inertia": f"the arm's inertia seems to be {value:.2g} kg m^2",
        ARCS: f"the markers seem to be {_places(test)} along the rope",
        CURL: f"the rope seems bent at rest, by {np.degrees(value):.2g} degrees a joint",
        "arm_friction": f"the arm's friction seems to be {value:.2g} N m s/rad",
    }
    if is_uneven(test):
        return uneven_words(test)
    if test.name not in meant:
        what = "resistance is of another kind or size, or changes" if test.law else "what is held does not fit"
        return f"{what}: with '{test.name}' free, {part} go away. Put it into free."
    return f"{meant[test.name]}: without that, {part} go away. Put '{test.name}' into free."


def _places(test: ScoreTest) -> str:
    return f"{', '.join(f'{1e3 * each:.4g}' for each in test.values)} mm"


def _lengths(tests: Sequence[ScoreTest]) -> list[str]:
    """Return that lengths seem off where a drive lets the motion tell them, and no clock seems off."""
    scales = next((each for each in tests if each.name == SCALES and each.values.size > 2), None)
    if scales is None or any(each.believed and each.name == "gravity_scale" for each in tests):
        return []
    known = scales.information[:2, :2]  # of links' lengths and of gravity, the arm being as long as declared
    score = scales.information[:2] @ np.log(np.clip(scales.values, 1e-9, 1e9))
    off, std = abs(float(np.linalg.solve(known, score)[0])), float(np.sqrt(np.linalg.inv(known)[0, 0]))
    if off < max(SHORT, CERTAIN * std):
        return []
    part = percent(off)
    words = f"lengths seem {part} off, of the links or the arm, unless a law was left out: measure them again. "
    return [f"{words}Standard deviations hold {part}."]


def _frames(factor: float) -> str:
    """Return what a factor of the times may come from."""
    for usual, words in ((2.0, "half"), (0.5, "twice")):
        if abs(factor / usual - 1.0) < NEAR:
            return f" (as if the frame rate were {words} of what was declared)"
    return ""


def untested(tests: Sequence[ScoreTest]) -> list[str]:
    """Return that this motion cannot show a wrong clock or wrong lengths, where it cannot."""
    scale = next((each for each in tests if each.name == "gravity_scale"), None)
    if scale is None or scale.std <= UNTESTED:
        return []
    words = f"times and lengths are taken as declared: this motion cannot test them. {UNDETECTABLE_CLOCK}"
    return [Sentence(words, About.UNTESTED)]


def undetectable(tests: Sequence[ScoreTest], *, alike: bool) -> list[str]:
    """Return by how much each per cent counts that a clock and lengths may be off without any motion showing it.

    `alike`: whether a longer and slower rope moves exactly alike. Where the motion tests neither, :func:`untested`
    says so.
    """
    tested = any(each.name == "gravity_scale" and each.std <= UNTESTED for each in tests)
    return [UNDETECTABLE_SCALE] if alike and tested else []


def percent(part: float) -> str:
    """Return a part in per cent: two digits, and no more than 1000 %, beyond which a number tells nothing."""
    return "1000 % and more" if part > 10.0 else f"{float(f'{100.0 * part:.2g}'):g} %"
