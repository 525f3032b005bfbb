"""Wrong and poor inputs: none converges to a wrong answer that is called usable."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks import wrong_input
from benchmarks.wrong_input import DOUBLE, SINGLE, Case, Outcome, longer, outcome, ratios, simulated, swing

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.identification import Kind
from hyperflex.identification.declarations.mistakes import ShortFit
from hyperflex.identification.fit import Loss

SIMULATED = list(simulated())
NAMED = {  # the kind of the first finding
    "double: relative angles read as absolute": Kind.RELATIVE,
    "double: absolute angles read as relative": Kind.ABSOLUTE,
    "double: degrees read as radians": None,  # refused before the fit
    "double: radians read as degrees": Kind.RADIANS,
    "double: 0 is up": Kind.ZERO_DIRECTION,
    "double: 0 is level": Kind.ZERO_DIRECTION,
    "double: zero off by 5 degrees": Kind.ZERO,
    "double: links in reverse order": Kind.REVERSED,
    "double: first link to the other side": Kind.SENSE,
    "double: clock x 1.1": Kind.CLOCK,
    "double: clock x 0.8 (400 for 500 Hz)": Kind.CLOCK,
    "double: twice the frame rate": Kind.CLOCK,
    "double: half the frame rate": Kind.CLOCK,
    "double: lengths x 1.1": Kind.CLOCK,
    "double: a clock that drifts, 2 % too slow at the end": Kind.DRIFT,
    "double: com held wrong": Kind.HELD,
    "double: inertia held wrong": Kind.HELD,
    "double: last link's zero off by 10 degrees": Kind.LINK_ZERO,
    "single: half the frame rate": Kind.MASS_FAR,
    "markers: y points down": Kind.Y_AXIS,
    "markers: x and y swapped": Kind.AXES_SWAPPED,
    "real double, markers: y points down": Kind.Y_AXIS,
    "real double, markers: x and y swapped": Kind.AXES_SWAPPED,
    "markers: camera turned by 8 degrees": Kind.ZERO,
    "markers: scale x 1.1": Kind.MARKER_DISTANCES,
    "markers: scale x 1.1, places fitted": Kind.MARKER_SCALE,
    "real triple: twice the frame rate": Kind.CLOCK,
    "real triple: half the frame rate": Kind.CLOCK,
    "real double: radians read as degrees": Kind.RADIANS,
    "real double: last link's zero off by 10 degrees": Kind.LINK_ZERO,
    "rope of 8 links: links in reverse order": Kind.REVERSED,
    "single: from 1.4 rad, angles x 0.9": Kind.ANGLE_SCALE,
    "rope of 8 links: half the mass at the tip, held alike": Kind.MASS_TAPER,
    "rope of 8 links: bent at rest, held straight": Kind.REST_BEND,
    "double: one length in cm": Kind.UNLIKE_LENGTHS,
    "double: angles x 1.1, default": Kind.ANGLE_SCALE,
    "markers: the last two swapped from the middle on": Kind.MARKERS_SWAPPED,
    "driven: arm's length x 1.2": Kind.ARM_LENGTH,
    "driven: stamps 100 ms late": Kind.DELAY,
}
SPOILED = {  # samples, of each motion
    "5 % lost, written as 0": Kind.LOST,
    "lost for 0.2 s every 2 s, written as 0": Kind.LOST,
    "half the frames, each twice": Kind.REPEATED_FRAMES,
    "wrapped": None,
    "the last marker stands still": None,
    "y points down": Kind.Y_AXIS,
}
NAMED |= {case.name: SPOILED[case.wrong] for case in SIMULATED if case.wrong in SPOILED and case.name not in NAMED}
NAMED |= {
    f"fast {kind}: {what}": named
    for kind in ("double", "markers")
    for what, named in (
        ("half of the frames dropped, times counted on", Kind.UNEVEN_FRAMES),
        ("a zero moved halfway", Kind.JUMP),
        ("4 % outliers", Kind.OUTLIERS),
    )
}
NAMED |= {f"fast double: last link {late} ms late": Kind.LINK_LATE for late in (10, 30)}
# must not be refused either
FIT = ("as it is", "moves alike", "as they are", "default", "40 % of samples missing", "guess off by 3")
FIT += ("the same as gaps", "with their times", "outliers, robust", "rounded to two digits")


def check(case: Case) -> Outcome:
    """Check how a case ends; return that."""
    found = outcome(case)
    what = f"{case.name}: {found.line}"
    assert found.end not in ("WRONG", "WIDE"), what
    assert NAMED.get(case.name, found.kind) == found.kind, what
    if case.name.endswith(FIT) and case.name not in NAMED:
        assert found.end in ("right", "suspicion", "undetectable"), what
    return found


IN_GATE = 3  # cases that the gate runs; nightly runs all


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=[pytest.mark.nightly] * (k >= IN_GATE)) for k, case in enumerate(SIMULATED)],
    ids=[case.name for case in SIMULATED],
)
def test_no_wrong_answer_is_called_usable(case):
    check(case)


def test_missing_frames_that_look_like_a_jump_are_named():
    (case,) = (each for each in SIMULATED if each.name == "double: every 25th frame dropped, times counted on")
    (found,) = case.recording().check()
    assert found.kind is Kind.MISSING_FRAMES


@pytest.mark.parametrize("kind", ["single", "triple", "double"])
@pytest.mark.nightly
def test_real_recordings_declared_wrongly(data_dir, kind):
    for case in wrong_input.real(data_dir):
        if case.name.startswith(f"real {kind}"):
            check(case)


UNDETECTABLE = [case for case in SIMULATED if case.undetectable]


@pytest.mark.parametrize("case", UNDETECTABLE, ids=[case.name for case in UNDETECTABLE])
def test_what_cannot_be_told_is_no_suspicion(case):
    """The right recording gets the same first line: that names nothing."""
    assert outcome(case).end == "undetectable"
    assert outcome(replace(case, undetectable=False)).end == "WRONG"


@pytest.mark.parametrize(
    ("rope", "other"),
    [
        (SINGLE, SINGLE.replace(inertia=1.21 * 7.5e-4 + 0.21 * 0.1 * 0.14**2, friction=1.1 * 2e-4)),
        (DOUBLE, longer(DOUBLE, 1.21).replace(friction=1.1**3 * DOUBLE.friction)),
        (hf.Rope.uniform(1.0, 0.05, 8, friction=4e-4), hf.Rope.uniform(1.21, 0.05, 8, friction=1.1**3 * 4e-4)),
    ],
    ids=["single: more inertia", "double: longer", "rope of 8 links: longer"],
)
def test_another_rope_makes_exactly_the_recording_of_a_wrong_clock(rope, other):
    q0 = np.linspace(0.9, 0.6, rope.n_links)
    t, q = swing(rope, q0, 3.0)
    slower = hf.simulate(other, duration=1.1 * float(t[-1]), t_eval=1.1 * t, q0=q0, tol=1e-9).q
    assert np.abs(slower - q).max() < 1e-6  # ten times what the tolerance leaves


@pytest.mark.parametrize(
    ("changed", "end"),
    [
        ({}, "right"),
        ({"widest": 1e-3}, "WIDE"),
        ({"truth": {"J/p1": np.array([0.2])}}, "WRONG"),
        ({"truth": {}}, "WIDE"),
        ({"truth": {"J/p1": np.array([0.2])}, "name": "single: clock x 1.1"}, "WRONG"),
    ],
    ids=["as it is", "a narrower limit", "another truth", "nothing to compare", "a cause that is not named"],
)
def test_what_counts_as_right(changed, end):
    right = next(case for case in SIMULATED if case.name == "single: as it is")
    assert outcome(replace(right, right=right, **changed)).end == end


def test_a_suspicion_is_of_the_true_cause():
    """A wrong clock and wrong lengths, reported as the length, count; the same finding for another cause does not."""
    case = next(case for case in SIMULATED if case.name == "driven: lengths x 0.99")
    case = replace(case, truth={name: 2.0 * value for name, value in ratios(DOUBLE).items()})
    assert outcome(case).end == "suspicion"
    assert outcome(replace(case, name="driven: com held wrong")).end == "WRONG"


def test_causes_are_those_of_cases():
    named = {case.wrong for case in SIMULATED}
    assert set(wrong_input.CAUSES) <= named


def test_a_recording_shorter_than_a_usual_window_is_checked_as_well():
    rod = hf.Rope([2.0], [0.1], friction=1e-3)
    t = np.linspace(0.0, 1.0, 101)
    swing = hf.Recording(t, hf.simulate(rod, duration=1.0, t_eval=t, q0=[0.8]).q)
    left, _ = ShortFit(rod, ["friction"], hf.RecordingSetup(), Loss("squares"), Budget())(swing)
    assert left < 1e-5
