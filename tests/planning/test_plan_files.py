"""A plan as files: the motor's table, the set-up that is simulated again, what is read back."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import InvalidInput
from hyperflex.planning import planner as course
from hyperflex.planning import read_plan
from hyperflex.planning.search.candidates import Landing
from hyperflex.planning.search.search import Search
from hyperflex.planning.wind.outcome import SETTLING, WATCH
from tests.planning.known import PEG, WINDS, late, planned, stopped, thrower, unreachable


def test_the_motors_table_holds_the_planned_angles(tmp_path):
    plan = planned()
    plan.to_csv(tmp_path / "motion.csv", rate=250.0)
    names, rows = files.read_table(tmp_path / "motion.csv")
    assert names == ["t", "angle"]
    np.testing.assert_array_equal(rows[:, 1], plan.motion.angle(rows[:, 0]))
    np.testing.assert_allclose(np.diff(rows[:, 0]), 1.0 / 250.0, rtol=1e-9)  # rounding of k / 250
    assert plan.motion.breaks[-1] <= rows[-1, 0] < plan.motion.breaks[-1] + 1.0 / 250.0
    assert rows[-1, 1] == plan.throw.angles(plan.thrower.limits)[-1]


def test_the_motors_table_reads_back_as_the_motion(tmp_path):
    plan = planned()
    plan.to_csv(tmp_path / "motion.csv")
    back, t = hf.read_motion(tmp_path / "motion.csv"), np.linspace(0.0, 9.0, 5001)
    # A spline through samples every h = 5 ms misses a jump of the acceleration by a = 24 rad/s^2 by less than
    # a h^2 / 8 = 7e-5 rad.
    np.testing.assert_allclose(back.angle(t), plan.motion.angle(t), atol=7e-5)


@pytest.mark.parametrize("rate", [0.0, math.nan, -1.0, 0.01, 1e9])
def test_a_rate_that_suits_no_motor_is_refused(tmp_path, rate):
    with pytest.raises(InvalidInput, match="rate"):
        planned().to_csv(tmp_path / "motion.csv", rate=rate)
    assert list(tmp_path.iterdir()) == []


def test_a_plan_reads_back(tmp_path):
    plan = planned()
    plan.to_toml(tmp_path / "plan.toml")
    who, peg, motion = read_plan(tmp_path / "plan.toml")
    assert (who.rope, who.arm, who.limits, who.time) == (
        plan.thrower.rope,
        plan.thrower.arm,
        plan.thrower.limits,
        plan.thrower.time,
    )
    assert peg == PEG
    assert motion == plan.motion
    told = files.read_toml(tmp_path / "plan.toml")["plan"]["outcome"]
    assert told["source"] == "simulated"
    assert told["cast"]["turns"] == plan.cast.turns
    assert told["strokes"] == 6


def test_the_set_up_of_a_plan_is_the_verified_run(tmp_path):
    plan = planned(winds=False)
    plan.to_toml(tmp_path / "plan.toml")
    plan.to_netcdf(tmp_path / "run.nc")
    again = hf.simulate(hf.Setup.from_toml(tmp_path / "plan.toml"), t_eval=plan.cast.run.t)
    np.testing.assert_array_equal(again.q, plan.cast.run.q)
    np.testing.assert_array_equal(hf.read_trajectory(tmp_path / "run.nc").q, plan.cast.run.q)


@pytest.mark.parametrize("made", [late, stopped])
def test_the_set_up_of_a_plan_without_a_run_lasts_as_long_as_one(tmp_path, made):
    plan = made()
    plan.to_toml(tmp_path / "plan.toml")
    setup = hf.Setup.from_toml(tmp_path / "plan.toml")
    assert setup.duration == pytest.approx(WINDS.stops(plan.thrower.limits) + SETTLING + WATCH)
    assert setup.duration == planned().cast.run.setup.duration


def test_a_run_that_was_not_finished_has_no_numbers(tmp_path):
    plan = late()
    plan.to_toml(tmp_path / "plan.toml")
    outcome = files.read_toml(tmp_path / "plan.toml")["plan"]["outcome"]
    assert outcome["cast"] == {"reason": plan.reason}
    assert "out of patience" in plan.reason


@pytest.mark.parametrize(
    ("made", "mark"), [(late, "not verified"), (stopped, "not verified"), (lambda: planned(winds=False), "fails")]
)
def test_the_motors_table_says_whether_its_throw_was_verified(tmp_path, made, mark):
    plan = made()
    plan.to_csv(tmp_path / "motion.csv")
    assert f"# {mark}: {plan.reason}\n" in (tmp_path / "motion.csv").read_text()
    assert files.read_notes(tmp_path / "motion.csv")[mark] == plan.reason
    assert hf.read_motion(tmp_path / "motion.csv").breaks[-1] == pytest.approx(plan.motion.breaks[-1], abs=5e-3)


def test_the_motors_table_of_a_throw_that_stands_bears_no_mark(tmp_path):
    planned().to_csv(tmp_path / "motion.csv")
    notes = files.read_notes(tmp_path / "motion.csv")
    assert not {"not verified", "fails"} & set(notes)
    assert notes["target"] == f"x {PEG.x:g} m, y {PEG.y:g} m, radius 0.04 m, mu 0.3"
    assert notes["arm"] == "0.105 m, begins at -1.5708 rad"


def test_an_interrupt_leaves_the_best_throw_that_was_not_verified(tmp_path, monkeypatch):
    """Ctrl-C in the search, and again while its best throw is verified."""

    def swing(self):
        if self.landings:
            raise KeyboardInterrupt
        self.landings.append(Landing(2.0, 2.0, -1, np.zeros(3), WINDS))
        return 1.0

    def check(self, found):
        raise KeyboardInterrupt

    monkeypatch.setattr(Search, "swing", swing)
    monkeypatch.setattr(Search, "try_ends", lambda self: None)
    monkeypatch.setattr(course.Course, "check", check)
    plan = hf.plan_cast(thrower().rope, thrower().arm, PEG)
    assert plan.interrupted
    assert (plan.throw, plan.cast) == (WINDS, None)
    plan.to_csv(tmp_path / "motion.csv")
    assert files.read_notes(tmp_path / "motion.csv")["not verified"] == plan.reason


def test_a_plan_without_a_throw_has_nothing_to_write(tmp_path):
    plan = unreachable()
    for write in (plan.to_csv, plan.to_toml, plan.to_netcdf):
        with pytest.raises(InvalidInput, match="out of reach"):
            write(tmp_path / "x.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_set_up_is_no_plan(tmp_path):
    hf.Setup(thrower().rope).to_toml(tmp_path / "setup.toml")
    with pytest.raises(InvalidInput, match="holds no plan"):
        read_plan(tmp_path / "setup.toml")


def test_a_plan_that_lacks_a_part_is_refused(tmp_path):
    planned().to_toml(tmp_path / "plan.toml")
    text = (tmp_path / "plan.toml").read_text()
    (tmp_path / "plan.toml").write_text(text.replace("[plan.limits]", "[plan.limit]"))
    with pytest.raises(InvalidInput, match="not whole"):
        read_plan(tmp_path / "plan.toml")


def test_what_is_read_back_can_be_printed(tmp_path):
    planned().to_toml(tmp_path / "plan.toml")
    who, peg, motion = read_plan(tmp_path / "plan.toml")
    assert repr(motion) == "Motion(moves, 0 to 8.05965 s, 21 pieces)"
    assert repr(who.rope) == "Rope(50 links, 2 m, 0.125 kg)"
    assert len(repr((who, peg, motion))) < 500
    assert repr(hf.swings(t_move=0.7, t_rest=0.3)).endswith("repeats from 0 s on)")
