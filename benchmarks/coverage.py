"""Twin experiments: how often do the stated 95 % intervals contain the truth, also if the model is too coarse?

python -m benchmarks.coverage                        2,000 of each kind, half an hour; to benchmarks/results/
python -m benchmarks.coverage --count 100 --out -    short; writes nothing

All data are simulated. Each experiment draws its rope, its first swing and its noise, fits with ``identify`` and its
defaults, and checks whether each interval contains the value that made the data. Where the model is right, lengths and
times are declared to be exact (length_std=0, clock_std=0); "measured" draws their errors from the default
distributions. The exit code is 1 if a right model's intervals contain one of the parameters more or less often than
chance allows, or if a wrong model's intervals miss in more than 12 % of the results that are not graded "do not use".
"""

import argparse
import json
import multiprocessing
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from benchmarks import machine
from rich.console import Console
from rich.progress import Progress

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import HyperflexError
from hyperflex.executor import refuse_lost, run_chunks
from hyperflex.identification import Kind, ratios
from hyperflex.model import divided
from hyperflex.status import Status

RESULTS = Path(__file__).parent / "results"
LEVEL = 0.95
CHUNK = 10  # experiments that a process fits in one call
CHANCE = 0.05  # probability that any of the parameters leaves the band although all intervals are right
NOISE = 0.01  # rad
LINKS, FINE = 5, 20
LENGTH, LINK_MASS = 0.2, 1.53e-3  # m, kg: of a link of the paper's rope for identification, as inferred
INERTIA, FRICTION = 1.43e-7, 6.31e-4  # kg m^2, N m s/rad: what the paper identified
CYLINDER = LINK_MASS * LENGTH**2 / 12.0  # kg m^2: a thin rod's
EXACT = {"length_std": 0.0, "clock_std": 0.0}  # lengths and times are exact, and are declared so
LENGTH_STD, CLOCK_STD = 0.01, 0.005  # as identify takes them
DRAG, LATE, PLACE_NOISE = 0.05, 0.02, 2e-3  # kg/m^2; s; m
HOLDS = 0.88  # of intervals of a wrong model that is not reported
WARNINGS = (Kind.COLOURED, Kind.NOISE_UNDERSTATED)


class Experiment(NamedTuple):
    """A recording, the model and options of its fit, and the true values by the names of the intervals."""

    recording: hf.Recording
    guess: hf.Rope
    free: list[str]
    truth: dict[str, float]
    setup: hf.RecordingSetup | None = None
    known: Mapping[str, float] = MappingProxyType({})  # standard deviations of the declared values
    window: float | None = np.inf


Draw = Callable[[np.random.Generator], Experiment]


def seen(rope: hf.Rope, frames: int, rate: float, q0: Any, random: np.random.Generator) -> hf.Recording:
    t = np.arange(frames) / rate
    run = hf.simulate(rope, duration=t[-1], t_eval=t, q0=q0, tol=1e-9)
    return hf.Recording(t, run.q + NOISE * random.standard_normal(run.q.shape), noise=NOISE)


def within(random: np.random.Generator, factor: float, size: int | None = None) -> Any:
    """Factors, log-uniform from 1 / factor to factor."""
    return factor ** random.uniform(-1.0, 1.0, size)


def bent(random: np.random.Generator, links: int) -> Any:
    """First angles of a rope, rad: drawn aside, with a little curvature."""
    along = (np.arange(links) + 0.5) / links
    return random.uniform(0.6, 1.1) + random.uniform(0.0, 0.5) * along


def rope(random: np.random.Generator) -> Experiment:
    inertia, friction = INERTIA * within(random, 3.0), FRICTION * within(random, 2.0)
    true = hf.Rope(length=[LENGTH] * LINKS, mass=[LINK_MASS] * LINKS, inertia=inertia, friction=friction)
    guess = true.replace(inertia=CYLINDER, friction=2.0 * FRICTION)
    truth = {"inertia:shared": inertia, "friction:shared": friction}
    return Experiment(seen(true, 22, 7.5, bent(random, LINKS), random), guess, list(truth), truth, known=EXACT)


def single(random: np.random.Generator) -> Experiment:
    inertia, friction = 7.5e-4 * within(random, 1.5), 2e-4 * within(random, 3.0)
    true = hf.Rope(length=[0.3], mass=[0.1], com=[0.14], inertia=inertia, friction=friction)
    truth = {"inertia[0]": inertia, "friction[0]": friction}
    recording = seen(true, 61, 20.0, [random.uniform(0.4, 1.2)], random)
    return Experiment(recording, true.replace(inertia=1e-3, friction=5e-4), ["inertia", "friction"], truth, known=EXACT)


def double(random: np.random.Generator) -> Experiment:
    inertia, friction = [8e-4, 3.5e-4] * within(random, 1.5, 2), [3e-4, 1e-4] * within(random, 2.0, 2)
    true = hf.Rope(length=[0.3, 0.25], mass=[0.1, 0.06], com=[0.14, 0.13], inertia=inertia, friction=friction)
    guess = true.replace(inertia=5e-4, com=0.12, friction=3e-4)
    truth = {f"{name}[{k}]": value for name, values in ratios(true).items() for k, value in enumerate(values.tolist())}
    del truth["p/p1[0]"]  # it is 1 by definition
    recording = seen(true, 81, 20.0, random.uniform(0.4, 1.1, 2), random)
    return Experiment(recording, guess, ["inertia", "com", "friction"], truth, known=EXACT)


def doubles(random: np.random.Generator, **more: Any) -> tuple[hf.Rope, hf.Rope, list[str], dict[str, float]]:
    """A double pendulum, a guess of it, the free parameters, and the true ratios of moments and inertias."""
    inertia, friction = [8e-4, 3.5e-4] * within(random, 1.5, 2), [3e-4, 1e-4] * within(random, 2.0, 2)
    true = hf.Rope(length=[0.3, 0.25], mass=[0.1, 0.06], com=[0.14, 0.13], inertia=inertia, friction=friction, **more)
    guess = true.replace(inertia=5e-4, com=0.12, friction=3e-4, drag=0.0)
    truth = {f"{name}[{k}]": float(x) for name in ("J/p1", "p/p1") for k, x in enumerate(ratios(true)[name])}
    del truth["p/p1[0]"]
    return true, guess, ["inertia", "com", "friction"], truth


def dragged(random: np.random.Generator) -> Experiment:
    true, guess, free, truth = doubles(random, drag=DRAG)
    return Experiment(seen(true, 81, 20.0, random.uniform(0.4, 1.1, 2), random), guess, free, truth)


def too_long(random: np.random.Generator) -> Experiment:
    true, guess, free, truth = doubles(random)
    recording = seen(true, 81, 20.0, random.uniform(0.4, 1.1, 2), random)
    return Experiment(recording, guess.replace(length=1.01 * guess.length), free, truth)


def measured(random: np.random.Generator) -> Experiment:
    """Lengths and times are measured with the errors that the intervals include by default."""
    true, guess, free, truth = doubles(random)
    recording = seen(true, 81, 20.0, random.uniform(0.4, 1.1, 2), random)
    factor, clock = np.exp([LENGTH_STD, CLOCK_STD] * random.standard_normal(2))
    recording = replace(recording, t=clock * recording.t)
    return Experiment(recording, guess.replace(length=factor * guess.length), free, truth)


def places(random: np.random.Generator, scale: float, roll: float) -> Experiment:
    """Markers at the joints, fitted as places, seen by a camera whose scale or roll is not as declared."""
    true, guess, free, truth = doubles(random)
    t = np.arange(81) / 20.0
    run = hf.simulate(true, duration=t[-1], t_eval=t, q0=random.uniform(0.4, 1.1, 2), tol=1e-9)
    c, s = np.cos(roll), np.sin(roll)
    where = scale * run.joints @ np.array([[c, s], [-s, c]])
    where = (where + PLACE_NOISE * random.standard_normal(where.shape))[:, 1:]
    recording = hf.Recording(t, where.reshape(t.size, -1), "markers", noise=PLACE_NOISE)
    return Experiment(recording, guess, free, truth, hf.RecordingSetup(arc_lengths=[0.3, 0.55], origin=(0.0, 0.0)))


def too_large(random: np.random.Generator) -> Experiment:
    return places(random, 1.02, 0.0)


def rolled(random: np.random.Generator) -> Experiment:
    return places(random, 1.0, 0.03)


def late(random: np.random.Generator) -> Experiment:
    """An arm swings the pendulum, and the camera's time stamps are late."""
    true, guess, free, truth = doubles(random)
    arm, motion = hf.Arm(length=0.1), hf.arm_swings(0.5, 0.1)
    t = np.arange(81) / 20.0
    run = hf.simulate(true, duration=t[-1], t_eval=t, q0=random.uniform(-0.3, 0.3, 2), arm=arm, motion=motion, tol=1e-9)
    noise = NOISE * random.standard_normal(run.q.shape)
    recording = hf.Recording(t + LATE, run.q + noise, noise=NOISE)
    # links rotate at up to 38 rad/s: no fit would converge over all 4 s, so the windows are the default ones
    return Experiment(recording, guess, free, truth, hf.RecordingSetup(arm=arm, motion=motion), window=None)


def stiff(random: np.random.Generator) -> Experiment:
    """A stiff rope's data from 60 links, its stiffness and friction fitted with 15."""
    links, length, mass, friction = 15, 1.0, 0.1, 2e-4
    stiffness = 3e-4 * within(random, 3.0) * links / length  # N m/rad, from 3e-4 N m^2
    chain = hf.Rope.uniform(length=length, mass=mass, n_links=links, friction=friction, stiffness=stiffness)
    chain = chain.replace(stiffness=np.append(0.0, np.full(links - 1, stiffness)))
    fine = divided(chain, 4)
    t = np.arange(90) / 30.0
    run = hf.simulate(fine, duration=t[-1], t_eval=t, q0=bent(random, fine.n_links), tol=1e-8)
    recording = hf.Recording(t, chords(run.joints[:, ::4], random, 3e-3), noise=3e-3)
    guess = chain.replace(friction=2.0 * friction, stiffness=2.0 * chain.stiffness)
    truth = {"friction:factor": 0.5, "stiffness:factor": 0.5}
    return Experiment(recording, guess, list(truth), truth)


def chords(places: Any, random: np.random.Generator, noise: float) -> Any:
    """Directions of straight lines between places (T, K, 2), rad, with noise."""
    step = np.diff(places, axis=1)
    angles = np.unwrap(np.arctan2(step[:, :, 0], -step[:, :, 1]), axis=0)
    return angles + noise * random.standard_normal(angles.shape)


def finer(random: np.random.Generator) -> Experiment:
    """The rope's data from 20 links; the truth is that rope divided into five."""
    parts = FINE // LINKS
    each = np.full(FINE, parts * FRICTION)
    each[0] = FRICTION
    fine = hf.Rope(
        length=[LENGTH / parts] * FINE,
        mass=[LINK_MASS / parts] * FINE,
        inertia=CYLINDER / parts**3,
        friction=each,
    )
    t = np.arange(22) / 7.5
    run = hf.simulate(fine, duration=t[-1], t_eval=t, q0=bent(random, FINE), tol=1e-9)
    recording = hf.Recording(t, chords(run.joints[:, ::parts], random, NOISE), noise=NOISE)
    guess = hf.Rope(length=[LENGTH] * LINKS, mass=[LINK_MASS] * LINKS, inertia=CYLINDER, friction=2.0 * FRICTION)
    truth = {"inertia:shared": CYLINDER, "friction:shared": FRICTION}
    return Experiment(recording, guess, list(truth), truth)


KINDS: dict[str, tuple[Draw, str]] = {
    "rope": (rope, "the paper's rope, 5 links, 22 frames in 2.8 s; J and eta shared, J poorly determined and near 0"),
    "single": (single, "a pendulum of known mass, 61 frames in 3 s"),
    "double": (double, "a double pendulum of unknown mass: ratios; 81 frames in 4 s"),
    "finer": (finer, "the rope of 20 links, fitted with 5; the truth is the rope divided into 5"),
    "stiff": (stiff, "a stiff rope of 60 links, fitted with 15; factors of friction and stiffness"),
    "measured": (measured, "a double pendulum, lengths measured with a standard deviation of 1 %, times of 0.5 %"),
    "drag": (dragged, "a double pendulum with air drag, fitted without air drag"),
    "length": (too_long, "a double pendulum, lengths declared 1 % too long"),
    "scale": (too_large, "a double pendulum, markers' positions 2 % too far apart"),
    "roll": (rolled, "a double pendulum, markers' positions seen by a camera rotated by 0.03 rad"),
    "late": (late, "a double pendulum swung by an arm, the camera's time stamps 20 ms late"),
}
RIGHT = ("rope", "single", "double")
WRONG = ("finer", "stiff", "measured", "drag", "length", "scale", "roll", "late")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="experiments of each kind with the right model (2000)")
    parser.add_argument("--wrong", type=int, metavar="COUNT", help="with wrong models (a quarter of count)")
    parser.add_argument("--length", type=int, default=0, metavar="COUNT", help="at least, with lengths 1 %% too long")
    parser.add_argument("--workers", type=int, default=1, help="processes (1)")
    parser.add_argument("--seed", type=int, default=1, help="of all draws (1)")
    parser.add_argument("--out", default=str(RESULTS), metavar="FOLDER", help="for JSON and Markdown; - writes nothing")
    return parser.parse_args()


def main() -> int:
    options = parse()
    counts = dict.fromkeys(RIGHT, options.count)
    counts |= dict.fromkeys(WRONG, options.count // 4 if options.wrong is None else options.wrong)
    counts["stiff"] //= 4
    counts |= {"length": max(counts["length"], options.length)}
    about = machine.describe()
    rows: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    context = multiprocessing.get_context("forkserver")
    with (
        Progress(console=Console(stderr=True)) as bar,
        nullcontext() if options.workers == 1 else ProcessPoolExecutor(options.workers, context) as pool,
    ):
        try:
            for number, kind in enumerate(KINDS):
                task = bar.add_task(kind, total=counts[kind])

                def keep(_: int, some: list[dict[str, Any]], kind: str = kind, task: Any = task) -> None:
                    rows[kind] += some
                    bar.update(task, advance=len(some))

                work = partial(examined, kind=kind, seed=(options.seed, number))
                refuse_lost(run_chunks(work, range(counts[kind]), pool, 1 if pool is None else CHUNK, keep), kind)
        except KeyboardInterrupt:
            sys.stderr.write("interrupted: the finished experiments are shown\n")
    about["load after"] = machine.load()
    page = f"# Coverage of the intervals\n\n{text(rows, options.seed)}\n{machine.sentence(about)}\n"
    print(page)
    if options.out != "-":
        folder = Path(options.out)
        folder.mkdir(parents=True, exist_ok=True)
        data = {"machine": about, "seed": options.seed, "rows": rows}
        files.write_text(folder / "coverage.json", json.dumps(data, separators=(",", ":")) + "\n")
        files.write_text(folder / "coverage.md", page)
    return int(not passed(rows))


def examined(indices: list[int], kind: str, seed: tuple[int, int]) -> list[dict[str, Any]]:
    """Fit the experiments of these numbers."""
    return [examine(KINDS[kind][0], np.random.default_rng([*seed, index])) for index in indices]


def examine(draw: Draw, random: np.random.Generator) -> dict[str, Any]:
    """Fit one experiment and return how it ended, and for each parameter truth, estimate, interval and its kind."""
    case = draw(random)
    began = time.perf_counter()
    try:
        options = hf.FitOptions(window=case.window, train=np.inf, **case.known)
        found = hf.identify(case.recording, case.guess, case.free, setup=case.setup, options=options)
    except HyperflexError as error:
        return {"status": type(error).__name__, "numbers": {}}
    if found.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    numbers = {}
    for name, true in case.truth.items():
        each = found.intervals[name]
        numbers[name] = [short(x) for x in (true, estimate(found, name), each.low, each.high)] + [each.kind]
    return {
        "status": "converged" if found.converged else str(found.status),
        "grade": str(found.grade),
        "links": found.has(Kind.LINKS_TOO_LONG),
        "seconds": short(time.perf_counter() - began),
        "rms": short(found.residual_rms_all),
        "warned": found.has(*WARNINGS),
        "numbers": numbers,
    }


def estimate(found: hf.Identification, name: str) -> float:
    property_, _, rest = name.partition("[" if "[" in name else ":")
    link = int(rest[:-1]) if "[" in name else 0
    if name in found.values:  # a law's
        return float(found.values[name])
    return float((found.ratios if property_ in found.ratios else found.values)[property_][link])


def short(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None


class Share(NamedTuple):
    """How often intervals of one parameter contained the truth, and on which side they missed it."""

    held: float
    below: float  # the whole interval lies below the truth
    above: float
    profiled: float
    width: float  # median, over the truth
    ratio: float  # median of the estimate over the truth


def share(rows: list[dict[str, Any]], name: str) -> Share:
    """Experiments that failed count as missed."""
    good = [row["numbers"][name] for row in rows if name in row["numbers"]]
    true, found, low, high = (np.array([row[k] for row in good], dtype=np.float64) for k in range(4))
    low, high = np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)
    total = len(rows)
    return Share(
        float(((low <= true) & (true <= high)).sum() / total),
        float((high < true).sum() / total),
        float((low > true).sum() / total),
        float(np.mean([row[4] == "profile" for row in good])),
        float(np.median((high - low) / true)),
        float(np.median(found / true)),
    )


def names(rows: list[dict[str, Any]]) -> list[str]:
    return next((list(row["numbers"]) for row in rows if row["numbers"]), [])


def band(rows: dict[str, list[dict[str, Any]]]) -> dict[str, tuple[float, float]]:
    """Band of coverages, for each kind, in which right intervals of all parameters stay by chance."""
    from scipy.stats import binom

    together = sum(len(names(rows[kind])) for kind in RIGHT)
    side = 0.5 * CHANCE / max(together, 1)
    result = {}
    for kind in RIGHT:
        total = len(rows[kind])
        if total:
            low, high = binom.ppf([side, 1.0 - side], total, LEVEL) / total
            result[kind] = (float(low), float(high))
    return result


def passed(rows: dict[str, list[dict[str, Any]]]) -> bool:
    limits = band(rows)
    return all(
        limits[kind][0] <= share(rows[kind], name).held <= limits[kind][1]
        for kind in limits
        for name in names(rows[kind])
    ) and all(wrong_share(rows[kind], name) >= HOLDS for kind in WRONG for name in names(rows[kind]))


def wrong_share(rows: list[dict[str, Any]], name: str) -> float:
    """How often the interval contained the truth, or the result was graded "do not use" or refused."""
    fair = [row for row in rows if row.get("grade", "do not use") == "do not use"]
    good = [row["numbers"][name] for row in rows if row not in fair]
    held = sum((low is None or low <= true) and (high is None or true <= high) for true, _, low, high, _ in good)
    return (held + len(fair)) / max(len(rows), 1)


def text(rows: dict[str, list[dict[str, Any]]], seed: int) -> str:
    """Results as Markdown."""
    limits, lines = band(rows), [f"Simulated recordings, noise {NOISE:g} rad, seed {seed}; intervals of 95 %.", ""]
    for kind, (_, about) in KINDS.items():
        if not rows[kind]:
            continue
        lines += [f"## {len(rows[kind])} experiments: {about}", ""]
        lines += ["| | contains the truth | too low | too high | by profile | width / truth | estimate / truth |"]
        lines += ["|---|---|---|---|---|---|---|"]
        for name in names(rows[kind]):
            one = share(rows[kind], name)
            cells = [f"{x:.1%}" for x in one[:3]] + [f"{one.profiled:.0%}", f"{one.width:.2g}", f"{one.ratio:.3f}"]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines += ["", sentence(kind, rows[kind], limits), ""]
    return "\n".join(lines)


def sentence(kind: str, rows: list[dict[str, Any]], limits: dict[str, tuple[float, float]]) -> str:
    """Explain the table."""
    arrived = np.mean([row["status"] == "converged" for row in rows])
    warned = np.mean([row.get("warned", False) for row in rows])
    rms = 1e3 * float(np.median([row["rms"] for row in rows if "rms" in row]))
    took = 1e3 * float(np.median([row["seconds"] for row in rows if "seconds" in row]))
    unit = "mm" if kind in ("scale", "roll") else "mrad"  # places of markers, or angles
    common = f"{arrived:.1%} converged, {took:.0f} ms a fit with its intervals (median); fit error {rms:.1f} {unit}."
    if kind in limits:
        low, high = limits[kind]
        within_band = "Range of chance for all parameters of right models together:"
        return (
            f"{within_band} {low:.1%} to {high:.1%}. {common} {warned:.1%} are warned that their residuals are not "
            "noise."
        )
    parts = ", ".join(f"{name} {wrong_share(rows, name):.1%}" for name in names(rows))
    refused = np.mean([row.get("grade", "do not use") == "do not use" for row in rows])
    told = f" {np.mean([row.get('links', False) for row in rows]):.0%} are advised to use more links." * (
        kind in ("finer", "stiff")
    )
    return (
        f'{refused:.0%} are graded "do not use" or refused. Share of results that contain the truth, are refused '
        f"or are graded so: {parts}.{told} {common}"
    )


if __name__ == "__main__":
    warnings.simplefilter("error")
    sys.exit(main())
