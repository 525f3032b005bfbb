"""Benchmarks: rows of long ones, hardware in the loop, the camera that is known as after a calibration."""

import json

import numpy as np
import pytest
from benchmarks import hand, log

from hyperflex.vision import Camera


def test_an_unfair_cast_is_repeated_three_times_at_most():
    lags = iter([0.05, 0.01, 0.03, 0.03, 0.03, 0.03])
    rig = object.__new__(hand.Rig)
    rig.once = lambda *_: (None, hand.lost("", next(lags)))
    first, second = rig.cast(None)[1], rig.cast(None)[1]
    assert (first["behind"], [each["behind"] for each in first["unfair"]]) == (0.01, [0.05])
    assert (second["behind"], len(second["unfair"])) == (0.03, 3)


def test_a_calibrated_camera_is_off_as_stated():
    true = Camera.facing((480, 480), pixels_per_metre=120.0, origin=(240.0, 240.0))
    grid = np.stack(np.meshgrid([-1.5, 0.0, 1.5], [-1.5, 0.0, 1.5]), axis=-1).reshape(-1, 2)
    off = np.array([hand.calibrated(true, seed).locate(true.project(grid)) - grid for seed in range(200)])
    assert np.sqrt((off[:, 4] ** 2).mean(axis=0)) == pytest.approx([hand.SHIFTED] * 2, rel=0.2)
    assert np.abs(off).max() < 0.05
    np.testing.assert_array_equal(hand.calibrated(true, 3).rotation, hand.calibrated(true, 3).rotation)


@pytest.mark.parametrize(
    ("tail", "kept"),
    [
        ("", [1, 2]),
        ('{"n": 3, "of": {"a": 1}', [1, 2]),  # ends as a row does
        ('{"n": 3', [1, 2]),
        ("[3]", [1, 2]),
        ('{"n": 3}', [1, 2, 3]),  # lacks nothing but the end of its line
    ],
)
def test_half_a_line_is_cut_off_before_the_next(tmp_path, tail, kept):
    path = tmp_path / "rows.jsonl"
    path.write_text('{"n": 1}\n{"n": 2}\n' + tail)
    assert [row["n"] for row in log.read(path)] == kept
    log.append(path, {"n": 9})
    assert [json.loads(line)["n"] for line in path.read_text().splitlines()] == [*kept, 9]
