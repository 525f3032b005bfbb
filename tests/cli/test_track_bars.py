"""``hyperflex track --bar``: a rendered pendulum's video in, a file for identify out; what is missing is said."""

import json
import re
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.cli import output
from hyperflex.files import read_netcdf
from hyperflex.vision import VideoReader
from tests.estimate.test_bars import CAMERA, filmed


def test_a_video_becomes_angles(hyperflex, tmp_path):
    run, _ = filmed(tmp_path / "pendulum.mp4", duration=0.6)
    clicks = CAMERA.project(run.joints[0, [0, 1, 2]])
    middles = 0.5 * (clicks[1:] + clicks[:-1])
    bars = [word for place in middles for word in ("--bar", f"{place[0]:.1f},{place[1]:.1f}")]
    out, seen = tmp_path / "angles.nc", tmp_path / "seen.mp4"
    code, text, err = hyperflex(
        "track", tmp_path / "pendulum.mp4", *bars, "--pivot", "158", "150", "-o", out, "--preview", seen, "--json"
    )
    assert (code, err) == (0, "")
    said = json.loads(text)
    recording = hf.read_recording(out)
    assert recording.kind == "angles"
    assert said["frames"] == len(recording.t)
    assert min(said["seen"]) > 0.9
    with VideoReader(seen) as video:
        assert len(list(video)) == said["frames"]


def test_the_preview_is_what_to_look_at(hyperflex, tmp_path, monkeypatch):
    found = SimpleNamespace(
        recording=hf.Recording([0.0, 0.1], [[0.1, 0.2], [0.1, 0.2]]),
        frames=2,
        seen=np.ones(2),
        notes=(),
        to_netcdf=lambda path: path.write_bytes(b"angles"),
    )
    monkeypatch.setattr("hyperflex.vision.track_bars", lambda *_, **__: found)
    monkeypatch.setattr("hyperflex.cli.track._bar_detector", lambda *_: None)
    clicks = ("--bar", "213,140", "--bar", "252,180", "--pivot", "158", "150")
    words = ("track", "pendulum.mp4", *clicks, "-o", "angles.nc")
    monkeypatch.chdir(tmp_path)
    code, out, err = hyperflex(*words)
    assert (code, err) == (0, "")
    assert "preview" not in out
    assert re.search(r"written +angles\.nc\n +preview +seen\.mp4\n", hyperflex(*words, "--preview", "seen.mp4")[1])


def test_ctrl_c_keeps_what_was_tracked_under_a_name_that_says_so(hyperflex, tmp_path, monkeypatch):
    @contextmanager
    def hit_at_frame_8():
        def said(words):
            if words == "frame 8":
                raise KeyboardInterrupt

        yield said

    monkeypatch.setattr(output, "spinner", hit_at_frame_8)
    run, _ = filmed(tmp_path / "pendulum.mp4", duration=0.6)
    clicks = CAMERA.project(run.joints[0, [0, 1, 2]])
    bars = [word for place in 0.5 * (clicks[1:] + clicks[:-1]) for word in ("--bar", f"{place[0]:.1f},{place[1]:.1f}")]
    files = ["-o", tmp_path / "angles.nc", "--preview", tmp_path / "seen.mp4"]
    code, text, err = hyperflex("track", tmp_path / "pendulum.mp4", *bars, "--pivot", "158", "150", *files, "--json")
    kept = tmp_path / "angles-interrupted.nc"
    assert code == 130
    assert "after 8 frames" in err
    assert json.loads(text)["output"] == str(kept)
    assert len(hf.read_recording(kept).t) == 8
    assert read_netcdf(kept).attributes["interrupted"] == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == [kept.name, "pendulum.mp4"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--bar", "120,100"], "--pivot is missing"),
        (["--bar", "120", "--pivot", "1", "2"], "--bar is a pixel"),
        (["--bar", "120,100", "--pivot", "1", "2", "--at", "9"], "after the end of the video"),
        ([], "a rope with markers needs more"),
    ],
)
def test_what_is_missing_is_said(hyperflex, tmp_path, options, message):
    filmed(tmp_path / "pendulum.mp4", duration=0.2)
    code, out, err = hyperflex("track", tmp_path / "pendulum.mp4", *options, "-o", tmp_path / "angles.nc")
    assert (code, out) == (2, "")
    assert message in err
    assert not (tmp_path / "angles.nc").exists()
