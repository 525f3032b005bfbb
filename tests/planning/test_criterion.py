"""What is asked of a wound rope, its turns and when they are watched: in checks, search, verification and files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.planning import CastPlan, Problem, check_feasibility, estimate_success_probability, verify_cast
from hyperflex.planning.outcome import WATCH_TIME, evaluate_cast
from hyperflex.planning.problem import MIN_TURNS, SETTLING_TIME
from hyperflex.planning.robust import refinement, scenario_rollouts
from hyperflex.planning.robust.refinement import RobustRefinement, robust_values
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.search import contact_phase, throw_search
from hyperflex.planning.search.candidates import Candidate, corrected, unconfirmed
from hyperflex.planning.search.contact_phase import (
    ARM_COST,
    ARM_TIME,
    END_TIME,
    FOLDED,
    MAX_TURNS,
    PASSING,
    PLAIN,
    WAY_COST,
    WAY_GAP,
    WindingScores,
    simulate_contact,
)
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.search.strikes import HANGING_TAIL, MAX_TAIL
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.wind import casting, fallback_targets
from hyperflex.planning.wind import planner as cast_planner
from hyperflex.planning.wind.verified import Asked, may_fall, rank, with_margin
from tests.planning.known import CABLE, PEG, WINDS, planned, problem, simulated_strikes

FREE = replace(problem(), clearance=-np.inf)  # its rope may go through arm and shaft
CORD, ARM = hf.Rope.uniform(length=1.2, mass=0.05, n_links=15, radius=0.002, friction=2e-4), hf.Arm(length=0.15)


def asks(**criterion: float) -> Problem:
    return replace(problem(), **criterion)


@pytest.mark.parametrize(
    ("criterion", "words"),
    [
        ({"turns": 0.5}, "turns are not those of a wound rope: got 0.5. Allowed: more than 0.5 turns, up to 20"),
        ({"turns": 21.0}, "turns are not those"),
        ({"turns": np.nan}, "turns is not finite"),
        ({"turns": -2.0}, "turns has the wrong sign"),
        ({"turns": "two"}, "turns is not a number"),
        ({"settle": -0.1}, "settle has the wrong sign"),
        ({"settle": 10.5}, "settle is longer than a rope takes to come to rest: got 10.5. Allowed: up to 10 s"),
        ({"settle": np.inf}, "settle is not finite"),
    ],
)
def test_what_cannot_be_asked_is_refused(criterion: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        asks(**criterion)
    with pytest.raises(InvalidInput, match=words):
        hf.plan_cast(CABLE, problem().arm, PEG, **criterion)
    with pytest.raises(InvalidInput, match=words):
        hf.build_reach_map(CABLE, problem().arm, x=[0.5], y=[0.5], **criterion)


def test_by_default_what_was_always_asked_is() -> None:
    known = problem()
    assert (known.turns, known.settle, known.more_turns) == (MIN_TURNS, SETTLING_TIME, 0.0) == (1.25, 1.0, 0.0)
    assert (asks(turns=20, settle=0).turns, asks(turns=0.6, settle=10).settle) == (20.0, 10.0)
    assert (type(asks(turns=2).turns), type(asks(settle=2).settle)) == (float, float)


def test_a_run_is_judged_by_the_turns_that_are_asked() -> None:
    """It makes 2.36."""
    run, stop = planned().run, float(planned().motion.breaks[-1])
    assert evaluate_cast(asks(turns=2.0), PEG, run, stop).success
    more = evaluate_cast(asks(turns=3.0), PEG, run, stop)
    assert (more.wound, more.held, more.success) == (False, True, False)
    assert more.message.endswith("stay while it is watched, and 3 are asked")


def test_a_rope_is_watched_from_when_that_is_asked() -> None:
    """One that still winds 1 s after the stop, as it is told, and lies still 3 s after it."""
    run, stop = planned().run, float(planned().motion.breaks[-1]) - 1.5
    early, late = (evaluate_cast(asks(settle=settle), PEG, run, stop) for settle in (1.0, 3.0))
    assert (early.wound, early.held, late.success) == (False, False, True)
    assert not early.slip < 5e-3  # it is not on the peg
    assert late.slip < 5e-3
    assert late.contact_angle > early.contact_angle
    assert (early.tip_hangs, late.tip_hangs) == (False, True)


def test_a_verified_run_lasts_until_the_watch_is_over() -> None:
    known, motion = asks(settle=3.0), planned().motion
    seen = verify_cast(known, PEG, motion)
    assert seen.success
    assert seen.run.setup.duration == pytest.approx(motion.breaks[-1] + 3.0 + WATCH_TIME)
    assert replace(planned(), problem=known).setup().duration == seen.run.setup.duration


@pytest.mark.parametrize(
    ("distance", "turns", "told"),
    [
        (1.45, 0.7, ""),
        (1.45, 2.0, ""),
        (1.45, 3.0, "rope for 2.85 turns is left beyond the target, 3.35 needed to wind 3"),
        (1.6, 0.7, ""),
        (1.6, 3.0, "with all of the rope round the target it makes 2.72 turns, 3 asked"),
    ],
)
def test_turns_that_are_asked_need_rope(distance: float, turns: float, told: str) -> None:
    far = hf.Peg(distance * np.sin(0.8), -distance * np.cos(0.8), 0.03)
    known, usual = (check_feasibility(each, far) for each in (asks(turns=turns), problem()))
    assert known.message == (f"out of reach: {told}" if told else "")
    assert known.impossible == ("all of the rope" in told)
    assert known.available_turns == usual.available_turns
    assert check_feasibility(asks(turns=MIN_TURNS + 1.0), far).needed_turns == pytest.approx(usual.needed_turns + 1.0)


def test_a_target_too_far_for_the_turns_asked_comes_with_a_nearer_one_and_remedies() -> None:
    plan = hf.plan_cast(CABLE, ARM, hf.Peg(1.1, -1.1, 0.03), turns=3.0)
    assert (plan.status, plan.message[-7:]) == (1, " wind 3")
    assert plan.fallback is not None
    near = check_feasibility(plan.problem, plan.fallback.target)
    assert near.feasible
    assert near.available_turns > near.needed_turns > 3.0
    assert [words.split()[:2] for words in plan.remedies] == [["a", "rope"], ["a", "peg"]]


def made_up(monkeypatch: pytest.MonkeyPatch, turns: float, bend: float = 0.0) -> list[float]:
    """Let runs in contact make `turns` and no slip; return until when they are simulated, s."""
    until: list[float] = []

    def run_on(one: RolloutBatch, since: float, end: float, *_: object) -> tuple[object, ...]:
        t = np.arange(since + 0.02, end + 0.01, 0.02)
        until.append(end)
        q = np.zeros((t.size, CABLE.n_links))
        q[-1, 7:] = bend
        return t, np.full(t.size, turns), q, np.zeros_like(q), one

    monkeypatch.setattr(contact_phase, "_run_on", run_on)
    monkeypatch.setattr(contact_phase, "_slip", lambda *_: 0.0)
    return until


def in_contact() -> RolloutBatch:
    motion, n = hf.arm_moves([0.0, 1.0], [0.0], [0.6]), CABLE.n_links
    return RolloutBatch([CABLE], [PEG], [motion], *np.zeros((2, 1, n)))


@pytest.mark.parametrize(("settle", "later"), [(0.0, -1.0), (1.0, 0.0), (4.0, 3.0)])
def test_a_run_of_a_search_sees_as_much_of_the_watch_as_usual(
    monkeypatch: pytest.MonkeyPatch, settle: float, later: float
) -> None:
    until, one = made_up(monkeypatch, 2.0), in_contact()
    assert simulate_contact(one, np.zeros(1), replace(FREE, settle=settle)).turns[0] == 2.0
    assert until[-1] == pytest.approx(float(one.motions[0].breaks[-1]) + END_TIME + later)


@pytest.mark.parametrize("asked", [MIN_TURNS, 2.0, 3.0])
def test_more_turns_than_are_asked_count_up_to_as_many_as_usual(monkeypatch: pytest.MonkeyPatch, asked: float) -> None:
    most, found = MAX_TURNS - MIN_TURNS, {}
    for more in (-0.1, 0.1, 1.0, most, most + 1.0):
        made_up(monkeypatch, asked + more)
        found[more] = simulate_contact(in_contact(), np.zeros(1), replace(FREE, turns=asked))
        assert found[more].turns[0] == pytest.approx(asked + more)
        assert found[more].score[0] == pytest.approx((1.0 + PASSING) * (asked + min(more, most)))
    plain = PLAIN + asked - MIN_TURNS
    made_up(monkeypatch, asked + 1.0, bend=3.0)
    folds = simulate_contact(in_contact(), np.zeros(1), replace(FREE, turns=asked))
    assert folds.score[0] == pytest.approx(plain + FOLDED * (found[1.0].score[0] - plain))
    assert plain < folds.score[0] < asked  # worth a verification in the end, after all that do not fold


def test_what_comes_undone_scores_less_than_what_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    for asked in (0.7, 2.0, 3.0):
        made_up(monkeypatch, asked + 1.0)
        monkeypatch.setattr(contact_phase, "_time_near_arm", lambda *_: 0.1)
        near = simulate_contact(in_contact(), np.zeros(1), replace(FREE, turns=asked))
        assert near.turns[0] < asked
        assert near.score[0] == pytest.approx(
            asked + PASSING * (asked + 1.0) - ARM_COST * (1.0 + 0.1 / (0.1 + ARM_TIME))
        )


def test_what_misses_a_peg_scores_less_than_what_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_phase, "_way_apart", lambda *_: WAY_GAP)
    for asked in (0.7, 3.0):
        made_up(monkeypatch, asked + 1.0)
        aside = simulate_contact(in_contact(), np.zeros(1), replace(FREE, turns=asked))
        assert aside.turns[0] < asked
        assert aside.score[0] == pytest.approx(asked + PASSING * (asked + 1.0) - 1.5 * WAY_COST)


def test_few_turns_that_are_asked_are_simulated_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many would not be worth it by default: runs end there at 0.65 turns, and at 0.75."""
    for asked, spans in ((0.55, 3), (MIN_TURNS, 1), (3.0, 1)):
        until = made_up(monkeypatch, 0.6)
        found = simulate_contact(in_contact(), np.zeros(1), replace(FREE, turns=asked), sweeping=True)
        assert len(until) == spans
        assert bool(found.turns[0] >= asked) is (spans == 3)


def test_the_slip_of_throws_counts_that_make_the_turns_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    made_up(monkeypatch, 2.0)
    monkeypatch.setattr(contact_phase, "_slip", lambda *_: 0.5)
    scores = [simulate_contact(in_contact(), np.zeros(1), replace(FREE, turns=n)).score[0] for n in (2.0, 2.1)]
    assert scores == pytest.approx([2.5 - 0.5, 2.5])


def test_a_longer_tail_counts_where_more_turns_are_asked() -> None:
    thin = replace(PEG, radius=0.03)
    usual, more = (simulated_strikes(asks(turns=turns), thin, [WINDS]) for turns in (MIN_TURNS, 3.0))
    tail = float(usual.tail_turns[0]) - HANGING_TAIL
    assert tail > MAX_TAIL
    assert more.score[0] == pytest.approx(usual.score[0] * min(tail, MAX_TAIL + 1.75) / MAX_TAIL)
    known = check_feasibility(problem(), thin)
    usually, worthy = (
        cast_planner.CastPlanner(ThrowSearch(asks(turns=n), thin), 60.0).worthy for n in (MIN_TURNS, 3.0)
    )
    assert worthy == pytest.approx(usually * (known.available_turns - HANGING_TAIL) / MAX_TAIL)


def candidates() -> list[Candidate]:
    """Two throws of other swings, of 2 and 1.5 turns."""
    search = ThrowSearch(problem(), PEG)
    x = search.parametrizations[-1].centre()
    both = (x, np.append(x[:1] + 1.0, x[1:]))
    return [Candidate(2.5, turns, -1, each, WINDS) for turns, each in zip((2.0, 1.5), both, strict=True)]


def test_candidates_are_those_that_make_the_turns_asked() -> None:
    two, fewer = candidates()
    assert unconfirmed([two, fewer], 1.25) == [two, fewer]
    assert unconfirmed([two, fewer], 1.75) == [two]
    assert unconfirmed([fewer._replace(confirmed=True), two], 1.75) == [two]  # the first one is not the best that winds
    alike = two._replace(x=two.x.copy())
    for asked, lost in ((1.25, 0.0), (1.75, 0.8 * 0.6)):
        after = corrected([two, alike], alike, 1.4, 1.0, asked)
        assert after[0].turns == pytest.approx(2.0 - lost)
        search = ThrowSearch(asks(turns=asked), PEG)
        search.candidates = [two, alike]
        search.correct(alike, 1.4, 1.0)
        assert search.candidates == after
    for asked, winds in ((1.25, True), (3.0, False)):
        search = ThrowSearch(asks(turns=asked), PEG)
        search.candidates = [two._replace(confirmed=True), fewer]
        assert search.winds is winds
        assert bool(cast_planner.CastPlanner(search, 60.0).fresh()) is winds
        search.candidates = [fewer._replace(score=9.0, confirmed=True)]
        assert bool(cast_planner.CastPlanner(search, 60.0).fresh()) is winds  # whatever it scores


def test_throws_with_the_turns_asked_are_simulated_with_shorter_links(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []
    monkeypatch.setattr(throw_search, "unconfirmed", lambda some, asked: seen.append(asked) or [])
    ThrowSearch(asks(turns=2.0), PEG).confirm()
    assert seen == [2.0]


def test_a_search_begins_an_evolution_again_where_the_turns_asked_are_missing() -> None:
    two, fewer = candidates()
    for asked, again in ((1.25, 0), (3.0, 1)):
        search = ThrowSearch(asks(turns=asked), PEG)
        search.candidates = [two, fewer]
        assert search._unrefined() is two
        assert search._unrefined() is (two, fewer)[again]
        search._contact = (-1, None, 0.0)
        search.correct(two, 1.3, 1.0)
        assert (search._contact is None) == bool(again)


def test_throws_are_worth_a_verification_by_the_score_of_the_turns_asked() -> None:
    two, _ = candidates()
    for asked, score in ((1.25, 1.24), (1.75, 1.74)):
        search = ThrowSearch(asks(turns=asked), PEG)
        work = cast_planner.CastPlanner(search, 60.0, clock=SimpleNamespace(spent=10.0))  # type: ignore[arg-type]
        search.candidates = [two._replace(confirmed=True, score=score)]
        assert not work.fresh()  # it slips, or folds
        assert work.worth_refining(late=True)
        search.candidates = [two._replace(confirmed=True, score=score + 0.02)]
        assert work.fresh()
        search.candidates = [two._replace(confirmed=True, score=score - 0.3)]
        work.clock = SimpleNamespace(spent=50.0)  # type: ignore[assignment]
        assert not work.fresh()
        search.candidates = [two._replace(confirmed=True, score=score - 0.2)]
        assert work.fresh()
        search.candidates = [two._replace(score=score - 0.4)]
        assert not work.worth_refining(late=True)


def test_a_margin_is_one_beyond_the_turns_asked() -> None:
    good = planned().outcome  # 2.36 turns
    throw = (None, good, good)
    assert with_margin(throw, Asked(2.0))
    assert not with_margin(throw, Asked(2.3))
    assert rank(throw, Asked(2.3))[:3] == (2, True, False)
    assert not rank((None, good, replace(good, turns=good.turns + 0.1)), Asked(2.2))[
        1
    ]  # they differ by more than is to spare
    on_top = replace(good, tip_hangs=False)
    assert may_fall(Asked(1.3), good, on_top)
    assert not may_fall(Asked(1.4), good, on_top)
    work = cast_planner.CastPlanner(ThrowSearch(asks(turns=2.3), PEG), 60.0)
    work.best = throw
    assert work.stands
    assert not work.done()
    assert work.asked.turns == 2.3


def test_scenarios_are_won_by_the_turns_that_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    found = WindingScores(np.array([3.0, 4.75, 9.0]), np.array([2.0, 3.0, 3.5]))
    assert robust_values(found, asks(turns=3.0)) == pytest.approx([0.2 * 3.0 / 4.75, 1.2, 1.2])
    two, fewer = candidates()

    def scores(problem: Problem, pairs: list, **_: object) -> WindingScores:
        return WindingScores(np.full(len(pairs), 2.5), np.full(len(pairs), 2.0))

    monkeypatch.setattr(refinement, "scenario_scores", scores)
    monkeypatch.setattr(scenario_rollouts, "scenario_scores", scores)
    for asked, wins in ((1.75, True), (2.25, False)):
        work = RobustRefinement(ThrowSearch(asks(turns=asked), PEG), Uncertainty())
        work.halve([fewer._replace(score=9.0), two])
        assert (work.incumbent.candidate is two) is wins  # one of 1.5 turns comes after those that wind
        assert set(work.incumbent.successes) == {wins}
        stated = estimate_success_probability(asks(turns=asked), PEG, WINDS, samples=3)
        assert stated.successes == 3 * wins
        assert scenario_rollouts._wins([None], asks(turns=asked), WINDS, 1) == wins  # type: ignore[list-item]


def test_fallback_targets_are_asked_for_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def plan_fallback(plan: CastPlan, search: ThrowSearch, time_budget: float, plan_for: Any, **_: object) -> CastPlan:
        asked.update(plan_for.keywords)
        return plan

    monkeypatch.setattr(casting, "plan_fallback", plan_fallback)
    hf.plan_cast(CABLE, problem().arm, hf.Peg(2.5, 0.0, 0.03), turns=2.0, settle=0.5, fallback=True)
    assert (asked["turns"], asked["settle"]) == (2.0, 0.5)


def test_throws_of_fewer_turns_than_are_asked_are_no_fallback(monkeypatch: pytest.MonkeyPatch) -> None:
    def planner(beside: SimpleNamespace, time_budget: float, **_: object) -> None:
        raise AssertionError(beside.problem.turns)

    monkeypatch.setattr(fallback_targets, "CastPlanner", planner)
    for asked in (3.0, 2.0):
        beside = SimpleNamespace(problem=asks(turns=asked), peg=PEG, candidates=candidates()[:1])
        monkeypatch.setattr(fallback_targets, "searches_near_by", lambda *_, beside=beside: iter([beside]))
        if asked == 3.0:
            assert fallback_targets._with_existing_throws(planned(), beside, 60.0) is None  # type: ignore[arg-type]
        else:
            with pytest.raises(AssertionError, match="2"):
                fallback_targets._with_existing_throws(planned(), beside, 60.0)  # type: ignore[arg-type]


def test_a_plan_makes_the_turns_that_are_asked_and_its_file_says_them(tmp_path: Path) -> None:
    given = {"contact": 0.0, "turns": 2.0, "settle": 1.5, "time_budget": 300.0}
    plan = hf.plan_cast(CORD, ARM, hf.Peg(-0.5, -0.6, 0.015), on_plan=lambda _: True, **given)  # type: ignore[arg-type]
    assert plan.success, plan.message
    assert plan.outcome is not None
    assert plan.finer_outcome is not None
    assert min(abs(plan.outcome.turns), abs(plan.finer_outcome.turns)) >= 2.0
    plan.to_toml(tmp_path / "cast.toml")
    back = hf.read_plan(tmp_path / "cast.toml")
    assert back.problem == plan.problem
    assert (back.problem.turns, back.problem.settle) == (2.0, 1.5)
    text = (tmp_path / "cast.toml").read_text("utf-8")
    (tmp_path / "old.toml").write_text(text.replace("turns = 2.0\nsettle = 1.5\n", "", 1), "utf-8")
    before = hf.read_plan(tmp_path / "old.toml")  # of a plan that was written before these could be asked
    assert (before.problem.turns, before.problem.settle) == (MIN_TURNS, SETTLING_TIME)
