"""Complete casts on short ropes with few links, their margins, and the use of options by a search."""

import os
import re
import signal
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.budget import Budget, OutOfTime
from hyperflex.planning import (
    Accuracy,
    Moves,
    casting,
    estimate_success_probability,
    replan_cast,
    rollouts,
    scaled_rope,
    verify_cast,
)
from hyperflex.planning.casting import CastRequest, fewer_turns, plan_each
from hyperflex.planning.ensemble import SPARE, margin, repeatable, verify_members
from hyperflex.planning.planner import Candidate
from hyperflex.planning.rollouts import MODEL, RolloutBatch, fly_to_strikes, simulate_contact
from hyperflex.planning.swings import DELAY, Strike
from hyperflex.planning.tasks.wind import WindTask, pumped
from hyperflex.planning.verification import CAST_ACCURACY
from tests.planning import known
from tests.planning.known import planned
from tests.refusals import refuses

CORD = hf.Rope.uniform(length=1.2, mass=0.05, n_links=15, radius=0.002, friction=2e-4)
ARM, PEG = hf.Arm(length=0.15), hf.Peg(-0.5, -0.7, 0.03)
FAR = hf.Peg(-1.3, -0.55, 0.03)  # out of reach
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)


def processor(seconds: float) -> Budget:
    """Return a budget of processor time, of one thread, which other work on the machine does not shorten."""
    return Budget(seconds, threads=1, clock=time.process_time)


@pytest.fixture(scope="module")
def cast() -> hf.CastPlan:
    return hf.plan_cast(CORD, ARM, PEG, time_budget=processor(60.0), on_plan=lambda plan: True)


def test_a_cast_winds_and_holds_in_a_run_that_the_planner_did_not_make(cast):
    assert cast.success
    assert not cast.message
    assert cast.margin >= 0.0
    assert cast.runs > 0
    finer = hf.Problem(hf.with_links(CORD, 38), ARM)
    assert verify_cast(finer, PEG, cast.motion, accuracy=Accuracy(contact_step=1e-4)).success
    assert cast.motion.angle(0.0) == pytest.approx(cast.moves.side * np.pi / 2)
    planned, shorter = (each.run.rope.length.min() / (PEG.radius + CORD.radius) for each in cast.outcomes)
    assert planned <= 0.3 < shorter <= 0.5  # links near the peg, in radii of the rope's axis on it


def test_a_plan_continues_from_states_that_were_measured(cast):
    """A rope longer than the planned one: the first moves are planned again, and it winds."""
    moves, problem = cast.moves, replace(cast.problem, rope=scaled_rope(CORD, 1.02, 1.0, 1.0))
    stops = [moves.first(k).stops(problem.limits) for k in (1, 2)]  # before it touches the target
    run = hf.simulate(problem.rope, cast.motion, arm=ARM, duration=stops[-1], t_eval=[0.0, *stops])
    seen = [(moves.first(k), hf.RopeState(t, run.q[k], run.qd[k])) for k, t in enumerate(stops, 1)]
    found = replan_cast(
        replace(cast, problem=problem),
        [moves],
        seen,
        anew=False,
        time_budget=processor(30.0),
        options=hf.SearchOptions(),
    )
    assert found.success, found.message
    assert found.moves.begins_with(seen[0][0])
    assert found.outcome.run.t[-1] < cast.outcome.run.t[-1]  # from there on
    assert verify_cast(problem, PEG, found.motion).success


def test_a_search_starts_from_plans_for_targets_near_by(cast):
    near = replace(PEG, x=PEG.x + 0.004)
    options = hf.SearchOptions(start_from=[cast], members=0)
    again = hf.plan_cast(CORD, ARM, near, time_budget=processor(30.0), options=options, on_plan=lambda plan: True)
    assert again.success
    assert again.runs < 20


def test_many_targets_are_planned_in_their_order(cast):
    options = hf.SearchOptions(start_from=[cast], threads=1)
    targets = [replace(PEG, y=9.0), PEG]
    plans = hf.plan_cast(CORD, ARM, targets, time_budget=30.0, options=options, on_plan=lambda plan: True)
    assert [plan.target for plan in plans] == targets
    assert [plan.success for plan in plans] == [False, True]
    with ProcessPoolExecutor(1) as executor:
        some = hf.plan_cast(CORD, ARM, targets[:1], options=replace(options, executor=executor))
    assert [plan.message for plan in some] == [plans[0].message]


def test_the_same_seed_draws_the_same_moves():
    def drawn(seed):
        task, found = WindTask(hf.Problem(CORD, ARM), PEG, hf.SearchOptions(seed=seed, threads=1)), []
        while not found:
            found = task.sample([], Budget(threads=1))
        return [float(one.moves.rests.sum()) for one in found]

    assert drawn(0) == drawn(0) != drawn(1)


def test_ctrl_c_before_anything_was_found_is_distinguished_from_the_end_of_the_time():
    looks = []

    def clock():
        looks.append(1)
        if len(looks) == 40:
            os.kill(os.getpid(), signal.SIGINT)
        return time.monotonic()

    with pytest.raises(hf.Interrupted) as caught:
        hf.plan_cast(
            CABLE, hf.Arm(length=0.105), hf.Peg(1.0, 0.3, 0.03), time_budget=Budget(60.0, threads=1, clock=clock)
        )
    plan = caught.value.partial
    assert (plan.moves, plan.message) == (None, "interrupted before a plan was found")


def test_an_interrupted_plan_of_a_worker_is_filed_under_its_own_target():
    def interrupt(plan):
        raise KeyboardInterrupt

    with ThreadPoolExecutor(1) as pool:
        options = hf.SearchOptions(executor=pool, chunk_size=2, threads=1)
        given = hf.MotorLimits(), hf.WindCriteria(), hf.Conditions(), None, 60.0, options, interrupt
        plans, stop = plan_each(CastRequest(CORD, ARM, *given), [FAR, PEG])
    assert stop.received
    assert {number: (plan.target, plan.success, plan.interrupted) for number, plan in plans.items()} == {
        1: (PEG, True, True)
    }


def test_targets_and_fallbacks_share_a_budget_that_is_given():
    slippery = [hf.Peg(x, -0.7, 0.03, 0.02) for x in (-0.5, 0.5)]
    plans = hf.plan_cast(CORD, ARM, slippery, time_budget=processor(2.0))
    assert all(
        plan.runs and 0.3 < plan.seconds < 1.8 for plan in plans
    )  # neither takes it all; the first loads kernels


def test_a_fallback_that_fails_is_none():
    """No place for so thick a peg has twice the rope that is needed, so that all are planned for."""
    plan = hf.plan_cast(
        CORD, ARM, hf.Peg(-1.3, -0.55, 0.06), time_budget=1e-9, options=hf.SearchOptions(fallback=True, threads=1)
    )
    assert plan.message.startswith("out of reach")
    assert plan.fallback is None


def test_ctrl_c_as_a_search_for_a_fallback_begins_leaves_the_failed_plan(monkeypatch):
    def begun(problem, peg, *given, **named):
        if peg != FAR:
            raise KeyboardInterrupt
        return WindTask(problem, peg, *given, **named)

    monkeypatch.setattr(casting, "WindTask", begun)
    with pytest.raises(hf.Interrupted) as caught:
        hf.plan_cast(CORD, ARM, FAR, options=hf.SearchOptions(fallback=True))
    plan = caught.value.partial
    assert plan.message.startswith("out of reach")
    assert (plan.interrupted, plan.fallback.plan) == (True, None)


def test_a_motor_that_turns_to_one_side_alone_swings_the_rope_up():
    left = hf.MotorLimits(angles=(-3.14, 0.0))
    plan = hf.plan_cast(CORD, ARM, PEG, left, time_budget=processor(20.0), on_plan=lambda plan: True)
    assert plan.success
    angles = plan.moves.angles(left)
    assert -3.14 <= angles.min() < angles.max() <= 0.0


def test_a_search_without_a_strike_counts_its_runs():
    options = hf.SearchOptions(threads=1)
    slow, target = hf.MotorLimits(speed=2.0), hf.Peg(-0.8, -1.0, 0.04)
    plan = hf.plan_cast(CABLE, hf.Arm(length=0.105), target, slow, time_budget=processor(1.0), options=options)
    assert plan.runs > 0
    assert plan.message == "no moves were found that strike it"


@pytest.mark.parametrize(
    ("mu", "turns", "message"),
    [(0.3, 2.6, r"turns at most, 2\.6 required"), (0.0, 1.75, r"moves wind the rope .* turns, but it comes off again")],
)
def test_a_search_that_fails_reports_how_far_the_rope_winds(mu, turns, message):
    target, criteria, options = (
        replace(PEG, mu=mu),
        hf.WindCriteria(turns=turns),
        hf.SearchOptions(skip_feasibility=True),
    )
    plan = hf.plan_cast(CORD, ARM, target, criteria=criteria, time_budget=processor(2.0), options=options)
    assert re.search(message, plan.message)


def test_places_and_ropes_that_the_planner_tries_are_not_asked_about():
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        wrong = hf.Peg(-800.0, -1000.0, 40.0)
        assert len(seen) == 2
        assert not hf.plan_cast(CORD, ARM, wrong).success
    assert len(seen) == 2


def test_no_time_is_stated():
    plan = hf.plan_cast(CORD, ARM, PEG, time_budget=1e-9)
    assert not plan.success
    assert "time budget" in plan.message
    assert "friction" not in plan.message
    assert "(mu 0)" in hf.plan_cast(CORD, ARM, replace(PEG, mu=0.0), time_budget=1e-9).message


def test_a_failed_plan_names_remedies_and_a_fallback_that_can_be_planned():
    plan = hf.plan_cast(CORD, ARM, FAR, time_budget=processor(60.0), options=hf.SearchOptions(fallback=True))
    assert plan.message.startswith("out of reach")
    assert plan.remedies
    assert plan.fallback.plan.success
    assert plan.fallback.plan.target == plan.fallback.target
    assert plan.fallback.distance == pytest.approx(
        np.hypot(plan.fallback.target.x + 1.3, plan.fallback.target.y + 0.55)
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target": "there"}, "target is not a peg"),
        ({"target": (2.5, 0.0, 0.03)}, r"target is not a peg: got \(2.5, 0.0, 0.03\)"),
        ({"target": hf.Peg(0.5, -0.5, 0.03, inertia=1e-3)}, "fixed targets"),
        ({"criteria": hf.Conditions()}, "criteria is no WindCriteria"),
        ({"uncertainty": 0.1}, "uncertainty is no "),
        ({"time_budget": -1.0}, "time_budget"),
    ],
)
def test_arguments_of_another_kind_are_refused(change, message):
    refuses(message, hf.plan_cast, **{"rope": CORD, "arm": ARM, "target": PEG, **change})


def test_criteria_are_required_of_a_run():
    plan = planned()
    motion = plan.motion
    for criteria in (hf.WindCriteria(turns=9.0), hf.WindCriteria(contact=40.0), hf.WindCriteria(max_slip=1e-9)):
        assert not verify_cast(replace(plan.problem, criteria=criteria), plan.target, motion).success


@pytest.mark.nightly
def test_a_robust_plan_states_how_often_it_succeeds():
    known = hf.Uncertainty(length=0.002, mass=0.0, friction=0.02, mu=0.0, lag=0.0, timing=1e-3, place=1e-3)
    plan = hf.plan_cast(CORD, ARM, PEG, uncertainty=known, time_budget=processor(25.0))
    chance = plan.success_probability
    assert plan.success
    assert chance.samples > 0
    assert chance.estimate >= 0.5
    low, high = chance.interval
    assert low <= chance.estimate <= high
    other = estimate_success_probability(
        plan.problem, PEG, plan.moves, known, samples=16, options=hf.SearchOptions(seed=5, threads=1)
    )
    assert abs(other.estimate - chance.estimate) <= 0.5


def test_the_margin_is_the_least_of_what_is_to_spare():
    outcome, criteria = planned().outcome, hf.WindCriteria()
    outcome = replace(outcome, turns=-2.0, slip=0.0, load_ratio=0.5, spare_clearance=1.0, tip_hangs=True, folded=False)
    assert margin(criteria, outcome, outcome) == pytest.approx(1.0 / SPARE.slip)
    for change, value in (
        ({"turns": -1.26}, 0.01 / SPARE.turns),
        ({"slip": 0.9 * criteria.max_slip}, 0.1 / SPARE.slip),
        ({"load_ratio": 2.0}, 0.5),
        ({"spare_clearance": 1e-3}, 1e-3 / SPARE.clearance),
        ({"tip_hangs": False}, 0.75 / SPARE.falling),
        ({"folded": True}, 0.0),
    ):
        worse = replace(outcome, **change)
        assert margin(criteria, worse, worse) == pytest.approx(value)
    assert margin(criteria, outcome, replace(outcome, turns=-1.4)) == pytest.approx(0.15 / 0.6)  # runs that differ


def test_runs_that_disagree_leave_the_cast_to_chance():
    outcome = replace(planned().outcome, spare_clearance=0.1)
    assert repeatable(outcome, outcome).success
    grazes = replace(outcome, touch_time=outcome.touch_time - 2.0)
    assert repeatable(outcome, grazes).success
    assert not repeatable(outcome, replace(grazes, strike_time=outcome.strike_time + 0.1)).success
    assert not repeatable(outcome, replace(outcome, turns=-outcome.turns)).success
    assert not repeatable(replace(outcome, spare_clearance=8e-3), replace(outcome, spare_clearance=1e-3)).success


@pytest.mark.parametrize(("third", "succeeds"), [(0.1, True), (0.2, False)])
def test_a_rope_that_strikes_at_another_time_with_shorter_links_does_so_with_others_too(monkeypatch, third, succeeds):
    outcome, links = planned().outcome, CORD.n_links
    later = {links: 0.0, 3 * links: 0.1, 2 * links: third}

    def verified(problem, *_, **__):
        t = 1.0 + later[problem.rope.n_links]
        return replace(outcome, touch_time=t, strike_time=t)

    monkeypatch.setattr("hyperflex.planning.ensemble.verify_cast", verified)
    problem, one = hf.Problem(CORD, ARM), Candidate(planned().moves, 1.0, 1.0)
    found = verify_members(problem, [problem.cut(3), problem.cut(2)], PEG, one, Budget(threads=1))
    assert (not found.message) == succeeds
    assert found.message.startswith("with other links it strikes the peg 0.10 s later") != succeeds


@pytest.mark.parametrize("threads", [1, 2])
def test_a_cast_that_fails_with_shorter_links_alone_says_so(monkeypatch, threads):
    """With two threads the run with shorter links fails while the other one goes on: that one is ended."""
    outcome, links = planned().outcome, CORD.n_links

    def verified(problem, *_, time_budget, **__):
        if problem.rope.n_links != links:
            return replace(outcome, message="it slips", held=False)
        while threads == 2 and not time_budget.expired:
            time.sleep(1e-3)
        return replace(outcome, message="too late", held=False, n_links=0) if threads == 2 else outcome

    monkeypatch.setattr("hyperflex.planning.ensemble.verify_cast", verified)
    problem, one = hf.Problem(CORD, ARM), Candidate(planned().moves, 1.0, 1.0)
    found = verify_members(problem, [problem.cut(3)], PEG, one, Budget(threads=threads))
    assert found.message == "with shorter links it slips"
    assert (found.outcome is None) == (threads == 2)
    assert found.finer_outcome.message == "it slips"


def test_swings_are_those_of_free_flight_until_the_strike_with_any_links():
    task = WindTask(hf.Problem(CORD, ARM), PEG, hf.SearchOptions(threads=1))
    budget, found = Budget(threads=1), []
    while not found:
        found = task.sample([], budget)
    for one in found[:3]:
        motion = one.moves.motion(task.problem.limits)
        times = []
        for problem in (task.problem, task.problem.cut(3), task.problem.cut(5)):
            batch = RolloutBatch.from_start(problem, [problem.rope], [PEG], [motion])
            times.append(float(fly_to_strikes(problem, PEG, batch, budget).t[0]))
        assert times == pytest.approx([one.t] * 3, abs=DELAY)  # the agreement that the search requires of two chains


def test_strikes_and_swings_of_a_rope_without_friction_are_those_that_chains_agree_on():
    rope = hf.Rope.uniform(length=2.5, mass=0.2, n_links=20, radius=0.004, friction=1e-5)
    search = WindTask(
        hf.Problem(rope, hf.Arm(length=0.25)), hf.Peg(1.0, -0.3, 0.03), hf.SearchOptions(threads=1)
    ).search
    found = [one for _ in range(12) for one in search.extend(Budget(threads=1))]
    assert found
    assert all(abs(one.states[0].t - one.states[1].t) <= DELAY for one in found)
    for one in found:
        coarse, fine = one.swing.states
        apart = (
            np.sin(coarse.q) - np.sin(fine.q).reshape(-1, 3).mean(axis=1),
            np.cos(coarse.q) - np.cos(fine.q).reshape(-1, 3).mean(axis=1),
        )
        ends = rope.length * np.stack(apart)
        assert np.sqrt((np.cumsum(ends, axis=1) ** 2).sum(axis=0).mean()) <= 0.02 * rope.total_length


def test_a_wound_rope_that_slips_is_given_time_to_settle():
    """After a fast last move it slips by 0.7 mm while it is watched; a period of its swing later it does not."""
    who, moves = known.problem(), known.WINDS.then(1.0, 0.5)
    found, motion = known.simulated_strikes(who, known.PEG, [moves]), moves.motion(who.limits)
    start = found.q, found.qd
    batch = RolloutBatch([who.rope], [known.PEG], [motion.shifted(-float(found.t[0]))], *start)
    hurried, settled = (simulate_contact(who, batch, found.t, Budget(threads=1), periods=periods) for periods in (0, 2))
    assert hurried.dwell == 0.0
    assert hurried.slip > 5e-4
    assert settled.dwell == pytest.approx(who.period)
    assert settled.slip < 5e-5
    assert settled.turns >= hurried.turns
    waits = moves.waiting(float(settled.dwell[0])).motion(who.limits)
    assert waits.end == pytest.approx(motion.end + who.period)


def test_a_wound_rope_that_loses_turns_as_it_swings_is_given_time_to_settle():
    who, moves = replace(known.problem(), criteria=hf.WindCriteria(turns=1.27)), known.WINDS.then(1.0, 0.5)
    found = known.simulated_strikes(who, known.PEG, [moves])
    batch = RolloutBatch(
        [who.rope], [known.PEG], [moves.motion(who.limits).shifted(-float(found.t[0]))], found.q, found.qd
    )
    hurried, settled = (simulate_contact(who, batch, found.t, Budget(threads=1), periods=periods) for periods in (0, 2))
    assert hurried.turns < who.criteria.turns <= settled.turns
    assert np.isinf(hurried.slip)
    assert settled.slip < who.criteria.max_slip
    assert settled.dwell > 0.0


def test_a_wound_rope_that_still_swings_in_a_verified_run_is_given_time_to_settle(monkeypatch):
    who, moves = known.problem(), known.WINDS.then(1.5, 0.5)
    hurried = verify_cast(who, known.PEG, moves.motion(who.limits), accuracy=CAST_ACCURACY)
    assert re.search(r"turns 1\.2[23] remain while it is watched", hurried.message)
    found = WindTask(who, known.PEG, hf.SearchOptions(threads=1)).verify(Candidate(moves, 1.0, 1.0), Budget(threads=1))
    assert not found.message
    assert found.candidate.moves.dwell == pytest.approx(rollouts.MODEL.periods * who.period)
    assert abs(found.outcome.turns) == pytest.approx(abs(hurried.turns), abs=0.03)

    def out_of_time(problem, finer, peg, one, *given):
        if one.moves.dwell:
            raise OutOfTime
        return verify_members(problem, finer, peg, one, *given)

    monkeypatch.setattr("hyperflex.planning.tasks.wind.verify_members", out_of_time)
    found = WindTask(who, known.PEG, hf.SearchOptions(threads=1)).verify(Candidate(moves, 1.0, 1.0), Budget(threads=1))
    assert found.message.startswith("with shorter links of 2.68 turns 1.22 remain")
    assert found.candidate.moves.dwell == 0.0


def test_moves_to_begin_with_do_not_wait_before_it_is_known_that_they_must():
    who = known.problem()
    task = WindTask(who, known.PEG, hf.SearchOptions(threads=1), start=[known.WINDS.waiting(3.0)])
    (one,) = task.sample([], Budget(threads=1))
    assert one.follow[0].dwell == one.moves.dwell == 0.0


def test_a_strike_after_the_time_limit_does_not_count():
    problem, budget, found = hf.Problem(CORD, ARM), Budget(threads=1), list[Strike]()
    search = WindTask(problem, PEG, hf.SearchOptions(threads=1)).search
    while not found:
        found = search.extend(budget)
    for limit, count in ((found[0].t + 0.2, 1), (found[0].t - 0.2, 0)):
        limited = WindTask(replace(problem, time=limit), PEG, hf.SearchOptions(threads=1)).search
        assert len(limited.start([found[0].moves], budget)) == count


def test_swings_of_a_rope_with_dry_friction_are_nearly_those_of_stiction_in_a_search_and_exact_elsewhere():
    dry = hf.Problem(CORD.replace(dry_friction=2e-3), ARM)
    moves = pumped(dry, pumped(dry, Moves(1, np.zeros(0), np.zeros(0))))
    batch = RolloutBatch.from_start(dry, [dry.rope], [], [moves.motion(dry.limits)])
    t, q, _ = replace(batch, stiction=MODEL.stiction).fly(ARM, 1.5, Budget(threads=1))
    _, stuck, _ = batch.fly(ARM, 1.5, Budget(threads=1))
    exact = hf.simulate(dry.rope, batch.motions[0], arm=ARM, duration=2.0, q0=batch.q[0], t_eval=t)
    away = dry.rope.joints(q[0], np.zeros((t.size, 2))) - dry.rope.joints(exact.q, np.zeros((t.size, 2)))
    # The tolerance is 0.04 rad/s: angles differ by up to 0.04 rad near the light end
    assert 0.001 * dry.rope.total_length < np.hypot(*away.T).max() < 0.02 * dry.rope.total_length
    # flights err by 1e-4 m in links of 0.08 m
    np.testing.assert_allclose(stuck[0], exact.q, rtol=0, atol=1e-3)


def test_a_reach_map_reads_back_equal(tmp_path):
    grid = hf.TargetGrid(x=[-0.5, 2.5], y=[-0.7], radius=0.03)
    found = hf.build_reach_map(CORD, ARM, grid=grid, time_budget=30.0, options=hf.SearchOptions(threads=1))
    assert found.status.tolist() == [[0, 1]]
    assert found.turns[0, 0] >= 1.25
    assert found.complete
    found.to_netcdf(tmp_path / "map.nc")
    again = hf.read_reach_map(tmp_path / "map.nc")
    assert again.problem == found.problem
    assert np.array_equal(again.status, found.status)
    refuses("not increasing", hf.build_reach_map, CORD, ARM, grid=hf.TargetGrid(x=[1.0, 0.5]))


def test_a_plan_that_fails_by_its_turns_reports_how_many_it_keeps():
    plan = planned()
    more = replace(plan.problem.criteria, turns=3.5)
    failed = replace(plan, problem=replace(plan.problem, criteria=more), message="of 2.37 turns 2.36 remain")
    (said,) = fewer_turns(failed)
    turns = float(said.removesuffix(" turns required"))
    assert 2.0 < turns < abs(plan.outcome.turns)
    easier = replace(plan.problem, criteria=replace(more, turns=turns))
    assert verify_cast(easier, plan.target, plan.motion).success
    (alone,) = fewer_turns(replace(failed, outcome=None))  # as planned it did not end
    assert "in one run of two" in alone
    assert "in one run" not in said
    assert fewer_turns(plan) == ()  # it succeeds
    aside = replace(plan.target, x=plan.target.x - 0.2)
    assert fewer_turns(replace(failed, target=aside)) == ()  # 0.2 turns are none
    slips = replace(failed.problem, criteria=replace(more, max_slip=1e-9))
    assert fewer_turns(replace(failed, problem=slips)) == ()  # fewer turns do not help
