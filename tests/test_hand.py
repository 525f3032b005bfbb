"""The benchmark of hardware in the loop: its page, and the camera that is known as after a calibration."""

import numpy as np
import pytest
from benchmarks import hand

from hyperflex.vision import Camera


def cast(turns, wound, **more):
    figures = {"seen": turns, "stopped": "", "cycles": 1000, "missed": 2, "late": 0, "frames": 90, "behind": 0.004}
    return {"won": turns >= 1.25, "turns": turns, "wound": wound, "decisions": [], "unfair": [], **figures, **more}


def row(name, casts, **ways):
    known = {way: casts[min(k, len(casts) - 1)] for k, way in enumerate(hand.WAYS)} | ways
    return {"plan": name, **known, "casts": casts, "motor": "emulator:moteus", "lag": 0.0156}


def test_the_page_counts_what_failed_and_what_was_repeated():
    behind = [{"behind": 0.05, "won": False, "stopped": ""}, {"behind": 0.03, "won": True, "stopped": ""}]
    closed = cast(1.3, True, unfair=behind, decisions=[["changed", 0.5, 0.2, 0.1], ["late", 0.5, 0.5, 0.4]])
    stopped = cast(0.4, None, stopped="No marker has been seen for 0.30 s.")
    failed = {**hand.lost("the rope still swings"), "unfair": []}
    rows = [
        row("one", [cast(1.1, True), closed, cast(1.4, True, behind=0.03)]),
        row("two", [stopped, failed], learned=hand.lost("The emulator ended with code 1.")),
    ]
    page = hand.page(rows)
    for line in (
        "| 0 | 1 | 1 | 2 |",
        "| one | 1.10 | 1.30 w | changed, late | 1.40 w | 3 |",
        "| two | 0.40 | none |  | none | 2 |",
        "- two, cast 1: No marker has been seen for 0.30 s.",
        "- two, cast 2: the rope still swings",
        "- two, learned: The emulator ended with code 1.",
    ):
        assert line in page.splitlines()
    for words in (
        "8 of 4000 (0.20%)",
        "late: 1 of 2",
        "right in 2 of 5 casts, wrong in 1, and unknown in 2",
        "which were repeated: 2, by up to 50 ms",
        "Casts that count as they are after 3 repeats: 1.",
        "Not measured on 20 targets yet.",
    ):
        assert words in page
    assert "Casts that were stopped" not in hand.page([row("one", [cast(1.1, True)])])


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
