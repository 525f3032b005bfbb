"""Worlds told apart by what was seen: the true one among others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyperflex.planning import Uncertainty
from hyperflex.planning.feedback.belief import Belief
from hyperflex.planning.feedback.simulated_ropes import DrawnWorld
from hyperflex.planning.robust.uncertainty import MOVES
from tests.planning.test_landing import PEG, THROWER, WINDS

LIMITS = THROWER.limits
TRUE = 6


def test_the_true_world_is_told_from_others() -> None:
    """Even if its moves start some milliseconds late, which no world knows."""
    draws = Uncertainty().draws(12, THROWER, PEG, seed=8)
    late = replace(draws[TRUE], late=np.resize([0.0, 2e-3, -1e-3], MOVES))
    motion, source = WINDS.motion(LIMITS), DrawnWorld(late, THROWER.arm)
    belief = Belief(THROWER, draws)
    assert belief.worlds(3) == draws[:3]  # nothing seen yet
    for move in (1, 2, 3):
        now = float(WINDS.starts(LIMITS)[move]) - float(WINDS.rests[move])
        belief.see(source.state(now, motion), motion)
    assert belief.worlds(1) == [draws[TRUE]]
    friction = [draw.rope.friction[1] for draw in draws]
    length = [draw.rope.total_length for draw in draws]
    near = [draws.index(draw) for draw in belief.worlds(4)]
    assert np.abs(np.array(length)[near] - length[TRUE]).mean() < np.abs(np.array(length) - length[TRUE]).mean()
    assert len(set(friction)) == 12


def test_the_error_is_that_of_the_predicted_place_and_nothing_is_counted_twice() -> None:
    (draw,) = Uncertainty(length=0.0, mass=0.0, friction=0.0, mu=0.0, lag=0.0, timing=0.0).draws(1, THROWER, PEG)
    motion, source = WINDS.motion(LIMITS), DrawnWorld(draw, THROWER.arm)
    belief = Belief(THROWER, [draw])
    state = source.state(1.0, motion)
    belief.see(state, motion)
    assert belief.off[0] < 1e-3  # coarse runs: some millimetres, of 5 cm that count one
    before = belief.off.copy()
    belief.see(state, motion)
    assert (belief.off == before).all()
    second = source.state(2.0, motion)
    # The last link turned by 0.5 rad: its end is off by 2 cm and alone among 50.
    belief.see(replace(second, q=second.q + 0.5 * (np.arange(50) == 49)), motion)
    chord = 2.0 * 0.04 * np.sin(0.25)
    expected = ((chord / 0.05) ** 2 + (chord * second.qd[-1] / 0.5) ** 2) / 50
    assert belief.off[0] - before[0] == pytest.approx(expected, rel=0.2)  # with what coarse runs are off by
