"""Verified runs: their refusals, contact and holding force of the wound rope, and motion out of the plane."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import winding
from hyperflex.budget import Budget
from hyperflex.planning import MotorLimits, Moves, Problem, Uncertainty, WindCriteria, outcome, verify_cast
from hyperflex.planning.clearance import FINE, rope_clearance
from hyperflex.planning.ensemble import strikes_in_plane
from hyperflex.planning.feasibility import check_feasibility
from hyperflex.planning.outcome import evaluate_cast, measure_holding_force, require_holding_force
from hyperflex.planning.tasks.whip import TipTarget, verify_whip
from hyperflex.planning.verification import folded_flat, greatest_bend, limit_bend, motor_torques, verified_setup
from hyperflex.report import CastReport
from tests.planning.known import CABLE, PEG, WINDS, late, planned, problem
from tests.planning.known_whip import planned_whip
from tests.refusals import refuses

CORD = hf.Rope.uniform(length=1.2, mass=0.06, n_links=15, radius=0.004, friction=2e-5)
QUICK = Problem(CORD, hf.Arm(length=0.2), MotorLimits(speed=12.0, acceleration=80.0), 3.0)
FOLDS = Moves(
    -1, np.array([3.0, 0.1, 3.1, -1.5]) - [np.pi / 2, np.pi / 2, np.pi / 2, 0.0], np.array([0.2, 0.5, 0.5, 0.3])
)


def test_no_joint_bends_further_than_the_ropes_thickness_lets_it():
    """Two links of 80 mm whose axes keep to a circle of 4 mm: nearly folded, by 2 atan(40 / 4) = 2.94 rad."""
    limited = limit_bend(CORD)
    assert limited.max_bend[0] == np.inf  # a hinge
    np.testing.assert_allclose(limited.max_bend[1:], 2.0 * np.arctan(10.0), rtol=1e-12)
    assert limit_bend(CORD.replace(radius=0.0)).max_bend[3] == pytest.approx(np.pi)
    own = limit_bend(CORD.replace(max_bend=[np.inf, 0.5] + 13 * [np.inf]))
    assert (own.max_bend[1], own.max_bend[2]) == (0.5, limited.max_bend[2])
    curled = limit_bend(CORD.replace(rest_angle=0.3))
    assert curled.max_bend[5] == pytest.approx(limited.max_bend[5] - 0.3)  # of the relative angle, from rest
    printed = CORD.replace(friction_model="printed")
    assert limit_bend(printed) == printed


def test_a_throw_that_would_fold_the_rope_through_itself_is_simulated_with_a_rope_that_cannot():
    motion = FOLDS.motion(QUICK.limits)
    free = hf.simulate(CORD, motion, arm=QUICK.arm, duration=3.0)
    assert greatest_bend(free) > 2.0 * np.pi  # once round
    run = hf.simulate(verified_setup(QUICK, motion, 3.0))
    assert greatest_bend(run) < 2.0 * np.arctan(10.0) + 1e-3
    assert folded_flat(run)
    assert not folded_flat(planned().run)


def test_a_rope_whose_own_limits_let_it_fold_through_itself_fails():
    loose, motion = replace(QUICK, rope=CORD.replace(max_bend=6.0), clearance=-np.inf), FOLDS.motion(QUICK.limits)
    seen = verify_whip(loose, TipTarget(0.0, 0.0, 0.0, 0.1, np.pi), motion, 2.5, tol=1e-4)
    assert "folds through itself" in seen.message


def standing(arm_angle: float, aside: float = 0.0, **arm: float) -> hf.Trajectory:
    """A straight rope at rest that hangs from an arm, turned by some angle."""
    rope = hf.Rope.uniform(length=1.2, mass=0.06, n_links=12, radius=0.004, friction=2e-3)
    q = np.full(12, aside)
    return hf.simulate(rope, hf.hold_arm(arm_angle), arm=hf.Arm(length=0.2, **arm), duration=1e-3, q0=q)


@pytest.mark.parametrize(
    ("arm_angle", "aside", "arm", "clear", "what"),
    [
        (np.pi, 0.0, {}, 0.0, "the arm"),  # the arm is upright, and the rope hangs along it, over the shaft
        (
            np.pi,
            np.arctan(0.5),
            {},
            0.1 * np.sin(np.arctan(0.5)),
            "the arm",
        ),  # the second link's begin, 0.1 m from the tip
        (0.5 * np.pi, -1.2, {"radius": 0.01}, 0.2 * np.cos(1.2) - 0.01, "the arm"),  # the third link's
        (0.5 * np.pi, 0.0, {"shaft_radius": 0.15}, 0.05, "the motor's shaft"),
    ],
)
def test_clearance_is_that_of_the_geometry(arm_angle, aside, arm, clear, what):
    found = rope_clearance(standing(arm_angle, aside, **arm))
    assert found.what == what
    assert found.value == pytest.approx(clear - 0.004, abs=FINE)


def test_clearance_between_samples_is_found():
    """An arm that goes over the top drags its rope across itself within one of these samples, and out again."""
    arm, motion = hf.Arm(length=0.2), hf.arm_moves([-1.5, -4.4], [0.2], [0.677])
    fine, rough = (
        hf.simulate(CORD, motion, arm=arm, duration=1.2, t_eval=np.linspace(0.0, 1.2, count)) for count in (6001, 41)
    )
    found = rope_clearance(rough)
    assert found.value == pytest.approx(-CORD.radius, abs=FINE)
    assert (found.value, found.t) == pytest.approx(rope_clearance(fine)[:2], abs=1e-3)
    apart = [rope_clearance(hf.simulate(CORD, motion, arm=arm, duration=t, t_eval=[t])) for t in rough.t[1:]]
    assert min(one.value for one in apart) > 5e-3


def test_a_throw_whose_rope_comes_too_near_its_arm_fails(tmp_path):
    seen = planned().outcome
    assert seen.clearance == planned().clearance == planned().summary()["clearance"] > 0.02
    near = replace(problem(), arm=hf.Arm(length=0.105, shaft_radius=0.0999))  # the body of a motor
    whole = verify_cast(near, PEG, WINDS.motion(near.limits))
    assert (whole.wound, whole.held, whole.success) == (True, True, False)
    assert "the rope goes through the motor's shaft at" in whole.message
    asked = verify_cast(replace(problem(), clearance=0.05), PEG, WINDS.motion(near.limits))
    assert asked.message.startswith(f"the rope comes within {1e3 * seen.clearance:.1f} mm of the arm at")
    assert asked.message.endswith(", 50 mm required")
    before = replace(near, clearance=-np.inf)
    assert verify_cast(before, PEG, WINDS.motion(near.limits)).success  # it swings in front of the motor
    plan = replace(planned(), problem=before, finer_outcome=late().outcome)
    assert plan.clearance == seen.clearance  # an incomplete run gives none
    plan.to_toml(tmp_path / "plan.toml")
    assert hf.read_plan(tmp_path / "plan.toml").problem == before


def test_torque_is_that_of_all_steps():
    """And not of samples 10 ms apart: against those 0.2 ms apart, half as long as a step, about the greatest."""
    seen = planned().outcome
    assert seen.torque_peak > 1.1 * np.abs(seen.run.motor_torque).max()  # a blow between two samples
    about = seen.run.attrs["torque_peak_time"], seen.run.attrs["torque_mean_time"]
    t = np.append(0.0, np.arange(min(about) - 0.02, max(about) + 0.02, 2e-4))
    fine = np.abs(hf.simulate(seen.run.setup, t_eval=t, duration=float(t[-1])).motor_torque[1:])
    # windows slide by a tenth of their length
    moved = np.convolve(fine, np.full(25, 0.04), mode="valid").max()
    assert 0.95 * moved < seen.torque < 1.02 * moved
    assert seen.torque < seen.torque_peak


def test_the_torque_of_a_blow_is_reported():
    """A hanging rope whose joint comes to its limit in a swing: what acts for no time is a mean over some."""
    rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=2, max_bend=0.5, friction=0.0)
    run = hf.simulate(rope, hf.hold_arm(0.0), arm=hf.Arm(length=0.2, mass=0.1, com=0.1), duration=1.0, qd0=[0.0, 6.0])
    mean, peak = motor_torques(run)
    assert peak > 5.0 * mean > 5.0 * np.abs(run.motor_torque).max() / 2.0
    assert peak * 5e-4 == pytest.approx(mean * 5e-3, rel=0.2)  # one impact, and little else


def test_contact_is_required_and_reported():
    """2.36 turns, 850 degrees, of which 616 lie on the peg all through the watch: the rest is straight or hangs."""
    seen, motion = planned().outcome, WINDS.motion(problem().limits)
    assert np.degrees(seen.contact_angle) == pytest.approx(616, abs=3)  # 643 at its end
    assert 0.25 < abs(seen.turns) - seen.contact_angle / (2.0 * np.pi) < 0.8
    assert verify_cast(replace(problem(), criteria=hf.WindCriteria(contact=10.5)), PEG, motion).success
    more = verify_cast(replace(problem(), criteria=hf.WindCriteria(contact=12.0)), PEG, motion)
    assert (more.wound, more.held, more.success) == (True, True, False)
    assert more.message.endswith("degrees of the peg, 688 required")


def test_required_contact_needs_rope():
    known = [
        check_feasibility(replace(problem(), criteria=hf.WindCriteria(contact=contact)), PEG)
        for contact in (0.0, 6.0, 7.0, 60.0)
    ]
    needed = [each.needed_turns for each in known]
    assert needed == sorted(needed)
    assert needed[1] == needed[2] == pytest.approx(needed[0] + 1.0)  # another time round
    assert [each.feasible for each in known] == [True, True, True, False]


def test_a_whip_through_its_own_arm_fails():
    plan = planned_whip()
    assert plan.success
    assert 0.0 < plan.clearance == min(plan.outcome.clearance, plan.finer_outcome.clearance)
    near = replace(plan.problem, clearance=1.01 * plan.outcome.clearance)
    motion = plan.moves.motion(near.limits)
    seen = verify_whip(near, plan.target, motion, plan.outcome.t)
    assert "comes within" in seen.message
    assert seen.refused == seen.message


def test_the_tail_is_what_hangs_below_the_peg():
    run = planned().outcome.run
    tail = winding.measure_winding(run, PEG).tail
    # Quiet at the end: the tension towards the tip is the tail's weight, but for its last slow swinging (1 %).
    assert winding.measure_winding(run, PEG).after[-1] == pytest.approx(tail[-1], rel=0.01)
    length = tail[-1] / 9.81 / CABLE.total_mass * CABLE.total_length
    assert np.linalg.norm(run.tip[-1] - [PEG.x, PEG.y]) == pytest.approx(length, abs=0.08)  # peg and a link
    assert np.isnan(tail[0])


def test_a_tug_bears_at_least_what_the_rule_gives():
    held = measure_holding_force(planned().outcome.run, PEG)
    assert held.contact_angle / (2.0 * np.pi) == pytest.approx(
        abs(planned().outcome.turns), abs=0.7
    )  # both tangents are off it
    assert held.capstan_force == pytest.approx(held.tail_weight * np.exp(0.3 * held.contact_angle), rel=1e-12)
    # The rope on the peg has weight as well, and a tug turns the tangent: more than the rule, within a factor of 3.
    assert held.capstan_force < held.force < 3.0 * held.capstan_force
    assert held.tug.slipped


def test_a_tug_allows_the_slip_of_the_criteria():
    plan = replace(planned(), problem=replace(planned().problem, criteria=WindCriteria(max_slip=0.02)))
    tug = plan.measure_holding_force().tug
    assert tug.allowed == 0.02
    assert tug.slipped == (np.abs(tug.slip).max() > 0.02)


def test_a_rope_off_the_peg_holds_nothing():
    assert measure_holding_force(planned(winds=False).outcome.run, PEG) is None


def test_a_rope_that_ended_inside_the_peg_is_not_tugged():
    run, wider = planned().outcome.run, replace(PEG, radius=PEG.radius + 1e-3)
    assert measure_holding_force(replace(run, setup=replace(run.setup, pegs=(wider,))), wider) is None


def test_a_cast_that_holds_less_than_required_fails():
    cast = planned().outcome
    force = measure_holding_force(cast.run, PEG).force
    budget = Budget()
    assert require_holding_force(cast, PEG, WindCriteria(holding_force=0.9 * force), budget) is cast
    assert require_holding_force(cast, PEG, WindCriteria(holding_force=0.0), budget) is cast
    failed = require_holding_force(cast, PEG, WindCriteria(holding_force=1.1 * force), budget)
    assert (failed.wound, failed.held, failed.success) == (True, False, False)
    assert failed.message == f"its holding force is {force:.3g} N, {1.1 * force:.3g} N required"


@pytest.mark.parametrize(
    ("touched", "begins"),
    [
        ([], np.nan),
        ([1.0], 1.0),
        ([1.0, 1.1, 1.2, 3.0, 3.1, 3.2, 3.3], 3.0),  # it grazes, then comes for good
        ([1.0, 1.2, 1.4, 1.6, 3.0, 3.1], 1.0),  # breaks of 0.2 s are bounces
        ([1.0, 1.1, 2.0, 2.1], 1.0),
    ],
)
def test_the_strike_begins_the_longest_stay(touched, begins):
    t = np.round(np.arange(0.0, 4.0, 0.1), 1)
    assert outcome._longest_stay(t, np.isin(t, touched)) == pytest.approx(begins, nan_ok=True)


def test_contact_and_bend_are_those_of_the_run():
    """By the places of the joints, in place of angles."""
    cast = planned().outcome
    run = cast.run
    links = np.diff(run.joints, axis=1) / np.linalg.norm(np.diff(run.joints, axis=1), axis=2)[..., None]
    bend = np.arccos(np.clip((links[:, 1:] * links[:, :-1]).sum(axis=2), -1.0, 1.0)).max()
    assert cast.max_bend == pytest.approx(bend, abs=1e-6)
    assert not cast.folded
    stop = planned().motion.breaks[-1] + hf.WindCriteria.settle
    watched = winding.measure_winding(run, PEG).contact[run.t >= stop]
    assert cast.contact_angle == watched.min() < watched[-1]  # the required and the reported value are equal
    away = run.joints[-1] - [PEG.x, PEG.y]
    lies = np.flatnonzero(np.hypot(*away.T) < PEG.radius + 0.0025 + 0.002)
    angle = np.unwrap(np.arctan2(away[lies, 1], away[lies, 0]))
    assert watched[-1] == pytest.approx(abs(angle[-1] - angle[0]), abs=0.5)  # to the length of a link on the peg
    assert cast.touch_time <= cast.strike_time


def test_a_weight_on_an_upright_rope_pulls_only_along_it():
    """A rod rests on a peg near its tip, at 60 degrees from hanging: half of the tip's weight pulls along it."""
    rod = hf.Rope.uniform(length=1.0, mass=0.1, n_links=1, radius=0.004, tip_mass=0.05, friction=0.5)
    slope = np.radians(60.0)
    along, across = np.array([np.sin(slope), -np.cos(slope)]), np.array([np.cos(slope), np.sin(slope)])
    peg = hf.Peg(*(0.8 * along - 0.02401 * across), 0.02, 0.3)
    run = hf.simulate(rod, duration=0.5, q0=[slope], pegs=[peg], refine=False)
    assert winding.measure_winding(run, peg).after[-1] == pytest.approx(0.05 * 9.81 * np.cos(slope), rel=1e-3)
    assert winding.rope_tension(run)[-1, -1] == pytest.approx(0.05 * 9.81, rel=1e-3)


def judged(**criteria):
    """The outcome of the known cast by other criteria."""
    run, stop = planned().run, float(planned().motion.breaks[-1])
    return evaluate_cast(replace(problem(), criteria=hf.WindCriteria(**criteria)), PEG, run, stop)


def test_a_cast_reports_how_far_to_the_side_it_strikes():
    seen, run = planned().outcome, planned().run
    found = hf.sideways(run, tilt=math.radians(1.0))
    assert found.touch == seen.touch_time
    assert seen.half_width <= np.abs(found.joints[-1]).max() * (1.0 + 1e-12)  # rounding: sums in another order
    near = np.abs(found.joints[-1] - seen.sideways).min(), np.abs(found.joints[-1] + seen.sideways).min()
    assert min(near) < run.setup.rope.length.max() * np.abs(found.angles[-1]).max()  # a joint of the link that strikes
    assert 0.0 < seen.sideways <= seen.half_width
    wider = judged(tilt=math.radians(2.0))
    assert wider.half_width == pytest.approx(2.0 * seen.half_width)
    assert judged(tilt=0.0).aside == pytest.approx(seen.aside)


def test_a_rope_too_far_aside_fails():
    most = planned().outcome.half_width
    assert judged(max_sideways=1.01 * most).success
    failed = judged(max_sideways=0.99 * most)
    assert not failed.success
    assert f"it is up to {1e3 * most:.0f} mm to the side" in failed.message


def test_a_plan_reports_that_links_lean_too_far_for_the_first_order():
    seen = planned().outcome
    assert seen.lean == pytest.approx(np.abs(hf.sideways(planned().run, tilt=math.radians(1.0)).angles).max())
    for lean, said in ((0.3, ""), (0.4, "Begun 1 degree out of the plane, a link leans by 22.9 degrees")):
        plan = replace(planned(), outcome=replace(seen, lean=lean))
        warning = CastReport(plan).warning
        assert said in warning
        assert ("a link leans" in warning) == bool(said)
        assert plan.summary()["outcome"]["lean"] == lean


def test_a_rope_that_does_not_strike_has_no_side():
    missed = planned(winds=False).outcome
    assert math.isnan(missed.half_width)
    assert math.isnan(missed.aside)


def test_a_rope_whose_side_is_not_known_fails(monkeypatch):
    monkeypatch.setattr(outcome, "_aside", lambda run: (math.nan, math.nan, math.nan, "it touches at once"))
    assert judged().success
    failed = judged(max_sideways=10.0)
    assert not failed.success
    assert "touches at once" in failed.message


def test_dry_friction_and_large_tilts_are_refused():
    dry = problem().rope.replace(dry_friction=1e-5)
    assert replace(problem(), rope=dry).rope is dry
    refuses("Leave dry friction out", replace, problem(), rope=dry, criteria=hf.WindCriteria(max_sideways=0.1))
    for kind in (hf.WindCriteria, Uncertainty):
        refuses("tilt is not small", kind, tilt=1.0)


def test_scenarios_draw_tilts_and_fail_by_them():
    narrow = replace(problem(), criteria=hf.WindCriteria(max_sideways=0.03))
    draws = Uncertainty(tilt=0.02).sample(400, narrow, PEG)
    assert np.std([each.tilt for each in draws]) == pytest.approx(0.02, rel=0.15)  # 4 standard deviations
    within = strikes_in_plane(narrow, draws, 1.5)
    assert within.mean() == pytest.approx(0.683, abs=0.09)  # within one standard deviation
    assert strikes_in_plane(problem(), draws, math.nan).all()
    assert not strikes_in_plane(narrow, draws, math.nan).any()
    same = Uncertainty(tilt=0.0).sample(3, narrow, PEG)
    assert [each.lag for each in same] == [each.lag for each in draws[:3]]
