"""``hyperflex track`` and ``watch``: a video to the motion of its rope or bars, and a rope followed live."""

import math
import re
import time
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from hyperflex import checks, files, model, vision
from hyperflex import estimate as estimation
from hyperflex.cli import output
from hyperflex.cli.command import ArcLengths, Click, arcs_of, check_destination, numbers, words
from hyperflex.cli.plain import CLICK_STD, Plain, PlainScene, answers_path
from hyperflex.errors import FileProblem, HyperflexError, InvalidInput
from hyperflex.interruption import stoppable

_SAME = 1e-6  # s, by which two times may differ
_TICK, _FILE_TICK = 0.1, 5.0  # s without a frame, from a camera and a file, after which an estimate is given anyway


@dataclass(frozen=True, kw_only=True)
class Markers:
    """Options on a rope with markers, and how its colour, parameters and changes are found."""

    rope: Annotated[Path | None, "TOML file with the rope."] = None
    camera: Annotated[Path | None, "TOML file of the calibrated camera, with the swing plane (calibrate)."] = None
    arc_lengths: ArcLengths = None
    preview: Annotated[Path | None, "MP4 file of the pictures with the estimate drawn on them."] = None
    click: Click = None
    estimate: Annotated[str, "Parameters to estimate too, with standard deviations: scale=0.01,delay=0.02."] = ""
    changes: Annotated[
        str,
        "Changes to test for: tip_mass,touch; or none. [default: length, tip_mass, friction, drag, touch]",
    ] = ""
    false_alarm_interval: Annotated[float, "Least mean time between false alarms of these tests, s."] = 600.0

    def check(self, out: Path, source: Path, *, needed: bool = True) -> None:
        """Refuse, before any work, outputs that cannot be written, and missing options if markers are `needed`."""
        for each, suffix in ((out, ".nc"), (self.preview, ".mp4")):
            check_destination(each, suffix, [source, self.rope, self.camera])
        options = {"--rope": self.rope, "--camera": self.camera, "--arc-lengths": self.arc_lengths}
        if needed and (missing := [name for name, value in options.items() if not value]):
            fix = "Give them; for a rope without markers --length; for a pendulum of bars --bar and --pivot"
            raise InvalidInput("a rope with markers needs more options", got="no " + ", ".join(missing), fix=fix)

    def plain(self, plain: Plain, source: Path) -> bool:
        """Return whether the rope is seen without markers: its length is given, or answers on its video are kept.

        These are not used if all is given that a rope with markers needs.
        """
        marked = self.rope and self.camera and self.arc_lengths
        return plain.length is not None or (not marked and answers_path(source).exists())

    def task(self, images: "Iterable[vision.Image]", *, origin_doubt: float = 0.0) -> "estimation.TrackingTask":
        """Return what is tracked; the markers' colour is that of `images`.

        The camera's origin is estimated too if it is known to `origin_doubt`, px, only.
        """
        lens, line = vision.read_camera(self.camera or ""), model.Rope.from_toml(self.rope or "")
        arcs = checks.instance("--arc-lengths", arcs_of(self.arc_lengths), np.ndarray)
        task = estimation.TrackingTask(line, arcs, lens, marker_colours(images, self.click or ()), tests=self._tests())
        doubt = origin_doubt / lens.pixels_per_metre
        return self._estimating(task, {"offset_x": doubt, "offset_y": doubt} if origin_doubt else {})

    def plain_task(self, scene: PlainScene) -> "estimation.TrackingTask":
        """Return what is tracked of a plain rope, and of some markers on it if their arc lengths are given."""
        arcs, colours = estimation.curve_arc_lengths(scene.rope), list["vision.MarkerColour"]()
        end = arcs.size - 1
        if (given := arcs_of(self.arc_lengths)) is not None:
            arcs, colours = given, marker_colours([scene.image], self.click or ())
            end = int(np.flatnonzero(~estimation.marked_arc_lengths(scene.rope, arcs)[1])[-1])
        tests = self._tests() if self.changes else None  # friction and mass are not known
        task = estimation.TrackingTask(scene.rope, arcs, scene.camera, colours, look=scene.found.look, tests=tests)
        return self._estimating(task, scene.doubts | {f"arc[{end}]": scene.radius})  # an end is cut or round

    def _tests(self) -> "estimation.ChangeTests | None":
        named = tuple(words([self.changes]))
        return None if named == ("none",) else estimation.ChangeTests(named or None, self.false_alarm_interval)

    def _estimating(self, task: "estimation.TrackingTask", doubts: dict[str, float]) -> "estimation.TrackingTask":
        """Return the task with the parameters of --estimate, and those of these standard deviations."""
        named = [_parameter(each) for each in words([self.estimate])]
        names = {each.name for each in named}
        more = [estimation.EstimatedParameter(name, std) for name, std in doubts.items() if name not in names]
        return replace(task, parameters=[*named, *more])


def _parameter(text: str) -> "estimation.EstimatedParameter":
    """Return a parameter of ``--estimate scale=0.01,delay=0.02``."""
    name, _, std = (part.strip() for part in text.partition("="))
    if not std:
        allowed = "each with the standard deviation of its prior, as in scale=0.01,delay=0.02"
        raise InvalidInput("--estimate names a parameter without a number", got=text, allowed=allowed)
    return estimation.EstimatedParameter(name, numbers("--estimate", [std], "scale=0.01")[0])


def marker_colours(images: "Iterable[vision.Image]", clicks: Sequence[str]) -> "list[vision.MarkerColour]":
    """Return the colours of the markers: that of the first picture which shows one, or those at pixels of the first."""
    pixels, count = [_pixel("--click", each) for each in clicks], 0
    for image in images:
        if pixels:
            return [vision.MarkerColour.from_click(image, each) for each in pixels]
        with suppress(InvalidInput):
            return [vision.MarkerColour.from_frame(image)]
        count += 1
    if not count:
        raise InvalidInput("no frame was received", fix="Check the source, and --at if it is given")
    raise InvalidInput(
        "no colour of markers was found",
        got=f"{count} frames",
        allowed="a frame with at least 3 small things of one strong colour and size",
        fix="Give a pixel of a marker with --click U,V",
    )


def track(
    video: Annotated[Path, typer.Argument(help="Video of the rope, MP4, MOV, ...")],
    bar: Annotated[
        list[str] | None,
        "In place of markers: pixel u,v in the middle of a link that is a bar of a separate colour; once "
        "for each link, from the pivot on.",
    ] = None,
    at: Annotated[
        float | None,
        "Time of the frame of the pixels of --bar or --click, s; a plain rope is tracked from it on. "
        "[default: the first frame]",
    ] = None,
    out: Annotated[Path, "NetCDF file for the positions or angles."] = Path("markers.nc"),
    *,
    plain: Plain,
    markers: Markers,
) -> None:
    """Track a rope in a video by its dynamics, with markers or without.

    For a plain rope give only its --length: the command asks for the rest, in the terminal and in a page of the
    browser, and saves the answers in a file next to the video, so that a second run asks nothing. It also writes the
    rope and the camera, for hyperflex identify and watch. A known --rope or --camera replaces answers. With
    --arc-lengths the command also uses a few markers on the rope.

    A rope with markers hangs from the origin of the swing plane. Its markers are found and ordered in the first frames;
    from then on each is searched where the rope's motion predicts it. `hyperflex identify` continues from the file.

    With --bar and --pivot the command follows the links of a pendulum by their colours and needs neither rope nor
    camera: the file then contains the links' angles.

    After Ctrl-C, the tracked part is in a separate file, such as markers-interrupted.nc.
    """
    preview = markers.preview
    if at is not None:
        checks.number("--at", at, unit="s")
    if bar and plain.pivot is None:
        raise InvalidInput("--pivot is missing", fix="Give the pixel of the first joint, as --pivot 167 147")
    without = not bar and markers.plain(plain, video)
    markers.check(out, video, needed=not bar and not without)
    scene = None
    if without:
        known: dict[str, Any] = {"at": at, "rope": markers.rope, "camera": markers.camera}
        scene = plain.scene(partial(_first_image, video), video, _readout_direction(video), **known)
    found: Any
    with output.spinner() as said:
        follow: dict[str, Any] = {"preview": preview, "progress": lambda count: said(f"frame {count}")}
        if bar:
            detector = vision.BarDetector.from_clicks(_first_image(video, at), [_pixel("--bar", each) for each in bar])
            found, stopped = output.run(lambda: vision.track_bars(video, detector, plain.pivot or (), **follow))
        elif scene is None:
            task = markers.task(_images_since(video, at), origin_doubt=CLICK_STD)
            found, stopped = _tracked(video, task, follow, False)
        else:
            follow["since"] = _since(scene.at)
            found, stopped = _tracked(video, markers.plain_task(scene), follow, scene.by_rope)
    kept = output.partial_path(out) if found.interrupted else out
    result = {
        "output": kept,
        "preview": None if found.interrupted else preview,
        "frames": found.frames,
        "duration_s": found.recording.duration,
        "seen": found.seen,
    }
    if not bar:
        result |= {
            "seen_each": found.seen_each,
            "found_at_s": found.found_at,
            "markers" if scene is None else "places": len(found.arc_lengths),
            "arc_lengths": found.arc_lengths,
        }
        result |= _estimated(found.errors.level, found.parameters, found.changes)
    files.rescued(found.to_netcdf, kept)
    if scene is not None:
        result |= scene.write(found, kept)
    doubted = [] if bar else [str(each) for each in found.doubts]
    result["notes"] = [each.replace("arc_lengths", "--arc-lengths") for each in found.notes]
    more = [("change", str(each)) for each in (() if bar else found.changes)]
    title = f"Tracked {video}" + (f", with doubts: {'; '.join(doubted)}" if doubted else "")
    text = f"Interrupted after {found.frames} frames; the part that was tracked is in {kept}."
    if stopped and not found.interrupted:
        text = f"A further pass over the frames was interrupted; the track of the first one is in {kept}."
    rows = output.rows(title, result, *more)
    output.show({**result, "doubts": doubted}, rows, interrupted=text if stopped else "")


def _tracked(
    video: Path, task: "estimation.TrackingTask", follow: dict[str, Any], by_rope: bool
) -> "tuple[estimation.VideoTrack, bool]":
    """Return a track, and whether it was interrupted.

    If the rope begins elsewhere than at the camera's origin, or moves as if disturbed all along, its first joint is
    estimated as one that moves; that is kept if it does. The length of a plain rope is tested in a video of a whole
    swing: with a length that is estimated too, which is kept if it contradicts the given one, with a scale and roll
    within three of their standard deviations; if not, the pass is made again from shorter and longer lengths. The scale
    is then as unknown as the length if it is by the rope's own length (`by_rope`). A plain rope that hangs still shows
    no more than its place: it is tracked with the scale, roll and so on as they are given. An error or Ctrl-C in a
    further pass leaves the track of the first.
    """
    moving = replace(task, parameters=[*task.parameters, *estimation.moving_base(task.rope)], tests=None)
    wide = ("length", "scale") if by_rope else ("length",)
    kept = [each for each in task.parameters if each.name not in wide]
    tenth = 0.1  # by which a tape may be wrong
    starts = [
        [estimation.EstimatedParameter(name, tenth, off if name == "length" else -off) for name in wide]
        for off in (0.0, -tenth, tenth)
    ]
    longer = [replace(task, parameters=[*kept, *each], tests=None) for each in starts]
    place = replace(task, parameters=[each for each in task.parameters if each.name.startswith(("offset_", "arc["))])
    try:
        found, stopped = output.run(lambda: estimation.track_video(video, task.tracker(), **follow))
    except estimation.BaseElsewhere:
        return output.run(lambda: estimation.track_video(video, moving.tracker(), **follow))
    period = math.tau / model.swing_rate(task.rope)
    doubted, others = {each.kind for each in found.doubts}, []
    if estimation.DoubtKind.STILL in doubted:
        others.append(([place], estimation.DoubtKind.STILL))
    elif task.look is not None and found.recording.duration > period:
        others.append((longer, estimation.DoubtKind.LENGTH))
    if estimation.DoubtKind.DISTURBED in doubted:
        others.append(([moving], estimation.DoubtKind.BASE_MOVES))
    preview = follow["preview"]
    spare = preview and preview.with_stem(f"{preview.stem}-other")  # of a track that may not be kept
    for tasks, kind in others if not stopped else ():
        other, stopped = _further(video, tasks, follow | {"preview": spare})
        if stopped:
            break
        kinds = set() if other is None else {each.kind for each in other.doubts}
        # a camera that pans looks like a wrong length, too: but then what the first track was doubted for remains
        if (
            other is None
            or kind not in kinds
            or kinds & doubted & {estimation.DoubtKind.DISTURBED, estimation.DoubtKind.SHAKE}
        ):
            continue
        if kind is estimation.DoubtKind.LENGTH and _far(other, tasks[0]):
            found = replace(
                found, doubts=(*found.doubts, estimation.Doubt(estimation.DoubtKind.OTHER_LENGTH, math.nan))
            )
            continue
        if preview:
            spare.replace(preview)
        return other, False
    if preview:
        spare.unlink(missing_ok=True)
    return found, stopped


def _far(track: "estimation.VideoTrack", task: "estimation.TrackingTask") -> bool:
    """Whether the scale or roll is more than three standard deviations of the task's prior from none."""
    priors = {each.name: each.std for each in task.parameters if each.name in ("scale", "roll")}
    return any(abs(track.parameters[name][0]) > 3.0 * std for name, std in priors.items())


def _further(
    video: Path, tasks: "Sequence[estimation.TrackingTask]", follow: dict[str, Any]
) -> "tuple[estimation.VideoTrack | None, bool]":
    """Return the track of a further pass, None if it failed, and whether it was interrupted.

    A pass that ends far from its priors is made again with the next task.
    """
    found: estimation.VideoTrack | None = None
    for task in tasks:
        try:
            track, stopped = output.run(partial(estimation.track_video, video, task.tracker(), **follow))
        except KeyboardInterrupt:
            return None, True
        except HyperflexError as error:
            output.note(f"a further pass over the frames failed: {error}")
            return None, False
        found = track
        if stopped or not _far(track, task):
            return track, stopped
    return found, False


def _estimated(
    noise: float, values: dict[str, tuple[float, float]], changes: "Iterable[estimation.Change]"
) -> dict[str, Any]:
    """Return for JSON what was estimated in addition to the motion."""
    named = {
        name: {"value": value, "std": std, "unit": estimation.EstimatedParameter(name, 1.0).unit}
        for name, (value, std) in values.items()
    }
    return {"noise_level": noise, "estimated": named, "changes": [asdict(change) for change in changes]}


def _since(at: float | None) -> float:
    """Return the time of the first frame, s, that is not before a given one."""
    return -math.inf if at is None else at - _SAME


def _images_since(video: Path, at: float | None) -> "Iterator[vision.Image]":
    """Yield the pictures of a video from a time on."""
    with vision.VideoReader(video) as reader:
        for frame in reader:
            if frame.time >= _since(at):
                yield frame.image


def _pixel(option: str, text: str) -> list[float]:
    """Return a pixel (2,) of ``--bar 213,140``."""
    if len(pixel := numbers(option, [text], "213,140")) != 2:
        raise InvalidInput(f"{option} is a pixel", got=text, allowed="u,v", fix="Give it once for each")
    return pixel


def _first_image(video: Path, at: float | None) -> "vision.Image":
    """Return the first picture of a video from a time on."""
    if (image := next(_images_since(video, at), None)) is None:
        raise InvalidInput("--at is after the end of the video", got=at, fix="Give an earlier time")
    return image


def _readout_direction(video: Path) -> str:
    """Return in which direction the rows of a sensor follow each other in a video."""
    with vision.VideoReader(video) as reader:
        return reader.readout_direction


def watch(
    source: Annotated[
        str, typer.Argument(help="Number of a camera (0 is the first), a stream (rtsp://...), or a video.")
    ],
    out: Annotated[Path, "NetCDF file for the log."] = Path("watch.nc"),
    page: Annotated[int | None, "Port of a page on this machine that shows the pictures; 0: any free one."] = None,
    duration: Annotated[float | None, "Stop after this time", "s"] = None,
    reconnect_timeout: Annotated[float, "Time for which a lost source is tried again, s."] = 10.0,
    *,
    plain: Plain,
    markers: Markers,
) -> None:
    """Follow a rope live by its dynamics, with markers or without.

    For a plain rope give only its --length; see `hyperflex track`. Answers about a camera are saved in
    camera-N.answers.toml in the working folder. A video is followed from the time of its answers on (--at of track).

    At every frame, and while none arrives, the command reports the rope's position, the age and uncertainty of this
    estimate, and detected changes, such as a mass at the tip or a touch. It ends with the source or by Ctrl-C, and then
    writes the log; the log of an interrupted run is marked. A video is processed frame by frame, with --page at its own
    speed. With --json the command prints one JSON object per line: one for each estimate, and a summary.
    """
    from threadpoolctl import threadpool_limits

    beside = Path(source) if Path(source).exists() else Path(re.sub(r"\W+", "-", f"camera-{source}"))
    without = markers.plain(plain, beside)
    markers.check(out, Path(source), needed=not without)
    known: dict[str, Any] = {"rope": markers.rope, "camera": markers.camera}
    scene = None
    if without and beside.exists():
        scene = plain.scene(partial(_first_image, beside), beside, _readout_direction(beside), **known)
    since = _since(None if scene is None else scene.at)
    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1))
        pictures = None if page is None else stack.enter_context(estimation.PicturePage(page))
        opened = estimation.open_frames(
            source, paced=page is not None, since=since, reconnect_timeout=reconnect_timeout
        )
        frames = stack.enter_context(opened)
        images = newest_images(frames, reconnect_timeout)
        if without and scene is None:
            if (image := next(images, None)) is None:
                raise InvalidInput("no frame was received", fix="Check the source")
            scene = plain.scene(lambda _: image, beside, **known)
        if scene is not None:
            task = markers.plain_task(scene)
        else:
            lens = vision.read_camera(markers.camera or "")
            if not frames.live:
                lens.check_size(frames.image_size)
            task = markers.task(images)
        task.rehearse()
        tracker = task.tracker()
        follow = estimation.Watch(frames, tracker, interval=_TICK if frames.live or page is not None else _FILE_TICK)
        if pictures is not None:
            output.note(f"pictures at {pictures.address}")
        with estimation.WatchLog(out, task.rope.n_links, len(tracker.arc_lengths), source) as log, ExitStack() as films:
            record = _Record(tracker, markers.preview, pictures, films)
            with stoppable() as stop:
                _run(follow, math.inf if duration is None else duration, [log.note, record.take])
                log.ending = frames.ended or f"stopped after {duration:g} s"
            log.interrupted = stop.received
    result = {"output": out, "ending": log.ending, "interrupted": log.interrupted, **record.summary()}
    result["skipped"] = follow.skipped
    stopped = f"Interrupted; the log is kept in {out}." if log.interrupted else ""
    output.show(result, output.rows(f"Watched {source}", result), one_line=True, interrupted=stopped)


def _run(follow: "estimation.Watch", until: float, takers: "list[Callable[[estimation.LiveEstimate], None]]") -> None:
    """Hand each estimate to all who take it, until the source or the time ends."""
    begin = time.monotonic()
    with output.spinner() as said:
        for estimate in follow:
            for take in takers:
                take(estimate)
            if output.as_json():
                output.print_json(_line(estimate), one_line=True)
            else:
                said("   ".join(_status(estimate)))
                for message in estimate.messages:
                    output.note(f"{estimate.t:.2f} s: {message}")
            if time.monotonic() - begin > until:
                return


def _status(estimate: "estimation.LiveEstimate") -> list[str]:
    """Return the status in two short lines."""
    sure = f"tip std {1e3 * estimate.tip_std:.1f} mm" if estimate.found else "rope not found"
    late = "no frame" if estimate.frame is None else f"latency {1e3 * estimate.latency:.1f} ms"
    age = "never seen" if math.isinf(estimate.age) else f"seen {1e3 * estimate.age:.0f} ms ago"
    return [
        f"{estimate.t:.2f} s   {estimate.rate:.1f} frames/s   {late}",
        f"{estimate.seen} of {estimate.markers} seen, {age}   {sure}",
    ]


def _line(estimate: "estimation.LiveEstimate") -> dict[str, Any]:
    """Return an estimate for a program."""
    names = ("t", "found", "tip", "tip_std", "age", "latency", "rate", "seen", "markers", "messages")
    state = {"frame": estimate.frame is not None, "q": estimate.state.q, "qd": estimate.state.qd}
    return {name: getattr(estimate, name) for name in names} | state


class _Record:
    """Counts what a run has seen, and draws it on the frames for a film and for the page."""

    def __init__(
        self,
        tracker: "estimation.RopeTracker",
        preview: Path | None,
        page: "estimation.PicturePage | None",
        films: ExitStack,
    ) -> None:
        self.tracker, self.preview, self.page, self.films = tracker, preview, page, films
        self.film: tuple[vision.VideoWriter, float] | None = None  # and the time of its first frame, s
        self.counts: Counter[str] = Counter()
        self.latencies, self.changes = array("f"), list["estimation.Change"]()

    def take(self, estimate: "estimation.LiveEstimate") -> None:
        """Count an estimate, and draw it if its frame can be used and a film or a page shows it."""
        self.counts["messages"] += len(estimate.messages)
        if estimate.frame is None:
            return
        self.counts.update(frames=1, **{name: int(getattr(estimate, name)) for name in ("found", "seen", "markers")})
        self.latencies.append(estimate.latency)
        if estimate.tracked is not None:
            self.changes += estimate.tracked.changes
            self._draw(estimate, estimate.frame, estimate.tracked)

    def _draw(
        self, estimate: "estimation.LiveEstimate", frame: "vision.Frame", tracked: "estimation.TrackedFrame"
    ) -> None:
        watched = self.page is not None and self.page.watched
        if not watched and self.preview is None:
            return
        image = estimation.draw_frame(frame.image, self.tracker, tracked, _status(estimate))
        if self.page is not None and watched:
            self.page.show(image)
        if self.preview is not None:
            if self.film is None:
                writer = vision.VideoWriter(self.preview, self.tracker.camera.image_size)
                self.film = self.films.enter_context(writer), frame.time
            self.film[0].write(image, frame.time - self.film[1])

    def summary(self) -> dict[str, Any]:
        """Return the counts by name."""
        filter_, counts = self.tracker.estimator, self.counts
        median, p99 = np.quantile(self.latencies or [np.nan], [0.5, 0.99])
        return {
            **{name: counts[name] for name in ("frames", "found", "messages")},
            "seen": counts["seen"] / max(counts["markers"], 1),
            "latency_s": {"median": median, "p99": p99},
            "warning": self.tracker.warning,
            **_estimated(self.tracker.level, filter_.values, self.changes),
        }


def newest_images(frames: "estimation.FrameThread", reconnect_timeout: float) -> "Iterator[vision.Image]":
    """Yield pictures for so long, s; the last one that was yielded stays in the queue."""
    until, count = time.monotonic() + reconnect_timeout, 0
    while (frame := frames.peek(max(0.0, until - time.monotonic()))) is not None:
        count += 1
        yield frame.image
        frames.take(0.0)
    if not count and frames.ended:
        raise FileProblem(frames.ended)
