"""The closed loop: back to a plan that a wrong rope has left, what is kept, and a throw that is given up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyperflex.casting import DrawnWorld, Throw, Uncertainty, follow
from hyperflex.casting.following import swing_down
from hyperflex.casting.matching import Goal, match
from hyperflex.casting.strikes import fly
from hyperflex.control import RopeState, TrueState
from hyperflex.errors import InvalidInput
from tests.casting.test_landing import PEG, THROWER, WINDS
from tests.casting.test_uncertainty import NONE

LIMITS = THROWER.limits


def rest_before(throw: Throw, move: int) -> float:
    """When the arm comes to rest before a move, s."""
    return float(throw.starts(LIMITS)[move]) - float(np.append(throw.rests, throw.rest)[move])


def test_the_goal_is_the_strike_of_the_plan() -> None:
    goal = Goal.of(THROWER, PEG, WINDS)
    assert goal is not None
    assert goal.t == pytest.approx(float(fly(THROWER, PEG, [WINDS]).t[0]))
    assert Goal.of(THROWER, PEG, replace(WINDS, strokes=np.full(6, 0.06))) is None


def test_a_throw_that_was_late_by_one_rest_is_led_back() -> None:
    """The state after a stroke that came 40 ms late: what is left undoes most of it."""
    goal, move = Goal.of(THROWER, PEG, WINDS), 3
    assert goal is not None
    rests = WINDS.rests.copy()
    rests[move - 1] += 0.04
    late = replace(WINDS, rests=rests)
    now = rest_before(late, move)
    seen = TrueState(THROWER.rope, THROWER.arm, tol=1e-4).state(now, late.motion(LIMITS))
    ways = match(THROWER, goal, late, move, seen, 0.1)
    assert ways
    best = ways[0]
    assert best.rests[:move].tolist() == late.rests[:move].tolist()  # what was done stays done
    assert best.strokes[:move].tolist() == late.strokes[:move].tolist()
    assert best.rests[move] >= 0.1
    assert miss(best, goal) < 0.3 * miss(late, goal)  # 0.15 was seen


def miss(throw: Throw, goal: Goal) -> float:
    """Distance from the goal's features, by whole flights from rest, at the best time about the goal's."""
    from hyperflex.casting.matching import features
    from hyperflex.casting.strikes import arm_tip, arm_tip_velocity
    from hyperflex.simulation import simulate

    motion = throw.motion(LIMITS)
    t = goal.t + np.arange(-0.25, 0.25, 0.002)
    run = simulate(THROWER.rope, motion, arm=THROWER.arm, duration=float(t[-1]), t_eval=t, tol=1e-4)
    base = arm_tip(THROWER.arm, motion, t), arm_tip_velocity(THROWER.arm, motion, t)
    return float(((features(THROWER.rope, run.q, run.qd, *base) - goal.features) ** 2).sum(axis=1).min())


def test_in_the_expected_world_the_plan_is_kept() -> None:
    (world,) = NONE.draws(1, THROWER, PEG)
    done = follow(THROWER, PEG, WINDS, DrawnWorld(world, THROWER.arm), uncertainty=NONE)
    assert [look.decided for look in done.looks] == ["kept"] * len(done.looks)
    assert [look.move for look in done.looks] == list(range(1, len(done.looks) + 1))
    assert len(done.looks) >= 5
    assert not done.aborted
    assert done.motion == WINDS.motion(LIMITS)
    for look in done.looks:
        assert look.t == pytest.approx(rest_before(WINDS, look.move))
        assert look.t + look.left == pytest.approx(float(WINDS.starts(LIMITS)[look.move]))


class Hanging:
    """A source that always sees the rope hang at rest: nothing that is planned can win."""

    def state(self, t: float, motion: object) -> RopeState:
        return RopeState(t, np.zeros(50), np.zeros(50))


def test_a_throw_that_cannot_win_any_more_is_given_up_slowly() -> None:
    done = follow(THROWER, PEG, WINDS, Hanging(), uncertainty=NONE)  # type: ignore[arg-type]
    assert done.aborted
    assert done.looks[-1].decided == "aborted"
    assert done.looks[-1].after == 0.0
    made = done.looks[-1].move
    assert made >= WINDS.count - 1
    assert done.throw.count == made
    end = float(done.motion.breaks[-1])
    assert float(done.motion.angle(end)) == pytest.approx(0.0, abs=1e-9)
    t = np.linspace(done.looks[-1].t, end, 500)
    assert float(np.abs(done.motion.rate(t)).max()) <= 0.31 * LIMITS.speed
    before = np.linspace(0.0, done.looks[-1].t, 50)
    np.testing.assert_allclose(swing_down(done.throw, made).motion(LIMITS).angle(before), done.motion.angle(before))


def test_bad_numbers_are_refused() -> None:
    (world,) = Uncertainty().draws(1, THROWER, PEG)
    for wrong in ({"thinking": -1.0}, {"seed": -1}, {"thinking": np.nan}):
        with pytest.raises(InvalidInput):
            follow(THROWER, PEG, WINDS, DrawnWorld(world, THROWER.arm), **wrong)
