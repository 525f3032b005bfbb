"""Errors of the lengths, and of links that are too long: in the intervals, and said."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.coverage import KINDS, chords

from hyperflex.errors import InvalidInput
from hyperflex.identification import Identification, identify
from hyperflex.model import Rope, divided
from hyperflex.recording import Recording
from hyperflex.simulation import simulate

LINKS, STIFFNESS = 15, 4.5e-3


def held(found: Identification, truth: dict[str, float]) -> list[str]:
    return [name for name, value in truth.items() if value in found.intervals[name]]


def test_lengths_that_are_one_per_cent_off_are_in_the_intervals() -> None:
    case = KINDS["length"][0](np.random.default_rng([1, 5, 1]))
    whole = {"window": np.inf, "train": np.inf}
    found = identify(case.recording, case.guess, case.free, **whole)
    assert held(found, case.truth) == list(case.truth)
    exact = identify(case.recording, case.guess, case.free, length_std=0.0, **whole)
    assert held(exact, case.truth) == []
    np.testing.assert_array_equal(exact.ratios["J/p1"], found.ratios["J/p1"])
    np.testing.assert_array_equal(exact.covariance, found.covariance)  # of the values, given the lengths
    assert found.settings["length_std"] == 0.01
    with pytest.raises(InvalidInput, match="length_std has the wrong sign"):
        identify(case.recording, case.guess, case.free, length_std=-0.01)


def test_ratios_of_what_was_held_have_no_error() -> None:
    case = KINDS["double"][0](np.random.default_rng(0))
    found = identify(case.recording, case.guess, ["friction"], train=np.inf, intervals=None)
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
    return identify(Recording(t, angles, noise=3e-3), guess, free, train=np.inf)


def test_a_rope_of_more_links_is_told_and_its_stiffness_held() -> None:
    found = fit_of_15_links(pieces=4)
    assert "use more links" in str(found.grade)
    assert found.values["stiffness:factor"] < 0.9 * 0.5  # the links' error: it is found too low
    assert held(found, {"friction:factor": 0.5, "stiffness:factor": 0.5}) == ["friction:factor", "stiffness:factor"]


def test_a_chain_of_just_these_links_is_not_told() -> None:
    found = fit_of_15_links(pieces=1)
    (test,) = (each for each in found.score_tests if each.name == "links")
    assert test.surplus < 1e-6
    assert test.sway > 0.1  # were it a rope
    assert "more links" not in str(found)
    assert found.values["stiffness:factor"] == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize("left_out", [{"drag": 0.02}, {"dry_friction": 4e-4}], ids=["drag", "dry friction"])
def test_a_law_that_was_left_out_is_not_taken_for_links_that_are_too_long(left_out: dict[str, float]) -> None:
    rope = Rope.uniform(length=1.0, mass=0.1, n_links=8, friction=4e-4)
    t = np.arange(120) / 30.0
    run = simulate(rope.replace(**left_out), duration=t[-1], t_eval=t, q0=np.linspace(0.7, 1.1, 8), tol=1e-8)
    angles = run.q + 3e-3 * np.random.default_rng(0).standard_normal(run.q.shape)
    found = identify(Recording(t, angles, noise=3e-3), rope, ["friction:shared"], train=np.inf, intervals=None)
    (test,) = (each for each in found.score_tests if each.name == "links")
    assert test.surplus < 0.5
    assert "more links" not in str(found)
