"""Videos: time stamps against OpenCV's, rotation, and files that are broken in every way."""

import struct
import subprocess
import sys
import wave

import cv2
import numpy as np
import pytest

from hyperflex import FileProblem, InvalidInput
from hyperflex.vision import LiveCamera, VideoReader, VideoWriter
from tests.refusals import fails, refuses

SIZE = (160, 120)
TIMES = 0.3 + 0.033 * np.arange(60) + 0.012 * np.sin(np.arange(60))  # a rate that varies
UPRIGHT = struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)  # the display matrix of an MP4 track
TURNED = {90: (0, -65536, 65536, 0), 180: (-65536, 0, 0, -65536), -90: (0, 65536, -65536, 0)}  # counterclockwise


def pattern(shift=0):
    blocks = np.random.default_rng(0).integers(0, 255, (12, 16, 3)).astype(np.uint8)
    return np.roll(cv2.resize(blocks, SIZE, interpolation=cv2.INTER_CUBIC), shift, axis=1)


@pytest.fixture
def video(tmp_path):
    with VideoWriter(tmp_path / "swing.mp4", SIZE) as writer:
        for k, time in enumerate(TIMES):
            writer.write(pattern(k), time)
    return tmp_path / "swing.mp4"


def read(path):
    with VideoReader(path) as reader:
        return list(reader), reader


def test_times_are_those_of_the_container(video):
    """They are kept to 1/90000 s; index over frame rate would be seconds off in a longer video."""
    frames, reader = read(video)
    assert np.abs([f.time for f in frames] - TIMES).max() <= 0.5 / 90000 + 1e-12
    assert [f.index for f in frames] == list(range(60))
    assert reader.notes == []
    assert reader.image_size == SIZE
    assert max(np.abs(f.image.astype(float) - pattern(f.index)).mean() for f in frames) < 10.0  # H.264, half chroma
    capture = cv2.VideoCapture(str(video))  # counts from the first frame on
    stamps = [capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3 for _ in iter(lambda: capture.read()[0], False)]
    assert np.allclose(stamps, TIMES - TIMES[0], atol=1e-4)


@pytest.mark.parametrize(
    ("angle", "direction"), [(90, "right"), (180, "up"), (-90, "left")], ids=["left", "upside-down", "right"]
)
def test_rotation_is_obeyed_as_opencv_does(video, angle, direction):
    content = video.read_bytes()
    at = content.index(UPRIGHT, content.index(b"tkhd"))
    a, b, c, d = TURNED[angle]
    turned = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    video.write_bytes(content[:at] + turned + content[at + len(turned) :])
    frames, reader = read(video)
    assert (reader.rotation, reader.readout_direction) == (angle, direction)
    want = cv2.VideoCapture(str(video)).read()[1]
    assert frames[0].image.shape == want.shape
    assert np.abs(frames[0].image.astype(int) - want).max() <= 1  # the same decoder and conversion
    assert reader.image_size == want.shape[1::-1]
    assert np.abs(np.rot90(pattern(), angle // 90).astype(float) - want).mean() < 6.0


def test_the_rest_of_a_truncated_video_is_read_and_reported(video):
    content = video.read_bytes()
    video.write_bytes(content[: int(0.6 * len(content))])  # its index is at the front, so it opens
    frames, reader = read(video)
    assert 10 < len(frames) < 60
    assert any("lists 60 frames" in note for note in reader.notes)


def test_damaged_parts_are_omitted_and_reported(video):
    content = bytearray(video.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 2000] = bytes(2000)
    video.write_bytes(content)
    frames, reader = read(video)
    assert 30 < len(frames) < 60
    assert any("cannot be decoded" in note for note in reader.notes)
    assert (np.diff([frame.time for frame in frames]) > 0.0).all()


def without_index(path, video):
    content = video.read_bytes()
    at = content.index(b"moov")
    path.write_bytes(content[: at + 40])


def sound(path, video):
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(4000))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path, video: path.write_bytes(b""), "empty"),
        (lambda path, video: path.write_bytes(b"not a video " * 500), "cannot be read as a video"),
        (without_index, "cut off"),
        (sound, "contains no video, only audio"),
        (lambda path, video: path.mkdir(), "a folder"),
        (lambda path, video: None, "There is no video"),
    ],
    ids=["empty", "text", "without-index", "sound", "folder", "missing"],
)
def test_no_video_is_refused_by_name(video, tmp_path, make, message):
    make(tmp_path / "bad.mp4", video)
    fails(FileProblem, message, VideoReader, tmp_path / "bad.mp4")


def test_a_set_up_given_for_a_video_and_frames_beyond_any_camera_are_refused(video, tmp_path, monkeypatch):
    (tmp_path / "rope.toml").write_text("[rope]\nn_links = 50\nlength = 0.02\nmass = 0.0025\n" * 20)
    fails(FileProblem, r"rope.toml contains no video, but text \(.toml\)", VideoReader, tmp_path / "rope.toml")
    monkeypatch.setattr("hyperflex.vision.video._LARGEST", 10_000)
    fails(FileProblem, "too large", VideoReader, video)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda w: None, "no frame"),
        (lambda w: w.write(np.zeros((10, 10, 3), np.uint8), 0.0), "does not fit"),
        (lambda w: w.write(pattern(), -1.0), "wrong sign"),
        (lambda w: [w.write(pattern(), 1.0), w.write(pattern(), 1.0)], "no later"),
    ],
)
def test_writing_goes_wholly_or_not_at_all(tmp_path, write, message):
    (tmp_path / "out.mp4").write_bytes(b"before")
    with pytest.raises(InvalidInput, match=message), VideoWriter(tmp_path / "out.mp4", SIZE) as writer:
        write(writer)
    assert [p.name for p in tmp_path.iterdir()] == ["out.mp4"]
    assert (tmp_path / "out.mp4").read_bytes() == b"before"


def test_an_odd_size_is_made_even(tmp_path):
    with VideoWriter(tmp_path / "odd.mp4", (161, 119)) as writer:
        writer.write(np.full((119, 161, 3), 200, np.uint8), 0.0)
    frames, _ = read(tmp_path / "odd.mp4")
    assert frames[0].image.shape == (120, 162, 3)


def test_another_suffix_is_refused(tmp_path):
    refuses("mp4", VideoWriter, tmp_path / "out.avi", SIZE)


def test_real_video(data_dir):
    frames, reader = read(data_dir / "real_double_pendulum_video" / "pendulum.mp4")
    assert len(frames) > 170
    assert reader.notes == []
    assert np.allclose(np.diff([f.time for f in frames]), 0.033, atol=1e-3)


def test_live_source_gives_the_stamps_of_its_stream(video):
    with LiveCamera(str(video)) as camera:
        frames = list(camera)
    assert camera.stamps == "driver"
    assert np.allclose([f.time for f in frames], TIMES - TIMES[0], atol=1e-4)
    assert camera.notes == ["the source ended or stalled after 60 frames"]


@pytest.mark.parametrize("source", [63, "rtsp://127.0.0.1:9/none"])
def test_live_source_that_is_not_there(source):
    # a separate process: OpenCV reads FFmpeg's log level once in each
    program = f"from hyperflex.vision import LiveCamera; LiveCamera({source!r}, timeout=2.0)"
    ended = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    *trace, last = ended.stderr.splitlines()
    assert "FileProblem: There is no camera or stream" in last
    assert not any("Connection" in line for line in trace)  # the message says it, not FFmpeg as well


@pytest.mark.skipif(sys.platform != "linux", reason="the limit of a process's memory is Linux's")
def test_too_little_memory_is_reported(video):
    """FFmpeg, which then cannot start its threads, says "Resource temporarily unavailable"."""
    program = (
        "import resource, sys; from hyperflex.vision import VideoReader; import av; "
        "used = 4096 * int(open('/proc/self/statm').read().split()[0]); "
        "resource.setrlimit(resource.RLIMIT_AS, (used + 2**24, used + 2**24)); list(VideoReader(sys.argv[1]))"
    )
    done = subprocess.run([sys.executable, "-c", program, str(video)], capture_output=True, text=True, check=False)
    assert done.returncode
    assert "MemoryError: no room for a frame" in done.stderr
