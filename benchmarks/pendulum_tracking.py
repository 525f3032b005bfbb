"""Real double pendulum: errors of predicted markers that were withheld from an estimator, through full rotations.

python -m benchmarks.pendulum_tracking --data FOLDER              both runs, three frame rates, three estimators
python -m benchmarks.pendulum_tracking --data FOLDER --quick      the first eighth of each run; writes nothing

FOLDER has run06_500Hz.csv and run16_500Hz.csv: t, x0, y0, x1, y1, x2, y2 in s and m, y up, made from the IBM
double-pendulum recordings (Asseman, Kornuta and Ozcan 2018, Learning beyond simulated physics; CDLA-Sharing-1.0).

A fifth of the samples and a tenth of the complete frames are withheld. The estimator's predictions for them are
compared with the measurements. The ratios of inertias are those of independent fits; friction, camera roll, position of
the pivot, lengths and positions of the markers are estimated with the state. The first second is omitted, because the
rates are unknown then.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.checks import Array
from hyperflex.estimate import EstimatedParameter, MovingHorizon, Observations, RopeFilter, smooth

RESULTS = Path(__file__).parent / "results"
RUNS, SAMPLED = (6, 16), 500  # Hz
ASKED = {50.0: 0.7e-3, 25.0: 1.3e-3, 12.5: 2.0e-3}  # m rms, by frames a second
NOISE = 0.25e-3  # m
SAMPLES, FRAMES = 0.2, 0.1  # withheld
SETTLED = 1.0  # s
LENGTHS = np.array([0.0917, 0.0701])  # m
INERTIA, MOMENT = np.array([0.0905, 0.00686]), 0.1019  # J/p1 of both links and p2/p1
FRICTION = (2.3e-3, 9.8e-4)  # over p1
SPREAD = {"friction": 0.5, "roll": 0.02, "length": 0.01} | dict.fromkeys(
    ("arc[0]", "arc[1]", "offset_x", "offset_y"), 5e-4
)
ESTIMATORS: dict[str, Callable[..., RopeFilter]] = {"filter": RopeFilter, "moving horizon": MovingHorizon}


class Recording(NamedTuple):
    """Times (T,), s, places (T, 2, 2) of joint and tip, m, and which are withheld (T, 2)."""

    t: Array
    places: Array
    withheld: Array

    def observations(self) -> list[Observations]:
        """The measurements that an estimator gets."""
        shown = np.where(self.withheld[:, :, None], np.nan, self.places)
        return [Observations(float(t), each, NOISE) for t, each in zip(self.t, shown, strict=True)]


def pendulum() -> hf.Rope:
    """The pendulum with p1 = 1 kg m: any mass of the second link gives the same motion."""
    mass, com = 2.9, 0.05
    first = (1.0 - LENGTHS[0] * mass) / com
    own = [INERTIA[0] - first * com**2 - mass * LENGTHS[0] ** 2, INERTIA[1] - MOMENT**2 / mass]
    return hf.Rope(length=LENGTHS, mass=[first, mass], com=[com, MOMENT / mass], inertia=own, friction=FRICTION)


def estimator(kind: Callable[..., RopeFilter]) -> Any:
    """An estimator that knows the pendulum approximately."""
    parameters = [EstimatedParameter(name, std) for name, std in SPREAD.items()]
    return kind(pendulum(), np.cumsum(LENGTHS), parameters=parameters)


def read(folder: Path, run: int, rate: float, duration: float, seed: int) -> Recording:
    """Read a run's first seconds at a frame rate, and withhold random samples except in the first frame."""
    table = np.loadtxt(folder / f"run{run:02d}_{SAMPLED}Hz.csv", delimiter=",", skiprows=1)
    table = table[table[:, 0] < duration][:: round(SAMPLED / rate)]
    rng = np.random.default_rng((seed, run))
    withheld = rng.random((len(table), 2)) < SAMPLES
    withheld[rng.random(len(table)) < FRAMES] = True
    withheld[0] = False
    return Recording(table[:, 0], table[:, 3:].reshape(-1, 2, 2), withheld)


def follow(tracker: RopeFilter, recording: Recording) -> tuple[Array, Array]:
    """Return errors (T, 2) of the markers, m, and their stated standard deviations, before any later measurement."""
    errors, stated = np.zeros(recording.withheld.shape), np.zeros(recording.withheld.shape)
    for k, seen in enumerate(recording.observations()):
        tracker.update(seen)
        places, wide = tracker.markers()
        errors[k] = np.linalg.norm(places - recording.places[k], axis=1)
        stated[k] = np.sqrt(np.trace(wide, axis1=1, axis2=2) + 2.0 * NOISE**2)
    return errors, stated


def counted(recording: Recording) -> Array:
    """Withheld markers (T, 2) after the first second."""
    return recording.withheld & (recording.t >= SETTLED)[:, None]


def rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors)))) if errors.size else np.nan


def measure(folder: Path, run: int, rate: float, duration: float, seed: int) -> list[dict[str, Any]]:
    """Rows of one recording at one rate."""
    recording = read(folder, run, rate, duration, seed)
    used, rows = counted(recording), []
    whole = used & recording.withheld.all(axis=1)[:, None]
    for name, kind in ESTIMATORS.items():
        begin = time.process_time()
        tracker = estimator(kind)
        errors, stated = follow(tracker, recording)
        took = (time.process_time() - begin) / recording.t.size
        rows.append(_row(name, errors, used, whole) | {"stated_mm": 1e3 * rms(stated[used]), "ms": 1e3 * took})
    begin = time.process_time()
    found = smooth(estimator(MovingHorizon), recording.observations())
    took = (time.process_time() - begin) / recording.t.size
    late = recording.t.size - len(found.states)
    errors = np.full(used.shape, np.nan)
    errors[late:] = np.linalg.norm(found.places - recording.places[late:], axis=2)
    rows.append(_row("smoother", errors, used, whole) | {"ms": 1e3 * took})
    return [{"run": run, "rate": rate, "seed": seed, **row} for row in rows]


def _row(name: str, errors: Array, used: Array, whole: Array) -> dict[str, Any]:
    used = used & np.isfinite(errors)
    found = {"withheld_mm": used, "samples_mm": used & ~whole, "frames_mm": used & whole}
    return {
        "estimator": name,
        **{key: 1e3 * rms(errors[which]) for key, which in found.items()},
        "greatest_mm": 1e3 * float(errors[used].max()),
        "count": int(used.sum()),
    }


def text(rows: list[dict[str, Any]]) -> str:
    """Results as Markdown."""
    heads = (
        "run",
        "frames/s",
        "estimator",
        "withheld",
        "single samples",
        "whole frames",
        "greatest",
        "asked",
        "ms a frame",
    )
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    settings = sorted({(row["run"], -row["rate"], list(_NAMES).index(row["estimator"])) for row in rows})
    for run, rate, which in settings:
        name = list(_NAMES)[which]
        same = [row for row in rows if (row["run"], row["rate"], row["estimator"]) == (run, -rate, name)]
        cells = [
            _range([row[key] for row in same]) for key in ("withheld_mm", "samples_mm", "frames_mm", "greatest_mm")
        ]
        cells += [f"{1e3 * ASKED[-rate]:g}", f"{np.median([row['ms'] for row in same]):.1f}"]
        lines.append(f"| {run:02d} | {-rate:g} | {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + (
        "\n\nWithheld markers: root mean square distance between predicted and measured positions, mm, least to "
        f"greatest of the random seeds of withheld samples ({SAMPLES:.0%} of the samples, and {FRAMES:.0%} of the "
        f"frames). The first {SETTLED:g} s are omitted. Filter and moving horizon predict before any later "
        "measurement; the smoother uses all other measurements. Times are processor times; that of the smoother "
        "includes the moving horizon, which precedes it."
    )


_NAMES = (*ESTIMATORS, "smoother")


def _range(values: list[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.2f}" if high - low < 5e-3 else f"{low:.2f}-{high:.2f}"


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    parser.add_argument("--seeds", type=int, default=2, help="number of random choices of withheld samples (2)")
    parser.add_argument("--quick", action="store_true", help="the first eighth of each run; writes nothing")
    options = parser.parse_args()
    about, rows = machine.describe(), []
    for rate in ASKED:
        for run in RUNS:
            for seed in range(1 if options.quick else options.seeds):
                rows += measure(options.data, run, rate, 4.5 if options.quick else np.inf, seed)
                print(*[f"{row['estimator']} {row['withheld_mm']:.2f} mm," for row in rows[-3:]], run, rate, flush=True)
    about["load after"] = machine.load()
    page = f"# Real double pendulum: withheld markers\n\n{text(rows)}\n\n{machine.sentence(about)}\n"
    print(page)
    if not options.quick:
        data = {"machine": about, "rows": rows}
        files.write_text(RESULTS / "pendulum-tracking.json", json.dumps(data, indent=1) + "\n")
        files.write_text(RESULTS / "pendulum-tracking.md", page)


if __name__ == "__main__":
    main()
