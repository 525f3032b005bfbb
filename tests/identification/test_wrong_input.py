"""Wrong and poor inputs: none converges to a wrong answer that is called usable."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.wrong_input import Case, outcome, real, simulated

import hyperflex as hf
from hyperflex.identification.diagnosis.declarations import ShortFit
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
    "double: first link to the other side": "link 0 grows to the other side",
    "double: clock x 1.1": "multiplied by 0.909",
    "double: clock x 0.8 (400 for 500 Hz)": "multiplied by 1.25",
    "double: twice the frame rate": "multiplied by 2",
    "double: half the frame rate": "multiplied by 0.5",
    "double: lengths x 1.1": "lengths divided by 1.1",
    "double: a clock that drifts, 2 % too slow at the end": "the clock drifts",
    "double: com held wrong": "'com'",
    "double: inertia held wrong": "'inertia'",
    "single: 0 is up": "zero='up'",
    "markers: y points down": "y points the other way",
    "markers: camera turned by 8 degrees": "off by 8.0",
    "rope of 8 links: links in reverse order": "counted from the free end",
}
FIT = (
    "as it is",
    "moves alike",
    "as they are",
    "default",
    "40 % of samples missing",
    "guess off by 3",
)  # must not be refused either


@pytest.mark.parametrize("case", SIMULATED, ids=[case.name for case in SIMULATED])
def test_no_wrong_answer_is_called_usable(case: Case) -> None:
    end, line = outcome(case)
    assert end != "WRONG", line
    assert NAMED.get(case.name, "") in line
    if case.name.endswith(FIT):
        assert end in ("right", "suspicion"), line


@pytest.mark.parametrize("which", [0, 1, 11, 14, 17, 19, 20, 30, 33])
def test_real_recordings_declared_wrongly(data_dir: Path, which: int) -> None:
    case = list(real(data_dir))[which]
    end, line = outcome(case)
    assert end != "WRONG", line
    if case.name.endswith(FIT):
        assert end in ("right", "suspicion"), line


def test_the_page_lists_these_cases() -> None:
    page = (ROOT / "docs" / "wrong-input.md").read_text("utf-8")
    missing = [case.name for case in SIMULATED if f"| {case.name} |" not in page]
    assert missing == [], "python -m benchmarks.wrong_input --data FOLDER"
    assert "WRONG" not in page


def test_a_recording_shorter_than_a_usual_window_is_looked_at_as_well() -> None:
    rod = hf.Rope([2.0], [0.1], friction=1e-3)
    t = np.linspace(0.0, 1.0, 101)
    swing = hf.Recording(t, hf.simulate(rod, duration=1.0, t_eval=t, q0=[0.8]).q)
    left, _ = ShortFit(rod, ["friction"], None, None, None, None, Loss("squares"))(swing)
    assert left < 1e-5
