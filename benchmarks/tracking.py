"""How a rope's filter keeps what it says: consistency, tests for changes, and parameters that are wrong by a little.

python -m benchmarks.tracking consistency 100    100 runs of each kind: the model right, and a rope of 100 links
python -m benchmarks.tracking changes 10         touches and masses at the tip, 10 of each kind
python -m benchmarks.tracking false-alarms 60    an hour of a rope of 100 links
python -m benchmarks.tracking starts 1000        starts with a length 1 % off, 20 links
python -m benchmarks.tracking friction 20        joint friction, beside the Cramer-Rao bound
python -m benchmarks.tracking page               the page from what there is

Markers in metres (10, 1.5 mm off), 30 frames/s, and which is which is known; the filter has 50 links. All data are
simulated. Each run adds a line to benchmarks/results/tracking.jsonl (--out); on one core a run takes 5 to 15 s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log, machine
from scipy import stats

import hyperflex as hf
from hyperflex import files
from hyperflex.checks import Array
from hyperflex.core.jit import SOURCE_HASH
from hyperflex.estimate import ChangeTests, EstimatedParameter, RopeFilter
from tests.estimate.runs import FINE, LENGTH, RATE, Tracked, Truth, disturbed, rope, track

RESULTS = Path(__file__).parent / "results"
LINKS, FRAMES, NOISE = 50, 30.0, 0.0015
DENSITY = (0.5, 1.0)  # rad/s^2 per square root of Hz, disturbances of the runs in which the model is right
# of a marker's noise (in 0.1 s, of velocities), added to covariances, which vanish along a taut rope: what is of second
# order in the errors, and by how much links of 4 cm differ from those of 2 cm
FLOOR, FINE_FLOOR = 0.005, 0.02
SINCE = 1.0  # s, from which errors count
NAMES = ("places", "velocities", "tip", "tip velocity")
Row = dict[str, Any]


def bounds(truth: Truth, moved: bool, density: tuple[float, float]) -> dict[str, float]:
    """Posterior Cramer-Rao bound (Tichavsky et al. 1998) of a run: rms of what is seen after `SINCE`, SI units.

    With disturbances that enter linearly it is the covariance of the filter whose derivatives are taken at the truth.
    """
    from hyperflex.estimate import square_root as sr
    from tests.estimate.runs import ARM, SWINGS, _seen

    arcs, n = np.linspace(LENGTH / 10, LENGTH, 10), truth.q.shape[1]
    ends = np.linspace(0.0, LENGTH, n + 1)
    base = {"motion": SWINGS, "arm": ARM} if moved else {}
    at = RopeFilter(rope(n), arcs, **base)  # type: ignore[arg-type]
    squares: dict[str, list[float]] = {name: [] for name in NAMES}
    rows = np.zeros(10)
    first = int(0.1 * RATE)
    for i in range(first, truth.t.size - first, round(RATE / FRAMES)):
        t, x = float(truth.t[i]), np.concatenate([truth.q[i], truth.qd[i]])
        if at.t is None:
            from hyperflex.estimate import Observations

            places = np.stack([np.interp(arcs, ends, truth.joints[i, :, c]) for c in range(2)], axis=1)
            at.update(Observations(t, places, NOISE))
        else:
            found = at.process.predict(before, at.t, t)
            at.factor = sr.predicted(at.factor, found.transition, at.process.noise(t - at.t, density))
            at.t, at.x = t, x
            slope = at.model.predict(x, at.process.base(t), rows)[1].reshape(20, -1)
            at.factor = sr.updated(at.factor, slope, np.full(20, NOISE))
        before = x
        if t >= SINCE:
            for name, (_, covariance) in _seen(at, arcs, ends, np.zeros((n + 1, 4))).items():
                squares[name].append(float(np.trace(covariance, axis1=-2, axis2=-1).mean()))
    return {name: float(np.sqrt(np.mean(each))) for name, each in squares.items()}


def consistency(seed: int) -> Iterator[Row]:
    """One run of each kind: free and pumped, the model right (with disturbances that it assumes) and a finer truth."""
    for moved in (False, True):
        for right in (True, False):
            truth = disturbed(
                moved=moved, n=LINKS if right else FINE, noise=DENSITY if right else (), seed=seed, duration=8.0
            )
            found = track(truth, frames=FRAMES, noise=NOISE, moved=moved, seed=seed, seen=True)
            row: Row = {"kind": "consistency", "moved": moved, "right": right, "seed": seed, **judged(found, FLOOR if right else FINE_FLOOR)}
            if right and seed < 20:
                row["bound"] = bounds(truth, moved, DENSITY)
            yield row


def judged(found: Tracked, floor_part: float) -> Row:
    """Mean NEES over dimension, part of the 90 % regions that hold, rms, and whiteness of the innovations."""
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
    """What is noticed, when, and as what; then the estimate of a mass at the tip 5 s later."""
    rng = np.random.default_rng((seed, 5))
    for name, what in HAPPENINGS.items():
        moved, at = what["moved"], float(rng.uniform(3.0, 6.0) if what["moved"] else rng.uniform(2.5, 4.0))
        at = round(at * RATE) / RATE
        touch = None
        if "force" in what:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            push = what["force"] * np.array([np.cos(angle), np.sin(angle)])
            touch = (float(rng.uniform(0.2, 1.0) * LENGTH), float(push[0]), float(push[1]), what.get("lasting", 0.1))
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
    """A minute of a finer rope to which nothing happens: a free swing of half a minute, and three casts."""
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
    """A length 1 % off, from a random shape: does it stay finite, and where is it after 5 s."""
    rng = np.random.default_rng((seed, 11))
    moved, long = bool(seed % 2), seed % 20 < 2  # two in twenty are followed for 5 s
    scale, n, frames = (1.01 if rng.random() < 0.5 else 0.99), 20, FRAMES if long else float(rng.choice([7.5, 15.0, 30.0]))
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
    """Joint friction from 5 s of a rope of as many links as the filter, beside what any estimate could be off by."""
    for moved in (False, True):
        truth = disturbed(moved=moved, n=LINKS, duration=5.2, at=0.1, seed=seed)
        parameters = [EstimatedParameter("friction", 3.0)]
        found = track(truth, frames=FRAMES, noise=NOISE, parameters=parameters, moved=moved, seed=seed)
        value, std = found.tracker.values["friction"]
        yield {
            "kind": "friction",
            "moved": moved,
            "seed": seed,
            "error": value,
            "std": std,
            "bound": friction_bound(truth, moved),
        }


def friction_bound(truth: Truth, moved: bool, noise: float = NOISE) -> float:
    """Cramer-Rao bound of the relative friction, the start being unknown but for the filter's own prior."""
    from tests.estimate.runs import ARM, SWINGS

    n, cable = truth.q.shape[1], rope(truth.q.shape[1])
    first = int(0.1 * RATE)
    at = np.arange(first, truth.t.size - first, round(RATE / FRAMES))
    places, by_friction = marker_sensitivities(truth, cable, at, moved, SWINGS, ARM)
    prior = RopeFilter(cable, np.linspace(0.2, LENGTH, 10))
    prior.process_noise.value = 0.0
    jacobian = np.concatenate([places, by_friction[:, None]], axis=1) / noise
    information = jacobian.T @ jacobian
    information[: 2 * n, : 2 * n] += start_information(cable)
    information[-1, -1] += 1.0 / 3.0**2
    left = information[-1, -1] - information[-1, :-1] @ np.linalg.solve(information[:-1, :-1], information[:-1, -1])
    return float(1.0 / np.sqrt(left))


def marker_sensitivities(
    truth: Truth, cable: hf.Rope, at: Array, moved: bool, motion: hf.Motion, arm: hf.Arm
) -> tuple[Array, Array]:
    """Derivatives of the markers' places (20 T, 2 n) by the state at the first frame, and (20 T,) by the friction."""
    from hyperflex.estimate.observations import lever_arms
    from hyperflex.simulation.sensitivity.sensitivity import AngleJacobian

    n = cable.n_links
    setup = hf.Setup(cable, motion if moved else None, arm if moved else None, tol=1e-6)
    run = AngleJacobian(setup, ["q0", "qd0", {"friction": {"friction": cable.friction}}])
    q, _, dq, _ = run(truth.t[at], truth.q[at[0]].copy(), truth.qd[at[0]].copy())
    arms = lever_arms(cable, np.linspace(LENGTH / 10, LENGTH, 10))[1]
    slope = arms[None, :, None, :] * np.stack([np.cos(q), np.sin(q)], axis=1)[:, None]  # (T, K, 2, n)
    moves = np.matmul(slope.reshape(len(at), -1, n), dq).reshape(-1, 2 * n + 1)
    return moves[:, :-1], moves[:, -1]


def start_information(cable: hf.Rope) -> Array:
    """Information (2 n, 2 n) of a filter's prior of the first shape and its rates."""
    from hyperflex.estimate import filter as f
    from hyperflex.estimate.process import smooth_shapes

    shapes, n = smooth_shapes(cable, f.START_CORRELATION), cable.n_links
    result = np.zeros((2 * n, 2 * n))
    for k, size in enumerate((f.BEND, f.SPEED * np.sqrt(9.81 / LENGTH))):
        covariance = size**2 * (shapes.T @ shapes + 0.01 * np.eye(n))
        result[k * n : (k + 1) * n, k * n : (k + 1) * n] = np.linalg.inv(covariance)
    return result


PARTS: dict[str, Callable[[int], Iterator[Row]]] = {
    "consistency": consistency,
    "changes": changes,
    "false-alarms": false_alarms,
    "starts": starts,
    "friction": friction,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=[*PARTS, "page"])
    parser.add_argument("count", nargs="?", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS / "tracking.jsonl")
    given = parser.parse_args()
    if given.part == "page":
        page(log.read(given.out))
        return
    for seed in range(given.first, given.first + given.count):
        begin = time.process_time()
        for row in PARTS[given.part](seed):
            row |= {"kernels": SOURCE_HASH, "seconds taken": round(time.process_time() - begin, 2)}
            log.append(given.out, row)
            begin = time.process_time()


if __name__ == "__main__":
    main()
