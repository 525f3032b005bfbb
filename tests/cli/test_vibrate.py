"""``hyperflex vibrate``: a posture, a plan, a motor that is too weak, and the picture."""

import json

import pytest
from PIL import Image

import hyperflex as hf
from hyperflex.cli.app import run


@pytest.fixture
def rod(tmp_path):
    hf.Rope(length=[0.3], mass=[0.05], friction=[1e-4]).to_toml(tmp_path / "rod.toml")
    return tmp_path / "rod.toml"


def called(capsys, *arguments: object) -> tuple[int, dict]:
    code = run(["vibrate", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_postures_of_a_vibration(rod, capsys):
    how = ["--amplitude", 0.005, "--frequency", 110, "--direction", 2.4, "--arm-length", 0.1]
    code, found = called(capsys, "--rope", rod, *how)
    held = hf.vibration_posture(hf.Rope.from_toml(rod), 0.005, 110.0, 2.4, arm=hf.Arm(length=0.1))[0]
    assert code == 0
    assert found["postures"][0]["tilt_rad"] == pytest.approx(held.tilt, abs=1e-9)
    assert found["postures"][0]["stable"]


def test_a_plan_names_what_the_motor_lacks_and_draws_the_map(rod, tmp_path, capsys):
    code, found = called(capsys, "--rope", rod, "--tilt", 1.9, "--arm-length", 0.1, "-o", tmp_path / "map.png")
    assert code == 4
    assert sorted(found["missing"]) == ["acceleration", "speed"]
    assert "the motor lacks" in found["message"]
    assert found["motor"]["speed"] > 20.0
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.size[0] > 600


def test_it_must_be_said_what_to_hold(rod, capsys):
    assert run(["vibrate", "--rope", str(rod)]) == 2
    assert "Give --tilt" in capsys.readouterr().err


def test_what_would_be_ignored_is_refused(rod, capsys):
    assert run(["vibrate", "--rope", str(rod), "--tilt", "1.9", "--amplitude", "0.01"]) == 2
    assert "--amplitude" in capsys.readouterr().err
    how = ["--amplitude", "0.05", "--frequency", "60", "--direction", "2.4"]
    assert run(["vibrate", "--rope", str(rod), *how, "--stiffness", "1"]) == 2
    assert "--stiffness" in capsys.readouterr().err


def test_the_map_of_a_large_vibration_ends_at_the_arm(rod, tmp_path):
    how = ["--amplitude", "0.05", "--frequency", "60", "--direction", "2.4", "-o", str(tmp_path / "map.png")]
    assert run(["vibrate", "--rope", str(rod), *how]) == 0
