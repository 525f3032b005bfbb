"""A planned whip as files: the motor's table, the set-up that is simulated again, what is read back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import InvalidInput
from hyperflex.planning import WhipPlan
from hyperflex.planning.plan import to_table
from hyperflex.planning.tasks.tip import sample_times
from hyperflex.planning.tasks.whip import verify_whip
from tests.planning.known_whip import far_whip, planned_whip


@pytest.mark.parametrize(
    "made",
    [
        planned_whip,
        lambda: planned_whip(meets=False),
        lambda: planned_whip(any_direction=True),
        lambda: replace(planned_whip(meets=False), outcome=None, finer_outcome=None, interrupted=True),
    ],
)
def test_a_whip_reads_back_as_it_was_written(tmp_path, made):
    """In all its fields but the runs, and once more in the same file."""
    plan = made()
    plan.to_toml(tmp_path / "whip.toml")
    back = hf.read_plan(tmp_path / "whip.toml")
    assert isinstance(back, WhipPlan)
    assert (back.problem, back.target, back.feasibility) == (plan.problem, plan.target, plan.feasibility)
    assert (back.success, back.status, back.message) == (plan.success, plan.status, plan.message)
    assert back.motion == plan.motion
    assert files.dumps_toml(to_table(back)) == files.dumps_toml(to_table(plan))
    back.to_toml(tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_text() == (tmp_path / "whip.toml").read_text()


def test_a_whip_that_is_read_back_strikes_again(tmp_path):
    plan = planned_whip()
    plan.to_toml(tmp_path / "whip.toml")
    back = hf.read_plan(tmp_path / "whip.toml")
    again = verify_whip(back.problem, back.target, back.motion, plan.outcome.t)
    assert again.miss == plan.outcome.miss == back.outcome.miss
    assert back.outcome.angle_error == pytest.approx(0.1)
    assert back.finer_outcome.n_links == 2 * back.outcome.n_links
    assert back.impact() == plan.impact()


def test_the_set_up_is_simulated_as_it_stands(tmp_path):
    plan = planned_whip()
    plan.to_toml(tmp_path / "whip.toml")
    run = hf.simulate(hf.Setup.from_toml(tmp_path / "whip.toml"))
    assert run.t[-1] == pytest.approx(sample_times(plan.outcome.t)[-1])
    at = np.array([np.interp(plan.outcome.t, run.t, run.tip[:, k]) for k in (0, 1)])
    # Straight between samples of 10 ms at 1.3 m/s, curved over some 0.3 m: 1e-4 m; the default tolerance is less.
    np.testing.assert_allclose(at, plan.outcome.place, atol=5e-4)


def test_the_motors_table_holds_the_planned_angles(tmp_path):
    plan = planned_whip()
    plan.to_csv(tmp_path / "motion.csv", rate=250.0)
    names, rows, *_ = files.read_table(tmp_path / "motion.csv")
    assert names == ["t", "angle"]
    np.testing.assert_array_equal(rows[:, 1], plan.motion.angle(rows[:, 0]))


def test_the_motors_table_says_that_a_whip_does_not_stand(tmp_path):
    for plan, noted in ((planned_whip(), None), (planned_whip(meets=False), planned_whip(meets=False).message)):
        plan.to_csv(tmp_path / "motion.csv")
        assert files.read_table(tmp_path / "motion.csv").notes.get("fails") == noted
    missed = replace(planned_whip(meets=False), outcome=None)
    missed.to_csv(tmp_path / "motion.csv")
    assert files.read_table(tmp_path / "motion.csv").notes["not verified"] == missed.message


def test_what_is_no_whip_is_refused(tmp_path):
    for write in (far_whip().to_toml, far_whip().to_csv, far_whip().to_netcdf):
        with pytest.raises(InvalidInput, match="the plan holds no"):
            write(tmp_path / "whip.toml")
    planned_whip().to_toml(tmp_path / "whip.toml")
    text = (tmp_path / "whip.toml").read_text().replace("direction = ", "way = ")
    (tmp_path / "whip.toml").write_text(text)
    with pytest.raises(InvalidInput, match="not complete"):
        hf.read_plan(tmp_path / "whip.toml")
