"""What was declared of a point mass, of lengths and of times, where its moment of inertia is at its bound."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.identification import Grade, Kind
from hyperflex.identification.symptoms import _determined
from hyperflex.identification.uncertainty.covariance import ratios
from tests.identification.twins import QUICK, recorded

LENGTH, NOISE = 0.48, 2e-3  # m, rad
STRING = hf.Rope(length=[LENGTH], mass=[0.08], com=[LENGTH], inertia=[0.0], friction=1e-4)


def string(duration: float, length: float = LENGTH, seed: int = 3) -> tuple[Array, Array]:
    """Times and angles of a point mass on a string, with linear and quadratic drag, at 40 frames/s."""
    t = np.arange(round(40 * duration)) / 40.0

    def slope(_: float, y: Array) -> list[float]:
        return [y[1], -9.81 / length * np.sin(y[0]) - (0.015 + 0.008 * abs(y[1])) * y[1]]

    angle = solve_ivp(slope, (0.0, duration), [0.3, 0.0], t_eval=t, rtol=1e-10, atol=1e-12).y[0]
    return t, angle + NOISE * np.random.default_rng(seed).standard_normal(t.size)


@pytest.mark.parametrize("free", [pytest.param(None, marks=pytest.mark.nightly), ["inertia", "friction"]])
def test_a_declared_centre_of_mass_that_would_move_far_contradicts_the_clock(free: list[str] | None) -> None:
    """24 frames/s declared as 30: J/p1 would be 0.64 of the truth, with a com of 0.64 of the declared one."""
    t, angle = string(12.0)
    found = hf.identify(hf.Recording(t * 24.0 / 30.0, angle[:, None]), STRING, free)
    assert found.grade is Grade.DO_NOT_USE
    first = found.findings[0]
    assert first.kind is Kind.COM_OR_CLOCK
    assert not found.has(Kind.UNTESTED)  # which would contradict that
    assert first.values["clock"] == pytest.approx(1.25, rel=5e-3)  # quadratic drag, noise: 1.2497
    assert "times must be multiplied by 1.25" in found.report()


def test_a_freed_length_far_from_the_declared_one_is_no_answer():
    """Frames at 0.93 of their times' rate: the string seems 1 / 0.93^2 times as long."""
    t, angle = string(12.0)
    found = hf.identify(hf.Recording(t / 0.93, angle[:, None]), STRING, ["length", "friction", "drag"])
    assert found.grade is Grade.DO_NOT_USE
    (first,) = [each for each in found.findings if each.kind is Kind.LENGTH_OR_CLOCK]
    assert first.values["clock"] == pytest.approx(0.93, abs=2e-3)
    far, unsure = STRING.replace(length=[1.2 * LENGTH], com=[1.2 * LENGTH]), hf.FitOptions(length_std=0.2)
    told = hf.identify(hf.Recording(t, angle[:, None]), far, ["length", "friction", "drag"], options=unsure)
    assert told.grade is Grade.RATIOS
    assert LENGTH in told.intervals["length[0]"]
    assert told.std["length"][0] < 0.011 * LENGTH  # by clock_std alone: 1 %


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.nightly)])
def test_a_clock_within_what_was_declared_is_no_fault_at_a_bound(seed: int) -> None:
    """A clock 0.3 % short: J/p1 seems less than a point mass can have, by 0.6 %, within clock_std of 0.5 %."""
    t, angle = string(10.0, seed=seed)
    found = hf.identify(hf.Recording(t / 1.003, angle[:, None]), STRING, ["inertia", "friction"])
    assert found.grade is Grade.RATIOS
    assert not found.has(Kind.ANGLE_SCALE, Kind.CLOCK, Kind.COM_OR_CLOCK)
    assert LENGTH in found.intervals["J/p1[0]"]
    # by clock_std alone: 1 % of J/p1; the declared length tells no more than 1.4 %
    assert found.ratio_std["J/p1"][0] == pytest.approx(0.01 * LENGTH, rel=0.2)
    most = 0.08 * LENGTH**2  # all that com and clock may hide, in inertia: 1.4 % of it, at two deviations
    assert 0.01 * most < found.intervals["inertia[0]"].high < 0.04 * most


def test_a_rope_without_a_first_moment_has_no_ratios_and_warns_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = ratios(STRING.replace(com=[0.0], inertia=[1e-3]))
    assert np.isinf(found["J/p1"][0])
    assert np.isnan(found["p/p1"][0])


def test_few_degrees_of_freedom_count_when_a_value_is_poorly_determined() -> None:
    """A std of 10 % is an interval of 20 % to either side with many, and of 43 % with two (Student's t: 4.3)."""
    t, angle = string(4.0, length=1.05 * LENGTH)
    basis = hf.identify(hf.Recording(t, angle[:, None]), STRING, ["inertia", "friction"]).basis
    known, rope = basis.information, basis.plant.parameters.rope(basis.fit.x)
    loose = replace(known, scaled=known.scaled * 100.0, freedom=np.inf)
    assert _determined(replace(basis, information=loose), rope)[0]
    assert not _determined(replace(basis, information=replace(loose, freedom=2.0)), rope)[0]


@pytest.mark.parametrize("declared", [True, False])
def test_a_spring_that_explains_as_much_as_a_declared_com_is_named_beside_it(declared: bool) -> None:
    """Small swings barely distinguish a spring in the first joint from more weight, which gives other ratios."""
    com = [0.12, 0.115] if declared else [0.105, 0.13]
    true = hf.Rope(length=[0.21, 0.26], mass=[0.18, 0.12], com=com, inertia=[7e-4, 8e-4], friction=[9e-4, 4e-4])
    stiff, t = true.replace(stiffness=[0.02, 0.0]), np.arange(600) / 100.0
    seen = recorded(stiff, [0.56, -0.28], t, 3e-3, seed=5, tol=1e-8)
    found = hf.identify(seen, true.replace(inertia=[5e-4, 5e-4], friction=1e-3), options=QUICK)
    (chosen,) = [each for each in found.findings if each.kind is Kind.CHOSEN]
    assert list(chosen.values["added"]) == ["com"]
    assert ("'stiffness'" in found.report()) == declared
