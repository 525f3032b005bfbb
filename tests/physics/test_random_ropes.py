"""Some of the ropes of benchmarks/robustness.py, those of few links: each keeps its tolerance, and none fails."""

from __future__ import annotations

import pytest

from tests.reference.judging import judge
from tests.reference.random_ropes import draw

COUNT = 60
MOST_LINKS = 25


@pytest.mark.parametrize("number", range(COUNT))
def test_a_random_rope_keeps_its_tolerance(number: int) -> None:
    case = draw(2, number, MOST_LINKS)
    verdict = judge(case.setup, number)
    # `promise` is the error in units of 3 tol (1 + t / 20 ms) growth, see judging.py: no more than 1 is met.
    assert verdict.outcome == "met", (verdict, case.kind)
