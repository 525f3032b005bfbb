"""A plain rope, filmed without markers, tracked and identified as in the tutorial: do intervals contain the truth?

python -m benchmarks.plain                      20 twins; to benchmarks/results/plain.jsonl and plain.md
python -m benchmarks.plain --count 2 --out -    short; writes nothing
python -m benchmarks.plain --markers            the same ropes with ten markers, for the widths
python -m benchmarks.plain --count 0            the page from the existing rows

Each twin is a uniform rope of 80 links, simulated with a tolerance of 1e-9 and filmed by the renderer for 10 s:
1280x720, 30 frames/s, compressed, with the noise of a phone; the camera is rolled by a few tenths of a degree. The
command line does the user's part: `hyperflex track` with a length and answers (clicks are off by a pixel), then
`hyperflex identify` with its first guess. With markers, the camera and its roll are known exactly.

The fitted model is a chain of 20 links. "Converted" is the result of `hf.with_links` for the finer rope: friction of
the same bending viscosity, inertia of straight links. "Best" is the result of the same fit to the exact positions of
the rope: long links differ from a smooth rope, and their inertia compensates a part of the difference, so the best
value is the true inertia of such a chain. Mass is unknown: friction, inertia and drag are compared relative to mass.
The exit code is 1 if an interval of friction or inertia misses the best value in more than one twin of 20.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log, machine
from numpy.typing import NDArray

import hyperflex as hf
from hyperflex import files
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.vision import Camera, Renderer, RopeMotion, Scene, srgb_tone

RESULTS = Path(__file__).parent / "results" / "plain.jsonl"
Array = NDArray[np.float64]
LINKS, FINE, COUNT, SECONDS, RATE = 20, 80, 20, 10.0, 30.0
SIZE, VIEW = (1280, 720), 4.5  # px; m, width of the picture
MARKERS = 10
FREE = ("friction", "inertia", "drag")
DENSITY = 0.0625  # kg/m, of the guess


def rope(rng: np.random.Generator) -> hf.Rope:
    """A rope of 1.4 to 2 m, 5 mm thick, 40 to 90 g/m, with 0.5 to 2 times the viscosity over mass of the paper's
    cable."""
    length = float(rng.uniform(1.4, 2.0))
    mass = float(rng.uniform(0.04, 0.09)) * length
    friction = float(np.exp(rng.uniform(-0.7, 0.7))) * 2e-5 * LINKS / length * mass / length / DENSITY
    line = hf.Rope.uniform(length, mass, LINKS, 0.0025, friction=friction, drag_coefficient=1.2)
    return hf.with_links(line, FINE)


def swing(line: hf.Rope, seed: int) -> RopeMotion:
    """A free swing from a bent shape."""
    rng, s = np.random.default_rng((seed, 1)), (np.arange(FINE) + 0.5) / FINE
    bend = 0.25 * rng.normal() * np.sin(np.pi * s) + 0.15 * rng.normal() * np.sin(2.0 * np.pi * s)
    t = np.arange(0.0, SECONDS + 0.1, 2e-3)
    return RopeMotion.from_trajectory(hf.simulate(line, duration=SECONDS + 0.1, q0=0.8 + bend, t_eval=t, tol=1e-9))


def film(motion: RopeMotion, arcs: Array, seed: int, path: Path) -> Camera:
    """Write the video; return the camera."""
    rng = np.random.default_rng((seed, 2))
    camera = Camera.facing(
        SIZE,
        pixels_per_metre=SIZE[0] / VIEW,
        origin=rng.uniform([560.0, 40.0], [720.0, 80.0]),
        roll=float(np.radians(rng.normal(0.0, 0.4))),
        exposure=0.002,
    )
    scene = Scene(arcs, marker_diameter=0.03, rope_width=0.005, tone=srgb_tone(), seed=seed)
    Renderer(camera, motion, scene).write(path, np.arange(round(SECONDS * RATE)) / RATE, quality=20)
    return camera


def examine(seed: int, markers: int, folder: Path) -> dict[str, Any]:
    """Film a twin, follow the tutorial, and compare."""
    rng = np.random.default_rng((seed, 0))
    line = rope(rng)
    length, motion = line.total_length, swing(line, seed)
    arcs = length * np.arange(1, markers + 1) / max(markers, 1)
    camera = film(motion, arcs, seed, folder / "phone.mp4")
    if markers:
        camera.write(folder / "camera.toml")
        guess = hf.Rope.uniform(length, DENSITY * length, LINKS, 0.0025, friction=4e-4, drag_coefficient=1.2)
        guess.to_toml(folder / "markers-rope.toml")
        given = ["--rope", "markers-rope.toml", "--camera", "camera.toml", "--changes", "none"]
        given += ["--arc-lengths", ",".join(f"{arc:.6g}" for arc in arcs)]
    else:
        pivot = camera.project([[0.0, 0.0]])[0] + rng.normal(0.0, 0.7, 2)
        given = ["--length", f"{length:.3f}", "--pivot", *(f"{each:.0f}" for each in pivot)]
        given += ["--tip", "found", "--size", "rope", "--mass", "unknown"]
    begun = spent()
    tracked = command(folder, "track", "phone.mp4", *given)
    how = ["--rope", "markers-rope.toml", "--free", ",".join(freed()), "-o", "identified"]
    found = command(folder, "identify", "markers.nc", *how)
    row = {"seed": seed, "markers": markers, "grade": found.get("grade"), "seconds": spent() - begun}
    row |= {"doubts": tracked["doubts"], "estimated": tracked["estimated"], "message": found.get("message", "")}
    figures = json.loads((folder / "identified" / "identification.json").read_text())
    row["findings"] = [each for each in figures["findings"] if each["severity"] in ("doubt", "wrong")]
    converted, fitted = hf.with_links(line, LINKS), best(motion, folder)
    ratio = hf.Rope.from_toml(folder / "markers-rope.toml").total_mass / line.total_mass
    for name in FREE:
        low, high = (figures["intervals"][f"{name}:shared"][end] for end in ("low", "high"))
        truth = float(getattr(converted, name)[1]) * ratio
        row[name] = {"converted": truth, "best": fitted[name], "low": low, "high": high}
    return row


def best(motion: RopeMotion, folder: Path) -> dict[str, float]:
    """Result of the same fit to the exact positions at the same times, with the same weights."""
    seen = hf.read_recording(folder / "markers.nc")
    arcs = np.asarray(files.read_netcdf(folder / "markers.nc").attributes["arc_lengths"])
    places = motion.places(seen.t, arcs)[:, :, :2].reshape(seen.data.shape)
    exact = hf.Recording(seen.t, np.where(np.isnan(seen.data), np.nan, places), kind="markers", noise=seen.noise)
    found = hf.identify(
        exact,
        hf.Rope.from_toml(folder / "identified" / "rope.toml"),
        freed(),
        setup=hf.RecordingSetup(arc_lengths=arcs, origin=(0.0, 0.0)),
        options=hf.FitOptions(intervals=None),
    )
    return {name: float(found.values[name][1]) for name in FREE}


def freed() -> list[str]:
    """Free parameters: the camera is level only to a few tenths of a degree."""
    return [*(f"{name}:shared" for name in FREE), "gravity_angle"]


def command(folder: Path, *words: str) -> dict[str, Any]:
    """Run a command of hyperflex in a folder; return its JSON."""
    run = [sys.executable, "-m", "hyperflex", *words, "--json"]
    done = subprocess.run(run, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3, 5):
        raise RuntimeError(f"{' '.join(words)}: {done.stderr}")
    return dict(json.loads(done.stdout))


def spent() -> float:
    """Processor time of the commands so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def summary(rows: list[log.Row]) -> list[str]:
    """Rows of a table: the number of twins whose interval contains the value, by number of markers and parameter."""
    held = "interval contains the best one | the converted one"
    lines = [f"| points | twins | value | {held} | width, median | best over converted |"]
    lines.append("|---" * 7 + "|")
    for markers, points in ((0, "curve, 12 places"), (MARKERS, f"{MARKERS} markers")):
        own = [row for row in rows if row["markers"] == markers]
        for name in FREE if own else ():
            each = {key: np.array([row[name][key] for row in own]) for key in own[0][name]}
            holds = {key: int(((each["low"] <= each[key]) & (each[key] <= each["high"])).sum()) for key in each}
            width = float(np.median((each["high"] - each["low"]) / each["best"]))
            ratio = np.sort(each["best"] / each["converted"])
            cells = [points, len(own), name, holds["best"], holds["converted"], f"{width:.1%}"]
            lines.append(f"| {' | '.join(map(str, cells))} | {ratio[0]:.2f} to {ratio[-1]:.2f} |")
    return lines


def main() -> int:
    """Run the twins, write a line for each, then the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--markers", action="store_true", help=f"{MARKERS} markers on each rope")
    parser.add_argument("--out", default=str(RESULTS), help="JSON lines; -: none")
    given = parser.parse_args()
    rows = [] if given.out == "-" else log.read(Path(given.out))
    for seed in range(given.seed, given.seed + given.count):
        with tempfile.TemporaryDirectory() as folder:
            rows.append(examine(seed, MARKERS if given.markers else 0, Path(folder)))
        rows[-1]["kernels"] = SOURCE_HASH
        print(json.dumps(rows[-1]), flush=True)
        if given.out != "-":
            log.append(Path(given.out), rows[-1])
    table = summary(rows)
    print("\n".join(table))
    if given.out != "-":
        files.write_text(Path(given.out).with_suffix(".md"), page(rows, table))
    own = [row for row in rows if not row["markers"]]
    missed = [sum(not row[name]["low"] <= row[name]["best"] <= row[name]["high"] for row in own) for name in FREE[:2]]
    return int(max(missed) > 0.05 * len(own))


def page(rows: list[log.Row], table: list[str]) -> str:
    """The results as Markdown."""
    what = " ".join("\n\n".join(str(__doc__).split("\n\n")[2:]).split())
    lines = ["# A plain rope from a video and a length", "", what, "", *table, ""]
    lines += [
        "| seed | markers | grade | doubts in the identification | processor, s | readout found, ms |",
        "|---" * 6 + "|",
    ]
    for row in rows:
        kinds = ", ".join(each["kind"] for each in row["findings"]) or "-"
        readout = row["estimated"].get("readout")
        late = f"{1e3 * readout['value']:.1f}" if readout else "-"
        cells = [row["seed"], row["markers"], row["grade"], kinds, round(row["seconds"]), late]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines += ["", "All rows of a picture are exposed at the same time, so a readout time other than 0 is an error.", ""]
    return "\n".join([*lines, f"{log.made(rows)} {machine.sentence(machine.describe())}\n"])


if __name__ == "__main__":
    sys.exit(main())
