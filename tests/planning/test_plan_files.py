"""Plans as files: the motor's table, the repeated simulation of the set-up, reading back."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.planning import CastPlan, FallbackTarget, SuccessProbability, WhipPlan, verify_cast
from hyperflex.planning.plan import to_table
from hyperflex.planning.tasks.tip import sample_times
from hyperflex.planning.tasks.whip import verify_whip
from hyperflex.planning.verification import CAST_ACCURACY
from hyperflex.status import Status
from tests.planning.known import PEG, WINDS, late, planned, stopped, unreachable
from tests.planning.known_insert import planned_insert
from tests.planning.known_whip import far_whip, planned_whip
from tests.refusals import refuses


def test_the_motors_table_holds_the_planned_angles(tmp_path):
    plan = planned()
    plan.to_csv(tmp_path / "motion.csv", rate=250.0)
    found = files.read_table(tmp_path / "motion.csv")
    names, rows = found.names, found.values
    assert names == ["t", "angle"]
    np.testing.assert_array_equal(rows[:, 1], plan.motion.angle(rows[:, 0]))
    np.testing.assert_allclose(np.diff(rows[:, 0]), 1.0 / 250.0, rtol=1e-9)  # rounding of k / 250
    assert plan.motion.breaks[-1] <= rows[-1, 0] < plan.motion.breaks[-1] + 1.0 / 250.0
    assert rows[-1, 1] == plan.moves.angles(plan.problem.limits)[-1]


def test_the_motors_table_reads_back_as_the_motion(tmp_path):
    plan = planned()
    plan.to_csv(tmp_path / "motion.csv")
    assert hf.read_motion(tmp_path / "motion.csv") == plan.motion
    # Rows that differ from the head are a spline's. One through samples every h = 5 ms misses a jump of the
    # acceleration by a = 24 rad/s^2 by less than a h^2 / 8 = 7e-5 rad, beside what the rows were moved by.
    table = files.read_table(tmp_path / "motion.csv")
    table.values[:, 1] += 1e-6
    files.write_table(tmp_path / "moved.csv", table.names, table.values, notes=table.notes)
    back, t = hf.read_motion(tmp_path / "moved.csv"), np.linspace(0.0, 9.0, 5001)
    np.testing.assert_allclose(back.angle(t), plan.motion.angle(t), atol=7.1e-5)
    assert np.abs(back.acceleration(t)).max() > 1.25 * plan.problem.limits.acceleration


@pytest.mark.parametrize("rate", [50.0, 200.0, 1000.0])
def test_what_the_motors_table_asks_is_within_the_motors_limits(tmp_path, rate):
    """Read back, and by differences of its rows: means of rate and acceleration between them."""
    plan, limits = planned(), planned().problem.limits
    plan.to_csv(tmp_path / "motion.csv", rate=rate)
    back, t = hf.read_motion(tmp_path / "motion.csv"), np.linspace(0.0, 9.0, 90001)
    assert np.abs(back.acceleration(t)).max() <= limits.acceleration * (1.0 + 1e-9)
    assert np.abs(back.rate(t)).max() <= limits.speed * (1.0 + 1e-9)
    angle = files.read_table(tmp_path / "motion.csv").values[:, 1]
    assert np.abs(np.diff(angle)).max() * rate <= limits.speed * (1.0 + 1e-9)
    assert np.abs(np.diff(angle, 2)).max() * rate**2 <= limits.acceleration * (1.0 + 1e-6)


@pytest.mark.parametrize("note", ["{", "3", "{}", '{"angles": [0, 1], "rests": [0], "durations": [-1]}'])
def test_a_head_that_does_not_fit_leaves_the_rows(tmp_path, note):
    files.write_table(tmp_path / "motion.csv", ["t", "angle"], [[0.0, 0.0], [1.0, 1.0]], notes={"moves": note})
    assert hf.read_motion(tmp_path / "motion.csv") == hf.sampled_motion([0.0, 1.0], [0.0, 1.0])


@pytest.mark.parametrize("rate", [0.0, math.nan, -1.0, 0.01, 1e9])
def test_a_rate_that_suits_no_motor_is_refused(tmp_path, rate):
    refuses("rate", planned().to_csv, tmp_path / "motion.csv", rate=rate)
    assert list(tmp_path.iterdir()) == []


def uncertain() -> CastPlan:
    return replace(planned(), success_probability=SuccessProbability(37, 40), interrupted=True)


def with_fallback() -> CastPlan:
    near = FallbackTarget(PEG, 0.07, planned(), 2)
    return replace(planned(winds=False), fallback=near, remedies=("a rope of 2.94 m", "an arm of 120 mm"))


def expected_only() -> CastPlan:
    return replace(stopped(), fallback=FallbackTarget(PEG, 0.07))


def unverified_whip() -> WhipPlan:
    return replace(planned_whip(meets=False), outcome=None, finer_outcome=None, interrupted=True, decided=False)


@pytest.mark.parametrize(
    "made",
    [
        planned,
        lambda: planned(winds=False),
        late,
        stopped,
        uncertain,
        with_fallback,
        expected_only,
        planned_whip,
        lambda: planned_whip(meets=False),
        lambda: planned_whip(any_direction=True),
        unverified_whip,
        planned_insert,
    ],
)
def test_a_plan_reads_back_as_it_was_written(tmp_path, made):
    """In all its fields but the runs, and once more in the same file."""
    plan = made()
    plan.to_toml(tmp_path / "plan.toml")
    back = hf.read_plan(tmp_path / "plan.toml")
    assert type(back) is type(plan)
    assert (back.problem, back.target, back.feasibility) == (plan.problem, plan.target, plan.feasibility)
    assert (back.success, back.status, back.message) == (plan.success, plan.status, plan.message)
    assert back.motion == plan.motion
    for name in ("margin", "runs", "seconds", "remedies", "interrupted", "decided"):
        assert getattr(back, name, None) == getattr(plan, name, None)
    assert (back.refuted, back.notes()) == (plan.refuted, plan.notes())
    assert files.dumps_toml(to_table(back)) == files.dumps_toml(to_table(plan))
    back.to_toml(tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_text() == (tmp_path / "plan.toml").read_text()
    head = (tmp_path / "plan.toml").read_text().split("\n\n")[0].splitlines()
    assert head[0].startswith(f"# A planned {plan.kind}. SI units: m, kg, s")
    assert all(line.startswith("# ") for line in head)
    assert back.run is None
    refuses("read from a file has no runs", back.to_netcdf, tmp_path / "run.nc")


@pytest.mark.parametrize(
    ("made", "status"),
    [
        (planned, Status.SUCCESS),
        (unreachable, Status.INFEASIBLE),
        (lambda: replace(stopped(None), interrupted=False), Status.OUT_OF_TIME),
        (lambda: planned(winds=False), Status.FAILED),
        (late, Status.OUT_OF_TIME),
        (stopped, Status.INTERRUPTED),
        (lambda: replace(unverified_whip(), interrupted=False, decided=True), Status.FAILED),
    ],
)
def test_the_status_reports_why_the_planner_ended(made, status):
    plan = made()
    assert (plan.status, plan.success, bool(plan.message)) == (status, status == "success", status != "success")


def test_the_set_up_of_a_plan_and_what_is_read_back_are_the_verified_run(tmp_path):
    plan = planned(winds=False)
    plan.to_toml(tmp_path / "plan.toml")
    plan.to_netcdf(tmp_path / "run.nc")
    back = hf.read_plan(tmp_path / "plan.toml")
    seen = verify_cast(back.problem, back.target, back.motion, accuracy=CAST_ACCURACY)
    np.testing.assert_array_equal(seen.run.q, plan.outcome.run.q)
    again = hf.simulate(hf.Setup.from_toml(tmp_path / "plan.toml"), t_eval=plan.outcome.run.t)
    np.testing.assert_array_equal(again.q, plan.outcome.run.q)
    np.testing.assert_array_equal(hf.read_trajectory(tmp_path / "run.nc").q, plan.outcome.run.q)


@pytest.mark.parametrize("made", [late, stopped])
def test_the_set_up_of_a_plan_without_a_run_lasts_as_long_as_one(tmp_path, made):
    plan = made()
    plan.to_toml(tmp_path / "plan.toml")
    setup = hf.Setup.from_toml(tmp_path / "plan.toml")
    assert setup.duration == pytest.approx(WINDS.stops(plan.problem.limits) + 3.0)
    assert setup.duration == planned().outcome.run.setup.duration


def test_a_summary_has_the_figures_of_the_plan():
    told = uncertain().summary()
    assert (told["source"], told["success"], told["status"], told["message"]) == ("simulated", True, "success", "")
    assert told["outcome"]["turns"] == planned().outcome.turns
    assert told["success_probability"]["interval"] == SuccessProbability(37, 40).interval
    assert len(told["starts"]) == planned().moves.ends.size
    assert told["stop"] == pytest.approx(planned().motion.breaks[-1], rel=1e-15)  # summed in another order
    assert "run" not in told["outcome"]
    assert with_fallback().summary()["fallback"]["plan"]["success"]


def test_a_whip_that_is_read_back_strikes_again(tmp_path):
    plan = planned_whip()
    plan.to_toml(tmp_path / "whip.toml")
    back = hf.read_plan(tmp_path / "whip.toml")
    again = verify_whip(back.problem, back.target, back.motion, plan.outcome.t)
    assert again.miss == plan.outcome.miss == back.outcome.miss
    assert back.outcome.angle_error == pytest.approx(0.1)
    assert back.finer_outcome.n_links == 2 * back.outcome.n_links
    assert back.impact() == plan.impact()
    run = hf.simulate(hf.Setup.from_toml(tmp_path / "whip.toml"))
    assert run.t[-1] == pytest.approx(sample_times(plan.outcome.t)[-1])
    at = np.array([np.interp(plan.outcome.t, run.t, run.tip[:, k]) for k in (0, 1)])
    # Straight between samples of 10 ms at 1.3 m/s, curved over some 0.3 m: 1e-4 m; the default tolerance is less.
    np.testing.assert_allclose(at, plan.outcome.place, atol=5e-4)


@pytest.mark.parametrize(
    ("made", "mark"),
    [
        (late, "not verified"),
        (stopped, "not verified"),
        (unverified_whip, "not verified"),
        (lambda: planned(winds=False), "fails"),
        (lambda: planned_whip(meets=False), "fails"),
    ],
)
def test_the_motors_table_reports_whether_its_throw_was_verified(tmp_path, made, mark):
    plan = made()
    plan.to_csv(tmp_path / "motion.csv")
    assert f"# {mark}: {plan.message}\n" in (tmp_path / "motion.csv").read_text()
    assert files.read_table(tmp_path / "motion.csv").notes[mark] == plan.message
    assert hf.read_motion(tmp_path / "motion.csv").breaks[-1] == pytest.approx(plan.motion.breaks[-1], abs=5e-3)


def test_the_motors_table_of_a_throw_that_succeeds_has_no_mark(tmp_path):
    planned().to_csv(tmp_path / "motion.csv")
    notes = files.read_table(tmp_path / "motion.csv").notes
    assert not {"not verified", "fails"} & set(notes)
    assert notes["target"] == f"x {PEG.x:g} m, y {PEG.y:g} m, radius 0.04 m, mu 0.3"
    assert notes["arm"] == "0.105 m, begins at -1.5708 rad"
    plan = planned_whip()
    plan.to_csv(tmp_path / "motion.csv")
    notes = files.read_table(tmp_path / "motion.csv").notes
    assert notes["target"] == f"x {plan.target.x:g} m, y {plan.target.y:g} m"
    assert {"rope", "arm", "start"} <= set(notes)


@pytest.mark.parametrize("made", [unreachable, far_whip])
def test_a_plan_without_moves_has_nothing_to_write(tmp_path, made):
    plan = made()
    for write in (plan.to_csv, plan.to_toml, plan.to_netcdf):
        refuses("out of reach", write, tmp_path / "x.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_set_up_is_no_plan(tmp_path):
    hf.Setup(planned().problem.rope).to_toml(tmp_path / "setup.toml")
    refuses("has no plan", hf.read_plan, tmp_path / "setup.toml")


@pytest.mark.parametrize(
    ("made", "old", "new"),
    [
        (planned, "[plan.problem.limits]", "[plan.problem.limit]"),
        (planned, "turns = ", "rounds = "),
        (planned_whip, "direction = ", "way = "),
    ],
)
def test_a_plan_that_lacks_a_part_is_refused(tmp_path, made, old, new):
    made().to_toml(tmp_path / "plan.toml")
    text = (tmp_path / "plan.toml").read_text()
    assert old in text
    (tmp_path / "plan.toml").write_text(text.replace(old, new))
    refuses("not complete", hf.read_plan, tmp_path / "plan.toml")


@pytest.mark.parametrize(("old", "new"), [("speed = 8.6", "speed = 4.3"), ("length = 0.105", "length = 0.3")])
def test_a_plan_whose_limits_or_arm_were_changed_by_hand_is_refused(tmp_path, old, new):
    planned().to_toml(tmp_path / "plan.toml")
    text = (tmp_path / "plan.toml").read_text()
    before, found, after = text.rpartition(old)
    assert found
    (tmp_path / "plan.toml").write_text(before + new + after)
    refuses("no longer fit", hf.read_plan, tmp_path / "plan.toml")
