"""A plain rope, filmed without markers, tracked and identified as the tutorial says: do intervals contain the truth?

python -m benchmarks.plain                      20 twins, an hour; to benchmarks/results/plain.jsonl
python -m benchmarks.plain --count 2 --out -    a look; nothing is written
python -m benchmarks.plain --markers            the same ropes with ten markers, for the widths

Each twin is a rope of LINKS links, simulated with a tolerance of 1e-9 and filmed by the renderer for 10 s: 1280x720,
30 frames/s, compressed, with the noise of a phone; the camera is rolled by some tenths of a degree, the clicks are off
by a pixel. The user's part is done by the command line: `hyperflex track` with a length and answers, `hyperflex
identify`. Mass is not known: what is compared is friction and inertia over mass. The exit code is 1 if an interval of
friction or inertia misses the truth in more than one twin of 20.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log, machine
from numpy.typing import NDArray

import hyperflex as hf
from hyperflex.vision import Camera, Renderer, RopeMotion, Scene

RESULTS = Path(__file__).parent / "results" / "plain.jsonl"
Array = NDArray[np.float64]
LINKS, COUNT, SECONDS, RATE = 20, 20, 10.0, 30.0
SIZE, VIEW = (1280, 720), 4.5  # px; m, width of the picture
MARKERS = 10
FREE = "friction:shared,inertia:shared,drag:shared"


def rope(rng: np.random.Generator) -> hf.Rope:
    """A rope of 1.4 to 2 m, 5 mm thick, of 40 to 90 g/m, whose links are stouter than a cylinder's."""
    length = float(rng.uniform(1.4, 2.0))
    mass = float(rng.uniform(0.04, 0.09)) * length
    friction = float(np.exp(rng.uniform(-0.7, 0.7))) * 2e-5 * LINKS / length * mass / length / 0.0625
    line = hf.Rope.uniform(length, mass, LINKS, 0.0025, friction=friction, drag_coefficient=1.2)
    return line.replace(inertia=line.inertia * float(rng.uniform(0.8, 2.0)))


def film(line: hf.Rope, seed: int, path: Path, markers: int) -> Camera:
    """Write the video; return the camera."""
    rng, s = np.random.default_rng((seed, 1)), np.linspace(0.0, 1.0, LINKS)
    bend = 0.25 * rng.normal() * np.sin(np.pi * s) + 0.15 * rng.normal() * np.sin(2.0 * np.pi * s)
    run = hf.simulate(line, duration=SECONDS + 0.1, q0=0.8 + bend, t_eval=np.arange(0.0, SECONDS + 0.1, 2e-3), tol=1e-9)
    camera = Camera.facing(
        SIZE,
        pixels_per_metre=SIZE[0] / VIEW,
        origin=rng.uniform([560.0, 40.0], [720.0, 80.0]),
        roll=float(np.radians(rng.normal(0.0, 0.4))),
        exposure=0.002,
    )
    arcs = line.total_length * np.arange(1, markers + 1) / max(markers, 1)
    scene = Scene(arcs, marker_diameter=0.03, rope_width=0.005, seed=seed, clutter=0)
    motion = RopeMotion(run.t, run.q, run.qd, line.length)
    Renderer(camera, motion, scene).write(path, np.arange(round(SECONDS * RATE)) / RATE, quality=20)
    return camera


def examine(seed: int, markers: int, folder: Path) -> dict[str, Any]:
    """Film a twin, do what the tutorial says, and compare."""
    rng = np.random.default_rng((seed, 0))
    line = rope(rng)
    camera = film(line, seed, folder / "phone.mp4", markers)
    if markers:
        camera.write(folder / "camera.toml")
        guess = hf.Rope.uniform(
            line.total_length, 0.0625 * line.total_length, LINKS, 0.0025, friction=4e-4, drag_coefficient=1.2
        )
        guess.to_toml(folder / "markers-rope.toml")
        arcs = ",".join(f"{arc:.6g}" for arc in line.total_length * np.arange(1, markers + 1) / markers)
        given = ["--rope", "markers-rope.toml", "--camera", "camera.toml", "--arc-lengths", arcs, "--changes", "none"]
    else:
        pivot = camera.project([[0.0, 0.0]])[0] + rng.normal(0.0, 0.7, 2)
        given = ["--length", f"{line.total_length:.3f}", "--pivot", *(f"{each:.0f}" for each in pivot)]
        given += ["--tip", "found", "--size", "rope", "--mass", "unknown"]
    tracked = command(folder, "track", "phone.mp4", *given)
    found = command(folder, "identify", "markers.nc", "--rope", "markers-rope.toml", "--free", FREE, "-o", "identified")
    mass = 0.0625 * line.total_length
    truth = {
        "friction:shared": float(line.friction[1]) * mass / line.total_mass,
        "inertia:shared": float(line.inertia[0]) * mass / line.total_mass,
        "drag:shared": float(line.drag[0]) * mass / line.total_mass,
    }
    figures = json.loads((folder / "identified" / "identification.json").read_text())
    row: dict[str, Any] = {"seed": seed, "markers": markers, "grade": found.get("grade"), "doubts": tracked["doubts"]}
    for name, value in truth.items():
        low, high = (figures["intervals"][name][end] for end in ("low", "high"))
        row[name] = {"truth": value, "low": low, "high": high, "inside": low <= value <= high}
        row[name]["width"] = (high - low) / value
    return row | {"estimated": tracked["estimated"], "message": found.get("message", "")}


def command(folder: Path, *words: str) -> dict[str, Any]:
    """Run a command of hyperflex in a folder; return its JSON."""
    run = [sys.executable, "-m", "hyperflex", *words, "--json"]
    done = subprocess.run(run, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3, 5):
        raise RuntimeError(f"{' '.join(words)}: {done.stderr}")
    return dict(json.loads(done.stdout))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--markers", action="store_true", help=f"{MARKERS} markers on each rope")
    parser.add_argument("--out", default=str(RESULTS), help="JSON lines; -: none")
    given = parser.parse_args()
    rows = []
    for seed in range(given.seed, given.seed + given.count):
        with tempfile.TemporaryDirectory() as folder:
            begun = time.monotonic()
            rows.append(examine(seed, MARKERS if given.markers else 0, Path(folder)))
            rows[-1]["seconds"] = time.monotonic() - begun
        print(json.dumps(rows[-1]), flush=True)
        if given.out != "-":
            log.append(Path(given.out), rows[-1] | {"machine": machine.describe()})
    missed = {name: sum(not row[name]["inside"] for row in rows) for name in FREE.split(",")}
    widths = {name: float(np.median([row[name]["width"] for row in rows])) for name in missed}
    print(f"missed {missed} of {len(rows)}; median widths over the truth {widths}")
    return int(max(missed.values()) > 0.05 * len(rows))


if __name__ == "__main__":
    sys.exit(main())
