"""``hyperflex motor``: check, identify, zero."""

import json
import tomllib
from types import SimpleNamespace

import pytest

import hyperflex as hf
from hyperflex import execution
from hyperflex.cli import motor
from hyperflex.errors import InvalidInput
from hyperflex.hardware import Drive, DriveZero
from tests.hardware.fake import FakeLink
from tests.planning.known import planned
from tests.refusals import refuses


@pytest.fixture
def rope(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hf.Rope.uniform(length=2.0, mass=0.125, n_links=10, friction=5e-4).to_toml("rope.toml")


@pytest.mark.usefixtures("rope")
def test_check_reports_what_is_possible_and_gives_limits(hyperflex):
    code, out, _ = hyperflex("motor", "check", "--motor", "XL430-W250", "--rope", "rope.toml", "--json")
    found = json.loads(out)
    assert code == 4
    assert [each["speed"] * 9.5493 for each in found["demands"]] == pytest.approx([120.0, 112.5], abs=0.1)
    assert found["holding_torque_Nm"] == pytest.approx(0.129, abs=5e-4)
    code, out, _ = hyperflex("motor", "check", "--rpm", 300, "--torque", 3, "--rope", "rope.toml")
    assert code == 0
    assert "Limits for cast" in out


@pytest.mark.usefixtures("rope")
def test_plans_count_with_their_own_torque_and_no_margin_is_absurd(hyperflex, hyperflex_json):
    planned().to_toml("cast.toml")
    how = "motor", "check", "cast.toml", "--rope", "rope.toml", "--rpm"
    torque, part = planned().torque, 0.9
    assert torque > 0.2  # the weight's is 0.13 N m
    code, found = hyperflex_json(*how, 1000, "--torque", part * torque)
    assert (code, found["demands"][2]["torque"], found["demands"][2]["possible"]) == (4, torque, False)
    assert found["demands"][2]["margin"] == pytest.approx(1.0 - 1.0 / part)
    _, out, _ = hyperflex(*how, 50, "--torque", 9)
    assert ("the motor is too slow" in out, "-" in out.replace("--", "").replace("bang-bang", "")) == (True, False)


@pytest.mark.usefixtures("rope")
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("check", "--rope", "rope.toml"), "no motor is given"),
        (("check", "--motor", "nothing", "--rope", "rope.toml"), "not in the catalogue"),
        (("check", "--motor", "XL430-W250", "--rpm", "100", "--rope", "rope.toml"), "given twice"),
        (("identify", "--motor", "nothing", "-o", "drive.toml"), "address is not known"),
        (("identify", "--motor", "moteus:/dev/not-there", "-o", "drive.toml"), "limit of torque"),
        (("identify", "--motor", "moteus:/dev/not-there", "-o", "drive.toml", "--torque", "1"), "needs its zero"),
        (("zero", "--motor", "moteus:/dev/not-there", "-o", "zero.toml"), "/dev/not-there"),
        (("zero", "--motor", "moteus:/dev/ttyACM0", "-o", "zero.txt"), "suffix"),
    ],
)
def test_wrong_use_has_one_clear_line(hyperflex, words, told):
    code, out, err = hyperflex("motor", *words)
    assert (code, out) == (2, "")
    assert told in err


def test_a_dry_run_opens_nothing_and_tells_strokes_which_are_small_unless_others_are_requested(
    hyperflex_json, tmp_path
):
    how = "motor", "identify", "--motor", "moteus:/no", "-o", tmp_path / "d.toml", "--dry-run"
    for more, angle in (((), 0.3), (("--speed", 8), 0.3), (("--speed", 8, "--stroke", 1.5), 1.5)):
        code, told = hyperflex_json(*how, *more)
        assert (code, told["greatest_angle"]) == (0, pytest.approx(angle))


@pytest.mark.parametrize(("stroke", "deviation"), [(0.3, 0.18), (1.5, 0.9), (3.0, 0.9)])
def test_small_strokes_notice_a_stuck_drive_too(hyperflex, tmp_path, monkeypatch, stroke, deviation):
    seen = []

    def record(connect, **_):
        seen.append(connect().max_deviation)
        raise InvalidInput("seen")

    monkeypatch.setattr(execution, "record_test_motion", record)
    DriveZero(0.0).to_toml(tmp_path / "zero.toml")
    how = "--torque", 1, "--speed", 8, "--zero", tmp_path / "zero.toml", "--yes", "--stroke", stroke
    hyperflex("motor", "identify", "--motor", "moteus:/dev/not-there", "-o", tmp_path / "drive.toml", *how)
    assert seen == pytest.approx([deviation])


@pytest.mark.parametrize(("turned", "direction"), [(-1.5, -1), (1.6, 1), (7.5, None), (0.2, None)])
def test_a_quarter_turn_by_hand_shows_the_direction(hyperflex_json, tmp_path, monkeypatch, turned, direction):
    link = FakeLink(4.0)
    monkeypatch.setattr(execution, "open_drive", lambda *_, **__: Drive(link, hf.MotorLimits()))
    monkeypatch.setattr("typer.prompt", lambda *_, **__: link.state.update(angle=4.0 + turned))
    how = "motor", "zero", "--motor", "moteus:/dev/ttyACM0", "-o", tmp_path / "zero.toml", "--angle", 0.1
    code, result = hyperflex_json(*how)
    if direction is None:
        assert (code, "no quarter turn" in result["error"]) == (2, True)
        return
    assert DriveZero.from_toml(tmp_path / "zero.toml") == DriveZero(4.0 - direction * 0.1, direction, how[3])
    link.state["angle"] = 4.0
    hyperflex_json(*how, "--direction", -direction)  # no question is asked
    assert DriveZero.from_toml(tmp_path / "zero.toml").direction == -direction


def test_a_fault_is_cleared_only_if_that_is_requested(refused, hyperflex, tmp_path, monkeypatch):
    link = FakeLink(4.0, fault="over temperature (38)")
    monkeypatch.setattr(execution, "open_drive", lambda *_, **__: Drive(link, hf.MotorLimits()))
    how = "motor", "zero", "--motor", "moteus:/dev/ttyACM0", "-o", tmp_path / "zero.toml", "--direction", 1
    assert "give --clear-fault" in refused(*how)
    assert link.state["fault"]
    assert hyperflex(*how, "--clear-fault")[0] == 0
    assert not link.state["fault"]


def test_run_and_identify_emulate_the_same_motor(monkeypatch):
    made = []

    def emulator(device, model, rope=None, arm=None, **_):
        made.append((model, arm or hf.Arm()))
        raise InvalidInput("seen")

    for module in ("hyperflex.hardware", "hyperflex.execution.emulated"):
        monkeypatch.setattr(f"{module}.Emulator", emulator)
    refuses("seen", execution.emulator_of, planned(), "emulator:moteus")
    refuses("seen", motor._drive("emulator:moteus", hf.MotorLimits(), None).__enter__)
    assert made[0] == made[1]
    assert made[0][0].extrapolates


def test_an_emulator_that_was_late_is_no_fair_trial():
    with pytest.warns(UserWarning, match="behind the clock"):
        motor.warn_if_behind(SimpleNamespace(unfair="motor fell 50 ms behind the clock"))


@pytest.mark.parametrize("more", [(), ("--help",)])
def test_the_commands_of_a_motor_are_listed(hyperflex, more):
    code, out, _ = hyperflex("motor", *more)
    assert code == 0
    assert all(f"  motor {each} " in out for each in ("check", "identify", "zero"))


@pytest.mark.nightly
def test_an_emulated_drive_is_identified_and_zeroed(hyperflex, tmp_path):
    drive, picture, zero = tmp_path / "drive.toml", tmp_path / "drive.png", tmp_path / "zero.toml"
    code, out, _ = hyperflex("motor", "zero", "--motor", "emulator:moteus", "-o", zero)
    assert (code, "raw angle" in out) == (0, True)
    words = ("--speed", 6, "--acceleration", 60, "--zero", zero, "--picture", picture, "--json")
    code, out, err = hyperflex("motor", "identify", "--motor", "emulator:moteus", "-o", drive, *words)
    assert code == 0, err
    found = json.loads(out)
    assert found["intervals"]["lag"][0] <= found["values"]["lag"] <= 0.05
    assert tomllib.loads(drive.read_text())["drive"]["values"]["lag"] == found["values"]["lag"]
    assert picture.exists()
