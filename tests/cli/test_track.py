"""``hyperflex watch`` and ``track``: ropes and bars, what programs get from them, videos as bad as they come."""

import json
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest

import hyperflex as hf
from hyperflex.cli import output
from hyperflex.estimate import VideoTrack
from hyperflex.files import read_netcdf
from hyperflex.vision import VideoReader, VideoWriter
from tests.estimate.filmed import ARCS, COUNT, facing, film_swing
from tests.estimate.runs import free_swing, rope
from tests.estimate.test_bars import CAMERA, filmed


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A free swing of a finer rope, the rope, and the camera."""
    path = tmp_path_factory.mktemp("watch")
    film_swing(path / "swing.mp4")
    rope(20).to_toml(path / "rope.toml")
    facing().write(path / "camera.toml")
    return path


def words(command: str, video: Path, folder: Path, out: Path, *more: object, camera: str = "camera.toml") -> list[str]:
    place = ["track", video] if command == "track" else ["watch", video]
    named = ["--rope", folder / "rope.toml", "--camera", folder / camera, "--arc-lengths", ",".join(map(str, ARCS))]
    return [str(each) for each in [*place, *named, "-o", out, *more]]


def lines(text: str) -> list[dict[str, Any]]:
    return [json.loads(each) for each in text.splitlines()]


def test_a_line_for_each_frame_and_a_summary(hyperflex, folder, tmp_path):
    arguments = words("watch", folder / "swing.mp4", folder, tmp_path / "log.nc", "--preview", tmp_path / "seen.mp4")
    code, out, err = hyperflex(*arguments, "--estimate", "scale=0.01", "--json")
    assert (code, err) == (0, "")
    *estimates, summary = lines(out)
    assert len(estimates) == summary["frames"] == summary["found"] == COUNT
    assert all(each["found"] and each["frame"] and each["seen"] == each["markers"] == 8 for each in estimates)
    assert [len(each[name]) for each in estimates[:1] for name in ("tip", "q", "qd")] == [2, 20, 20]
    assert all(0.0 < each["tip_std"] < 0.1 and each["age"] == 0.0 and each["latency"] > 0.0 for each in estimates)
    assert (summary["ending"], summary["interrupted"]) == ("the source ended", False)
    assert abs(summary["estimated"]["scale"]["value"]) < 0.02
    assert 0.0 < summary["latency_s"]["median"] <= summary["latency_s"]["p99"]
    kept = read_netcdf(tmp_path / "log.nc")
    np.testing.assert_array_equal(kept.variables["t"].values, [each["t"] for each in estimates])
    np.testing.assert_array_equal(kept.variables["tip"].values, [each["tip"] for each in estimates])
    with VideoReader(tmp_path / "seen.mp4") as seen:
        assert sum(1 for _ in seen) == COUNT
    code, out, _ = hyperflex(*words("watch", folder / "swing.mp4", folder, tmp_path / "log.nc"))
    assert code == 0
    for said in (f"frames {COUNT}", "seen 1 ", "ending the source ended", "latency median 0.0"):
        assert said in " ".join(out.split())


def test_it_stops_in_time(hyperflex, folder, tmp_path):
    arguments = words("watch", folder / "swing.mp4", folder, tmp_path / "log.nc", "--page", 0, "--duration", 0.4)
    code, out, err = hyperflex(*arguments, "--json")
    assert code == 0
    assert "pictures at http://127.0.0.1:" in err
    summary = lines(out)[-1]
    assert summary["ending"] == "stopped after 0.4 s"
    assert 2 <= summary["frames"] < COUNT - 5  # at its own speed


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)])
@pytest.mark.skipif(sys.platform == "win32", reason="signals cannot be sent to one process")
def test_an_interrupted_run_is_kept(folder, tmp_path, number):
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code += "from hyperflex.cli import main; main()"
    more = ["--page", "0", "--preview", str(tmp_path / "seen.mp4"), "--json"]
    arguments = words("watch", folder / "swing.mp4", folder, tmp_path / "log.nc", *more)
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        first = program.stdout.readline()
        assert json.loads(first)["t"] >= 0.0
        program.send_signal(number)
        rest, err = program.communicate(timeout=60.0)
    assert program.returncode == 128 + number
    assert "Interrupted; the log is kept" in err
    end = lines(rest)[-1]
    assert end["error"] == "interrupted"
    kept = read_netcdf(tmp_path / "log.nc")
    assert (kept.attributes["interrupted"], kept.attributes["ending"]) == (1, "interrupted")
    assert kept.variables["t"].values[0] == json.loads(first)["t"]
    with VideoReader(tmp_path / "seen.mp4") as seen:
        assert sum(1 for _ in seen) >= 1
    assert sorted(each.name for each in tmp_path.iterdir()) == ["log.nc", "seen.mp4"]


BOTH = pytest.mark.parametrize("command", ["track", "watch"])


@BOTH
@pytest.mark.parametrize("kind", ["cut off", "noise"])
def test_a_video_that_is_damaged_within_is_followed(hyperflex, folder, tmp_path, command, kind):
    """The pictures' data end early, or are noise for a while: what can be decoded is followed, and that is said."""
    whole = bytearray((folder / "swing.mp4").read_bytes())
    begin = whole.find(b"mdat")
    assert 0 < begin < len(whole) // 4
    at = begin + int(0.6 * (len(whole) - begin))
    if kind == "cut off":
        del whole[at:]
    else:
        whole[at : at + 3000] = np.random.default_rng(1).bytes(3000)
    (tmp_path / "bad.mp4").write_bytes(whole)
    code, out, _ = hyperflex(*words(command, tmp_path / "bad.mp4", folder, tmp_path / "out.nc", "--json"))
    assert code == 0
    if command == "track":
        result = json.loads(out)
        said = " ".join(result["notes"])
    else:
        *estimates, result = lines(out)
        said = " ".join(words for each in estimates for words in each["messages"])
        assert all(each["found"] for each in estimates)
    assert COUNT // 4 < result["frames"] <= COUNT
    assert f"the file lists {COUNT} frames" in said or "cannot be decoded" in said


def test_the_colour_is_taken_where_there_is_one(hyperflex, folder, tmp_path):
    """The first frames are dark; a pixel of a marker is of a frame that is named by its time."""
    with VideoReader(folder / "swing.mp4") as bright, VideoWriter(tmp_path / "dark.mp4", (640, 480)) as video:
        for frame in bright:
            video.write(frame.image if frame.index >= 4 else np.zeros_like(frame.image), frame.time)
    given = words("track", tmp_path / "dark.mp4", folder, tmp_path / "out.nc", "--json")
    code, out, err = hyperflex(*given)
    assert (code, err) == (0, "")
    assert json.loads(out)["seen"] > 0.8
    u, v = facing().project(free_swing(0, 4.0).joints[round(0.317 * 600.0)])[-1]
    clicked = [*given, "--click", f"{u},{v}"]
    assert hyperflex(*clicked)[0] == 2
    assert hyperflex(*clicked, "--at", "0.31")[0] == 0


def test_markers_of_two_colours_are_shown_by_a_pixel_of_each(hyperflex_json, folder, tmp_path):
    colours = np.where(np.arange(len(ARCS))[:, None] % 2, (60.0, 165.0, 20.0), (40.0, 30.0, 205.0))
    pixels = film_swing(tmp_path / "two.mp4", marker_colours=colours).pixels[0]
    clicks = [word for place in pixels[:2].tolist() for word in ("--click", "{:.0f},{:.0f}".format(*place))]
    code, told = hyperflex_json(*words("track", tmp_path / "two.mp4", folder, tmp_path / "out.nc", *clicks))
    assert (code, told["seen"] > 0.95) == (0, True)


@BOTH
def test_a_raw_stream_is_refused(refused, folder, tmp_path, command):
    """Without a container there are no time stamps."""
    with av.open(str(folder / "swing.mp4")) as video, av.open(str(tmp_path / "raw.h264"), "w", format="h264") as raw:
        copy = raw.add_stream_from_template(video.streams.video[0])
        for packet in video.demux(video=0):
            if packet.dts is not None:
                packet.stream = copy
                raw.mux(packet)
    for more in ((), ("--click", "320,70")):
        err = refused(*words(command, tmp_path / "raw.h264", folder, tmp_path / "out.nc", *more))
        assert "have no time stamps" in err
        assert "ffmpeg -framerate 30 -i raw.h264 -c copy raw.mp4" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--estimate", "scale"), "--estimate names a parameter without a number: got 'scale'"),
        (("--estimate", "scale=0.01,delay="), "without a number: got 'delay='"),
        (("--estimate", "scale=much"), "--estimate is not made of numbers"),
        (("--arc-lengths", "1.0"), "arc lengths of markers do not increase: 1 m comes after 2 m"),
    ],
)
@BOTH
def test_options_that_cannot_be(refused, folder, tmp_path, command, options, message):
    assert message in refused(*words(command, folder / "swing.mp4", folder, tmp_path / "out.nc", *options))
    assert not (tmp_path / "out.nc").exists()


def test_what_was_never_seen_and_what_was_estimated_is_reported(hyperflex, folder, tmp_path):
    arguments = words(
        "track", folder / "swing.mp4", folder, tmp_path / "out.nc", "--estimate", "scale=0.02,length=0.02"
    )
    arguments[arguments.index("--arc-lengths") + 1] = ",".join(map(str, [0.1, *ARCS]))
    code, out, _ = hyperflex(*arguments)
    assert code == 0
    assert re.search(r"markers +8\n", out)
    assert "the marker at 0.1 m was never seen: check its arc length and colour, or omit it from --arc-lengths" in out
    assert "applied to the places of all frames: scale" in out
    assert "of the rope, not of the places. To identify it: lengths in the rope's file times" in out


@pytest.mark.parametrize("scale", [150.0, 260.0])
def test_a_wrong_scale_is_refused_or_admitted(hyperflex, folder, tmp_path, scale):
    """A third off: markers further apart than the rope between them, or a rope that is bent where none is.

    The first is refused. The second cannot be detected in one picture; then the observed motion is far from a possible
    one, and the noise level is large (1 is the detector's value).
    """
    facing(scale=scale).write(folder / "wrong.toml")
    arguments = words("track", folder / "swing.mp4", folder, tmp_path / "out.nc", "--json", camera="wrong.toml")
    code, out, _ = hyperflex(*arguments)
    result = json.loads(out)
    if scale < 200.0:
        assert code == 2
        assert "not found in the video" in result["error"]
        assert "swing plane" in result["error"]
    else:
        assert code == 0
        assert result["noise_level"] > 2.0
        assert "check the camera's scale" in " ".join(result["notes"])


def test_a_rope_that_begins_elsewhere_is_reported_in_the_first_line(hyperflex, folder, tmp_path):
    """The origin is 0.5 m above the hook, as the axis of an arm: each marker would be taken for one two places off.

    Places are then from that origin.
    """
    facing().with_origin([320.0, -80.0]).write(folder / "above.toml")
    arguments = words("track", folder / "swing.mp4", folder, tmp_path / "markers.nc", camera="above.toml")
    code, out, err = hyperflex(*arguments)
    assert code == 0, err
    assert "with doubts: the rope's first joint is 0.5 m from the camera's origin" in " ".join(out.split())
    recording = hf.read_recording(tmp_path / "markers.nc")
    run, ends = free_swing(0, 4.0), np.linspace(0.0, 2.0, 101)
    row = int(np.abs(run.t - recording.t[10]).argmin())
    true = np.stack([np.interp(ARCS, ends, run.joints[row, :, c]) for c in (0, 1)], axis=1) - [0.0, 0.5]
    assert np.nanmax(np.abs(recording.data[10].reshape(-1, 2) - true)) < 0.01


def test_markers_out_of_view(hyperflex, folder, tmp_path):
    """The picture ends above the lower half of the rope: the part below is less certain, and this is reported."""
    cut = facing((640, 240))
    cut.write(folder / "cut.toml")
    film_swing(tmp_path / "cut.mp4", cut, count=3 * COUNT)
    code, out, _ = hyperflex(
        *words("watch", tmp_path / "cut.mp4", folder, tmp_path / "out.nc", "--json", camera="cut.toml")
    )
    assert code == 0
    swing, found = free_swing(0, 4.0), [each for each in lines(out)[:-1] if each["found"]]
    assert len(found) > COUNT  # for a second it waits for a frame that shows the whole rope
    assert max(each["seen"] for each in found) < 8
    off = [np.linalg.norm(each["tip"] - swing.joints[round(each["t"] * 600.0), -1]) for each in found]
    std = np.array([each["tip_std"] for each in found])
    assert std[0] > 0.1  # the tip's own marker is not seen
    assert (np.array(off) < 3.5 * std).mean() > 0.95


def test_two_ropes(hyperflex, folder, tmp_path):
    """Another rope with the same markers hangs half a metre away: ours, which hangs from the origin, is tracked."""
    other = film_swing(tmp_path / "other.mp4", seed=3).pixels
    with VideoReader(folder / "swing.mp4") as ours, VideoWriter(tmp_path / "two.mp4", (640, 480)) as both:
        for frame, places in zip(ours, other, strict=True):
            image = frame.image.copy()
            for u, v in places - [120.0, 0.0]:
                cv2.circle(image, (round(u), round(v)), 4, (40, 30, 210), -1, cv2.LINE_AA)
            both.write(image, frame.time)
    assert hyperflex(*words("watch", tmp_path / "two.mp4", folder, tmp_path / "out.nc", "--json"))[0] == 0
    swing, kept, ends = free_swing(0, 4.0), read_netcdf(tmp_path / "out.nc").variables, np.linspace(0.0, 2.0, 101)
    for t, row in zip(kept["t"].numbers("t"), kept["places"].numbers("places"), strict=True):
        joints = swing.joints[round(t * 600.0)]
        true = np.stack([np.interp(ARCS, ends, joints[:, c]) for c in (0, 1)], axis=1)
        off = np.linalg.norm(row - true, axis=1)
        assert not (off > 0.1).any(), (t, off)  # the other one is half a metre away


@BOTH
def test_no_markers(refused, folder, tmp_path, command):
    rng = np.random.default_rng(0)
    with VideoWriter(tmp_path / "wall.mp4", (640, 480)) as video:
        for k in range(5):
            video.write(rng.integers(120, 130, (480, 640, 3), dtype=np.uint8), k / 30.0)
    assert "bug" not in refused(*words(command, tmp_path / "wall.mp4", folder, tmp_path / "out.nc"))
    assert not (tmp_path / "out.nc").exists()


# ---- bars


@pytest.fixture
def pendulum(tmp_path, monkeypatch):
    """The words of a command that tracks a rendered pendulum, which is filmed in the working directory."""
    monkeypatch.chdir(tmp_path)
    run, _ = filmed(tmp_path / "pendulum.mp4", duration=0.6)
    clicks = CAMERA.project(run.joints[0, [0, 1, 2]])
    bars = [word for u, v in 0.5 * (clicks[1:] + clicks[:-1]) for word in ("--bar", f"{u:.1f},{v:.1f}")]
    return ["track", "pendulum.mp4", *bars, "--pivot", "158", "150", "-o", "angles.nc"]


def test_a_video_of_bars_becomes_angles(hyperflex, pendulum):
    code, text, err = hyperflex(*pendulum, "--preview", "seen.mp4", "--json")
    assert (code, err) == (0, "")
    said, recording = json.loads(text), hf.read_recording("angles.nc")
    assert (recording.kind, said["frames"], min(said["seen"]) > 0.9) == ("angles", len(recording.t), True)
    with VideoReader("seen.mp4") as video:
        assert len(list(video)) == said["frames"]


def test_ctrl_c_keeps_what_was_tracked_under_a_name_that_reports_it(hyperflex, pendulum, tmp_path, monkeypatch):
    @contextmanager
    def hit_at_frame_8():
        def said(words):
            if words == "frame 8":
                raise KeyboardInterrupt

        yield said

    monkeypatch.setattr(output, "spinner", hit_at_frame_8)
    code, text, err = hyperflex(*pendulum, "--preview", "seen.mp4", "--json")
    assert (code, "after 8 frames" in err, json.loads(text)["output"]) == (130, True, "angles-interrupted.nc")
    assert json.loads(text)["preview"] is None
    assert len(hf.read_recording("angles-interrupted.nc").t) == 8
    assert read_netcdf("angles-interrupted.nc").attributes["interrupted"] == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["angles-interrupted.nc", "pendulum.mp4"]


def test_ctrl_c_in_a_second_pass_leaves_the_first_under_its_name(hyperflex_json, folder, tmp_path, monkeypatch):
    whole = hf.Recording([0.0, 0.1], np.zeros((2, 4)), kind="markers")
    found = VideoTrack(whole, np.array([0.5, 1.0]), 2, 0.0, 1.0, {}, SimpleNamespace(level=1.0), (), ())
    monkeypatch.setattr("hyperflex.cli.track._tracked", lambda *_: (found, True))
    code, told = hyperflex_json(*words("track", folder / "swing.mp4", folder, tmp_path / "markers.nc"))
    assert (code, told["output"]) == (130, str(tmp_path / "markers.nc"))
    assert told["message"].startswith("A further pass over the frames was interrupted; the track of the first one")
    assert [each.name for each in tmp_path.iterdir()] == ["markers.nc"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--bar", "120,100"], "--pivot is missing"),
        (["--bar", "120", "--pivot", "1", "2"], "--bar is a pixel"),
        (["--bar", "120,100", "--pivot", "1", "2", "--at", "9"], "after the end of the video"),
        ([], "a rope with markers needs more"),
    ],
)
def test_what_bars_lack_is_reported(refused, tmp_path, options, message):
    filmed(tmp_path / "pendulum.mp4", duration=0.2)
    assert message in refused("track", tmp_path / "pendulum.mp4", *options, "-o", tmp_path / "angles.nc")
    assert not (tmp_path / "angles.nc").exists()
