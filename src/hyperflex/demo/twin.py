"""The demo's recording: a finer rope than the one that is fitted to it, simulated and seen by a noisy camera."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.identification import Identification, identify
from hyperflex.model import Rope
from hyperflex.recording import Recording, read_recording
from hyperflex.simulation import simulate

LENGTH, MASS, RADIUS = 2.0, 0.125, 0.0025  # m, kg, m: as the paper's cable
FINE, COARSE = 40, 10  # links of the rope that made the data, and of the one that is fitted
BENDING_FRICTION = 1e-4  # N m^2 s, joint friction times link length; between the paper's cable and its other rope
RATE, SECONDS = 30.0, 10.0  # frames a second, s
NOISE = 3e-3  # m, of each coordinate of a marker
LOST = 0.01  # part of the marker sightings that the camera misses
SEED = 2007
NAME = "demo swing (simulated)"
TRAIN, WINDOW = 7.0, 3.5  # s, fitted part of the recording and length of its windows
FREE = ("friction:shared", "inertia:shared")
BUNDLED = Path(__file__).parent / "data" / "demo_swing.csv"
MAPPED = Path(__file__).parent / "data" / "demo_mapped.toml"


def friction(n_links: int) -> Array:
    """Return the joint friction (n,) of the rope cut into `n_links`, N m s/rad.

    A joint stands for the bending of one link length; a coarse joint does the work of several fine ones in series and
    so has less friction. The first joint is the eye that the rope hangs from: the same in every cut.
    """
    result = np.full(n_links, BENDING_FRICTION * n_links / LENGTH)
    result[0] = BENDING_FRICTION * COARSE / LENGTH
    return result


def fine_rope() -> Rope:
    """Return the rope that makes the data: 40 links."""
    return Rope.uniform(LENGTH, MASS, FINE, RADIUS, name="demo rope, 40 links").replace(friction=friction(FINE))


def coarse_rope() -> Rope:
    """Return the same rope simply cut into 10 links, with the cylinder's inertia."""
    return Rope.uniform(LENGTH, MASS, COARSE, RADIUS, name="demo rope, 10 links").replace(friction=friction(COARSE))


def guess() -> Rope:
    """Return what the demo starts from: right length and mass, three times the friction."""
    return coarse_rope().replace(friction=3.0 * friction(COARSE), name="demo guess")


def record(*, noise: float = NOISE, lost: float = LOST, rate: float = RATE) -> Recording:
    """Simulate the fine rope's free swing and look at it as a camera would.

    `noise` is the standard deviation of each marker coordinate, m, `lost` the part of the sightings that are missing,
    and `rate` in frames per second. The markers are at the joints of the coarse chain.
    """
    t = np.arange(round(SECONDS * rate) + 1) / rate
    along = (np.arange(FINE) + 0.5) / FINE
    run = simulate(fine_rope(), duration=t[-1], t_eval=t, q0=0.9 + 0.5 * along, tol=1e-9)
    markers = run.joints[:, :: FINE // COARSE].copy()
    rng = np.random.default_rng(SEED)
    markers += noise * rng.standard_normal(markers.shape)
    markers[rng.uniform(size=markers.shape[:2]) < lost] = np.nan
    return Recording(
        t,
        markers.reshape(t.size, -1),
        kind="markers",
        noise=noise if noise > 0.0 else None,  # type: ignore[arg-type]
        name=NAME,
        source=f"simulated: {FINE} links, {1e3 * noise:g} mm of noise, {100 * lost:g} % of the sightings lost",
    )


def fit(recording: Recording) -> Identification:
    """Identify friction and inertia of the 10-link chain from a recording, as the demo does it."""
    return identify(recording, guess(), FREE, train=TRAIN, window=WINDOW)


def write_bundled(recording_path: Path = BUNDLED, mapped_path: Path = MAPPED) -> None:
    """Make the files that come with the package: the recording and its mapped truth.

    The mapped truth is what the same fit finds in a recording of the same swing without noise and gaps: the best that
    10 links can do for a rope of 40. It differs from the rope simply cut into 10 links, because coarse links need more
    inertia and friction to move alike.
    """
    recording = record()
    notes = {"name": recording.name, "source": recording.source, "time_unit": "s", "unit": "m", "y_axis": "up"}
    table = np.column_stack([np.round(recording.t, 6), np.round(recording.data, 5)])
    files.write_table(recording_path, ["t", *recording.channels], table, notes=notes)
    found = fit(record(noise=0.0, lost=0.0)).values
    mapped = {name: float(values[0]) for name, values in found.items()}
    about = "what the demo's fit finds without noise and gaps; made by hyperflex.demo.twin.write_bundled"
    files.write_toml(mapped_path, {"source": "simulated", "about": about, "mapped": mapped})


def bundled() -> Recording:
    """Read the recording that comes with the package."""
    return replace(read_recording(BUNDLED, noise=NOISE, name=NAME), source=files.read_notes(BUNDLED)["source"])


def mapped_truth() -> dict[str, float]:
    """Read the mapped truth that comes with the package: one value of friction and inertia for all links, SI."""
    return {name: float(value) for name, value in files.read_toml(MAPPED)["mapped"].items()}
