"""Online estimation by a camera (paper section III D): rendered swings, those who follow them, Fig. 8, claim C8.

The cable of section IV swings freely from 1.2 m beside its rest, a rope of 100 links, and a camera sees ten markers of
it 7.5 times a second; whoever follows it has 50 links or none. It is first seen in the middle of the swing, so that
rates are not known. Pictures are rendered, 5 mm a pixel; each marker is 1.5 mm off by chance in each frame.
"""

import time
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.estimate import MarkerMeasurement, RopeFilter, RopeTracker
from hyperflex.model import Rope
from hyperflex.paper.casting import cable
from hyperflex.paper.estimator import SAMPLES, TOL, BlobTracker, OnlineEstimator, capture
from hyperflex.paper.part import Claim, Item, Part, Table
from hyperflex.report import BLUE, GREEN, GREY, INK, RED, Section, TextTable, legend, new_figure
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

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATE, T_SIM = 7.5, 1.0 / 7.5  # frames a second; s
LENGTH, MARKERS, AMPLITUDE = 2.0, 10, 1.2  # m
FINE = 100  # links of the rope that is seen
START, DURATION = 0.4, 8.0  # s, of the first frame and until the last
SINCE = 1.0  # s after the first frame, from which captures and errors count
NOISE = 0.0015  # m, of each coordinate of a marker in each frame
FEW = 0.7  # part of the markers; if fewer are found in their windows, the whole picture is searched
_RUN_RATE = 600.0  # samples a second of the simulated swing
_STEP = 1e-3  # s, of the difference quotient of the tip's true velocity
TRACKERS = ("paper", "filter", "constant velocity", "nearest blob")
TITLES = dict(zip(TRACKERS, ("the paper's estimator", "RopeTracker", "constant velocity", "nearest blob"), strict=True))
_STYLE: dict[str, Any] = {
    name: {"color": colour, "marker": marker, "ms": 3.5, "lw": 1.0, "label": TITLES[name]}
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


def finer_cable() -> Rope:
    """Return the paper's cable of 100 links: friction in each joint that bends alike, and the same first joint."""
    rope = cable()
    bending = rope.friction[1] * FINE / rope.n_links
    finer = Rope.uniform(LENGTH, rope.total_mass, FINE, radius=0.0025, friction=bending, name="paper cable, 100 links")
    return finer.replace(friction=np.append(rope.friction[0], np.full(FINE - 1, bending)))


class NoisyMotion(RopeMotion):
    """The motion of a run whose markers are a little off, anew in each frame."""

    def __init__(self, run: Trajectory, arc_lengths: Array, seed: int) -> None:
        super().__init__(run.t, run.q, run.qd, run.setup.rope.length)
        self._arcs, frames = arc_lengths, round(RATE * DURATION) + 1
        self._off = NOISE * np.random.default_rng((seed, 1)).normal(size=(frames, arc_lengths.size, 2))

    def places(self, t: npt.ArrayLike, arc_lengths: npt.ArrayLike) -> Array:
        """Return places (m, P, 3), m: x, y and off the plane, at times (m,), s, of points (P,), m along the rope."""
        result = super().places(t, arc_lengths)
        frame = np.clip(np.round((np.atleast_1d(t) - START) * RATE).astype(int), 0, len(self._off) - 1)
        for off, arc in zip(self._off[frame].transpose(1, 0, 2), self._arcs, strict=True):
            result[:, np.isclose(np.asarray(arc_lengths), arc), :2] += off[:, None]
        return result


@dataclass(frozen=True, eq=False)
class Seen:
    """A swing as it was, and as the camera saw it."""

    swing: FreeSwing
    motion: RopeMotion
    camera: Camera
    frames: tuple[Frame, ...]
    truth: Truth
    rates: Array  # (T, 50) rad/s, of the 100 links two by two
    detector: MarkerDetector

    @property
    def tip(self) -> Array:
        """True places of the tip (T, SAMPLES + 1, 2), m, at each frame and until the next one."""
        times = self.truth.stamps[:, None] + np.linspace(0.0, T_SIM, SAMPLES + 1)
        return self.motion.places(times.ravel(), [LENGTH])[:, 0, :2].reshape(*times.shape, 2)

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
    run = simulate(finer_cable(), duration=DURATION, q0=np.arcsin(AMPLITUDE / LENGTH) + bend, t_eval=t, tol=1e-6)
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
    rates = np.asarray(run.qd)[np.round(stamps * _RUN_RATE).astype(int)].reshape(stamps.size, -1, 2).mean(axis=2)
    return Seen(swing, motion, camera, frames, truth, rates, detector)


class Followed:
    """What one of the TRACKERS made of a swing of T frames with K markers; NaN: not known.

    Attributes
    ----------
    places : (T, K, 2) float64
        Markers found, m.
    expected : (T, K, 2) float64
        Where they were expected, m; NaN in the first frame.
    tip : (T, SAMPLES + 1, 2) float64
        At each frame and, predicted, until the next one, m.
    velocity, rates : (T, 2), (T, 50) float64
        Of the tip, m/s, and of the links, rad/s, at frames.
    took : list of (float, float)
        Time to find the markers, the paper's T_v, and to simulate ahead, s, in each frame but the first.
    """

    def __init__(self, subject: Seen) -> None:
        self.seen, (frames, markers) = subject, subject.truth.visible.shape
        self.t = subject.truth.stamps
        self.places, self.expected = np.full((2, frames, markers, 2), np.nan)
        self.tip, self.velocity = np.full((frames, SAMPLES + 1, 2), np.nan), np.full((frames, 2), np.nan)
        self.rates = np.full_like(subject.rates, np.nan)
        self.took: list[tuple[float, float]] = []

    @property
    def captured(self) -> npt.NDArray[np.bool_]:
        """Which visible markers were found, and are what they were taken for (T, K)."""
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

    def captured_since(self, since: float) -> float:
        """Return which part of the visible markers was captured from a time after the first frame, s, on."""
        late = self.t >= self.t[0] + since
        return float(self.captured[late].sum() / self.seen.truth.visible[late].sum())

    def summary(self) -> dict[str, float | None]:
        """Figures from `SINCE` after the first frame on."""
        late, visible = self.t >= self.t[0] + SINCE, self.seen.truth.visible
        found = ~np.isnan(self.places[:, :, 0]) & visible
        off = np.linalg.norm(self.tip - self.seen.tip, axis=2)[late]
        before, after = (self.seen.motion.places(self.t + sign * _STEP, [LENGTH])[:, 0, :2] for sign in (-1.0, 1.0))
        velocity = (after - before) / (2.0 * _STEP)
        return {
            "captured": self.captured_since(SINCE),
            "wrong": float((found & ~self.captured)[late].sum() / visible[late].sum()),
            "tip": _rms(off[:, 0]),
            "between": _rms(off[:, 1:]),
            "velocity": _rms((self.velocity - velocity)[late], velocity[late]),
            "rates": _rms((self.rates - self.seen.rates)[late], self.seen.rates[late]),
        }


def _rms(error: Array, true: Array | None = None) -> float | None:
    """Return the root mean square of an error, over that of the true values if given; None if it is not known."""
    if np.isnan(error).any():
        return None
    return float(np.sqrt((error**2).mean() / (1.0 if true is None else (true**2).mean())))


@cache
def followed(name: str, seed: int = 0, on_tip: bool = True) -> Followed:
    """Return what one of the TRACKERS made of a swing; each is made once in a process."""
    result = Followed(seen(FreeSwing(seed, on_tip)))
    if name == "filter":
        _by_filter(result)
    else:
        _by_windows(result, name)
    return result


def _by_windows(result: Followed, name: str) -> None:
    """Follow a swing as the paper did: simulate or guess ahead, look in windows, correct."""
    subject, times, arcs = result.seen, result.t, result.seen.swing.arc_lengths
    first = subject.ordered(subject.frames[0])
    known, along = ~np.isnan(first[:, 0]), np.append(0.0, arcs)
    ends = along[np.append(True, known)]
    start = np.stack([np.interp(arcs, ends, np.append(0.0, first[known, c])) for c in (0, 1)], axis=1)
    paper = OnlineEstimator(cable(), arcs, times[0], start)
    tracker = paper if name == "paper" else BlobTracker(times[0], start, moving=name == "constant velocity")
    result.places[0] = first
    for k, frame in enumerate(subject.frames):
        began = time.perf_counter()
        if k:
            found = result.places[k] = capture(frame.image, subject.detector, subject.camera, result.expected[k])
            result.took.append((time.perf_counter() - began, paper.seconds))
            lost = np.isfinite(found[:, 0]).mean() < FEW  # the whole picture is searched, which counts as a loss
            tracker.correct(times[k], subject.ordered(frame) if lost else found)
        ahead = tracker.predict(times[k] + T_SIM)
        result.expected[k + 1 : k + 2] = ahead.places
        result.rates[k] = ahead.rates
        if subject.swing.on_tip or name == "paper":
            result.tip[k], result.velocity[k] = ahead.tip, ahead.velocity


def _by_filter(result: Followed) -> None:
    """Follow a swing with the package's own tracker."""
    subject, times = result.seen, np.linspace(0.0, T_SIM, SAMPLES + 1)
    measurement = MarkerMeasurement(subject.detector)
    tracker = RopeTracker(RopeFilter(cable(), subject.swing.arc_lengths, camera=subject.camera), measurement)
    for k, frame in enumerate(subject.frames):
        looked = tracker.look(frame)
        if looked.state is None:
            continue
        q, qd = looked.state.q, looked.state.qd
        ahead = simulate(cable(), duration=T_SIM, q0=q, qd0=qd, t_eval=times, tol=TOL)
        result.places[k], result.expected[k] = looked.places, subject.camera.locate(looked.predicted)
        result.tip[k], result.velocity[k], result.rates[k] = ahead.tip, ahead.tip_velocity[0], qd


def _fig8() -> Table:
    runs = {name: followed(name, DRAWN.seed) for name in TRACKERS}
    subject = seen(DRAWN)
    columns = {"t": subject.truth.stamps, "visible": subject.truth.visible.sum(axis=1).astype(np.float64)}
    columns |= {"x_true": subject.tip[:, 0, 0], "y_true": subject.tip[:, 0, 1]}
    for name, run in runs.items():
        key = name.replace(" ", "_")
        columns |= {f"x_{key}": run.tip[:, 0, 0], f"y_{key}": run.tip[:, 0, 1]}
        columns |= {f"captured_{key}": run.captured_share, f"expected_error_{key}": run.expected_error}
    notes = {
        "title": "tip, captured markers and errors of prediction, online",
        "source": "rendered",
        "units": "t in s; x, y of the tip and rms of how far markers were from their predicted places in m; captured: "
        "part of the visible ones; nan: not known",
        "parameters": f"t_sim = {T_SIM:.3f} s, {DRAWN.title}",
    }
    return Table(columns, notes)


def _draw_fig8() -> "Figure":
    """Draw the tip as it is estimated, the capture rate, and the error of prediction, over time."""
    paper = followed("paper", DRAWN.seed)
    with new_figure(9.0, 8.0, f"Online estimation at {RATE:g} frames/s, rendered (Fig. 8)") as figure:
        tip, rate, error = figure.subplots(3, 1, sharex=True, height_ratios=(1.2, 1.0, 1.0))
        times = (paper.t[:, None] + np.linspace(0.0, T_SIM, SAMPLES + 1)).ravel()
        tip.plot(times, paper.seen.tip[..., 0].ravel(), color=GREY, lw=3.0, alpha=0.5, label="true")
        tip.plot(times, paper.tip[..., 0].ravel(), color=INK, lw=0.9, label="estimated, continuous")
        hit = paper.captured[:, -1]
        tip.plot(paper.t[hit], paper.places[hit, -1, 0], "o", color=BLUE, ms=4.0, label="captured")
        expected = paper.expected[~hit, -1, 0]
        tip.plot(paper.t[~hit], expected, "x", color=RED, ms=6.0, mew=1.5, label="not captured: predicted")
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
    return Claim("C8", statement, swing, run.captured_since(4.0), 0.995, note)


def in_time(swing: FreeSwing) -> Claim:
    """C8: looking and simulating are done before the prediction is due. Measured: (T_v + alpha t_sim) / t_sim."""
    looking, simulating = np.median(followed("paper", swing.seed, swing.on_tip).took, axis=0)
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
