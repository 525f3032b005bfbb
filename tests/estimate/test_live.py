"""Live: sources that stall, end, change their size or drop frames; the process that estimates."""

import itertools
import os
import signal
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import wait
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import EstimatorLost, FileProblem
from hyperflex.estimate import (
    CameraStateSource,
    ChangeTests,
    EstimatedParameter,
    FrameThread,
    LiveEstimate,
    MarkerMeasurement,
    RopeFilter,
    RopeTracker,
    TrackingTask,
    Watch,
    WatchLog,
    curve_arc_lengths,
    measurements,
    open_frames,
)
from hyperflex.estimate.live.frames import Arrival
from hyperflex.estimate.live.page import PicturePage
from hyperflex.estimate.live.state_source import Packet, StampClock
from hyperflex.files import read_netcdf
from hyperflex.vision import (
    Camera,
    FoundRope,
    Frame,
    MarkerColour,
    MarkerDetector,
    Renderer,
    RopeLook,
    RopeMotion,
    Scene,
    VideoReader,
    VideoWriter,
)
from tests.estimate.filmed import ARCS, facing, film_swing
from tests.estimate.runs import ARM, SWINGS, free_swing, rope
from tests.refusals import refuses

FRAMES = 40


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, MarkerColour]:
    """A free swing at 30 frames/s."""
    path = tmp_path_factory.mktemp("live") / "swing.mp4"
    pixels = film_swing(path, count=2 * FRAMES).pixels
    with VideoReader(path) as reader:
        return path, MarkerColour.from_click(next(iter(reader)).image, pixels[0, 3])


@pytest.fixture(scope="module")
def pictures(video: tuple[Path, MarkerColour]) -> list[Frame]:
    with VideoReader(video[0]) as reader:
        return list(itertools.islice(reader, FRAMES))


def tracker(video: tuple[Path, MarkerColour]) -> RopeTracker:
    return RopeTracker(RopeFilter(rope(20), ARCS, camera=facing()), MarkerMeasurement(MarkerDetector(video[1])))


class Scripted:
    """A source that provides frames, and executes the given actions in between: a number is a pause, s."""

    def __init__(self, *script: Frame | float | Exception) -> None:
        self.script, self.notes, self.closed = script, [], False
        self.image_size = next(each.image.shape[1::-1] for each in script if isinstance(each, Frame))

    def __iter__(self) -> Iterator[Frame]:
        for each in self.script:
            if isinstance(each, Exception):
                raise each
            if isinstance(each, float):
                time.sleep(each)
            else:
                yield each

    def close(self) -> None:
        self.closed = True


def watched(video: tuple[Path, MarkerColour], source: Scripted, interval: float = 30.0) -> list[LiveEstimate]:
    """All reports of a source that is watched until it ends."""
    with FrameThread(lambda: source, live=False) as frames:
        return list(Watch(frames, tracker(video), interval=interval))


def watched_file(video: tuple[Path, MarkerColour], count: int, **options: object) -> list[LiveEstimate]:
    """The first reports of a file that is watched."""
    with open_frames(str(video[0])) as frames:
        return list(itertools.islice(Watch(frames, tracker(video), interval=30.0, **options), count))


def test_every_frame_has_an_estimate(video, pictures):
    found = watched_file(video, FRAMES)
    assert [each.frame.time for each in found if each.frame] == [each.time for each in pictures]
    assert all(each.found and each.age == 0.0 and each.seen == 8 and not each.messages for each in found)
    swing = free_swing(0, 4.0)
    true = [swing.joints[round(each.t * 600.0), -1] for each in found[10:]]
    off = np.linalg.norm([each.tip - place for each, place in zip(found[10:], true, strict=True)], axis=1)
    assert np.sqrt((off**2).mean()) < 0.01  # a pixel is 5 mm; 20 links for 100
    assert all(0.0 < each.tip_std < 0.02 for each in found[10:])


def test_the_rope_is_searched_only_when_that_is_allowed(video):
    """An arm whose motion is not known yet: its rope may be anywhere."""
    allowed = iter([False] * 5 + [True] * 5)
    assert [each.found for each in watched_file(video, 10, before=lambda: next(allowed))] == [False] * 5 + [True] * 5


def test_a_stall_is_reported_and_bridged(video, pictures):
    """Half a second and more without a frame: estimates go on, older and less sure; then frames come again."""
    source = Scripted(*pictures[:10], 0.8, *[Frame(f.time + 0.8, f.image, f.index) for f in pictures[33:36]])
    found = watched(video, source, 0.05)
    blind = [each for each in found if each.frame is None]
    assert len(blind) > 5
    assert all(each.found and each.seen == 0 for each in blind)
    assert np.all(np.diff([each.age for each in blind]) > 0.0)
    assert blind[-1].age == pytest.approx(blind[-1].t - found[9].t, abs=1e-6)
    assert blind[-1].tip_std > blind[0].tip_std > found[9].tip_std
    messages = " ".join(words for each in found for words in each.messages)
    assert "no frame for" in messages
    assert "frames come again" in messages
    assert source.closed


def test_dropped_frames_and_another_size_are_reported(video, pictures):
    small = [Frame(each.time, np.zeros((240, 320, 3), np.uint8), each.index) for each in pictures]
    source = Scripted(*pictures[:8], *pictures[11:14], *small[14:17], *pictures[17:20])
    found = watched(video, source)
    assert len(found) == 17
    assert found[8].messages == (f"3 frames missing before {pictures[11].time:.3f} s",)
    assert "frames of 320x240 px are skipped" in found[11].messages[0]
    assert [each.tracked is None for each in found[11:14]] == [True] * 3
    assert all(each.found for each in found)  # the rope's equations continue
    assert found[13].age == pytest.approx(pictures[16].time - pictures[13].time, abs=1e-9)
    assert "640x480 px again" in found[14].messages[0]
    assert found[-1].seen == 8
    assert found[-1].age == 0.0


def test_a_long_gap_is_not_bridged(video, pictures):
    dark = np.zeros((480, 640, 3), np.uint8)
    later = [Frame(each.time + 600.0, each.image if k else dark, each.index) for k, each in enumerate(pictures[:3])]
    source = Scripted(*pictures[:5], *later)
    begin = time.monotonic()
    found = watched(video, source)
    assert time.monotonic() - begin < 20.0  # ten minutes are not simulated
    assert "a gap of 599" in found[5].messages[0] or "a gap of 600" in found[5].messages[0]
    assert not found[5].found
    assert np.isinf(found[5].tip_std)
    assert found[5].age > 590.0
    assert found[-1].found


def test_a_live_source_is_opened_again(video, pictures):
    sources = iter([Scripted(*pictures[:3]), FileProblem("busy"), Scripted(*pictures[3:6])])

    def open_source():
        each = next(sources, FileProblem("gone"))
        if isinstance(each, Exception):
            raise each
        return each

    with FrameThread(open_source, live=True, reconnect_timeout=1.0) as frames:
        found = []
        while frames.ended is None:
            found.append(frames.take(0.05))
        said = frames.messages()
    taken = [each for each in found if each is not None]
    assert {3, 4, 5} & {each.frame.index for each in taken}
    assert said.count("no more frames come; the source is opened again") == 2
    assert "could not be opened again within 1 s" in str(frames.ended)


def test_time_continues_if_a_source_restarts_its_stamps(video, pictures):
    """A camera that was opened again: its stamps begin at 0, the frames' times continue, and the rope is found again.

    A busy machine may take no frame of an opening, or give a prediction before a frame that is late.
    """
    opened = 0

    def open_source():
        nonlocal opened
        opened += 1
        script = [each for frame in pictures[:6] for each in (frame, 0.04)]  # stamps are 1/30 s apart: never ahead
        return Scripted(*script, 0.5)

    for retime in ({}, {"retime": StampClock()}):
        opened, begin, found, told = 0, time.monotonic(), [], 0
        with FrameThread(open_source, live=True, reconnect_timeout=1.0) as frames:
            for each in Watch(frames, tracker(video), **retime):
                found += [] if each.frame is None else [each]
                told += any("opened again: the rope" in words for words in each.messages)
                if told == 2 or opened == 20:
                    break
        ended = time.monotonic()
        assert told == 2
        assert all(each.found and each.age == 0.0 for each in found)
        times = [each.t for each in found]
        assert np.all(np.diff(times) > 0.0)
        assert times[-1] - times[0] < ended - begin
        assert times[-1] - times[0] > 2 * 0.5  # no clock stops
        if retime:
            assert begin + 2 * 0.5 < times[-1] <= ended


class Stepped(Scripted):
    """An emulated camera that provides frames on request, and then fails permanently."""

    def __init__(self, *script: Frame) -> None:
        super().__init__(*script)
        self.told, self.given, self.opened = threading.Semaphore(0), threading.Semaphore(0), False

    def __iter__(self) -> Iterator[Frame]:
        for each in self.script:
            self.told.acquire()
            yield each
            self.given.release()

    def give(self, count: int) -> None:
        """Provide `count` frames; return when they wait to be read."""
        for _ in range(count):
            self.told.release()
            assert self.given.acquire(timeout=30.0)

    def opening(self) -> FrameThread:
        def open_once() -> Scripted:
            if self.opened:
                raise FileProblem("gone")
            self.opened = True
            return self

        return FrameThread(open_once, live=True, reconnect_timeout=0.0)


def test_a_live_source_gives_the_newest(pictures):
    """Frames are not read for a while: the newest one is provided, and the number of skipped ones is reported."""
    source = Stepped(*pictures[:7])
    with source.opening() as frames:
        source.give(6)
        arrival = frames.take(30.0)
        assert (arrival.frame.index, arrival.missed) == (5, 5)
        assert frames.take(0.1) is None  # nobody waits for a source that gives no more
        source.give(1)


def test_frames_that_wait_are_processed_later_unless_as_many_come(pictures, monkeypatch):
    """4 of 9 frames wait, the newest in place of the last one. Then each frame that is read is followed by one."""
    monkeypatch.setattr(FrameThread, "KEPT", 4 * pictures[0].image.nbytes)
    source = Stepped(*pictures[:15])
    with source.opening() as frames:
        source.give(9)
        taken, behind = [], frames.catch_up()
        for _ in range(6):
            taken.append(frames.take(30.0))
            source.give(1)
        assert frames.take(30.0).frame.index == 14
    assert behind == 4
    assert [(each.frame.index, each.missed) for each in taken] == [(0, 0), (1, 0), (2, 0), (8, 5), (12, 3), (13, 0)]


def test_a_second_search_while_frames_are_processed_later_keeps_no_more(pictures):
    """Of 8 frames that wait, the fourth is searched, while 6 come, and the last one: the newest follows."""
    source = Stepped(*pictures[:17])
    with source.opening() as frames:
        source.give(8)
        taken, behind = [], [frames.catch_up()]
        for k in range(9):
            taken.append(frames.take(30.0))
            source.give({3: 6, 8: 3}.get(k, 0))
            behind += [frames.catch_up()] * (k in (3, 7, 8))
    assert behind == [8, 0, 0, 3]
    assert [(each.frame.index, each.missed) for each in taken] == [*((k, 0) for k in range(8)), (13, 5)]


def test_a_plain_rope_that_moves_is_followed_from_its_first_picture_on(monkeypatch):
    """12 frames come during the search, then one for each three that are looked at. The free end moves at 4 m/s."""
    camera, motion = facing((320, 240), 100.0, exposure=0.002), RopeMotion.from_trajectory(free_swing(3, 2.0))
    renderer = Renderer(camera, motion, Scene([], rope_width=0.012, seed=3))
    source = Stepped(*(Frame(t, renderer.image(t), k) for k, t in enumerate(0.4 + np.arange(19) / 30.0)))
    look, find = RopeLook(np.array([45.0, 45.0, 45.0]), 1.2), measurements.find_rope

    def find_slowly(*given: object, **more: object) -> FoundRope:
        source.give(12)
        return find(*given, **more)

    monkeypatch.setattr(measurements, "find_rope", find_slowly)
    task = TrackingTask(rope(20), curve_arc_lengths(rope(20)), camera, [], look=look)
    found = []
    with source.opening() as frames:
        source.give(1)
        watch = Watch(frames, task.tracker(), interval=30.0)
        for each in watch:
            found.append(each)
            if len(found) % 3 == 0 and len(found) < 19:
                source.give(1)
    assert [each.frame.index for each in found if each.frame] == [*range(19)]
    assert found[0].messages == ("12 frames came during the search, and are worked off",)
    assert watch.skipped == 0
    true = motion.places([each.t for each in found[:19]], [2.0])[:, 0, :2]
    off = np.linalg.norm([each.tip for each in found[:19]] - true, axis=1)
    assert off[6:].max() < 0.01  # m, a pixel


def test_a_driver_that_fails_is_reported(pictures):
    with FrameThread(lambda: Scripted(pictures[0], RuntimeError("cable")), live=False) as frames:
        assert frames.take(5.0) is not None
        assert frames.take(5.0) is None
        assert frames.ended == "the source failed: RuntimeError: cable"


def test_the_log_of_an_interrupted_run_is_kept(video, pictures, tmp_path):
    path = tmp_path / "watch.nc"
    estimates = watched(video, Scripted(*pictures[:6]))

    def interrupted():
        with WatchLog(path, 20, 8, "a test") as log:
            for each in estimates[:4]:
                log.note(each)
            assert list(tmp_path.iterdir()) == []  # nothing is there until the end
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    kept = read_netcdf(path)
    assert (kept.attributes["interrupted"], kept.attributes["ending"]) == (1, "interrupted")
    np.testing.assert_array_equal(kept.variables["t"].values, [each.t for each in estimates[:4]])
    np.testing.assert_array_equal(kept.variables["q"].values[-1], estimates[3].state.q)
    assert kept.variables["pixels"].dims == ("time", "marker", "axis")
    with WatchLog(path, 20, 8, "a test") as log:
        log.note(estimates[0])
        log.ending = "the source ended"
    assert read_netcdf(path).attributes["interrupted"] == 0
    with pytest.raises(FileProblem, match="No log can be written"), WatchLog(tmp_path / "no" / "a.nc", 20, 8, "a test"):
        pass


def test_the_page_is_for_this_machine_alone(pictures):
    with PicturePage() as page:
        assert page.address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(page.address, timeout=5.0) as answer:
            assert b"stream" in answer.read()
        foreign = urllib.request.Request(page.address, headers={"Host": "evil.example"})  # others: tests/play
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(foreign, timeout=5.0)
        assert not page.watched
        with urllib.request.urlopen(page.address + "stream", timeout=5.0) as stream:
            until = time.monotonic() + 5.0
            while not page.watched and time.monotonic() < until:
                time.sleep(0.01)
            page.show(pictures[0].image)
            head = stream.read(200)
        assert b"Content-Type: image/jpeg" in head
        assert b"\xff\xd8\xff" in head  # a JPEG begins
        refuses("no page can be shown there: address already in use", PicturePage, page.port)


def test_stamps_are_put_on_the_clock_of_the_quickest_frame():
    clock, image = StampClock(), np.zeros((2, 2, 3), np.uint8)
    late = [0.2, 0.05, 0.3, 0.1]
    times = [clock(Arrival(Frame(10.0 + k, image, k), 1000.0 + k + late[k], 0)).time for k in range(4)]
    np.testing.assert_allclose(times, [1000.2, 1001.05, 1002.05, 1003.05], atol=1e-3)


def task(video: tuple[Path, MarkerColour], **more: object) -> TrackingTask:
    return TrackingTask(rope(20), ARCS, facing(), [video[1]], **more)


@pytest.fixture
def source(video: tuple[Path, MarkerColour]) -> Iterator[CameraStateSource]:
    with CameraStateSource(str(video[0]), task(video), longest=2.0, stalled=0.6) as found:
        yield found


def ask(source: CameraStateSource, seconds: float) -> None:
    """Ask for the state again and again."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        source.state(source.now, hf.hold_arm(0.0))
        time.sleep(0.005)


def test_a_state_source_predicts_to_now(source):
    """The video plays at its own speed; the requested state is that of the rope at this time, with its covariance."""
    source.wait_until_found(30.0)
    swing, motion = free_swing(0, 4.0), hf.hold_arm(0.0)
    time.sleep(0.7)
    packet = source._newest()
    offset = packet.t - 0.05  # the first frame's stamp is 0.05 s
    now = source.now
    begin = time.monotonic()
    state = source.state(now, motion)
    assert time.monotonic() - begin < 0.5
    assert state.t == now
    assert state.covariance.shape == (40, 40)
    first = offset - (packet.frames - 1.0) / 30.0  # on the machine's clock, when the video's time was 0
    at = now + source._zero - first
    tip = rope(20).joints(state.q, np.zeros(2))[-1]
    true = swing.joints[min(round(at * 600.0), len(swing.t) - 1), -1]
    assert np.linalg.norm(tip - true) < 0.05  # the tip moves at 3 m/s: 17 ms


def test_a_change_reaches_the_reader(video, tmp_path):
    """Somebody bumps into the camera after 1.2 s: all moves by 6 px, 30 mm."""
    with VideoReader(video[0]) as frames, VideoWriter(tmp_path / "bumped.mp4", (640, 480)) as bumped:
        for frame in frames:
            bumped.write(np.roll(frame.image, 6 if frame.time > 1.2 else 0, axis=1), frame.time)
    wanted = task(video, parameters=[EstimatedParameter("scale", 0.01)], tests=ChangeTests(("offset_x",)))
    with CameraStateSource(str(tmp_path / "bumped.mp4"), wanted, stalled=2.0) as source:
        source.wait_until_found(30.0)
        found, until = source.now, time.monotonic() + 4.0
        assert set(source.values) == {"scale"}
        while not source.changes and time.monotonic() < until:
            time.sleep(0.01)
        (change,), values = source.changes, source.values
    assert change.name == "offset_x"
    assert change.size == pytest.approx(0.03, abs=0.003)
    assert found < change.time < change.noticed < found + 2.0
    assert set(values) == {"scale", "offset_x"}


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("number", "said"), [(signal.SIGKILL, "The estimator ended by signal 9"), (signal.SIGSTOP, "no sign of life")]
)
def test_an_estimator_that_is_killed_or_stopped_is_reported_and_replaced(source, number, said):
    source.wait_until_found(30.0)
    first = source.pid
    os.kill(first, number)
    with pytest.raises(EstimatorLost, match=said):
        ask(source, 2.0)
    source.restart()
    assert not Path(f"/proc/{first}").exists()  # no zombie
    source.wait_until_found(30.0)
    assert source.pid != first
    assert source.state(source.now, hf.hold_arm(0.0)).t >= 0.0


def test_a_search_may_take_longer_than_a_stall(video, monkeypatch):
    """Five seconds ago the process wrote that the rope was not found, or was: only the second one is a stall."""
    source = CameraStateSource(str(video[0]), task(video))
    monkeypatch.setattr(type(source._child), "pid", 1)
    nothing = np.zeros(0)
    source._packet = Packet(time.monotonic() - 5.0, 0.0, 0.0, False, 1, nothing, nothing, nothing, (), 0, nothing)
    with pytest.raises(EstimatorLost, match="was not found within"):
        source.wait_until_found(0.01)
    source._packet = source._packet._replace(found=True)
    with pytest.raises(EstimatorLost, match="no sign of life"):
        source.wait_until_found(0.01)


def test_a_video_that_ends_is_reported(video, pictures, tmp_path):
    with VideoWriter(tmp_path / "short.mp4", (640, 480)) as short:
        for frame in pictures[:20]:
            short.write(frame.image, frame.time)
    given = str(tmp_path / "short.mp4"), task(video)
    with CameraStateSource(*given, longest=20.0, stalled=20.0) as source:  # busy machines are slow
        source.wait_until_found(30.0)
        with pytest.raises(EstimatorLost, match="No more frames come: the source ended"):
            ask(source, 20.0)


def test_an_estimator_that_cannot_begin_reports_why(video, tmp_path):
    source = CameraStateSource(str(tmp_path / "none.mp4"), task(video))
    with pytest.raises(EstimatorLost, match="did not start: There is no video"), source:
        pass
    refuses("knows the swing plane", CameraStateSource, "0", replace(task(video), camera=Camera.pinhole((640, 480))))
    refuses("does not run", source.wait_until_found, 1.0)


def test_an_estimator_ends_by_itself_if_nobody_listens(video, pictures, tmp_path):
    """Its video goes on for a minute. That children of a killed program get to know it: tests/execution/test_stream."""
    with VideoWriter(tmp_path / "slow.mp4", (640, 480)) as slow:
        for frame, t in zip(pictures[:2], (0.0, 60.0), strict=True):
            slow.write(frame.image, t)
    with CameraStateSource(str(tmp_path / "slow.mp4"), task(video)) as source:
        source._child.link.close()  # as the system does when the parent is killed
        assert wait([source._child._process.sentinel], 10.0), "it outlives its parent"


def test_the_motion_reaches_the_estimator():
    """A motion that is handed over on the way gives what one known from the start does."""
    x = np.concatenate([np.full(20, 0.3), np.zeros(20)])
    known, told = (RopeFilter(rope(20), ARCS, motion=each, arm=ARM).process for each in (SWINGS, hf.hold_arm(0.0)))
    assert not np.allclose(told.carry(x, np.eye(40), 0.2, 0.4)[0], known.carry(x, np.eye(40), 0.2, 0.4)[0])
    told.set_motion(SWINGS)
    for one, two in zip(told.carry(x, np.eye(40), 0.2, 0.4), known.carry(x, np.eye(40), 0.2, 0.4), strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("area", [None, 15.0, 40.0, 120.0, 400.0])
def test_the_rehearsal_finds_its_rope(area, monkeypatch):
    """Or else nothing of the filter would be compiled by it; discs that are drawn too large are taken for two."""
    seen: list[int] = []
    look = RopeTracker.look

    def noted(self, frame):
        result = look(self, frame)
        seen.append(int(result.seen.sum()))
        return result

    monkeypatch.setattr(RopeTracker, "look", noted)
    lens = Camera.facing((640, 480), pixels_per_metre=180.0, origin=(320.0, 20.0))
    colour = MarkerColour(np.array([40.0, 30.0, 210.0]), area=area)
    TrackingTask(rope(6), np.array([0.5, 1.0, 1.5, 2.0]), lens, [colour], ARM).rehearse()
    assert seen == [4] * 3
