"""Angles that are read too large or too small: named as that, and not as a clock that drifts or a spring."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE, FREE, SINGLE, Array, noisy, swing

import hyperflex as hf
from hyperflex.identification import Kind
from hyperflex.identification.declarations.held import DRIFT
from hyperflex.identification.model import ANGLES
from tests.identification.twins import QUICK
from tests.refusals import refuses

GUESS = SINGLE.replace(inertia=1e-3, friction=5e-4)


def told(found: hf.Identification) -> float:
    """The factor that the first line names."""
    assert found.grade == "do not use"
    own = [each.values["factor"] for each in found.findings if each.kind is Kind.ANGLE_SCALE]
    return own[0] if own else named(found, "scale of the angles")


def named(found: hf.Identification, kind: str) -> float:
    """Return the value of what explains as much as the first finding."""
    return float(found.findings[0].values["alike"][kind])


def real_single(data_dir: Path, factor: float = 1.0, drift: float = 0.0) -> tuple[Array, Array, hf.Rope]:
    """Eight seconds of a real pendulum of J/p1 = 0.1529 m, its angles and its clock, and a guess."""
    path = data_dir / "multiarm_single" / "SinglePendulumDataForParameterEstimation.mat"
    part = hf.read_recording(path).window(0.0, 8.0).decimate(5)
    return part.t * (1.0 + drift * part.t / part.t[-1]), factor * part.data, hf.Rope([0.3], 0.1, friction=1e-4)


@pytest.mark.parametrize("factor", [0.9, 1.1])
@pytest.mark.parametrize("free", [["inertia", "friction"], None], ids=["named", "default"])
@pytest.mark.nightly
def test_a_real_pendulum_read_too_small_or_too_large(data_dir, factor, free):
    t, q, guess = real_single(data_dir, factor)
    found = hf.identify(hf.Recording(t, q), guess, free, options=QUICK)
    assert told(found) == pytest.approx(1.0 / factor, rel=0.01)
    assert not found.has(Kind.DRIFT)
    assert ANGLES not in found.settings["free"]


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_pendulum_read_too_small_or_too_large(factor):
    """Noise hides most of it, and J/p1 is 2 % off; a spring only makes a pendulum faster, and does the same then."""
    t, q = swing(SINGLE, [1.0])
    found = hf.identify(hf.Recording(t, factor * noisy(q)), GUESS, ["inertia", "friction"], options=QUICK)
    assert told(found) == pytest.approx(1.0 / factor, rel=0.01)
    assert ("stiffness" in str(found.findings[0].values)) == (factor > 1.0)


def test_a_clock_that_drifts_keeps_its_name(data_dir):
    t, q, guess = real_single(data_dir, drift=0.02)
    found = hf.identify(hf.Recording(t, q), guess, ["inertia", "friction"], options=QUICK)
    assert found.findings[0].kind is Kind.DRIFT
    gains = {each.name: each.gain for each in found.score_tests}
    assert gains[DRIFT] > gains[ANGLES]


def test_a_spring_keeps_its_name():
    """One of a single pendulum does exactly, to third order in the angle, what angles read too large do."""
    t, q = swing(DOUBLE.replace(stiffness=[0.02, 0.01]), [0.9, 0.6])
    guess = DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4)
    found = hf.identify(hf.Recording(t, noisy(q)), guess, FREE, options=QUICK)
    assert found.findings[0].values["name"] == "'stiffness'"
    t, q = swing(SINGLE.replace(stiffness=0.02), [1.0])
    found = hf.identify(hf.Recording(t, noisy(q)), GUESS, ["inertia", "friction"], options=QUICK)
    first = found.findings[0]
    assert {first.kind} | set(first.values["alike"]) >= {Kind.ANGLE_SCALE, "'stiffness'"}  # which is first, noise tells


@pytest.mark.parametrize("more", [[], pytest.param(["gravity_angle"], marks=pytest.mark.nightly)])
def test_a_stiffness_that_was_freed_may_be_angles_read_too_large(data_dir, more):
    """J/p1 would be 17 % off, by nine standard deviations."""
    t, q, guess = real_single(data_dir, 1.1)
    found = hf.identify(hf.Recording(t, q), guess, ["inertia", "friction", "stiffness", *more], options=QUICK)
    assert found.findings[0].kind is Kind.SPRING_OR_ANGLES
    assert found.findings[0].values["factor"] == pytest.approx(0.91, abs=0.02)
    assert not found.has(Kind.CLOCK)


def test_places_have_no_such_factor_and_none_can_be_free():
    t, q = swing(DOUBLE, [0.9, 0.6], 3.0)
    places = np.stack([DOUBLE.joints(row, np.zeros(2)) for row in q]).reshape(t.size, -1)
    found = hf.identify(hf.Recording(t, noisy(places, 5e-4), kind="markers"), DOUBLE, FREE, options=QUICK)
    assert ANGLES not in {each.name for each in found.score_tests}
    refuses("unknown name", hf.identify, hf.Recording(t, q), DOUBLE, [*FREE, ANGLES])
