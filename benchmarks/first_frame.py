"""The rope in a first frame: is the curve right, or is the frame refused with the right reason?

python -m benchmarks.first_frame                    200 frames, 30 to be refused, 30 by MuJoCo
python -m benchmarks.first_frame --length           the same frames; the rope's length is known
python -m benchmarks.first_frame --seed 1 --count 40 --others 0 --pictures FOLDER

Ropes of 0.5 to 3 m and 120 links hang, swing or are pumped. Thickness, colour, wall, texture, shadow, shine, clutter,
noise, exposure and compression are drawn for each frame. The clicked pivot is 2 px (rms) off. Width, colour and length
of the rope are unknown, except in rows named "length known": there the length is known to 2 % (rms), as from two
clicked points. Grey levels are proportional to light, in the pictures and in the search, except in rows named "tone
curve": sRGB in both. A curve is right if its rms distance from the true one in the middle of the exposure is at most 1
% of the rope's length, and its free end is at most 3 % off.
"""

import argparse
import functools
import json
import time
from collections import Counter
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from benchmarks import log, machine

import hyperflex as hf
from hyperflex import files
from hyperflex.checks import Array
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.vision import (
    Camera,
    Image,
    NoRope,
    Occluder,
    Reason,
    Renderer,
    RopeMotion,
    Scene,
    find_rope,
    srgb_tone,
)

RESULTS = Path(__file__).parent / "results" / "first-frame.jsonl"
LINKS, POSES = 120, 10  # of the truth; frames of one motion
SIZE = (1280, 720)  # px
CURVE, END = 0.01, 0.03  # of the rope's length
LOOKS = ("dark on bright", "bright on dark", "coloured on textured")
# Frames that show no rope, two, one that leaves the view, or one whose last sixth is behind a thing
ABSENT = (Reason.NOTHING, Reason.TWO, Reason.OUTSIDE, Reason.HIDDEN)
EYE_LINKS = 60  # capsules of MuJoCo's rope


class Shot(NamedTuple):
    """A frame and its truth."""

    image: Image
    curve: Array  # (P, 2) px, each point in the middle of its row's exposure
    length: float  # px, as from two clicked points
    pivot: Array  # (2,) px, as clicked
    look: str
    width: float  # px
    blur: float  # px, of the fastest part


@functools.lru_cache(maxsize=2)
def motion(seed: int, number: int) -> tuple[hf.Rope, RopeMotion]:
    """A rope and its motion for 4 s: a free swing from a bent start, or pumping by an arm."""
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


def shot(
    seed: int, index: int, absent: Reason | None = None, by_mujoco: bool = False, tone: Array | None = None
) -> Shot:
    """Draw a frame; optionally one to be refused, by MuJoCo's renderer, or with a tone curve."""
    rope, moves = motion(seed, index // POSES)
    rng, length = np.random.default_rng((seed, index, 1)), rope.total_length
    stamp, look = float(rng.uniform(0.05, 3.9)), LOOKS[index % 3]
    scale = float(rng.uniform(0.55, 0.85)) * SIZE[1] / length * (2.0 if absent is Reason.OUTSIDE else 1.0)
    camera = Camera.facing(
        SIZE,
        pixels_per_metre=scale,
        origin=(rng.uniform(0.4, 0.6) * SIZE[0], rng.uniform(0.08, 0.14) * SIZE[1]),
        roll=0.0 if by_mujoco else rng.normal() * 0.02,
        exposure=float(rng.choice([1 / 100, 1 / 250, 1 / 1000])),
        readout=0.0 if by_mujoco else float(rng.choice([0.0, 0.015])),
    )
    bright, dark = rng.uniform(150.0, 220.0) + rng.normal(0, 8, 3), rng.uniform(25.0, 75.0) + rng.normal(0, 5, 3)
    strong = np.array([[40.0, 40.0, 200.0], [200.0, 90.0, 30.0], [50.0, 170.0, 60.0], [40.0, 200.0, 230.0]])
    colour, wall = {
        "dark on bright": (dark, bright),
        "bright on dark": (bright, dark),
        "coloured on textured": (strong[rng.integers(4)], rng.uniform(80.0, 170.0) + rng.normal(0, 8, 3)),
    }[look]
    width = float(np.exp(rng.uniform(np.log(1.5), np.log(9.0))))  # px
    scene = Scene(
        [],
        rope_width=0.0 if absent is Reason.NOTHING else width / scale,
        rope_colour=np.clip(colour, 5.0, 250.0),
        rope_texture=float(rng.choice([0.0, 0.1, 0.25])),
        shine=float(rng.choice([0.0, 0.0, 120.0])) if look == "dark on bright" else 0.0,
        shadow=(float(rng.uniform(-0.08, 0.08)) * length, -0.02 * length, float(rng.choice([0.0, 0.3]))),
        background=np.clip(wall, 15.0, 235.0),
        wall_texture=float(rng.uniform(0.0, 15.0 if look == "coloured on textured" else 6.0)),
        clutter=int(rng.integers(0, 12)),
        noise=float(rng.uniform(1.0, 4.0)),
        tone=tone,
        occluders=_before(moves, stamp, width / scale, colour, absent, motion(seed, index // POSES + 1)[1]),
        seed=int(rng.integers(1 << 30)),
    )
    image = _by_mujoco(camera, moves, scene, stamp) if by_mujoco else Renderer(camera, moves, scene).image(stamp)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(75, 96))]
    image = np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, quality)[1], cv2.IMREAD_COLOR), np.uint8)
    truth = Renderer(camera, moves, Scene(np.linspace(0.0, length, 200))).truth([stamp])
    curve, blur = truth.pixels[0], float(np.hypot(*truth.streaks[0].T).max())
    pivot, size = curve[0] + rng.normal(0.0, 2.0, 2), float(np.hypot(*np.diff(curve, axis=0).T).sum())
    return Shot(image, curve, size * (1.0 + 0.02 * rng.normal()), pivot, look, width, blur)


def _before(
    moves: RopeMotion, stamp: float, width: float, colour: Array, absent: Reason | None, other: RopeMotion
) -> tuple[Occluder, ...]:
    """The arm, if it moves; a second rope from the same pivot, if there are two; what hides an end, if it is hidden."""
    top = moves.places([stamp], [0.0])[0, 0, :2]
    things = [Occluder((0.0, 0.0), tuple(top), 0.02, (90.0, 95.0, 100.0))] if np.hypot(*top) > 0.02 else []
    size, reach = moves.joint_arc_lengths[-1], other.joint_arc_lengths[-1]
    if absent is Reason.HIDDEN:
        rng, ends = np.random.default_rng((int(1e6 * stamp), 7)), moves.places([stamp], size * np.array([5 / 6, 1.05]))
        line, wide = ends[0, :, :2].tolist(), float(rng.uniform(0.06, 0.15)) * size
        things += [Occluder(tuple(line[0]), tuple(line[1]), wide, tuple(rng.uniform(30.0, 220.0, 3)))]
    if absent is Reason.TWO:
        places = other.places([4.0 - stamp], np.linspace(0.0, reach, 40))[0, :, :2]
        line = (
            top
            + (places - places[0]) * [-1.0, 1.0] * size / reach
            + np.linspace(0.0, 0.25 * size, 40)[:, None] * [1, 0]
        )
        things += [Occluder(tuple(a), tuple(b), width, tuple(colour)) for a, b in pairwise(line.tolist())]
    return tuple(things)


def _by_mujoco(camera: Camera, moves: RopeMotion, scene: Scene, stamp: float) -> Image:
    from tests.oracles.mujoco_eye import Eye, Look

    away = float(camera.axes[1][2])
    origin, focal = camera.project([[0.0, 0.0]])[0], float(camera.matrix[0, 0])
    look = Look(
        tuple(np.asarray(scene.rope_colour)), 0.5 * scene.rope_width, float(scene.shine > 0.0), tuple(scene.background),
        scene.wall_texture, scene.shadow[2] > 0.0, scene.noise,
    )  # fmt: skip
    eye = Eye(SIZE, focal, away, origin, EYE_LINKS, look, scene.seed)
    times = stamp + camera.exposure * ((np.arange(8) + 0.5) / 8 - 0.5)
    arcs = np.linspace(0.0, moves.joint_arc_lengths[-1], EYE_LINKS + 1)
    image = eye.picture(moves.places(times, arcs)[:, :, :2])
    eye.close()
    return np.asarray(image, np.uint8)


def measure(seed: int, index: int, kind: str, known: bool, toned: bool, pictures: Path | None) -> dict[str, Any]:
    """Find the rope in a frame, with or without its length and a tone curve."""
    absent = Reason(kind) if kind in set(ABSENT) else None
    tone = srgb_tone() if toned else None
    each, found = shot(seed, index, absent, kind == "MuJoCo", tone), None
    size = float(np.hypot(*np.diff(each.curve, axis=0).T).sum())
    row: dict[str, Any] = {"kind": kind, "index": index, "seed": seed, "length": known, "kernels": SOURCE_HASH}
    row["finder"] = log.sources("vision")
    row |= {"tone": True} if toned else {}
    row |= {} if ((each.curve >= 0.0) & (each.curve <= np.array(SIZE) - 1.0)).all() else {"leaves": True}
    row |= {"look": each.look, "width": round(each.width, 1), "blur": round(each.blur, 1)}
    begin = time.process_time()
    try:
        found = find_rope(each.image, each.pivot, length=each.length if known else None, tone=tone)
    except NoRope as error:
        row["result"] = error.reason.value
    row["seconds"] = round(time.process_time() - begin, 2)
    if found is not None:
        near = np.linalg.norm(found.curve[:, None] - each.curve, axis=2).min(axis=0)
        curve, end = (
            float(np.sqrt(np.mean(near**2))) / size,
            float(np.hypot(*(found.curve[-1] - each.curve[-1]))) / size,
        )
        right = curve <= CURVE and end <= END and absent is None
        row |= {"curve": round(curve, 5), "end": round(end, 5), "result": "right" if right else "wrong"}
    if pictures:
        shown = each.image.copy()
        for line, colour in ((each.curve, (0, 255, 0)), *([(found.curve, (255, 0, 255))] if found else [])):
            cv2.polylines(shown, [np.rint(line * 16).astype(np.int32)], False, colour, 1, cv2.LINE_AA, 4)
        cv2.putText(shown, f"{kind} {index} {row['result']}", (10, 700), 0, 0.8, (255, 0, 255), 2)
        cv2.imwrite(str(pictures / f"{kind[:6]}-{index:03d}.png"), shown)
    return row


def page(rows: list[dict[str, Any]]) -> str:
    """The page."""
    text = "# The rope in a first frame\n\n" + (__doc__ or "").split("\n\n", 2)[2] + "\n"
    text += "| frames | number | right | refused, reason | wrong | curve, median, % | worst | end, median, % | s |\n"
    text += "|---|---|---|---|---|---|---|---|---|\n"
    for kind, known, toned in product(("rope", "MuJoCo"), (False, True), (False, True)):
        for look in LOOKS:
            wanted = {"kind": kind, "length": known, "look": look, "tone": toned}
            own = [row for row in rows if wanted.items() <= ({"tone": False} | row).items()]
            if own:
                counts = Counter(row["result"] for row in own)
                right, wrong = counts.pop("right", 0), counts.pop("wrong", 0)
                refused = "; ".join(f"{number}: {name}" for name, number in counts.items()) or "none"
                off = 100.0 * np.array(
                    [[row["curve"], row["end"]] for row in own if row["result"] == "right"] or [[np.nan] * 2]
                )
                figures = f"{np.median(off[:, 0]):.2f} | {off[:, 0].max():.2f} | {np.median(off[:, 1]):.2f}"
                spent = np.median([row["seconds"] for row in own])
                name = look + (", by MuJoCo" if kind == "MuJoCo" else "") + (", length known" if known else "")
                name += ", tone curve" if toned else ""
                text += f"| {name} | {len(own)} | {right} | {refused} | {wrong} | {figures} | {spent:.1f} |\n"
    away = [row["result"] for row in rows if row["kind"] == "rope" and row.get("leaves")]
    text += f"\nIn {len(away)} of the frames with one rope it leaves the view: {away.count(Reason.OUTSIDE)} of them "
    text += "are refused for this reason.\n"
    text += "\n| to be refused | frames | with this reason | with another | accepted |\n|---|---|---|---|---|\n"
    for kind in ABSENT:
        own = [row["result"] for row in rows if row["kind"] == kind.value]
        named, wrong = own.count(kind.value), own.count("wrong")
        text += f"| {kind.value} | {len(own)} | {named} | {len(own) - named - wrong} | {wrong} |\n"
    return text


def main() -> None:
    """Find ropes, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=5601, help="of poses and appearances (5601)")
    parser.add_argument("--count", type=int, default=200, help="frames with one rope (200)")
    parser.add_argument("--others", type=int, default=30, help="by MuJoCo, and to be refused (30 each)")
    parser.add_argument("--first", type=int, default=0, help="first frame (0)")
    parser.add_argument("--length", action="store_true", help="the rope's length is known")
    parser.add_argument("--tone", action="store_true", help="the pictures, except MuJoCo's, have a tone curve (sRGB)")
    parser.add_argument("--pictures", type=Path, help="folder for the frames with the true (green) and the found curve")
    parser.add_argument("--out", type=Path, default=RESULTS, help="file of rows; the page is written next to it")
    options = parser.parse_args()
    before = log.read(options.out)
    log.warn_of_others(before)
    indices = range(options.first, options.first + options.count)
    marks = [("rope", index) for index in indices] + [("MuJoCo", index) for index in range(options.others)]
    marks += [(ABSENT[index % len(ABSENT)].value, index) for index in range(options.others)]
    for kind, index in marks:
        mark = {"kind": kind, "index": index, "seed": options.seed, "length": options.length, "tone": options.tone}
        if not any(mark.items() <= ({"tone": False} | each).items() for each in before):
            row = measure(options.seed, index, kind, options.length, options.tone, options.pictures)
            print(json.dumps(row), flush=True)
            log.append(options.out, row)
    rows = [row for row in log.read(options.out) if row["seed"] == options.seed]
    made = f"{machine.sentence(machine.describe())} {log.made(rows)} {log.made(rows, 'finder')}"
    again = f"`python -m benchmarks.first_frame --seed {options.seed} --others {options.others}`, and with `--length`"
    text = page(rows) + f"\nSeed {options.seed}. {made}\n\nReproduce: {again}\n"
    print(text)
    files.write_text(options.out.with_suffix(".md"), text)


if __name__ == "__main__":
    main()
