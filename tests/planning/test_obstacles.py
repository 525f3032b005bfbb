"""Casts past obstacles, which the rope must not touch, and behind pegs, which it must: search, runs and files."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.cli.app import run
from hyperflex.cli.plan import Source
from hyperflex.errors import InvalidInput
from hyperflex.planning import (
    Accuracy,
    Uncertainty,
    build_whip_map,
    check_feasibility,
    check_whip_feasibility,
    read_plan,
    verify_cast,
)
from hyperflex.planning.clearance import FINE, obstacle_clearance, sampled_obstacle_gaps, way_gaps
from hyperflex.planning.outcome import evaluate_cast
from hyperflex.planning.rollouts import RolloutBatch, simulate_contact
from hyperflex.planning.verification import verified_setup
from hyperflex.report import CastReport
from hyperflex.winding import TOUCH
from tests.planning.known import CABLE, PEG, WINDS, planned, problem, simulated_strikes
from tests.refusals import refuses

FLOOR, POST, WALL = hf.Ground(0.0, -2.5, 0.3, 1.0), hf.Peg(1.2, -1.2, 0.2), hf.Wall(-1.6, -1.8, -1.3, -0.4)


def distance(obstacle: hf.Peg | hf.Wall | hf.Ground, points: np.ndarray) -> np.ndarray:
    """Distances of points (..., 2) from an obstacle, by another way than the library's."""
    if isinstance(obstacle, hf.Peg):
        return np.linalg.norm(points - [obstacle.x, obstacle.y], axis=-1) - obstacle.radius
    if isinstance(obstacle, hf.Ground):
        out = np.array([obstacle.nx, obstacle.ny])
        return (points - [obstacle.x, obstacle.y]) @ (out / np.linalg.norm(out))
    begin, end = (complex(*place) for place in ((obstacle.x, obstacle.y), (obstacle.x2, obstacle.y2)))
    along = (points[..., 0] + 1j * points[..., 1] - begin) / (end - begin)  # the wall lies from 0 to 1
    return np.abs(end - begin) * np.abs(along - np.clip(along.real, 0.0, 1.0))


@pytest.mark.parametrize("obstacle", [FLOOR, POST, WALL], ids=["floor", "post", "wall"])
def test_distances_are_those_of_many_points_of_the_rope(obstacle):
    rope = CABLE.replace(radius=0.01)
    for q in np.random.default_rng(5).uniform(-1.2, 1.2, (8, rope.n_links)):
        joints = rope.joints(q[None], np.zeros((1, 2)))[0]
        share = np.linspace(0.0, 1.0, 41)[:, None, None]
        points = (joints[:-1] * (1.0 - share) + joints[1:] * share).reshape(-1, 2)
        there = sampled_obstacle_gaps(rope, [obstacle], q[None], np.zeros((1, 2)))[0]
        want = distance(obstacle, points).min() - rope.radius
        assert there == pytest.approx(want, abs=1e-3)  # the points are 1 mm apart
        for within in (0.5 * there, 2.0 * there):
            stated = sampled_obstacle_gaps(rope, [obstacle], q[None], np.zeros((1, 2)), within)[0]
            assert stated == there if there <= within else within <= stated <= there


def test_a_run_tells_which_obstacle_it_comes_near_and_when():
    run = planned().run
    k = int(np.argmin(distance(POST, run.tip)))
    near = replace(POST, radius=POST.radius + 0.9 * float(distance(POST, run.tip)[k]))
    found = obstacle_clearance(run, [FLOOR, near])
    assert found.what == "the peg at (1.2, -1.2) m"
    between = found.value - (float(sampled_obstacle_gaps(run.setup.rope, [near], run.q, run.base).min()) - 0.5 * FINE)
    assert -0.03 < between <= 1e-9  # samples are 10 ms apart: the rope comes nearer between two of them


def test_a_cast_that_touches_an_obstacle_fails_and_reports_which():
    run, motion = planned().run, WINDS.motion(problem().limits)
    aside = hf.Ground(float(run.tip[:, 0].max()) - 0.05, 0.0, -1.0, 0.0)
    seen = verify_cast(replace(problem(), obstacles=[aside]), PEG, motion)
    assert not seen.success
    assert seen.clearance <= 0.0
    assert "touches the ground" in seen.message
    blocked = verify_cast(replace(problem(), obstacles=[replace(aside, x=aside.x - 0.6)]), PEG, motion)
    assert not blocked.wound
    assert "; the rope touches the ground at" in blocked.message  # why it does not wind
    far = replace(aside, x=aside.x + 0.15)
    with_room = replace(problem(), obstacles=[far])
    seen = verify_cast(with_room, PEG, motion)
    assert seen.success
    room = obstacle_clearance(run, [far]).value
    assert seen.clearance == pytest.approx(min(room, planned().outcome.clearance), abs=1e-3)
    short = verify_cast(replace(with_room, clearance=room + 0.01), PEG, motion)
    assert f"comes within {1e3 * room:.0f}"[:-1] in short.message or "the arm" in short.message


def test_a_touch_between_two_samples_is_seen():
    who, motion = problem(), WINDS.motion(problem().limits)
    t = np.arange(0.0, 4.3, 0.01)
    for x, y in ((0.85778, -1.65443), (0.8414, -1.68562), (0.16175, -1.99088), (0.08262, -1.97463)):
        post = hf.Peg(x, y, 0.003, 0.1)
        setup = verified_setup(replace(who, obstacles=[post]), motion, 4.3)
        run = hf.simulate(setup, t_eval=t)
        assert run.attrs["contact_impacts"] > 0.0
        assert obstacle_clearance(run, [post]).value <= 0.0  # cubic interpolation alone passes it by 1 to 2 mm
        free = hf.simulate(replace(setup, pegs=()), t_eval=t)
        assert obstacle_clearance(free, [post]).value < -0.5e-3


def test_a_search_sees_what_lies_in_the_way():
    run = planned().run
    free = simulated_strikes(problem(), PEG, [WINDS])
    assert np.isfinite(free.t[0])
    before = run.tip[run.t < free.t[0]]
    aside = hf.Ground(float(before[:, 0].max()) - 0.05, 0.0, -1.0, 0.0)
    blocked = simulated_strikes(replace(problem(), obstacles=[aside]), PEG, [WINDS])
    assert np.isnan(blocked.t[0])
    assert blocked.clear[0] < free.clear[0]
    assert blocked.score[0] < 0.0
    motion = WINDS.motion(problem().limits).shifted(-free.t[0])
    one = RolloutBatch([CABLE], [PEG], [motion], free.q, free.qd)
    loose = replace(problem(), clearance=-np.inf)
    on = simulate_contact(loose, one, free.t, Budget(threads=1))
    after = run.joints[run.t > free.t[0] + 0.1].reshape(-1, 2)
    lowest = hf.Ground(0.0, float(after[:, 1].min()) + 0.02)
    off = simulate_contact(replace(loose, obstacles=[lowest]), one, free.t, Budget(threads=1))
    assert off.score[0] < on.score[0]
    assert off.turns[0] < on.turns[0]
    assert np.isinf(off.slip[0])  # it ended before it had settled
    assert np.isfinite(on.slip[0])


def test_obstacles_that_cannot_be_are_refused():
    refuses("turning arm hits the wall", replace, problem(), obstacles=[hf.Wall(0.05, -0.05, 0.05, 0.05)])
    with pytest.raises(hf.InvalidInput, match="past obstacles are not followed"):
        hf.follow_plan(replace(planned(), problem=replace(problem(), obstacles=[FLOOR])), None)


def test_a_start_or_target_in_an_obstacle_is_reported_before_a_search():
    arm, floor, post = hf.Arm(length=0.105), hf.Ground(0.0, -1.0), hf.Peg(-0.8, -1.1, 0.1)
    slot = hf.Slot(0.56, -1.9, -0.78)
    for plan in (
        lambda: hf.plan_cast(CABLE, arm, PEG, conditions=hf.Conditions(obstacles=[floor])),
        lambda: hf.plan_whip(CABLE, arm, hf.TipTarget(0.3, -2.05), conditions=hf.Conditions(obstacles=[floor])),
        lambda: hf.plan_insert(CABLE, arm, slot, conditions=hf.Conditions(obstacles=[floor])),
    ):
        refuses(r"the rope begins in the ground at \(0, -1\) m, whatever", plan)
    turned = CABLE.replace(gravity=(0.17, -9.81))
    for plan in (
        lambda: hf.plan_cast(turned, arm, PEG),
        lambda: hf.plan_whip(turned, arm, hf.TipTarget(0.3, -2.05)),
        lambda: hf.plan_insert(turned, arm, slot),
    ):
        refuses(r"gravity along -y; the rope has \(0.17, -9.81\) m/s\^2", plan)
    refuses("obstacles holds something else", hf.Conditions, obstacles=post)
    seen = hf.plan_cast(CABLE, arm, hf.Peg(-0.8, -1.1, 0.03), conditions=hf.Conditions(obstacles=[post]))
    assert (seen.status, seen.message) == ("infeasible", "the target lies in the peg at (-0.8, -1.1) m")
    whip_map = hf.build_whip_map(replace(problem(), obstacles=[post], time=1.0), swings=1)
    assert check_whip_feasibility(whip_map, hf.TipTarget(-0.8, -1.1)).message == seen.message


def test_a_target_that_the_rope_begins_in_is_not_feasible_and_others_are_planned_all_the_same():
    places = [hf.Peg(-0.105, -1.0, 0.03), hf.Peg(-0.8, 1.9, 0.03)]
    on, far = hf.plan_cast(CABLE, hf.Arm(length=0.105), places, conditions=hf.Conditions(side=-1))
    assert on.message.startswith("the rope begins in the target")
    assert (on.status, far.status) == ("infeasible", "infeasible")


@pytest.mark.nightly
def test_obstacles_that_leave_a_wound_rope_no_room_are_reported_before_a_search():
    """And places that they leave none are no fallback targets, and a remedy is one that makes room."""
    arm, room = hf.Arm(length=0.105), 2e3 * CABLE.radius
    near = hf.Wall(PEG.x - PEG.radius - 0.003, -1.5, PEG.x - PEG.radius - 0.003, -0.8)
    plan = hf.plan_cast(CABLE, arm, PEG, conditions=hf.Conditions(obstacles=[near]))
    said = f"out of reach: the wall at ({near.x:.4g}, -1.5) m is 3 mm from the target, the rope needs {room:.3g}"
    assert (plan.status, plan.message, plan.feasibility.impossible) == ("infeasible", said, False)
    assert plan.remedies == ("a peg of 37.9 mm radius",)
    assert plan.fallback.target.x - PEG.radius - near.x >= 2.0 * CABLE.radius
    assert plan.fallback.distance < 0.02
    between = hf.Wall(-0.7, -0.4, -0.2, -0.9)
    for obstacles in ([between], [hf.Peg(2.0, 0.0, 0.1), between]):
        behind = hf.plan_cast(CABLE, arm, PEG, conditions=hf.Conditions(obstacles=obstacles))
        assert behind.message == "out of reach: the wall at (-0.7, -0.4) m is between the arm and the target"
        there = behind.fallback.target
        sight = [np.linspace(tip, (there.x, there.y), 4001) for tip in arm.tip(np.linspace(-np.pi, np.pi, 25))]
        assert max(distance(between, way).min() for way in sight) > 0.0 or behind.fallback.distance > 0.2
    for free in (hf.Wall(-0.6, -1.2, -0.5, -1.0), hf.Peg(-0.3, -0.6, 0.05), hf.Ground(0.0, -2.5)):
        assert check_feasibility(replace(problem(), obstacles=[free]), PEG).feasible


def test_a_cast_is_found_near_a_wall_that_leaves_room():
    cord = hf.Rope.uniform(length=1.2, mass=0.06, n_links=15, radius=0.003, friction=5e-4)
    floor = hf.Conditions(obstacles=[hf.Ground(0.0, -1.4)])
    plan = hf.plan_cast(cord, hf.Arm(length=0.15), hf.Peg(0.5, -0.6, 0.03), conditions=floor, on_plan=lambda plan: True)
    assert plan.success, plan.message
    assert plan.clearance > 0.0
    assert plan.run.joints[..., 1].min() > -1.4


CORD = hf.Rope.uniform(length=1.2, mass=0.06, n_links=30, radius=0.003, friction=2e-4)
ARM, TARGET, BEFORE = hf.Arm(length=0.2), hf.Peg(-0.5, -0.7, 0.03), hf.Peg(-0.25, -0.35, 0.03)

ROD = hf.Rope.uniform(length=1.0, mass=0.1, n_links=5, radius=0.01, friction=0.0)
STRAIGHT = np.zeros((3, 5)), np.zeros((3, 2))  # three samples of a rope that hangs straight down


def beside(down: float, gap: float = 0.0) -> hf.Peg:
    """Return a peg at the side of a rope that hangs straight down, `gap`, m, from its surface."""
    return hf.Peg(0.03 + ROD.radius + gap, -down, 0.03)


def laid(*pegs: hf.Peg, target: hf.Peg) -> tuple[bool, ...]:
    gaps = way_gaps(ROD, target, pegs, STRAIGHT[0], ROD.joints(*STRAIGHT))
    return tuple((gaps < TOUCH).all(axis=0).tolist())


def test_a_rope_runs_behind_what_it_touches_between_arm_and_target():
    assert laid(beside(0.3), target=beside(0.7)) == (True,)
    assert laid(beside(0.7), target=beside(0.3)) == (False,)  # beyond the target
    assert laid(beside(0.3, gap=0.001), target=beside(0.7)) == (False,)
    assert laid(beside(0.3), beside(0.5, gap=0.01), beside(0.1), target=beside(0.7)) == (True, False, True)
    assert laid(target=beside(0.7)) == ()


def test_the_place_along_the_rope_counts_within_a_link_too():
    assert laid(beside(0.45), target=beside(0.55)) == (True,)  # both beside the third link
    assert laid(beside(0.55), target=beside(0.45)) == (False,)


def test_a_touch_that_does_not_last_is_none():
    q = np.zeros((3, 5))
    q[1] = -0.01  # away from the peg
    joints = ROD.joints(q, np.zeros((3, 2)))
    gaps = way_gaps(ROD, beside(0.7), [beside(0.3)], q, joints)[:, 0]
    np.testing.assert_allclose(gaps[[0, 2]], 0.0, atol=1e-12)
    assert gaps[1] == pytest.approx(0.3 * 0.01, rel=0.2)  # where the target is not touched, the way ends at the tip


def test_a_cast_that_does_not_run_behind_a_peg_fails_and_reports_which():
    run = planned().run
    stop = float(planned().motion.breaks[-1])
    taut = run.joints[-1, 0] + 0.5 * (np.array([PEG.x, PEG.y]) - run.joints[-1, 0])
    lies = run.joints[-1][np.hypot(*(run.joints[-1] - taut).T).argmin()]
    for aside, behind in ((0.0, True), (0.1, False)):  # m; the rope sways by 1 cm
        peg = hf.Peg(float(lies[0]) + aside, float(lies[1]), 0.03)
        seen = evaluate_cast(replace(problem(), criteria=hf.WindCriteria(behind=[peg])), PEG, run, stop)
        assert seen.runs_behind == (behind,)
        assert seen.success == behind
        place = f"({peg.x:.4g}, {peg.y:.4g}) m"
        assert seen.message == ("" if behind else f"the rope does not run behind the peg at {place}")


def test_pegs_to_run_behind_are_simulated_and_links_cut_near_them():
    before = hf.Peg(-0.4, -0.5, 0.01)
    setup = verified_setup(replace(problem(), criteria=hf.WindCriteria(behind=[before])), hf.hold_arm(0.0), 1.0, (PEG,))
    assert setup.pegs == (PEG, before)
    assert setup.rope.n_links > verified_setup(problem(), hf.hold_arm(0.0), 1.0, (PEG,)).rope.n_links


def test_a_swing_strikes_the_peg_that_it_meets_first():
    free = simulated_strikes(problem(), PEG, [WINDS])
    before, never = hf.Peg(0.5 * PEG.x, 0.5 * PEG.y, 0.03), hf.Peg(0.0, 1.9, 0.03)
    alone = simulated_strikes(problem(), before, [WINDS])
    assert alone.t[0] < free.t[0]
    first = simulated_strikes(replace(problem(), criteria=hf.WindCriteria(behind=[before])), PEG, [WINDS])
    assert first.t[0] == alone.t[0]
    np.testing.assert_array_equal(first.q, alone.q)
    assert first.score[0] < alone.score[0]  # less rope is left for the target
    same = simulated_strikes(replace(problem(), criteria=hf.WindCriteria(behind=[never])), PEG, [WINDS])
    assert (same.t[0], same.score[0]) == (free.t[0], free.score[0])


def test_turns_of_a_throw_that_misses_a_peg_do_not_count():
    free = simulated_strikes(problem(), PEG, [WINDS])
    motion = WINDS.motion(problem().limits).shifted(-free.t[0])
    one = RolloutBatch([CABLE], [PEG], [motion], free.q, free.qd)
    loose = replace(problem(), clearance=-np.inf)
    on = simulate_contact(loose, one, free.t, Budget(threads=1))
    near, far = (
        simulate_contact(
            replace(loose, criteria=hf.WindCriteria(behind=[hf.Peg(0.3, y, 0.03)])), one, free.t, Budget(threads=1)
        )
        for y in (0.5, 1.5)
    )
    assert on.turns[0] >= 1.25
    assert far.turns[0] == near.turns[0] < 1.25
    assert 0.0 < far.score[0] < near.score[0] < on.score[0]


@pytest.mark.parametrize("asked", [("whip", "--target", -0.5, -0.7), ("insert", "--slot", -0.5, -0.7)])
def test_commands_that_do_not_know_these_pegs_refuse_them(asked, tmp_path, capsys):
    path = tmp_path / "setup.toml"
    path.write_text(hf.Setup(CORD, arm=ARM).dumps() + "\n[behind]\nx = -0.25\ny = -0.35\nradius = 0.03\n", "utf-8")
    assert run([str(each) for each in (*asked, path, "--output", tmp_path / "out")]) == 2
    assert "takes no pegs that the rope is to run behind" in " ".join(capsys.readouterr().err.split())


def test_pegs_to_run_behind_go_with_a_plan_through_its_files(tmp_path):
    pegs = (BEFORE, hf.Peg(-0.4, -0.5, 0.01, 0.2))
    obstacles = hf.Peg(1.2, -1.2, 0.2), hf.Wall(-1.6, -1.8, -1.3, -0.4), hf.Ground(0.0, -2.5, 0.3, 1.0)
    who = replace(problem(), criteria=hf.WindCriteria(behind=pegs), obstacles=obstacles)
    known = replace(planned(), problem=who, outcome=replace(planned().outcome, runs_behind=(True, False)))
    known.to_toml(tmp_path / "cast.toml")
    again = read_plan(tmp_path / "cast.toml")
    assert again.problem == known.problem
    assert again.outcome.runs_behind == (True, False)
    assert hf.Setup.from_toml(tmp_path / "cast.toml").pegs == (PEG, *pegs, *obstacles)
    task = Source(out=tmp_path, setup=tmp_path / "cast.toml", limits={}).read({}, {})
    assert (task.criteria.behind, task.targets["peg"]) == (pegs, PEG)
    assert task.conditions.obstacles == obstacles
    report = CastReport(known)
    story, said = " ".join(report.story), report.texts.text("setup")
    assert "it runs behind a peg at (-0.25, -0.35) m, radius 30 mm, and not behind a peg at (-0.4, -0.5) m" in story
    assert "on its way from the arm to the target: a peg at (-0.25, -0.35) m, radius" in said


def test_a_setup_file_tells_what_to_run_behind(tmp_path):
    path = tmp_path / "setup.toml"
    text = hf.Setup(CORD, arm=ARM, pegs=[TARGET]).dumps()
    path.write_text(text + "\n[behind]\nx = -0.25\ny = -0.35\nradius = 0.03\n", "utf-8")
    source = Source(out=tmp_path, setup=path, limits={})
    assert source.read({}, {}).criteria.behind == (BEFORE,)
    with pytest.warns(UserWarning, match="links of 40 mm near the peg"):
        assert hf.Setup.from_toml(path).pegs == (TARGET,)  # a run leaves it alone
    path.write_text(text + "\n[behind]\nx = -0.25\nspeed = 1.0\n", "utf-8")
    refuses("speed", source.read, {}, {})


def test_what_cannot_be_run_behind_is_refused():
    who = replace(problem(), criteria=hf.WindCriteria(behind=[BEFORE]))
    for each in (hf.Wall(-0.3, -0.3, -0.3, -0.5), hf.Peg(-0.3, -0.4, 0.03, inertia=1e-4)):
        refuses("led behind fixed pegs alone", hf.WindCriteria, behind=[each])
    refuses("behind holds something else", hf.WindCriteria, behind=BEFORE)
    with pytest.raises(InvalidInput, match="turning arm hits the peg"):
        hf.plan_cast(CORD, ARM, TARGET, criteria=hf.WindCriteria(behind=[hf.Peg(0.1, 0.1, 0.01)]))
    with pytest.raises(InvalidInput, match=r"begins in the peg at \(-0.2, -0.5\) m and the peg at \(0.2, -0.5\) m"):
        hf.plan_cast(
            CORD, ARM, TARGET, criteria=hf.WindCriteria(behind=[hf.Peg(side, -0.5, 0.03) for side in (-0.2, 0.2)])
        )
    refuses("is given twice", replace, who, criteria=hf.WindCriteria(behind=[BEFORE, BEFORE]))
    refuses("is an obstacle, too", replace, who, obstacles=[BEFORE])
    asked = {"criteria": hf.WindCriteria(behind=[BEFORE]), "uncertainty": Uncertainty()}
    for words, call in (
        ("a plan with an uncertainty", lambda: hf.plan_cast(CORD, ARM, TARGET, **asked)),
        (
            "a holding force",
            lambda: hf.plan_cast(CORD, ARM, TARGET, criteria=hf.WindCriteria(behind=[BEFORE], holding_force=1.0)),
        ),
        ("an uncertainty", lambda: Uncertainty().sample(1, who, PEG)),
        ("a reach map", lambda: hf.build_reach_map(CORD, ARM, criteria=hf.WindCriteria(behind=[BEFORE]))),
        ("a plan that is followed", lambda: hf.follow_plan(replace(planned(), problem=who), None)),
        ("a whip", lambda: build_whip_map(who, swings=1)),
    ):
        refuses(f"^{words} takes no pegs that the rope is to run behind", call)


def test_the_way_round_counts_as_the_way_to_the_target():
    who = replace(problem(), rope=CORD, arm=ARM)
    straight, beside_it = (
        check_feasibility(replace(who, criteria=hf.WindCriteria(behind=[peg])), TARGET)
        for peg in (BEFORE, hf.Peg(-0.45, -0.1, 0.02))
    )
    assert straight.available_turns == pytest.approx(check_feasibility(who, TARGET).available_turns)
    way = np.hypot(0.45, 0.1) + np.hypot(0.05, 0.6) - np.hypot(0.5, 0.7) - 2.0 * 0.023
    assert straight.available_turns - beside_it.available_turns == pytest.approx(way / (2.0 * np.pi * 0.033))
    assert check_feasibility(replace(who, criteria=hf.WindCriteria(behind=[TARGET])), TARGET).message.startswith(
        "the target lies in the peg"
    )
    tight = check_feasibility(
        replace(who, criteria=hf.WindCriteria(behind=[hf.Peg(-0.46, -0.65, 0.03)])), TARGET
    ).message
    assert "from the target, the rope needs 6" in tight
    wide = replace(
        who, criteria=hf.WindCriteria(behind=[hf.Peg(-0.43, -0.62, 0.03)]), clearance=0.1
    )  # from obstacles alone, not from these
    assert check_feasibility(wide, TARGET).message == check_feasibility(replace(wide, clearance=0.0), TARGET).message
    far = hf.plan_cast(CORD, ARM, hf.Peg(-0.5, -1.0, 0.03), criteria=hf.WindCriteria(behind=[hf.Peg(-0.5, 0.0, 0.03)]))
    assert far.status == "infeasible"
    assert not any("arm" in each for each in far.remedies)  # a longer one would hit the peg


def test_a_cast_behind_a_peg_is_found_and_touches_both():
    plan = hf.plan_cast(
        CORD,
        ARM,
        TARGET,
        criteria=hf.WindCriteria(behind=[BEFORE], contact=0.0),
        on_plan=lambda plan: True,
        time_budget=300.0,
        options=hf.SearchOptions(threads=1),
    )
    assert plan.success, plan.message
    assert plan.outcome.runs_behind == plan.finer_outcome.runs_behind == (True,)
    seen = plan.run
    assert seen.setup.pegs == (TARGET, BEFORE)
    share = np.linspace(0.0, 1.0, 51)[:, None]
    links = zip(seen.joints[-1, :-1], seen.joints[-1, 1:], strict=True)
    points = np.concatenate([a * (1.0 - share) + b * share for a, b in links])
    at = []
    for peg in (BEFORE, TARGET):
        gap = np.hypot(*(points - [peg.x, peg.y]).T) - peg.radius - CORD.radius
        assert abs(gap.min()) < 2e-4
        at.append(int((gap < 2e-4).argmax()))
    assert at[0] < at[1]
    finer = verify_cast(plan.problem.cut(2), TARGET, plan.motion, accuracy=Accuracy(0.2 * hf.model.DEFAULT_TOL, 1e-4))
    assert finer.success, finer.message
    assert finer.runs_behind == (True,)
