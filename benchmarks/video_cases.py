"""Stated and true errors of a track: a rope filmed by an independent renderer, tracked as the docs describe.

python -m benchmarks.video_cases                   all cases
python -m benchmarks.video_cases clean "flicker"   these cases; --seed for another rope, camera and calibration
python -m benchmarks.video_cases page              the page from the existing rows

The pictures do not use `hyperflex.vision`: the benchmark implements the camera (pinhole, k1, k2), draws discs and rope
at four times the resolution, averages sub-frames for the motion blur, and traces boards pixel by pixel. The command
line does the user's part: `hyperflex calibrate` from a video of a board and a picture of it in the plane, with the hook
clicked to a whole pixel, then `hyperflex track`; if markers have two colours, one of each is clicked. The truth is a
chain of 120 links, tracked with 24. Each seed has another rope, camera, frame rate, and number of markers.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import numpy.typing as npt
from benchmarks import log, machine
from scipy.interpolate import CubicSpline

import hyperflex as hf
from hyperflex import files
from hyperflex.core.cache import SOURCE_HASH

RESULTS = Path(__file__).parent / "results" / "video_cases.jsonl"
Array = npt.NDArray[np.float64]

SIZE = (640, 480)  # px
CENTRE, RADIAL = np.array([326.4, 233.7]), (-0.08, 0.02)  # px; k1 and k2
TRUE_LINKS, LINKS = 120, 24
EXPOSURE, SUBFRAMES, FINE = 0.004, 5, 4  # s, pictures a frame, pixels a pixel
RED, GREEN = (40.0, 30.0, 205.0), (60.0, 165.0, 20.0)  # blue, green and red of markers
SQUARES, TALL = (8, 6), 360.0  # of the board; of the hanging rope, px


class Scene:
    """Rope, markers and camera of a seed."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng((seed, 6))
        self.seed, self.length = seed, float(rng.uniform(0.6, 1.6))  # m
        self.arcs = np.linspace(0.1, 1.0, int(rng.integers(6, 15))) * self.length
        self.rate = float(rng.choice([24.0, 25.0, 30.0, 50.0, 60.0]))  # frames/s
        self.focal = float(rng.uniform(700.0, 1100.0))  # px
        self.away = self.focal * self.length / TALL  # m, of the swing plane
        self.radius = float(rng.uniform(2.8, 4.2)) * self.length / TALL  # m, of a marker
        self.square = self.length / 15.0  # m, of the board

    def rope(self, n: int) -> hf.Rope:
        """The rope of n links: joint friction grows with n, so that it is the same rope."""
        mass, friction = 0.0625 * self.length, 1.4e-4 * self.length**2 * n / 24
        return hf.Rope.uniform(length=self.length, mass=mass, n_links=n, radius=0.002, friction=friction)


@dataclass(frozen=True)
class Case:
    """Differences from the plain video."""

    tilt: float = 0.0  # degrees, of the swing plane about the vertical
    jitter: float = 0.0  # s, by which frames are early or late
    flicker: float = 0.0  # relative amplitude of the light, at 10.3 Hz, followed by an exposure that lags
    crf: int = 16
    shake: float = 0.0  # px rms, of the whole picture in each frame
    sway: float = 0.0  # out of the plane over the swing in it
    colours: int = 1  # of the markers, by turns
    wood: bool = False  # a wall of the markers' hue, red things on it, and a person who walks by
    arm: float = 0.0  # m, of an arm that turns to and fro with the rope at its end, which the user does not declare
    from_hook: bool = False  # whether the user chooses the rope's first joint at the start as the origin, not the arm's
    duration: float = 3.5


CASES = {
    "clean": Case(),
    "flicker": Case(flicker=0.15),
    "uneven frame times": Case(jitter=0.008),
    "plane tilted by 8 degrees": Case(tilt=8.0),
    "compression (crf 38)": Case(crf=38),
    "camera shakes by 2 pixels": Case(shake=2.0),
    "10 % sway out of the plane": Case(sway=0.1),
    "wooden wall, clutter, one colour": Case(wood=True),
    "the same, two colours": Case(wood=True, colours=2),
    "the arm moves, undeclared": Case(arm=0.15),
    "an arm, from the hook at the start": Case(arm=0.15, from_hook=True),
}


def places(case: Case, scene: Scene, times: Array) -> Array:
    """Return the rope's joints (T, n + 1, 3), m, x right, y up, z to the viewer, at times (T,)."""
    rng, s = np.random.default_rng((scene.seed, 1)), np.linspace(0.0, 1.0, TRUE_LINKS)
    q0 = (
        0.5 + 0.1 * rng.normal() + 0.15 * rng.normal() * np.sin(np.pi * s) + 0.08 * rng.normal() * np.sin(2 * np.pi * s)
    )
    t = np.arange(0.0, case.duration + 0.1, 1.0 / 600.0)
    motion, arm = None, None
    if case.arm:
        motion, arm = hf.sampled_motion(t, 0.7 * np.sin(2 * np.pi * 1.1 * t)), hf.Arm(case.arm)
    run = hf.simulate(scene.rope(TRUE_LINKS), motion, arm=arm, q0=q0, duration=t[-1], t_eval=t, tol=1e-7)
    flat = CubicSpline(run.t, run.joints)(times)  # (T, n + 1, 2)
    along = np.linspace(0.0, 1.0, TRUE_LINKS + 1)
    phase = np.sqrt(9.81 * 1.45 / scene.length) * times[:, None]
    out = case.sway * np.abs(np.sin(0.5)) * scene.length * along * np.sin(phase)
    return np.concatenate([flat, out[:, :, None]], axis=2)


class Lens:
    """The camera and the pose of the swing plane."""

    def __init__(self, tilt: float, scene: Scene) -> None:
        rng = np.random.default_rng((scene.seed, 2))
        self.scene = scene
        turn, roll = np.radians(tilt), np.radians(rng.normal(0.0, 0.5))
        about_y = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
        about_z = np.array([[np.cos(roll), -np.sin(roll), 0.0], [np.sin(roll), np.cos(roll), 0.0], [0.0, 0.0, 1.0]])
        self.turn = np.diag([1.0, -1.0, -1.0]) @ about_y @ about_z  # of plane to camera
        self.move = np.append(rng.uniform([-0.04, -0.56], [0.04, -0.48]) * scene.length, scene.away)  # m, of the hook

    def pixels(self, points: Array) -> Array:
        """Return pixels (..., 2) of points (..., 3) of the plane's frame; (0, 0) is the middle of the first pixel."""
        return seen(points @ self.turn.T + self.move, self.scene.focal)


def seen(points: Array, focal: float) -> Array:
    """Return pixels (..., 2) of points (..., 3) of the camera's frame."""
    ideal = points[..., :2] / points[..., 2:]
    square = (ideal**2).sum(axis=-1, keepdims=True)
    return np.asarray(focal * ideal * (1.0 + RADIAL[0] * square + RADIAL[1] * square**2) + CENTRE)


def rays(focal: float) -> Array:
    """Return directions (480, 640, 16, 3) of the lines of sight of 16 points of each pixel."""
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    u = (np.arange(SIZE[0])[:, None] + fine).ravel()
    v = (np.arange(SIZE[1])[:, None] + fine).ravel()
    target = (np.stack(np.meshgrid(u, v), axis=-1) - CENTRE) / focal
    ideal = target.copy()
    for _ in range(8):  # each iteration reduces the error by about 30
        square = (ideal**2).sum(axis=-1, keepdims=True)
        ideal = target / (1.0 + RADIAL[0] * square + RADIAL[1] * square**2)
    return np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=2)


def board_picture(
    sight: Array, square: float, turn: Array, move: Array, rng: np.random.Generator
) -> npt.NDArray[np.uint8]:
    """Return a picture of the board; `turn` and `move` take its frame (x right, y up, its top left corner) to ours."""
    pattern = board_pattern(square)
    side = pattern.shape[0] / SQUARES[1] / square  # pixels of the pattern a metre
    normal = turn[:, 2]
    points = sight * (normal @ move / (sight @ normal))[..., None] - move
    x, y = points @ turn[:, 0], -(points @ turn[:, 1])
    column, row = np.floor(x * side).astype(int), np.floor(y * side).astype(int)
    margin = round(0.4 * square * side)
    on = (column >= -margin) & (row >= -margin)
    on &= (column < pattern.shape[1] + margin) & (row < pattern.shape[0] + margin)
    inside = (column >= 0) & (row >= 0) & (column < pattern.shape[1]) & (row < pattern.shape[0])
    level = np.where(on, 235.0, 105.0)
    level[inside] = 30.0 + 205.0 / 255.0 * pattern[row[inside], column[inside]]
    gray = level.reshape(SIZE[1], FINE, SIZE[0], FINE).mean(axis=(1, 3))
    gray = cv2.GaussianBlur(gray, (0, 0), 0.5) + rng.normal(0.0, 2.0, gray.shape)
    return np.repeat(np.clip(np.rint(gray), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def board_pattern(square: float) -> npt.NDArray[np.uint8]:
    """Return the printed board, 96 pixels a square."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard(SQUARES, square, 0.75 * square, dictionary)
    return np.asarray(board.generateImage((96 * SQUARES[0], 96 * SQUARES[1])))


def film_board(folder: Path, lens: Lens) -> None:
    """Write board.mp4 and plane.png: the board held at many angles, and in the swing plane."""
    scene = lens.scene
    rng, sight, square = np.random.default_rng((scene.seed, 3)), rays(scene.focal), scene.square
    pictures, middle = [], square * np.array([0.5 * SQUARES[0], -0.5 * SQUARES[1], 0.0])
    for k in range(16):
        turn = cv2.Rodrigues(0.6 * np.array([np.cos(k), np.sin(k), 0.0]) + rng.normal(0.0, 0.1, 3))[0]
        turn = turn @ np.diag([1.0, -1.0, -1.0])
        place = scene.away * np.array([*rng.uniform([-0.07, -0.05], [0.07, 0.05]), rng.uniform(0.4, 0.57)])
        pictures.append(board_picture(sight, square, turn, place - turn @ middle, rng))
    write_video(folder / "board.mp4", pictures, np.arange(16) * 0.5, 16)
    corner = lens.move + lens.turn @ np.array([-0.25, -0.29, 0.0]) * scene.length
    cv2.imwrite(str(folder / "plane.png"), board_picture(sight, square, lens.turn, corner, rng))


def write_video(path: Path, pictures: list[npt.NDArray[np.uint8]], stamps: Array, crf: int) -> None:
    """Write an MP4 file (H.264, PyAV)."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=30, options={"crf": str(crf), "preset": "fast"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 90_000)
        for picture, stamp in zip(pictures, stamps, strict=True):
            frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
            frame.pts = round(90_000 * stamp)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def film(case: Case, lens: Lens) -> tuple[list[npt.NDArray[np.uint8]], Array, Array]:
    """Return frames, their time stamps, and where the markers are (T, K, 2) in the plane in the middle of each."""
    scene = lens.scene
    rng = np.random.default_rng((scene.seed, 4))
    stamps = np.arange(0.02, case.duration, 1.0 / scene.rate)
    stamps = stamps + rng.uniform(-case.jitter, case.jitter, stamps.size)
    stamps = np.round(stamps * 90_000) / 90_000
    parts = (np.arange(SUBFRAMES) + 0.5) / SUBFRAMES - 0.5
    times = (stamps[:, None] + EXPOSURE * parts).ravel()
    joints = places(case, scene, times)
    shakes = np.repeat(rng.normal(0.0, case.shake, (stamps.size, 2)), SUBFRAMES, axis=0)
    wall, pictures = wall_of(case, scene.seed), []
    light = 1.0
    for k, stamp in enumerate(stamps):
        own = slice(k * SUBFRAMES, (k + 1) * SUBFRAMES)
        picture = wall(stamp, shakes[own][0])
        draw(picture, lens, joints[own], shakes[own][0], case.colours)
        wanted = 1.0 + case.flicker * np.sin(2.0 * np.pi * 10.3 * stamp)
        gain, light = wanted / light, light + 0.3 * (wanted - light)
        picture = cv2.GaussianBlur(picture * np.float32(gain), (0, 0), 0.5) + 2.0 * rng.standard_normal(
            picture.shape, np.float32
        )
        pictures.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    middle = joints[SUBFRAMES // 2 :: SUBFRAMES]
    return pictures, stamps, on_rope(middle, scene)[:, :, :2]


def on_rope(joints: Array, scene: Scene) -> Array:
    """Return the markers' places (..., K, D) on a line of joints (..., n + 1, D)."""
    where = scene.arcs / scene.length * TRUE_LINKS
    first = np.minimum(np.floor(where).astype(int), TRUE_LINKS - 1)
    part = (where - first)[:, None]
    return np.asarray((1.0 - part) * joints[..., first, :] + part * joints[..., first + 1, :])


def wall_of(case: Case, seed: int) -> Callable[[float, Array], Array]:
    """Return the background at a time, shifted by some pixels."""
    rng = np.random.default_rng((seed, 5))
    width, height = SIZE[0] + 40, SIZE[1] + 40
    slope = np.linspace(-12.0, 12.0, width)[None, :, None]
    level = np.array([186.0, 192.0, 198.0]) + slope + np.zeros((height, 1, 1))
    if case.wood:
        grain = cv2.GaussianBlur(rng.normal(0.0, 1.0, (height, width)), (0, 0), sigmaX=30.0, sigmaY=1.5)
        level = np.array([70.0, 110.0, 165.0]) + 14.0 * (grain / grain.std())[..., None] * [0.8, 1.0, 1.1]
        for _ in range(9):  # red things, some as large as markers
            u, v, r = rng.uniform([20, 20, 3], [width - 20, height - 20, 9])
            cv2.circle(level, (int(u), int(v)), int(r), RED, -1, cv2.LINE_AA)

    shade = level.astype(np.float32)

    def shown(time: float, shake: Array) -> Array:
        matrix = np.array([[1.0, 0.0, shake[0] - 20.0], [0.0, 1.0, shake[1] - 20.0]])
        picture = cv2.warpAffine(shade, matrix, SIZE, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if case.wood:  # a person walks past behind the rope
            u = int(-60 + 220 * time)
            cv2.rectangle(picture, (u, 90), (u + 55, 480), (60.0, 55.0, 50.0), -1)
            cv2.circle(picture, (u + 27, 65), 25, (120.0, 150.0, 200.0), -1)
        return np.asarray(picture)

    return shown


def draw(picture: Array, lens: Lens, joints: Array, shake: Array, colours: int) -> None:
    """Draw the mean of instants (S, n + 1, 3) of rope and markers on a picture, with the covered share of each
    pixel."""
    scene, lines = lens.scene, lens.pixels(joints) + shake
    thickness = scene.focal * 0.004 / scene.away
    corner = np.maximum(np.floor(lines.min(axis=(0, 1))).astype(int) - 12, 0)
    right, bottom = np.ceil(lines.max(axis=(0, 1))).astype(int) + 13
    region = picture[corner[1] : bottom, corner[0] : right]
    height, width = region.shape[:2]
    drawn = []
    for line, points in zip(lines, on_rope(joints, scene), strict=True):
        layer, mask = region.copy(), np.zeros((height * FINE, width * FINE), np.uint8)
        fine = ((line - corner + 0.5) * FINE - 0.5) * 16.0
        cv2.polylines(mask, [np.rint(fine).astype(np.int32)], False, 255, round(thickness * FINE), cv2.LINE_AA, 4)
        share = cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA)[..., None] / np.float32(255.0)
        layer += share * (np.array([70.0, 72.0, 75.0], np.float32) - layer)
        centres = lens.pixels(points) + shake - corner
        sides = lens.pixels(points + np.array([scene.radius, 0, 0])) + shake - corner
        for k, (centre, radius) in enumerate(zip(centres, np.linalg.norm(sides - centres, axis=1), strict=True)):
            reach, (u, v) = int(radius) + 2, np.rint(centre).astype(int)
            if not (reach <= u < width - reach and reach <= v < height - reach):
                continue
            grid = (np.arange(-8 * reach, 8 * (reach + 1)) + 0.5) / 8.0 - 0.5  # px about the pixel, eighths
            inside = (grid + u - centre[0]) ** 2 + (grid[:, None] + v - centre[1]) ** 2 < radius**2
            share = inside.reshape(2 * reach + 1, 8, 2 * reach + 1, 8).mean(axis=(1, 3), dtype=np.float32)[..., None]
            part = layer[v - reach : v + reach + 1, u - reach : u + reach + 1]
            part += share * (np.array(RED if k % colours == 0 else GREEN, np.float32) - part)
        drawn.append(layer)
    region[:] = np.mean(drawn, axis=0)


def run(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Film a case, follow the docs, and compare."""
    case, scene = CASES[name], Scene(seed)
    lens = Lens(case.tilt, scene)
    film_board(folder, lens)
    pictures, stamps, true = film(case, lens)
    write_video(folder / "swing.mp4", pictures, stamps, case.crf)
    origin = places(case, scene, np.zeros(1))[0, 0] if case.from_hook else np.zeros(3)
    clicked = np.pad(true[0, : case.colours if case.colours > 1 else 0], ((0, 0), (0, 1)))
    np.savez(folder / "truth.npz", stamps=stamps, true=true - origin[:2], clicks=np.rint(lens.pixels(clicked)))
    scene.rope(LINKS).to_toml(folder / "rope.toml")
    hook = [str(round(each)) for each in lens.pixels(origin).tolist()]
    board = ["--squares", "8", "6", "--square", f"{scene.square:.9g}", "--marker", f"{0.75 * scene.square:.9g}"]
    board += ["--exposure", str(EXPOSURE), "--plane", "plane.png", "--origin-pixel", *hook]
    command(folder, "calibrate", "board.mp4", *board)
    return tracked(name, scene, folder)


def tracked(name: str, scene: Scene, folder: Path) -> dict[str, Any]:
    """Track the video in a folder, and compare."""
    arcs = ",".join(f"{arc:.12g}" for arc in scene.arcs)
    given = ["--rope", "rope.toml", "--camera", "camera.toml", "--arc-lengths", arcs]
    known = np.load(folder / "truth.npz")
    for u, v in known["clicks"]:
        given += ["--click", f"{u:.0f},{v:.0f}"]
    result = json.loads(command(folder, "track", "swing.mp4", *given, "--preview", "seen.mp4", "--json"))
    recording = hf.read_recording(folder / "markers.nc")
    at = [int(np.abs(known["stamps"] - t).argmin()) for t in recording.t]
    columns = [int(np.abs(scene.arcs - arc).argmin()) for arc in result["arc_lengths"]]
    error = recording.data.reshape(len(at), -1, 2) - known["true"][np.ix_(at, columns)]
    stated = np.broadcast_to(recording.noise, recording.data.shape).reshape(error.shape)
    there, scaled = np.isfinite(error), np.abs(error) / stated
    return {
        "case": name,
        "kernels": SOURCE_HASH,
        "seed": scene.seed,
        "seen": result["seen"] * len(columns) / len(scene.arcs),
        "error": float(np.sqrt(2.0 * np.nanmean(error**2))),
        "shift": np.nanmean(error, axis=(0, 1)).tolist(),
        "tip": float(np.sqrt(2.0 * np.nanmean(error[:, -1] ** 2))),
        "stated": float(np.sqrt(2.0 * np.mean(stated[there] ** 2))),
        "inside": float((scaled[there] < 1.96).mean()),
        "wrong": float((np.linalg.norm(error, axis=2)[there[:, :, 0]] > 0.05 * scene.length).mean()),
        "said": result["doubts"],
    }


def command(folder: Path, *words: str) -> str:
    """Run a command of hyperflex in a folder, and return its output."""
    program = [sys.executable, "-m", "hyperflex", *words]
    done = subprocess.run(program, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")
    return done.stdout


def main() -> None:
    """Run the chosen cases and write a line for each, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join([*CASES, "page"]).replace("%", "%%"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name in [] if options.cases == ["page"] else options.cases or CASES:
        with tempfile.TemporaryDirectory() as folder:
            row = run(name, options.seed, Path(folder))
        log.append(RESULTS, row)
        print(row, flush=True)
    files.write_text(RESULTS.with_suffix(".md"), page(log.read(RESULTS)))


def page(rows: list[log.Row]) -> str:
    """The results as Markdown."""
    kept = {(row["case"], row["seed"]): row for row in rows}
    lines = [
        "# Stated and true errors of a track",
        "",
        __doc__.split("\n\n")[2].replace("\n", " ").strip(),
        "",
        "| case | seed | seen, % | error, mm rms | tip | stated | inside 95 %, % | wrong marker, % | first line |",
        "|---" * 9 + "|",
    ]
    for name in CASES:
        for (case, seed), row in sorted(kept.items()):
            if case == name:
                numbers = [1e2 * row["seen"], *(1e3 * row[key] for key in ("error", "tip", "stated"))]
                numbers += [1e2 * row["inside"], 1e2 * row["wrong"]]
                cells = [name, str(seed), *(f"{number:.3g}" for number in numbers), "; ".join(row["said"])]
                lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "| seed | rope, m | markers | their radius, px | frames/s | pixels a metre |", "|---" * 6 + "|"]
    for scene in map(Scene, sorted({seed for _, seed in kept})):
        scale = TALL / scene.length
        numbers = [scene.length, len(scene.arcs), scene.radius * scale, scene.rate, scale]
        lines.append(f"| {scene.seed} | {' | '.join(f'{number:.3g}' for number in numbers)} |")
    return "\n".join([*lines, "", f"{log.made(kept.values())} {machine.sentence(machine.describe())}\n"])


if __name__ == "__main__":
    main()
