"""``hyperflex vibrate``: a posture, a plan, a motor that is too weak, and the picture."""

import pytest
from PIL import Image

import hyperflex as hf


@pytest.fixture
def rod(tmp_path):
    hf.Rope(length=[0.3], mass=[0.05], friction=[1e-4]).to_toml(tmp_path / "rod.toml")
    return tmp_path / "rod.toml"


def test_postures_of_a_vibration(rod, hyperflex_json):
    how = ["--amplitude", 0.005, "--frequency", 110, "--direction", 2.4, "--arm-length", 0.1]
    code, found = hyperflex_json("vibrate", "--rope", rod, *how)
    held = hf.vibration_posture(hf.Rope.from_toml(rod), 0.005, 110.0, 2.4, arm=hf.Arm(length=0.1))[0]
    assert code == 0
    assert found["postures"][0]["tilt_rad"] == pytest.approx(held.tilt, abs=1e-9)
    assert found["postures"][0]["stable"]


def test_a_plan_names_what_the_motor_lacks_and_draws_the_map(rod, tmp_path, hyperflex_json):
    how = "--tilt", 1.9, "--arm-length", 0.1, "-o", tmp_path / "map.png"
    code, found = hyperflex_json("vibrate", "--rope", rod, *how)
    assert code == 4
    assert sorted(found["missing"]) == ["acceleration", "speed"]
    assert "the motor lacks" in found["message"]
    assert found["motor"]["speed"] > 20.0
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.size[0] > 600


LARGE = ("--amplitude", 0.05, "--frequency", 60, "--direction", 2.4)


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ((), "Give --tilt"),
        (("--tilt", 1.9, "--amplitude", 0.01), "--amplitude"),
        ((*LARGE, "--stiffness", 1), "--stiffness"),
    ],
)
def test_nothing_to_hold_and_what_would_be_ignored_are_refused(rod, refused, how, told):
    assert told in refused("vibrate", "--rope", rod, *how)


def test_the_map_of_a_large_vibration_ends_at_the_arm(rod, hyperflex, tmp_path):
    assert hyperflex("vibrate", "--rope", rod, *LARGE, "-o", tmp_path / "map.png")[0] == 0
