"""Online estimation by a camera (paper section III D): rendered swings, those who follow them, Fig. 8, claim C8.

The cable of section IV swings freely from 1.2 m off its rest position, a rope of 100 links, and a camera sees ten
markers of it 7.5 times a second; whoever follows it has 50 links or none. It is first seen in the middle of the swing,
so that rates are not known. Pictures are rendered, 5 mm a pixel; each marker is 1.5 mm off by chance in each frame.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hyperflex.checks import Array, ByName, Flags
from hyperflex.estimate import MarkerMeasurement, RopeFilter, RopeTracker
from hyperflex.model import divided
from hyperflex.paper.casting import cable
from hyperflex.paper.estimator import SAMPLES, BlobTracker, OnlineEstimator, capture
from hyperflex.paper.identification import RATE
from hyperflex.paper.part import Claim, Item, Part, Table
from hyperflex.report import BLUE, GREEN, GREY, INK, RED, Figure, Section, TextTable, legend, new_figure
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory
from hyperflex.vision import (
    Camera,
    Frame,
    MarkerColour,
    MarkerDetector,
    Renderer,
    RopeMotion,
    Scene,
    Truth,
    order_markers,
    random_occlusion,
)

T_SIM = 1.0 / RATE  # s
AHEAD = np.linspace(0.0, T_SIM, SAMPLES + 1)  # s, at which a prediction is compared
LENGTH, MARKERS, AMPLITUDE = 2.0, 10, 1.2  # m
FINE = 100  # links of the rope that is seen
START, DURATION = 0.4, 8.0  # s, of the first frame and until the last
SINCE = 1.0  # s after the first frame, from which captures and errors count
NOISE = 0.0015  # m, of each coordinate of a marker in each frame
FEW = 0.7  # part of the markers; if fewer are found in their windows, the whole picture is searched
_RUN_RATE = 600.0  # samples a second of the simulated swing
TRACKERS = ("paper", "filter", "constant velocity", "nearest blob")
TITLES = dict(zip(TRACKERS, ("the paper's estimator", "RopeTracker", "constant velocity", "nearest blob"), strict=True))
_STYLE: ByName = {
    name: {"color": colour, "marker": marker, "ms": 3.5, "label": TITLES[name]}
    for name, colour, marker in zip(TRACKERS, (BLUE, GREEN, RED, GREY), "os^v", strict=True)
}
_FIGURES = {  # of a summary: title, factor to the unit shown
    "captured": (f"captured after {SINCE:g} s, %", 1e2),
    "wrong": ("taken for another, %", 1e2),
    "tip": ("tip at frames, mm", 1e3),
    "between": ("between frames, mm", 1e3),
    "velocity": ("tip velocity, %", 1e2),
    "rates": ("link rates, %", 1e2),
}


@dataclass(frozen=True)
class FreeSwing:
    """One swing; the seed bends the rope at the start, and covers markers."""

    seed: int = 0
    on_tip: bool = True

    @property
    def title(self) -> str:
        """The swing in words."""
        return f"free swing of {AMPLITUDE:g} m{'' if self.on_tip else ', no marker on the tip'}, seed {self.seed}"

    @property
    def arc_lengths(self) -> Array:
        """Of the markers, m; without one on the tip the last is 0.1 m above it."""
        spacing = LENGTH / MARKERS
        return np.linspace(spacing, LENGTH, MARKERS) - (0.0 if self.on_tip else 0.5 * spacing)


SWINGS = tuple(FreeSwing(seed) for seed in range(7))
DRAWN = SWINGS[6]  # where two frames lose markers at first, as the paper's did


class NoisyMotion(RopeMotion):
    """The motion of a run with independent small errors of the markers in each frame."""

    def __init__(self, run: Trajectory, arc_lengths: Array, seed: int) -> None:
        super().__init__(run.t, run.q, run.qd, run.setup.rope.length)
        self._arcs, frames = arc_lengths, round(RATE * DURATION) + 1
        self._off = NOISE * np.random.default_rng((seed, 1)).normal(size=(frames, arc_lengths.size, 2))

    def places(self, t: ArrayLike, arc_lengths: ArrayLike) -> Array:
        """Return places (m, P, 3), m: x, y and off the plane, at times (m,), s, of points (P,), m along the rope."""
        result, of = super().places(t, arc_lengths), np.isclose(np.asarray(arc_lengths)[:, None], self._arcs)
        frame = np.clip(np.round((np.atleast_1d(t) - START) * RATE).astype(int), 0, len(self._off) - 1)
        result[..., :2] += of @ self._off[frame]
        return result


@dataclass(frozen=True, eq=False)
class Seen:
    """A swing of T frames as it was, and as the camera saw it."""

    swing: FreeSwing
    camera: Camera
    detector: MarkerDetector
    frames: tuple[Frame, ...]
    truth: Truth
    tip: Array  # (T, SAMPLES + 1, 2) m, true places at each frame and until the next one
    velocity: Array  # (T, 2) m/s, of the tip
    rates: Array  # (T, 50) rad/s, of the 100 links two by two

    def ordered(self, frame: Frame) -> Array:
        """Return the markers (K, 2) in a whole frame, m, in the order in which a rope runs through them; NaN: none."""
        places = self.camera.locate(self.detector.find(frame.image).places)
        order = order_markers(places, self.swing.arc_lengths, np.zeros(2))
        return np.where((order.indices[:, None] >= 0) & order.certain, places[order.indices], np.nan)


@cache
def seen(swing: FreeSwing) -> Seen:
    """Simulate a swing and render it; each is made once in a process."""
    rng, s = np.random.default_rng(swing.seed), np.linspace(0.0, 1.0, FINE)
    bend = 0.15 * rng.normal() * np.sin(np.pi * s) + 0.1 * rng.normal() * np.sin(2.0 * np.pi * s)
    t = np.arange(0.0, DURATION, 1.0 / _RUN_RATE)
    finer = divided(cable(), FINE // cable().n_links)
    run = simulate(finer, duration=DURATION, q0=np.arcsin(AMPLITUDE / LENGTH) + bend, t_eval=t, tol=1e-6)
    camera = Camera.facing((640, 480), pixels_per_metre=200.0, origin=(320.0, 30.0), exposure=0.005)
    hidden = random_occlusion(MARKERS, 0.1, 0.15, until=DURATION, seed=swing.seed)
    scene = Scene(swing.arc_lengths, marker_diameter=0.04, hidden=hidden, seed=swing.seed)
    stamps = np.arange(START, DURATION - T_SIM, T_SIM)
    renderer = Renderer(camera, NoisyMotion(run, swing.arc_lengths, swing.seed), scene)
    frames = tuple(Frame(stamp, renderer.image(stamp), k) for k, stamp in enumerate(stamps.tolist()))
    motion = RopeMotion.from_trajectory(run)
    truth = Renderer(camera, motion, scene).truth(stamps)
    clicked = [MarkerColour.from_click(frames[0].image, place) for place in truth.pixels[0, truth.visible[0]]]
    detector = MarkerDetector(sorted(clicked, key=lambda each: each.area or 0.0)[len(clicked) // 2])

    def tip(times: Array) -> Array:
        return motion.places(times.ravel(), [LENGTH])[:, 0, :2].reshape(*times.shape, 2)

    sample = np.round(stamps * _RUN_RATE).astype(int)
    rates = np.asarray(run.qd)[sample].reshape(stamps.size, -1, 2).mean(axis=2)
    return Seen(swing, camera, detector, frames, truth, tip(stamps[:, None] + AHEAD), run.tip_velocity[sample], rates)


class Step(NamedTuple):
    """Result of a tracker for a frame with K markers; NaN: not known."""

    places: Array  # (K, 2) m, of the markers found
    expected: Array  # (K, 2) m, where they were expected; NaN in the first frame
    tip: Array  # (SAMPLES + 1, 2) m, in the frame and, predicted, until the next one
    velocity: Array  # (2,) m/s, of the tip
    rates: Array  # (50,) rad/s, of the links
    took: tuple[float, float] = (np.nan, np.nan)  # s, to find the markers, the paper's T_v, and to simulate ahead


@dataclass(frozen=True, eq=False)
class Followed:
    """Result of one of the TRACKERS for a swing of T frames; fields are those of a :class:`Step`, of all frames."""

    seen: Seen
    places: Array
    expected: Array
    tip: Array
    velocity: Array
    rates: Array
    took: Array

    @property
    def t(self) -> Array:
        """Times of the frames (T,), s."""
        return self.seen.truth.stamps

    @property
    def captured(self) -> Flags:
        """Visible markers that were found with the right identity (T, K)."""
        truth = self.seen.truth
        apart = np.linalg.norm(truth.places[:, None, :, :2] - self.places[:, :, None], axis=3)
        right = np.nan_to_num(apart).argmin(axis=2) == np.arange(truth.visible.shape[1])
        return np.asarray(truth.visible & ~np.isnan(self.places[:, :, 0]) & right)

    @property
    def captured_share(self) -> Array:
        """Part of the visible markers in each frame (T,) that was found and rightly named."""
        return np.asarray(self.captured.sum(axis=1) / np.maximum(self.seen.truth.visible.sum(axis=1), 1))

    @property
    def expected_error(self) -> Array:
        """Root mean square over the markers (T,) of how far they were from where they were expected, m."""
        off = self.expected - self.seen.truth.places[:, :, :2]
        return np.asarray(np.sqrt((off**2).sum(axis=2).mean(axis=1)))

    def summary(self, since: float = SINCE) -> dict[str, float | None]:
        """Figures from a time after the first frame, s, on."""
        late, truth = self.t >= self.t[0] + since, self.seen
        visible, captured = truth.truth.visible[late], self.captured[late]
        found = ~np.isnan(self.places[late, :, 0]) & visible
        off = np.linalg.norm(self.tip - truth.tip, axis=2)[late]
        return {
            "captured": float(captured.sum() / visible.sum()),
            "wrong": float((found & ~captured).sum() / visible.sum()),
            "tip": _rms(off[:, 0]),
            "between": _rms(off[:, 1:]),
            "velocity": _rms((self.velocity - truth.velocity)[late], truth.velocity[late]),
            "rates": _rms((self.rates - truth.rates)[late], truth.rates[late]),
        }


def _rms(error: Array, true: Array | float = 1.0) -> float | None:
    """Return the root mean square of an error, over that of the true values if given; None if it is not known."""
    return None if np.isnan(error).any() else float(np.sqrt((error**2).mean() / np.mean(np.square(true))))


@cache
def followed(name: str, seed: int = 0, on_tip: bool = True) -> Followed:
    """Return what one of the TRACKERS made of a swing; each is made once in a process."""
    subject = seen(FreeSwing(seed, on_tip))
    steps = _by_filter(subject) if name == "filter" else _by_windows(subject, name)
    return Followed(subject, *map(np.array, zip(*steps, strict=True)))


def _by_windows(subject: Seen, name: str) -> Iterator[Step]:
    """Follow a swing as the paper did: simulate or guess ahead, look in windows, correct."""
    times, arcs, found = subject.truth.stamps, subject.swing.arc_lengths, subject.ordered(subject.frames[0])
    known = np.append(True, ~np.isnan(found[:, 0]))
    ends, places = np.append(0.0, arcs)[known], np.vstack([np.zeros(2), found])[known]
    start = np.stack([np.interp(arcs, ends, column) for column in places.T], axis=1)
    paper = name == "paper"
    tracker: OnlineEstimator | BlobTracker = (
        OnlineEstimator(cable(), arcs, times[0], start)
        if paper
        else BlobTracker(times[0], start, moving=name == "constant velocity")
    )
    expected, looking, simulating = np.full_like(found, np.nan), np.nan, np.nan
    for k, frame in enumerate(subject.frames):
        if k:
            began = time.perf_counter()
            found = capture(frame.image, subject.detector, subject.camera, expected)
            looking = time.perf_counter() - began
            lost = np.isfinite(found[:, 0]).mean() < FEW  # the whole picture is searched, which counts as a loss
            tracker.correct(times[k], subject.ordered(frame) if lost else found)
        took, began = (looking, simulating), time.perf_counter()
        ahead = tracker.predict(times[k] + T_SIM)
        simulating = time.perf_counter() - began
        known_tip = 1.0 if subject.swing.on_tip or paper else np.nan
        rates = np.broadcast_to(ahead.rates, subject.rates[k].shape)
        yield Step(found, expected, known_tip * ahead.tip, known_tip * ahead.velocity, rates, took)
        expected = ahead.places


def _by_filter(subject: Seen) -> Iterator[Step]:
    """Follow a swing with the package's own tracker."""
    estimator = RopeFilter(cable(), subject.swing.arc_lengths, camera=subject.camera)
    tracker = RopeTracker(estimator, MarkerMeasurement(subject.detector))
    for k, frame in enumerate(subject.frames):
        looked = tracker.look(frame)
        if looked.state is None:
            unknown = (np.full_like(each[k], np.nan) for each in (subject.tip, subject.velocity, subject.rates))
            yield Step(*np.full((2, MARKERS, 2), np.nan), *unknown)
            continue
        q, qd = looked.state.q, looked.state.qd
        ahead = simulate(cable(), duration=T_SIM, q0=q, qd0=qd, t_eval=AHEAD)
        yield Step(looked.places, subject.camera.locate(looked.predicted), ahead.tip, ahead.tip_velocity[0], qd)


def _fig8() -> Table:
    runs = {name: followed(name, DRAWN.seed) for name in TRACKERS}
    subject = seen(DRAWN)
    columns = {"t": subject.truth.stamps, "visible": subject.truth.visible.sum(axis=1).astype(np.float64)}
    columns |= {"x_true": subject.tip[:, 0, 0], "y_true": subject.tip[:, 0, 1]}
    for name, run in runs.items():
        key = name.replace(" ", "_")
        columns |= {f"x_{key}": run.tip[:, 0, 0], f"y_{key}": run.tip[:, 0, 1]}
        columns |= {f"captured_{key}": run.captured_share, f"expected_error_{key}": run.expected_error}
    return Table(
        columns,
        source="rendered",
        title="tip, captured markers and errors of prediction, online",
        units="t in s; x, y of the tip and rms of how far markers were from their predicted places in m; captured: "
        "part of the visible ones; nan: not known",
        parameters=f"t_sim = {T_SIM:.3f} s, {DRAWN.title}",
    )


def _draw_fig8() -> "Figure":
    """Draw the tip as it is estimated, the capture rate, and the error of prediction, over time."""
    paper = followed("paper", DRAWN.seed)
    with new_figure(9.0, 8.0, f"Online estimation at {RATE:g} frames/s, rendered (Fig. 8)") as figure:
        tip, rate, error = figure.subplots(3, 1, sharex=True, height_ratios=(1.2, 1.0, 1.0))
        times = (paper.t[:, None] + AHEAD).ravel()
        tip.plot(times, paper.seen.tip[..., 0].ravel(), color=GREY, lw=3.0, alpha=0.5, label="true")
        tip.plot(times, paper.tip[..., 0].ravel(), color=INK, label="estimated, continuous")
        hit = paper.captured[:, -1]
        tip.plot(paper.t[hit], paper.places[hit, -1, 0], "o", color=BLUE, label="captured")
        expected = paper.expected[~hit, -1, 0]
        tip.plot(paper.t[~hit], expected, "x", color=RED, ms=6.0, label="not captured: predicted")
        for name in reversed(TRACKERS):
            run = followed(name, DRAWN.seed)
            rate.plot(run.t, 100.0 * run.captured_share, **_STYLE[name])
            error.plot(run.t, 1e3 * run.expected_error, **_STYLE[name])
        tip.set(ylabel="x of the tip, m")
        rate.set(ylabel="visible markers captured, %", ylim=(-4.0, 104.0))
        error.set(ylabel="error of prediction, mm (rms)", yscale="log", xlabel="time, s")
        legend(figure, tip, rate, place="lower center", columns=4)
    return figure


def captures_all(swing: FreeSwing) -> Claim:
    """C8: the capture rate goes to 100 %. Measured: the part of the visible markers captured after 4 s."""
    run = followed("paper", swing.seed, swing.on_tip)
    share, errors = run.captured_share, run.summary()
    lost = np.flatnonzero(share < 1.0)
    until = "no frame loses one" if not lost.size else f"the last is lost {run.t[lost[-1]] - run.t[0]:.1f} s after it"
    note = (
        f"first frames: {', '.join(f'{100.0 * each:.0f}' for each in share[:5])} %, {until}; tip rms after {SINCE:g} s "
        f"{1e3 * (errors['tip'] or 0.0):.1f} mm at frames, {1e3 * (errors['between'] or 0.0):.1f} mm predicted between"
    )
    statement = "the capture rate goes to 100 %: visible markers captured after 4 s"
    return Claim("C8", statement, swing, run.summary(4.0)["captured"] or 0.0, 0.995, note)


def in_time(swing: FreeSwing) -> Claim:
    """C8: looking and simulating are done before the prediction is due. Measured: (T_v + alpha t_sim) / t_sim."""
    looking, simulating = np.median(followed("paper", swing.seed, swing.on_tip).took[1:], axis=0)
    alpha = simulating / T_SIM
    note = (
        f"on this machine T_v = {1e3 * looking:.1f} ms and alpha = {alpha:.3f}: t_sim could be "
        f"{1e3 * looking / max(1.0 - alpha, 1e-9):.1f} ms; it is {1e3 * T_SIM:.0f} ms, the time between two frames"
    )
    return Claim("C8", "T_v + alpha t_sim over t_sim", swing, float(looking + simulating) / T_SIM, 1.0, note, "<=")


def _sections() -> list[Section]:
    """Compare captures and errors of the trackers: the mean over the swings, and the worst in brackets."""
    text = (
        f"Means over {len(SWINGS)} swings, the worst in brackets. After {SINCE:g} s; errors are rms, those of velocity "
        "and rates over the rms of the true ones; between frames the tip is predicted. A tracker that finds fewer than "
        f"{100.0 * FEW:g} % of the markers in their windows searches the whole picture, which counts as a loss in that "
        "frame."
    )
    rows = []
    for name in TRACKERS:
        found = [followed(name, swing.seed).summary() for swing in SWINGS]
        cells = []
        for key, (_, factor) in _FIGURES.items():
            values = [factor * value for each in found if (value := each[key]) is not None]
            worst = min if key == "captured" else max
            cells.append(f"{np.mean(values):.3g} ({worst(values):.3g})" if values else "-")
        rows.append((TITLES[name], *cells))
    table = TextTable(("tracker", *(title for title, _ in _FIGURES.values())), tuple(rows))
    return [Section("Trackers compared", text=(text,), table=table)]


_CAPTION = (
    "Above: the tip as the paper's estimator (Fig. 7) has it, at all times; the rope is first seen in the middle of "
    "its swing, when rates are not known. Middle: the part of the visible markers found where they were looked for and "
    "rightly named. Below: how far markers were from where they were expected. The other curves are our own filter and "
    "two trackers without dynamics."
)
PART = Part(
    title="Online estimation by a camera",
    lead=(
        "Online estimation: simulate t_sim ahead, look for the markers there, take the prediction where they are not "
        "found, correct (section III D); a free swing of a rope of 100 links, rendered."
    ),
    message="rendering and following swings",
    items={"fig8": Item(_fig8, _draw_fig8, _CAPTION)},
    measures={captures_all: SWINGS, in_time: (DRAWN,)},
    sections=_sections,
)
