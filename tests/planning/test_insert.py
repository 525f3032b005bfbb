"""Insertions: crossings and passages in closed form, exact derivatives, a plan from end to end, what is a touch."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import InvalidInput
from hyperflex.model import recut
from hyperflex.planning import InsertPlan, MotorLimits, Problem, Slot, estimate_insert_probability, plan_insert
from hyperflex.planning.clearance import FINE, obstacle_clearance, obstacle_gaps
from hyperflex.planning.insert import chance, task
from hyperflex.planning.insert import planner as insert_planner
from hyperflex.planning.insert.chance import TOGETHER, insert_scenarios, usual_uncertainty
from hyperflex.planning.insert.entry import LEVELS
from hyperflex.planning.insert.outcome import InsertOutcome, evaluate_insert, verify_insert
from hyperflex.planning.insert.slot import find_crossings, frame, nearest_passage, passages
from hyperflex.planning.insert.task import InsertTask
from hyperflex.planning.plan import to_table
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.tip.outcome import sample_times
from hyperflex.simulation import Deadline
from tests.planning.known_insert import ARM, NEAR, ROPE, SLOT, STROKES

DOWN = Slot(0.1, -0.5, -0.5 * np.pi, width=0.02, depth=0.05, wall=0.1)  # its left is +x


@functools.cache
def planned() -> InsertPlan:
    plan = plan_insert(ROPE, ARM, SLOT, threads=1, time_budget=100.0, samples=30)
    assert plan.success, plan.message
    return plan


def near() -> float:
    outcome = planned().outcome
    assert outcome is not None
    return outcome.t


def aside(slot: Slot, way: float) -> Slot:
    """The slot moved to the left of the way in, m."""
    x, y = slot.point + way * slot.axes[1]
    return replace(slot, x=float(x), y=float(y))


def test_walls_leave_the_gap_free() -> None:
    left, right = DOWN.walls
    assert [(w.x, w.y, w.x2, w.y2) for w in (left, right)] == [
        pytest.approx((0.11, -0.5, 0.21, -0.5)),
        pytest.approx((0.09, -0.5, -0.01, -0.5)),
    ]


def test_a_tube_goes_on_from_the_gaps_edges() -> None:
    walls = replace(DOWN, tube=0.07).walls
    assert walls[:2] == DOWN.walls
    assert [(w.x, w.y, w.x2, w.y2) for w in walls[2:]] == [
        pytest.approx((0.11, -0.5, 0.11, -0.57)),
        pytest.approx((0.09, -0.5, 0.09, -0.57)),
    ]


@pytest.mark.parametrize(
    ("x", "slant", "offset", "gap"),
    [
        (0.104, 0.0, 0.004, 0.006),  # in the gap, 6 mm from its left edge
        (0.098, 0.0, -0.002, 0.008),
        (0.113, 0.0, 0.013, -0.003),  # in the left wall, 3 mm from the gap
        (0.2, 0.0, 0.1, -0.01),  # in the wall, 10 mm from its outer end
        (0.218, 0.0, 0.118, 0.008),  # past its outer end
        (0.1, 1.0, 0.0, 0.01 / np.sqrt(2.0)),  # askew it is nearer to the edges
    ],
)
def test_where_a_straight_rope_crosses(x: float, slant: float, offset: float, gap: float) -> None:
    along = np.array([-0.3, -0.1, 0.1])
    joints = np.stack([x + slant * along, -0.5 - along], axis=-1)
    found = find_crossings(DOWN, 0.002, *frame(DOWN, joints[None]))
    assert (found.row.tolist(), found.link.tolist(), found.tip.tolist()) == ([0], [1], [True])
    assert found.offset[0] == pytest.approx(offset)
    assert found.gap[0] == pytest.approx(gap - 0.002)


def test_a_rope_that_hangs_back_out_is_not_what_follows_the_tip() -> None:
    joints = np.array([[[0.1, -0.4], [0.1, -0.6], [0.13, -0.45]]])
    found = find_crossings(DOWN, 0.002, *frame(DOWN, joints))
    assert found.link.tolist() == [0, 1]
    assert not found.tip.any()


def test_ways_of_a_tip_beyond_the_walls() -> None:
    depth = np.array([0.1, -0.1, 0.2, 0.4, 0.3, -0.1, 0.5, 0.9])
    assert passages(depth, 0.4) == [(2, 3), (6, 6)]
    assert passages(depth, 0.6) == [(2, 3), (6, 7)]  # the first never comes so deep: where it is deepest
    assert passages(np.array([0.1, 0.2, -0.1]), 0.1) == []  # it begins there


@pytest.mark.parametrize(
    ("depth", "tube", "names"), [(0.04, 0.0, ("offset", "t")), (0.04, 0.05, ("offset",)), (0.06, 0.05, ("depth",))]
)
def test_derivatives_of_an_entry(depth: float, tube: float, names: tuple[str, ...]) -> None:
    """Against central differences: of an entry to the depth asked, and of how deep one comes that does not reach it."""
    task = InsertTask(Problem(ROPE, ARM, MotorLimits(), 3.0), replace(SLOT, depth=depth, tube=tube), [])
    strokes = replace(STROKES, rests=STROKES.rests + 0.02)
    entry = task.find(strokes, NEAR)
    assert entry is not None
    for k in range(strokes.parameters.size):
        change = np.zeros(strokes.parameters.size)
        change[k] = 1e-4
        plus, minus = (task.find(strokes.varied(sign * change), entry.t) for sign in (1.0, -1.0))
        assert plus is not None
        assert minus is not None
        for name in names:
            by = (getattr(plus, name) - getattr(minus, name)) / 2e-4
            told = entry.dt[k] if name == "t" else getattr(entry, f"d{name}")[..., k]
            whole = entry.dt if name == "t" else getattr(entry, f"d{name}")
            # runs are within 1e-6 m of the true ones, each with steps of its own
            np.testing.assert_allclose(told, by, rtol=0.0, atol=0.03 * np.abs(whole).max())


def test_a_plan_goes_through_by_its_own_samples() -> None:
    plan = planned()
    assert plan.runs > 0
    for seen in (plan.outcome, plan.finer_outcome):
        assert seen is not None
        assert seen.run is not None
        run, until = seen.run, seen.run.t <= seen.t
        assert run.setup.pegs == SLOT.walls
        assert not np.abs(run.contact_force[until]).any()
        assert frame(SLOT, run.tip)[0].max() >= SLOT.depth
        assert seen.depth >= SLOT.depth
        assert seen.t_enter < seen.t
        ends = np.array([[(w.x, w.y), (w.x2, w.y2)] for w in SLOT.walls])
        part = np.linspace(0.0, 1.0, 400)[:, None]
        wall = np.concatenate([a + part * (b - a) for a, b in ends])
        links = (
            run.joints[until, :-1, None]
            + np.linspace(0.0, 1.0, 9)[:, None] * np.diff(run.joints[until], axis=1)[:, :, None]
        )
        sampled = min(np.hypot(*np.moveaxis(row.reshape(-1, 1, 2) - wall, -1, 0)).min() for row in links[::4])
        # points lie at most 8 mm apart along links and 0.25 mm along walls
        assert sampled - ROPE.radius > seen.wall_clearance - 1e-9
    assert plan.finer_outcome.n_links == 40
    assert plan.success_probability is not None


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_slot_that_is_not_there_is_touched(side: float) -> None:
    plan = planned()
    motion = plan.required(plan.motion, "motion")
    off = verify_insert(plan.problem, aside(SLOT, side * 0.4 * SLOT.width), motion, near())
    assert off is not None
    assert "touches a wall at" in off.message
    assert off.wall_clearance <= 0.0
    deeper = verify_insert(plan.problem, replace(SLOT, depth=0.5), motion, near())
    assert deeper is not None
    assert "mm deep, and 500 mm are asked" in deeper.message or "touches" in deeper.message


def test_in_a_tube_the_tip_keeps_to_the_middle_too() -> None:
    who = Problem(ROPE, ARM, MotorLimits(), 3.0)
    entries = [InsertTask(who, replace(SLOT, tube=tube), []).find(STROKES, NEAR) for tube in (0.0, 0.05)]
    assert [entry.offset.size for entry in entries] == [3, 5]
    assert (entries[1].offset[:3] == entries[0].offset).all()
    run = verify_insert(who, SLOT, STROKES.motion(who.limits), NEAR).run
    depth, offset = frame(SLOT, run.tip)
    at = int(np.argmax(depth >= SLOT.depth))
    assert entries[1].offset[4] == pytest.approx(offset[at], abs=5e-4)


def test_a_plan_into_a_tube_keeps_clear_of_its_sides() -> None:
    tube = replace(SLOT, tube=0.05)
    plan = plan_insert(ROPE, ARM, tube, threads=1, time_budget=100.0, samples=4)
    assert plan.success, plan.message
    run, until = plan.outcome.run, plan.outcome.run.t <= plan.outcome.t
    assert run.setup.pegs == tube.walls
    depth, offset = frame(tube, run.joints[until])
    inside = (depth > 0.0) & (depth < tube.tube) & (np.abs(offset) < 0.1)
    assert inside.any()
    assert np.abs(offset[inside]).max() + ROPE.radius < 0.5 * tube.width


def test_touches_are_allowed_where_the_slot_says_so() -> None:
    plan, motion = planned(), planned().required(planned().motion, "motion")
    narrow = aside(SLOT, 0.3 * SLOT.width)
    off, on = (verify_insert(plan.problem, replace(narrow, touching=may), motion, near()) for may in (False, True))
    assert "touches a wall at" in off.message
    assert on.wall_clearance <= 0.0
    assert on.message == "" or "mm deep" in on.message


def test_a_slot_is_not_called_out_of_reach_where_the_time_ended_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(insert_planner, "insert_candidates", lambda *_: [])
    assert "out of reach" in plan_insert(ROPE, ARM, SLOT, time_budget=1000.0).message
    message = plan_insert(ROPE, ARM, SLOT, time_budget=1e-6).message
    assert message == "the time budget ended before swings were made of which one goes through near to it"


def test_a_touch_of_an_obstacle_is_no_touch_of_a_wall() -> None:
    plan, seen = planned(), planned().outcome
    run, row = seen.run, int(np.searchsorted(seen.run.t, seen.t_enter - 0.3))
    force = np.zeros_like(run.contact_force)
    force[row, 8] = 0.0, 0.1
    pushed, depth = replace(run, contact_force=force), frame(SLOT, run.tip)[0]
    rows = nearest_passage(depth, SLOT.depth, run.t, seen.t)
    post = hf.Peg(*(run.joints[row, 8] - [0.0, 0.02]), 0.01)
    beside, alone = (
        evaluate_insert(replace(plan.problem, obstacles=there), SLOT, pushed, depth, *rows) for there in ([post], ())
    )
    assert beside.wall_clearance == seen.wall_clearance > 0.0
    assert alone.wall_clearance == 0.0


def test_a_tip_that_is_too_fast_inside_fails() -> None:
    plan, motion = planned(), planned().required(planned().motion, "motion")
    speed = plan.outcome.speed
    for most, message in ((1.01 * speed, ""), (0.9 * speed, f"the tip is there with {speed:.2f} m/s")):
        seen = verify_insert(plan.problem, replace(SLOT, max_speed=most), motion, near())
        assert seen.message.startswith(message)
        assert bool(seen.message) is bool(message)


def test_a_floor_that_the_rope_would_touch_is_kept_clear_of() -> None:
    lowest = float(planned().outcome.run.joints[..., 1].min())
    who = replace(planned().problem, obstacles=(hf.Ground(0.0, lowest + 0.01),))
    motion = planned().required(planned().motion, "motion")
    seen = verify_insert(who, SLOT, motion, near())
    assert seen is None or "touches the ground" in seen.message
    free, blocked = (
        InsertTask(each, SLOT, []).score([planned().strokes], 1, np.inf)[0][0] for each in (planned().problem, who)
    )
    assert free < 0.1 < blocked


def test_free_swings_tell_what_runs_beside_the_walls_do() -> None:
    """In each of some scenarios, half of which fail: the slot is 6 mm off."""
    plan = planned()
    strokes = plan.required(plan.strokes, "strokes")
    wide = replace(usual_uncertainty(), place=6e-3)
    count = 12
    told = [
        estimate_insert_probability(plan.problem, SLOT, strokes, near(), wide, samples=k, threads=1).successes
        for k in range(1, count + 1)
    ]
    seen = []
    for rope, slot, motion in insert_scenarios(plan.problem, SLOT, strokes, wide, count, [7001, 0]):
        found = verify_insert(replace(plan.problem, rope=rope), slot, motion, near())
        seen.append(found is not None and not found.message)
    assert np.diff([0, *told]).tolist() == [int(each) for each in seen]
    assert 0 < sum(seen) < count


def test_a_slot_where_it_is_planned_is_sure() -> None:
    plan, none = planned(), replace(usual_uncertainty(), place=0.0, timing=0.0)
    strokes = plan.required(plan.strokes, "strokes")
    for slot, won in ((SLOT, 3), (aside(SLOT, 0.03), 0)):
        found = estimate_insert_probability(plan.problem, slot, strokes, near(), none, samples=3, threads=1)
        assert found.successes == won


def certain(problem: Problem, slot: Slot = SLOT) -> int:
    """Successes in three scenarios that are all as planned."""
    none = replace(usual_uncertainty(), place=0.0, timing=0.0)
    return estimate_insert_probability(problem, slot, STROKES, NEAR, none, samples=3, threads=1).successes


def test_a_scenario_in_which_the_tip_is_too_fast_fails() -> None:
    """By what a run with as many links tells."""
    who = Problem(ROPE, ARM, MotorLimits(), 4.0)
    seen = verify_insert(InsertTask(who, SLOT, []).finer, SLOT, STROKES.motion(who.limits), NEAR)
    assert seen is not None
    for part, successes in ((1.02, 3), (0.98, 0)):
        assert certain(who, replace(SLOT, max_speed=part * seen.speed)) == successes


def test_a_scenario_in_which_the_tip_is_not_deep_enough_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    who, none = Problem(ROPE, ARM, MotorLimits(), 4.0), replace(usual_uncertainty(), place=0.0, timing=0.0)
    monkeypatch.setattr(chance, "_touches", lambda *_: False)
    t, drawn = sample_times(NEAR), insert_scenarios(who, SLOT, STROKES, none, 1, 0)
    (q,) = chance._flights(who, drawn, t, Deadline(np.inf, lambda: 1.0), 1)
    rope, _, motion = drawn[0]
    deepest = frame(SLOT, rope.joints(q, ARM.tip(motion.angle(t))))[0][t > NEAR - 0.1, -1].max()
    for more, successes in ((-1e-3, 3), (1e-3, 0)):
        assert certain(who, replace(SLOT, depth=deepest + more)) == successes


def test_a_scenario_fails_in_which_the_rope_comes_too_near_arm_shaft_or_obstacle() -> None:
    """By what a run with as many links tells: with 1 mm more than is there, not with 1 mm less."""
    who = Problem(ROPE, ARM, MotorLimits(), 4.0)
    seen = verify_insert(InsertTask(who, SLOT, []).finer, SLOT, STROKES.motion(who.limits), NEAR)
    assert seen is not None
    assert seen.run is not None
    lowest = float(seen.run.joints[..., 1].min()) - ROPE.radius
    shaft = 0.01 + obstacle_clearance(seen.run, [hf.Peg(0.0, 0.0, 0.01)]).value
    for more, successes in ((-1e-3, 3), (1e-3, 0)):
        assert certain(replace(who, clearance=seen.clearance + more)) == successes
        assert certain(replace(who, arm=hf.Arm(length=0.1, shaft_radius=shaft + more))) == successes
        assert certain(replace(who, obstacles=(hf.Ground(0.0, lowest + more),))) == successes


def test_a_scenario_in_which_the_rope_is_folded_flat_before_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    who = Problem(ROPE, ARM, MotorLimits(), 4.0)
    drawn = insert_scenarios(who, SLOT, STROKES, replace(usual_uncertainty(), place=0.0, timing=0.0), 1, 0)
    (q,) = chance._flights(who, drawn, np.arange(0.0, NEAR, 2e-3), Deadline(np.inf, lambda: 1.0), 1)
    bend = np.abs(np.diff(q, axis=1)).max()
    for part, successes in ((1.02, 3), (0.98, 0)):
        monkeypatch.setattr(chance, "limit_bend", lambda rope, most=part * bend: rope.replace(max_bend=most))
        assert certain(who) == successes


@pytest.mark.parametrize("tube", [0.0, 0.05])
def test_touches_of_the_walls_are_those_of_all_links(tube: float) -> None:
    random, slot, found = np.random.default_rng(0), replace(SLOT, tube=tube), []
    for _ in range(300):
        joints = slot.point + np.cumsum(random.normal(0.0, 0.03, (5, 12, 2)), axis=1) + random.uniform(-0.2, 0.2, 2)
        gaps = obstacle_gaps(slot.walls, joints[:, :-1], joints[:, 1:])
        found.append(bool(gaps.min() <= 0.003 + 0.5 * FINE))
        assert chance._touches(slot, 0.003, joints, *frame(slot, joints)) == found[-1]
    assert 30 < sum(found) < 270


@pytest.mark.parametrize(("row", "front", "enters"), [(100, 2.6e-3, False), (100, 3.5e-3, True), (-1, 2.6e-3, True)])
def test_a_tip_that_touches_a_wall_long_before_it_enters_fails(row: int, front: float, enters: bool) -> None:
    """Made up: at one sample the rope is moved until its tip lies in front of a wall; after the entry it may."""
    who, none = Problem(ROPE, ARM, MotorLimits(), 4.0), replace(usual_uncertainty(), place=0.0, timing=0.0)
    t = sample_times(NEAR)
    drawn = insert_scenarios(who, SLOT, STROKES, none, 1, 0)
    (q,) = chance._flights(who, drawn, t, Deadline(np.inf, lambda: 1.0), 1)
    rope, _, motion = drawn[0]
    base = ARM.tip(motion.angle(t))
    way, left = SLOT.axes
    wall = SLOT.point + 0.5 * (SLOT.width + SLOT.wall) * left
    base[row] += wall - front * way - rope.joints(q, base)[row, -1]
    assert frame(SLOT, rope.joints(q, base))[0][row].max() == pytest.approx(-front)
    assert chance._enters(who, rope, SLOT, NEAR, t, q, base) == enters


def test_an_estimate_counts_the_samples_that_there_was_time_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Made up: flights of 4 s for each lot of them; those that end late are not looked at."""
    now, left = [0.0], list[float]()

    class Now:
        @property
        def spent(self) -> float:
            return now[0]

    def flights(_: object, drawn: list, t: np.ndarray, time_budget: Deadline, threads: object) -> np.ndarray:
        left.append(time_budget.left())
        now[0] += 4.0
        return np.full((len(drawn), t.size, 40), np.nan)

    monkeypatch.setattr(chance, "Clock", Now)
    looked: list[int] = []
    monkeypatch.setattr(chance, "_flights", flights)
    monkeypatch.setattr(chance, "_enters", lambda *_: looked.append(1) is None)
    given = (Problem(ROPE, ARM, MotorLimits(), 4.0), SLOT, STROKES, NEAR)
    assert estimate_insert_probability(*given, samples=60).samples == 60
    for time_budget, lots, lefts in ((10.0, 2, [10.0, 6.0, 2.0]), (3.0, 0, [3.0]), (0.0, 0, [])):
        now[0] = 0.0
        left.clear()
        looked.clear()
        found = estimate_insert_probability(*given, time_budget=time_budget)
        assert found.successes == found.samples == len(looked) == lots * TOGETHER
        assert left == lefts


def test_flights_of_an_estimate_end_with_the_time() -> None:
    who, none = Problem(ROPE, ARM, MotorLimits(), 4.0), replace(usual_uncertainty(), place=0.0, timing=0.0)
    drawn, t = insert_scenarios(who, SLOT, STROKES, none, 2, 0), np.array([0.5, 1.0])
    for left, flown in ((1.0, True), (-1.0, False)):
        q = chance._flights(who, drawn, t, Deadline(np.inf, lambda left=left: left), 1)
        assert q.shape == (2, 2, 40)
        assert np.isfinite(q).all() == flown


def test_an_estimate_does_not_outlast_its_time() -> None:
    given = (Problem(ROPE, ARM, MotorLimits(), 4.0), SLOT, STROKES, NEAR)
    estimate_insert_probability(*given, samples=1)  # so that kernels are loaded
    clock = Clock()
    found = estimate_insert_probability(*given, time_budget=0.02)
    assert clock.spent < 1.0
    assert (found.samples, str(found)) == (0, "not estimated, no time was left")


@pytest.mark.parametrize(
    ("given", "now", "told"),
    [
        (0.6e-3, 0.2e-3, "it passes 0.2 mm, not 0.6 mm, from the walls"),
        (0.1e-3, 3.2e-3, "it passes 3.2 mm, not 0.1 mm, from the walls"),
        (0.4e-3, 0.5e-3, ""),  # both see the same
        (0.8e-3, 2.4e-3, ""),  # room enough
    ],
)
def test_an_insertion_past_the_walls_by_less_than_its_runs_differ_is_left_to_chance(
    monkeypatch: pytest.MonkeyPatch, given: float, now: float, told: str
) -> None:
    plan, aim = planned(), SimpleNamespace(strokes=STROKES, t=NEAR)
    outcomes = [replace(plan.outcome, wall_clearance=gap) for gap in (given, now)]
    seen: list[InsertOutcome] = []
    monkeypatch.setattr(task, "verify_insert", lambda *_, **__: seen.pop(0))
    for touching, words in ((False, told), (True, "")):
        seen += outcomes
        found = InsertTask(plan.problem, replace(SLOT, touching=touching), []).verify(aim, None)
        assert found.finer_outcome.message == (f"{words}: whether it touches is left to chance" if words else "")
        assert found.message == ("with 2.5 times the links " if words else "") + found.finer_outcome.message
    seen += outcomes[0], replace(outcomes[1], message="it is not deep enough")
    found = InsertTask(plan.problem, SLOT, []).verify(aim, None)
    assert found.message == "with 2.5 times the links it is not deep enough"


def test_clearance_of_a_hanging_rope_from_a_wall() -> None:
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, radius=0.003)
    run = hf.simulate(rope, duration=0.1, pegs=[hf.Wall(0.04, -0.5, 0.3, -0.4)], t_eval=[0.0, 0.1])
    found = obstacle_clearance(run, [hf.Wall(0.04, -0.5, 0.3, -0.4)], 0.1)
    assert found.value == pytest.approx(0.04 - 0.003, abs=4e-4)  # told is up to that too small
    assert found.value <= 0.037


def test_a_plan_reads_back_as_it_was_written(tmp_path) -> None:
    plan = planned()
    plan.to_toml(tmp_path / "insert.toml")
    back = hf.read_plan(tmp_path / "insert.toml")
    assert isinstance(back, InsertPlan)
    assert (back.target, back.success_probability, back.success) == (SLOT, plan.success_probability, True)
    assert files.dumps_toml(to_table(back)) == files.dumps_toml(to_table(plan))
    run = hf.simulate(hf.Setup.from_toml(tmp_path / "insert.toml"))
    assert run.setup.pegs == SLOT.walls
    assert frame(SLOT, run.tip)[0].max() >= SLOT.depth


def test_out_of_reach_is_said_before_any_search() -> None:
    far = plan_insert(ROPE, ARM, Slot(1.2, 0.0, 0.0), threads=1)
    assert (far.success, far.status) == (False, 1)
    assert "the rope ends 0.15 m short of that depth" in far.message
    up = plan_insert(ROPE, ARM, Slot(0.0, 0.3, 0.5 * np.pi), threads=1, time_limit=0.5)
    assert (up.success, up.status) == (False, 1)
    assert "in no swing does the tip go through" in up.message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"width": 0.014}, r"too narrow for the rope.*0.015 m, 3 diameters"),
        ({"width": 0.0}, "slot width has the wrong sign"),
        ({"depth": np.inf}, "slot depth is not finite"),
        ({"direction": "down"}, "slot direction is not a number"),
        ({"tube": -0.1}, "slot tube has the wrong sign"),
        ({"max_speed": 0.0}, "slot max_speed has the wrong sign"),
        ({"touching": "yes"}, "slot touching is neither true nor false"),
    ],
)
def test_slots_that_are_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        plan_insert(ROPE, ARM, Slot(**{"x": 0.2, "y": -0.8, "direction": 0.0} | change))


def test_finer_links_are_of_the_same_rope() -> None:
    task = InsertTask(planned().problem, SLOT, [])
    assert task.finer.rope == recut(ROPE, 40)
    assert len(LEVELS) == 3
