"""A planned whip as files: the motor's table, the set-up that is simulated again, what is read back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import InvalidInput
from hyperflex.planning import read_whip
from hyperflex.planning.whip.outcome import lash
from tests.planning.known import planned
from tests.planning.known_whip import far_whip, planned_whip


def test_a_whip_reads_back_and_strikes_again(tmp_path):
    plan = planned_whip()
    plan.to_toml(tmp_path / "whip.toml")
    who, mark, motion = read_whip(tmp_path / "whip.toml")
    assert who == plan.thrower
    assert (mark, motion) == (plan.mark, plan.motion)
    again = lash(who, mark, motion, plan.lash.t)
    assert again.miss == plan.lash.miss
    told = files.read_toml(tmp_path / "whip.toml")["plan"]["outcome"]
    assert told["source"] == "simulated"
    assert told["lash"]["miss_m"] == plan.lash.miss
    assert told["lash"]["off_rad"] == pytest.approx(0.1)
    assert told["finer"]["links"] == 2 * told["lash"]["links"]


def test_the_set_up_is_simulated_as_it_stands(tmp_path):
    plan = planned_whip()
    plan.to_toml(tmp_path / "whip.toml")
    run = hf.simulate(hf.Setup.from_toml(tmp_path / "whip.toml"))
    assert run.t[-1] == pytest.approx(plan.lash.run.t[-1])
    at = np.array([np.interp(plan.lash.t, run.t, run.tip[:, k]) for k in (0, 1)])
    # Straight between samples of 10 ms at 1.3 m/s, curved over some 0.3 m: 1e-4 m; the default tolerance is less.
    np.testing.assert_allclose(at, plan.lash.place, atol=5e-4)


def test_the_motors_table_holds_the_planned_angles(tmp_path):
    plan = planned_whip()
    plan.to_csv(tmp_path / "motion.csv", rate=250.0)
    names, rows = files.read_table(tmp_path / "motion.csv")
    assert names == ["t", "angle"]
    np.testing.assert_array_equal(rows[:, 1], plan.motion.angle(rows[:, 0]))


def test_the_motors_table_says_that_a_whip_does_not_stand(tmp_path):
    for plan, noted in ((planned_whip(), None), (planned_whip(meets=False), planned_whip(meets=False).reason)):
        plan.to_csv(tmp_path / "motion.csv")
        assert files.read_notes(tmp_path / "motion.csv").get("fails") == noted
    missed = replace(planned_whip(meets=False), lash=None)
    missed.to_csv(tmp_path / "motion.csv")
    assert files.read_notes(tmp_path / "motion.csv")["not verified"] == missed.reason


def test_what_is_no_whip_is_refused(tmp_path):
    for write in (far_whip().to_toml, far_whip().to_csv, far_whip().to_netcdf):
        with pytest.raises(InvalidInput, match="the plan holds no"):
            write(tmp_path / "whip.toml")
    planned(winds=False).to_toml(tmp_path / "cast.toml")
    with pytest.raises(InvalidInput, match="no planned whip"):
        read_whip(tmp_path / "cast.toml")
    planned_whip().to_toml(tmp_path / "whip.toml")
    text = (tmp_path / "whip.toml").read_text().replace("direction = ", "way = ")
    (tmp_path / "whip.toml").write_text(text)
    with pytest.raises(InvalidInput, match="not whole"):
        read_whip(tmp_path / "whip.toml")
