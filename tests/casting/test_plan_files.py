"""A plan as files: the motor's table, the set-up that is simulated again, what is read back."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.casting import read_plan
from hyperflex.errors import InvalidInput
from tests.casting.known import PEG, planned, thrower, unreachable


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
