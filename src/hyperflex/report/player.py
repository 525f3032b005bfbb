"""A player of a run in one HTML file: rope, arm, obstacles and plots, to scrub and slow down, without a network."""

import base64
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.model import Obstacle, Peg
from hyperflex.report.page import render
from hyperflex.report.shapes import NO_TARGETS, shapes, span, view
from hyperflex.trajectory import Trajectory

Note = Callable[[float], str]
FRAME_RATE = 60.0  # frames a second, unless a run is so long that these would be more than
MOST_FRAMES = 3600
_PLOTTED = 1500  # samples of a curve, about
_ALIKE = 1e-6  # by which a sampling interval may be longer than a frame's
_PRECISION = 5e-5  # m, greatest error of a position
_NARROW, _WIDE = 2**15 - 1, 2**31 - 1


class Line(NamedTuple):
    """A curve: its label, empty where it is the only one of its plot, and its values (T,) at the run's samples."""

    label: str
    values: Array


class Dots(NamedTuple):
    """Measured places to mark: times (K,), s, and places (K, m, 2), m, NaN where there are none."""

    t: Array
    places: Array


class Plot(NamedTuple):
    """A plot over time: what it shows, the unit, and its curves, three at most."""

    title: str
    unit: str
    lines: tuple[Line, ...]


def player_html(
    run: Trajectory,
    *,
    start: float | None = None,
    end: float | None = None,
    frame_rate: float | None = None,
    speed: float = 1.0,
    title: str = "",
    note: Note | None = None,
    targets: Array | None = None,
    obstacles: Sequence[Obstacle] = (),
    plots: Sequence[Plot] = (),
    marks: Sequence[float] = (),
    dots: Dots | None = None,
    ropes: Sequence[Trajectory] = (),
    autoplay: bool = True,
) -> str:
    """Return the HTML document that plays a run; ``#t=1.5`` behind its address shows the run at that time, s.

    Parameters
    ----------
    run
        What to show.
    start, end : float, optional
        Simulated time to show, s; the whole run by default.
    frame_rate : float, optional
        Frames a simulated second, Hz; the page moves the rope between them on cubics. Where the run has samples as
        close as that, the frames are samples. By default they are all samples, if these are as close as FRAME_RATE and
        at most MOST_FRAMES; else FRAME_RATE, or as many as make MOST_FRAMES.
    speed : float
        Simulated seconds a second at first, > 0.
    title, note : str, callable, optional
        Written above the picture; called with the simulated time, s, for the words below the title.
    targets : (k, 2) float64, optional
        Points to mark with a ring, m.
    obstacles : sequence of Peg, Wall, Ground, optional
        Those of the set-up that the rope must not touch, in a colour of their own.
    plots : sequence of Plot, optional
        Shown after arm angle, speed of the tip and energy.
    marks : sequence of float, optional
        Times that the plots mark, s.
    dots : Dots, optional
        Measured places, marked by rings; those that are next in time.
    ropes : sequence of Trajectory, optional
        Further runs of as many links, drawn thin beside it, such as draws of what is not known exactly.
    autoplay : bool
        Whether it plays at once.

    Raises
    ------
    InvalidInput
        Another frame rate, speed or span than allowed.
    """
    first, last = span(run, start, end)
    if frame_rate is not None:
        checks.number("frame_rate", frame_rate, sign="positive", unit="Hz")
    times = _frame_times(run, first, last, frame_rate)
    targets = NO_TARGETS if targets is None else targets
    drawn = shapes(run, times)
    arm = run.setup.arm is not None
    points = np.concatenate([drawn.pivots[:, None], drawn.joints], axis=1) if arm else drawn.joints
    words = [] if note is None else [(float(t), note(float(t))) for t in times]
    low, high = view(run, np.concatenate([points.reshape(-1, 2), targets]), above=1.0)
    data = {
        "times": _packed(times),
        **_places(points),
        "points": points.shape[1],
        "arm": arm,
        "radius": run.setup.rope.radius,
        "view": [*low, *high],
        "obstacles": _obstacles(run, obstacles),
        "peg_angles": None if run.peg_angle is None else _packed(_at(run, run.peg_angle, times).astype("<f4")),
        "targets": targets.tolist(),
        "dots": None if dots is None else {"t": _packed(dots.t), "places": _packed(dots.places.astype("<f4"))},
        "ropes": [_packed(shapes(each, times).joints.astype("<f4")) for each in ropes],
        "notes": [each for k, each in enumerate(words) if not k or each[1] != words[k - 1][1]],
        "note_lines": max((text.count("\n") + 1 for _, text in words), default=0),
        "marks": [[t] for t in marks],
        "speed": checks.number("speed", speed, sign="positive"),
        "trail": 0.8,
        "autoplay": autoplay,
        **_curves(run, first, last, plots),
    }
    return render("player.html", title=title, data=files.plain(data))


def write_player(run: Trajectory, path: str | Path, **options: Any) -> None:
    """Write the page of :func:`player_html`, with its options, to `path`, whole or not at all."""
    files.write_text(path, player_html(run, **options))


def _frame_times(run: Trajectory, first: float, last: float, given: float | None) -> Array:
    """Return the frames' times: samples, all or those next to a uniform grid, or the grid if they are too few."""
    rate = min(FRAME_RATE, MOST_FRAMES / (last - first)) if given is None else given
    grid = np.linspace(first, last, max(round((last - first) * rate), 1) + 1)
    samples = run.t[(run.t >= first) & (run.t <= last)]
    if samples.size < 2 or np.diff(samples, prepend=first, append=last).max() > (1.0 + _ALIKE) / rate:
        return grid
    if given is None and samples.size <= MOST_FRAMES + 1:
        return np.asarray(samples)
    right = np.clip(samples.searchsorted(grid), 1, samples.size - 1)
    nearest = right - (grid - samples[right - 1] < samples[right] - grid)
    return np.asarray(samples[np.unique(nearest)])


def _places(points: Array) -> dict[str, Any]:
    """Return positions (k, m, 2), m, as whole numbers of steps from a centre; of two bytes where that is precise."""
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    extent = max(float((high - low).max()), 1e-9)
    step = 0.5 * extent / _NARROW
    wide = step > np.sqrt(2.0) * _PRECISION  # half a step off in x and y
    step = 0.5 * extent / _WIDE if wide else step
    centre = 0.5 * (low + high)
    steps = np.rint((points - centre) / step).astype("<i4" if wide else "<i2")
    return {"places": _packed(steps), "wide": bool(wide), "centre": centre.tolist(), "step": step}


def _obstacles(run: Trajectory, avoided: Sequence[Obstacle]) -> list[dict[str, Any]]:
    """Return what there is beside the rope; `turns` is the place of a round peg among those, None of one that is fixed.

    `avoided` are those that it must not touch.
    """
    found, pegs = [], run.setup.round_pegs
    for each in run.setup.pegs:
        turns = pegs.index(each) if isinstance(each, Peg) and each.turns else None
        found.append({**asdict(each), "kind": type(each).__name__.lower(), "turns": turns, "avoided": each in avoided})
    return found


def _curves(run: Trajectory, first: float, last: float, plots: Sequence[Plot]) -> dict[str, Any]:
    """Return the curves of arm, tip and energy, and those given, at samples between two times, thinned out."""
    kept = np.flatnonzero((run.t >= first) & (run.t <= last))
    kept = kept[:: max(kept.size // _PLOTTED, 1)]
    lines = [
        Plot("speed of the tip", "m/s", (Line("", np.hypot(*run.tip_velocity.T)),)),
        Plot(
            "energy",
            "J",
            (
                Line("kinetic", run.kinetic_energy),
                Line("potential", run.potential_energy - run.potential_energy[0]),
                Line("motor's work", run.motor_work),
            ),
        ),
        *plots,
    ]
    if run.setup.arm is not None:
        lines.insert(0, Plot("arm", "degrees", (Line("", np.degrees(run.arm_angle)),)))
    series = [
        {
            "title": plot.title,
            "unit": plot.unit,
            "digits": _digits(plot),
            "lines": [{"label": line.label, "values": _packed(line.values[kept].astype("<f4"))} for line in plot.lines],
        }
        for plot in lines
    ]
    return {"series_times": _packed(run.t[kept].astype("<f4")), "series": series}


def _digits(plot: Plot) -> int:
    """Return how many decimals three digits of the greatest value leave."""
    greatest = max(float(np.nanmax(np.abs(line.values), initial=0.0)) for line in plot.lines)
    return int(np.clip(2 - np.floor(np.log10(greatest)), 0, 6)) if greatest > 0.0 else 2


def _at(run: Trajectory, values: Array, times: Array) -> Array:
    return np.stack([np.interp(times, run.t, column) for column in values.T], axis=-1)


def _packed(values: npt.NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
