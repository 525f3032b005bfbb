"""Pumping the paper's cable to |x| = 1.8 m, all with the same half turn of the arm: ours against constant rests."""

import numpy as np
import pytest
from benchmarks.pumping_cases import BEST, arrival, closed_loop, constant_arrivals, motion_of

from hyperflex.control import TrueState
from hyperflex.paper import cable, casting_arm

pytestmark = pytest.mark.claims

# The best constant rest of a sweep in steps of 2 ms, s, and its neighbours: the sweep itself is benchmarks/pumping.py.
BEST_CONSTANTS = {"under": np.array([0.482, 0.484, 0.486, 0.488, 0.51]), "over": np.array([0.410, 0.412, 0.414, 0.416])}
ARRIVALS = {"under": 7.29, "over": 7.09}  # s, of the searched rests


@pytest.mark.parametrize("path", ["under", "over"])
def test_free_rests_are_sooner_than_the_papers_rest(path):
    ours = arrival(motion_of(path, BEST[path]))
    assert ours == pytest.approx(ARRIVALS[path], abs=0.02)  # printed with two decimals, sampled every 10 ms
    assert ours < 0.95 * constant_arrivals(path, np.array([0.53]))[0]  # found: 16 % and 38 % sooner


def test_over_the_top_free_rests_are_five_per_cent_sooner_than_the_best_constant_one():
    assert ARRIVALS["over"] < 0.95 * constant_arrivals("over", BEST_CONSTANTS["over"]).min()  # found: 6.7 %


def test_through_the_bottom_they_are_sooner_but_by_less_than_that():
    # 2.2 %. Nothing 5 % sooner was found by global searches of several kinds: benchmarks/pumping_bound.py.
    best = constant_arrivals("under", BEST_CONSTANTS["under"]).min()
    assert ARRIVALS["under"] < 0.985 * best
    assert ARRIVALS["under"] > 0.95 * best


@pytest.mark.parametrize("path", ["under", "over"])
def test_the_closed_loop_is_within_ten_per_cent_of_the_search(path):
    loop = arrival(closed_loop(path, TrueState(cable(), casting_arm())))
    assert loop <= 1.1 * ARRIVALS[path]
