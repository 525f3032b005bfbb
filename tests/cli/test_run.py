"""``hyperflex run`` against emulated drives, and its refusals."""

import io
import signal
import threading
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

import pytest

from hyperflex import execution
from hyperflex.cli import output
from hyperflex.execution import Attempt, LearningResult
from hyperflex.execution.cast_run import Prediction
from hyperflex.hardware import Drive, DriveFit, DriveModel, DriveZero
from hyperflex.planning import read_plan, scaled_rope
from tests.execution.ideal_link import open_ideal
from tests.planning.known import planned
from tests.planning.known_whip import planned_whip


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "cast.toml"
    planned().to_toml(path)
    return path


def test_a_dry_run_connects_nothing_and_tells_speed_torque_and_duration(hyperflex_json, plan, tmp_path):
    how = "--motor", "moteus:/dev/none", "-o", tmp_path / "done", "--dry-run"
    code, result = hyperflex_json("run", plan, *how)
    assert (code, result["dry_run"], (tmp_path / "done").exists()) == (0, True, False)
    motion = planned().motion
    assert result["peak_speed"] == pytest.approx(planned().problem.limits.speed, rel=1e-3)
    assert (result["duration"], result["torque"]) == pytest.approx((motion.breaks[-1], planned().torque))


DRY = "--dry-run", "--motor"
EMULATED = (*DRY, "emulator:moteus")
NONE = "--motor", "moteus:/dev/none"
REAL = (*NONE, "--zero", "zero.toml")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((*DRY, "emulator:moteus?foo=1"), "foo"),
        ((*EMULATED, "--zero", "none.toml"), "none.toml"),
        ((*EMULATED, "--camera", "emulated", "--calibration", "none.toml"), "none.toml"),
        ((*EMULATED, "--camera", "emulated", "--arc-lengths", "x"), "--arc-lengths"),
        ((*EMULATED, "--camera", "emulated", "--arc-lengths", "0.2,9"), "not all on the rope"),
        ((*EMULATED, "--page", "99999"), "99999"),
        ((*EMULATED, "--click", "3,4"), "--click is of a camera"),
        ((*EMULATED, "--torque", 0.1), "the plan's torque is beyond the limit"),
        (NONE, "needs its zero"),
        (("--motor", "emulator:moteus", "--camera", "0"), "does not see the rope of an emulated motor"),
        ((*NONE, "--camera", "emulated"), "does not see the rope of a real motor"),
        ((*NONE, "--camera", "0"), "no --calibration, --arc-lengths"),
        (REAL, "a real motor moves with a limit of torque only"),
        ((*REAL, "--motor", "moteus:/dev/none?watchdog=0.5"), "watchdog of a real motor is too long"),
        ((*REAL, "--torque", 1, "--learn"), "which --learn must know"),
        ((*REAL, "--torque", 1, "--follow"), "which --follow must know"),
        ((*REAL, "--torque", 1, "--repeat", 2, "--yes"), "which --yes and --repeat must know"),
        ((*REAL, "--learn", "--follow"), "a learned motion is not followed"),
        ((*REAL, "--learn", "--repeat", 2), "--repeat 3 or more"),
    ],
)
def test_what_cannot_run_is_refused_in_one_line(refused, plan, tmp_path, monkeypatch, options, message):
    """A dry run refuses what the run refuses; what is dangerous on a real motor is not begun."""
    monkeypatch.chdir(tmp_path)
    DriveZero(0.0).to_toml(tmp_path / "zero.toml")
    assert message in refused("run", plan, "-o", tmp_path / "done", *options)


def test_a_motor_that_is_not_there_is_one_line(hyperflex, plan, tmp_path):
    DriveZero(0.0).to_toml(tmp_path / "zero.toml")
    how = "--zero", tmp_path / "zero.toml", "--torque", 1, "--yes"
    code, out, err = hyperflex("run", plan, "--motor", "moteus:/dev/none", "-o", tmp_path / "done", *how)
    assert (code != 0, out) == (True, "")
    assert "/dev/none" in err.splitlines()[-1]


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A file of a slow drive with a lag of 25 ms."""
    values = {"lag": 0.025, "rate_limit": 1.0}
    model = DriveModel(0.01, 60.0, 1.0, 0.5)
    fit = DriveFit(values, {"lag": (0.024, 0.026), "rate_limit": (0.9, 1.1)}, (8.0, 80.0), 1e-3, model)
    fit.to_toml(tmp_path / "drive.toml")
    return tmp_path / "drive.toml"


def test_a_plan_is_compared_with_the_identified_drive(refused, plan, drive, tmp_path):
    how = "--motor", "moteus:/dev/none", "--drive", drive, "--dry-run"
    assert "rate" in refused("run", plan, "-o", tmp_path / "done", *how)


@pytest.mark.parametrize("way", ["--follow", "--learn"])
def test_moves_that_would_be_others_on_the_drive_are_not_changed(refused, plan, drive, tmp_path, monkeypatch, way):
    slower = replace(planned().problem.limits, speed=5.0)
    monkeypatch.setattr(DriveFit, "motor_limits", lambda *_: slower)
    monkeypatch.setattr(Drive, "check_motion", lambda *_: None)  # as if they were within what is allowed by rounding
    how = "--motor", "emulator:moteus", "--drive", drive, way, "--dry-run"
    assert "Plan again with --drive" in refused("run", plan, "-o", tmp_path / "done", *how)


def test_learning_keeps_to_the_drives_limits(hyperflex, plan, drive, tmp_path, monkeypatch):
    seen, limits = [], replace(planned().problem.limits, speed=99.0)
    monkeypatch.setattr(DriveFit, "motor_limits", lambda *_: limits)

    def carry_out(plan, *_, repeat, **__):
        seen.append((plan.problem.limits, repeat))

    monkeypatch.setattr(import_module("hyperflex.cli.run"), "_carry_out", carry_out)
    hyperflex("run", plan, "--motor", "emulator:moteus", "--drive", drive, "--learn", "-o", tmp_path / "done")
    assert seen == [(limits, 10)]


def test_a_drive_that_was_tried_at_less_speed_than_the_plans_is_reported(drive):
    fit = DriveFit.from_toml(drive)
    replace(fit, values={"lag": 0.025}, intervals={"lag": (0.024, 0.026)}, reached=(1.0, 80.0)).to_toml(drive)
    with pytest.warns(UserWarning, match="shows nothing above 1 rad/s, and the plan reaches"):
        import_module("hyperflex.cli.run")._of_drive(planned(), drive, None, {})


def test_with_yes_an_arm_whose_zero_is_in_doubt_is_not_moved(hyperflex, plan, tmp_path, monkeypatch):
    monkeypatch.setattr(execution, "open_drive", partial(open_ideal, tmp_path / "notes", angle=0.3))
    DriveZero(0.0).to_toml(tmp_path / "zero.toml")
    real = "--motor", "moteus:/dev/none", "--zero", tmp_path / "zero.toml", "--torque", 1, "--yes"
    code, _, err = hyperflex("run", plan, "-o", tmp_path / "done", *real)
    assert (code, "without torque the arm is at 0.30 rad" in err) == (2, True)
    assert (tmp_path / "notes").read_text().split() == ["open", "closed"]


def test_who_does_not_press_enter_moves_nothing(hyperflex, plan, tmp_path, monkeypatch):
    """The input ends, which the parser takes as Ctrl-C."""
    monkeypatch.setattr(execution, "open_drive", partial(open_ideal, tmp_path / "notes"))
    monkeypatch.setattr(Prediction, "of", lambda *_: None)  # not needed
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    DriveZero(0.0).to_toml(tmp_path / "zero.toml")
    real = "--motor", "moteus:/dev/none", "--zero", tmp_path / "zero.toml", "--torque", 1
    code, out, err = hyperflex("run", plan, "-o", tmp_path / "done", *real)
    assert (code, out.strip(), err.splitlines()[-1]) == (130, "", "hyperflex: Interrupted; nothing moved")
    assert "[]" not in err
    assert not (tmp_path / "done").exists()


def test_limits_and_lag_of_a_run_are_the_drives(drive):
    of_drive = partial(import_module("hyperflex.cli.run")._of_drive, planned(), drive)
    limits, options = of_drive(0.7, {})
    assert (limits.speed, limits.torque, options.lag) == (0.9, 0.7, 0.025)
    assert of_drive(None, {"lag": 0.01})[1].lag == 0.01


def test_what_was_learned_is_a_plan(hyperflex_json, plan, tmp_path, monkeypatch):
    rope, moves = scaled_rope(planned().problem.rope, 1.03, 1.0, 1.2), planned().moves
    attempt = Attempt(1, moves, False, lag=0.015)
    done = LearningResult(moves, replace(planned().problem, rope=rope), 0.015, (attempt,), 3)
    monkeypatch.setattr(execution, "learn_cast", lambda *_, **__: done)
    _, result = hyperflex_json("run", plan, "--motor", "emulator:moteus", "--learn", "-o", tmp_path / "done")
    learned = read_plan(result["files"]["learned plan"])
    assert learned.problem.rope.total_length == pytest.approx(1.03 * planned().problem.rope.total_length)
    assert learned.motion == done.motion
    assert result["lag"] == 0.015


def test_a_plan_of_a_whip_is_refused(refused, tmp_path):
    planned_whip().to_toml(tmp_path / "whip.toml")
    assert "no plan of a cast" in refused(
        "run", tmp_path / "whip.toml", "--motor", "emulator:moteus", "-o", tmp_path / "x"
    )


BUSY = "behind the clock", "no valid reply", "has not answered", "goal jumps", "too late", "watchdog expired"


@pytest.fixture
def in_time(hyperflex_json):
    """Run a command until it succeeds or fails with the machine in time, at most three times; skip if it never is."""

    def call(*words):
        for _ in range(3):
            code, result = hyperflex_json(*words)
            told = " ".join(map(str, [*result["warnings"], result.get("message"), result.get("error")]))
            missed = any(cast["missed_cycles"] > 0.01 * cast["cycles"] for cast in result.get("casts", []))
            if code == 0 or not (missed or any(each in told for each in BUSY)):
                return code, result
        return pytest.skip(f"this machine is too busy for real time: {told}")

    return call


@pytest.mark.parametrize(
    ("stuck", "message"),
    [(False, "the torque was switched off"), pytest.param(True, "did not confirm", marks=pytest.mark.nightly)],
)
def test_ctrl_c_keeps_the_log_and_tells_of_the_torque(in_time, plan, tmp_path, monkeypatch, stuck, message):
    notes, tell = tmp_path / "notes", output.note

    def say(phase):
        tell(phase)
        if phase == "the cast runs":
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    monkeypatch.setattr(output, "note", say)
    monkeypatch.setattr(execution, "open_drive", partial(open_ideal, notes, stuck=stuck))
    DriveZero(0.0).to_toml(tmp_path / "zero.toml")
    quick = ["--wait", "0", "--countdown", "0", "--approach", "1", "--calm", "0", "--torque", "1", "--yes"]
    how = "--motor", "moteus:/dev/none", "--zero", tmp_path / "zero.toml", *quick
    code, result = in_time("run", plan, "-o", tmp_path / "done", *how)
    assert (code, result["status"], result["success"]) == (130, "interrupted", False)
    assert message in result["message"]
    assert ("off" in notes.read_text().split()) is not stuck
    (cast,) = result["casts"]
    assert cast["cycles"] > 0
    assert {Path(path).name for path in result["files"].values()} == {"run.nc", "run.png", "run.mcap"}
    assert all(Path(path).is_file() for path in result["files"].values())


@pytest.mark.nightly
@pytest.mark.parametrize("make", ["moteus", "dynamixel", "odrive"])
def test_a_cast_on_an_emulated_drive_winds(in_time, plan, tmp_path, make):
    code, result = in_time("run", plan, "--motor", f"emulator:{make}", "-o", tmp_path / "done", "--countdown", 0)
    assert (code, result["success"], result["emulated"]) == (0, True, True)
    (run,) = result["casts"]
    assert abs(run["turns"]) >= 1.25
    assert run["tracking_error_max"] < 0.3
    assert all(Path(path).is_file() for path in result["files"].values())


@pytest.mark.nightly
def test_learning_stops_after_three_casts_that_wind(in_time, plan, tmp_path):
    how = "--motor", "emulator:moteus", "--repeat", 5, "--learn", "--countdown", 0
    code, result = in_time("run", plan, *how, "-o", tmp_path / "done")
    assert (code, len(result["casts"]), len(result["learned"])) == (0, 3, 3)


@pytest.mark.nightly
def test_a_cast_that_an_emulated_camera_sees_winds(in_time, plan, tmp_path):
    """Renderer, tracker, follower, stream and emulated drive in processes of their own."""
    how = "--motor", "emulator:moteus", "--camera", "emulated", "--follow", "--countdown", 0
    code, result = in_time("run", plan, *how, "-o", tmp_path / "done")
    assert (code, result["success"]) == (0, True)
    (run,) = result["casts"]
    assert run["judged_by"] == "state"
    assert abs(run["turns"]) == pytest.approx(2.3, abs=0.4)
    assert run["decisions"]
