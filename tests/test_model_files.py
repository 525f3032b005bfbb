"""Ropes and set-ups in TOML files, and back: equal bit for bit, with files in the same folder."""

import numpy as np
import pytest

import hyperflex as hf
from tests.refusals import refuses

ROPE = hf.Rope(length=[0.1, 0.2, 0.3], mass=[0.1 / 3, 0.02, 0.01], friction=1 / 7e4, tip_mass=0.1, name='a "rope"')
PIECES = '[motion]\nkind = "pieces"\nbreaks = [0.0, 1.0]\ncoef = [1.0]\nswitch = [true, true]\nloop = -1\n'
TABLE = "[rope]\nn_links = 10\ntotal_length = 1.0\ntotal_mass = 0.05\n"


@pytest.mark.parametrize(
    "motion",
    [
        hf.hold_arm(0.1),
        hf.move_arm(0.0, 1.0, 0.5, "minimum-jerk"),
        hf.arm_swings(0.7, 0.3, "ramp", "over").shifted(0.25),
        hf.sampled_motion([0.0, 0.1, 0.3], [0.0, 1 / 3, 0.1]),
        hf.arm_strokes([0.1, 1.2], 0.6, "ramp", "over", ramp=0.2, made=1),
        hf.arm_swings().then(hf.hold_arm(float(hf.arm_swings().angle(3.0))), 3.0),
    ],
    ids=["hold", "move", "swings", "sampled", "strokes", "joined"],
)
def test_setup_round_trip(motion, tmp_path):
    setup = hf.Setup(ROPE, motion, hf.Arm(0.1, pivot=(0.5, 1.0)), duration=1.5, q0=[0.1, 0.2, 1 / 3])
    setup.to_toml(tmp_path / "setup.toml")
    again = hf.Setup.from_toml(tmp_path / "setup.toml")
    assert again.rope == ROPE
    assert again.motion == motion
    assert again.arm == setup.arm
    np.testing.assert_array_equal(again.q0, setup.q0)
    assert again.dumps() == setup.dumps()


def test_totals_are_shared_out(tmp_path):
    (tmp_path / "rope.toml").write_text(TABLE)
    rope = hf.Rope.from_toml(tmp_path / "rope.toml")
    assert rope == hf.Rope.uniform(length=1.0, mass=0.05, n_links=10, friction=0.0)


def test_arrays_tell_the_number_of_links():
    setup = hf.Setup.loads("[rope]\nlength = [0.1, 0.2]\nmass = [0.01, 0.02]\n")
    assert setup.rope == hf.Rope(length=[0.1, 0.2], mass=[0.01, 0.02])


def test_tables_of_a_planner_are_omitted():
    planned = "[target]\nx = 0.6\ny = -1.1\nradius = 0.05\n[limits]\nspeed = 8.0\n[plan]\nseed = 1\n"
    assert hf.Setup.loads(TABLE + planned).dumps() == hf.Setup.loads(TABLE).dumps()
    refuses("does not know this key: got 'aim'", hf.Setup.loads, TABLE + "[aim]\nx = 0.6\n")


def test_motion_file_is_found_beside_the_setup(tmp_path):
    (tmp_path / "arm.csv").write_text("t,angle\n0.0,0.0\n0.5,1.0\n")
    (tmp_path / "setup.toml").write_text(
        "duration = 1.0\n" + TABLE + '[arm]\nlength = 0.1\n[motion]\nkind = "file"\npath = "arm.csv"\n'
    )
    setup = hf.Setup.from_toml(tmp_path / "setup.toml")
    assert setup.motion == hf.sampled_motion([0.0, 0.5], [0.0, 1.0])
    assert hf.Setup.loads(setup.dumps()).motion == setup.motion  # and needs the file no more


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "rope"),
        ("[rope]\nn_links = 50\nlength = 2.0\nmass = 0.125\n", "length is one number for 50 links.*total_length"),
        ("[rope]\nlength = [0.1, 0.1]\nmass = [0.1]\n", "mass"),
        ("[rope]\nn_links = 3\nlength = [0.1, 0.1]\ntotal_mass = 0.1\n", "n_links"),
        ("[rope]\ntotal_length = 1.0\ntotal_mass = 0.1\n", "lacks n_links"),
        (TABLE + PIECES, "coef"),
        ("[rope]\nn_links = 10\n", "length"),
        ("[rope]\nn_links = 0\nlink_length = 0.1\nlink_mass = 0.1\n", "n_links"),
        (TABLE + "link_length = 0.1\n", "length 2 times"),
        ("rope = 3\n", "not a table"),
        (TABLE + '[motion]\nkind = "dance"\n', "dance"),
    ],
)
def test_bad_tables(text, words):
    refuses(words, hf.Setup.loads, text)


@pytest.mark.parametrize("wrong", [{"total_mass": 125.0}, {"total_length": 2000.0, "radius": 2.5}], ids=["g", "mm"])
def test_a_rope_in_other_units_is_refused(wrong):
    right = {"n_links": 20, "total_length": 2.0, "total_mass": 0.125, "radius": 0.0025}
    assert hf.Rope.from_table(right).total_mass == pytest.approx(0.125)
    refuses(r"impossible density: got .* kg/m\^3.*in m and mass in kg", hf.Rope.from_table, right | wrong)
