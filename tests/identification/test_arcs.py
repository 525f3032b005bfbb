"""Places of markers along the rope that are not as declared."""

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE, FREE, noisy, swing

from hyperflex.identification import Identification, Kind, RecordingSetup, identify
from hyperflex.model import Rope
from hyperflex.recording import Recording

T, Q = swing(DOUBLE, [0.9, 0.6])
PLACES = np.stack([DOUBLE.joints(each, np.zeros(2))[1:].ravel() for each in Q])  # of the elbow and the tip
GUESS = DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4)


def found(off: float, seed: int, guess: Rope = GUESS) -> Identification:
    recording = Recording(T, noisy(PLACES, 3e-4, seed), kind="markers")
    return identify(recording, guess, FREE, setup=RecordingSetup(arc_lengths=[0.3 + off, 0.55], origin=(0.0, 0.0)))


@pytest.mark.parametrize("off", [0.003, pytest.param(0.006, marks=pytest.mark.nightly), -0.004])
def test_one_that_is_elsewhere_is_reported(off):
    """With the elbow's 1 or 2 % off, ratios were by more than four standard deviations, and nothing was suspected.

    A marker before the elbow moves no ratio, but acts like a scale of its own position: it explains a poor fit.
    """
    result = found(off, 1)
    assert result.grade == "do not use"
    assert result.findings[0].kind is Kind.MARKER_PLACES
    if off < 0.0:
        assert result.findings[0].values["places"] == pytest.approx([300.0, 550.0], abs=0.5)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2, 3))])
def test_those_that_are_as_declared_are_not(seed):
    result = found(0.0, seed)
    assert result.grade == "usable for ratios"
    assert not result.has(Kind.MARKER_PLACES)
