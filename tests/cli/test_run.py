"""``hyperflex run`` against emulated drives, and what it refuses."""

import signal
import threading
from functools import partial
from pathlib import Path

import pytest

from hyperflex import execution
from hyperflex.cli import output
from hyperflex.hardware import DriveZero
from tests.execution.ideal_link import open_ideal
from tests.planning.known import planned
from tests.planning.known_whip import planned_whip


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "cast.toml"
    planned().to_toml(path)
    return path


def test_a_dry_run_checks_the_plan_and_connects_nothing(hyperflex_json, plan, tmp_path):
    code, result = hyperflex_json("run", plan, "--motor", "moteus:/dev/none", "-o", tmp_path / "done", "--dry-run")
    assert (code, result["dry_run"]) == (0, True)
    assert not (tmp_path / "done").exists()


@pytest.mark.parametrize(
    ("motor", "message"),
    [
        ("moteus:/dev/none", "/dev/none"),
        ("servo:/dev/ttyUSB0", "the motor's address is not known"),
        ("moteus", "the motor's address"),
        ("emulator:servo", "the motor's address"),
    ],
)
def test_a_motor_that_is_not_there_is_one_line(hyperflex, plan, tmp_path, motor, message):
    DriveZero(0.0).to_toml(tmp_path / "zero.toml")
    how = "--zero", tmp_path / "zero.toml", "--yes"
    code, out, err = hyperflex("run", plan, "--motor", motor, "-o", tmp_path / "done", *how)
    assert (code != 0, out) == (True, "")
    assert message in err.splitlines()[-1]


def test_a_real_motor_needs_its_zero(refused, plan, tmp_path):
    assert "needs its zero" in refused("run", plan, "--motor", "moteus:/dev/none", "-o", tmp_path / "done")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--motor", "emulator:moteus", "--camera", "0"), "does not see the rope of an emulated motor"),
        (("--motor", "moteus:/dev/none", "--camera", "emulated"), "does not see the rope of a real motor"),
        (("--motor", "moteus:/dev/none", "--camera", "0"), "no --calibration, --arc-lengths"),
    ],
)
def test_a_camera_that_cannot_see_the_rope_is_one_line(refused, plan, tmp_path, options, message):
    assert message in refused("run", plan, "-o", tmp_path / "done", *options)


def test_a_plan_of_a_whip_is_refused(refused, tmp_path):
    planned_whip().to_toml(tmp_path / "whip.toml")
    assert "no plan of a cast" in refused(
        "run", tmp_path / "whip.toml", "--motor", "emulator:moteus", "-o", tmp_path / "x"
    )


@pytest.mark.parametrize(("stuck", "message"), [(False, "the torque was switched off"), (True, "did not confirm")])
def test_ctrl_c_keeps_the_log_and_tells_of_the_torque(hyperflex_json, plan, tmp_path, monkeypatch, stuck, message):
    notes, tell = tmp_path / "notes", output.note

    def say(phase):
        tell(phase)
        if phase == "the cast runs":
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    monkeypatch.setattr(output, "note", say)
    monkeypatch.setattr(execution, "open_drive", partial(open_ideal, notes, stuck=stuck))
    DriveZero(0.0).to_toml(tmp_path / "zero.toml")
    quick = "--wait", 0, "--countdown", 0, "--approach", 1, "--calm", 0, "--zero", tmp_path / "zero.toml", "--yes"
    code, result = hyperflex_json("run", plan, "--motor", "moteus:/dev/none", "-o", tmp_path / "done", *quick)
    assert (code, result["status"], result["success"]) == (130, "interrupted", False)
    assert message in result["message"]
    assert ("off" in notes.read_text().split()) is not stuck
    (cast,) = result["casts"]
    assert cast["cycles"] > 0
    assert {Path(path).name for path in result["files"].values()} == {"run.nc", "run.png", "run.mcap"}
    assert all(Path(path).is_file() for path in result["files"].values())


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
