"""Where a target would do, and what would do for it where it is: by the criterion, and with plans."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.planning import MotorLimits, Thrower, reach
from hyperflex.planning.cast_plan import CastPlan
from hyperflex.planning.search.candidates import Landing
from hyperflex.planning.search.parametrization import Genes
from hyperflex.planning.search.search import Search
from hyperflex.planning.wind import fallback_targets as elsewhere
from hyperflex.planning.wind import nearest_target as nearest
from hyperflex.planning.wind.remedies import remedies
from tests.planning.known import CABLE, PEG, WINDS, late, planned, stopped, thrower, unreachable

THROWER = thrower()
FAR = hf.Peg(1.72 * np.sin(0.9), -1.72 * np.cos(0.9), 0.04)  # some 10 cm beyond what is in reach in its direction
SLOW, LAZY, WEAK = (replace(THROWER, limits=MotorLimits(*pair)) for pair in ((0.8, 8.0), (8.6, 0.5), (0.8, 1.0)))


def distance(one: hf.Peg, other: hf.Peg) -> float:
    return float(np.hypot(one.x - other.x, one.y - other.y))


@pytest.mark.parametrize("peg", [FAR, hf.Peg(-FAR.x, FAR.y, 0.04), hf.Peg(0.14, -0.9, 0.03), hf.Peg(0.02, 0.05, 0.02)])
def test_the_nearest_place_is_in_reach_and_none_is_nearer(peg: hf.Peg) -> None:
    found = nearest.nearest(THROWER, peg)
    assert found is not None
    assert reach(THROWER, found.peg).within
    assert not reach(THROWER, peg).within
    assert found.plan is None
    assert found.away == pytest.approx(distance(found.peg, peg))
    assert (found.peg.radius, found.peg.mu) == (peg.radius, peg.mu)
    random = np.random.default_rng(1)
    far, angle = 0.97 * found.away * np.sqrt(random.uniform(size=400)), random.uniform(-np.pi, np.pi, 400)
    assert not any(
        reach(THROWER, replace(peg, x=peg.x + r * np.sin(a), y=peg.y + r * np.cos(a))).within
        for r, a in zip(far, angle, strict=True)
    )


def test_a_target_ten_centimetres_too_far_has_one_near_by() -> None:
    found = nearest.nearest(THROWER, FAR)
    assert found is not None
    assert 0.05 < found.away < 0.15
    assert found.peg.x == pytest.approx(round(found.peg.x, 3), abs=1e-12)  # a place that can be said


def test_what_the_nearest_place_shall_have_to_spare_and_hold_counts() -> None:
    plain, safe = (nearest.nearest(THROWER, FAR, more=more) for more in (0.0, 0.5))
    firm = nearest.nearest(THROWER, FAR, hold=2.0)
    assert plain is not None and safe is not None and firm is not None  # noqa: PT018
    spares = [nearest.spare(reach(THROWER, one.peg)) for one in (plain, safe)]
    assert 0.0 <= spares[0] < 0.1
    assert 0.5 <= spares[1] < 0.6
    assert plain.away < safe.away
    assert reach(THROWER, firm.peg).hold >= 2.0 > reach(THROWER, plain.peg).hold


def test_a_motor_too_slow_for_everything_reaches_nothing() -> None:
    asleep = replace(THROWER, limits=MotorLimits(speed=0.01, acceleration=0.1))
    assert nearest.nearest(asleep, PEG) is None


def test_down_is_where_gravity_points() -> None:
    turned = replace(THROWER, rope=CABLE.replace(gravity=(9.81, 0.0)))
    there, here = nearest.nearest(turned, hf.Peg(-FAR.y, FAR.x, 0.04)), nearest.nearest(THROWER, FAR)
    assert there is not None
    assert here is not None
    assert (there.peg.x, there.peg.y) == pytest.approx((-here.peg.y, here.peg.x), abs=1.5e-3)  # in whole millimetres


def with_speed(speed: float) -> tuple[Thrower, hf.Peg]:
    return replace(SLOW, limits=MotorLimits(speed, SLOW.limits.acceleration)), PEG


def with_acceleration(acceleration: float) -> tuple[Thrower, hf.Peg]:
    return replace(LAZY, limits=MotorLimits(LAZY.limits.speed, acceleration)), PEG


def with_motor(speed: float, acceleration: float) -> tuple[Thrower, hf.Peg]:
    return replace(SLOW, limits=MotorLimits(speed, acceleration)), PEG


def with_rope(length: float) -> tuple[Thrower, hf.Peg]:
    """A rope of the same kind; the time stays as it was."""
    longer = hf.Rope.uniform(length, 0.0625 * length, 50, 0.0025, friction=5e-4)
    return replace(THROWER, rope=longer, time=THROWER.time), FAR


def with_arm(length: float) -> tuple[Thrower, hf.Peg]:
    return replace(THROWER, arm=hf.Arm(length=1e-3 * length)), hf.Peg(0.068, -1.179, 0.025)


def with_time(time: float) -> tuple[Thrower, hf.Peg]:
    return replace(THROWER, time=time), PEG


def with_peg(radius: float) -> tuple[Thrower, hf.Peg]:
    return THROWER, replace(FAR, radius=1e-3 * radius)


@pytest.mark.parametrize(
    ("who", "target", "words", "changed"),
    [
        (SLOW, PEG, r"a motor of (\S+) rad/s", with_speed),
        (LAZY, PEG, r"a motor of (\S+) rad/s\^2", with_acceleration),
        (WEAK, PEG, r"a motor of (\S+) rad/s and (\S+) rad/s\^2", with_motor),
        (THROWER, FAR, r"a rope of (\S+) m", with_rope),
        (THROWER, hf.Peg(0.068, -1.179, 0.025), r"an arm of (\S+) mm", with_arm),
        (replace(THROWER, time=1.5), PEG, r"(\S+) s to strike", with_time),
        (THROWER, FAR, r"a peg of (\S+) mm radius", with_peg),
    ],
)
def test_a_remedy_helps_and_less_of_it_does_not(
    who: Thrower, target: hf.Peg, words: str, changed: Callable[..., tuple[Thrower, hf.Peg]]
) -> None:
    assert not reach(who, target).within
    told = next(found for text in remedies(who, target) if (found := re.fullmatch(words, text)))
    numbers = np.array([float(text) for text in told.groups()])
    sense = -1.0 if "radius" in words else 1.0
    assert reach(*changed(*numbers)).within  # rounded to what is enough
    assert not reach(*changed(*(numbers * (1.0 - sense * 0.02)))).within  # a factor is found to 1 %


def test_a_faster_motor_makes_each_move_in_the_same_part_of_the_time() -> None:
    told = next(found for text in remedies(WEAK, PEG) if (found := re.search(r"(\S+) rad/s and (\S+) rad", text)))
    speed, acceleration = (float(text) for text in told.groups())
    before, after = (MotorLimits(*pair).fastest([0.1, 3.0])[0] for pair in ((0.8, 1.0), (speed, acceleration)))
    assert after / before == pytest.approx(0.8 / speed, rel=0.02)  # three digits are told


def test_places_about_a_peg_are_tried_from_the_sides_that_are_clear_there() -> None:
    """A long arm, whose rope hangs where the target is moved to."""
    who = replace(THROWER, arm=hf.Arm(length=0.5))
    search = Search(who, hf.Peg(0.56, -1.1, 0.03))
    search.landings.append(Landing(1.0, 1.0, 1, search.genes[1].centre(), WINDS))
    sides = [list(beside.genes) for beside in nearest.around(search)]
    assert [-1] in sides


def test_a_target_in_reach_needs_no_remedy() -> None:
    assert remedies(THROWER, PEG) == ()


def test_a_plan_that_fails_says_where_one_should_do() -> None:
    plan = unreachable()
    assert plan.nearest is not None
    assert plan.nearest.plan is None
    assert reach(plan.thrower, plan.nearest.peg).within
    assert [text[:9] for text in plan.remedies] == ["a rope of"]


@pytest.mark.parametrize("made", [late, stopped, lambda: stopped(None)], ids=["clock", "ctrl-c", "no throw"])
def test_no_place_is_named_where_the_target_is_not_what_failed(made: Callable[[], CastPlan]) -> None:
    plan = made()
    assert plan.unfinished
    assert elsewhere.expected(plan, 0.0) is None


@pytest.mark.parametrize(
    "made",
    [
        lambda: planned(winds=False),  # a throw that was run says so
        lambda: replace(stopped(None), peg=FAR, reach=reach(THROWER, FAR)),  # the criterion says so
    ],
    ids=["throw", "criterion"],
)
def test_a_place_is_named_where_the_target_is_what_failed(made: Callable[[], CastPlan]) -> None:
    plan = made()
    assert not plan.unfinished
    assert elsewhere.expected(plan, 0.0) is not None


def test_a_plan_that_stands_is_finished() -> None:
    assert not planned().unfinished


def test_a_finer_run_that_took_too_long_is_not_the_targets_fault() -> None:
    assert replace(planned(), finer=late().cast, reason="with shorter links").unfinished


class Planner:
    """Plans for other places, of which the number `good` stands; remembers them."""

    def __init__(self, good: int, interrupted: bool = False) -> None:
        self.good, self.interrupted, self.asked = good, interrupted, []  # type: ignore[var-annotated]

    def __call__(self, peg: hf.Peg) -> CastPlan:
        self.asked.append(peg)
        if len(self.asked) == self.good:
            return replace(planned(), peg=peg)
        return replace(planned(), peg=peg, reason="it slips", interrupted=self.interrupted)


def failed(peg: hf.Peg) -> CastPlan:
    return replace(planned(), peg=peg, reach=reach(THROWER, peg), reason="it slips")


@pytest.mark.parametrize("peg", [FAR, PEG])
def test_places_are_planned_for_until_one_stands(peg: hf.Peg) -> None:
    again = Planner(good=2)
    plan = elsewhere.found(failed(peg), Search(THROWER, peg), 0.0, 1.0, again)
    assert plan.nearest is not None
    assert plan.nearest.plan is not None
    assert plan.nearest.plan.peg == plan.nearest.peg == again.asked[1]
    assert plan.nearest.tried == 1
    assert plan.reason == "it slips"
    away = [distance(one, peg) for one in again.asked]
    assert 0.0 < away[0] < away[1] == pytest.approx(plan.nearest.away)


def test_where_no_place_stands_the_next_one_is_expected() -> None:
    again = Planner(good=0)
    plan = elsewhere.found(failed(FAR), Search(THROWER, FAR), 0.0, 1.0, again)
    assert plan.nearest is not None
    assert (plan.nearest.plan, plan.nearest.tried) == (None, 3)
    assert plan.nearest.peg not in again.asked
    assert plan.nearest.away > max(distance(one, FAR) for one in again.asked)


def test_no_place_is_planned_for_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elsewhere, "SPARE", (0.0, 0.0, 0.0, 0.0))
    again = Planner(good=0)
    plan = elsewhere.found(failed(FAR), Search(THROWER, FAR), 0.0, 1.0, again)
    assert len(again.asked) == 1
    assert plan.nearest is None


def test_a_throw_at_hand_counts_where_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Made up: nothing strikes or winds at the first places, one slips at the next, one stands at the last."""
    places = [replace(PEG, x=PEG.x + 0.01 * k) for k in (1, 2, 3, 4)]
    beside = [SimpleNamespace(thrower=THROWER, peg=peg, landings=[]) for peg in places]
    for one, turns in zip(beside[1:], (1.2, 1.3, 1.3), strict=True):
        one.landings.append(SimpleNamespace(turns=turns))
    monkeypatch.setattr(elsewhere, "around", lambda search: iter(beside))
    monkeypatch.setattr(elsewhere, "Course", lambda search, *_: SimpleNamespace(search=search, look=lambda: None))
    stands = replace(planned(), peg=places[3])
    monkeypatch.setattr(
        elsewhere, "come_to", lambda work, known: failed(places[2]) if work.search.peg == places[2] else stands
    )
    plan = elsewhere.found(failed(PEG), Search(THROWER, PEG), 0.0, 10.0, Planner(good=0))
    assert plan.nearest is not None
    assert plan.nearest.plan is stands
    assert plan.nearest.away == pytest.approx(0.04)
    assert plan.nearest.tried == 0


def test_an_interrupt_ends_the_search_for_a_place() -> None:
    again = Planner(good=0, interrupted=True)
    plan = elsewhere.found(failed(FAR), Search(THROWER, FAR), 0.0, 1.0, again)
    assert plan.interrupted
    assert len(again.asked) == 1
    assert plan.nearest is not None
    assert plan.nearest.plan is None


def test_a_throw_at_hand_is_tried_on_pegs_near_by_and_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    """The throw that is known to wind, for a target 2 mm beside its own."""
    monkeypatch.setattr(nearest, "RADII", (0.001,))
    genes = Genes(THROWER, WINDS.side)
    x = genes.centre()
    x[:6], x[genes.strokes : genes.strokes + 6] = WINDS.strokes / np.pi, WINDS.rests / genes.period
    x[-4:] = 0.5, WINDS.end / np.pi, WINDS.rest / genes.period, WINDS.speed
    search = Search(THROWER, replace(PEG, x=PEG.x - 0.002))
    search.landings.append(Landing(1.0, 1.0, WINDS.side, x, WINDS))
    again = Planner(good=1)
    plan = elsewhere.found(failed(search.peg), search, 0.0, 1e3, again)
    assert again.asked == []
    assert plan.nearest is not None
    assert plan.nearest.plan is not None
    assert plan.nearest.away == pytest.approx(0.002)
    cast = plan.nearest.plan.cast
    assert cast is not None
    assert cast.success
    assert cast.run is not None
    assert plan.nearest.peg in cast.run.setup.pegs


def test_throws_at_hand_are_tried_on_near_places_first(monkeypatch: pytest.MonkeyPatch) -> None:
    landed: list[int] = []
    monkeypatch.setattr(Search, "land", lambda self, side, points: landed.append(len(points)))
    search = Search(THROWER, PEG)
    search.landings += [Landing(1.0, 1.0, side, np.zeros(3), WINDS) for side in (1, -1, 1, 1, 1, 1, 1, 1)]
    places: Iterator[Search] = nearest.around(search)
    away = [distance(one.peg, PEG) for one in places]
    assert np.all(np.diff(away) > -1e-8)  # places are rounded to 1e-9 m
    assert away[0] == pytest.approx(0.02)
    assert landed[:2] == [1, 5]  # of the best six
    assert dataclasses.asdict(search.peg) == dataclasses.asdict(PEG)
