"""Results of identify for wrong and poor inputs, simulated and real.

python -m benchmarks.wrong_input --data FOLDER     all cases; the table goes to benchmarks/results/wrong-input.md
python -m benchmarks.wrong_input --out -           simulated cases only; writes nothing
python -m benchmarks.wrong_input --only WORDS      cases with these words in their names; writes nothing

Each case must end in one of five ways: it is refused; it is graded "do not use"; the usable values have 95 % intervals
that contain the truth and are no wider than its kind of case allows; its first finding names the mistake, as listed in
CAUSES; or the recording is exactly that of another rope, and the findings state the effect of each per cent. The exit
code is 1 if a result is called usable and is wrong or nearly empty.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import HyperflexError
from hyperflex.identification import Grade, Kind, ratios, text

Array = np.ndarray
TIMES_OR_LENGTHS = (Kind.CLOCK, Kind.LENGTHS)
ANGLES = (Kind.ZERO, Kind.GRAVITY_ROTATED)
CAUSES: dict[str, tuple[Kind, ...]] = {  # by mistake, as in a case's name: allowed kinds of the first finding
    "clock x 1.1": TIMES_OR_LENGTHS,
    "clock x 0.8 (400 for 500 Hz)": TIMES_OR_LENGTHS,
    "clock x 1.005, as clocks err": TIMES_OR_LENGTHS,
    "clock x 1.005 and lengths x 1.01, as clocks and rulers err": TIMES_OR_LENGTHS,
    "twice the frame rate": TIMES_OR_LENGTHS,
    "half the frame rate": TIMES_OR_LENGTHS,
    "length x 1.1": TIMES_OR_LENGTHS,
    "lengths x 1.1": TIMES_OR_LENGTHS,
    "lengths x 0.99": TIMES_OR_LENGTHS,
    "first length x 1.1": (Kind.LENGTHS,),
    "scale x 1.1": (Kind.MARKER_DISTANCES,),
    "scale x 1.1, places fitted": (Kind.MARKER_SCALE,),
    "a clock that drifts, 2 % too slow at the end": (Kind.DRIFT,),
    "zero off by 5 degrees": ANGLES,
    "camera turned by 8 degrees": ANGLES,
    "the tip's alone, camera turned by 5 degrees": ANGLES,
    "com held wrong": (Kind.HELD,),
    "masses held wrong": (Kind.HELD,),
    "inertia held wrong": (Kind.HELD,),
    "arm's length x 1.01": (Kind.LENGTHS,),
    "stamps 20 ms late": (Kind.DELAY,),
    "bent at rest, held straight": (Kind.REST_BEND,),
    "5 % lost, written as 0": (Kind.LOST,),
    "lost for 0.2 s every 2 s, written as 0": (Kind.LOST,),
    "half of the frames dropped, times counted on": (Kind.UNEVEN_FRAMES, Kind.MISSING_FRAMES, *TIMES_OR_LENGTHS),
    "every 25th frame dropped, times counted on": (Kind.MISSING_FRAMES, Kind.UNEVEN_FRAMES),
    "half the frames, each twice": (Kind.REPEATED_FRAMES,),
    "a frame is repeated every second": (Kind.REPEATED_FRAMES,),
    "a zero moved halfway": (Kind.JUMP, *ANGLES),
    "4 % outliers": (Kind.OUTLIERS,),
    "last link 10 ms late": (Kind.LINK_LATE,),
    "last link 30 ms late": (Kind.LINK_LATE,),
}
BOTH = "clock x 1.1 and lengths x 1.21: a longer rope that moves alike"
DOUBLE = hf.Rope(length=[0.3, 0.25], mass=[0.1, 0.06], com=[0.14, 0.13], inertia=[8e-4, 3.5e-4], friction=[3e-4, 1e-4])
SINGLE = hf.Rope(length=[0.3], mass=[0.1], com=[0.14], inertia=[7.5e-4], friction=[2e-4])
FREE = ("inertia", "com", "friction")
BAND = 1.96  # standard deviations on either side that hold 95 %
# Largest half width of an interval over its value: of ratios of moments and inertias; of these ratios from a poor
# recording; of masses and inertias, which include 2 % of the torque, 1 % of the lengths and more for a link about its
# centre of mass; of frictions, which another law of friction changes by up to their value
NARROW, POOR, WEIGHED, FRICTION = 0.05, 0.3, 0.2, 1.0
FRICTIONS = ("c/p1", "friction")


@dataclass(frozen=True)
class Case:
    """A recording, its declaration, and the true ratios (and values, if these may be called usable)."""

    name: str
    recording: Callable[[], hf.Recording]
    guess: hf.Rope
    truth: dict[str, Array]
    free: tuple[str, ...] | None = FREE
    setup: dict[str, Any] = field(default_factory=dict)
    loss: Any = "squares"
    error: dict[str, Array] = field(default_factory=dict)  # standard deviations of a measured truth
    undetectable: bool = False  # another rope makes exactly this recording
    widest: float = NARROW  # largest half width of an interval over its value
    right: "Case | None" = None  # the case with a right declaration

    @property
    def wrong(self) -> str:
        """The mistake."""
        return self.name.partition(": ")[2]


def swing(rope: hf.Rope, q0: Any, duration: float = 6.0, rate: float = 50.0, **drive: Any) -> tuple[Array, Array]:
    t = np.arange(round(duration * rate)) / rate
    return t, hf.simulate(rope, duration=float(t[-1]), t_eval=t, q0=q0, tol=1e-9, **drive).q


def noisy(values: Array, size: float = 2e-3, seed: int = 0) -> Array:
    return values + size * np.random.default_rng(seed).standard_normal(values.shape)


def slips(name: str, t: Array, q: Array, guess: hf.Rope, truth: dict[str, Array], **more: Any) -> Iterator[Case]:
    """Yield the angles of two links or more with every usual wrong declaration."""
    n = q.shape[1]
    last = np.eye(n)[-1]

    def case(what: str, data: Array, times: Array = t, rope: hf.Rope = guess) -> Case:
        return Case(f"{name}: {what}", lambda: hf.Recording(times, data), rope, truth, **more)

    yield case("as it is", q)
    yield case("relative angles read as absolute", np.diff(q, axis=1, prepend=0.0))
    yield case("absolute angles read as relative", np.cumsum(q, axis=1))
    yield case("degrees read as radians", np.degrees(q))
    yield case("radians read as degrees", np.radians(q))
    yield case("0 is up", q + np.pi)
    yield case("0 is level", q + 0.5 * np.pi)
    yield case("zero off by 5 degrees", q + 0.09)
    yield case("links in reverse order", q[:, ::-1])
    yield case("first link to the other side", q * np.where(np.arange(n) == 0, -1.0, 1.0))
    yield case("last link's zero off by 10 degrees", q + 0.17 * last)
    yield case("clock x 1.1", q, 1.1 * t)
    yield case("clock x 0.8 (400 for 500 Hz)", q, 0.8 * t)
    yield case("twice the frame rate", q, 0.5 * t)
    yield case("half the frame rate", q, 2.0 * t)
    yield case("lengths x 1.1", q, t, longer(guess, 1.1))
    yield case("first length x 1.1", q, t, longer(guess, np.where(np.arange(n) == 0, 1.1, 1.0)))
    yield case("a clock that drifts, 2 % too slow at the end", q, t + 0.01 * (t - t[0]) ** 2 / np.ptp(t))
    yield replace(case(BOTH, q, 1.1 * t, longer(guess, 1.21)), undetectable=True)
    yield case("clock x 1.005 and lengths x 1.01, as clocks and rulers err", q, 1.005 * t, longer(guess, 1.01))


def longer(rope: hf.Rope, factor: Any) -> hf.Rope:
    """The rope with scaled lengths and all quantities that scale with them."""
    return rope.replace(length=rope.length * factor, com=rope.com * factor, inertia=rope.inertia * factor**2)


def simulated() -> Iterator[Case]:
    """Yield twins, each with its rightly declared case."""
    guess = DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4)
    t, q = swing(DOUBLE, [0.9, 0.6])
    q = noisy(q)
    truth = ratios(DOUBLE)
    double = [*slips("double", t, q, guess, truth), *poor(t, q, guess, truth), *held(t, q, truth)]
    for cases in (double, of_single(), of_markers(guess, truth), of_ropes(), driven(guess, truth), *of_samples()):
        yield from beside_right(cases)


def beside_right(cases: Iterable[Case]) -> Iterator[Case]:
    """Yield cases of one motion, each with the first one, which is declared rightly."""
    right, *others = cases
    yield right
    yield from (replace(case, right=right) for case in others)


def poor(t: Array, q: Array, guess: hf.Rope, truth: dict[str, Array]) -> Iterator[Case]:
    def case(what: str, data: Array, times: Array = t, rope: hf.Rope = guess, **more: Any) -> Case:
        return Case(f"double: {what}", lambda: hf.Recording(times, data), rope, truth, widest=POOR, **more)

    random = np.random.default_rng(1)
    yield case("40 % of samples missing", np.where(random.random(q.shape) < 0.4, np.nan, q))
    spoiled = q.copy()
    spoiled[random.random(q.shape) < 0.03] += 2.0
    yield case("3 % outliers", spoiled)
    yield case("3 % outliers, robust", spoiled, loss="cauchy")
    yield case("noise of a tenth of the motion", noisy(q, 0.06, 2))
    yield case("nothing moves", 1e-5 * q)
    yield case("a motor hums: a force that is not declared", q + 0.02 * np.sin(2.0 * np.pi * 3.0 * t)[:, None])
    yield case("the base sways", q + 0.1 * np.sin(2.0 * np.pi * 0.4 * t)[:, None])
    yield case("one second of it", q[:50], t[:50])
    yield case("a tenth of a second of it", q[:6], t[:6])
    yield case("guess off by 3", q, rope=guess.replace(inertia=guess.inertia * 3.0, friction=guess.friction / 3.0))
    yield case("guess of one mass for both", q, rope=guess.replace(mass=0.1))
    kept = np.arange(t.size) % 25 != 0
    yield case("every 25th frame dropped, times counted on", q[kept], t[: kept.sum()])
    yield case(
        "a frame is repeated every second", np.where((np.arange(t.size) % 50 == 0)[:, None], np.roll(q, 1, 0), q)
    )


def held(t: Array, q: Array, truth: dict[str, Array]) -> Iterator[Case]:
    def case(what: str, rope: hf.Rope, free: tuple[str, ...] | None) -> Case:
        return Case(f"double: {what}", lambda: hf.Recording(t, q), rope, truth, free)

    yield case("com held wrong", DOUBLE.replace(com=[0.15, 0.125]), ("inertia", "friction"))
    yield case("masses held wrong", DOUBLE.replace(mass=[0.1, 0.1]), ("inertia", "friction"))
    yield case("masses and com guessed, default", DOUBLE.replace(mass=0.1, com=[0.15, 0.125]), None)
    yield case("inertia held wrong", DOUBLE.replace(inertia=[1.2e-3, 3.5e-4]), ("friction",))
    yield Case(
        "double: angles x 1.1, default", lambda: hf.Recording(t, 1.1 * q), DOUBLE.replace(inertia=5e-4), truth, None
    )
    yield case("one length in cm", DOUBLE.replace(length=[0.3, 25.0]), FREE)
    yield case("dry friction free, at 0", DOUBLE.replace(dry_friction=0.0), (*FREE, "dry_friction"))


def of_single() -> Iterator[Case]:
    t, q = swing(SINGLE, [1.0])
    q, truth = noisy(q), ratios(SINGLE)
    guess = SINGLE.replace(inertia=1e-3, friction=5e-4)

    def case(what: str, data: Array, times: Array = t, rope: hf.Rope = guess) -> Case:
        return Case(f"single: {what}", lambda: hf.Recording(times, data), rope, truth, ("inertia", "friction"))

    yield case("as it is", q)
    yield replace(case("clock x 1.1: a pendulum of more inertia", q, 1.1 * t), undetectable=True)
    yield case("clock x 1.005, as clocks err", q, 1.005 * t)
    yield case("half the frame rate", q, 2.0 * t)
    wide = noisy(swing(SINGLE, [1.4])[1])
    yield case("from 1.4 rad", wide)
    yield case("from 1.4 rad, angles x 0.9", 0.9 * wide)
    yield case("length x 1.1", q, t, longer(guess, 1.1))
    yield case("0 is up", q + np.pi)
    yield case("radians read as degrees", np.radians(q))


def of_markers(guess: hf.Rope, truth: dict[str, Array]) -> Iterator[Case]:
    t, q = swing(DOUBLE, [0.9, 0.6])
    places = noisy(np.stack([DOUBLE.joints(row, np.zeros(2)) for row in q]), 5e-4)

    def case(what: str, data: Array, **more: Any) -> Case:
        flat = data.reshape(t.size, -1)
        return Case(f"markers: {what}", lambda: hf.Recording(t, flat, kind="markers"), guess, truth, **more)

    yield case("as they are", places)
    yield case("y points down", places * [1.0, -1.0])
    yield case("x and y swapped", places[:, :, ::-1])
    yield case("camera turned by 8 degrees", turned(places, 0.14))
    yield case("reverse order", places[:, ::-1])
    yield case(
        "the last two swapped from the middle on", np.where((t < 3.0)[:, None, None], places, places[:, [0, 2, 1]])
    )
    twice = (t > 1.0) & (t < 2.0) | (t > 3.5) & (t < 4.5)
    yield case("the last two swapped in two intervals", np.where(twice[:, None, None], places[:, [0, 2, 1]], places))
    yield case("scale x 1.1", 1.1 * places)
    yield case("scale x 1.1, places fitted", 1.1 * places, setup={"arc_lengths": [0.0, 0.3, 0.55]})
    yield case("millimetres read as metres", 1e3 * places)
    arcs = {"arc_lengths": [0.55], "origin": (0.0, 0.0)}
    yield case("the tip's alone", places[:, 2:], setup=arcs)
    yield case("the tip's alone, the origin off by 3 cm", places[:, 2:], setup=arcs | {"origin": (0.03, 0.0)})
    yield case("the tip's alone, camera turned by 5 degrees", turned(places, 0.09)[:, 2:], setup=arcs)
    yield case("the tip's alone, y points down", places[:, 2:] * [1.0, -1.0], setup=arcs)


def driven(guess: hf.Rope, truth: dict[str, Array]) -> Iterator[Case]:
    motion, arm = hf.arm_swings(0.7, 0.4, "minimum-jerk"), hf.Arm(length=0.1)
    t = np.arange(300) / 50.0
    run = hf.simulate(DOUBLE, motion, arm=arm, duration=float(t[-1]), t_eval=t, tol=1e-9)
    q, drive = noisy(run.q), {"motion": motion, "arm": arm}
    torque = {"torque": noisy(run.motor_torque, 1e-3, 1), "torque_noise": 1e-3}
    values = {name: getattr(DOUBLE, name) for name in ("mass", "inertia", "friction")}

    def case(what: str, times: Array = t, free: tuple[str, ...] = FREE, **more: Any) -> Case:
        return Case(
            f"driven: {what}", lambda: hf.Recording(times, q, noise=2e-3), guess, truth | values, free, drive | more
        )

    yield case("as it is")
    yield replace(case("torque measured", free=tuple(values), **torque), guess=guess.replace(mass=0.1, com=DOUBLE.com))
    yield replace(case("lengths x 0.99"), guess=longer(guess, 0.99))
    yield case("arm's length x 1.01", arm=hf.Arm(length=0.101))
    yield case("arm's length x 1.2", arm=hf.Arm(length=0.12))
    yield case("stamps 20 ms late", t + 0.02)
    yield case("stamps 100 ms late", t + 0.1)


def of_samples() -> Iterator[Iterator[Case]]:
    """Yield motions with faulty samples, as angles and as markers, regular and not, at 30 to 100 frames/s."""
    truth, guess = ratios(DOUBLE), DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4)
    t, q = swing(DOUBLE, [0.9, 0.6], rate=100.0)
    yield spoiled("fast double", Case("", lambda: hf.Recording(t, noisy(q)), guess, truth))
    wild = swing(DOUBLE, [2.6, 2.2], rate=100.0)[1]
    yield spoiled("tumbling double", Case("", lambda: hf.Recording(t, noisy(wild)), guess, truth))
    pivot = np.array([0.4, 0.9])
    places = noisy(np.stack([DOUBLE.joints(row, pivot) for row in q]), 5e-4).reshape(t.size, -1)
    yield spoiled("fast markers", Case("", lambda: hf.Recording(t, places, kind="markers"), guess, truth))
    alone = {"arc_lengths": [0.55], "origin": pivot}
    yield spoiled(
        "a marker alone", Case("", lambda: hf.Recording(t, places[:, 4:], kind="markers"), guess, truth, setup=alone)
    )
    string = hf.Rope([0.8], [0.05], com=[0.8], inertia=1e-6, friction=2e-4)
    t30, q30 = swing(string, [0.5], 20.0, 30.0)
    seen = noisy(np.stack([string.joints(row, pivot) for row in q30]), 1e-3).reshape(t30.size, -1)
    held = string.replace(inertia=5e-4, friction=5e-4)
    of_string = Case("", lambda: hf.Recording(t30, seen, kind="markers"), held, ratios(string), ("inertia", "friction"))
    yield spoiled("string", of_string)
    alone = {"arc_lengths": [0.8], "origin": pivot}
    bob = replace(of_string, recording=lambda: hf.Recording(t30, seen[:, 2:], kind="markers"), setup=alone)
    yield spoiled("string's bob alone", bob)


def spoiled(name: str, right: Case) -> Iterator[Case]:
    """Yield a case without faults, and with typical faults of programs, cameras and sensors in its samples."""
    recording, random = right.recording(), np.random.default_rng(3)
    t, data, markers = recording.t, recording.data, recording.kind == "markers"
    last, middle = slice(-2, None) if markers else slice(-1, None), t.size // 2

    def case(what: str, data: Array, times: Array = t, **more: Any) -> Case:
        made = lambda: hf.Recording(times, data, kind=recording.kind)  # noqa: E731
        return replace(right, name=f"{name}: {what}", recording=made, **more)

    def changed(where: Any, what: Any, columns: slice = last) -> Array:
        result = data.copy()
        result[where, columns] = what
        return result

    yield case("as it is", data)
    few = random.random(t.size) < 0.05
    yield case("5 % lost, written as 0", changed(few, 0.0))
    runs = (t % 2.0) > 1.8
    yield case("lost for 0.2 s every 2 s, written as 0", changed(runs, 0.0))
    yield case("the same as gaps", changed(runs, np.nan), widest=POOR)
    kept = np.sort(random.permutation(t.size)[:middle])
    yield case("half of the frames dropped, times counted on", data[kept], t[:middle])
    yield case("half of the frames dropped, with their times", data[kept], t[kept], widest=POOR)
    yield case("half the frames, each twice", np.repeat(data[::2], 2, axis=0)[: t.size])
    shift = 0.03 if markers else 0.1
    yield case("a zero moved halfway", changed(slice(middle, None), data[middle:, last] + shift))
    wild = random.random(data.shape) < 0.04
    outliers = data + np.where(wild, random.normal(0.0, 0.1 if markers else 0.3, data.shape), 0.0)
    yield case("4 % outliers", outliers, widest=POOR)
    yield case("4 % outliers, robust", outliers, loss="cauchy", widest=POOR)
    yield case("held for a second first", np.vstack([np.repeat(data[:1], 30, axis=0), data[:-30]]), widest=POOR)
    yield case("rounded to two digits", np.round(data, 2), widest=POOR)
    if not markers and np.abs(data).max() > np.pi:
        yield case("wrapped", (data + np.pi) % (2.0 * np.pi) - np.pi)
    if not markers and data.shape[1] > 1:
        for late in (0.01, 0.03):
            column = np.interp(t - late, t, data[:, -1])
            yield case(f"last link {1e3 * late:.0f} ms late", np.column_stack([data[:, :-1], column]), widest=POOR)
    if markers and data.shape[1] > 2:
        flipped = data * np.tile([1.0, -1.0], data.shape[1] // 2)
        yield case("y points down", flipped)
        yield case("the last marker stands still", changed(slice(None), data[:1, last] + 1e-3 * data[:, last]))


def turned(places: Array, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return places @ np.array([[c, s], [-s, c]])


def of_ropes() -> Iterator[Case]:
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=8, friction=4e-4)
    t, q = swing(rope, np.full(8, 0.8), 4.0)
    q, truth = noisy(q, 5e-3), ratios(rope)
    guess = rope.replace(friction=1e-3)

    def case(what: str, data: Array, times: Array = t, rope: hf.Rope = guess) -> Case:
        return Case(f"rope of 8 links: {what}", lambda: hf.Recording(times, data), rope, truth, None)

    yield case("default", q)
    yield case("relative angles read as absolute", np.diff(q, axis=1, prepend=0.0))
    yield case("clock x 1.1", q, 1.1 * t)
    yield replace(case(BOTH, q, 1.1 * t, rope=longer(guess, 1.21)), undetectable=True)
    yield case("links in reverse order", q[:, ::-1])
    part = 0.5 ** np.linspace(0.0, 1.0, 8)
    lighter = rope.replace(mass=rope.mass * part, inertia=rope.inertia * part)
    q = noisy(swing(lighter, np.full(8, 0.8), 4.0)[1], 5e-3)
    yield replace(case("half the mass at the tip, held alike", q), truth=ratios(lighter))
    bent = rope.replace(stiffness=1e-3, rest_angle=np.where(np.arange(8) > 0, 0.1, 0.0))
    q = noisy(swing(bent, np.full(8, 0.8), 4.0)[1], 5e-3)
    springy = case("bent at rest, held straight", q, rope=guess.replace(stiffness=2e-3))
    yield replace(springy, truth=ratios(bent))


def real(folder: Path) -> Iterator[Case]:
    """Yield real pendulums with wrong declarations; the truth is an independent fit of the whole recording."""
    # means and scatter of eight parts of each recording, benchmarks/results/windows.md; of all the triple's, by others
    triple = hf.Rope(length=[0.1727, 0.2286, 0.2413], mass=0.1, friction=1e-4)
    truth = {"J/p1": np.array([0.1687, 0.1644, 0.0377]), "p/p1": np.array([1.0, 0.762, 0.197])}
    error = {"J/p1": np.array([2.5e-4, 7.6e-4, 1.7e-4]), "p/p1": np.array([0.0, 1.5e-3, 6.3e-4])}
    part = hf.read_recording(folder / "multiarm_triple" / "TriplePendulumDataForParameterEstimation.mat").window(
        0.0, 8.0
    )
    part = part.decimate(5)
    yield from beside_right(slips("real triple", part.t, part.data, triple, truth, error=error))
    yield from beside_right(real_single(folder))
    yield from beside_right(real_double(folder))


def real_single(folder: Path) -> Iterator[Case]:
    part = hf.read_recording(folder / "multiarm_single" / "SinglePendulumDataForParameterEstimation.mat").window(
        0.0, 8.0
    )
    t, q, guess = part.t[::5], part.data[::5], hf.Rope(length=[0.3], mass=0.1, friction=1e-4)
    truth, error = {"J/p1": np.array([0.1531])}, {"J/p1": np.array([9e-5])}

    def case(what: str, data: Array, times: Array = t) -> Case:
        return Case(f"real single: {what}", lambda: hf.Recording(times, data), guess, truth, error=error)

    yield case("as it is", q)
    yield case("angles x 0.9", 0.9 * q)
    yield case("zero off by 5 degrees", q + 0.09)
    yield case("half the frame rate", q, 2.0 * t)
    yield replace(case("clock x 1.1: a pendulum of more inertia", q, 1.1 * t), undetectable=True)


def real_double(folder: Path) -> Iterator[Case]:
    """Yield IBM 16 with wrong declarations, and a part of IBM 06 with only the tip visible and a rolled camera."""
    folder = folder / "ibm_double_pendulum"
    truth = {"J/p1": np.array([0.0906, 0.00691]), "p/p1": np.array([1.0, 0.1022])}
    error = {"J/p1": np.array([3.0e-4, 6.6e-5]), "p/p1": np.array([0.0, 1.0e-3])}
    markers = hf.read_recording(folder / "run16_500Hz.csv", time_unit="s", unit="m", y_axis="up").window(10.0, 16.0)
    guess = hf.Rope(length=markers.link_lengths(), mass=0.1, friction=1e-5)
    part = markers.angles()
    yield from slips("real double", part.t, part.data, guess, truth, error=error)
    places = markers.data.reshape(markers.t.size, -1, 2)
    for what, meant in (("y points down", places * [1.0, -1.0]), ("x and y swapped", places[:, :, ::-1])):
        wrong = replace(markers, data=meant.reshape(markers.t.size, -1))
        yield Case(f"real double, markers: {what}", lambda wrong=wrong: wrong, guess, truth, error=error)
    every = hf.read_recording(folder / "run06_500Hz.csv", time_unit="s", unit="m", y_axis="up").window(20.0, 28.0)
    tip = hf.Recording(every.t, every.data[:, 4:], kind="markers", noise=1e-3)
    setup = {"arc_lengths": [every.link_lengths().sum()], "origin": np.nanmedian(every.data[:, :2], axis=0)}
    guess = hf.Rope(every.link_lengths(), mass=0.1, inertia=[4e-5, 2e-5], com=[0.06, 0.02], friction=2e-5)
    yield Case("real double: the tip's alone of IBM 06", lambda: tip, guess, truth, setup=setup, error=error)


class Outcome(NamedTuple):
    """How a case ends: refused, do not use, right, suspicion, undetectable, WIDE or WRONG; its first line and kind.

    For usable values: the number of 95 % intervals that contain the truth, and of all intervals.
    """

    end: str
    line: str
    kind: Kind | None = None
    held: int = 0
    intervals: int = 0


class Compared(NamedTuple):
    """Distance of the truth from an estimate over half its 95 % interval, and the excess width of the interval.

    The interval is widened by the error of a measured truth.
    """

    away: float
    width: float


def outcome(case: Case) -> Outcome:
    """Fit, and compare with the truth."""
    try:
        found = hf.identify(
            case.recording(),
            case.guess,
            case.free,
            setup=hf.RecordingSetup(**case.setup),
            options=hf.FitOptions(loss=case.loss),
        )
    except HyperflexError as error:
        return Outcome("refused", str(error))
    first = found.findings[0]
    line = f"{found.grade.capitalize()}: {text(first)}"
    if found.grade is Grade.DO_NOT_USE:
        return Outcome("do not use", line, first.kind)
    every = compared(found, case)
    holds = all(each.away <= together(len(every)) for each in every)
    if every and holds and all(each.width <= 1.0 for each in every):
        return Outcome("right", line, first.kind, sum(each.away <= 1.0 for each in every), len(every))
    if case.undetectable and found.has(Kind.UNTESTED, Kind.UNDETECTABLE):
        return Outcome("undetectable", line, first.kind)
    named = first.kind in CAUSES.get(case.wrong, ())
    if named and case.right is not None and line != outcome(case.right).line:
        return Outcome("suspicion", line, first.kind)
    return Outcome("WIDE" if holds else "WRONG", line, first.kind)


def compared(found: hf.Identification, case: Case) -> list[Compared]:
    """Return each interval of usable values with the truth; poorly determined values may have any width."""
    usable = found.ratios | (found.values if found.grade is Grade.USABLE else {})
    loose = (each.values["parts"] for each in found.findings if each.kind is Kind.POORLY_DETERMINED)
    unknown = {name for names in loose for name in names}
    model_error = any(each.kind is Kind.FRICTION_MODEL and each.values["included"] for each in found.findings)
    every = []
    for name in usable.keys() & case.truth.keys():
        errors = np.broadcast_to(case.error.get(name, 0.0), case.truth[name].shape)
        for k, (value, true, error) in enumerate(zip(usable[name], case.truth[name], errors, strict=True)):
            label = f"{name}[{k}]"
            interval = found.intervals.get(label)
            if interval is None or label in found.held or (name == "p/p1" and k == 0):
                continue
            side = interval.high - value if true > value else value - interval.low
            allowed = case.widest if name in found.ratios else max(case.widest, WEIGHED)
            if name in FRICTIONS:
                allowed = np.inf if model_error else FRICTION
            if {label, name} & unknown:
                allowed = np.inf
            width = 0.5 * (interval.high - interval.low) / (allowed * abs(true)) if true else 0.0
            every.append(Compared(float(abs(true - value) / np.hypot(side, BAND * error)), float(width)))
    return every


def together(count: int) -> float:
    """Return the factor on 95 % intervals for a joint coverage of 95 % of `count` intervals (Bonferroni)."""
    return float(ndtri(1.0 - 0.025 / max(count, 1)) / BAND)


def table(rows: list[tuple[str, Outcome]]) -> str:
    head = "| input | ends | first line |\n|---|---|---|\n"
    return head + "".join(f"| {name} | {each.end} | {each.line.replace('|', '/')} |\n" for name, each in rows)


@cache
def cases(data: Path | None, only: str = "") -> list[Case]:
    return [case for case in (*simulated(), *(real(data) if data else ())) if only in case.name]


def ended(which: int, data: Path | None, only: str) -> tuple[str, Outcome]:
    """Return the name of a case, and how it ends."""
    began = time.process_time()
    case = cases(data, only)[which]
    found = outcome(case)
    sys.stderr.write(f"{time.process_time() - began:5.1f} s  {found.end:10s} {case.name}: {found.line[:120]}\n")
    return case.name, found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with the real recordings")
    parser.add_argument("--workers", type=int, default=1, help="processes (1)")
    parser.add_argument("--out", default="benchmarks/results/wrong-input.md", help="- writes nothing")
    parser.add_argument("--only", default="", help="words in the names of the cases to run; writes nothing")
    options = parser.parse_args()
    count = len(cases(options.data, options.only))
    with ProcessPoolExecutor(options.workers, get_context("forkserver")) as pool:
        rows = list(pool.map(partial(ended, data=options.data, only=options.only), range(count)))
    intervals, held = (sum(getattr(each, name) for _, each in rows) for name in ("intervals", "held"))
    if options.out != "-" and not options.only:
        page = PAGE.format(table=table(rows), count=count, intervals=intervals, held=held)
        files.write_text(Path(options.out), page)
    return int(any(each.end in ("WRONG", "WIDE") for _, each in rows))


PAGE = f"""# Wrong and poor inputs

What `identify` reports for {{count}} wrong and right inputs, simulated unless called real. Each input is refused, or
graded "do not use", or its usable values are "right", or its first line names the mistake ("suspicion"; the script
lists the allowed findings for each mistake). The rest is "undetectable": the recording is exactly that of another rope
with a right clock and right lengths. One of its findings then states the effect of each per cent, and the standard
deviations include `clock_std` and `length_std`. A test shows that these motions are exactly alike.

A result is "right" if its 95 % intervals, widened to a joint coverage of 95 %, contain the truth: all ratios, and the
values that are called usable; the truth of a real pendulum has its own standard deviation. The intervals must also be
narrow: at most {NARROW:.0%} of the value to either side ({POOR:.0%} for a poor recording: noisy, short, with gaps or
forces; {WEIGHED:.0%} for a mass or inertia determined from a torque; {FRICTION:.0%} for a friction), except for values
reported as poorly determined and frictions reported as a model error. A wider one is "WIDE", one that misses the truth
is "WRONG". {{held}} of the {{intervals}} intervals contain the truth without being widened.

Reproduce: `python -m benchmarks.wrong_input --data FOLDER`

{{table}}"""

if __name__ == "__main__":
    raise SystemExit(main())
