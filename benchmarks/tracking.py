"""Consistency of a rope's filter, its tests for changes, and slightly wrong parameters.

python -m benchmarks.tracking consistency 100    100 runs of each kind: a right model, and a rope of 100 links
python -m benchmarks.tracking changes 10         touches and masses at the tip, 10 of each kind
python -m benchmarks.tracking false-alarms 60    an hour of a rope of 100 links
python -m benchmarks.tracking starts 1000        starts with a length 1 % off, 20 links
python -m benchmarks.tracking friction 20        joint friction, compared with the Cramer-Rao bound
python -m benchmarks.tracking page               the page from the existing rows

10 markers in metres (noise 1.5 mm), 30 frames/s, known identities; the filter has 50 links. All data are simulated.
Each run adds a line to benchmarks/results/tracking.jsonl (--out); on one core a run takes 5 to 15 s.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log, machine
from scipy import stats

from hyperflex import files
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.estimate import ChangeTests, EstimatedParameter, Observations, RopeFilter, square_root
from tests.estimate.runs import (
    ARM,
    FINE,
    LENGTH,
    RATE,
    SWINGS,
    Tracked,
    Truth,
    disturbed,
    friction_bound,
    rope,
    seen_errors,
    track,
)

RESULTS = Path(__file__).parent / "results"
LINKS, FRAMES, NOISE = 50, 30.0, 0.0015
DENSITY = (0.5, 1.0)  # rad/s^2 per square root of Hz, disturbances of the runs in which the model is right
# of a marker's noise (in 0.1 s, of velocities), added to covariances, which vanish along a taut rope: second-order
# errors, and the difference between links of 4 cm and of 2 cm
FLOOR, FINE_FLOOR = 0.005, 0.02
QUIET = 0.02  # rad/s^2 per square root of Hz, first guess of a filter that expects little disturbance
SINCE = 1.0  # s, from which errors count
NAMES = ("places", "velocities", "tip", "tip velocity")
Row = dict[str, Any]


def bounds(truth: Truth, moved: bool, density: tuple[float, float]) -> dict[str, float]:
    """Posterior Cramer-Rao bound (Tichavsky et al. 1998) of a run: rms after `SINCE`, SI units.

    With disturbances that enter linearly it is the covariance of the filter whose derivatives are taken at the truth.
    """
    arcs, n = np.linspace(LENGTH / 10, LENGTH, 10), truth.q.shape[1]
    ends, rows = np.linspace(0.0, LENGTH, n + 1), np.zeros(10)
    at = RopeFilter(rope(n), arcs, motion=SWINGS if moved else None, arm=ARM if moved else None)
    squares: dict[str, list[float]] = {name: [] for name in NAMES}
    first = int(0.1 * RATE)
    frames = range(first, truth.t.size - first, round(RATE / FRAMES))
    places = np.stack([np.interp(arcs, ends, truth.joints[first, :, c]) for c in range(2)], axis=1)
    at.update(Observations(float(truth.t[first]), places, NOISE))
    for last, i in pairwise(frames):
        begin, t = float(truth.t[last]), float(truth.t[i])
        found = at.process.predict(np.concatenate([truth.q[last], truth.qd[last]]), begin, t)
        at.t, at.x = t, np.concatenate([truth.q[i], truth.qd[i]])
        rows_since = [at.factor @ found.transition.T, at.process.noise(t - begin, density)]
        at.factor = square_root.triangular(np.concatenate(rows_since))
        slope = at.model.predict(at.x, at.process.base(t), rows)[1].reshape(20, -1)
        across, upper = square_root.innovation_factor(at.factor, slope / NOISE)
        at.factor = square_root.updated(at.factor, across, upper)
        if t >= SINCE:
            for name, (_, covariance) in seen_errors(at, arcs, ends, np.zeros((n + 1, 4))).items():
                squares[name].append(float(np.trace(covariance, axis1=-2, axis2=-1).mean()))
    return {name: float(np.sqrt(np.mean(each))) for name, each in squares.items()}


def consistency(seed: int) -> Iterator[Row]:
    """One run of each kind: free and pumped, with a right model (and the assumed disturbances) and a finer truth."""
    for moved in (False, True):
        for right in (True, False):
            truth = disturbed(
                moved=moved, n=LINKS if right else FINE, noise=DENSITY if right else (), seed=seed, duration=8.0
            )
            found = track(truth, frames=FRAMES, noise=NOISE, moved=moved, seed=seed, seen=True)
            row: Row = {
                "kind": "consistency",
                "moved": moved,
                "right": right,
                "seed": seed,
                **statistics(found, FLOOR if right else FINE_FLOOR),
            }
            if right and seed < 20:
                row["bound"] = bounds(truth, moved, DENSITY)
            yield row


def statistics(found: Tracked, floor_part: float) -> Row:
    """Mean NEES over dimension, coverage of the 90 % regions, rms, and whiteness of the innovations."""
    row: Row = {}
    late = [k for k, t in enumerate(found.t) if t >= SINCE]
    for name in NAMES:
        error, covariance = (np.array([found.seen[k][name][i] for k in late]) for i in (0, 1))
        floor = (floor_part * NOISE * (10.0 if "velocit" in name else 1.0)) ** 2 * np.eye(2)
        nees = np.einsum("fkc,fkc->fk", error, np.linalg.solve(covariance + floor, error[..., None])[..., 0])
        row[name] = {
            "nees": float(nees.mean() / 2.0),
            "held": float((nees < stats.chi2.ppf(0.9, 2)).mean()),
            "rms": float(np.sqrt((error**2).sum(axis=-1).mean())),
            "stated": float(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1).mean())),
        }
    white = [each for k, each in enumerate(found.whitened) if found.t[k] >= SINCE and each.size == 20]
    z = np.array(white)
    pairs = (z[1:] * z[:-1]).sum(axis=1)  # of unit variance times 20 if white
    return {
        **row,
        "nis": float((z**2).mean()),
        "lag 1": float(pairs.mean() / 20.0),
        "lag 1 std": float(1.0 / np.sqrt(20.0 * len(pairs))),
        "process": found.tracker.process_noise.value.tolist(),
        "measurement": found.tracker.measurement_noise.value,
    }


HAPPENINGS: dict[str, Row] = {
    "5 g, cast": {"moved": True, "tip_mass": 5e-3},
    "5 g, free swing": {"moved": False, "tip_mass": 5e-3},
    "0.2 N for 0.1 s, cast": {"moved": True, "force": 0.2},
    "0.2 N for 0.1 s, free swing": {"moved": False, "force": 0.2},
    "0.02 N for 0.1 s, cast": {"moved": True, "force": 0.02},
    "0.02 N for 0.1 s, free swing": {"moved": False, "force": 0.02},
    "0.02 N for 0.5 s, cast": {"moved": True, "force": 0.02, "lasting": 0.5},
    "0.02 N for 0.5 s, free swing": {"moved": False, "force": 0.02, "lasting": 0.5},
}


def changes(seed: int) -> Iterator[Row]:
    """Detected changes, their delays and names; then the estimate of a mass at the tip 5 s later."""
    rng = np.random.default_rng((seed, 5))
    for name, what in HAPPENINGS.items():
        moved, at = what["moved"], float(rng.uniform(3.0, 6.0) if what["moved"] else rng.uniform(2.5, 4.0))
        at = round(at * RATE) / RATE
        touch = None
        if "force" in what:
            arc = float(rng.uniform(0.2, 1.0) * LENGTH)
            before = disturbed(moved=moved, duration=at, at=at, seed=seed)
            angle = float(before.q[-1][min(int(arc / LENGTH * FINE), FINE - 1)])  # it pushes across the rope
            push = rng.choice([-1.0, 1.0]) * what["force"] * np.array([np.cos(angle), np.sin(angle)])
            touch = (arc, float(push[0]), float(push[1]), what.get("lasting", 0.1))
        mass = what.get("tip_mass", 0.0)
        after = 5.2 if mass else 1.2
        truth = disturbed(moved=moved, duration=at + after, at=at, tip_mass=mass, touch=touch, seed=seed)
        found = track(truth, frames=FRAMES, noise=NOISE, moved=moved, seed=seed, tests=ChangeTests())
        wanted = "tip_mass" if mass else "touch"
        true = [change for change in found.changes if change.noticed > at]
        row: Row = {"kind": "changes", "what": name, "seed": seed, "early": len(found.changes) - len(true)}
        row["after"] = true[0].noticed - at if true else None
        row["named"] = true[0].name if true else None
        row["right after"] = next((each.noticed - at for each in true if each.name == wanted), None)
        row["all"] = [str(change) for change in found.changes]
        if mass:
            value, std = found.tracker.values.get("tip_mass", (0.0, 0.0))
            row |= {"value": value, "std": std}
        elif true and true[0].arc_length is not None and touch is not None:
            row["off"] = abs(true[0].arc_length - touch[0])
            row["along"] = touch[1:3]
        yield row


def false_alarms(seed: int) -> Iterator[Row]:
    """A minute of a finer rope without changes: a free swing of half a minute, and three casts."""
    for k in range(4):
        moved = k > 0
        truth = disturbed(moved=moved, duration=10.4 if moved else 30.4, at=1.0, seed=4 * seed + k)
        tests = ChangeTests()
        found = track(truth, frames=FRAMES, noise=NOISE, moved=moved, seed=4 * seed + k, tests=tests)
        yield {
            "kind": "false alarms",
            "moved": moved,
            "seed": 4 * seed + k,
            "tested": found.t[-1] - found.t[0] - 1.0,
            "all": [str(change) for change in found.changes],
            "tip": found.rms("tip"),
            "largest bend": float(np.abs(np.diff(truth.q[60:], axis=1)).max()),
        }


def starts(seed: int) -> Iterator[Row]:
    """A length 1 % off, from a random shape: whether the filter stays finite, and its errors after 5 s."""
    rng = np.random.default_rng((seed, 11))
    moved, long = bool(seed % 2), seed % 20 < 2  # two in twenty are followed for 5 s
    scale, n, frames = (
        (1.01 if rng.random() < 0.5 else 0.99),
        20,
        FRAMES if long else float(rng.choice([7.5, 15.0, 30.0])),
    )
    truth = disturbed(moved=moved, n=40, duration=6.2 if long else 1.4, at=0.1, seed=seed)
    parameters = [EstimatedParameter("length", 0.01)]
    found = track(truth, n=n, frames=frames, noise=1e-3, scale=scale, parameters=parameters, moved=moved, seed=seed)
    value, std = found.tracker.values["length"]
    finite = bool(np.isfinite(found.tracker.x).all() and np.isfinite(np.array(found.tip)).all())
    yield {
        "kind": "starts",
        "moved": moved,
        "long": long,
        "seed": seed,
        "finite": finite,
        "error": (1.0 + value) * scale - 1.0,
        "std": std,
        "tip": found.rms("tip", found.t[-1] - 0.5),
    }


def friction(seed: int) -> Iterator[Row]:
    """Joint friction from 5 s of a rope with the links of the filter, and the lower bound of its error."""
    for moved in (False, True):
        truth = disturbed(moved=moved, n=LINKS, duration=5.2, at=0.1, seed=seed)
        parameters = [EstimatedParameter("friction", 0.5)]
        found = track(
            truth,
            frames=FRAMES,
            noise=NOISE,
            parameters=parameters,
            moved=moved,
            seed=seed,
            process_noise=QUIET,
        )
        value, std = found.tracker.values["friction"]
        yield {
            "kind": "friction",
            "moved": moved,
            "seed": seed,
            "error": value,
            "std": std,
            "bound": friction_bound(truth, moved, NOISE),
        }


PARTS: dict[str, Callable[[int], Iterator[Row]]] = {
    "consistency": consistency,
    "changes": changes,
    "false-alarms": false_alarms,
    "starts": starts,
    "friction": friction,
}


def page(found: list[Row]) -> str:
    """The results as Markdown."""
    of: dict[str, list[Row]] = {}
    for row in found:
        of.setdefault(row["kind"], []).append(row)
    words = (
        f"A rope of 2 m, 10 markers in metres with {1e3 * NOISE:g} mm of noise, {FRAMES:g} frames/s, a filter of "
        f"{LINKS} links; free swings of 1.2 m, and casts (the arm swings to and fro). A finer truth has {FINE} links. "
        "Simulated."
    )
    lines = ["# Tracking: consistency of the filter, and detected changes", "", words]
    for kind, write in PAGES.items():
        if kind in of:
            lines += ["", *write(of[kind])]
    kernels = ", ".join(sorted({row["kernels"] for row in found}))
    lines += ["", f"Kernels: {kernels}. {machine.sentence(machine.describe())}", ""]
    return "\n".join(lines)


def consistency_page(found: list[Row]) -> list[str]:
    words = (
        "Right model: disturbances as the filter assumes them; it estimates their size. NEES over dimension, share of "
        "the frames in which the stated 90 % regions contain the truth, and rms over the posterior Cramer-Rao bound, "
        f"after {SINCE:g} s of 8 s. The square of {FLOOR:g} ({FINE_FLOOR:g} with the finer truth) of a marker's noise "
        "is added to each covariance, divided by 0.1 s for velocities: covariances vanish along a taut rope, and "
        "links of 4 cm differ by that much from links of 2 cm."
    )
    lines = [
        "## Consistency",
        "",
        words,
        "",
        "| truth | runs | " + " | ".join(f"{name}: NEES, coverage, over bound" for name in NAMES) + " | NIS | lag 1 |",
        "|---" * (4 + len(NAMES)) + "|",
    ]
    for right in (True, False):
        for moved in (False, True):
            those = [row for row in found if row["moved"] == moved and row["right"] == right]
            if not those:
                continue
            cells = []
            for name in NAMES:
                nees, held = (np.mean([row[name][key] for row in those]) for key in ("nees", "held"))
                bounded = [row for row in those if "bound" in row]
                rms = sum(row[name]["rms"] ** 2 for row in bounded)
                ratio = f"{np.sqrt(rms / sum(row['bound'][name] ** 2 for row in bounded)):.2f}" if bounded else "-"
                cells.append(f"{nees:.2f}, {100.0 * held:.1f} %, {ratio}")
            what = f"{'right model' if right else 'finer'}, {'casts' if moved else 'free swings'}"
            lag, std = np.mean([row["lag 1"] for row in those]), those[0]["lag 1 std"] / np.sqrt(len(those))
            white = f"{np.mean([row['nis'] for row in those]):.3f} | {lag:.4f} ± {std:.4f}"
            lines.append(f"| {what} | {len(those)} | {' | '.join(cells)} | {white} |")
    return lines


def changes_page(found: list[Row]) -> list[str]:
    lines = [
        "## Changes",
        "",
        "Touches push across the rope, at random positions and times. Tests may give one false alarm in 600 s.",
        "",
        "| change | runs | detected | delay, s: median, longest | delay of the right name, s: median, longest |",
        "|---|---|---|---|---|",
    ]
    for what in HAPPENINGS:
        those = [row for row in found if row["what"] == what]
        after, right = ([row[key] for row in those if row[key] is not None] for key in ("after", "right after"))
        if after and right:
            cells = [f"{np.median(each):.2f}, {max(each):.2f}" for each in (after, right)]
            lines.append(f"| {what} | {len(those)} | {len(after)} | {cells[0]} | {cells[1]} |")
    masses = [row for row in found if "value" in row]
    if masses:
        error = np.array([row["value"] - 5e-3 for row in masses])
        rms, worst = 1e3 * np.sqrt((error**2).mean()), 1e3 * np.abs(error).max()
        lines += ["", f"Error of the estimated mass 5 s later: {rms:.2f} g rms, {worst:.2f} g at most, of 5 g."]
    return lines


def false_alarms_page(found: list[Row]) -> list[str]:
    tested, count = sum(row["tested"] for row in found), sum(len(row["all"]) for row in found)
    bend = max(row["largest bend"] for row in found)
    words = (
        f"{count} in {tested / 60.0:.1f} minutes of the finer truth without changes (one in 10 minutes is allowed). It "
        f"bends by up to {bend:.2f} rad between links."
    )
    return ["## False alarms", "", words]


def starts_page(found: list[Row]) -> list[str]:
    long = np.array([row["error"] for row in found if row["long"]])
    short = [row["tip"] for row in found]
    words = (
        f"{len(found)} starts of 20 links (truth 40), 1 mm of noise, 7.5, 15 or 30 frames/s, from random shapes: "
        f"{sum(not row['finite'] for row in found)} not finite; final tip error {1e3 * np.median(short):.2f} mm "
        f"(median), {1e3 * max(short):.1f} mm at most."
    )
    if long.size:
        words += f" After 6 s ({long.size} of them) the length is off by {1e2 * np.abs(long).max():.3f} % at most."
    return ["## A length 1 % off", "", words]


def friction_page(found: list[Row]) -> list[str]:
    words = (
        "Relative error with a right model, without disturbances. The Cramer-Rao bound starts from the filter's prior. "
        f"The filter expects friction to 50 % and initial disturbances of {QUIET:g} rad/s^2/sqrt(Hz) (1 by default): "
        "information lost while it learns that there are none cannot be recovered."
    )
    lines = ["## Joint friction in 5 s", "", words, "", "| | runs | rms | stated | bound | rms over bound |"]
    lines.append("|---|---|---|---|---|---|")
    for moved in (False, True):
        those = [row for row in found if row["moved"] == moved]
        if those:
            rms = float(np.sqrt(np.mean([row["error"] ** 2 for row in those])))
            std, bound = (float(np.mean([row[key] for row in those])) for key in ("std", "bound"))
            what = "casts" if moved else "free swings"
            lines.append(f"| {what} | {len(those)} | {rms:.4f} | {std:.4f} | {bound:.4f} | {rms / bound:.2f} |")
    return lines


PAGES: dict[str, Callable[[list[Row]], list[str]]] = {
    "consistency": consistency_page,
    "changes": changes_page,
    "false alarms": false_alarms_page,
    "starts": starts_page,
    "friction": friction_page,
}


def main() -> None:
    """Run, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=[*PARTS, "page"])
    parser.add_argument("count", nargs="?", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--out", type=Path, default=RESULTS / "tracking.jsonl")
    options = parser.parse_args()
    if options.part == "page":
        files.write_text(options.out.with_suffix(".md"), page(log.read(options.out)))
        return
    for seed in range(options.first, options.first + options.count):
        begin = time.process_time()
        for row in PARTS[options.part](seed):
            log.append(options.out, row | {"kernels": SOURCE_HASH, "seconds": round(time.process_time() - begin, 2)})
            begin = time.process_time()


if __name__ == "__main__":
    main()
