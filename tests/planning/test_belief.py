"""Worlds told apart by what was seen: the true one among others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyperflex.planning import Uncertainty
from hyperflex.planning.feedback.closed_loop import ScenarioRanking
from hyperflex.planning.feedback.simulated_ropes import ScenarioStateSource
from hyperflex.planning.robust.uncertainty import MOVES
from tests.planning.test_landing import CAST_SETUP, PEG, WINDS

LIMITS = CAST_SETUP.limits
TRUE = 6


def test_the_true_world_is_told_from_others() -> None:
    """Even if its moves start some milliseconds late, which no world knows."""
    draws = Uncertainty().sample(12, CAST_SETUP, PEG, seed=8)
    late = replace(draws[TRUE], delays=np.resize([0.0, 2e-3, -1e-3], MOVES))
    motion, source = WINDS.motion(LIMITS), ScenarioStateSource(late, CAST_SETUP.arm)
    belief = ScenarioRanking(CAST_SETUP, draws)
    assert belief.best(3) == draws[:3]  # nothing seen yet
    for move in (1, 2, 3):
        now = float(WINDS.starts(LIMITS)[move]) - float(WINDS.rests[move])
        belief.observe(source.state(now, motion), motion)
    assert belief.best(1) == [draws[TRUE]]
    friction = [draw.rope.friction[1] for draw in draws]
    length = [draw.rope.total_length for draw in draws]
    near = [draws.index(draw) for draw in belief.best(4)]
    assert np.abs(np.array(length)[near] - length[TRUE]).mean() < np.abs(np.array(length) - length[TRUE]).mean()
    assert len(set(friction)) == 12


def test_the_error_is_that_of_the_predicted_place_and_nothing_is_counted_twice() -> None:
    (draw,) = Uncertainty(length=0.0, mass=0.0, friction=0.0, mu=0.0, lag=0.0, timing=0.0).sample(1, CAST_SETUP, PEG)
    motion, source = WINDS.motion(LIMITS), ScenarioStateSource(draw, CAST_SETUP.arm)
    belief = ScenarioRanking(CAST_SETUP, [draw])
    state = source.state(1.0, motion)
    belief.observe(state, motion)
    assert belief.errors[0] < 1e-3  # coarse runs: some millimetres, of 5 cm that count one
    before = belief.errors.copy()
    belief.observe(state, motion)
    assert (belief.errors == before).all()
    second = source.state(2.0, motion)
    # The last link turned by 0.5 rad: its end is off by 2 cm and alone among 50.
    belief.observe(replace(second, q=second.q + 0.5 * (np.arange(50) == 49)), motion)
    chord = 2.0 * 0.04 * np.sin(0.25)
    expected = ((chord / 0.05) ** 2 + (chord * second.qd[-1] / 0.5) ** 2) / 50
    assert belief.errors[0] - before[0] == pytest.approx(expected, rel=0.2)  # with what coarse runs are off by
