"""A planned cast carried out on a drive: its phases, its verdict, and what stops it."""

import json
import math
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

import hyperflex as hf
from hyperflex import execution
from hyperflex.checks import Array
from hyperflex.control import TrueState
from hyperflex.errors import DriveError, EstimatorLost, Interrupted, InvalidInput
from hyperflex.execution import MotionStream, RunOptions, observed_turns, run_plan
from hyperflex.interfaces import RopeState
from hyperflex.motion import Motion
from hyperflex.planning import CastPlan, FollowOptions, Moves, WindCriteria, check_feasibility, scaled_rope
from tests.execution.ideal_link import ideal_drive

ROPE = hf.Rope.uniform(length=0.8, mass=0.05, n_links=10, radius=0.0025, friction=1e-3)
QUICK = RunOptions(wait=0.1, countdown=0.0, approach=1.0, calm=0.0)


def short_plan() -> CastPlan:
    """Return a plan of one stroke, which does not wind."""
    criteria = WindCriteria(settle=0.1, watch=0.2)
    problem = hf.Problem(ROPE, hf.Arm(length=0.1), hf.MotorLimits(), criteria=criteria)
    peg = hf.Peg(0.3, -0.5, 0.03)
    moves = Moves(side=1, ends=np.array([0.8, 1.2]), rests=np.array([0.1, 0.1]))
    return CastPlan(problem, peg, check_feasibility(problem, peg), moves)


class SeenRope:
    """A simulated rope under the motion that was commanded; before the cast it may swing, or stand `away`, rad.

    In the cast it is seen until `seen`, s; if that is negative, not before it either. Then `lost` is called. `told` are
    the motions that it was given.
    """

    contact = True

    def __init__(
        self,
        plan: CastPlan,
        swings: float = 0.0,
        seen: float = 1e9,
        *,
        away: float = 0.0,
        rate: float = 0.0,
        lost: Callable[[], object] = lambda: None,
    ) -> None:
        self.plan, self.swings, self.seen, self.away, self.rate, self.lost = plan, swings, seen, away, rate, lost
        self.told: list[Motion] = []
        self.rope, self.cast = ROPE, False
        self.given: list[RopeState] = []

    def start_clock(self, at: float | None = None) -> None:
        self.cast = at is not None
        self.true = TrueState(ROPE, self.plan.problem.arm)

    def state(self, t: float, motion: Motion) -> RopeState:
        n = ROPE.n_links
        self.told.append(motion)
        if t > self.seen and (self.cast or self.seen < 0.0):
            self.lost()
            raise EstimatorLost("No marker has been seen for 0.30 s.")
        if not self.cast:
            turns = 2.0 * np.pi * np.arange(n)  # which a picture does not show
            swung = self.swings * math.sin(6.0 * t)
            return RopeState(t, self.away + swung + turns, np.full(n, self.rate))
        self.given.append(self.true.state(max(t, 0.0), self.plan.required(self.plan.motion, "motion")))
        return self.given[-1]

    def turns(self, arm_angle: Callable[[Array], Array], peg: hf.Peg, side: int, rope: hf.Rope) -> tuple[Array, Array]:
        t = np.array([each.t for each in self.given])
        rows = zip(self.given, arm_angle(t).tolist(), strict=True)
        turns = [observed_turns(ROPE, self.plan.problem.arm, state, angle, peg) for state, angle in rows]
        return t, np.transpose([turns, turns])


def test_a_run_brings_the_arm_to_its_start_and_follows_the_motion(tmp_path: Path) -> None:
    plan, said = short_plan(), list[str]()
    run = run_plan(
        plan, partial(ideal_drive, tmp_path / "notes"), source=SeenRope(plan), options=QUICK, say=said.append
    )
    motion = plan.required(plan.motion, "motion")
    sent = run.log.column("sent")
    cast = sent >= 0.0
    assert run.log.column("goal_angle")[cast] == pytest.approx(motion.angle(sent[cast]), abs=1e-9)
    assert run.log.column("angle")[0] == pytest.approx(0.3, abs=1e-3)  # where the arm was found
    assert any("slowly from 0.30" in each for each in said)
    assert run.wound is False
    assert run.judged_by == "state"
    assert "not wound" in run.message
    assert run.left_plan is None  # the simulated rope is the plan's
    run.to_netcdf(tmp_path / "run.nc")
    assert (tmp_path / "notes").read_text().split() == ["open", "on", "off", "closed"]


def test_a_rope_that_swings_is_not_cast(tmp_path: Path) -> None:
    plan = short_plan()
    waits = replace(QUICK, wait=0.6)
    with pytest.raises(InvalidInput, match="still swings"):
        run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=SeenRope(plan, swings=0.1), options=waits)
    assert (tmp_path / "notes").read_text().split()[-2:] == ["off", "closed"]


def test_estimated_rates_alone_do_not_make_a_rope_swing(tmp_path: Path) -> None:
    plan = short_plan()
    run = run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=SeenRope(plan, rate=0.3), options=QUICK)
    assert len(run.log.rows) > 0


def test_a_rope_that_is_still_wound_is_not_pulled(tmp_path: Path) -> None:
    plan = short_plan()
    with pytest.raises(InvalidInput, match="does not hang down"):
        run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=SeenRope(plan, away=1.0), options=QUICK)
    assert (tmp_path / "notes").read_text().split() == ["open", "closed"]


def test_the_user_is_asked_after_the_drive_was_read_and_before_its_torque_is_on(tmp_path: Path) -> None:
    said = list[str]()

    def ask() -> None:
        said.extend((tmp_path / "notes").read_text().split())
        raise InvalidInput("no")

    with pytest.raises(InvalidInput, match="no"):
        run_plan(short_plan(), partial(ideal_drive, tmp_path / "notes"), options=QUICK, say=said.append, ready=ask)
    assert "without torque the arm is at 0.30" in said[-2]
    assert said[-1] == "open"


def test_an_arm_that_is_held_by_a_torque_of_the_wrong_sign_is_not_cast(tmp_path: Path) -> None:
    drive = partial(ideal_drive, tmp_path / "notes", holds=-0.05)
    with pytest.raises(InvalidInput, match="torque of the wrong sign"):
        run_plan(short_plan(), drive, options=QUICK)
    assert (tmp_path / "notes").read_text().split()[-2:] == ["off", "closed"]


@pytest.mark.parametrize("holds", [0.0, 0.4, 1.0])
def test_an_arm_whose_weight_is_not_as_expected_is_reported(tmp_path: Path, holds: float) -> None:
    """0.049 N m at a quarter turn; `holds` in parts of what holds arm and rope at the start."""
    plan, said = short_plan(), list[str]()
    start = float(plan.required(plan.motion, "motion").angle(0.0))
    drive = partial(ideal_drive, tmp_path / "notes", holds=holds * 0.05 * 9.80665 * 0.1 * math.sin(start))
    run_plan(plan, drive, source=SeenRope(plan), options=QUICK, doubt=said.append)
    assert any("without torque the arm is at 0.30" in each for each in said)
    assert any("Check zero, rope and arm" in each for each in said) == (holds < 1.0)


@pytest.mark.parametrize(
    ("link", "message"),
    [({"short": 0.08}, "not at its start at"), ({"angle": -1.7}, "the way to the start is more than half a turn")],
)
def test_an_arm_that_does_not_come_to_its_start_is_not_cast(
    tmp_path: Path, link: dict[str, float], message: str
) -> None:
    with pytest.raises((DriveError, InvalidInput), match=message):
        run_plan(short_plan(), partial(ideal_drive, tmp_path / "notes", **link), options=QUICK)
    assert (tmp_path / "notes").read_text().split() == ["open", "on", "off", "closed"]


def test_a_fault_in_the_middle_ends_the_run_and_reports_it(tmp_path: Path) -> None:
    plan = short_plan()
    drive = partial(ideal_drive, tmp_path / "notes", fault_after=450)
    run = run_plan(plan, drive, source=SeenRope(plan), options=QUICK)
    assert "over-temperature" in run.message
    assert not run.success
    assert run.log.rows.size


def test_an_off_that_is_not_confirmed_keeps_the_log(tmp_path: Path) -> None:
    plan = short_plan()
    drive = partial(ideal_drive, tmp_path / "notes", stuck=True)
    run = run_plan(plan, drive, source=SeenRope(plan), options=QUICK)
    assert "The drive did not confirm that its torque is off." in run.message
    assert run.message.endswith("Cut its power.")
    assert (run.success, run.status) == (False, "failed")
    assert run.log.column("sent")[-1] > plan.required(plan.motion, "motion").breaks[-1]
    assert run.recording is not None


def test_the_logs_of_drive_and_rope_are_one_mcap_file(tmp_path: Path) -> None:
    plan = short_plan()
    run = run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=SeenRope(plan), options=QUICK)
    run.to_mcap(tmp_path / "run.mcap")
    rope = hf.read_recording(tmp_path / "run.mcap")
    np.testing.assert_array_equal(rope.data, run.recording.data)
    with (tmp_path / "run.mcap").open("rb") as stream:
        found = [(m.log_time, json.loads(m.data)) for _, _, m in make_reader(stream).iter_messages(["/drive"])]
    for name in ("goal_angle", "angle", "received"):
        np.testing.assert_array_equal([each[name] for _, each in found], run.log.column(name))
    assert [each["t"] for _, each in found] == run.log.column("sent").tolist()
    assert found[0][0] == 0  # the arm went to its start before t = 0 of the cast
    replace(run, recording=None).to_mcap(tmp_path / "alone.mcap")


@pytest.mark.parametrize("follow", [None, FollowOptions(decision_time=0.05)])
def test_a_camera_that_is_lost_in_the_middle_stops_the_run_with_one_line(
    tmp_path: Path, follow: FollowOptions | None
) -> None:
    plan = short_plan()
    drive = partial(ideal_drive, tmp_path / "notes")
    run = run_plan(plan, drive, source=SeenRope(plan, seen=0.1), follow=follow, options=QUICK)
    assert run.message == "No marker has been seen for 0.30 s."
    assert not run.success
    assert np.abs(run.log.column("goal_torque")).max() > 1e-3  # N m; of the plan, in closed loop as well
    assert (tmp_path / "notes").read_text().split()[-2:] == ["off", "closed"]


def test_a_source_that_hangs_stops_the_run(tmp_path: Path) -> None:
    plan, woken = short_plan(), threading.Event()
    source = SeenRope(plan, seen=0.1, lost=lambda: woken.wait(60.0))
    run = run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=source, options=QUICK)
    woken.set()
    assert run.stopped == "The source of the rope's state has not answered for 0.3 s."


class HangsOnce(SeenRope):
    """A source that hangs when the closed loop reads it."""

    def __init__(self, plan: CastPlan) -> None:
        super().__init__(plan)
        self.woken = threading.Event()

    def state(self, t: float, motion: Motion) -> RopeState:
        if self.cast and threading.current_thread().name != "rope recorder":
            self.woken.wait(60.0)
        return super().state(t, motion)


@pytest.mark.parametrize(
    ("asks", "message"),
    [
        (True, "The source of the rope's state has not answered for 0.3 s."),
        (False, "The closed loop has not decided by the end of the motion: its source may hang."),
    ],
)
def test_a_closed_loop_that_hangs_stops_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asks: bool, message: str
) -> None:
    plan = short_plan()
    source = HangsOnce(plan)
    begun, made = threading.Event(), plan.required(plan.motion, "motion")

    def follow(_: object, watch: Any, **__: object) -> None:
        begun.set()
        if asks:
            watch.state(0.1, made)
        source.woken.wait(60.0)

    monkeypatch.setattr(execution.run, "follow_plan", follow)
    drive = partial(ideal_drive, tmp_path / "notes")
    run = run_plan(plan, drive, source=source, follow=FollowOptions(), options=QUICK)
    source.woken.set()
    assert begun.is_set()
    assert run.stopped == message
    assert bool(run.log.column("sent")[-1] < made.breaks[-1]) is asks
    assert (tmp_path / "notes").read_text().split()[-2:] == ["off", "closed"]


def test_a_source_that_fails_in_any_way_stops_the_run_and_reports_why(tmp_path: Path) -> None:
    plan = short_plan()
    source = SeenRope(plan, seen=0.1, lost=lambda: int("nothing"))
    run = run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=source, options=QUICK)
    assert "source of the rope's state failed: ValueError" in run.stopped


class OtherRope(SeenRope):
    """A source that knows no contact, and whose rope has a link less once the cast has begun."""

    contact = False

    def state(self, t: float, motion: Motion) -> RopeState:
        found = super().state(t, motion)
        return RopeState(found.t, found.q[1:], found.qd[1:]) if self.cast and t > 0.0 else found


def test_a_source_of_another_rope_stops_the_run(tmp_path: Path) -> None:
    plan = short_plan()
    run = run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=OtherRope(plan), options=QUICK)
    assert run.stopped.startswith("q has the wrong shape: got (9,)")


def test_the_motion_of_a_run_is_what_was_commanded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = short_plan()
    made = plan.required(plan.motion, "motion")

    def change(*_: object, motor: MotionStream, **__: object) -> None:
        motor.set_motion(made.shifted(0.3), 0.0)
        raise EstimatorLost("gone")

    monkeypatch.setattr(execution.run, "follow_plan", change)
    run = run_plan(
        plan, partial(ideal_drive, tmp_path / "notes"), source=SeenRope(plan), follow=FollowOptions(), options=QUICK
    )
    assert run.stopped == "gone"
    assert run.motion == made.shifted(0.3)


def test_an_interrupt_while_the_run_is_checked_keeps_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = short_plan()
    source = SeenRope(plan)
    judge, calls = source.turns, list[int]()

    def interrupted(*given: Any) -> tuple[Array, Array]:
        calls.append(1)
        if len(calls) == 1:
            signal.raise_signal(signal.SIGINT)
        return judge(*given)

    monkeypatch.setattr(source, "turns", interrupted)
    with pytest.raises(Interrupted) as stop:
        run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=source, options=QUICK)
    assert stop.value.partial.interrupted
    assert len(stop.value.partial.log.rows)


def test_a_camera_that_never_finds_the_rope_moves_nothing(tmp_path: Path) -> None:
    plan = short_plan()
    with pytest.raises(EstimatorLost, match="No marker"):
        run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=SeenRope(plan, seen=-1.0), options=QUICK)
    assert (tmp_path / "notes").read_text().split() == ["open", "closed"]


def test_the_arm_is_known_to_be_late_by_the_lag_and_the_rope_to_be_as_long_as_it_is_seen(tmp_path: Path) -> None:
    plan = short_plan()
    source = SeenRope(plan)
    source.rope = scaled_rope(ROPE, 1.05, 1.0, 1.0)  # as it is seen
    options = replace(QUICK, lag=0.02)
    run = run_plan(plan, partial(ideal_drive, tmp_path / "notes"), source=source, options=options)
    places = run.cast_log().recording.data[0].reshape(-1, 2)  # of what is learned from
    assert places[-1] - places[0] == pytest.approx([0.0, -1.05 * ROPE.total_length], abs=1e-3)
    motion = plan.required(plan.motion, "motion")
    assert source.told[0].angle(0.0) == pytest.approx(0.3)  # while it hangs from an arm without torque
    assert source.told[-1] == motion.shifted(0.02)


def test_without_a_source_and_a_torque_nobody_reports_that_it_wound(tmp_path: Path) -> None:
    run = run_plan(short_plan(), partial(ideal_drive, tmp_path / "notes"), options=QUICK)
    assert not run.success
    assert run.summary()["wound"] in (None, False)


def test_a_motion_beyond_the_drives_limits_moves_nothing(tmp_path: Path) -> None:
    slow = hf.MotorLimits(speed=0.5)
    with pytest.raises(InvalidInput, match=r"fast|speed|rate"):
        run_plan(short_plan(), partial(ideal_drive, tmp_path / "notes", limits=slow), options=QUICK)
    assert not (tmp_path / "notes").exists()
