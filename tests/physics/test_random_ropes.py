"""Some of the ropes of benchmarks/robustness.py, those of few links: each keeps its tolerance, and none fails."""

import pytest

from tests.reference.judging import drift, judge
from tests.reference.random_ropes import draw, draw_stuck

COUNT = 60
MOST_LINKS = 25


@pytest.mark.parametrize("number", range(COUNT))
def test_a_random_rope_keeps_its_tolerance(number):
    case = draw(2, number, MOST_LINKS)
    verdict = judge(case.setup, number)
    # `promise` is the error in units of 3 tol (1 + t / 20 ms) growth, see judging.py: no more than 1 is accurate.
    assert verdict.outcome == "accurate", (verdict, case.kind)


@pytest.mark.parametrize("number", [12, 180, 301, 332])
def test_a_rope_that_went_wrong_once_keeps_its_tolerance(number):
    """Printed friction whose modes were not found (12, 180), ties of rounding (301), a turn within a step (332)."""
    case = draw(1, number)
    verdict = judge(case.setup, number)
    assert verdict.outcome == "accurate", (verdict, case.kind)


@pytest.mark.parametrize("number", range(6))
def test_a_rope_below_its_friction_stays_where_it_is(number: int) -> None:
    # a stuck joint is not integrated, so nothing can add up in the ten seconds; a microradian is allowed
    assert drift(draw_stuck(2, number, MOST_LINKS).setup) < 1e-6
