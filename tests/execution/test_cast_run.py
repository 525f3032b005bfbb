"""The verdict of a run, from a log that is given."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.cli.run import _refuse
from hyperflex.execution import CastRun, StreamLog
from hyperflex.execution.cast_run import Prediction
from hyperflex.execution.run import _compare_weight
from hyperflex.execution.stream import FIELDS
from hyperflex.files import read_netcdf
from tests.execution.test_run import short_plan
from tests.refusals import refuses

PLAN = short_plan()
MOTION = PLAN.required(PLAN.motion, "motion")
STOP = float(MOTION.breaks[-1])
END = STOP + 0.3  # of the watch
START, HANGING = PLAN.problem.arm.weight_torque(PLAN.problem.rope, MOTION.angle(np.array([0.0, STOP]))).tolist()


def run(wound: float, held: float = START, scatter: float = 0.0, end: float = HANGING) -> CastRun:
    """Return a run whose wound rope would be held by a torque, N m; it was `held` before, and at its end by `end`."""
    sent = np.arange(-0.5, END + 1.0, 0.005)
    rows = np.zeros((sent.size, len(FIELDS)))
    rows[:, FIELDS.index("sent")] = rows[:, FIELDS.index("received")] = sent
    noise = scatter * (-1.0) ** np.arange(sent.size)
    rows[:, FIELDS.index("torque")] = np.where(sent < 0.0, held, end) + noise
    rows[:, FIELDS.index("angle")] = MOTION.angle(sent)
    t = np.linspace(0.0, END, 200)
    places = np.zeros((t.size, PLAN.problem.rope.n_links + 1, 2))
    places[:, :, 0] = t[:, None]
    return CastRun(PLAN, MOTION, StreamLog(rows, 200.0), Prediction(t, places, np.full(t.size, wound), np.inf, 1))


def test_only_turns_while_the_rope_is_watched_count():
    t = np.array([STOP, STOP + 0.15, END, END + 0.2])
    assert replace(run(0.0), observed=(t, np.array([0.0, 1.6, 1.5, 0.0])[:, None] + [0.0, 0.1])).turns == 1.5


@pytest.mark.parametrize(
    ("turns", "wound", "message"),
    [
        ((1.3, 1.35), True, ""),
        ((0.3, 0.4), False, "the rope is not wound: 0.30 turns of 1.25 (state)"),
        ((0.3, 1.3), None, "not known whether the rope is wound: it shows 0.30 to 1.30 turns of 1.25"),
    ],
)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_rope_is_wound_by_its_likeliest_turns_and_not_if_it_cannot_be(turns, wound, message, side):
    t = STOP + np.linspace(0.12, 0.28, 7)
    seen = side * np.array([[1.9, 2.0]] * 3 + [[math.nan] * 2, turns, turns, [0.1, 0.1]])
    cast = replace(run(0.0, scatter=1.0), observed=(t, seen))
    assert (cast.wound, cast.judged_by) == (wound, "" if wound is None else "state")
    assert cast.message.replace("-", "") == message


@pytest.mark.parametrize(
    ("how", "wound"),
    [
        ({}, False),
        ({"end": HANGING + 0.02}, True),
        ({"scatter": 0.01}, None),
        ({"held": START + 0.03}, None),
        ({"held": np.nan}, None),
    ],
)
def test_a_torque_decides_only_if_it_differs_enough(how, wound):
    assert run(HANGING + 0.02, **how).wound is wound


def test_the_rope_is_compared_with_the_plan_as_late_as_the_drive_is():
    """The predicted joints move by 1 m/s to the right."""
    t = np.linspace(0.5, 1.0, 5)
    recording = hf.Recording(t, np.zeros((5, PLAN.problem.rope.n_links)), "angles")
    seen = [replace(run(0.0), recording=recording, lag=lag).deviation[1][:, 0] for lag in (0.0, 0.1)]
    tips = PLAN.problem.arm.tip(MOTION.angle(t))
    expected = [np.hypot(tips[:, 0] - (t - lag), tips[:, 1]) for lag in (0.0, 0.1)]
    np.testing.assert_allclose(seen, expected, atol=0.02)


def test_a_source_that_knows_no_contact_tells_no_deviation_after_the_strike():
    t = np.linspace(0.0, 1.0, 5)
    recording = hf.Recording(t, np.zeros((5, PLAN.problem.rope.n_links)), "angles")
    cast = replace(run(0.0), recording=recording, lag=0.1)
    cast = replace(cast, prediction=replace(cast.prediction, touch=0.5))
    ends = [replace(cast, contact=contact).deviation[0][-1] for contact in (True, False)]
    assert ends == [1.0, 0.5]


def test_the_log_and_the_figure_say_which_motor_carried_out_which_plan(tmp_path):
    cast = replace(run(0.0), motor="emulator:moteus (simulated motor and rope)")
    cast.to_netcdf(tmp_path / "run.nc")
    notes = read_netcdf(tmp_path / "run.nc").attributes
    assert notes["motor"] == cast.motor
    assert notes["date"].startswith("20")
    assert "target: x 0.3 m, y -0.5 m" in notes["plan"]
    assert cast.plot().axes[0].get_title(loc="left").startswith(cast.motor)


@pytest.mark.parametrize("part", [0.0, 0.4, 1.0])
def test_an_arm_that_is_held_with_another_torque_than_its_weight_is_reported(part):
    said, log = [], run(0.0, held=part * START).log
    _compare_weight(replace(log, rows=log.rows[log.column("sent") < 0.0]), PLAN.problem, said.append)
    assert ["Check zero, rope and arm" in each for each in said] == [True] * (part < 1.0)


def test_an_arm_of_another_length_is_refused_where_nobody_can_judge():
    longer = replace(PLAN.problem, arm=hf.Arm(length=0.3))
    log = run(0.0, held=float(longer.arm.weight_torque(longer.rope, MOTION.angle(0.0)))).log
    before = replace(log, rows=log.rows[log.column("sent") < 0.0])
    refuses("Check zero, rope and arm", _compare_weight, before, PLAN.problem, _refuse)
