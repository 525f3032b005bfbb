"""A motion streamed to a drive by a separate process: the messages, and torque off at every end."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import DriveError, InvalidInput
from hyperflex.execution import record_test_motion
from hyperflex.execution.stream import MotionStream
from hyperflex.hardware import Drive
from hyperflex.motion import move_arm
from tests.execution.ideal_link import IdealLink, ideal_drive
from tests.refusals import fails


def lines(notes: Path) -> list[str]:
    """Return the log of the drive."""
    return notes.read_text().split()


def wait(stream: MotionStream) -> None:
    """Wait for two seconds, or until the stream raises what ended it."""
    for _ in range(100):
        time.sleep(0.02)
        stream.raise_if_ended()


def test_goals_are_those_of_the_motion_at_the_time_of_sending(tmp_path: Path) -> None:
    motion = move_arm(0.3, 0.8, duration=0.6)
    torque = np.array([0.0, 0.2, 0.5]), np.array([0.0, 0.1, 0.0])
    with MotionStream(partial(ideal_drive, tmp_path / "notes"), rate=200.0) as stream:
        stream.enable()
        stream.start_clock(time.monotonic() + 0.1)
        stream.set_motion(motion, 0.0, torque)
        time.sleep(1.0)
        log = stream.log()
        assert stream.angle(10.0) == pytest.approx(0.8)
    sent = log.column("sent")
    assert sent[0] < 0.0
    late = sent >= 0.0
    assert log.column("goal_angle")[late] == pytest.approx(motion.angle(sent[late]), abs=1e-12)
    assert log.column("goal_rate")[late] == pytest.approx(motion.rate(sent[late]), abs=1e-12)
    assert log.column("goal_torque")[late] == pytest.approx(np.interp(sent[late], *torque), abs=1e-12)
    assert np.all(log.tracking_error[late] == 0.0)
    assert lines(tmp_path / "notes") == ["open", "on", "off", "closed"]


def test_a_motion_that_replaces_another_begins_at_its_time(tmp_path: Path) -> None:
    with MotionStream(partial(ideal_drive, tmp_path / "notes"), rate=200.0) as stream:
        stream.enable()
        stream.start_clock(time.monotonic() + 0.1)
        stream.set_motion(move_arm(0.3, 0.6, duration=0.4), 0.0)
        stream.set_motion(move_arm(0.6, 0.4, duration=0.4).shifted(0.5), 0.45)
        time.sleep(1.1)
        log = stream.log()
    sent, goal = log.column("sent"), log.column("goal_angle")
    assert goal[np.searchsorted(sent, 0.45)] == pytest.approx(0.6)
    assert goal[-1] == pytest.approx(0.4)


def test_a_fault_switches_the_torque_off_and_is_raised(tmp_path: Path) -> None:
    with MotionStream(partial(ideal_drive, tmp_path / "notes", fault_after=40)) as stream:
        stream.enable()
        fails(DriveError, "over-temperature", wait, stream)
    assert "off" in lines(tmp_path / "notes")


def test_a_link_that_never_confirms_is_an_error_at_the_end_as_well(tmp_path: Path) -> None:
    stream = MotionStream(partial(ideal_drive, tmp_path / "notes", silent_after=40)).__enter__()
    stream.enable()
    fails(DriveError, "no valid reply", wait, stream)
    fails(DriveError, "did not confirm that its torque is off", stream.__exit__)


def test_the_torque_goes_off_after_the_motion_if_the_program_hangs(tmp_path: Path) -> None:
    with MotionStream(partial(ideal_drive, tmp_path / "notes"), patience=0.2) as stream:
        stream.enable()
        stream.start_clock()
        stream.set_motion(move_arm(0.3, 0.4, duration=0.6), stream.now)
        for _ in range(25):
            time.sleep(0.02)
            stream.raise_if_ended()
        assert lines(tmp_path / "notes") == ["open", "on"]
        time.sleep(1.0)
        fails(DriveError, "silent since its motion was over", stream.raise_if_ended)
    assert lines(tmp_path / "notes") == ["open", "on", "off", "closed"]
    log = stream.log()
    assert log.column("goal_angle")[-1] == pytest.approx(0.4)


def test_a_stop_while_the_process_ends_tells_what_the_device_has_confirmed(tmp_path: Path) -> None:
    stream = MotionStream(partial(ideal_drive, tmp_path / "notes", stuck=True)).__enter__()
    stream.enable()
    with ThreadPoolExecutor(1) as pool:
        ending = pool.submit(stream.__exit__)
        assert not stream.stop()
        fails(DriveError, "did not confirm", ending.result)
    assert not stream.stop()


class SlowDrive(Drive):
    """A drive whose process does not end at once when its torque is off."""

    def close(self) -> None:
        super().close()
        time.sleep(0.5)


def slow_drive(notes: Path) -> Drive:
    """Return one over an ideal link."""
    return SlowDrive(IdealLink(notes), hf.MotorLimits())


def test_many_stops_are_as_good_as_one(tmp_path: Path) -> None:
    with MotionStream(partial(slow_drive, tmp_path / "notes")) as stream:
        stream.enable()
        with ThreadPoolExecutor(4) as pool:
            stops = [pool.submit(stream.stop)]
            while "closed" not in lines(tmp_path / "notes"):
                time.sleep(1e-3)
            stops += [pool.submit(stream.stop) for _ in range(3)]
            assert all(each.result() for each in stops)


def test_a_motion_that_comes_too_late_is_not_jumped_to(tmp_path: Path) -> None:
    with MotionStream(partial(ideal_drive, tmp_path / "notes")) as stream:
        stream.enable()
        stream.start_clock(time.monotonic() + 0.1)
        motion = move_arm(0.3, 0.8, duration=0.6)
        assert stream.set_motion(motion, 0.0)
        time.sleep(0.5)
        assert not stream.set_motion(move_arm(0.3, 0.8, duration=0.5), 0.0)
        time.sleep(0.5)
        assert stream.late == 1
        assert stream.motion == motion
        assert stream.log().column("goal_angle")[-1] == pytest.approx(0.8)


PROGRAM = """
import os, signal, sys, time
from functools import partial
from pathlib import Path
from hyperflex.execution.stream import MotionStream
from tests.execution.ideal_link import ideal_drive

if __name__ == "__main__":
    with MotionStream(partial(ideal_drive, Path(sys.argv[1]))) as stream:
        stream.enable()
        print(stream.pid, flush=True)
        time.sleep(60.0)
"""


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT, pytest.param(signal.SIGQUIT, marks=pytest.mark.nightly)]
)
def test_the_torque_is_off_when_the_program_ends_by_a_signal(tmp_path: Path, number: signal.Signals) -> None:
    """Those that are typed at a terminal go to all processes of the program."""
    program, notes = tmp_path / "program.py", tmp_path / "notes"
    program.write_text(PROGRAM)
    root = Path(__file__).parents[2]
    path = os.pathsep.join([str(root), *filter(None, sys.path)])
    with subprocess.Popen(
        [sys.executable, str(program), str(notes)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": path},
        start_new_session=True,
    ) as run:
        assert run.stdout is not None
        run.stdout.readline()
        (os.killpg if number in (signal.SIGINT, signal.SIGQUIT) else os.kill)(run.pid, number)
        run.wait(20.0)
    until = time.monotonic() + 5.0
    while lines(notes)[-1] != "closed" and time.monotonic() < until:
        time.sleep(0.02)
    assert lines(notes) == ["open", "on", "off", "closed"]


def test_the_process_ended_by_sigterm_switches_the_torque_off(tmp_path: Path) -> None:
    with MotionStream(partial(ideal_drive, tmp_path / "notes")) as stream:
        stream.enable()
        os.kill(stream.pid, signal.SIGTERM)
        fails(DriveError, "ended by a signal", wait, stream)
    assert lines(tmp_path / "notes") == ["open", "on", "off", "closed"]


def test_a_test_motion_is_recorded_and_the_torque_is_off_after_it(tmp_path: Path) -> None:
    motion = hf.arm_moves([0.3, 0.6, 0.3], [0.1, 0.1], [0.5, 0.5])
    record = record_test_motion(partial(ideal_drive, tmp_path / "notes"), motion)
    np.testing.assert_array_equal(record.angle, record.goal)
    assert np.ptp(record.goal) == pytest.approx(0.3, abs=1e-3)
    assert record.sent[-1] > motion.breaks[-1]
    assert lines(tmp_path / "notes") == ["open", "on", "off", "closed"]


def test_a_process_that_was_killed_is_named_before_the_advice(tmp_path: Path) -> None:
    stream = MotionStream(partial(ideal_drive, tmp_path / "notes")).__enter__()
    os.kill(stream.pid, signal.SIGKILL)
    with pytest.raises(DriveError) as killed:
        wait(stream)
    with pytest.raises(
        DriveError, match=r"signal 9\. The drive did not confirm that its torque is off\. Cut its power\."
    ):
        stream.__exit__(DriveError, killed.value)


def test_a_test_motion_from_a_wrong_zero_names_the_turns(tmp_path: Path) -> None:
    connect = partial(ideal_drive, tmp_path / "notes", angle=-6.28)
    fails(DriveError, "1 turn away: its counter may have wrapped", record_test_motion, connect)
    assert lines(tmp_path / "notes") == ["open", "closed"]


def test_a_test_motion_beyond_the_limits_moves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="beyond the limits"):
        record_test_motion(partial(ideal_drive, tmp_path / "notes"), move_arm(0.3, 2.0, duration=0.1))
    assert lines(tmp_path / "notes") == ["open", "closed"]


def test_a_test_motion_waits_for_a_busy_computer(tmp_path: Path) -> None:
    motion = hf.arm_moves([0.3, 0.6, 0.3], [0.1, 0.1], [0.5, 0.5])
    record = record_test_motion(partial(ideal_drive, tmp_path / "notes", pauses=120), motion)
    assert np.diff(record.sent).max() >= 0.2
    assert np.abs(np.diff(record.goal)).max() < 0.05  # of 0.2 s it would be at least 0.1
    assert record.goal[-1] == pytest.approx(0.3)


def test_replies_that_are_lost_are_gaps_of_the_record(tmp_path: Path) -> None:
    motion = hf.arm_moves([0.3, 0.6, 0.3], [0.1, 0.1], [0.5, 0.5])
    record = record_test_motion(partial(ideal_drive, tmp_path / "notes", loses=7), motion)
    lost = np.isnan(record.angle)
    assert 0.05 < lost.mean() < 0.25
    np.testing.assert_array_equal(record.angle[~lost], record.goal[~lost])
