"""The demo from end to end: intervals that cover, predictions near the noise, a cast like the rope's, a folder."""

import dataclasses
import re

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.demo import twin, write_demo
from hyperflex.errors import FileProblem


def test_the_folder_is_complete(demo_report):
    names = {path.name for path in demo_report.files.values()}
    assert names == {
        "swing.mp4",
        "camera.toml",
        "guess.toml",
        "tracked.mp4",
        "seen.png",
        "markers.nc",
        "prediction.png",
        "parameters.png",
        "cast.nc",
        "strike.png",
        "course.png",
        "tug.png",
        "motion.csv",
        "cast.toml",
        "rope.toml",
        "identification.json",
        "summary.md",
        "report.html",
    }
    page = demo_report.files["page"]
    assert page.stat().st_size < 4e6  # bytes; two thirds of them pictures
    assert page.read_text("utf-8").count("<iframe sandbox=") == 1  # the cast plays
    titles = re.findall(r"<h2>([^<]*)</h2>", page.read_text("utf-8"))
    assert titles[:2] == ["The cast", "In short"]  # what the reader came for comes first
    folder = page.parent
    assert {path.name for path in folder.iterdir()} == names
    assert all(path.stat().st_size > (100 if path.suffix == ".toml" else 1000) for path in demo_report.files.values())


def test_intervals_cover_the_mapped_truth_and_exclude_the_guess(demo_report):
    assert demo_report.demo.identification.success
    for each in demo_report.demo.parameters:
        low, high = each.interval
        assert low < each.mapped < high, each
        assert each.covered
        assert not low < each.guess < high, each


def test_a_parameter_outside_its_interval_is_told(demo_report):
    each = demo_report.demo.parameters[0]
    assert not dataclasses.replace(each, mapped=each.value + 2.0 * each.std).covered


def test_the_prediction_is_near_the_noise(demo_report):
    demo = demo_report.demo
    joints = twin.swing(demo.recording.t).joints[:, :: twin.FINE // twin.COARSE]
    sides = np.diff(joints, axis=1)
    true = np.unwrap(np.arctan2(sides[..., 0], -sides[..., 1]), axis=0)
    off = demo.recording.angles().data - true
    noise = float(np.sqrt(np.nanmean((off - 2.0 * np.pi * np.round(off / (2.0 * np.pi))) ** 2)))
    # The tracked angles scatter by their errors themselves, so the prediction's cannot be much less. The upper limit is
    # 1.3 times the errors of the first tracker, 8.2 mrad: it leaves room for the state, which is fitted on 15 frames,
    # and for the coarse chain, and neither shrinks with the tracker's errors.
    assert 0.9 * noise < demo.held_out_rms < 1.3 * 8.2e-3
    assert demo.angle_noise.mean() == pytest.approx(noise, rel=0.5)  # what the tracker says of itself


def test_files_can_be_used_again(demo_report):
    rope = hf.Rope.from_toml(demo_report.files["rope"])
    assert rope.friction[0] == demo_report.demo.parameters[0].value
    cast = hf.read_trajectory(demo_report.files["run"])
    np.testing.assert_array_equal(cast.tip, demo_report.demo.plan.run.tip)
    assert cast.dataset.attrs["source"] == "simulated"


def test_the_demo_ends_wound_and_held(demo_report):
    plan, held = demo_report.demo.plan, demo_report.demo.held
    assert plan.success, plan.message
    assert abs(plan.outcome.turns) >= 1.25
    assert held.force > held.tail_weight
    page = demo_report.files["page"].read_text("utf-8")
    for told in (
        f"{abs(plan.outcome.turns):.2f} turns",
        f"{held.force:.2f} N",
        f"{plan.moves.ends.size - 1} swings",
        "40 links",
    ):
        assert told in page
    # Whether the rope of the recording winds too is told as it is: it is no promise of a plan on an identified rope.
    assert (demo_report.verdicts[1][0]) == demo_report.demo.proof.success


def test_the_page_says_simulated_and_names_no_folder(demo_report):
    text = demo_report.files["page"].read_text("utf-8")
    plain = re.sub(r'src="data:[^"]*"', "", text)
    assert "simulated" in plain
    assert "Nothing here was measured on a real rope" in plain
    assert len(re.findall(r"<figure[ >]", plain)) == 7
    assert str(demo_report.files["page"].parent) not in plain
    for row in demo_report.parameters.rows:
        assert row[2] in plain


def test_a_file_in_the_way_of_the_folder_is_refused_before_any_work(tmp_path):
    (tmp_path / "taken").write_text("x")
    with pytest.raises(FileProblem, match="not a folder"):
        write_demo(tmp_path / "taken", lambda _: pytest.fail("work began"))
