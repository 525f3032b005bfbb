"""An unknown common factor, and parameters at 0 with it."""

import numpy as np
import pytest

from hyperflex.identification import FitOptions, Identification, Kind, identify
from hyperflex.identification.model import Parameters, in_common_factor, parse, scaling
from hyperflex.identification.uncertainty.covariance import of_ratios
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from tests.identification.twins import WHOLE

TRUE = Rope(length=[0.17, 0.23], mass=[0.21, 0.16], com=[0.11, 0.09], inertia=[6e-4, 8e-4], friction=[1.2e-3, 0.0])
FREE = ["inertia", "com", "friction"]


@pytest.fixture(scope="module")
def recording() -> Recording:
    t = np.arange(151) * 0.02
    swing = simulate(TRUE, duration=3.0, t_eval=t, q0=[0.6, 0.9]).q
    return Recording(t, swing + 4e-3 * np.random.default_rng(3).standard_normal(swing.shape), noise=4e-3)


def guessed(recording: Recording, factor: float) -> Identification:
    guess = TRUE.replace(mass=TRUE.mass * factor, inertia=1.3 * factor * TRUE.inertia, friction=1e-3 * factor)
    return identify(recording, guess, FREE, options=WHOLE)


def test_what_is_at_0_beside_an_unknown_factor_has_no_interval_of_its_own(recording):
    one, ten = guessed(recording, 1.0), guessed(recording, 10.0)
    for found in (one, ten):
        assert found.values["friction"][1] == 0.0
        assert np.isinf(found.std["friction"]).all()
        alone = found.intervals["friction[1]"]
        assert (alone.low, alone.high, alone.kind, alone.ends) == (0.0, np.inf, "unknown", ("bound", "open"))
        ratio = found.intervals["c/p1[1]"]
        assert (ratio.low, ratio.ends[0]) == (0.0, "bound")
        assert np.isfinite(ratio.high)
        assert found.has(Kind.COMMON_FACTOR)
    # the mass that was guessed is no part of a ratio; 1 %: where either fit stops
    assert ten.intervals["c/p1[1]"].high == pytest.approx(one.intervals["c/p1[1]"].high, rel=0.01)


def test_what_grows_with_the_common_factor():
    free = ["inertia", "com", "friction", "gravity_angle"]
    parameters = Parameters(TRUE, parse(TRUE, free))
    common = scaling(parameters, parameters.start)
    assert common[parameters.labels.index("friction[1]")] == 0.0  # 0 times any factor
    found = in_common_factor(parameters, parameters.start, common[:, None])
    grow = [name for name, each in zip(parameters.labels, found, strict=True) if each]
    assert grow == ["inertia[0]", "inertia[1]", "friction[0]", "friction[1]"]
    assert not in_common_factor(parameters, parameters.start, np.eye(7)[:, 6:]).any()  # only gravity_angle is unknown


def test_ratios_end_at_0_where_they_cannot_be_negative():
    values = {"J/p1": np.array([0.1]), "p/p1": np.array([0.1]), "c/p1": np.array([0.0])}
    stds, none = ({name: np.array([std]) for name in values} for std in (1.0, 0.0))
    found = of_ratios(values, stds, none, np.inf)
    assert found["J/p1[0]"].low == found["c/p1[0]"].low == 0.0
    assert found["J/p1[0]"].ends == found["c/p1[0]"].ends == ("bound", "crossed")
    assert found["p/p1[0]"].low < -1.0  # a centre of mass may lie behind its joint
    assert found["c/p1[0]"].high == pytest.approx(1.96, abs=0.01)  # the normal quantile


def test_what_was_declared_has_no_students_doubt():
    """The half interval of a length known to 1 % is 1.96 %, for any number of values that determine the noise."""
    value, std = {"J/p1": np.array([1.0])}, {"J/p1": np.array([0.01])}
    widths = [of_ratios(value, std, {"J/p1": np.array([part])}, 1.0)["J/p1[0]"].high - 1.0 for part in (0.0, 0.01)]
    assert widths == pytest.approx([0.127, 0.0196], rel=0.01)  # Student's quantile with one degree of freedom is 12.7


def test_what_held_centres_of_mass_change_is_what_a_fit_with_others_finds():
    """1 % of each: a linear estimate, so 3 % of it; noise is 50 times smaller than its effect."""
    t = np.arange(300) / 30.0
    true = TRUE.replace(friction=1e-3)
    swing = simulate(true, duration=10.0, t_eval=t, q0=[0.9, 1.2]).q
    seen = Recording(t, swing + 1e-4 * np.random.default_rng(0).standard_normal(swing.shape))
    options = FitOptions(intervals=None, length_std=1e-6, clock_std=1e-6)

    def found(com):
        return identify(seen, true.replace(com=com), ["inertia", "friction"], options=options)

    held = found(true.com)
    (scale,) = [each for each in held.findings if each.kind is Kind.HELD_SCALE]
    moved = [found(true.com * (1.0 + 0.01 * row)).ratios["J/p1"] / held.ratios["J/p1"] - 1.0 for row in np.eye(2)]
    assert scale.values["moved"] == pytest.approx(np.abs(moved).max(), rel=0.03)
