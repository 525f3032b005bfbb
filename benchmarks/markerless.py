"""A plain rope, tracked without markers from rendered videos: errors of its curve and free end, and their stated
errors.

python -m benchmarks.markerless 10                    all cases, ten seeds each (about three hours on one core)
python -m benchmarks.markerless 10 --case clutter     one case; --first 3 begins with seed 3
python -m benchmarks.markerless 1 --case dim          thin, faint, noisy, blurred and compressed ropes
python -m benchmarks.markerless 10 --videos FOLDER    folder in which videos are kept and found again
python -m benchmarks.markerless wrong                 wrong set-ups: what is reported
python -m benchmarks.markerless page                  the page from the existing rows

Ropes of 100 links, 5 mm thick, 1280 x 720 pixels over 4.5 m, rendered, written as MP4 (x264, crf 23) and read again.
Trackers have 50 links and find the rope themselves, in the first frame that shows it clearly. Errors are distances of
50 points of the curve, and of the free end, from the true points at the same arc lengths, from 0.5 s after the rope was
found, except for 0.1 s after blackouts. The stated 90 % region is that of the curve in its normal direction (the error
along the curve is that of straight links), and that of the free end in both directions. A run counts as lost if the
curve is off by more than 100 mm rms in one of the last ten frames, and as doubted if the tracker reports at the end
what may be wrong. Times are processor times of one core, without decoding. Camera, motion of the arm, length, mass and
friction are known exactly, and the wall is plain unless the row names a texture: in a real video their uncertainties
add errors. With texture, shadow and steps, the wall has a grain of 8 levels, the rope's shadow on it lacks 30 % of the
light (in MuJoCo all light of the lamp, on a wall 0.9 m behind the rope), and the exposure changes by -20 % and then by
+37 %. MuJoCo's pictures are means of instants at most 1.5 px apart. Levels are proportional to light, except in rows
that name a tone curve (sRGB). Seeds below 100 were used while the method was developed.
"""

import argparse
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benchmarks import log, machine
from scipy import stats
from threadpoolctl import threadpool_limits

import hyperflex as hf
from hyperflex import files
from hyperflex.checks import Array
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.errors import InvalidInput
from hyperflex.estimate import CurveMeasurement, RopeFilter, RopeTracker, curve_arc_lengths, track_video
from hyperflex.vision import (
    Camera,
    Frame,
    Occluder,
    Renderer,
    RopeMotion,
    Scene,
    VideoReader,
    VideoWriter,
    find_rope,
    srgb_tone,
)
from tests.estimate.runs import ARM, FINE, LENGTH, RATE, SWINGS, free_swing, rope
from tests.oracles.mujoco_eye import film

RESULTS = Path(__file__).parent / "results" / "markerless.jsonl"
LINKS, WIDTH, SCALE = 50, 0.005, 1280 / 4.5  # m, px/m
DARK, WALL = (45.0, 45.0, 45.0), np.array([175.0, 185.0, 190.0])
START, SETTLED, LONGEST = 0.05, 0.5, 1.0  # s; the longest search for the first frame
NINETY = float(stats.chi2.ppf(0.9, 1)), float(stats.chi2.ppf(0.9, 2))  # of a number, and of a position


@dataclass(frozen=True)
class Case:
    """A kind of video.

    Attributes
    ----------
    cast : whether the rope is pumped up to some 12 m/s; else it swings freely from 1.2 m
    rate, exposure : frames/s, s
    hidden : whether a board as high as a fifth of the rope moves in front of it, from its end upwards
    clutter : whether three lines as thick and dark as the rope cross it
    blackouts : times at which nothing is visible, s
    looks : whether the wall is textured, the rope throws a shadow on it, and an automatic exposure changes twice
    eye : whether MuJoCo renders the pictures
    tone : whether the pictures have the usual tone curve of cameras, which the tracker knows; else none
    width : of the rope, m
    contrast : of rope and wall, levels; by default 138
    noise : levels
    declared : exposure that the tracker is given, s; by default the true one
    quality : of the compression (crf of x264)
    """

    cast: bool = False
    rate: float = 30.0
    exposure: float = 0.01
    hidden: bool = False
    clutter: bool = False
    blackouts: tuple[tuple[float, float], ...] = ()
    looks: bool = False
    eye: bool = False
    tone: bool = False
    width: float = WIDTH
    contrast: float | None = None
    noise: float = 2.0
    declared: float | None = None
    quality: int = 23

    @property
    def duration(self) -> float:
        """Of the video, s: the pumped rope reaches 12 m/s near its end."""
        return 10.0 if self.cast else 4.0


DIM: dict[str, dict[str, Any]] = {
    "dim: 5 mm, contrast 138, noise 2, 1/500 s, crf 20": {},
    "dim: 2 mm": {"width": 0.002},
    "dim: 1 mm": {"width": 0.001},
    "dim: contrast 20": {"contrast": 20.0},
    "dim: contrast 8": {"contrast": 8.0},
    "dim: 1 mm, contrast 20": {"width": 0.001, "contrast": 20.0},
    "dim: noise 8": {"noise": 8.0},
    "dim: 1/30 s": {"exposure": 1.0 / 30.0},
    "dim: 1/50 s, declared 1/250 s": {"exposure": 0.02, "declared": 0.004},
    "dim: crf 35": {"quality": 35},
}
CASES = {
    f"{name}{rate:.0f}/s, 1/{1 / exposure:.0f} s": Case(cast, rate, exposure)
    for name, cast in (("swing ", False), ("cast ", True))
    for rate in (30.0, 60.0)
    for exposure in (0.01, 0.002)
} | {
    "swing, hidden": Case(hidden=True),
    "swing, clutter": Case(clutter=True),
    "cast, hidden": Case(True, hidden=True),
    "cast, clutter": Case(True, clutter=True),
    "cast, blackouts": Case(True, blackouts=((4.0, 4.3), (6.0, 6.3))),
    "swing, texture, shadow, steps": Case(looks=True),
    "cast, texture, shadow, steps": Case(True, looks=True),
    "swing, tone curve": Case(tone=True),
    "cast, tone curve": Case(True, tone=True),
    "swing, MuJoCo": Case(eye=True),
    "cast, MuJoCo": Case(True, eye=True),
    "swing, MuJoCo, texture, shadow, steps": Case(looks=True, eye=True),
    "cast, MuJoCo, texture, shadow, steps": Case(True, looks=True, eye=True),
    **{name: Case(**{"tone": True, "exposure": 0.002, "quality": 20, **changed}) for name, changed in DIM.items()},
}
ASKED = {False: (3.0, 10.0), True: (6.0, 25.0)}  # mm, of curve and tip, by whether it is a cast


def motion_of(case: Case, seed: int) -> RopeMotion:
    """The rope of 100 links: a free swing, or the paper's swings from a rope that hangs nearly at rest."""
    if not case.cast:
        return RopeMotion.from_trajectory(free_swing(seed, case.duration + 0.5))
    rng, s = np.random.default_rng((seed, 1)), np.linspace(0.0, 1.0, FINE)
    bend = (
        rng.normal(size=3) * (0.05, 0.05, 0.025) @ np.stack([np.ones(FINE), np.sin(np.pi * s), np.sin(2 * np.pi * s)])
    )
    t = np.arange(0.0, case.duration + 0.5, 1.0 / RATE)
    run = hf.simulate(rope(FINE), SWINGS, arm=ARM, duration=case.duration + 0.5, q0=bend, t_eval=t)
    return RopeMotion.from_trajectory(run)


def scene_of(case: Case, seed: int) -> Scene:
    """The contents of the picture."""
    rng, fronts = np.random.default_rng((seed, 6)), []
    if case.hidden:  # it moves in from below, and covers the free end after a second
        fronts.append(Occluder((-2.3, -2.6), (2.3, -2.6), 0.4, velocity=(0.0, rng.uniform(0.8, 1.6) / case.duration)))
    for start in np.linspace(0.5, case.duration - 1.5, 3) if case.clutter else ():
        way, speed = rng.uniform(-0.5, 0.5), rng.uniform(0.5, 1.5)
        u = -1.5 - speed * start
        fronts.append(Occluder((u - way, -2.3), (u + way, 0.2), WIDTH, DARK, (speed, 0.0)))
    looks: dict[str, Any] = {"wall_texture": 8.0, "shadow": (0.06, -0.04, 0.3)}  # levels; m, and the share of the light
    looks["exposure_steps"] = ((0.3 * case.duration, 0.8), (0.6 * case.duration, 1.1))
    return Scene(
        np.zeros(0),
        rope_width=case.width,
        rope_colour=DARK if case.contrast is None else WALL - case.contrast,
        background=WALL,
        clutter=0,
        noise=case.noise,
        light_drift=0.1,
        **(looks if case.looks else {}),
        occluders=tuple(fronts),
        blackouts=case.blackouts,
        tone=srgb_tone() if case.tone else None,
        seed=seed,
    )


def run(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Render a video into a folder unless it exists, read it, track it, and compare."""
    case = CASES[name]
    motion = motion_of(case, seed)
    camera = Camera.facing((1280, 720), pixels_per_metre=SCALE, origin=(640.0, 60.0), exposure=case.exposure)
    stamps = START + np.arange(0.0, case.duration, 1.0 / case.rate)
    path, scene = folder / f"{re.sub('[^a-z0-9]+', '-', name.lower())}-{seed}.mp4", scene_of(case, seed)
    if not path.exists():
        seen = film(camera, motion, scene, stamps) if case.eye else map(Renderer(camera, motion, scene).image, stamps)
        with VideoWriter(path, camera.image_size, case.quality) as video:
            for image, stamp in zip(seen, stamps, strict=True):
                video.write(image, stamp)
    told = replace(camera, exposure=case.declared or case.exposure)
    with VideoReader(path) as frames, threadpool_limits(1):  # as the commands do
        return tracked(case, motion, told, iter(frames))


def tracked(case: Case, motion: RopeMotion, camera: Camera, frames: Iterator[Frame]) -> dict[str, Any]:
    """Track the frames, and compare with the motion."""
    cable = rope(LINKS)
    given = {"motion": SWINGS, "arm": ARM} if case.cast else {}
    estimator = RopeFilter(cable, curve_arc_lengths(cable), camera=camera, **given)
    tracker: RopeTracker | None = None
    rows, fastest, spent, refused = [], 0.0, [], ""
    arcs = np.append(0.0, np.cumsum(cable.length))
    for frame in frames:
        begun = time.process_time()
        if tracker is None:
            pivot = camera.project(estimator.process.base(frame.time)[:1])[0]
            try:
                width, tone = case.width * SCALE, srgb_tone() if case.tone else None
                look = find_rope(frame.image, pivot, width=width if width >= 1.0 else None, tone=tone).look  # px
            except InvalidInput as error:
                refused = str(error).partition(":")[0]
                print(f"{frame.time:.2f} s: {error}")
                if frame.time > START + LONGEST:
                    break
                continue
            tracker = RopeTracker(estimator, CurveMeasurement(look))
        result = tracker.look(frame)
        spent.append(time.process_time() - begun)
        before, now, after = motion.places(frame.time + np.array([-1e-3, 0.0, 1e-3]), arcs)[:, :, :2]
        fastest = max(fastest, float(np.linalg.norm(after[-1] - before[-1])) / 2e-3)
        if result.state is None:
            continue
        places, slopes = estimator.joints(result.state)
        off = (places - now)[1:]
        wide = slopes[1:] @ result.state.covariance[:LINKS, :LINKS] @ slopes[1:].swapaxes(1, 2)
        along = np.gradient(places, axis=0)[1:]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        distance = np.einsum("ka,ka->k", across, off) ** 2 / np.einsum("ka,kab,kb->k", across, wide, across)
        within = np.append(distance < NINETY[0], off[-1] @ np.linalg.solve(wide[-1], off[-1]) < NINETY[1])
        rows.append((frame.time, (off**2).sum(axis=1), within, result.seen.mean()))
    if tracker is None:
        return {"reported": refused, "off": None}
    t, squares, within, seen = (np.array(column) for column in zip(*rows, strict=True))
    used = (t > t[0] + SETTLED) & ~np.any([(t >= a) & (t < b + 0.1) for a, b in case.blackouts] or [t < 0.0], axis=0)
    return {
        "fastest": fastest,
        "curve": float(np.sqrt(squares[used].mean())),
        "tip": float(np.sqrt(squares[used, -1].mean())),
        "worst": float(np.sqrt(squares[used, -1].max())),
        "within": float(within[used, :-1].mean()),
        "tip within": float(within[used, -1].mean()),
        "seen": float(seen[used].mean()),
        "doubted": bool(tracker and tracker.warning),
        "lost": bool((np.sqrt(squares[-10:].mean(axis=1)) > 0.1).any()) or result.state is None,
        "ms": 1e3 * float(np.median(spent)),
        "slowest, ms": 1e3 * float(np.percentile(spent[5:], 99)),
    }


WRONG = {  # the fault, and the scale of the declared rope
    "nothing": 1.0,
    "no rope": 1.0,
    "two ropes": 1.0,
    "the rope leaves the view": 1.0,
    "10 % too long": 1.1,
    "10 % too short": 0.9,
    "mirrored, the arm's motion known": 1.0,
    "the camera pans": 1.0,
    "the camera shakes": 1.0,
}


def reported(wrong: str, seed: int, folder: Path) -> dict[str, Any]:
    """Track a video of 4 s with a wrong set-up; return the report, and the final error of the free end."""
    case, rng = Case(cast=wrong.startswith("mirrored")), np.random.default_rng((seed, 9))
    motion, scale = motion_of(case, seed), 800.0 if "view" in wrong else SCALE
    camera = Camera.facing((1280, 720), pixels_per_metre=scale, origin=(640.0, 60.0), exposure=case.exposure)
    scene = Scene(
        np.zeros(0),
        rope_width=0.0 if wrong == "no rope" else WIDTH,
        rope_colour=DARK,
        occluders=(Occluder((0.0, 0.0), (0.5, -1.7), WIDTH, DARK),) if wrong == "two ropes" else (),
        seed=seed,
    )
    renderer, cable = Renderer(camera, motion, scene), rope(LINKS, WRONG[wrong])
    given = {"motion": SWINGS, "arm": ARM} if case.cast else {}
    estimator = RopeFilter(cable, curve_arc_lengths(cable), camera=camera, **given)
    path = folder / "wrong.mp4"
    with VideoWriter(path, camera.image_size, 23) as video:
        for t in START + np.arange(0.0, 4.0, 1.0 / case.rate):
            shift = {"the camera pans": (25.0 * t, 0.0), "the camera shakes": rng.normal(0.0, 2.5, 2)}.get(wrong)
            image = renderer.image(t)
            if shift is not None:
                moved = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
                image = cv2.warpAffine(image, moved, camera.image_size, borderMode=cv2.BORDER_REPLICATE)
            video.write(np.ascontiguousarray(image[:, ::-1]) if case.cast else image, t)
    try:
        with VideoReader(path) as frames:
            first = next(iter(frames))
        pivot = camera.project(estimator.process.base(first.time)[:1])[0]
        look = find_rope(first.image, pivot, width=WIDTH * scale).look
        said = "; ".join(map(str, track_video(path, RopeTracker(estimator, CurveMeasurement(look))).doubts))
    except InvalidInput as refusal:
        return {"reported": str(refusal).partition(":")[0], "off": None}
    true = motion.places([estimator.state.t], [LENGTH * min(1.0, WRONG[wrong])])[0, 0, :2]
    return {"reported": said, "off": float(np.linalg.norm(estimator.tip(estimator.state)[0] - true))}


def main() -> None:
    """Run the chosen cases and write a line for each, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", help="how many seeds, or: wrong, page")
    parser.add_argument("--case", default="", help="cases whose name contains this text")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--videos", type=Path, help="folder that keeps the videos of runs")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    todo: list[tuple[str, int, Callable[[str, int, Path], dict[str, Any]]]] = []
    if options.seeds == "wrong":
        todo = [(name, options.first, reported) for name in WRONG if options.case in name]
    elif options.seeds != "page":
        seeds = range(options.first, options.first + int(options.seeds))
        todo = [(name, seed, run) for name in CASES if options.case in name for seed in seeds]
    for name, seed, work in todo:
        with tempfile.TemporaryDirectory() as folder:
            found = work(name, seed, options.videos or Path(folder))
        row = {"case": name, "seed": seed, **found, "kernels": SOURCE_HASH}
        log.append(options.out, row)
        print(row, flush=True)
    files.write_text(options.out.with_suffix(".md"), page(log.read(options.out)))


def page(rows: list[log.Row]) -> str:
    """The results as Markdown."""
    kept = {(row["case"], row["seed"]): row for row in rows}
    lines = ["# A plain rope, tracked without markers", "", __doc__.split("\n\n")[2].replace("\n", " ").strip(), ""]
    lines.append(
        "| case | seeds | fastest, m/s | curve rms, mm (worst seed) | goal | tip rms, mm (worst seed) | goal | curve "
        "within the stated 90 %, % (from - to) | tip, % (from - to) | lost | doubted | ms a frame (slowest of 100) |"
    )
    lines.append("|---" * 12 + "|")
    for name, case in CASES.items():
        own = [row for (which, _), row in kept.items() if which == name and "curve" in row]
        if not own:
            continue
        table: dict[str, Array] = {
            key: np.array([row[key] for row in own], dtype=float)
            for key in set(own[0]) - {"case", "kernels", "doubted"}
        }
        rms = {key: (1e3 * np.sqrt((table[key] ** 2).mean()), 1e3 * table[key].max()) for key in ("curve", "tip")}
        within = 1e2 * table["within"]
        cells = [
            name,
            " ".join(str(row["seed"]) for row in own),
            f"{table['fastest'].max():.1f}",
            "{:.2g} ({:.2g})".format(*rms["curve"]),
            f"{ASKED[case.cast][0]:g}",
            "{:.2g} ({:.2g})".format(*rms["tip"]),
            f"{ASKED[case.cast][1]:g}",
            f"{within.mean():.0f} ({within.min():.0f} - {within.max():.0f})",
            "{:.0f} ({:.0f} - {:.0f})".format(*(1e2 * f(table["tip within"]) for f in (np.mean, np.min, np.max))),
            f"{table['lost'].sum():.0f}",
            sum(row.get("doubted", False) for row in own),
            f"{np.median(table['ms']):.1f} ({np.median(table['slowest, ms']):.1f})",
        ]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    wrong = [row for row in kept.values() if "reported" in row]
    if wrong:
        lines += [
            "",
            "## Wrong set-ups and refused videos: what is reported",
            "",
            "| fault | reported | error of the end, m |",
            "|---|---|---|",
        ]
    for row in wrong:
        off = "-" if row["off"] is None else f"{row['off']:.2g}"
        lines.append(f"| {row['case']} | {row['reported'] or '-'} | {off} |")
    return "\n".join([*lines, "", f"{log.made(kept.values())} {machine.sentence(machine.describe())}\n"])


if __name__ == "__main__":
    main()
