"""How runs with a peg are judged, from turns made up for the purpose and from a throw that is known to wind."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.planning import MotorLimits, Problem, Throw, estimate_success_probability, verify_cast
from hyperflex.planning.outcome import evaluate_cast
from hyperflex.planning.problem import MIN_TURNS
from hyperflex.planning.search import contact_phase, rollouts
from hyperflex.planning.search.contact_phase import (
    ARM_COST,
    CHECK_TIME,
    END_TIME,
    FOLDED,
    LAST,
    LATE_COST,
    LOOK_TIME,
    MAX_TURNS,
    MIN_HOPE,
    MIN_SWEEP,
    PASSING,
    PLAIN,
    SLIP_COST,
    SWEEP_TIME,
    _time_near_arm,
    score_winding,
    simulate_contact,
)
from hyperflex.planning.search.rollouts import RolloutBatch
from tests.planning.known import contact_scores, planned, simulated_strikes

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
CAST_SETUP = Problem(CABLE, hf.Arm(length=0.105), MotorLimits())
FREE = replace(CAST_SETUP, clearance=-np.inf)  # its rope may go through arm and shaft
PEG = hf.Peg(1.36 * np.sin(-0.66), -1.36 * np.cos(-0.66), 0.04, 0.3)
WINDS = Throw(
    side=-1,
    strokes=np.array([3.0662, 3.1416, 2.5988, 3.1416, 3.1416, 3.1416]),
    rests=np.array([0.4817, 0.5317, 0.3877, 0.8342, 0.5736, 0.3592]),
    end=-0.5 * np.pi,
    rest=0.2625,
    speed=1.0,
    count=6,
)  # found by a search


def test_turns_count_if_they_stay() -> None:
    t = np.arange(0.0, 4.0, 0.01)
    stays = np.minimum(t, 2.3)
    undone = np.where(t < 3.9, -2.0 * np.ones_like(t), -0.2)
    failed = np.where(t < 1.0, 1.0, np.nan)
    many = 9.0 * np.ones_like(t)
    found = [score_winding(t, turns, t[-1], begin) for turns, begin in ((stays, 0.0), (undone, 1.0), (failed, 0.0))]
    assert found == [
        pytest.approx((2.3 + PASSING * 2.3, 2.3)),
        pytest.approx((0.2 + PASSING * 2.0 - LATE_COST, 0.2)),
        (-1.0, 0.0),
    ]
    assert score_winding(t, many, t[-1], 0.0) == pytest.approx((MAX_TURNS + PASSING * MAX_TURNS, 9.0))


def test_each_run_is_judged_over_its_own_span() -> None:
    t = np.arange(0.0, 4.0, 0.01)
    later = np.where(t < 2.0, 1.5, 0.0)  # undone after 2 s: beyond the first one's span
    assert [score_winding(t, later, span, 0.0)[1] for span in (1.9, t[-1])] == pytest.approx([1.5, 0.0])
    assert LAST < 1.9


def test_a_run_from_the_strike_on_ends_as_the_whole_run_does() -> None:
    strike = simulated_strikes(CAST_SETUP, PEG, [WINDS])
    found = contact_scores(CAST_SETUP, PEG, [WINDS], (strike.t, strike.q, strike.qd))
    whole = verify_cast(CAST_SETUP, PEG, WINDS.motion(CAST_SETUP.limits))
    assert whole.success, whole.message
    assert whole.turns < 0.0  # clockwise: struck from the right
    # 50 links and a step of 1 ms against the refined rope; turns are quantised, the hanging tail swings
    assert found.turns[0] == pytest.approx(-whole.turns, abs=0.1)
    assert whole.slip < 5e-3
    assert whole.strike_time == pytest.approx(strike.t[0], abs=0.05)


def test_without_friction_it_does_not_hold() -> None:
    smooth = hf.Peg(PEG.x, PEG.y, PEG.radius, 0.0)
    whole = verify_cast(CAST_SETUP, smooth, WINDS.motion(CAST_SETUP.limits))
    assert not whole.success
    assert whole.message


def test_a_motor_that_is_too_weak_is_told() -> None:
    weak = Problem(CABLE, CAST_SETUP.arm, MotorLimits(torque=0.05))
    whole = verify_cast(weak, PEG, WINDS.motion(weak.limits))
    assert whole.wound
    assert whole.held
    assert not whole.success
    assert "N m of a motor that gives 0.05" in whole.message


def test_the_turns_that_are_missing_are_those_that_stay() -> None:
    """Not those at the end alone, which are told beside them."""
    plan = planned()
    asked = replace(plan.problem, turns=9.0)
    seen = evaluate_cast(asked, plan.target, plan.run, float(plan.motion.breaks[-1]))
    most, stay = (float(word) for word in re.findall(r"\d\.\d\d", seen.message))
    assert seen.message.endswith(f"turns {stay:.2f} stay while it is watched, and 9 are asked")
    assert stay <= abs(seen.turns) + 0.005 <= most + 0.01


def test_a_rope_that_misses_is_told() -> None:
    whole = verify_cast(CAST_SETUP, hf.Peg(1.5, 1.2, 0.03), hf.arm_moves([-1.5, -1.4], [0.0], [0.2]), watch_time=0.2)
    assert whole.message == "the rope does not touch the peg"
    assert np.isnan(whole.strike_time)


def test_throws_are_judged_alike_alone_and_together() -> None:
    """Whatever they run beside, on threads, and though those without hope end early."""
    still = replace(WINDS, end=0.9 * np.pi, rest=0.9)  # it stops later
    strike = simulated_strikes(CAST_SETUP, PEG, [WINDS] * 2)
    state = strike.t, strike.q, strike.qd
    throws = [WINDS.cut(float(strike.t[0]), CAST_SETUP.limits), still.cut(float(strike.t[0]), CAST_SETUP.limits)]
    both = contact_scores(CAST_SETUP, PEG, throws, state)
    for k, throw in enumerate(throws):
        alone = contact_scores(CAST_SETUP, PEG, [throw], tuple(values[k : k + 1] for values in state))
        assert (both.score[k], both.turns[k]) == (alone.score[0], alone.turns[0])
    far = contact_scores(CAST_SETUP, hf.Peg(3.0, 3.0, 0.04), [WINDS], tuple(values[:1] for values in state))
    assert far.turns[0] < MIN_HOPE


def test_a_rope_that_slips_in_the_end_is_worth_less() -> None:
    """On a smooth peg the same throw stays wound for the time watched, and slides."""
    strike = simulated_strikes(CAST_SETUP, PEG, [WINDS])
    smooth = hf.Peg(PEG.x, PEG.y, PEG.radius, 0.13)
    holds, slides = (contact_scores(CAST_SETUP, peg, [WINDS], (strike.t, strike.q, strike.qd)) for peg in (PEG, smooth))
    least = [
        (1.0 + PASSING) * found.turns[0] - LATE_COST * strike.t[0] for found in (holds, slides)
    ]  # but for slipping
    assert slides.turns[0] > MIN_TURNS
    assert holds.score[0] > least[0] - 0.01 * SLIP_COST  # what is held moves by less than 0.2 mm
    assert slides.score[0] < least[1] - 0.3 * SLIP_COST


def test_a_rope_that_unwinds_later_has_no_turns_whatever_it_runs_beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two turns until 1 s after its stop, none from then on; the other stops half a second later. Runs are made up."""

    def run_on(one: RolloutBatch, since: float, until: float, *_: object) -> tuple[object, ...]:
        t = np.arange(since + 0.02, until + 0.01, 0.02)
        turns = np.where(t < float(one.motions[0].breaks[-1]) + 1.0, 2.0, 0.0)
        return t, turns, *np.zeros((2, t.size, CABLE.n_links)), one

    monkeypatch.setattr(contact_phase, "_run_on", run_on)
    motions = [hf.arm_moves([0.0, 1.0], [0.0], [0.6]), hf.arm_moves([0.0, 1.0], [0.4], [0.69])]
    assert motions[1].breaks[-1] - motions[0].breaks[-1] > 0.4
    both = RolloutBatch([CABLE] * 2, [PEG] * 2, motions, np.zeros((2, 1)), np.zeros((2, 1)))
    found = simulate_contact(both, np.zeros(2), FREE)
    assert found.turns[0] <= MIN_HOPE
    assert found.score[0] <= MIN_HOPE + PASSING * 2.0


def test_of_two_throws_that_wind_the_one_that_folds_scores_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs are made up: two turns that stay, and a joint that bends by 3 rad, more than a rope so thick can."""

    def run_on(one: RolloutBatch, since: float, until: float, *_: object) -> tuple[object, ...]:
        t = np.arange(since + 0.02, until + 0.01, 0.02)
        q = np.zeros((t.size, CABLE.n_links))
        q[5, 7:] = 3.0 * (one.q[0, 0] > 0.0)
        return t, np.full(t.size, 2.0), q, np.zeros_like(q), one

    monkeypatch.setattr(contact_phase, "_run_on", run_on)
    monkeypatch.setattr(contact_phase, "_slip", lambda *_: 0.0)
    motions = 2 * [hf.arm_moves([0.0, 1.0], [0.0], [0.6])]
    starts = np.zeros((2, CABLE.n_links))
    starts[1, 0] = 0.1  # marks the one that folds
    both = RolloutBatch([CABLE] * 2, [PEG] * 2, motions, starts, np.zeros_like(starts))
    found = simulate_contact(both, np.zeros(2), FREE)
    whole = 2.0 + PASSING * 2.0
    assert found.turns.tolist() == [2.0, 2.0]
    assert found.score == pytest.approx([whole, PLAIN + FOLDED * (whole - PLAIN)])


@pytest.mark.parametrize(("folds", "spans"), [(0, 0), (1, 1), (2, 2), (3, 3)])
def test_a_rope_that_folds_flat_is_not_simulated_on_where_that_is_not_asked_for(
    monkeypatch: pytest.MonkeyPatch, folds: int, spans: int
) -> None:
    """It folds before the run (0), in its first or second span, or after both. Runs are made up: two turns stay."""
    seen: list[float] = []

    def run_on(one: RolloutBatch, since: float, until: float, *_: object) -> tuple[object, ...]:
        t = np.arange(since + 0.02, until + 0.01, 0.02)
        seen.append(until)
        q = np.zeros((t.size, CABLE.n_links))
        q[-1, 7:] = 3.0 * (len(seen) == folds)
        return t, np.full(t.size, 2.0), q, np.zeros_like(q), one

    monkeypatch.setattr(contact_phase, "_run_on", run_on)
    monkeypatch.setattr(contact_phase, "_slip", lambda *_: 0.0)
    start = np.zeros((1, CABLE.n_links))
    start[0, 7:] = 3.0 * (folds == 0)
    one = RolloutBatch([CABLE], [PEG], [hf.arm_moves([0.0, 1.0], [0.0], [0.6])], start, np.zeros_like(start))
    kept, simulated_on = (
        simulate_contact(one, np.zeros(1), FREE, sweeping=True, folding=folding) for folding in (False, True)
    )
    assert len(seen) == spans + 3
    assert simulated_on.turns[0] == 2.0
    assert kept.turns[0] == (2.0 if folds == 3 else MIN_HOPE if folds == 2 else 0.0)
    assert folds == 3 or kept.score[0] < simulated_on.score[0]


@pytest.mark.parametrize("duration", [0.6, 0.78, 0.8])
def test_a_stop_at_any_time_is_looked_at_once(duration: float) -> None:
    """Also where the look falls on a sample."""
    strike = simulated_strikes(CAST_SETUP, PEG, [WINDS])
    end = float(WINDS.cut(float(strike.t[0]), CAST_SETUP.limits).angles(CAST_SETUP.limits)[-2])
    motion = hf.arm_moves([end, end - 0.2], [0.0], [duration])
    one = RolloutBatch([CABLE], [PEG], [motion], strike.q, strike.qd)
    for sweeping in (False, True):
        assert np.isfinite(simulate_contact(one, strike.t, FREE, sweeping=sweeping).score).all()


@pytest.mark.parametrize(("turns", "spans"), [(0.9 * MIN_SWEEP, 1), (1.1 * MIN_SWEEP, 2), (1.0, 3)])
def test_a_rope_that_does_not_sweep_round_the_peg_is_not_simulated_further(
    monkeypatch: pytest.MonkeyPatch, turns: float, spans: int
) -> None:
    """Nor is one with few turns after the stop. Runs are made up, and bend nothing."""
    seen: list[float] = []

    def run_on(one: RolloutBatch, since: float, until: float, *_: object) -> tuple[object, ...]:
        t = np.arange(since + 0.02, until + 0.01, 0.02)
        seen.append(until)
        return t, np.full(t.size, turns), *np.zeros((2, t.size, CABLE.n_links)), one

    monkeypatch.setattr(contact_phase, "_run_on", run_on)
    one = RolloutBatch([CABLE], [PEG], [hf.arm_moves([0.0, 1.0], [0.0], [0.6])], *np.zeros((2, 1, CABLE.n_links)))
    stop = float(one.motions[0].breaks[-1])
    found = simulate_contact(one, np.zeros(1), FREE, sweeping=True)
    ends = [SWEEP_TIME * np.sqrt(2.0 / 9.81), stop + CHECK_TIME, stop + END_TIME]
    assert seen == pytest.approx(ends[:spans], rel=1e-3)
    if spans == 1:  # turns that nobody saw stay do not count, but for having passed
        assert found.score[0] == pytest.approx(PASSING * turns)
        assert found.turns[0] == 0.0
    seen.clear()
    simulate_contact(one, np.zeros(1), FREE)  # whatever it sweeps: no search, but an estimate
    assert seen == pytest.approx(ends[1 : max(spans, 2)], rel=1e-3)


@pytest.mark.parametrize(("clearance", "stays"), [(-np.inf, True), (0.0, True), (1.0, False)])
def test_a_rope_that_comes_too_near_its_arm_counts_as_undone(clearance: float, stays: bool) -> None:
    strike = simulated_strikes(CAST_SETUP, PEG, [WINDS])
    motion = WINDS.motion(CAST_SETUP.limits).shifted(-strike.t[0])
    one = RolloutBatch([CABLE], [PEG], [motion], strike.q, strike.qd)
    found = simulate_contact(one, strike.t, replace(CAST_SETUP, clearance=clearance))
    assert bool(found.turns[0] >= MIN_TURNS) is stays
    assert stays or found.score[0] <= MIN_TURNS - ARM_COST + PASSING * MAX_TURNS


def test_the_longer_a_rope_is_too_near_its_arm_the_less_it_is_worth() -> None:
    """Also where it winds: what a search is to get away from must not look alike everywhere."""
    strike = simulated_strikes(CAST_SETUP, PEG, [WINDS])
    motion = WINDS.motion(CAST_SETUP.limits).shifted(-strike.t[0])
    one = RolloutBatch([CABLE], [PEG], [motion], strike.q, strike.qd)
    for_short, long = (
        simulate_contact(one, strike.t, replace(CAST_SETUP, clearance=clearance)).score[0] for clearance in (0.037, 1.0)
    )
    assert long + 0.1 < for_short < MIN_TURNS + PASSING * MAX_TURNS - ARM_COST


@pytest.mark.parametrize("looks", [[0.0, 0.0], [0.0, 0.3], [0.3]])
def test_a_rope_that_comes_too_near_its_arm_at_the_very_end_counts_as_undone(
    monkeypatch: pytest.MonkeyPatch, looks: list[float]
) -> None:
    """Times near the arm, until CHECK_TIME after the stop and after it, are made up."""
    strike, left = simulated_strikes(CAST_SETUP, PEG, [WINDS]), list(looks)
    state = strike.t, strike.q, strike.qd
    clear = contact_scores(CAST_SETUP, PEG, [WINDS], state)
    monkeypatch.setattr(contact_phase, "_time_near_arm", lambda *_: left.pop(0))
    found = contact_scores(CAST_SETUP, PEG, [WINDS], state)
    assert not left
    if any(looks):
        assert found.turns[0] == MIN_HOPE
        assert found.score[0] <= clear.score[0] - ARM_COST
    else:
        assert (found.turns[0], found.score[0]) == (clear.turns[0], clear.score[0])


def test_a_rope_that_lies_through_the_peg_at_first_makes_no_turn() -> None:
    """Its run could not begin: one throw is no reason to end a search."""
    peg, still = hf.Peg(0.0, -1.0, 0.03), hf.hold_arm(0.0)
    one = RolloutBatch([CABLE], [peg], [still], *np.zeros((2, 1, CABLE.n_links)))
    found = simulate_contact(one, np.array([3.0]), FREE)
    assert (found.turns[0], found.score[0]) == (0.0, pytest.approx(-3.0 * LATE_COST))


def test_a_run_that_is_too_deep_in_the_peg_to_go_on_counts_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coarse runs sink deeper than a run may begin: one throw of a search ended it with an error."""
    strike = simulated_strikes(CAST_SETUP, PEG, [WINDS])
    state, asked = (strike.t, strike.q, strike.qd), []

    def refuse(setup: hf.Setup, t: float, q: np.ndarray) -> None:
        asked.append((t, q.shape))
        if len(asked) > 1:  # not where it strikes
            raise InvalidInput("too deep")

    monkeypatch.setattr(contact_phase, "check_outside", refuse)
    found = contact_scores(CAST_SETUP, PEG, [WINDS], state)
    assert found.turns[0] == MIN_HOPE
    assert found.score[0] < MIN_TURNS
    assert [shape for _, shape in asked] == [(50,), (50,)]


@pytest.mark.parametrize("what", ["swings", "landings", "drawn worlds"])
def test_a_batch_that_ctrl_c_cut_short_is_no_result(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    """It would count what was cut off as lost."""
    strike = simulated_strikes(CAST_SETUP, PEG, [WINDS])
    part = SimpleNamespace(status=("interrupted",))
    monkeypatch.setattr(rollouts, "simulate_batch", lambda *_, **__: (_ for _ in ()).throw(hf.Interrupted(part)))
    work = {
        "swings": lambda: simulated_strikes(CAST_SETUP, PEG, [WINDS]),
        "landings": lambda: contact_scores(CAST_SETUP, PEG, [WINDS], (strike.t, strike.q, strike.qd)),
        "drawn worlds": lambda: estimate_success_probability(CAST_SETUP, PEG, WINDS, samples=2),
    }
    with pytest.raises(KeyboardInterrupt):
        work[what]()


def test_a_tip_that_passes_the_arm_between_two_samples_is_seen() -> None:
    """A straight rope that turns by half a radian from one sample to the next, from the arm's tip past the shaft."""
    rope, t = hf.Rope.uniform(length=1.0, mass=0.05, n_links=10, radius=0.0025), np.array([0.02, 0.04])
    arm = hf.Arm(length=0.2)
    q = np.repeat([[0.5 * np.pi - 0.25], [0.5 * np.pi + 0.25]], 10, axis=1)
    one = RolloutBatch([rope], [PEG], [hf.hold_arm(-0.5 * np.pi)], q[:1], np.full((1, 10), 25.0))
    assert _time_near_arm(one, q, np.full_like(q, 25.0), t, arm, 0.0) == pytest.approx(LOOK_TIME)
    assert _time_near_arm(one, q[[0, 0]], np.zeros_like(q), t, arm, 0.0) == 0.0
