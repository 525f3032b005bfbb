"""Online estimation by a camera (paper section III D, Fig. 8): rendered swings, those who follow them, claim C8.

The cable of section IV swings freely from 1.2 m beside its rest, a rope of 100 links, and a camera sees ten markers of
it 7.5 times a second; whoever follows it has 50 links or none. It is first seen in the middle of the swing, so that
rates are not known. Pictures are rendered, 5 mm a pixel; each marker is 1.5 mm off by chance in each frame.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.estimate import MarkerMeasurement, RopeFilter, RopeTracker
from hyperflex.model import Rope
from hyperflex.paper.casting import cable
from hyperflex.paper.estimator import SAMPLES, ConstantVelocity, NearestBlob, OnlineEstimator, capture
from hyperflex.paper.results import Claim, Table
from hyperflex.simulation import simulate
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

RATE, T_SIM = 7.5, 1.0 / 7.5  # frames a second; s
LENGTH, MARKERS, AMPLITUDE = 2.0, 10, 1.2  # m
FINE = 100  # links of the rope that is seen
START, DURATION = 0.4, 8.0  # s, of the first frame and until the last
SINCE = 1.0  # s after the first frame, from which captures and errors count
NOISE = 0.0015  # m, of each coordinate of a marker in each frame
TRACKERS = ("paper", "filter", "constant velocity", "nearest blob")
TITLES = dict(zip(TRACKERS, ("the paper's estimator", "RopeTracker", "constant velocity", "nearest blob"), strict=True))


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
    """A motion whose markers are a little off, anew in each frame."""

    def __init__(self, motion: RopeMotion, arc_lengths: Array, seed: int) -> None:
        self.__dict__.update(vars(motion))
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
    colour: MarkerColour


@cache
def seen(swing: FreeSwing) -> Seen:
    """Simulate a swing and render it; each is made once in a process."""
    rng, s = np.random.default_rng(swing.seed), np.linspace(0.0, 1.0, FINE)
    bend = 0.15 * rng.normal() * np.sin(np.pi * s) + 0.1 * rng.normal() * np.sin(2.0 * np.pi * s)
    t = np.arange(0.0, DURATION, 1.0 / 600.0)
    run = simulate(finer_cable(), duration=DURATION, q0=np.arcsin(AMPLITUDE / LENGTH) + bend, t_eval=t, tol=1e-6)
    motion = RopeMotion.from_trajectory(run)
    camera = Camera.facing((640, 480), pixels_per_metre=200.0, origin=(320.0, 30.0), exposure=0.005)
    hidden = random_occlusion(MARKERS, 0.1, 0.15, until=DURATION, seed=swing.seed)
    scene = Scene(swing.arc_lengths, marker_diameter=0.04, hidden=hidden, seed=swing.seed)
    stamps = np.arange(START, DURATION - T_SIM, T_SIM)
    renderer = Renderer(camera, NoisyMotion(motion, swing.arc_lengths, swing.seed), scene)
    frames = tuple(Frame(stamp, renderer.image(stamp), k) for k, stamp in enumerate(stamps.tolist()))
    truth = Renderer(camera, motion, scene).truth(stamps)
    clicked = [MarkerColour.from_click(frames[0].image, place) for place in truth.pixels[0, truth.visible[0]]]
    colour = sorted(clicked, key=lambda each: each.area or 0.0)[len(clicked) // 2]
    rates = np.asarray(run.qd)[np.round(stamps * 600.0).astype(int)].reshape(stamps.size, -1, 2).mean(axis=2)
    return Seen(swing, motion, camera, frames, truth, rates, colour)


@dataclass(frozen=True, eq=False)
class Followed:
    """What one of the TRACKERS made of a swing of T frames with K markers."""

    seen: Seen
    places: Array  # (T, K, 2) m, of the markers found; NaN: not found
    expected: Array  # (T, K, 2) m, where they were expected; NaN in the first frame
    tip: Array  # (T, SAMPLES + 1, 2) m, at each frame and, foretold, until the next one; NaN: not known
    velocity: Array  # (T, 2) m/s, of the tip at frames
    rates: Array  # (T, 50) rad/s, of the links at frames
    seconds: tuple[float, float]  # medians of T_v and of the time for a simulation, s

    @property
    def t(self) -> Array:
        """Times of the frames, s."""
        return self.seen.truth.stamps

    @property
    def captured(self) -> npt.NDArray[np.bool_]:
        """Which markers were found, and are what they were taken for (T, K)."""
        true = self.seen.truth.places[:, :, :2]
        apart = np.linalg.norm(true[:, None] - self.places[:, :, None], axis=3)
        found = ~np.isnan(self.places[:, :, 0])
        return np.asarray(found & (np.nan_to_num(apart).argmin(axis=2) == np.arange(true.shape[1])))

    @property
    def captured_share(self) -> Array:
        """Part of the visible markers in each frame (T,) that was found and rightly named."""
        visible = self.seen.truth.visible
        return np.asarray((self.captured & visible).sum(axis=1) / np.maximum(visible.sum(axis=1), 1))

    @property
    def expected_error(self) -> Array:
        """Root mean square over the markers (T,) of how far they were from where they were expected, m."""
        off = self.expected - self.seen.truth.places[:, :, :2]
        return np.asarray(np.sqrt((off**2).sum(axis=2).mean(axis=1)))

    @property
    def tip_error(self) -> Array:
        """Distance of the tip from its true place (T, SAMPLES + 1), m."""
        return np.asarray(np.linalg.norm(self.tip - true_tip(self.seen), axis=2))

    def captured_since(self, since: float) -> float:
        """Return which part of the visible markers was captured from a time after the first frame, s, on."""
        late = self.t >= self.t[0] + since
        visible = self.seen.truth.visible[late]
        return float((self.captured[late] & visible).sum() / visible.sum())

    def summary(self) -> dict[str, float | None]:
        """Figures from `SINCE` after the first frame on."""
        late = self.t >= self.t[0] + SINCE
        visible, right = self.seen.truth.visible[late], self.captured[late]
        found = ~np.isnan(self.places[late, :, 0])
        times = np.array([-1e-3, 1e-3])
        moved = [np.diff(self.seen.motion.places(t + times, [LENGTH])[:, 0, :2], axis=0)[0] for t in self.t]
        velocity = np.array(moved) / 2e-3
        return {
            "captured": self.captured_since(SINCE),
            "wrong": float((found & ~right & visible).sum() / visible.sum()),
            "tip": _rms(self.tip_error[late, 0]),
            "between": _rms(self.tip_error[late, 1:]),
            "velocity": _ratio(self.velocity[late] - velocity[late], velocity[late]),
            "rates": _ratio(self.rates[late] - self.seen.rates[late], self.seen.rates[late]),
        }


def true_tip(subject: Seen) -> Array:
    """Return places of the tip (T, SAMPLES + 1, 2), m, at each frame and until the next one."""
    times = subject.truth.stamps[:, None] + np.linspace(0.0, T_SIM, SAMPLES + 1)
    return subject.motion.places(times.ravel(), [LENGTH])[:, 0, :2].reshape(*times.shape, 2)


@cache
def followed(name: str, seed: int = 0, on_tip: bool = True) -> Followed:
    """Return what one of the TRACKERS made of a swing; each is made once in a process."""
    subject = seen(FreeSwing(seed, on_tip))
    return _by_filter(subject) if name == "filter" else _by_windows(subject, name)


def _by_windows(subject: Seen, name: str) -> Followed:
    """Follow a swing as the paper did: simulate or guess ahead, look in windows, correct."""
    camera, times, arcs = subject.camera, subject.truth.stamps, subject.swing.arc_lengths
    detector = MarkerDetector(subject.colour)
    first = _ordered(subject, subject.frames[0], detector)
    known, along = ~np.isnan(first[:, 0]), np.concatenate([[0.0], arcs])
    ends = along[np.append(True, known)]
    start = np.stack([np.interp(arcs, ends, np.append(0.0, first[known, c])) for c in (0, 1)], axis=1)
    tracker: OnlineEstimator | NearestBlob
    if name == "paper":
        tracker = OnlineEstimator(cable(), arcs, times[0], start)
    else:
        tracker = (ConstantVelocity if name == "constant velocity" else NearestBlob)(times[0], start)
    result, took = _nothing(subject), []
    result.places[0] = first
    for k, frame in enumerate(subject.frames):
        if k:
            looked = capture(frame.image, detector, camera, result.expected[k])
            lost = looked.found.mean() < 0.7  # then the whole picture is searched, which counts as a loss
            tracker.correct(times[k], _ordered(subject, frame, detector) if lost else looked.places)
            result.places[k] = looked.places
        ahead = tracker.predict(times[k] + T_SIM)
        if k + 1 < times.size:
            result.expected[k + 1] = ahead
        if isinstance(tracker, OnlineEstimator) and tracker.ahead is not None:
            result.tip[k] = tracker.ahead.tip
            result.velocity[k], result.rates[k] = tracker.ahead.tip_velocity[0], tracker.qd
        elif isinstance(tracker, NearestBlob) and subject.swing.on_tip:
            result.tip[k] = tracker.places[-1] + np.outer(np.linspace(0.0, T_SIM, SAMPLES + 1), tracker.velocity[-1])
            result.velocity[k] = tracker.velocity[-1]
        if k:
            took.append((looked.seconds, tracker.seconds if isinstance(tracker, OnlineEstimator) else 0.0))
    return _timed(result, took)


def _by_filter(subject: Seen) -> Followed:
    """Follow a swing with the package's own tracker."""
    camera, arcs, result = subject.camera, subject.swing.arc_lengths, _nothing(subject)
    measurement = MarkerMeasurement(MarkerDetector(subject.colour))
    tracker = RopeTracker(RopeFilter(cable(), arcs, camera=camera), measurement)
    for k, frame in enumerate(subject.frames):
        looked = tracker.look(frame)
        if looked.state is None:
            continue
        result.places[k] = looked.places
        result.expected[k] = camera.locate(looked.predicted)
        q, qd = looked.state.q, looked.state.qd
        times = np.linspace(0.0, T_SIM, SAMPLES + 1)
        ahead = simulate(cable(), duration=T_SIM, q0=q, qd0=qd, t_eval=times, tol=1e-5)
        result.tip[k], result.velocity[k], result.rates[k] = ahead.tip, ahead.tip_velocity[0], qd
    return result


def _ordered(subject: Seen, frame: Frame, detector: MarkerDetector) -> Array:
    """Return the markers (K, 2) in a whole frame, m, in the order in which a rope runs through them."""
    places = subject.camera.locate(detector.find(frame.image).places)
    order = order_markers(places, subject.swing.arc_lengths, np.zeros(2))
    return np.where((order.indices[:, None] >= 0) & order.certain, places[order.indices], np.nan)


def _nothing(subject: Seen) -> Followed:
    """Return a result that is still empty."""
    frames, markers = subject.truth.visible.shape
    return Followed(
        subject,
        places=np.full((frames, markers, 2), np.nan),
        expected=np.full((frames, markers, 2), np.nan),
        tip=np.full((frames, SAMPLES + 1, 2), np.nan),
        velocity=np.full((frames, 2), np.nan),
        rates=np.full((frames, cable().n_links), np.nan),
        seconds=(np.nan, np.nan),
    )


def _timed(result: Followed, took: list[tuple[float, float]]) -> Followed:
    looking, simulating = np.median(np.array(took), axis=0)
    return replace(result, seconds=(float(looking), float(simulating)))


def _rms(values: Array) -> float | None:
    return None if np.isnan(values).any() else float(np.sqrt((values**2).mean()))


def _ratio(error: Array, true: Array) -> float | None:
    return None if np.isnan(error).any() else float(np.sqrt((error**2).sum() / (true**2).sum()))


def fig8() -> Table:
    """The tip as it is estimated, and which part of the markers each tracker captures (Fig. 8)."""
    runs = {name: followed(name, DRAWN.seed) for name in TRACKERS}
    subject = runs["paper"].seen
    columns = {"t": subject.truth.stamps, "visible": subject.truth.visible.sum(axis=1).astype(np.float64)}
    columns |= {"x_true": true_tip(subject)[:, 0, 0], "y_true": true_tip(subject)[:, 0, 1]}
    for name, run in runs.items():
        key = name.replace(" ", "_")
        columns |= {f"x_{key}": run.tip[:, 0, 0], f"y_{key}": run.tip[:, 0, 1]}
        columns |= {f"captured_{key}": run.captured_share, f"expected_error_{key}": run.expected_error}
    notes = {
        "title": "tip, captured markers and errors of prediction, online",
        "source": "rendered",
        "units": "t in s; x, y of the tip and rms of how far markers were from their predicted places in m; captured: "
        "part of the visible ones; nan: not known",
        "parameters": f"t_sim = {T_SIM:.3f} s, {subject.swing.title}",
    }
    return Table("fig8", "online estimation", columns, notes)


def captures_all(swing: FreeSwing) -> Claim:
    """C8: the capture rate goes to 100 %. Measured: the part of the visible markers captured after 4 s."""
    run = followed("paper", swing.seed, swing.on_tip)
    share, errors = run.captured_share, run.summary()
    lost = np.flatnonzero(share < 1.0)
    until = "no frame loses one" if not lost.size else f"the last is lost {run.t[lost[-1]] - run.t[0]:.1f} s after it"
    note = (
        f"first frames: {', '.join(f'{100.0 * each:.0f}' for each in share[:5])} %, {until}; tip rms after {SINCE:g} s "
        f"{1e3 * (errors['tip'] or 0.0):.1f} mm at frames, {1e3 * (errors['between'] or 0.0):.1f} mm foretold between"
    )
    statement = "the capture rate goes to 100 %: visible markers captured after 4 s"
    return Claim("C8", statement, swing, run.captured_since(4.0), 0.995, note)


def in_time(swing: FreeSwing) -> Claim:
    """C8: looking and simulating are done before the prediction is due. Measured: (T_v + alpha t_sim) / t_sim."""
    looking, simulating = followed("paper", swing.seed, swing.on_tip).seconds
    alpha = simulating / T_SIM
    note = (
        f"on this machine T_v = {1e3 * looking:.1f} ms and alpha = {alpha:.3f}: t_sim could be "
        f"{1e3 * looking / max(1.0 - alpha, 1e-9):.1f} ms; it is {1e3 * T_SIM:.0f} ms, the time between two frames"
    )
    share = (looking + simulating) / T_SIM
    return Claim("C8", "T_v + alpha t_sim over t_sim", swing, share, 1.0, note, "<=")


def estimation_claims() -> list[Claim]:
    """Measure C8 on three swings."""
    return [*map(captures_all, SWINGS), in_time(DRAWN)]
