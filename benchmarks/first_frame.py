"""The rope in a first frame: is the curve right, or is it refused by name? 200 poses and looks drawn at random.

python -m benchmarks.first_frame                    200 frames of the seed that judges
python -m benchmarks.first_frame --seed 1 --count 40 --pictures FOLDER

Ropes of 0.5 to 3 m hang, swing and are pumped, 120 links each. A look is drawn for each frame: thickness, colour and wall
(dark on bright, bright on dark, coloured on textured), texture of rope and wall, shadow, shine, clutter, noise, exposure,
quality of the compression. The pivot is clicked 2 px (rms) off. A curve is right if its rms distance from the true one
in the middle of the exposure is at most 1 % of the rope's length, and the free end at most 3 % off.
"""

import argparse
import functools
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.vision import Camera, Image, Occluder, Renderer, RopeMotion, Scene
from hyperflex.vision.first_frame import FoundRope, NoRope, find_rope

LINKS, POSES = 120, 10  # of the truth; frames of one motion
SIZE = (1280, 720)  # px
CURVE, END = 0.01, 0.03  # of the rope's length
LOOKS = ("dark on bright", "bright on dark", "coloured on textured")


class Shot(NamedTuple):
    """A frame, and what is true of it."""

    image: Image
    camera: Camera
    curve: Array  # (P, 2) px, in the middle of the exposure
    pivot: Array  # (2,) px, as clicked
    length: float  # m
    look: str
    width: float  # px
    blur: float  # px, of the fastest part


@functools.lru_cache(maxsize=2)
def motion(seed: int, number: int) -> tuple[hf.Rope, RopeMotion]:
    """A rope and how it moves for 4 s: it swings freely from a bent start, or an arm pumps it."""
    rng, s = np.random.default_rng((seed, number)), np.linspace(0.0, 1.0, LINKS)
    length = float(rng.uniform(0.5, 3.0))
    rope = hf.Rope.uniform(
        length=length, mass=0.06 * length, n_links=LINKS, radius=0.003, friction=1.4e-4 * length**2 * LINKS / 24
    )
    pumped = number % 3 == 2
    q0 = (
        rng.normal() * (0.1 if pumped else 0.5)
        + 0.25 * rng.normal() * np.sin(np.pi * s)
        + 0.15 * rng.normal() * np.sin(2.0 * np.pi * s)
    )
    swings = hf.arm_swings(t_move=0.52 * length**0.5, t_rest=0.37 * length**0.5) if pumped else None
    arm = hf.Arm(length=0.1) if pumped else None
    t = np.arange(0.0, 4.0, 1.0 / 400.0)
    return rope, RopeMotion.from_trajectory(hf.simulate(rope, swings, arm=arm, q0=q0, duration=4.0, t_eval=t))


def shot(seed: int, index: int) -> Shot:
    """Draw a frame."""
    rope, moves = motion(seed, index // POSES)
    rng, length = np.random.default_rng((seed, index, 1)), rope.total_length
    scale = float(rng.uniform(0.55, 0.85)) * SIZE[1] / length
    camera = Camera.facing(
        SIZE,
        pixels_per_metre=scale,
        origin=(rng.uniform(0.4, 0.6) * SIZE[0], rng.uniform(0.08, 0.14) * SIZE[1]),
        roll=rng.normal() * 0.02,
        exposure=float(rng.choice([1 / 100, 1 / 250, 1 / 1000])),
        readout=float(rng.choice([0.0, 0.015])),
    )
    look = LOOKS[index % 3]
    bright, dark = (
        rng.uniform(150.0, 220.0, 3).mean() + rng.normal(0, 8, 3),
        rng.uniform(25.0, 75.0) + rng.normal(0, 5, 3),
    )
    strong = np.array([[40.0, 40.0, 200.0], [200.0, 90.0, 30.0], [50.0, 170.0, 60.0], [40.0, 200.0, 230.0]])
    rope_colour, wall = {
        "dark on bright": (dark, bright),
        "bright on dark": (bright, dark),
        "coloured on textured": (strong[rng.integers(4)], rng.uniform(80.0, 170.0) + rng.normal(0, 8, 3)),
    }[look]
    width = float(np.exp(rng.uniform(np.log(1.5), np.log(9.0))))  # px
    base = moves.places([0.0], [0.0])[0, 0, :2]
    stamp = float(rng.uniform(0.05, 3.9))
    top = moves.places([stamp], [0.0])[0, 0, :2]
    things = tuple(
        Occluder(tuple(a), tuple(b), float(rng.uniform(0.005, 0.04)) * length, tuple(rng.uniform(30.0, 220.0, 3)))
        for a, b in rng.uniform(-1.0, 1.0, (int(rng.integers(0, 2)), 2, 2)) * length + [0.0, -0.4 * length]
    )
    arm = (Occluder((0.0, 0.0), tuple(top), 0.02, (90.0, 95.0, 100.0)),) if np.hypot(*(top - [0.0, 0.0])) > 0.02 else ()
    scene = Scene(
        [],
        rope_width=width / scale,
        rope_colour=np.clip(rope_colour, 5.0, 250.0),
        rope_texture=float(rng.choice([0.0, 0.1, 0.25])),
        shine=float(rng.choice([0.0, 0.0, 120.0])) if look == "dark on bright" else 0.0,
        shadow=(float(rng.uniform(-0.08, 0.08)) * length, -0.02 * length, float(rng.choice([0.0, 0.3]))),
        background=np.clip(wall, 15.0, 235.0),
        wall_texture=float(rng.uniform(0.0, 15.0)) if look == "coloured on textured" else float(rng.uniform(0.0, 6.0)),
        clutter=int(rng.integers(0, 12)),
        noise=float(rng.uniform(1.0, 4.0)),
        occluders=arm,
        seed=int(rng.integers(1 << 30)),
    )
    image = Renderer(camera, moves, scene).image(stamp)
    image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(75, 96))])[1], 1)
    arcs = np.linspace(0.0, length, 400)
    begin, end = (camera.project(moves.places([stamp + k * camera.exposure], arcs)[0]) for k in (-0.5, 0.5))
    curve = camera.project(moves.places([stamp], arcs)[0])
    for _ in range(3):  # each point in its row
        curve = camera.project(
            np.array([moves.places([t], [s])[0, 0] for t, s in zip(camera.exposure_times(stamp, curve), arcs)])
        )
    pivot = curve[0] + rng.normal(0.0, 2.0, 2)
    return Shot(image, camera, curve, pivot, length, look, width, float(np.hypot(*(end - begin).T).max()))


def distances(curve: Array, truth: Array) -> tuple[float, float]:
    """Rms distance of the true points from a curve, and between the ends, px."""
    dense = np.stack(
        [np.interp(np.linspace(0, len(curve) - 1, 4 * len(curve)), np.arange(len(curve)), c) for c in curve.T], 1
    )
    near = np.array([np.hypot(*(dense - point).T).min() for point in truth])
    return float(np.sqrt(np.mean(near**2))), float(np.hypot(*(curve[-1] - truth[-1])))


def measure(seed: int, index: int, known_length: bool) -> tuple[dict[str, Any], Shot, FoundRope | None]:
    """Find the rope in a frame."""
    each, found = shot(seed, index), None
    size = float(np.hypot(*np.diff(each.curve, axis=0).T).sum())
    row: dict[str, Any] = {
        "index": index,
        "look": each.look,
        "width": round(each.width, 1),
        "blur": round(each.blur, 1),
    }
    begin = time.process_time()
    try:
        found = find_rope(each.image, each.pivot, length=size if known_length else None)
        curve, end = distances(found.curve, each.curve)
        row |= {"curve": round(curve / size, 4), "end": round(end / size, 4)}
        row["result"] = "right" if curve <= CURVE * size and end <= END * size else "wrong"
    except NoRope as error:
        row["result"] = error.reason.value
    return row | {"seconds": round(time.process_time() - begin, 2)}, each, found


def main() -> None:
    """Find ropes, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=5601)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--from", type=int, default=0, dest="first")
    parser.add_argument("--length", action="store_true")
    parser.add_argument("--pictures")
    options = parser.parse_args()
    rows = []
    for index in range(options.first, options.first + options.count):
        row, each, found = measure(options.seed, index, options.length)
        rows.append(row)
        print(json.dumps(row), flush=True)
        if options.pictures:
            shown = each.image.copy()
            for line, colour in ((each.curve, (0, 255, 0)), *([(found.curve, (255, 0, 255))] if found else [])):
                cv2.polylines(shown, [np.rint(line * 16).astype(np.int32)], False, colour, 1, cv2.LINE_AA, 4)
            cv2.circle(shown, np.rint(each.pivot).astype(int).tolist(), 8, (255, 255, 0), 1)
            cv2.putText(shown, f"{index} {row['result']}", (10, 700), 0, 0.8, (255, 0, 255), 2)
            cv2.imwrite(str(Path(options.pictures) / f"{index:03d}.png"), shown)
    print({name: sum(row["result"] == name for row in rows) for name in sorted({row["result"] for row in rows})})


if __name__ == "__main__":
    main()
