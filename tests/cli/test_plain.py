"""A plain rope from a video and a length: questions that are open are named, answers are kept, the rope is tracked."""

import json
import shutil
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.cli.plain import QUESTIONS, Plain, PlainScene, answers_path
from hyperflex.cli.track import _tracked
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.estimate import DoubtKind, EstimatedParameter, Observations, RopeFilter, TrackingTask, curve_arc_lengths
from hyperflex.estimate.doubts import Doubt
from hyperflex.estimate.observations import UNMEASURED
from hyperflex.files import read_toml, write_toml
from hyperflex.vision import (
    Board,
    Camera,
    FoundRope,
    NoRope,
    Reason,
    Renderer,
    RopeLook,
    RopeMotion,
    Scene,
    VideoReader,
    VideoWriter,
    read_camera,
    srgb_tone,
)
from tests.estimate.runs import free_swing
from tests.refusals import refuses
from tests.vision.test_video import TURNED, UPRIGHT

CAMERA = Camera.facing((320, 240), pixels_per_metre=100.0, origin=(160.0, 10.0), exposure=0.002)
ANSWERS = ("--pivot", "160", "10", "--tip", "found", "--size", "rope", "--mass", "0.125")
COUNT = 12  # frames


def film(path: Path, *markers: float) -> Path:
    """Film a free swing of a finer rope, with markers at some arc lengths, m."""
    scene = Scene(markers, marker_diameter=0.07, rope_width=0.02, tone=srgb_tone())
    motion = RopeMotion.from_trajectory(free_swing(0, 4.0))
    Renderer(CAMERA, motion, scene).write(path, 0.05 + np.arange(COUNT) / 30.0)
    return path


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A free swing without markers."""
    return film(tmp_path_factory.mktemp("plain") / "phone.mp4")


@pytest.fixture
def folder(video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the video alone, in which the commands run."""
    shutil.copy(video, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_answers_are_kept_and_the_second_run_asks_nothing(hyperflex, hyperflex_json, folder):
    code, first = hyperflex_json("track", "phone.mp4", "--length", "2.0", *ANSWERS, "--exposure", "0.002")
    assert code == 0, first
    assert first["frames"] == COUNT
    assert first["doubts"] == []
    assert any(each.startswith("the exposure is 2 ms (--exposure)") for each in first["assumed"])
    kept = read_toml("phone.mp4.answers.toml")["answers"]
    answers = {"pivot": [160.0, 10.0], "tip": "found", "size": "rope", "mass": [0.125]}
    assert kept == {"exposure": 0.002, "length": 2.0, **answers}
    code, out, err = hyperflex("watch", "phone.mp4", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out.splitlines()[-1])["found"] >= COUNT - 1
    assert off_near_tip().max() < 0.03
    assert hf.Rope.from_toml("markers-rope.toml").total_length == pytest.approx(2.0, rel=0.02)
    assert read_camera("markers-camera.toml").pixels_per_metre == pytest.approx(100.0, rel=0.02)
    filmed_again(lambda image, k: image)  # a file of this name with other content
    code, out, err = hyperflex("track", "phone.mp4", "--json")
    assert code == 2
    assert "is about another video" in err
    assert "--length is missing" in err


def off_near_tip(track: str = "markers.nc") -> np.ndarray:
    """How far the last place of a track is off in each frame, m."""
    swing, found = free_swing(0, 4.0), hf.read_recording(track)
    near_tip = round(100 * 11.5 / 12)  # its joint
    truth = np.array([[np.interp(t, swing.t, swing.joints[:, near_tip, c]) for c in range(2)] for t in found.t])
    return np.hypot(*(found.data[:, -2:] - truth).T)


def test_a_few_markers_on_a_plain_rope_are_used_too(hyperflex_json, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    film(tmp_path / "phone.mp4", 0.5, 1.0, 1.5)
    marked = ("--length", "2.0", *ANSWERS, "--arc-lengths", "0.5,1.0,1.5", "--at", "0.1", "-o", "my track.nc")
    code, found = hyperflex_json("track", "phone.mp4", *marked)
    assert code == 0, found
    assert found["found_at_s"] >= 0.1
    assert found["frames"] < COUNT
    assert read_toml("phone.mp4.answers.toml")["answers"]["at"] == 0.1
    assert "identify 'my track.nc' --rope 'my track-rope.toml'" in found["next"]
    assert found["doubts"] == []
    assert found["seen"] > 0.9
    assert off_near_tip("my track.nc").max() < 0.03


def filmed_again(change):
    """Write the video again, each picture changed by its number."""
    with VideoReader("phone.mp4") as reader:
        changed = [(np.ascontiguousarray(change(each.image.copy(), k)), each.time) for k, each in enumerate(reader)]
    with VideoWriter("phone.mp4", changed[0][0].shape[1::-1]) as writer:
        for image, t in changed:
            writer.write(image, t)


def test_a_part_that_is_seldom_seen_is_named(hyperflex_json, folder):
    def hidden(image, k):
        image[150 if k >= 4 else 240 :] = image[0, 0]
        return image

    filmed_again(hidden)
    code, found = hyperflex_json("track", "phone.mp4", "--length", "2.0", *ANSWERS)
    assert code == 0, found
    (note,) = (each for each in found["notes"] if "was seen in less than 50% of the frames" in each)
    assert note.endswith("1.92 m was seen in less than 50% of the frames: check what hides it")


WALL = (175, 185, 190)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda image, k: np.full_like(image, WALL), "no rope is seen at the pivot"),
        (lambda image, k: np.minimum(image, np.roll(image[:, ::-1], 1, axis=1)), "two ropes are seen"),
        (lambda image, k: image[:120], "the rope leaves the view"),
    ],
    ids=["no rope", "two ropes", "leaves the view"],
)
def test_a_video_that_does_not_show_the_rope_is_refused_in_a_line(refused, folder, change, said):
    filmed_again(change)
    assert said in refused("track", "phone.mp4", "--length", "2.0", *ANSWERS)


def test_a_camera_that_moves_is_doubted(hyperflex_json, folder):
    filmed_again(lambda image, k: np.roll(image, 2 * k, axis=1))
    code, found = hyperflex_json("track", "phone.mp4", "--length", "2.0", *ANSWERS)
    assert code == 0, found
    (doubt,) = found["doubts"]
    assert doubt.startswith("the rope's first joint moves, by 0.06")
    assert any("(--pivot)" in each for each in found["notes"])
    assert "next" not in found


@pytest.fixture
def hanging(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder, with a rope of 2 m that is found straight below the pivot in any picture."""
    curve = np.stack([np.full(201, 160.0), 10.0 + np.arange(201.0)], axis=1)
    found = FoundRope(curve, RopeLook(np.zeros(3), 2.0))
    monkeypatch.setattr("hyperflex.vision.find_rope", lambda *_, **__: found)
    return folder


def first_image(at: float | None) -> np.ndarray:
    with VideoReader("phone.mp4") as reader:
        return next(each.image for each in reader if at is None or each.time >= at)


def test_a_known_rope_and_camera_replace_answers(refused, hanging):
    hf.Rope.uniform(2.0, 0.1, 20, friction=1e-3).to_toml("known.toml")
    replace(CAMERA, readout=0.003).write("camera.toml")
    known = {"rope": Path("known.toml"), "camera": Path("camera.toml")}
    found = Plain(tip="found").scene(first_image, hanging / "phone.mp4", **known)
    assert found.doubts.keys() == {"offset_x", "offset_y"}
    assert found.rope.n_links == 20
    assert (found.camera.readout, found.camera.exposure) == (0.003, 0.002)
    assert not found.by_rope
    replace(CAMERA.adjusted(scale=0.8)).write("camera.toml")
    refuses("--camera contradicts the rope's length", Plain().scene, first_image, hanging / "phone.mp4", **known)
    replace(CAMERA, image_size=(640, 480)).write("camera.toml")
    with pytest.raises(InvalidInput, match=r"another size than the camera's: got '320x240'\. Allowed: 640x480"):
        Plain().scene(first_image, hanging / "phone.mp4", **known)
    given = ("track", "phone.mp4", "--rope", "known.toml", "--camera", "camera.toml", "--length")
    assert "--length contradicts --rope: got 1.5. Allowed: 2" in refused(*given, "1.5")
    assert "--size and --camera are both given" in refused(*given, "2.0", "--size", "rope")


def test_a_free_end_that_is_not_found_is_asked_for():
    """A wrong pivot, from which no rope hangs, is refused at once."""
    curve = np.stack([np.full(401, 320.0), 20.0 + np.arange(401.0)], axis=1)

    def find(u, v, tip, size):
        if tip is None:
            raise NoRope(Reason.END if u == 320.0 else Reason.NOTHING, 400, "another")
        return FoundRope(curve, RopeLook(np.zeros(3), 2.0))

    scene = PlainScene(np.zeros((480, 640, 3), np.uint8), 2.0, 0.004, "down", find, {"pivot": [320.0, 20.0]})
    scene.check("pivot")
    asked = scene.asked(QUESTIONS[1])
    assert "No line is found: it is not clear where the rope ends" in asked.cost
    assert not asked.default
    clicked = replace(scene, answers=scene.answers | {"tip": [320.0, 420.0]})
    clicked.check("tip")
    assert clicked.asked(QUESTIONS[2]).line == curve.tolist()
    for name, answers in (("tip", scene.answers | {"tip": "found"}), ("pivot", {"pivot": [100.0, 20.0]})):
        with pytest.raises(NoRope):
            replace(scene, answers=answers).check(name)


def test_the_time_of_the_answers_is_kept_and_another_one_makes_a_clicked_tip_void(hanging):
    asked = []

    def picture(at):
        asked.append(at)
        return first_image(at)

    plain = Plain(length=2.0, pivot=(160.0, 10.0), tip="found", size="rope", mass="unknown")
    assert plain.scene(picture, hanging / "phone.mp4", at=0.2).at == 0.2
    assert Plain().scene(picture, hanging / "phone.mp4").at == 0.2
    assert asked == [None, 0.2, None, 0.2]
    with pytest.raises(InvalidInput, match="answers about the video are missing: got \\['tip'\\]"):
        Plain().scene(picture, hanging / "phone.mp4", at=0.1)


def test_answers_outweigh_a_camera_and_what_only_the_camera_tells_is_not_kept(hanging):
    CAMERA.write("camera.toml")

    def scene(**options):
        return Plain(**options).scene(first_image, hanging / "phone.mp4", camera=Path("camera.toml"))

    first = scene(length=2.0, tip="found", mass="unknown")
    assert (first.answers["pivot"], first.camera.exposure) == (pytest.approx([160.0, 10.0]), 0.002)
    kept = {"length": 2.0, "tip": "found", "mass": "unknown"}
    assert read_toml("phone.mp4.answers.toml")["answers"] == kept
    scene(pivot=(165.0, 12.0), exposure=0.001)
    again = scene()
    assert (again.answers["pivot"], again.camera.exposure) == ([165.0, 12.0], 0.001)
    assert read_toml("phone.mp4.answers.toml")["answers"] == kept | {"pivot": [165.0, 12.0], "exposure": 0.001}


def test_a_video_is_watched_from_the_time_of_its_answers_on(refused, hanging, monkeypatch):
    def watch(frames, *_, **__):
        raise InvalidInput(f"the first frame is at {frames.peek(9.0).time:.1f} s")

    monkeypatch.setattr("hyperflex.estimate.Watch", watch)
    monkeypatch.setattr(TrackingTask, "rehearse", lambda self: None)
    monkeypatch.setattr(TrackingTask, "tracker", lambda self: None)
    plain = Plain(length=2.0, pivot=(160.0, 10.0), tip="found", size="rope", mass="unknown")
    plain.scene(first_image, hanging / "phone.mp4", at=0.3)
    assert "the first frame is at 0.3 s" in refused("watch", "phone.mp4")


def test_answers_that_cannot_be_kept_are_said_as_options(hanging, monkeypatch, capsys):
    def write(path, content):
        raise FileProblem("the folder is read-only.")

    monkeypatch.setattr("hyperflex.files.write_toml", write)
    plain = Plain(length=2.0, pivot=(160.0, 10.0), tip="found", size="rope", mass="0.1")
    assert plain.scene(first_image, hanging / "phone.mp4").length == 2.0
    options = "--length 2.0 --pivot 160.0 10.0 --tip found --size rope --mass 0.1"
    assert f"the folder is read-only. Give these options next time: {options}" in capsys.readouterr().err


SHORT_ROPE = hf.Rope.uniform(0.5, 0.03, 4, 0.004, friction=1e-4)


def passes(monkeypatch, first: list[DoubtKind], second: BaseException | dict[str, tuple[float, float]]):
    """Return what is kept of a first pass with doubts and a second one, whose length contradicts, and what is free."""
    done = []

    @dataclass
    class Track:
        doubts: tuple[Doubt, ...]
        parameters: dict[str, tuple[float, float]]
        recording: SimpleNamespace

    def track(video, tracker, **follow):
        done.append(tracker)
        if len(done) == 2 and isinstance(second, BaseException):
            raise second
        kinds, found = (first, {}) if len(done) == 1 else (first or [DoubtKind.LENGTH], second)
        return Track(tuple(Doubt(each, 0.3) for each in kinds), found, SimpleNamespace(duration=9.0))

    monkeypatch.setattr("hyperflex.estimate.track_video", track)
    monkeypatch.setattr(TrackingTask, "tracker", lambda self: [each.name for each in self.parameters])
    parameters = [EstimatedParameter(name, std) for name, std in (("scale", 0.02), ("roll", 0.03), ("offset_x", 0.01))]
    task = TrackingTask(SHORT_ROPE, np.array([0.5]), CAMERA, [], parameters=parameters, look=SimpleNamespace())
    found, stopped = _tracked(Path("phone.mp4"), task, {"preview": None}, True)
    return found, stopped, done


def test_nothing_but_its_place_is_estimated_of_a_rope_that_hangs_still(monkeypatch):
    found, _, free = passes(monkeypatch, [DoubtKind.STILL], {"offset_x": (0.1, 0.02)})
    assert [each.kind for each in found.doubts] == [DoubtKind.STILL]
    assert free == [["scale", "roll", "offset_x"], ["offset_x"]]
    assert found.parameters.keys() == {"offset_x"}


@pytest.mark.parametrize(("scale", "roll", "kept"), [(0.2, 0.05, 2), (-0.35, 0.0, 1), (0.0, 0.1, 1)])
def test_another_length_is_kept_only_with_a_possible_camera(monkeypatch, scale, roll, kept):
    estimates = {"scale": (scale, 0.02), "roll": (roll, 0.01)}
    found, stopped, _ = passes(monkeypatch, [], estimates)
    assert found.parameters == (estimates if kept == 2 else {})
    (doubt,) = found.doubts
    assert doubt.kind is (DoubtKind.LENGTH if kept == 2 else DoubtKind.OTHER_LENGTH)
    assert ("+30.0%" in str(doubt)) is (kept == 2)  # the number is of what is kept
    assert not stopped


@pytest.mark.parametrize(("problem", "stops"), [(KeyboardInterrupt(), True), (InvalidInput("it was not found"), False)])
def test_a_second_pass_that_fails_leaves_the_first(monkeypatch, capsys, problem, stops):
    found, stopped, free = passes(monkeypatch, [], problem)
    assert (found.parameters, stopped, len(free)) == ({}, stops, 2)
    assert ("pass over the frames failed: it was not found" in capsys.readouterr().err) is not stops


@pytest.mark.parametrize("command", ["track", "watch"])
def test_the_rows_of_a_file_that_is_upside_down_follow_each_other_upwards(refused, folder, monkeypatch, command):
    content, (a, b, c, d) = Path("phone.mp4").read_bytes(), TURNED[180]
    at = content.index(UPRIGHT, content.index(b"tkhd"))
    turned = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    Path("phone.mp4").write_bytes(content[:at] + turned + content[at + len(turned) :])

    def scene(plain, picture, beside, direction="down", **known):
        raise InvalidInput(f"rows that follow each other {direction}, {known['rope']} and {known['camera']}")

    monkeypatch.setattr(Plain, "scene", scene)
    files = ("--rope", "known.toml", "--camera", "camera.toml")
    said = "rows that follow each other up, known.toml and camera.toml"
    assert said in refused(command, "phone.mp4", "--length", "2.0", *files)


@pytest.mark.parametrize("command", ["track", "watch"])
def test_answers_that_are_missing_are_named_and_nothing_hangs(hyperflex, folder, command):
    code, out, err = hyperflex(command, "phone.mp4", "--length", "2.0", "--pivot", "160", "10", "--json")
    assert code == 2
    assert json.loads(out)["type"] == "InvalidInput"
    for option in ("--tip found or u,v", "--size rope or u,v,u,v,", "--mass unknown or kg"):
        assert option in err
    assert "--pivot" not in err
    assert not answers_path(Path("phone.mp4")).exists()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"--pivot": ("900", "20")}, "--pivot is not in the picture"),
        (
            {"--tip": ("there",)},
            "--tip does not answer: Where is the rope's free end?: got 'there'. Allowed: found or u,v.",
        ),
        ({"--size": ("1,2,3,4",)}, "--size does not answer: What tells the size of the picture?"),
        ({"--size": ("0,0,50,0,-1.0",)}, "--size"),
        ({"--size": ("5,5,5,5,1.0",)}, "--size: its two points are the same"),
        ({"--tip": ("nan,nan",)}, "--tip is not in the picture"),
        ({"--size": ("0,0,50,0,1000",)}, "--size makes an impossible picture"),
        ({"--size": ("0,0,50,0,0.6",)}, "--size contradicts the rope's length: got '2.4"),
        ({"--tip": ("160,100",), "--size": ("0,0,50,0,0",)}, "--size"),
        ({"--mass": ("0",)}, "--mass"),
        ({"--length": ("-1",)}, "--length"),
    ],
)
def test_an_impossible_answer_is_refused(refused, folder, changed, said):
    given = {"--length": ("2.0",), "--pivot": ("160", "10"), "--tip": ("found",), "--size": ("rope",)}
    words = [word for name, values in (given | {"--mass": ("1",)} | changed).items() for word in (name, *values)]
    assert said in refused("track", "phone.mp4", *words)
    assert not Path("phone.mp4.answers.toml").exists()


def film_whole_swing(first: float = 0.5, last: float = 0.9):
    """Film a rope of 0.5 m that swings for 1.6 s, longer than its period, from angles of its links, rad."""
    short = hf.Rope.uniform(0.5, 0.03, 40, 0.004, friction=1e-4)
    swing = hf.simulate(short, duration=1.7, q0=np.linspace(first, last, 40), t_eval=np.arange(0.0, 1.7, 2e-3))
    camera = Camera.facing((320, 240), pixels_per_metre=320.0, origin=(160.0, 30.0), exposure=0.002)
    stamps = np.arange(48) / 30.0
    scene = Scene([], rope_width=0.008, tone=srgb_tone())
    Renderer(camera, RopeMotion.from_trajectory(swing), scene).write("phone.mp4", stamps)


SHORT = ("--pivot", "160", "30", "--tip", "found", "--size", "rope", "--mass", "unknown")


@pytest.mark.nightly
@pytest.mark.parametrize(("length", "said"), [(0.45, 0.11), (0.55, -0.09)])
def test_a_wrong_length_is_said(hyperflex_json, tmp_path, monkeypatch, length, said):
    monkeypatch.chdir(tmp_path)
    film_whole_swing()
    code, found = hyperflex_json("track", "phone.mp4", "--length", length, *SHORT, "--preview", "seen.mp4")
    assert code == 0, found
    (doubt,) = found["doubts"]
    before, _, part = doubt.rpartition(" ")
    assert before == "the rope swings as one whose length differs from the given one by"
    assert float(part[:-1]) / 100.0 == pytest.approx(said, abs=0.02)
    assert abs(found["estimated"]["readout"]["value"]) < 0.5e-3  # the pictures are exposed at once
    mass = hf.Rope.from_toml("markers-rope.toml").total_mass
    assert any(each.startswith(f"the rope weighs {mass:.3g} kg") for each in found["assumed"])
    assert {each.name for each in tmp_path.glob("*.mp4")} == {"phone.mp4", "seen.mp4"}


@pytest.mark.nightly
def test_a_camera_that_pans_for_a_whole_swing_is_no_wrong_length(hyperflex_json, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    film_whole_swing()
    filmed_again(lambda image, k: np.roll(image, -k, axis=1))
    code, found = hyperflex_json("track", "phone.mp4", "--length", "0.5", *SHORT)
    assert code == 0, found
    assert "length" not in found["doubts"][0]


@pytest.mark.nightly
def test_a_rope_that_hangs_still_is_said_to(hyperflex_json, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    film_whole_swing(0.0, 0.0)
    code, found = hyperflex_json("track", "phone.mp4", "--length", "0.5", *SHORT)
    assert code == 0, found
    (doubt,) = found["doubts"]
    assert doubt.startswith("the rope hangs still")
    assert not found["estimated"].keys() & {"length", "scale", "roll"}
    assert found["assumed"][:2] == ["the camera is level", "the scale is as answered"]
    assert "next" not in found


def test_a_file_that_holds_no_answers_is_refused(refused, folder):
    write_toml("phone.mp4.answers.toml", {"answers": {}})
    assert "contains no answers on a video" in refused("track", "phone.mp4", "--length", "2.0")


def scene(image: np.ndarray, size: str | list[float], find=None) -> PlainScene:
    answers = {"pivot": [320.0, 20.0], "tip": "found", "size": size, "mass": "unknown"}
    return PlainScene(image, 2.0, 0.002, "down", find or (lambda *_: None), answers)


@pytest.mark.parametrize(("size", "length"), [("rope", None), ([100.0, 50.0, 100.0, 150.0, 0.5], pytest.approx(400.0))])
def test_the_rope_is_searched_with_its_length_where_the_scale_is_known(size, length):
    """2 m at 200 px/m."""
    searched = []
    _ = scene(np.full((480, 640, 3), 128, np.uint8), size, lambda *given: searched.append(given)).found
    assert searched == [(320.0, 20.0, None, length)]


@pytest.mark.nightly
def test_friction_of_the_first_joint_is_not_taken_for_a_readout():
    """Exact offsets of a rope of 80 links, 4 s, exposed at once. Before its first link was cut: -1.6 +- 0.3 ms."""
    true = hf.with_links(hf.Rope.uniform(1.6, 0.1, 20, 0.0025, friction=3e-4, drag_coefficient=1.2), 80)
    swing = hf.simulate(true, duration=4.1, q0=np.linspace(0.6, 1.1, 80), t_eval=np.arange(0.0, 4.1, 2e-3), tol=1e-9)
    motion, camera = (
        RopeMotion.from_trajectory(swing),
        Camera.facing((1280, 720), pixels_per_metre=284.0, origin=(320.0, 20.0)),
    )
    found = SimpleNamespace(look=SimpleNamespace(width=1.4))
    line = replace(scene(np.zeros((720, 1280, 3), np.uint8), [0.0, 0.0, 284.0, 0.0, 1.0], lambda *_: found), length=1.6)
    arcs = curve_arc_lengths(line.rope)
    doubts = [EstimatedParameter(name, std) for name, std in line.doubts.items()]
    follower = RopeFilter(line.rope, arcs, camera=camera, parameters=doubts)
    for t in np.arange(0.0, 4.0, 1.0 / 30.0):
        before, places, after = (camera.project(motion.places([t], arcs + shift)[0]) for shift in (-0.01, 0.0, 0.01))
        tangents = (after - before) / np.linalg.norm(after - before, axis=1, keepdims=True)
        across = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
        ways, along = np.concatenate([across[:-1], tangents[-1:]]), np.concatenate([tangents[:-1], across[-1:]])
        wide = np.einsum("kc,kd->kcd", ways, ways) + (2.0 * UNMEASURED) ** 2 * np.einsum("kc,kd->kcd", along, along)
        wide *= np.append(np.full(40, 0.03**2), 0.7**2)[:, None, None]  # px^2
        first = 9.0 * np.eye(2) if follower.t is None else wide
        rows = camera.readout_share(places) - 0.5
        follower.update(Observations(t, places, rows=rows, covariances=first))
    readout, std = follower.values["readout"]
    assert std < 0.4e-3
    assert abs(readout) < 2.0 * std


def test_a_rope_that_is_seen_too_short_is_named():
    """0.5 m is seen of 2 m."""

    def find(u, v, tip, length):
        if length is not None:
            raise NoRope(Reason.LENGTH, length, "")
        return SimpleNamespace(curve=np.array([[u, v], [u, v + 50.0]]))

    with pytest.raises(InvalidInput, match=r"--size contradicts the rope's length: got '0\.5 m in the picture'"):
        scene(np.zeros((480, 640, 3), np.uint8), [0.0, 0.0, 100.0, 0.0, 1.0], find).check("size")


def test_the_size_of_the_picture_is_known_by_points_a_sheet_or_a_board():
    image = np.full((480, 640, 3), 128, np.uint8)
    near = scene(image, [100.0, 50.0, 100.0, 80.0, 0.15])
    assert near.camera.pixels_per_metre == pytest.approx(200.0)
    assert near.doubts["scale"] == pytest.approx(np.hypot(0.02, np.sqrt(2.0) / 30.0))  # each point is a pixel off
    assert scene(image, [100.0, 50.0, 100.0, 150.0, 0.5]).camera.pixels_per_metre == pytest.approx(200.0)
    corners = [100.0, 100.0, 142.0, 100.0, 100.0, 159.4, 142.0, 159.4]  # in reading order
    assert scene(image, corners).camera.pixels_per_metre == pytest.approx(200.0, rel=1e-3)
    with pytest.raises(InvalidInput, match="not the corners of an A4 sheet"):
        _ = scene(image, [*corners[:5], 142.0, 142.0, 142.0]).camera
    with pytest.raises(InvalidInput, match="no chessboard was found"):
        _ = scene(image, [7.0, 5.0, 0.03]).camera
    board = Board((7, 5), 0.1).draw(20)
    image[100:200, 200:340] = board[..., None]
    image[90:100, 190:350] = image[200:210, 190:350] = image[90:210, 190:200] = image[90:210, 340:350] = 255
    camera = scene(image, [7.0, 5.0, 0.1]).camera
    assert camera.pixels_per_metre == pytest.approx(200.0, rel=0.01)
    assert camera.project([[0.0, 0.0]])[0] == pytest.approx([320.0, 20.0], abs=1e-6)
    assert abs(camera.plane_view.roll) < 2.0
