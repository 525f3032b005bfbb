"""Demanding identifications: a real double pendulum, its tip alone, a rope on a measured arm, and one of few links.

The recordings are those that the tests use: in the folder that ``HYPERFLEX_DATA`` names, or ``../shared/data``. Without
them their rows are omitted.
"""

import os
import statistics
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from clock import Times, once

import hyperflex as hf
from hyperflex.identification import Kind
from hyperflex.model import divided

Row = dict[str, Any]
DATA = Path(os.environ.get("HYPERFLEX_DATA", Path(__file__).parents[1] / ".." / "shared" / "data"))
KNOWN = np.array([0.0905, 0.00686, 0.1019])  # J/p1 of both links, p/p1 of the second: independent fits of run 16
FREE = ["inertia", "com", "friction"]
FACTOR = 3.0  # largest factor between a guess and the best known value
SEED, GUESSES = 2, 20
SAME = 1.02  # times the least residual, up to which an optimum counts as the best known one
TRUE_STIFFNESS, FRICTION = 4.5e-3, 2e-4  # N m/rad, N m s/rad: of the joints of 15 links
ANGLE_NOISE = 3e-3  # rad


def measure(quick: bool) -> list[Row]:
    """Return rows of {problem, seconds, clock, accuracy}."""
    rows = [_row("15 links on a measured arm, 800 rows, two shared parameters", *arm_driven())]
    rows.append(_row("stiffness by 15 links, of a rope of 60", *coarse()))
    if (DATA / "ibm_double_pendulum").is_dir():
        rows.append(_row("real double pendulum, 20 s, dry friction, profiles", *real_double()))
        for name, seen in (("tip marker alone", slice(4, 6)), ("two markers alone", slice(2, 6))):
            rows.append(guesses(name, seen, SEED, 3 if quick else GUESSES))
    return rows


def _row(problem: str, seconds: float, clock: float, accuracy: str) -> Row:
    return {"problem": problem, "seconds": seconds, "clock": clock, "accuracy": accuracy}


def _timed(fit: Callable[[], hf.Identification]) -> tuple[hf.Identification, float, float]:
    """Return the second of two fits and its times, s; the first one compiles."""
    fit()
    times = Times()
    found = once(fit, times)
    return found, times.median, statistics.median(times.clock)  # type: ignore[return-value]


def run16(begin: float, end: float) -> hf.Recording:
    """Return markers of the real double pendulum, m."""
    path = DATA / "ibm_double_pendulum" / "run16_500Hz.csv"
    return hf.read_recording(path, time_unit="s", unit="m", y_axis="up").window(begin, end)


def figures(found: hf.Identification) -> np.ndarray:
    """Return J/p1 of both links, and p/p1 of the second."""
    return np.array([*found.ratios["J/p1"], found.ratios["p/p1"][1]])


def real_double() -> tuple[float, float, str]:
    """Return the times of a fit of 20 s, 500 frames a second, and the errors of its ratios."""
    recording = run16(10.0, 30.0)
    guess = hf.Rope(length=recording.link_lengths(), mass=0.1, friction=1e-5)
    free = [*FREE, "dry_friction", "gravity_angle"]
    found, seconds, clock = _timed(lambda: hf.identify(recording, guess, free, options=hf.FitOptions(train=np.inf)))
    off = np.abs(figures(found) / KNOWN - 1.0).max()
    profiled = sum(each.kind == "profile" for each in found.intervals.values())
    return seconds, clock, f"ratios within {100 * off:.2g} % of those known; {profiled} profiles; {found.grade}"


def arm_driven() -> tuple[float, float, str]:
    """Return the times of a fit to a rope on an arm whose motion was sampled, and the errors of its values."""
    rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=15, radius=0.003, friction=FRICTION)
    rope = rope.replace(stiffness=np.append(0.0, np.full(14, TRUE_STIFFNESS)))
    t, random, arm = np.arange(800) / 100.0, np.random.default_rng(0), hf.Arm(length=0.1)
    motion = hf.sampled_motion(t, 0.6 * np.sin(2.0 * np.pi * 0.9 * t) * np.minimum(t, 1.0))
    run = hf.simulate(rope, motion, arm=arm, duration=t[-1], t_eval=t, tol=1e-8)
    recording = hf.Recording(t, run.q + ANGLE_NOISE * random.standard_normal(run.q.shape), noise=ANGLE_NOISE)
    guess = rope.replace(friction=2.0 * FRICTION, stiffness=2.0 * rope.stiffness)
    free = ["friction:factor", "stiffness:factor"]
    found, seconds, clock = _timed(
        lambda: hf.identify(
            recording, guess, free, setup=hf.RecordingSetup(motion=motion, arm=arm), options=hf.FitOptions(train=np.inf)
        )
    )
    off = max(abs(float(found.values[name]) - 0.5) / float(found.std[name]) for name in free)
    return seconds, clock, f"truth within {off:.1f} standard deviations; {found.grade}"


def coarse() -> tuple[float, float, str]:
    """Return the times of a fit of 15 links to a rope of 60, and whether its stiffness or the first line is right."""
    chain = hf.Rope.uniform(length=1.0, mass=0.1, n_links=15, friction=FRICTION)
    chain = chain.replace(stiffness=np.append(0.0, np.full(14, TRUE_STIFFNESS)))
    true, t, random = divided(chain, 4), np.arange(90) / 30.0, np.random.default_rng(0)
    run = hf.simulate(true, duration=t[-1], t_eval=t, q0=np.linspace(0.9, 1.3, true.n_links), tol=1e-8)
    steps = np.diff(run.joints[:, ::4], axis=1)
    angles = np.unwrap(np.arctan2(steps[:, :, 0], -steps[:, :, 1]), axis=0)
    recording = hf.Recording(t, angles + ANGLE_NOISE * random.standard_normal(angles.shape), noise=ANGLE_NOISE)
    guess = chain.replace(friction=2.0 * FRICTION, stiffness=2.0 * chain.stiffness)
    found, seconds, clock = _timed(
        lambda: hf.identify(
            recording, guess, ["friction:factor", "stiffness:factor"], options=hf.FitOptions(train=np.inf)
        )
    )
    holds = 0.5 in found.intervals["stiffness:factor"]
    words = "use more links" if found.has(Kind.LINKS_TOO_LONG) else "more links are not recommended"
    factor, std = 2.0 * float(found.values["stiffness:factor"]), 2.0 * float(found.std["stiffness:factor"])
    return (
        seconds,
        clock,
        f'{factor:.2f} +- {std:.2f} of the truth, {"held" if holds else "missed"}; first line: "{words}"',
    )


def guesses(name: str, seen: slice, seed: int, count: int) -> Row:
    """Return how many guesses within FACTOR end at the best known optimum: 10 s, 500 frames a second, 80 % fitted."""
    every = run16(10.0, 20.0)
    length, origin = every.link_lengths(), np.nanmedian(every.data[:, :2], axis=0)
    full = hf.Rope(length=length, mass=0.1, inertia=[4e-5, 2e-5], com=[0.06, 0.02], friction=2e-5)
    best = hf.identify(every, full, FREE, options=hf.FitOptions(intervals=None, train=np.inf)).rope
    shown = hf.Recording(every.t, every.data[:, seen], kind="markers", noise=1e-3)
    arcs = np.cumsum(length)[-(shown.data.shape[1] // 2) :]
    residuals, times = [], Times()
    for guess in (best, *drawn(best, seed, count)):
        found = once(
            lambda rope=guess: hf.identify(
                shown,
                rope,
                FREE,
                setup=hf.RecordingSetup(arc_lengths=arcs, origin=origin),
                options=hf.FitOptions(intervals=None),
            ),
            times,
        )
        residuals.append(found.residual_rms_all)  # type: ignore[attr-defined]
    good = sum(each < SAME * min(residuals) for each in residuals[1:])
    processor, clock = (statistics.median(each[1:]) for each in (times.processor, times.clock))
    words = f"{good} of {count} end at the best known optimum, {1e3 * min(residuals):.3g} mm; "
    words += f"slowest {max(times.processor[1:]):.3g} s"
    return _row(
        f"real double pendulum, {name}, guesses within a factor of {FACTOR:g}, seed {seed}", processor, clock, words
    )


def drawn(best: hf.Rope, seed: int, count: int) -> Iterator[hf.Rope]:
    """Yield ropes whose free values are the best ones times independent factors between 1 / FACTOR and FACTOR."""
    for number in range(count):
        random, wide = np.random.default_rng([seed, number]), np.log(FACTOR)
        factors = {name: np.exp(random.uniform(-wide, wide, best.n_links)) for name in FREE}
        yield best.replace(**{name: factor * getattr(best, name) for name, factor in factors.items()})


def text(rows: list[Row]) -> str:
    """Return a Markdown table."""
    lines = ["| problem | s | elapsed, s | result |", "|---|---|---|---|"]
    lines += [f"| {r['problem']} | {r['seconds']:.3g} | {r['clock']:.3g} | {r['accuracy']} |" for r in rows]
    lines += ["", "Fits from several guesses: median time; they omit intervals and are otherwise those of `identify`."]
    return "\n".join(lines)
