"""``hyperflex watch``: a rope followed live, frame by frame, from a camera, a stream or a file."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex import checks
from hyperflex.cli import output
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.interruption import catch_interrupt

if TYPE_CHECKING:
    from hyperflex.estimate import Change, FrameThread, LiveEstimate, RopeTracker, Watch
    from hyperflex.vision import Image, VideoWriter

_TICK, _FILE_TICK = 0.1, 5.0  # s without a frame after which an estimate is handed out all the same


def watch(
    camera: Annotated[
        str,
        typer.Option(help="The camera's number (0 is the first), a stream (rtsp://...), or a video."),
    ],
    rope: Annotated[Path, typer.Option(help="TOML file with the rope.")],
    calibration: Annotated[Path, typer.Option(help="TOML file of the camera, with the swing plane (calibrate).")],
    arc_lengths: Annotated[list[str], output.ARC_LENGTHS],
    out: Annotated[Path, typer.Option("-o", "--output", help="NetCDF file for the log.")] = Path("watch.nc"),
    preview: Annotated[
        Path | None, typer.Option(help="MP4 file of the pictures with what is known drawn on them.")
    ] = None,
    page: Annotated[
        int | None,
        typer.Option(help="Show the pictures in a browser of this machine, at this port; 0: any free one."),
    ] = None,
    click: output.Click = None,
    estimate: output.Estimate = "",
    changes: output.Changes = "",
    false_alarm_interval: output.FalseAlarmInterval = 600.0,
    duration: Annotated[float | None, typer.Option(help="Stop after so long, s.")] = None,
    reconnect_timeout: Annotated[float, typer.Option(help="How long a lost source is tried again, s.")] = 10.0,
    json: Annotated[
        bool, typer.Option("--json", help="Print a JSON object a line: one for each estimate, and a summary.")
    ] = False,
) -> None:
    """Follow a rope live by its markers and its dynamics, until the source ends or Ctrl-C.

    At every frame, and while none comes, it says where the rope is, how old that is and how sure, and what was noticed
    to have changed: a mass at the tip, say, or a touch. The log is written
    when the run ends; an interrupted one is kept, and marked. A video is followed frame by frame, with --page at its
    own speed.
    """
    from threadpoolctl import threadpool_limits

    from hyperflex.estimate import PicturePage, TrackingTask, Watch, WatchLog, open_frames
    from hyperflex.model import Rope
    from hyperflex.vision import read_camera

    inputs = [rope, calibration, Path(camera)]
    output.check_destination(out, ".nc", inputs)
    output.check_destination(preview, ".mp4", inputs)
    until = math.inf if duration is None else checks.number("--duration", duration, sign="positive", unit="s")
    lens, line = read_camera(calibration), Rope.from_toml(rope)
    arcs = output.numbers("--arc-lengths", arc_lengths, "0.2,0.4,0.6")
    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1))
        pictures = None if page is None else stack.enter_context(PicturePage(page))
        frames = stack.enter_context(open_frames(camera, paced=page is not None, reconnect_timeout=reconnect_timeout))
        if not frames.live and frames.image_size != lens.image_size:
            got, allowed = ("x".join(map(str, size)) for size in (frames.image_size, lens.image_size))
            raise InvalidInput("the video has another size than the camera's", got=got, allowed=allowed)
        colour = output.marker_colour(_images(frames, reconnect_timeout), click)
        task = TrackingTask(
            line,
            checks.array("--arc-lengths", arcs, (-1,)),
            lens,
            colour,
            parameters=output.parameters(estimate),
            tests=output.change_tests(changes, false_alarm_interval),
        )
        task.rehearse()
        tracker = task.tracker()
        follow = Watch(frames, tracker, interval=_TICK if frames.live or page is not None else _FILE_TICK)
        if pictures is not None:
            sys.stderr.write(f"hyperflex: pictures at {pictures.address}\n")
        shown = _Pictures(tracker, preview, pictures)
        tally = _Tally()
        with WatchLog(out, line.n_links, len(arcs), camera) as log, shown:
            with catch_interrupt() as stop:
                _run(follow, until, [log.note, tally.note, shown.draw], json)
                log.ending = frames.ended or f"stopped after {duration:g} s"
            log.interrupted = stop.received
    result = {"output": out, "ending": log.ending, "interrupted": log.interrupted, **tally.summary(tracker)}
    if log.interrupted:
        raise typer.Exit(output.interrupted(f"Interrupted; the log is kept in {out}.", result, as_json=json))
    _tell(result, json)


def _run(follow: Watch, until: float, takers: list[Callable[[LiveEstimate], None]], as_json: bool) -> None:
    """Hand each estimate to all who take it, until the source or the time ends."""
    begin = time.monotonic()
    with output.spinner() as said:
        for estimate in follow:
            for take in takers:
                take(estimate)
            if as_json:
                output.print_json(_line(estimate), one_line=True)
            else:
                said("   ".join(_status(estimate)))
                for words in estimate.messages:
                    sys.stderr.write(f"hyperflex: {estimate.t:.2f} s: {words}\n")
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


def _tell(result: dict[str, Any], as_json: bool) -> None:
    latency = result["latency_s"]
    output.show(
        result,
        f"Watched {result['frames']} frames",
        [
            ("ended", result["ending"]),
            ("seen", f"{100.0 * result['seen']:.1f} % of all markers, {result['found']} frames with a rope"),
            ("latency", f"median {1e3 * latency['median']:.1f} ms, of 99 % at most {1e3 * latency['p99']:.1f} ms"),
            *((name, f"{each['value']:.5g} ± {each['std']:.2g}") for name, each in result["estimated"].items()),
            ("messages", str(result["messages"])),
            *([("warning", result["warning"])] if result["warning"] else []),
            ("written", str(result["output"])),
        ],
        as_json=as_json,
        one_line=True,
    )


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
