"""Errors of the lengths, and of links that are too long: in the intervals, and said."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.coverage import KINDS, chords
from benchmarks.wrong_input import DOUBLE, FREE, longer, noisy, swing

from hyperflex.errors import InvalidInput
from hyperflex.identification import FitOptions, Identification, Kind, RecordingSetup, identify
from hyperflex.identification.declarations.score_tests import ScoreTest
from hyperflex.identification.uncertainty.covariance import ratios
from hyperflex.identification.uncertainty.model_error import with_model_error
from hyperflex.model import Arm, Rope, divided, parse_label
from hyperflex.motion import arm_swings
from hyperflex.planning import RopePosterior
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from tests.identification.twins import EXACT, QUICK, WHOLE, WHOLE_QUICK

LINKS, STIFFNESS = 15, 4.5e-3


def held(found: Identification, truth: dict[str, float]) -> list[str]:
    return [name for name, value in truth.items() if value in found.intervals[name]]


def test_lengths_that_are_one_per_cent_off_are_in_the_intervals():
    case = KINDS["length"][0](np.random.default_rng([1, 5, 3]))
    whole: dict[str, Any] = {"window": np.inf, "train": np.inf, "clock_std": 0.0}
    found = identify(case.recording, case.guess, case.free, options=FitOptions(**whole))
    assert held(found, case.truth) == list(case.truth)
    exact = identify(case.recording, case.guess, case.free, options=FitOptions(length_std=0.0, **whole))
    assert held(exact, case.truth) == []
    np.testing.assert_array_equal(exact.ratios["J/p1"], found.ratios["J/p1"])
    own = found.length_covariance
    np.testing.assert_allclose(found.covariance - np.outer(own[:-1], own[:-1]) / own[-1], exact.covariance, rtol=1e-6)
    assert not exact.length_covariance.any()
    for length_std in (0.0, 0.01):
        one = identify(
            case.recording, case.guess, ["inertia", "friction"], options=FitOptions(length_std=length_std, **whole)
        )
        stds = [one.std[label.name][label.place or 0] for label in map(parse_label, one.parameters) if label]
        np.testing.assert_allclose(np.sqrt(np.diag(one.covariance)), stds, rtol=1e-12)
    posterior = RopePosterior.from_identification(found)
    drawn = [ratios(posterior.sample(np.random.default_rng([2, k])), found.values) for k in range(300)]
    for name, std in found.ratio_std.items():
        scatter = np.std([each[name] for each in drawn], axis=0)
        np.testing.assert_allclose(scatter, std, rtol=0.2, err_msg=name)  # 300 draws tell it to 4 %
    assert found.settings["length_std"] == 0.01
    with pytest.raises(InvalidInput, match="length_std has the wrong sign"):
        identify(case.recording, case.guess, case.free, options=FitOptions(length_std=-0.01))


@pytest.mark.parametrize("factor", [0.99, 1.0, 1.01])
def test_a_drive_tells_lengths_and_deviations_hold_them(factor):
    """With an arm of known length and motion all lengths 1 % off move unlike any clock; ratios were 2 to 4 sd off."""
    motion, arm = arm_swings(0.7, 0.4, "minimum-jerk"), Arm(length=0.1)
    t, q = swing(DOUBLE, None, motion=motion, arm=arm)
    guess = longer(DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4), factor)
    recording = Recording(t, noisy(q), noise=2e-3)
    found = identify(recording, guess, FREE, setup=RecordingSetup(motion=motion, arm=arm), options=QUICK)
    truth = ratios(DOUBLE)
    assert found.has(Kind.LENGTHS, Kind.CLOCK) == (factor != 1.0)
    assert np.all(np.abs(found.ratios["J/p1"] - truth["J/p1"]) < 1.96 * found.ratio_std["J/p1"])
    assert abs(found.ratios["p/p1"][1] - truth["p/p1"][1]) < 1.96 * found.ratio_std["p/p1"][1]


def test_clock_and_lengths_that_are_off_together_are_in_the_deviations():
    """A longer and slower pendulum moves in exactly the same way; 1 % of lengths and 0.5 % of times are a deviation
    each."""
    case = KINDS["double"][0](np.random.default_rng(3))

    def found(factor, **stds):
        recording = replace(case.recording, t=np.sqrt(factor) * case.recording.t)
        guess = case.guess.replace(length=factor * case.guess.length, com=factor * case.guess.com)
        one = identify(
            recording, guess, case.free, options=FitOptions(train=np.inf, window=np.inf, intervals=None, **stds)
        )
        return float(one.ratios["J/p1"][0]), float(one.ratio_std["J/p1"][0])

    (right, _), (wrong, std), (same, noise) = found(1.0), found(1.01), found(1.01, length_std=0.0, clock_std=0.0)
    assert wrong == same == pytest.approx(1.01 * right, rel=1e-4)
    added = np.sqrt(std**2 - noise**2) / wrong
    assert 0.01 / np.sqrt(2.0) < added < 0.01 * np.sqrt(1.5)  # what the data do not tell, and all
    for exact in ({"length_std": 0.0}, {"clock_std": 0.0}):  # what is left is of the other one
        assert np.sqrt(found(1.01, **exact)[1] ** 2 - noise**2) / wrong < added


def test_a_clock_is_in_the_deviation_of_a_single_pendulum():
    """Its inertia goes with the square of the times, its friction with them."""
    case = KINDS["single"][0](np.random.default_rng(4))
    own, more = (
        identify(
            case.recording, case.guess, case.free, options=FitOptions(intervals=None, length_std=0.0, clock_std=std)
        )
        for std in (0.0, 0.01)
    )
    for name, power in (("J/p1", 2.0), ("c/p1", 1.0)):
        added = np.sqrt(more.ratio_std[name] ** 2 - own.ratio_std[name] ** 2) / more.ratios[name]
        assert added[0] == pytest.approx(power * 0.01, rel=0.02), name


def test_ratios_of_what_was_held_have_no_error():
    case = KINDS["double"][0](np.random.default_rng(0))
    found = identify(case.recording, case.guess, ["friction"], options=WHOLE_QUICK)
    assert (found.ratio_std["J/p1"] == 0.0).all()


def fit_of_15_links(pieces: int) -> Identification:
    """A rope of 15 links, or one whose links are cut into pieces, seen by the directions of 15 chords."""
    chain = Rope.uniform(length=1.0, mass=0.1, n_links=LINKS, friction=2e-4, stiffness=STIFFNESS)
    chain = chain.replace(stiffness=np.append(0.0, np.full(LINKS - 1, STIFFNESS)))
    true = divided(chain, pieces)
    t = np.arange(90) / 30.0
    run = simulate(true, duration=t[-1], t_eval=t, q0=np.linspace(0.9, 1.3, true.n_links), tol=1e-8)
    angles = chords(run.joints[:, ::pieces], np.random.default_rng(0), 3e-3)
    guess = chain.replace(friction=4e-4, stiffness=2.0 * chain.stiffness)
    free = ["friction:factor", "stiffness:factor"]
    return identify(Recording(t, angles, noise=3e-3), guess, free, options=WHOLE)


def test_a_rope_of_more_links_is_reported_and_its_stiffness_held():
    found = fit_of_15_links(pieces=4)
    assert found.has(Kind.LINKS_TOO_LONG)
    assert found.values["stiffness:factor"] < 0.9 * 0.5  # the links' error: it is found too low
    assert held(found, {"friction:factor": 0.5, "stiffness:factor": 0.5}) == ["friction:factor", "stiffness:factor"]


def test_a_chain_of_just_these_links_is_not_reported():
    found = fit_of_15_links(pieces=1)
    (test,) = (each for each in found.score_tests if each.name == "links")
    assert test.excess_gain < 1e-6
    assert test.ratio_sensitivity > 0.1  # were it a rope
    assert not found.has(Kind.LINKS_TOO_LONG)
    assert found.values["stiffness:factor"] == pytest.approx(0.5, rel=0.03)


def fit_of_four_links(n_links: int, drag: float, free: list[str] | None) -> Identification:
    """Four markers on a rope of `n_links` links, fitted with four."""
    rope = Rope.uniform(length=0.8, mass=0.1, n_links=n_links, friction=1.6e-3 / n_links, drag=drag)
    t = np.arange(400) / 100.0
    run = simulate(rope, duration=t[-1], t_eval=t, q0=np.full(n_links, 0.8))
    places = run.joints[:, n_links // 4 :: n_links // 4].reshape(t.size, -1)
    places = places + 1e-3 * np.random.default_rng(1).standard_normal(places.shape)
    guess = Rope.uniform(length=0.8, mass=0.1, n_links=4, friction=8e-4)
    recording = Recording(t, places, kind="markers")
    return identify(
        recording, guess, free, setup=RecordingSetup(arc_lengths=[0.2, 0.4, 0.6, 0.8], origin=[0.0, 0.0]), options=QUICK
    )


@pytest.mark.nightly
@pytest.mark.parametrize("free", [None, ["inertia:shared", "friction:shared"]], ids=["default", "shared"])
def test_four_links_of_a_rope_of_40_are_reported_before_the_units_are_doubted(free):
    found = fit_of_four_links(40, 0.0, free)
    assert found.grade == "do not use"
    assert found.findings[0].kind is Kind.LINKS_TOO_LONG
    assert found.has(Kind.POOR_FIT)


@pytest.mark.nightly
@pytest.mark.parametrize("drag", [0.0, 0.05])
def test_a_chain_of_just_four_links_is_not_reported(drag):
    found = fit_of_four_links(4, drag, ["inertia", "friction"])
    assert not found.has(Kind.LINKS_TOO_LONG)
    assert all(each.excess_gain < 0.5 for each in found.score_tests if each.name == "links")
    if drag > 0.0:  # which explains far more than stiffness, by which ratios would move more
        first = found.findings[0]
        assert (first.kind, first.values["name"]) == (Kind.RESISTANCE, "'drag'")
        assert first.gain > 0.97
        names = [each.values["name"] for each in found.findings if each.kind is Kind.RESISTANCE]
        assert names.count("'drag'") == 1


@pytest.mark.nightly
def test_links_and_drag_are_reported_together():
    found = fit_of_four_links(40, 0.05, ["inertia:shared", "friction:shared"])
    first = found.findings[0]
    assert (first.kind, first.values["name"]) == (Kind.RESISTANCE, "'drag'")
    assert [each.values["freed_with"] for each in found.findings if each.kind is Kind.LINKS_TOO_LONG] == [["'drag'"]]
    (links,) = (each for each in found.score_tests if each.name == "links")
    assert links.shift.shape == (len(found._basis.fit.x),)
    assert links.freed_with == ("drag",)


def test_links_that_may_be_too_long_count_by_their_probability():
    """Also below what other tests need to count, where residuals are not white."""
    basis = fit_of_four_links(4, 0.0, ["friction:shared"])._basis
    odd = replace(basis, information=replace(basis.information, whiteness=0.0))
    for excess_gain in (0.1, 0.5):
        test = ScoreTest("links", 0.3, np.array([16.0]), shift=np.array([0.2]), excess_gain=excess_gain)
        told = with_model_error(odd, [test], np.zeros(4)).information.model
        assert told == pytest.approx(np.array([[excess_gain * 0.2**2]]))


def test_a_law_that_acts_as_inertia_does_counts_only_if_it_is_sure():
    """A spring of a size that chance gives it left nothing known: ratios 200 times as wide as by noise."""
    case = KINDS["length"][0](np.random.default_rng([1, 5, 3]))
    basis = identify(case.recording, case.guess, case.free, options=EXACT)._basis
    noise = basis.information.covariance
    springs = ScoreTest("stiffness", 0.01, np.ones(1), std=0.01, shift=np.zeros(len(noise)))
    for widths, counts in ((100.0, False), (1.0, True)):
        for excess in (0.8, 0.95):
            law = replace(springs, excess_gain=excess, added=widths**2 * noise)
            model = with_model_error(basis, [law], np.zeros(4)).information.model
            np.testing.assert_allclose(model, (counts or excess > 0.9) * excess * law.added, rtol=1e-9)


@pytest.mark.parametrize("seed", [18, 21])
def test_a_law_that_chance_gives_takes_no_more_than_there_is(seed):
    """If a swing barely decays, laws cannot be distinguished: the uncertainty of friction seemed to be 400 %."""
    random = np.random.default_rng(seed)
    length = random.uniform(0.3, 1.2)
    rope = Rope(length=[length], mass=[0.05], com=[length], inertia=[1e-6], friction=5e-4 * length**2)
    t = np.arange(601) / 30.0
    run = simulate(rope, duration=t[-1], t_eval=t, q0=[random.uniform(0.15, 0.6)], tol=1e-8)
    angles = run.q + 3e-3 * random.standard_normal(run.q.shape)
    found = identify(Recording(t, angles, noise=3e-3), rope.replace(friction=[5e-5]))
    assert all(each.values.min() >= 0.0 for each in found.score_tests if each.name in ("drag", "dry_friction"))
    assert abs(found.ratios["c/p1"][0] / (5e-4 * length / 0.05) - 1.0) < 0.1
    assert found.ratio_std["c/p1"][0] < 0.1 * found.ratios["c/p1"][0]


def test_what_a_law_leaves_less_known_of_a_friction_is_no_more_than_it_is():
    rope = Rope(length=[0.3], mass=[0.1], friction=2e-4)
    t, q = swing(rope, [0.8])
    basis = identify(Recording(t, noisy(q)), rope, options=EXACT)._basis
    size = len(basis.fit.x)
    drag = ScoreTest("drag", 0.1, np.ones(1), std=1.0, shift=np.zeros(size), added=100.0 * np.eye(size))
    model = with_model_error(basis, [replace(drag, excess_gain=0.95)], np.zeros(4)).information.model
    friction = basis.plant.parameters.labels.index("friction[0]")
    assert model[friction, friction] == pytest.approx(0.95 * basis.fit.x[friction] ** 2, rel=1e-6)
