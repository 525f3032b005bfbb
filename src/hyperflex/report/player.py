"""A player of a run in one HTML file: rope, arm, obstacles and plots, to scrub and slow down, without a network."""

import base64
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks, files
from hyperflex.checks import Array, ByName
from hyperflex.model import Obstacle, Peg
from hyperflex.report.curves import course
from hyperflex.report.page import render
from hyperflex.report.scene import PLAIN, Overlay, Plot, shapes, span, view
from hyperflex.trajectory import Trajectory

FRAME_RATE = 60.0  # Hz, of screens: frames a second of simulated time
MOST_FRAMES = 3600  # of a page, which stays small enough to be sent: a minute at FRAME_RATE


def player_html(
    run: Trajectory,
    *,
    start: float | None = None,
    end: float | None = None,
    frame_rate: float | None = None,
    speed: float = 1.0,
    title: str = "",
    overlay: Overlay = PLAIN,
    autoplay: bool = True,
) -> str:
    """Return the HTML document that plays a run; ``#t=1.5`` behind its address shows the run at that time, s.

    Parameters
    ----------
    run : Trajectory
    start, end : float, optional
        Simulated time to show, s; the whole run by default.
    frame_rate : float, optional
        Frames a simulated second, Hz; the page interpolates between them by cubics. By default the frames are the
        samples of the run if these are at least FRAME_RATE and not more than MOST_FRAMES; else FRAME_RATE, or as many
        as make MOST_FRAMES.
    speed : float
        Simulated seconds a second at first, > 0.
    title : str
        Text above the picture.
    overlay : Overlay
        What is shown in addition to the run.
    autoplay : bool
        Whether it plays at once.

    Raises
    ------
    InvalidInput
        If the frame rate, the speed or the times cannot be used.
    """
    first, last = span(run, start, end)
    if frame_rate is not None:
        checks.positive("frame_rate", frame_rate, "Hz")
    times, note = _frame_times(run, first, last, frame_rate), overlay.note
    drawn = shapes(run, times)
    arm = run.setup.arm is not None
    points = np.concatenate([drawn.pivots[:, None], drawn.joints], axis=1) if arm else drawn.joints
    dots, turned = (
        overlay.dots,
        [np.interp(times, run.t, each) for each in ([] if run.peg_angle is None else run.peg_angle.T)],
    )
    words = [] if note is None else [(float(t), note(float(t))) for t in times]
    low, high = view(run, np.concatenate([points.reshape(-1, 2), overlay.targets]), above=1.0)
    data = {
        "times": _packed(times),
        **_places(points),
        "points": points.shape[1],
        "arm": arm,
        "radius": run.setup.rope.radius,
        "view": [*low, *high],
        "obstacles": _obstacles(run, overlay.obstacles),
        "peg_angles": None if run.peg_angle is None else _packed(np.stack(turned, axis=-1).astype("<f4")),
        "targets": overlay.targets.tolist(),
        "dots": dots and {"t": _packed(dots.t), "places": _packed(dots.places.astype("<f4"))},
        "ropes": [_packed(shapes(each, times).joints.astype("<f4")) for each in overlay.ropes],
        "notes": [each for k, each in enumerate(words) if not k or each[1] != words[k - 1][1]],
        "note_lines": max((text.count("\n") + 1 for _, text in words), default=0),
        "marks": [[t] for t in overlay.marks],
        "speed": checks.positive("speed", speed),
        "trail": overlay.trail,
        "autoplay": autoplay,
        **_curves(run, first, last, overlay.plots),
    }
    return render("player.html", title=title, data=files.plain(data))


def write_player(run: Trajectory, path: str | Path, **options: Any) -> None:
    """Write the page of :func:`player_html`, with its options, to `path`, whole or not at all."""
    files.write_text(path, player_html(run, **options))


def _frame_times(run: Trajectory, first: float, last: float, rate: float | None) -> Array:
    """Return the times of the frames, s: the run's samples, if these are close enough and not too many, else a grid."""
    samples = run.t[(run.t >= first) & (run.t <= last)]
    if rate is None:
        rate = min(FRAME_RATE, MOST_FRAMES / (last - first))
        if samples.size <= MOST_FRAMES + 1 and np.diff(samples, prepend=first, append=last).max() < 1.001 / rate:
            return samples
    return np.linspace(first, last, max(round((last - first) * rate), 1) + 1)


def _places(points: Array) -> ByName:
    """Return positions (k, m, 2), m, as whole numbers of steps from a centre; two bytes each where that is precise."""
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    extent = max(float((high - low).max()), 1e-9)
    wide = extent > 4.6  # m: with two bytes a coordinate, positions would be off by more than 0.05 mm
    kind = np.dtype("<i4" if wide else "<i2")
    step, centre = 0.5 * extent / np.iinfo(kind).max, 0.5 * (low + high)
    steps = np.rint((points - centre) / step).astype(kind)
    return {"places": _packed(steps), "wide": wide, "centre": centre.tolist(), "step": step}


def _obstacles(run: Trajectory, avoided: Sequence[Obstacle]) -> list[ByName]:
    """Return pegs, walls and grounds; `turns` is the index of a peg that turns among round pegs, None of the others."""
    found, pegs = [], run.setup.round_pegs
    for each in run.setup.pegs:
        turns = pegs.index(each) if isinstance(each, Peg) and each.turns else None
        found.append({**asdict(each), "kind": type(each).__name__.lower(), "turns": turns, "avoided": each in avoided})
    return found


def _curves(run: Trajectory, first: float, last: float, plots: Sequence[Plot]) -> ByName:
    """Return the curves of every run and of further plots at samples between two times, thinned out."""
    kept = np.flatnonzero((run.t >= first) & (run.t <= last))
    kept = kept[:: max(kept.size // 1500, 1)]  # a plot has fewer pixels
    series = [
        {
            "title": plot.title,
            "unit": plot.unit,
            "level": plot.level,
            "lines": [{"label": line.label, "values": _packed(line.values[kept].astype("<f4"))} for line in plot.lines],
        }
        for plot in (*course(run), *plots)
    ]
    return {"series_times": _packed(run.t[kept].astype("<f4")), "series": series}


def _packed(values: npt.NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
