"""Windows that disagree: a clock that drifts, and estimates that scatter."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE, FREE, SINGLE, Array, noisy, swing
from scipy.special import gammaincc

import hyperflex as hf
from hyperflex.identification import Kind
from hyperflex.identification.declarations.held import DRIFT
from hyperflex.identification.declarations.score_tests import Scores
from tests.identification.twins import QUICK

GUESS = DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4)


def identified(t: Array, q: Array, guess: hf.Rope = GUESS, free: tuple[str, ...] | None = FREE) -> hf.Identification:
    return hf.identify(hf.Recording(t, noisy(q)), guess, free, options=QUICK)


def in_turn(ropes: list[hf.Rope], q0: list[float], duration: float) -> tuple[Array, Array]:
    """A recording of ropes one after the other, each from where the one before was."""
    t = np.arange(round(50.0 * duration)) / 50.0
    cuts = np.linspace(0, t.size - 1, len(ropes) + 1).astype(int)
    parts, q, rates = [], np.array(q0), np.zeros(len(q0))
    for rope, begin, end in zip(ropes, cuts[:-1], cuts[1:], strict=True):
        part = t[begin : end + 1] - t[begin]
        run = hf.simulate(rope, duration=part[-1], t_eval=part, q0=q, qd0=rates, tol=1e-9)
        parts.append(run.q[:-1])
        q, rates = run.q[-1], run.qd[-1]
    return t, np.vstack([*parts, q])


def drift(found: hf.Identification) -> float:
    return float(next(each.values[0] for each in found.score_tests if each.name == DRIFT))


def test_a_zero_that_is_off_is_no_clock_that_drifts():
    """Windows of large swings ask for another gravity than those of small ones, until the zero is off there as well."""
    t, q = swing(DOUBLE, [0.9, 0.6])
    found = identified(t, q + 0.025)
    assert drift(found) == pytest.approx(0.0, abs=0.005)
    assert not found.has(Kind.DRIFT)
    assert found.findings[0].kind is Kind.ZERO
    assert np.degrees(found.findings[0].values["angle"]) == pytest.approx(1.4, abs=0.1)


def test_a_clock_that_drifts_is_no_stiffness():
    t, q = swing(SINGLE, [1.0], 20.0)
    found = identified(t + 0.0025 * t**2 / t[-1], q, SINGLE.replace(inertia=1e-3, friction=5e-4), None)
    assert found.settings["free"] == ["inertia", "friction"]
    assert any(each.startswith("drifting clock") for each in found.findings[0].values["alike"])  # much like a spring


def test_a_drift_that_hardly_moves_ratios_is_in_their_deviations():
    t, q = swing(DOUBLE, [0.9, 0.6], 6.0)
    found = identified(t + 0.005 * t**2 / t[-1], q)
    assert found.grade == "usable for ratios"
    assert found.findings[0].kind is Kind.DRIFT
    assert found.findings[0].values["drift"] == pytest.approx(0.0075, abs=5e-4)
    off = np.abs(found.ratios["J/p1"] - hf.identification.ratios(DOUBLE)["J/p1"])
    assert (off < 2.0 * found.ratio_std["J/p1"]).all()


def test_windows_that_tell_less_and_less_disagree_by_chance_as_rarely_as_said():
    """The statistic of parts of a motion that dies away, of two unknowns, by fits to white noise."""
    rng, parts = np.random.default_rng(0), np.repeat(np.arange(6), 40)
    size = np.sqrt(np.array([0.26, 0.31, 0.24, 0.13, 0.04, 0.01]))[parts]
    slopes = size[:, None] * np.column_stack([np.sin(np.arange(240.0)), parts + np.cos(np.arange(240.0))])
    each_part = [parts == k for k in range(6)]
    noise = rng.standard_normal((20_000, 240))
    left = noise - noise @ slopes @ np.linalg.pinv(slopes)
    information = np.array([slopes[rows].T @ slopes[rows] for rows in each_part])
    found = Scores(None, np.zeros(2), {}, [0, 1], np.ones(2), np.zeros((6, 2)), information, np.arange(6.0), 1.0)
    slope, inverse = np.array([1.0, 0.3]), found.inverse([0, 1])
    scores = np.stack([left[:, rows] @ slopes[rows] for rows in each_part], axis=1)
    several = [replace(found, score=score).moves(slope, inverse) for score in scores]
    _, expected, freedom = several[0]
    squares = np.array([each @ each for each, _, _ in several]) / (slope @ inverse @ slope)
    assert squares.mean() == pytest.approx(expected, rel=0.03)  # of 20 000 draws: 0.6 %
    rare = gammaincc(0.5 * freedom, 0.5 * freedom * squares / expected)
    assert (rare < 0.05).mean() == pytest.approx(0.05, abs=0.01)
    assert (rare < 1e-3).mean() == pytest.approx(1e-3, abs=7e-4)  # W - 1 = 5 degrees of freedom make it 3e-3


@pytest.mark.parametrize("seed", range(2))
def test_a_clock_that_does_not_drift_is_not_reported(seed):
    t, q = swing(DOUBLE, [0.9, 0.6], 12.0)
    found = hf.identify(hf.Recording(t, noisy(q, 2e-3, seed)), GUESS, FREE, options=QUICK)
    assert abs(drift(found)) < 2e-3
    assert not found.has(Kind.DRIFT, Kind.WINDOWS_DISAGREE, Kind.RESISTANCE_CHANGES)


def test_windows_of_which_some_show_another_rope_are_reported():
    other = DOUBLE.replace(com=[0.14, 0.143])
    found = identified(*in_turn([DOUBLE, other, DOUBLE], [0.9, 0.6], 12.0))
    assert found.grade == "do not use"
    first = found.findings[0]
    assert (first.kind, first.values["label"]) == (Kind.WINDOWS_DISAGREE, "p/p1[1]")
    assert found.ratio_std["p/p1"][1] > 0.018 * found.ratios["p/p1"][1]  # as far as its windows scatter


def test_friction_that_changes_is_a_model_error():
    other = SINGLE.replace(friction=6e-4)
    found = identified(
        *in_turn([SINGLE, other, SINGLE], [1.0], 24.0), SINGLE.replace(inertia=1e-3), ("inertia", "friction")
    )
    assert found.grade == "usable for ratios"
    assert [each.values["label"] for each in found.findings if each.kind is Kind.RESISTANCE_CHANGES] == ["c/p1[0]"]


def test_fixed_parameters_are_reported():
    t, q = swing(DOUBLE, [0.9, 0.6], 4.0)
    found = identified(t, q, DOUBLE, ("friction[1]",))
    assert found.held == ("friction[0]", "J/p1", "p/p1", "c/p1[0]")
    assert found.has(Kind.HELD_VALUES)
    assert found.summary()["held"] == list(found.held)
    assert identified(t, q, DOUBLE, FREE).held == ()
