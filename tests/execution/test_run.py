"""A planned cast carried out on a drive: its phases, its verdict, and what stops it."""

import json
import math
import re
import signal
import threading
import time
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
from hyperflex.execution import (
    CastRun,
    EmulatedRope,
    MotionStream,
    RunOptions,
    emulator_of,
    observed_turns,
    open_drive,
    run_plan,
)
from hyperflex.interfaces import RopeState
from hyperflex.motion import Motion
from hyperflex.planning import CastPlan, FollowOptions, Moves, WindCriteria, check_feasibility, scaled_rope
from tests.execution.ideal_link import ideal_drive
from tests.refusals import refuses

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


PLAN = short_plan()
MOTION = PLAN.required(PLAN.motion, "motion")
START = float(MOTION.angle(0.0))
CarryOut = Callable[..., CastRun]
SWITCHED_OFF = ["open", "on", "off", "closed"]


@pytest.fixture
def notes(tmp_path: Path) -> Callable[[], list[str]]:
    """What the drive has noted so far."""
    return lambda: (tmp_path / "notes").read_text().split()


@pytest.fixture
def carry_out(tmp_path: Path) -> CarryOut:
    """Carry the plan out on an ideal link at its start; other arguments than those of `run_plan` are the link's."""

    def run(source: SeenRope | None, *, options: RunOptions = QUICK, follow: Any = None, **given: Any) -> CastRun:
        how = {name: given.pop(name) for name in ("say", "doubt", "ready") if name in given}
        drive = partial(ideal_drive, tmp_path / "notes", **{"angle": START, **given})
        return run_plan(PLAN, drive, source=source, options=options, follow=follow, **how)

    return run


def test_a_run_brings_the_arm_to_its_start_and_follows_the_motion(carry_out: CarryOut, notes, tmp_path: Path) -> None:
    said, doubts = list[str](), list[str]()
    holds = float(PLAN.problem.arm.weight_torque(ROPE, START))
    seen = SeenRope(PLAN, rate=0.3)  # estimated rates alone do not make a rope swing
    run = carry_out(seen, say=said.append, doubt=doubts.append, angle=0.3, holds=holds)
    sent = run.log.column("sent")
    cast = sent >= 0.0
    assert run.log.column("goal_angle")[cast] == pytest.approx(MOTION.angle(sent[cast]), abs=1e-9)
    assert run.log.column("angle")[0] == pytest.approx(0.3, abs=1e-3)  # where the arm was found
    assert any("slowly from 0.30" in each for each in said)
    assert [each.partition(":")[0] for each in doubts] == ["without torque the arm is at 0.30 rad"]
    assert run.wound is False
    assert run.judged_by == "state"
    assert "not wound" in run.message
    assert run.left_plan is None  # the simulated rope is the plan's
    run.to_netcdf(tmp_path / "run.nc")
    assert notes() == SWITCHED_OFF
    run.to_mcap(tmp_path / "run.mcap")  # drive and rope in one file
    rope = hf.read_recording(tmp_path / "run.mcap")
    np.testing.assert_array_equal(rope.data, run.recording.data)
    with (tmp_path / "run.mcap").open("rb") as stream:
        found = [(m.log_time, json.loads(m.data)) for _, _, m in make_reader(stream).iter_messages(["/drive"])]
    for name in ("goal_angle", "angle", "received"):
        np.testing.assert_array_equal([each[name] for _, each in found], run.log.column(name))
    assert [each["t"] for _, each in found] == sent.tolist()
    assert found[0][0] == 0  # the arm went to its start before t = 0 of the cast
    replace(run, recording=None).to_mcap(tmp_path / "alone.mcap")


@pytest.mark.parametrize(
    ("rope", "link", "message", "done"),
    [
        ({"swings": 0.1}, {"options": replace(QUICK, wait=0.6)}, "still swings", SWITCHED_OFF),
        ({"away": 1.0}, {}, "does not hang down", ["open", "closed"]),  # still wound
        ({"seen": -1.0}, {}, "No marker", ["open", "closed"]),
        (None, {"holds": -0.05}, "torque of the wrong sign", SWITCHED_OFF),
        (None, {"angle": 0.3, "short": 0.08}, "not at its start at", SWITCHED_OFF),
        (None, {"angle": -1.7}, "the way to the start is more than half a turn", SWITCHED_OFF),
    ],
)
def test_what_is_not_cast(carry_out: CarryOut, notes, rope, link, message: str, done: list[str]) -> None:
    """A rope that swings, does not hang down or is not seen; an arm held the wrong way or not where it should be."""
    with pytest.raises((DriveError, EstimatorLost, InvalidInput), match=message):
        carry_out(None if rope is None else SeenRope(PLAN, **rope), **link)
    assert notes() == done


def test_a_motion_beyond_the_drives_limits_moves_nothing(carry_out: CarryOut, tmp_path: Path) -> None:
    refuses(r"fast|speed|rate", carry_out, None, limits=hf.MotorLimits(speed=0.5))
    assert not (tmp_path / "notes").exists()


def test_the_user_is_asked_after_the_drive_was_read_and_before_its_torque_is_on(carry_out: CarryOut, notes) -> None:
    said = list[str]()

    def ask() -> None:
        said.extend(notes())
        raise InvalidInput("no")

    refuses("no", carry_out, None, angle=0.3, say=said.append, ready=ask)
    assert "without torque the arm is at 0.30" in said[-2]
    assert said[-1] == "open"


class OtherRope(SeenRope):
    """A source that knows no contact, and whose rope has a link less once the cast has begun."""

    contact = False

    def state(self, t: float, motion: Motion) -> RopeState:
        found = super().state(t, motion)
        return RopeState(found.t, found.q[1:], found.qd[1:]) if self.cast and t > 0.0 else found


class HangsOnce(SeenRope):
    """A source that hangs when the closed loop reads it."""

    def __init__(self, plan: CastPlan) -> None:
        super().__init__(plan)
        self.woken = threading.Event()

    def state(self, t: float, motion: Motion) -> RopeState:
        if self.cast and threading.current_thread().name != "rope recorder":
            self.woken.wait(60.0)
        return super().state(t, motion)


def hangs() -> None:
    """As long as the run takes."""
    time.sleep(1.0)


@pytest.mark.parametrize(
    ("source", "follow", "message"),
    [
        (lambda: SeenRope(PLAN, seen=0.1), None, r"No marker has been seen for 0.30 s\.$"),
        (lambda: SeenRope(PLAN, seen=0.1), FollowOptions(decision_time=0.05), r"No marker has been seen for 0.30 s\.$"),
        (
            lambda: SeenRope(PLAN, seen=0.1, lost=hangs),
            None,
            "The source of the rope's state has not answered for 0.3 s.",
        ),
        (
            lambda: SeenRope(PLAN, seen=0.1, lost=lambda: int("x")),
            None,
            "source of the rope's state failed: ValueError",
        ),
        (lambda: OtherRope(PLAN), None, r"q has the wrong shape: got \(9,\)"),
    ],
    ids=["lost", "lost by the closed loop", "hangs", "fails", "of another rope"],
)
def test_a_source_that_gives_no_state_stops_the_run(carry_out: CarryOut, notes, source, follow, message: str) -> None:
    run = carry_out(source(), follow=follow)
    assert re.search(message, run.stopped)
    assert run.message == run.stopped
    assert not run.success
    assert np.abs(run.log.column("goal_torque")).max() > 1e-3  # N m; of the plan, in closed loop as well
    assert notes() == SWITCHED_OFF


@pytest.mark.parametrize(
    ("asks", "message"),
    [
        (True, "The source of the rope's state has not answered for 0.3 s."),
        (False, "The closed loop has not decided by the end of the motion: its source may hang."),
    ],
)
def test_a_closed_loop_that_hangs_stops_the_run(
    carry_out: CarryOut, notes, monkeypatch: pytest.MonkeyPatch, asks: bool, message: str
) -> None:
    source, begun = HangsOnce(PLAN), threading.Event()

    def follow(_: object, watch: Any, **__: object) -> None:
        begun.set()
        if asks:
            watch.state(0.1, MOTION)
        source.woken.wait(60.0)

    monkeypatch.setattr(execution.run, "follow_plan", follow)
    run = carry_out(source, follow=FollowOptions())
    source.woken.set()
    assert begun.is_set()
    assert run.stopped == message
    assert bool(run.log.column("sent")[-1] < MOTION.breaks[-1]) is asks
    assert notes() == SWITCHED_OFF


def test_an_off_that_is_not_confirmed_keeps_the_log(carry_out: CarryOut) -> None:
    run = carry_out(SeenRope(PLAN), stuck=True)
    assert "The drive did not confirm that its torque is off." in run.message
    assert run.message.endswith("Cut its power.")
    assert (run.success, run.status) == (False, "failed")
    assert run.log.column("sent")[-1] > MOTION.breaks[-1]
    assert run.recording is not None


def test_the_motion_of_a_run_is_what_was_commanded(carry_out: CarryOut, monkeypatch: pytest.MonkeyPatch) -> None:
    def change(*_: object, motor: MotionStream, **__: object) -> None:
        motor.set_motion(MOTION.shifted(0.3), 0.0)
        raise EstimatorLost("gone")

    monkeypatch.setattr(execution.run, "follow_plan", change)
    run = carry_out(SeenRope(PLAN), follow=FollowOptions())
    assert run.stopped == "gone"
    assert run.motion == MOTION.shifted(0.3)


def test_an_interrupt_while_the_run_is_checked_keeps_it(carry_out: CarryOut, monkeypatch: pytest.MonkeyPatch) -> None:
    source = SeenRope(PLAN)
    judge, calls = source.turns, list[int]()

    def interrupted(*given: Any) -> tuple[Array, Array]:
        calls.append(1)
        if len(calls) == 1:
            signal.raise_signal(signal.SIGINT)
        return judge(*given)

    monkeypatch.setattr(source, "turns", interrupted)
    with pytest.raises(Interrupted) as stop:
        carry_out(source)
    assert stop.value.partial.interrupted
    assert len(stop.value.partial.log.rows)


def test_the_arm_is_known_to_be_late_by_the_lag_and_the_rope_to_be_as_long_as_it_is_seen(carry_out: CarryOut) -> None:
    source = SeenRope(PLAN)
    source.rope = scaled_rope(ROPE, 1.05, 1.0, 1.0)  # as it is seen
    run = carry_out(source, options=replace(QUICK, lag=0.02), angle=0.3)
    places = run.cast_log().recording.data[0].reshape(-1, 2)  # of what is learned from
    assert places[-1] - places[0] == pytest.approx([0.0, -1.05 * (ROPE.total_length - ROPE.length[0])], abs=1e-3)
    assert source.told[0].angle(0.0) == pytest.approx(0.3)  # while it hangs from an arm without torque
    assert source.told[-1] == MOTION.shifted(0.02)


def test_without_a_source_and_a_torque_nobody_reports_that_it_wound(carry_out: CarryOut) -> None:
    doubts = list[str]()
    run = carry_out(None, doubt=doubts.append)
    assert any("Check zero, rope and arm" in each for each in doubts)  # it is held without torque
    assert not run.success
    assert run.summary()["wound"] in (None, False)


def test_a_run_on_an_emulated_drive_sees_the_emulated_rope() -> None:
    rope = PLAN.setup().rope  # shorter links near the peg
    make, emulator = emulator_of(PLAN, "emulator:moteus", rope=rope)
    with emulator:
        source = EmulatedRope(emulator, ROPE, rope, PLAN.problem.arm)
        connect = partial(open_drive, f"{make}:{emulator.port}", PLAN.problem.limits)
        run = run_plan(PLAN, connect, source=source, options=replace(QUICK, wait=20.0, still=0.5))
        assert run.judged_by == "state" or emulator.unfair, run.message
        assert np.nanmax(np.abs(run.log.tracking_error)) < 0.3 or emulator.unfair
        assert np.ptp(run.recording.data) > 0.2 or emulator.unfair
