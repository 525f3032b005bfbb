"""Ropes and set-ups in TOML files, and back: equal bit for bit, files beside them found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput

ROPE = hf.Rope(length=[0.1, 0.2, 0.3], mass=[0.1 / 3, 0.02, 0.01], friction=1 / 7e4, tip_mass=0.1, name='a "rope"')
TABLE = "[rope]\nn_links = 10\ntotal_length = 1.0\ntotal_mass = 0.05\n"


@pytest.mark.parametrize(
    "motion",
    [
        hf.hold(0.1),
        hf.move(0.0, 1.0, 0.5, "minimum-jerk"),
        hf.swings(0.7, 0.3, "ramp", "over").shifted(0.25),
        hf.sampled([0.0, 0.1, 0.3], [0.0, 1 / 3, 0.1]),
        hf.swings().then(hf.hold(float(hf.swings().angle(3.0))), 3.0),
    ],
    ids=["hold", "move", "swings", "sampled", "joined"],
)
def test_setup_round_trip(motion: hf.Motion, tmp_path: Path) -> None:
    setup = hf.Setup(ROPE, motion, hf.Arm(0.1, pivot=(0.5, 1.0)), duration=1.5, q0=[0.1, 0.2, 1 / 3])
    setup.to_toml(tmp_path / "setup.toml")
    again = hf.Setup.from_toml(tmp_path / "setup.toml")
    assert again.rope == ROPE
    assert again.motion == motion
    assert again.arm == setup.arm
    np.testing.assert_array_equal(again.q0, setup.q0)
    assert again.dumps() == setup.dumps()


def test_rope_round_trip(tmp_path: Path) -> None:
    ROPE.to_toml(tmp_path / "rope.toml")
    assert hf.Rope.from_toml(tmp_path / "rope.toml") == ROPE


def test_totals_are_shared_out(tmp_path: Path) -> None:
    (tmp_path / "rope.toml").write_text(TABLE)
    rope = hf.Rope.from_toml(tmp_path / "rope.toml")
    assert rope == hf.Rope.uniform(length=1.0, mass=0.05, n_links=10)


def test_motion_file_is_found_beside_the_setup(tmp_path: Path) -> None:
    (tmp_path / "arm.csv").write_text("t,angle\n0.0,0.0\n0.5,1.0\n")
    (tmp_path / "setup.toml").write_text(
        "duration = 1.0\n" + TABLE + '[arm]\nlength = 0.1\n[motion]\nkind = "file"\npath = "arm.csv"\n'
    )
    setup = hf.Setup.from_toml(tmp_path / "setup.toml")
    assert setup.motion == hf.sampled([0.0, 0.5], [0.0, 1.0])
    assert hf.Setup.loads(setup.dumps()).motion == setup.motion  # and needs the file no more


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "rope"),
        ("[rope]\nn_links = 10\n", "length"),
        ("[rope]\nn_links = 0\nlength = 0.1\nmass = 0.1\n", "n_links"),
        (TABLE + "length = 0.1\n", "both total_length and length"),
        (TABLE + "weight = 3.0\n", "weight"),
        (TABLE.replace("0.05", "-0.05"), "-0.05"),
        ("rope = 3\n", "not a table"),
        ("speed = 3\n" + TABLE, "speed"),
        (TABLE + '[motion]\nkind = "dance"\n', "dance"),
        (TABLE + '[motion]\nkind = "swings"\nt_mov = 0.3\n', "t_mov"),
        (TABLE + "[arm]\nlenght = 0.3\n", "lenght"),
    ],
)
def test_bad_tables(text: str, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        hf.Setup.loads(text)
