"""Wrong and poor inputs: none converges to a wrong answer that is called usable."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.wrong_input import (
    CAUSES,
    DOUBLE,
    SINGLE,
    Case,
    Outcome,
    longer,
    outcome,
    ratios,
    real,
    simulated,
    swing,
)

import hyperflex as hf
from hyperflex.identification.diagnosis.declarations import ShortFit, _upright
from hyperflex.identification.fit.loss import Loss

ROOT = Path(__file__).parents[2]
SIMULATED = list(simulated())
NAMED = {  # what the first line must name
    "double: relative angles read as absolute": "angles='relative'",
    "double: absolute angles read as relative": "angles='absolute'",
    "double: degrees read as radians": "unit='deg'",
    "double: radians read as degrees": "unit='rad'",
    "double: 0 is up": "zero='up'",
    "double: 0 is level": "turned by 90 degrees",
    "double: zero off by 5 degrees": "off by 5.",
    "double: links in reverse order": "counted from the free end",
    "double: first link to the other side": "link 0 grows to the other side",
    "double: clock x 1.1": "multiplied by 0.909",
    "double: clock x 0.8 (400 for 500 Hz)": "multiplied by 1.25",
    "double: twice the frame rate": "multiplied by 2",
    "double: half the frame rate": "multiplied by 0.5",
    "double: lengths x 1.1": "lengths divided by 1.1",
    "double: a clock that drifts, 2 % too slow at the end": "the clock drifts",
    "double: com held wrong": "'com'",
    "double: inertia held wrong": "'inertia'",
    "double: last link's zero off by 10 degrees": "the zero of link 1 is off by 9.",
    "single: 0 is up": "zero='up'",
    "real double: 0 is up": "0 pointing up",
    "single: half the frame rate": "Check times, frame rate",
    "markers: y points down": "y points the other way",
    "markers: camera turned by 8 degrees": "off by 8.0",
    "markers: scale x 1.1": "check their scale",
    "markers: scale x 1.1, places fitted": "divided by 1.1 (their scale)",
    "real triple: twice the frame rate": "times were to be multiplied by 1.99",
    "real triple: half the frame rate": "as if the frame rate were twice",
    "real double: radians read as degrees": "unit='rad'",
    "real double: last link's zero off by 10 degrees": "the zero of link 1 is off by 10.",
    "rope of 8 links: links in reverse order": "counted from the free end",
    "single: from 1.4 rad, angles x 0.9": "angles multiplied by 1.1",
    "rope of 8 links: half the mass at the tip, held alike": "the rope's mass changes along it",
    "rope of 8 links: bent at rest, held straight": "the rope seems bent at rest",
    "double: one length in cm": "Link 1 is 83.3 times as long as link 0: are all lengths in m?",
    "double: angles x 1.1, default": "angles multiplied by 0.91",
    "markers: the last two swapped from the middle on": "markers 1 and 2 are swapped from t = 3 to",
    "driven: arm's length x 1.2": "the arm were 0.1 m long",
    "driven: stamps 100 ms late": "0.1 s",
}
FIT = (
    "as it is",
    "moves alike",
    "as they are",
    "default",
    "40 % of samples missing",
    "guess off by 3",
)  # must not be refused either


REAL = (
    "real single: as it is",
    "real single: angles x 0.9",
    "real single: zero off by 5 degrees",
    "real single: half the frame rate",
    "real single: clock x 1.1: a pendulum of more inertia",
    "real triple: as it is",
    "real triple: relative angles read as absolute",
    "real triple: degrees read as radians",
    "real triple: radians read as degrees",
    "real triple: 0 is up",
    "real triple: zero off by 5 degrees",
    "real triple: last link's zero off by 10 degrees",
    "real triple: clock x 1.1",
    "real triple: twice the frame rate",
    "real triple: half the frame rate",
    "real triple: a clock that drifts, 2 % too slow at the end",
    "real triple: clock x 1.005 and lengths x 1.01, as clocks and rulers err",
    "real double: as it is",
    "real double: relative angles read as absolute",
    "real double: 0 is up",
    "real double: degrees read as radians",
    "real double: 0 is level",
    "real double: zero off by 5 degrees",
    "real double: first link to the other side",
    "real double: clock x 1.1",
    "real double: lengths x 1.1",
    "real double: clock x 1.005 and lengths x 1.01, as clocks and rulers err",
    "real double: radians read as degrees",
    "real double: last link's zero off by 10 degrees",
    "real double: a clock that drifts, 2 % too slow at the end",
)


def check(case: Case) -> Outcome:
    """Check how a case ends; return that."""
    found = outcome(case)
    assert found.end not in ("WRONG", "WIDE"), found.line
    assert NAMED.get(case.name, "") in found.line
    if case.name.endswith(FIT) and case.name not in NAMED:
        assert found.end in ("right", "suspicion", "cannot be told"), found.line
    return found


@pytest.mark.parametrize("case", SIMULATED, ids=[case.name for case in SIMULATED])
def test_no_wrong_answer_is_called_usable(case: Case) -> None:
    check(case)


@pytest.mark.parametrize("name", REAL)
def test_real_recordings_declared_wrongly(data_dir: Path, name: str) -> None:
    check(next(case for case in real(data_dir) if case.name == name))


UNDETECTABLE = [case for case in SIMULATED if case.undetectable]


@pytest.mark.parametrize("case", UNDETECTABLE, ids=[case.name for case in UNDETECTABLE])
def test_what_cannot_be_told_is_no_suspicion(case: Case) -> None:
    """The right recording gets the same first line: that names nothing."""
    assert outcome(case).end == "cannot be told"
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
def test_another_rope_makes_exactly_the_recording_of_a_wrong_clock(rope: hf.Rope, other: hf.Rope) -> None:
    q0 = np.linspace(0.9, 0.6, rope.n_links)
    t, q = swing(rope, q0, 3.0)
    slower = hf.simulate(other, duration=1.1 * float(t[-1]), t_eval=1.1 * t, q0=q0, tol=1e-9).q
    assert np.abs(slower - q).max() < 1e-6  # ten times what the tolerance leaves


def test_the_page_has_the_rows_of_this_matrix() -> None:
    page = (ROOT / "docs" / "wrong-input.md").read_text("utf-8")
    rows = {cells[0]: cells[1:] for line in page.splitlines() if len(cells := line.strip("| ").split(" | ")) == 3}
    missing = [case.name for case in SIMULATED if case.name not in rows] + [name for name in REAL if name not in rows]
    assert missing == [], "python -m benchmarks.wrong_input --data FOLDER"
    assert [name for name, (end, _) in rows.items() if end in ("WRONG", "WIDE")] == []
    assert [name for name, words in NAMED.items() if words not in rows[name][1]] == []
    undetectable = {case.name for case in SIMULATED if case.undetectable}
    told = {name for name, (end, _) in rows.items() if end == "cannot be told" and not name.startswith("real")}
    assert told == undetectable
    held, count = (int(re.search(words, page)[1]) for words in (r"as they are (\d+) do", r"Of the (\d+) intervals"))  # type: ignore[index]
    assert 0.9 * count <= held <= count


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
def test_what_counts_as_right(changed: dict[str, Any], end: str) -> None:
    right = next(case for case in SIMULATED if case.name == "single: as it is")
    assert outcome(replace(right, right=right, **changed)).end == end


def test_a_suspicion_is_of_the_true_cause() -> None:
    """A clock and lengths that are off, told as the length, count; the same words for another cause do not."""
    case = next(case for case in SIMULATED if case.name == "driven: lengths x 0.99")
    case = replace(case, truth={name: 2.0 * value for name, value in ratios(DOUBLE).items()})
    assert outcome(case).end == "suspicion"
    assert outcome(replace(case, name="driven: com held wrong")).end == "WRONG"


def test_causes_are_those_of_cases() -> None:
    named = {case.wrong for case in SIMULATED}
    assert set(CAUSES) <= named


def test_a_recording_shorter_than_a_usual_window_is_looked_at_as_well() -> None:
    rod = hf.Rope([2.0], [0.1], friction=1e-3)
    t = np.linspace(0.0, 1.0, 101)
    swing = hf.Recording(t, hf.simulate(rod, duration=1.0, t_eval=t, q0=[0.8]).q)
    left, _ = ShortFit(rod, ["friction"], None, None, None, None, Loss("squares"))(swing)
    assert left < 1e-5


@pytest.mark.parametrize(
    ("free", "angle", "left"),
    [
        (("gravity_angle",), 0.7, 0.2),
        (("gravity_angle",), -0.7, 0.2),
        (("gravity_angle",), 0.9, np.inf),  # beyond 45 degrees
        (("gravity_angle",), -2.0, np.inf),
        (("gravity_angle",), np.pi, np.inf),
        (("inertia",), np.pi, 0.2),
    ],
)
def test_a_declaration_that_turns_gravity_explains_nothing(free: tuple[str, ...], angle: float, left: float) -> None:
    """With its direction free all zeros of the angles fit alike, each with another direction."""

    class Fit:
        def __init__(self) -> None:
            self.free = free

        def __call__(self, _: object, names: tuple[str, ...] = ()) -> tuple[float, tuple[float, ...]]:
            return 0.2, tuple(angle for _ in names)

    assert _upright(None, Fit()) == left  # type: ignore[arg-type]
