"""Latency of tracking a rope in video, frame by frame, and memory over a long run (simulated video).

python benchmarks/tracking_latency.py          about five minutes; results in benchmarks/results/
python benchmarks/tracking_latency.py --quick  a minute; writes nothing

One thread: the script restarts itself with one BLAS thread, which must be set before numpy is loaded.
"""

import argparse
import ctypes
import gc
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import machine
import numpy as np
from cast import cable

import hyperflex as hf
from hyperflex.estimate import ChangeTests, FrameThread, MarkerMeasurement, RopeFilter, RopeTracker, Watch, WatchLog
from hyperflex.estimate.live.state_source import Packet
from hyperflex.vision import Camera, Frame, MarkerColour, MarkerDetector, Renderer, RopeMotion, Scene, VideoReader

RESULTS = Path(__file__).parent / "results"
LINKS, FINE, LENGTH, RATE = 50, 100, 2.0, 30.0
ARCS = np.linspace(0.2, LENGTH, 10)
SIZE = (1280, 720)
ARM, SWINGS = hf.Arm(length=0.105), hf.arm_swings(t_move=0.73, t_rest=0.53)
SECONDS, ROUNDS = 8.0, 5  # of the cast; number of repetitions
SOAK, SETTLED = 18_000, 900  # frames; those before the first memory measurement
GENTLE = hf.arm_swings(t_move=1.5, t_rest=1.0)
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
AIM = {"median": 4.0, "p99": 10.0, "packet p99": 20.0, "growth": 5.0}  # ms, ms, ms, MB


def camera(**timing: float) -> Camera:
    """A view that contains the whole rope at all times."""
    return Camera.facing(SIZE, pixels_per_metre=150.0, origin=(640.0, 330.0), **timing)


def moving(motion: hf.Motion, seconds: float, rate: float) -> tuple[hf.Trajectory, RopeMotion]:
    """A finer rope on the arm, and its camera."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    run = hf.simulate(cable(FINE, scaled=True), motion, arm=ARM, duration=seconds, t_eval=t)
    angle, turning = motion.angle(t), motion.rate(t)
    base = ARM.length * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    speed = ARM.length * turning[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return run, RopeMotion(t, run.q, run.qd, cable(FINE, scaled=True).length, base, speed)


def tracker(motion: hf.Motion, colour: MarkerColour, lens: Camera, tests: ChangeTests | None = None) -> RopeTracker:
    """The tracker in its initial state."""
    estimator = RopeFilter(cable(LINKS, scaled=True), ARCS, motion=motion, arm=ARM, camera=lens, tests=tests)
    return RopeTracker(estimator, MarkerMeasurement(MarkerDetector(colour)))


def latency(rounds: int) -> dict[str, Any]:
    """Times of each frame of a cast, ms: tracking of a decoded frame, and from the packet to the shared state."""
    lens = camera(exposure=0.004)
    _, shown = moving(SWINGS, SECONDS + 0.5, 600.0)
    with tempfile.TemporaryDirectory(prefix="hyperflex-bench-") as folder:
        path = Path(folder) / "cast.mp4"
        scene = Scene(ARCS, marker_diameter=0.045, clutter=6, light_drift=0.1)
        truth = Renderer(lens, shown, scene).write(path, np.arange(0.05, SECONDS, 1.0 / RATE))
        with VideoReader(path) as video:
            colour = MarkerColour.from_click(next(iter(video)).image, truth.pixels[0, 3])
        _pass(path, tracker(SWINGS, colour, lens))  # loads the kernels
        _pass(path, tracker(SWINGS, colour, lens, ChangeTests()))
        passes = []
        for _ in range(rounds):
            own = _pass(path, tracker(SWINGS, colour, lens))
            own["tested"] = _pass(path, tracker(SWINGS, colour, lens, ChangeTests()))["processor"]
            passes.append(own)
    return {
        "frames": len(passes[0]["clock"]),
        "rounds": rounds,
        "seen": float(np.mean(passes[0]["seen"])),
        **{
            what: [_quantiles(each[what]) for each in passes]
            for what in ("clock", "processor", "tested", "packet to state")
        },
    }


def _pass(path: Path, each: RopeTracker) -> dict[str, list[float]]:
    """Track a video once; times in ms."""
    found: dict[str, list[float]] = {"clock": [], "processor": [], "packet to state": [], "seen": []}
    estimator = each.estimator
    near, far = multiprocessing.Pipe()
    with near, far, VideoReader(path) as video:
        frames = iter(video)
        while True:
            begin = time.perf_counter()
            frame = next(frames, None)
            if frame is None:
                return found
            decoded, processor = time.perf_counter(), time.process_time()
            result = each.look(frame)
            found["processor"].append(1e3 * (time.process_time() - processor))
            looked = time.perf_counter()
            found["clock"].append(1e3 * (looked - decoded))
            state = estimator.process_noise.value, estimator.x, estimator.factor
            near.send(Packet(looked, result.t, result.t, True, 1, *state, (), 0))
            far.recv()
            found["packet to state"].append(1e3 * (time.perf_counter() - begin))
            found["seen"].append(float(result.seen.mean()))


def _quantiles(times: list[float]) -> dict[str, float]:
    return {name: float(np.quantile(times, part)) for name, part in (("median", 0.5), ("p99", 0.99), ("most", 1.0))}


class Drawn:
    """A source of drawn frames: discs at the markers on a grey wall, with noise."""

    def __init__(self, pixels: np.ndarray) -> None:
        self.pixels, self.image_size, self.notes = pixels, SIZE, []
        rng = np.random.default_rng(0)
        self.walls = [np.clip(rng.normal(180.0, 2.0, (SIZE[1], SIZE[0], 3)), 0, 255).astype(np.uint8) for _ in range(3)]

    def frame(self, k: int) -> Frame:
        """Return the k-th frame."""
        image = self.walls[k % 3].copy()
        for u, v in np.round(16.0 * self.pixels[k]).astype(int).tolist():
            cv2.circle(image, (u, v), 16 * 4, (40, 30, 210), -1, cv2.LINE_AA, 4)
        return Frame(k / RATE, image, k)

    def __iter__(self) -> Iterator[Frame]:
        for k in range(len(self.pixels)):
            yield self.frame(k)

    def close(self) -> None:
        """Do nothing: there is no device to close."""


def soak(frames: int) -> dict[str, Any]:
    """A long run through all parts of ``hyperflex watch`` except the camera: memory, errors, times."""
    lens = camera()
    run, _ = moving(GENTLE, frames / RATE, RATE)
    ends = np.linspace(0.0, LENGTH, FINE + 1)
    joints = np.asarray(run.joints)
    places = np.stack([[np.interp(ARCS, ends, row[:, c]) for c in (0, 1)] for row in joints], axis=0).transpose(0, 2, 1)
    source = Drawn(lens.project(places.reshape(-1, 2)).reshape(frames, -1, 2))
    colour = MarkerColour.from_click(source.frame(0).image, source.pixels[0, 3])
    follower = tracker(GENTLE, colour, lens)
    memory, off, seen, late, begin = [], [], 0, [], time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="hyperflex-bench-") as folder:
        with FrameThread(lambda: source, live=False) as thread, WatchLog(Path(folder) / "a.nc", LINKS, 10, "") as log:
            for k, each in enumerate(Watch(thread, follower, interval=60.0)):
                log.note(each)
                off.append(float(np.linalg.norm(each.tip - joints[min(k, frames - 1), -1])))
                seen += each.seen
                late.append(1e3 * each.latency)
                if k >= SETTLED and k % 300 == 0:
                    memory.append(resident())
            log.ending = str(thread.ended)
        written = (Path(folder) / "a.nc").stat().st_size / 1e6
    return {
        "frames": frames,
        "seconds": time.perf_counter() - begin,
        "growth_mb": memory[-1] - memory[0] if memory else float("nan"),
        "most_growth_mb": max(memory) - memory[0] if memory else float("nan"),
        "memory_mb": memory,
        "log_mb": written,
        "tip_rms_mm": 1e3 * float(np.sqrt(np.mean(np.square(off[30:])))),
        "seen": seen / (10 * len(off)),
        "latency": _quantiles(late[30:]),
    }


def resident() -> float:
    """Memory of this process, MB, after free memory is returned to the system, so that leaks are visible."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def text(times: dict[str, Any], long: dict[str, Any] | None) -> str:
    """Return the page's body."""
    lines = [
        "| of a frame, ms | median of the rounds (least-most) | p99 of a round (least-most) | aim |",
        "|---|---|---|---|",
    ]
    labels = {
        "processor": ("look, processor time", f"median {AIM['median']:g}, p99 {AIM['p99']:g}"),
        "clock": ("look, elapsed", f"median {AIM['median']:g}, p99 {AIM['p99']:g}"),
        "tested": ("look with tests for changes, processor time", ""),
        "packet to state": ("packet to shared state, elapsed", f"p99 {AIM['packet p99']:g}"),
    }
    for what, (label, aim) in labels.items():
        cells = [_spread([each[name] for each in times[what]]) for name in ("median", "p99")]
        lines.append(f"| {label} | {cells[0]} | {cells[1]} | {aim} |")
    about = (
        f"Simulated video: the paper's cable of {LINKS} links ({FINE} in truth) on its arm, {ARCS.size} markers, "
        f"{SIZE[0]}x{SIZE[1]} at {RATE:g} frames/s, {times['frames']} frames of a cast tracked {times['rounds']} "
        f"times; {100.0 * times['seen']:.1f} % of the markers were found. Look: RopeTracker.look on a decoded frame: "
        "prediction, search in gates, assignment, update. Packet to shared state: demuxing, decoding in one thread, "
        "conversion of the whole picture to blue, green, red, look, and a write and a read of the shared memory."
    )
    lines += ["", about]
    if long is not None:
        lines += ["", _soaked(long)]
    return "\n".join(lines)


def _soaked(long: dict[str, Any]) -> str:
    """Return the sentences about the long run."""
    late = long["latency"]
    return (
        f"Soak: {long['frames']} drawn frames ({long['frames'] / RATE / 60.0:.0f} minutes at {RATE:g} frames/s) in "
        f"{long['seconds']:.0f} s, as fast as they are tracked, through FrameThread, Watch and WatchLog. Memory grew "
        f"by {long['growth_mb']:.2f} MB from frame {SETTLED} to the end, at most by {long['most_growth_mb']:.2f} MB in "
        f"between (aim: less than {AIM['growth']:g}); the log has {long['log_mb']:.0f} MB. Tip "
        f"{long['tip_rms_mm']:.2f} mm rms, {100.0 * long['seen']:.2f} % of the markers found; latency, with the "
        f"drawing in another thread: median {late['median']:.2f} ms, p99 {late['p99']:.2f} ms."
    )


def _spread(values: list[float]) -> str:
    return f"{np.median(values):.2f} ({min(values):.2f}-{max(values):.2f})"


def main() -> None:
    """Measure, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two rounds, a short soak; writes nothing")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--no-soak", action="store_true")
    given = parser.parse_args()
    if any(os.environ.get(name) != "1" for name in THREADS):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **dict.fromkeys(THREADS, "1")})
    about = machine.describe()
    times = latency(2 if given.quick else given.rounds)
    long = None if given.no_soak else soak(2400 if given.quick else SOAK)
    about["load after"] = machine.load()
    page = f"# Tracking: latency of a frame, and memory\n\n{text(times, long)}\n\n{machine.sentence(about)}\n"
    sys.stdout.write(page)
    if not given.quick and long is not None:
        (RESULTS / "tracking-latency.md").write_text(page, encoding="utf-8")
        content = {"machine": about, "latency": times, "soak": long}
        (RESULTS / "tracking-latency.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
