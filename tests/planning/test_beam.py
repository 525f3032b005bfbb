"""Swings found stroke by stroke, against whole flights from rest; and throws that are looked at with shorter links."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.control import swing_period
from hyperflex.planning import MotorLimits, Problem
from hyperflex.planning.problem import MIN_TURNS
from hyperflex.planning.search import beam, strikes
from hyperflex.planning.search.beam import BACK, SIZES, BeamSearch
from hyperflex.planning.search.candidates import APART, SCREENED, SHARED, Candidate, Swing, corrected
from hyperflex.planning.search.contact_phase import WindingScores
from hyperflex.planning.search.known_strikes import moved_to
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.throw import LAST, ThrowParametrization
from hyperflex.simulation import Batch
from tests.planning.known import simulated_strikes

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=20, radius=0.0025, friction=5e-4)
CAST_SETUP = Problem(CABLE, hf.Arm(length=0.105), MotorLimits(), 8.0)
LEVEL = hf.Peg(1.1, -0.6, 0.03)  # 60 degrees aside: a swing must be wide to strike it with much energy
FAR = hf.Peg(9.0, 0.0, 0.03)


def searched(peg: hf.Peg, time: float, seed: int = 1, most: int = 20, problem: Problem = CAST_SETUP) -> BeamSearch:
    found = BeamSearch(problem, peg, (-1, 1), np.random.default_rng(seed))
    found.extend(time, most)
    return found


def test_a_strike_is_that_of_the_whole_flight_from_rest() -> None:
    """Its strokes, flown at once: same time, same score; two integrations at a tolerance of 0.1 mm."""
    patient = replace(CAST_SETUP, time=11.0)
    found = BeamSearch(CAST_SETUP, LEVEL, (-1, 1), np.random.default_rng(1)).extend(patient.time, 20)
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)
    genes = {side: ThrowParametrization(patient, side) for side in (-1, 1)}
    some = [one for one in found if len(one.strokes) <= genes[1].strokes]
    assert len(some) > 10
    throws = [genes[one.side].throw(genes[one.side].point(one.strokes, one.rests, one.after + 0.04)) for one in some]
    whole = simulated_strikes(patient, LEVEL, [throw.cut(patient.time, patient.limits) for throw in throws])
    close = np.abs(whole.t - [one.t for one in some]) < 2.0 * strikes.SAMPLE_TIME  # samples of both begin elsewhere
    assert close.all()
    assert np.median(np.abs(whole.score - [one.score for one in some])) < 0.1


def test_swings_gain_energy_far_from_any_target() -> None:
    """Faster than steady pumping at half the period of a small swing, in time with which a wide one is not."""
    best = max(one.energy for one in searched(FAR, 7.0)._swings)
    genes = ThrowParametrization(CAST_SETUP, 1)
    steady = genes.throw(genes.centre())
    motion = steady.motion(CAST_SETUP.limits)
    ends = steady.starts(CAST_SETUP.limits)[:-1]
    t = ends[(ends > 1.0) & (ends < 8.5)]  # the arm rests before each stroke
    run = hf.simulate(CABLE, motion, arm=CAST_SETUP.arm, duration=float(t[-1]), t_eval=t)
    base = np.stack([np.sin(motion.angle(t)), -np.cos(motion.angle(t))], axis=1) * 0.105
    places, speeds = strikes.mass_points(CABLE, run.q, run.qd, base, np.zeros_like(base))
    energy = (np.append(CABLE.mass, 0.0) * (0.5 * (speeds**2).sum(axis=2) + 9.81 * places[..., 1])).sum(axis=1)
    assert best > energy.max() > energy[0]


def test_no_swing_strikes_before_it_is_continued_and_all_keep_to_the_motor() -> None:
    slow = replace(CAST_SETUP, limits=MotorLimits(angles=(-2.0, 1.0)))
    swings = searched(LEVEL, 5.0, problem=slow)._swings
    assert swings
    for one in swings:
        angles = one.side * np.pi / 2 if one.side < 0 else 1.0
        for k, stroke in enumerate(one.strokes):
            angles += -one.side * (-1) ** k * stroke
            assert -2.0 - 1e-9 <= angles <= 1.0 + 1e-9
        assert angles == pytest.approx(one.angle)
        assert (np.array(one.rests) >= 0.0).all()
        base = np.array([[[np.sin(one.angle), -np.cos(one.angle)]]]) * 0.105
        gaps = [strikes.first_contact(q[None, None], base, CABLE.length, LEVEL, CABLE.radius)[2][0] for q in one.q]
        assert min(gaps[1:], default=1.0) > 0.0


def test_a_search_goes_on_where_it_stopped_and_ends_at_so_many_strokes() -> None:
    found = searched(FAR, 3.0)
    before = found.runs
    assert not found.ready(3.0, 20)
    assert found.ready(6.0, 20)
    found.extend(6.0, 20)
    assert found.runs > before
    assert min(one.end for one in found._swings) >= 6.0
    assert {len(one.strokes) for one in searched(FAR, 60.0, most=3)._swings} == {3}


def test_only_so_many_are_continued_and_few_after_the_same_strokes() -> None:
    swings = searched(FAR, 60.0, most=5)._swings
    for side in (-1, 1):
        mine = [one for one in swings if one.side == side]
        assert 1 < len(mine) <= beam.WIDTH
        parents = [(one.strokes[:-1], one.rests[:-1]) for one in mine]
        assert max(parents.count(one) for one in parents) <= beam.EACH


def test_a_swing_that_fails_later_is_not_continued(monkeypatch: pytest.MonkeyPatch) -> None:
    run = RolloutBatch.run

    def failing(self: RolloutBatch, *args: Any, **how: Any) -> Batch:
        batch = run(self, *args, **how)
        if "qd" in how["keep"]:
            batch.q[:, -1] = np.nan
        return batch

    monkeypatch.setattr(RolloutBatch, "run", failing)
    assert not searched(FAR, 3.0)._swings


def test_a_motor_that_turns_little_makes_each_stroke_once() -> None:
    narrow = replace(CAST_SETUP, limits=MotorLimits(angles=(-0.5, 0.5)))
    found = searched(FAR, 60.0, most=3, problem=narrow)
    assert len(found._swings) > 3
    assert max(max(one.strokes) for one in found._swings) <= 1.0 + 1e-9
    for one in found._swings:
        sense = -one.side * (-1) ** len(one.strokes)
        tries = found._continuations(one._replace(angle=0.3 * sense))  # most strokes end where the motor does
        assert len({(each.rest, each.angle) for each in tries}) == len(tries) > 0


def test_swings_left_to_chance_are_not_continued(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where all are, those are that differ least with shorter links, up to a bound."""
    most = len(searched(FAR, 3.0)._swings)
    monkeypatch.setattr(beam, "MAX_DEVIATION", 0.0)
    assert 0 < len(searched(FAR, 3.0)._swings) < most
    monkeypatch.setattr(beam, "MAX_LEAST", 0.0)
    assert not searched(FAR, 3.0)._swings


def test_a_search_ends_where_swings_are_worth_a_try_and_goes_on_from_there() -> None:
    work = ThrowSearch(CAST_SETUP, hf.Peg(1.36 * np.sin(0.66), -1.36 * np.cos(0.66), 0.04))
    score = work.beam_search(0.1)
    assert score > 0.1
    assert work.climbing
    runs = work.runs
    assert work.beam_search() >= score
    assert work.runs > runs
    assert not work.climbing


def test_a_search_makes_full_strokes_first_and_by_turns_others_where_these_are_not_enough() -> None:
    """A full stroke is 0.95 of half a turn."""
    work = ThrowSearch(CAST_SETUP, hf.Peg(1.36 * np.sin(0.66), -1.36 * np.cos(0.66), 0.04))
    sizes = []
    for enough in (0.1, np.inf, np.inf, np.inf):  # the second call continues the first search
        work.swings.clear()
        work.beam_search(enough)
        made = {round(float(each), 6) for one in work.swings for each in one.x[: work.parametrizations[1].strokes]}
        sizes.append(made == {0.95})
    assert sizes == [True, True, True, False]


def test_a_search_whose_time_is_over_begins_nothing() -> None:
    found = BeamSearch(CAST_SETUP, LEVEL, (-1, 1), np.random.default_rng(1))
    assert found.extend(8.0, 20, lambda: 0.0) == []
    assert found.runs == 0
    work = ThrowSearch(CAST_SETUP, LEVEL)
    work.left = lambda: 0.0
    work.candidates = [
        Candidate(
            2.0,
            2.0,
            1,
            work.parametrizations[1].centre(),
            work.parametrizations[1].throw(work.parametrizations[1].centre()),
        )
    ]
    work.confirm()
    assert work.runs == 0


def test_a_swing_of_a_search_strikes_when_it_was_found_to() -> None:
    """Also those that strike long after their last stroke: the next one waits."""
    patient = replace(CAST_SETUP, time=11.0)
    work = ThrowSearch(patient, LEVEL, seed=2)
    work.beam_search()
    some = [one for one in work.swings if one.score >= 0.0]
    throws = [work.parametrizations[one.side].throw(one.x).cut(patient.time, patient.limits) for one in some]
    assert len(some) > 5
    assert simulated_strikes(patient.cut(beam.FINER), LEVEL, throws).t == pytest.approx([one.t for one in some])


def test_a_search_that_has_ended_begins_again_some_strokes_before_the_first_strike() -> None:
    work = ThrowSearch(CAST_SETUP, LEVEL, seed=2)
    score = work.beam_search()
    assert score == work.swings[0].score
    assert all(one.t < CAST_SETUP.time for one in work.swings)
    beam, before = work._beam, len(work.swings)
    assert beam is not None
    first = min(len(one.strokes) for one in beam._strikes)
    beam.restart(SIZES)
    assert {len(one.strokes) for one in beam._swings} == {max(0, first - BACK)}
    again = beam.extend(CAST_SETUP.time, 9)
    assert again
    assert min(len(one.strokes) for one in again) > max(0, first - BACK)
    assert not {(one.strokes, one.rests) for one in again} & {
        (one.strokes, one.rests) for one in beam._strikes[:before]
    }
    work = ThrowSearch(replace(CAST_SETUP, time=3.0), FAR)  # strikes nothing
    assert work.beam_search() == strikes.NEVER
    runs = work.runs
    assert work.beam_search() == strikes.NEVER
    assert work.runs > runs


def test_a_swing_counts_what_it_does_with_shorter_links_if_that_is_less(monkeypatch: pytest.MonkeyPatch) -> None:
    work = ThrowSearch(CAST_SETUP, LEVEL)
    genes = work.parametrizations[1]
    found = [Swing(score, 1, genes.centre() + k, 3.0) for k, score in enumerate((2.0, 1.0))]
    seen = []

    def finer(self: ThrowSearch, problem: Problem, throws: list, **_: object) -> object:
        seen.append(problem.rope.n_links)
        return replace(struck_at(3.1, 3.2), score=np.array([0.5, 3.0]))

    monkeypatch.setattr(ThrowSearch, "_strikes", finer)
    assert work._keep(found) == 1.0
    assert ([(one.score, one.t) for one in work.swings], seen) == ([(1.0, 3.2), (0.5, 3.1)], [3 * CABLE.n_links])


def struck_at(*t: float) -> strikes.Strikes:
    """Strikes with shorter links at given times, of a rope that hangs."""
    count, q = len(t), np.zeros((2, len(t), 3 * CABLE.n_links))
    return strikes.Strikes(*np.zeros((3, count)), np.array(t), *q, np.zeros(count, np.int64))


def landings(work: ThrowSearch, count: int = 6) -> list[Candidate]:
    """Pairs of throws from the same swing: their last moves differ, and what comes after the strike."""
    genes, made = work.parametrizations[1], []
    for k in range(count):
        x = genes.centre()
        x[0] -= 2.0 * APART * (k // 2)
        x[-LAST + 1] = 0.1 * k
        x[genes.strokes - 1] -= 0.5 * k  # a stroke that is not made
        throw = replace(genes.throw(x), count=3)
        made.append(Candidate(3.0 - 0.1 * k, 2.5 - 0.1 * k, 1, x, throw))
    return made


def test_swing_after_swing_is_refined_until_a_throw_winds(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one is again where all of them were in vain, or where it winds."""
    seen: list[float] = []

    def evaluate(self: ThrowSearch, points: list, until: float) -> np.ndarray:
        seen.append(float(np.mean([x[0] for _, x in points])))
        return np.zeros(len(points))

    monkeypatch.setattr(ThrowSearch, "evaluate", evaluate)
    for turns, order in ((0.5, (0, 1, 2, 0)), (2.0, (0, 0, 0, 0))):
        work = ThrowSearch(CAST_SETUP, LEVEL)
        work.candidates = [one._replace(turns=turns) for one in landings(work)[:6]]
        seen.clear()
        for _ in order:
            work.evolve_throws()
            work.restart()
        first = work.candidates[0].x[0]
        assert seen == pytest.approx([first - 2.0 * APART * k for k in order], abs=0.5 * APART)


def test_throws_that_do_not_wind_with_shorter_links_lose_and_so_do_those_of_the_same_swing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    work = ThrowSearch(CAST_SETUP, LEVEL)
    work.candidates = landings(work)
    ran = []

    def again(problem: Problem, throws: list, struck: object) -> WindingScores:
        ran.append(len(throws))
        good = np.array([throw.strokes[0] < np.pi * (0.95 - 3.0 * APART) for throw in throws])
        return WindingScores(np.where(good, 2.0, 0.3), np.where(good, 1.8, 0.2))

    def flown(self: ThrowSearch, problem: Problem, throws: list, **_: object) -> object:
        assert problem.rope.n_links == 3 * CABLE.n_links
        return struck_at(*len(throws) * [2.0])

    monkeypatch.setattr(ThrowSearch, "_strikes", flown)
    monkeypatch.setattr(work, "_wind", again)
    work.confirm()
    best = work.candidates[0]
    assert (best.confirmed, best.turns, best.score) == (True, 1.8, 2.0)
    assert ran[0] == 3 <= SCREENED  # one of each swing
    failed = [one for one in work.candidates if one.confirmed and one.turns < MIN_TURNS]
    assert failed
    assert all((one.score, one.turns) == (0.3, 0.2) for one in failed)
    spared = [one for one in work.candidates if not one.confirmed and one.x[0] > 0.95 - APART]
    assert [one.turns for one in spared] == pytest.approx([2.4 - SHARED * 2.3])
    ran.clear()
    work.confirm()
    assert not ran  # the best one that winds is sure


def test_a_firm_throw_loses_only_by_what_was_firm_too() -> None:
    """One that winds with shorter links is no worse for another of its swing that does not; but if it fails when it is
    verified, so may the others."""
    sure, other = (
        one._replace(confirmed=firm)
        for one, firm in zip(landings(ThrowSearch(CAST_SETUP, LEVEL), 2), (True, False), strict=True)
    )
    after = corrected([sure, other], other, 0.2, 0.3, MIN_TURNS)
    assert after[0] == sure
    assert (after[1].turns, after[1].score, after[1].confirmed) == (0.2, 0.3, True)
    third = other._replace(confirmed=True)
    after = corrected([sure, third], sure, 0.2, -0.8, MIN_TURNS)
    assert [one.turns for one in after] == pytest.approx([third.turns - SHARED * (sure.turns - 0.2), 0.2])


def test_a_throw_that_strikes_nothing_with_shorter_links_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    work = ThrowSearch(CAST_SETUP, LEVEL)
    work.candidates = landings(work, 1)
    monkeypatch.setattr(ThrowSearch, "_strikes", lambda *_, **__: struck_at(np.nan))
    work.confirm()
    assert (work.candidates[0].turns, work.candidates[0].confirmed) == (0.0, True)


def test_throws_that_differ_in_the_last_move_alone_are_flown_once(monkeypatch: pytest.MonkeyPatch) -> None:
    work = ThrowSearch(CAST_SETUP, LEVEL)
    some = landings(work, 1)[0].x
    other = some.copy()
    other[-LAST:] += 0.3
    third = some.copy()
    third[1] -= 0.2
    points = [some, other, third]
    work = ThrowSearch(CAST_SETUP, hf.Peg(1.36 * np.sin(0.66), -1.36 * np.cos(0.66), 0.04))  # struck by steady pumping
    before = work.runs
    throws = [work.parametrizations[1].throw(x) for x in points]
    found = work._first_strikes([(1, x) for x in points], throws, np.inf)
    assert work.runs - before == 2
    assert found.t[0] == found.t[1]
    assert np.array_equal(found.q[0], found.q[1])
    apart = simulated_strikes(
        CAST_SETUP,
        work.peg,
        [work.parametrizations[1].throw(x).cut(CAST_SETUP.time, CAST_SETUP.limits) for x in points],
    )
    assert np.array_equal(found.t, apart.t)


def test_throws_of_a_swing_that_was_kept_go_on_from_its_strike_with_shorter_links() -> None:
    """Neither those in contact nor those that are looked at again are simulated from rest."""
    work = ThrowSearch(CAST_SETUP, LEVEL, seed=2)
    work.beam_search()
    one = next(one for one in work.swings if one.score > 0.5)
    x = one.x.copy()
    x[-LAST:] += 0.3
    throw, before = work.parametrizations[one.side].throw(x), work.runs
    found = work._first_strikes([(one.side, x)], [throw], np.inf)
    finer = simulated_strikes(CAST_SETUP.cut(beam.FINER), LEVEL, [throw.cut(CAST_SETUP.time, CAST_SETUP.limits)])
    known = moved_to(finer, CAST_SETUP.cut(beam.FINER).rope, CABLE)
    assert (work.runs, found.t[0]) == (before, one.t)
    assert found.q == pytest.approx(known.q, abs=1e-9)
    assert found.qd == pytest.approx(known.qd, abs=1e-7)
    cut = throw.cut(one.t, CAST_SETUP.limits)
    work.candidates = [Candidate(2.0, 2.0, one.side, x, cut, t=one.t)]
    work.confirm()
    assert work.runs == before + 1  # in contact alone
    assert work.candidates[0].confirmed


def test_a_strike_that_puts_the_rope_into_the_target_is_simulated_anew() -> None:
    """Links that are longer than those it is known for may reach into it."""
    work = ThrowSearch(CAST_SETUP, LEVEL, seed=2)
    work.beam_search()
    one = next(one for one in work.swings if one.score > 0.5)
    throw = work.parametrizations[one.side].throw(one.x)
    base, _ = strikes.arm_tip(CAST_SETUP.arm, throw.motion(CAST_SETUP.limits), np.array([one.t]))
    x, y = np.array([LEVEL.x, LEVEL.y]) - base[0]
    known = work._known.find(one.side, one.x, one.t)
    assert known is not None
    assert work._known.find(one.side, one.x, one.t + 0.02) is None  # another strike
    assert work._known.find(-one.side, one.x, one.t) is None
    work._known.add(one.side, one.x, replace(known, q=np.full((1, 3 * CABLE.n_links), np.arctan2(x, -y))))
    before = work.runs
    found = work._first_strikes([(one.side, one.x)], [throw], np.inf)
    assert work.runs == before + 1
    assert found.t == pytest.approx(simulated_strikes(CAST_SETUP, LEVEL, [throw]).t)


def test_a_strike_past_the_limits_of_longer_links_is_simulated_anew() -> None:
    """Joints of short links at their limits add up to more than a longer link's limit."""
    stiff = replace(CAST_SETUP, rope=CABLE.with_bend_radius(0.1))
    work = ThrowSearch(stiff, LEVEL)
    side, x = 1, work.parametrizations[1].centre()
    throw = work.parametrizations[side].throw(x)
    finer = work._known.finer.rope
    bend = np.where(np.arange(finer.n_links) < 9, 0.99 * finer.max_bend[1], 0.0)
    bend[0] = 0.0
    struck = struck_at(1.0)
    work._known.add(side, x, replace(struck, q=-np.cumsum(bend)[None]))
    assert work._known.on_links(stiff, side, x, throw) is None
    work._known.add(side, x, replace(struck, q=-0.2 * np.cumsum(bend)[None]))
    found = work._known.on_links(stiff, side, x, throw)
    assert found is not None
    assert found.q.shape == (1, CABLE.n_links)


def test_known_strikes_serve_other_links_in_contact_as_well() -> None:
    """Those that are cut in two where no throw winds."""
    work = ThrowSearch(CAST_SETUP, LEVEL, seed=2)
    work.beam_search()
    one = next(one for one in work.swings if one.score > 0.5)
    work._in_contact = CAST_SETUP.cut(2)
    before = work.runs
    found = work._first_strikes([(one.side, one.x)], [work.parametrizations[one.side].throw(one.x)], np.inf)
    assert (work.runs, found.q.shape[1]) == (before, 2 * CABLE.n_links)


def test_known_and_new_throws_are_looked_at_again_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each goes on from its own strike."""
    work, seen = ThrowSearch(CAST_SETUP, LEVEL), []
    work.candidates = [one._replace(t=1.0) for one in landings(work)]
    known = work.candidates[2]
    work._known.add(known.side, known.x, struck_at(1.0))

    def flown(self: ThrowSearch, problem: Problem, throws: list, **_: object) -> strikes.Strikes:
        return struck_at(*(2.0 + k for k in range(len(throws))))

    def wind(problem: Problem, throws: list, struck: strikes.Strikes) -> WindingScores:
        seen.append(struck.t.tolist())
        return WindingScores(np.full(len(throws), 2.0), np.full(len(throws), 2.0))

    monkeypatch.setattr(ThrowSearch, "_strikes", flown)
    monkeypatch.setattr(work, "_wind", wind)
    work.confirm()
    assert seen[0] == [2.0, 1.0, 3.0]


def test_the_time_of_a_small_swing_is_the_unit_of_rests() -> None:
    genes = ThrowParametrization(CAST_SETUP, 1)
    x = genes.point([np.pi / 2, np.pi], [0.5 * swing_period(CABLE), 0.0], 0.7 * swing_period(CABLE))
    throw = genes.throw(x)
    assert throw.strokes[:2] == pytest.approx([np.pi / 2, np.pi])
    assert throw.rests[:3] == pytest.approx([0.5 * swing_period(CABLE), 0.0, 0.7 * swing_period(CABLE)])
    assert np.array_equal(x[2 : genes.strokes], genes.centre()[2 : genes.strokes])


def test_swings_are_not_continued_after_the_rope_was_folded_flat(monkeypatch: pytest.MonkeyPatch) -> None:
    """What it does then depends on its contact with itself."""
    search = BeamSearch(CAST_SETUP, LEVEL, [1], np.random.default_rng(0), 1)
    search.extend(8.0, 1)
    assert search.ready(8.0, 2)
    monkeypatch.setattr(strikes, "samples_unfolded", lambda rope, q: np.zeros(len(q), dtype=np.int64))
    search.extend(8.0, 2)
    assert not search.ready(8.0, 3)


def test_a_rope_with_limits_of_its_own_is_searched() -> None:
    """A bend at one of its joints would be past the limits of links a third as long, on which swings are confirmed."""
    rope = hf.Rope.uniform(1.5, 0.06, 24, 0.003, friction=2e-3).with_bend_radius(0.06)
    search = BeamSearch(Problem(rope, hf.Arm(length=0.5), MotorLimits(), 8.0), LEVEL, [1], np.random.default_rng(1), 2)
    assert search.extend(8.0, 9) or search.runs > 50
