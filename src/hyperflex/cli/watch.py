"""``hyperflex watch``: a rope followed live, frame by frame, from a camera, a stream or a file."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex import checks
from hyperflex.cli import output
from hyperflex.cli.command import ArcLengths, check_destination, numbers
from hyperflex.cli.output import Rows
from hyperflex.cli.vision import (
    Camera,
    Changes,
    Click,
    Estimate,
    FalseAlarmInterval,
    Preview,
    change_tests,
    marker_colour,
    parameters,
)
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.interruption import stoppable

if TYPE_CHECKING:
    from hyperflex.estimate import Change, FrameThread, LiveEstimate, RopeTracker, Watch
    from hyperflex.vision import Image, VideoWriter

_TICK, _FILE_TICK = 0.1, 5.0  # s without a frame, from a camera and a file, after which an estimate is given anyway


def watch(
    source: Annotated[
        str, typer.Argument(help="Number of a camera (0 is the first), a stream (rtsp://...), or a video.")
    ],
    rope: Annotated[Path, typer.Option(help="TOML file with the rope.")],
    camera: Camera,
    arc_lengths: ArcLengths = None,
    out: Annotated[Path, typer.Option("-o", "--output", help="NetCDF file for the log.")] = Path("watch.nc"),
    preview: Preview = None,
    page: Annotated[
        int | None, typer.Option(help="Port of a page on this machine that shows the pictures; 0: any free one.")
    ] = None,
    click: Click = None,
    estimate: Estimate = "",
    changes: Changes = "",
    false_alarm_interval: FalseAlarmInterval = 600.0,
    duration: Annotated[float | None, typer.Option(help="Stop after this time, s.")] = None,
    reconnect_timeout: Annotated[float, typer.Option(help="Time for which a lost source is tried again, s.")] = 10.0,
) -> None:
    """Follow a rope live by its markers and its dynamics.

    At every frame, and while none arrives, the command reports where the rope is, the age and uncertainty of this
    estimate, and detected changes: a mass at the tip, for example, or a touch. It ends with the source or by Ctrl-C,
    and then writes the log; the log of an interrupted run is marked. A video is followed frame by frame, with --page at
    its own speed. With --json it prints one JSON object a line: one for each estimate, and a summary.
    """
    from threadpoolctl import threadpool_limits

    from hyperflex.estimate import PicturePage, TrackingTask, Watch, WatchLog, open_frames
    from hyperflex.model import Rope
    from hyperflex.vision import read_camera

    for each, suffix in ((out, ".nc"), (preview, ".mp4")):
        check_destination(each, suffix, [rope, camera, Path(source)])
    if not arc_lengths:
        raise InvalidInput("--arc-lengths is missing", fix="Give the distance of each marker along the rope, m")
    until = math.inf if duration is None else checks.number("--duration", duration, sign="positive", unit="s")
    lens, line = read_camera(camera), Rope.from_toml(rope)
    arcs = numbers("--arc-lengths", arc_lengths, "0.2,0.4,0.6")
    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1))
        pictures = None if page is None else stack.enter_context(PicturePage(page))
        frames = stack.enter_context(open_frames(source, paced=page is not None, reconnect_timeout=reconnect_timeout))
        if not frames.live and frames.image_size != lens.image_size:
            got, allowed = ("x".join(map(str, size)) for size in (frames.image_size, lens.image_size))
            raise InvalidInput("the video has another size than the camera's", got=got, allowed=allowed)
        colour = marker_colour(_images(frames, reconnect_timeout), click)
        task = TrackingTask(
            line,
            checks.array("--arc-lengths", arcs, (-1,)),
            lens,
            colour,
            parameters=parameters(estimate),
            tests=change_tests(changes, false_alarm_interval),
        )
        task.rehearse()
        tracker = task.tracker()
        follow = Watch(frames, tracker, interval=_TICK if frames.live or page is not None else _FILE_TICK)
        if pictures is not None:
            output.note(f"pictures at {pictures.address}")
        shown = _Pictures(tracker, preview, pictures)
        tally = _Tally()
        with WatchLog(out, line.n_links, len(arcs), source) as log, shown:
            with stoppable() as stop:
                _run(follow, until, [log.note, tally.note, shown.draw])
                log.ending = frames.ended or f"stopped after {duration:g} s"
            log.interrupted = stop.received
    result = {"output": out, "ending": log.ending, "interrupted": log.interrupted, **tally.summary(tracker)}
    latency = result["latency_s"]
    rows = [
        ("ended", log.ending),
        ("seen", f"{100.0 * result['seen']:.1f} % of all markers, {result['found']} frames with a rope"),
        ("latency", f"median {1e3 * latency['median']:.1f} ms, 99 % at most {1e3 * latency['p99']:.1f} ms"),
        *((name, f"{each['value']:.5g} ± {each['std']:.2g}") for name, each in result["estimated"].items()),
        ("messages", str(result["messages"])),
        *([("warning", result["warning"])] if result["warning"] else []),
        ("written", str(out)),
    ]
    stopped = f"Interrupted; the log is kept in {out}." if log.interrupted else ""
    output.show(result, Rows(f"Watched {result['frames']} frames", rows), one_line=True, interrupted=stopped)


def _run(follow: Watch, until: float, takers: list[Callable[[LiveEstimate], None]]) -> None:
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
                for words in estimate.messages:
                    output.note(f"{estimate.t:.2f} s: {words}")
            if time.monotonic() - begin > until:
                return


def _status(estimate: LiveEstimate) -> list[str]:
    """Return the status in two short lines."""
    sure = f"tip ± {1e3 * estimate.tip_std:.1f} mm" if estimate.found else "rope not found"
    late = "no frame" if estimate.frame is None else f"latency {1e3 * estimate.latency:.1f} ms"
    age = "never seen" if math.isinf(estimate.age) else f"seen {1e3 * estimate.age:.0f} ms ago"
    return [
        f"{estimate.t:.2f} s   {estimate.rate:.1f} frames/s   {late}",
        f"{estimate.seen} of {estimate.markers} markers, {age}   {sure}",
    ]


def _line(estimate: LiveEstimate) -> dict[str, Any]:
    """Return an estimate for a program."""
    names = ("t", "found", "tip", "tip_std", "age", "latency", "rate", "seen", "markers")
    state = {"frame": estimate.frame is not None, "q": estimate.state.q, "qd": estimate.state.qd}
    return {name: getattr(estimate, name) for name in names} | state | {"messages": list(estimate.messages)}


class _Tally:
    """Counts what a run has seen."""

    def __init__(self) -> None:
        self.frames = self.found = self.seen = self.markers = self.messages = 0
        self.changes: list[Change] = []
        self.latency = [0] * 4096  # frames of 0 to 0.1 ms, 0.1 to 0.2 ms, ...

    def note(self, estimate: LiveEstimate) -> None:
        """Count an estimate."""
        self.messages += len(estimate.messages)
        self.changes += [] if estimate.tracked is None else estimate.tracked.changes
        if estimate.frame is None:
            return
        self.frames += 1
        self.found += estimate.found
        self.seen, self.markers = self.seen + estimate.seen, self.markers + estimate.markers
        self.latency[min(int(1e4 * estimate.latency), len(self.latency) - 1)] += 1

    def summary(self, tracker: RopeTracker) -> dict[str, Any]:
        """Return the counts by name."""
        return {
            "frames": self.frames,
            "found": self.found,
            "seen": self.seen / max(self.markers, 1),
            "latency_s": {"median": self._quantile(0.5), "p99": self._quantile(0.99)},
            "messages": self.messages,
            "noise_level": tracker.estimator.measurement_noise.value,
            "warning": tracker.warning,
            "changes": [asdict(change) for change in self.changes],
            "estimated": {
                name: {"value": value, "std": std} for name, (value, std) in tracker.estimator.values.items()
            },
        }

    def _quantile(self, part: float) -> float:
        """Return the latency, s, that a part of the frames did not exceed."""
        left = part * self.frames
        for k, count in enumerate(self.latency):
            left -= count
            if left <= 0.0:
                return 1e-4 * (k + 1)
        return math.nan


class _Pictures:
    """Draws what is known on the frames, for a film and for the page."""

    def __init__(self, tracker: RopeTracker, preview: Path | None, page: Any) -> None:
        self.tracker, self.preview, self.page = tracker, preview, page
        self._stack, self._begin = ExitStack(), 0.0
        self._writer: VideoWriter | None = None

    def __enter__(self) -> None:
        self._stack.__enter__()

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def draw(self, estimate: LiveEstimate) -> None:
        """Draw an estimate, if its frame can be used and somebody wants it."""
        from hyperflex.estimate import draw_frame
        from hyperflex.vision import VideoWriter

        looked = self.page is not None and self.page.watched
        if estimate.frame is None or estimate.tracked is None or (self.preview is None and not looked):
            return
        image = draw_frame(estimate.frame.image, self.tracker, estimate.tracked, _status(estimate))
        if looked:
            self.page.show(image)
        if self.preview is not None:
            if self._writer is None:
                self._writer = self._stack.enter_context(VideoWriter(self.preview, self.tracker.camera.image_size))
                self._begin = estimate.frame.time
            self._writer.write(image, estimate.frame.time - self._begin)


def _images(frames: FrameThread, reconnect_timeout: float) -> Iterator[Image]:
    """Yield pictures for so long, s; the last one that was asked for is left to be taken."""
    until, count = time.monotonic() + reconnect_timeout, 0
    while (frame := frames.peek(max(0.0, until - time.monotonic()))) is not None:
        count += 1
        yield frame.image
        frames.take(0.0)
    if not count and frames.ended:
        raise FileProblem(frames.ended)
