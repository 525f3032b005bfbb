"""What a fit's misfit comes from: the cause that explains most is named first, with what explains the same."""

from collections.abc import Sequence

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE, FREE, noisy, swing

import hyperflex as hf
from hyperflex.identification import Kind
from tests.identification.twins import QUICK

GUESS = DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4)


def fitted(true: hf.Rope, guess: hf.Rope, free: Sequence[str], clock: float = 1.0) -> hf.Identification:
    t, q = swing(true, np.linspace(0.9, 0.6, true.n_links))
    return hf.identify(hf.Recording(clock * t, noisy(q)), guess, free, options=QUICK)


def causes(found: hf.Identification) -> tuple[hf.identification.Finding, ...]:
    assert found.grade == "do not use"
    return found.findings


@pytest.mark.nightly
def test_friction_held_three_times_too_large_is_named_first():
    """It moves no ratio of moments and inertias, but that of friction over a moment that is free."""
    guess = GUESS.replace(friction=3.0 * DOUBLE.friction)
    for free in (["inertia", "com"], ["inertia"]):  # in the second other masses explain nearly the same
        first = causes(fitted(DOUBLE, guess, free))[0]
        assert first.gain > 0.9
        assert any("'friction'" in each for each in (first.values["name"], *first.values["alike"]))


def test_inertia_held_wrong_is_named_beside_what_explains_the_same():
    first = causes(fitted(DOUBLE, DOUBLE.replace(inertia=1.03 * DOUBLE.inertia, drag=0.01), ["drag", "friction"]))[0]
    named = str([first.values["name"], *first.values["alike"]])
    assert "'inertia'" in named
    assert "'com'" in named


@pytest.mark.nightly
def test_a_wrong_clock_is_reported_with_omitted_drag():
    found = causes(fitted(DOUBLE.replace(drag=0.15), GUESS, FREE, clock=1.02))
    clock = next(each for each in found if each.kind is Kind.CLOCK)
    assert clock.values["clock"] == pytest.approx(0.98, abs=0.005)
    assert clock.values["freed_with"] == ["'drag'"]
    assert "'drag'" in [each.values.get("name") for each in found]


@pytest.mark.nightly
def test_drag_is_found_though_little_of_it_shows_where_there_is_none():
    """To first order it explains less than a third, and nearly all once it is free."""
    chain = hf.Rope.uniform(length=1.0, mass=0.05, n_links=4, friction=3e-4, drag=0.05, dry_friction=3e-4)
    found = fitted(
        chain, chain.replace(drag=0.0, dry_friction=0.0, friction=6e-4), ["inertia:shared", "friction:shared"]
    )
    assert causes(found)[0].values["name"] == "'drag'"
    assert not found.has(Kind.LINKS_TOO_LONG)


@pytest.mark.nightly
def test_deviations_grow_with_a_clock_that_is_off_also_beside_a_drag_of_nearly_nothing(data_dir):
    """A drag that cannot become negative does not prevent the other values from following gravity."""
    part = hf.read_recording(data_dir / "multiarm_triple" / "TriplePendulumDataForParameterEstimation.mat").window(
        22.0, 30.0
    )
    part, guess = part.decimate(5), hf.Rope(length=[0.1727, 0.2286, 0.2413], mass=0.1, friction=1e-4, drag=0.1)
    inertia = np.array([0.1687, 0.1644, 0.0377])  # over p1, by other parts of the recording
    stds = []
    for clock in (1.005, 1.01):
        found = hf.identify(hf.Recording(clock * part.t, part.data), guess, [*FREE, "drag"], options=QUICK)
        stds.append(found.ratio_std["J/p1"])
        assert (np.abs(found.ratios["J/p1"] - inertia) < 2.0 * stds[-1]).all()
    assert (stds[1] > stds[0]).all()


def test_a_wrong_clock_is_reported_with_a_wrong_fixed_mass():
    """Each explains a quarter of what they leave together, which is 1.5 % of a tumbling motion, and no noise."""
    true = hf.Rope(length=[0.0917, 0.0701], mass=[0.05, 0.02], com=[0.046, 0.035], friction=[2e-5, 6e-6])
    t = np.arange(1001) / 100.0
    run = hf.simulate(true, duration=10.0, t_eval=t, q0=[3.0, 2.5], qd0=[5.0, -8.0], tol=1e-8)
    places = run.joints.reshape(t.size, -1)
    seen = hf.Recording(t / 0.93, noisy(places, 2e-4), kind="markers")
    found = hf.identify(seen, true.replace(mass=[0.05, 0.03], friction=1e-5), options=QUICK)
    (clock,) = [each for each in causes(found) if each.kind is Kind.CLOCK]
    assert clock.values["clock"] == pytest.approx(0.93, abs=0.005)
    assert clock.values["freed_with"] in (["'mass'"], ["'com'"])


@pytest.mark.nightly
def test_a_wrong_frame_rate_of_a_real_recording_is_reported_with_wrong_masses(data_dir):
    run = hf.read_recording(data_dir / "ibm_double_pendulum/run06_500Hz.csv", time_unit="s", unit="m", y_axis="up")
    part = run.window(0.0, 10.0)
    guess = hf.Rope(length=[0.0917, 0.0701], mass=[0.05, 0.03], com=[0.046, 0.035], friction=1e-5)
    found = hf.identify(hf.Recording(1.25 * part.t, part.data, kind="markers"), guess)
    first = causes(found)[0]
    assert first.kind is Kind.CLOCK
    assert first.values["clock"] == pytest.approx(0.8, abs=0.01)


def test_an_origin_that_is_wrong_is_named_for_a_marker_alone():
    """5 mm off a string of 0.6 m; across the string positions show it, along it the marker's distance may be the
    cause."""
    rope = hf.Rope(length=[0.6], mass=[0.07], com=[0.6], inertia=[1e-6], friction=2e-4)
    t = np.arange(400) / 30.0
    run = hf.simulate(rope, duration=float(t[-1]), t_eval=t, q0=[0.4], tol=1e-8)
    seen = hf.Recording(t, noisy(run.joints[:, 1] + [0.3, 0.8], 1e-3), kind="markers")
    for x in (0.305, 0.3):
        setup = hf.RecordingSetup(arc_lengths=[0.6], origin=(x, 0.8))
        found = hf.identify(seen, rope, setup=setup, options=QUICK)
        named = [each.values for each in found.findings if each.values.get("name") == "'origin_x'"]
        assert len(named) == (x != 0.3)
    assert found.grade == "usable for ratios"


@pytest.mark.parametrize("noise", [0.0, pytest.param(1e-8, marks=pytest.mark.nightly)])
def test_data_as_exact_as_the_simulation_are_a_fit_that_has_converged(noise):
    """Its minimum is rough by rounding, so no step gains as much as the linear model predicts."""
    true = hf.Rope(length=[0.3, 0.25], mass=[0.2, 0.12], friction=[5e-4, 3e-4])
    t = np.arange(401) / 100.0
    run = hf.simulate(true, duration=4.0, t_eval=t, q0=[0.6, 0.2], tol=1e-10)
    seen = hf.Recording(t, noisy(run.q, noise))
    found = hf.identify(seen, true.replace(friction=1e-3), options=QUICK)
    assert found.grade == "usable for ratios"
    np.testing.assert_allclose(found.ratios["J/p1"], hf.identification.ratios(true)["J/p1"], rtol=1e-5)
