"""What identify says of wrong and poor inputs, simulated and real.

python -m benchmarks.wrong_input --data FOLDER     all cases; the table goes to docs/wrong-input.md
python -m benchmarks.wrong_input --out -           simulated cases alone; nothing is written

Each case must end in one of five ways: it is refused; it is graded "do not use"; its ratios hold the truth; its first
line names what is wrong with it, and the right recording gets another one; or the recording is exactly that of another
rope, and the reasons say by how much each per cent counts. The exit code is 1 where one is called usable and is wrong.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import HyperflexError
from hyperflex.identification import ratios
from hyperflex.identification.diagnosis.misdeclared import UNDETECTABLE_CLOCK, UNDETECTABLE_SCALE

Array = np.ndarray
TIMES_OR_LENGTHS = ("times or lengths may be off", "lengths seem")
NAMES = {  # what is wrong, as in a case's name: what a first line must say if its ratios are wrong
    "drifts": ("the clock seems to drift",),
    "clock x": TIMES_OR_LENGTHS,
    "frame rate": TIMES_OR_LENGTHS,
    "length": TIMES_OR_LENGTHS,
    "scale": TIMES_OR_LENGTHS,
    "zero off": ("the zero of the angles",),
    "turned": ("the zero of the angles", "gravity is turned"),
    "com held": ("'com' may be off",),
    "masses held": ("'mass' may be off", "'com' may be off"),
    "inertia held": ("'inertia' may be off",),
}
BOTH = "clock x 1.1 and lengths x 1.21: a longer rope that moves alike"
DOUBLE = hf.Rope(length=[0.3, 0.25], mass=[0.1, 0.06], com=[0.14, 0.13], inertia=[8e-4, 3.5e-4], friction=[3e-4, 1e-4])
SINGLE = hf.Rope(length=[0.3], mass=[0.1], com=[0.14], inertia=[7.5e-4], friction=[2e-4])
FREE = ("inertia", "com", "friction")
TIMES = 3.0  # standard deviations within which a ratio holds the truth; of 60 cases some are beyond 2
REAL_ERROR = 0.01  # of ratios of real pendulums: what independent fits of all data differ by


@dataclass(frozen=True)
class Case:
    """A recording, what is said of it, and the true ratios."""

    name: str
    recording: Callable[[], hf.Recording]
    guess: hf.Rope
    truth: dict[str, Array]
    free: tuple[str, ...] | None = FREE
    options: dict[str, Any] = field(default_factory=dict)
    error: float = 0.0  # relative, of the truth
    undetectable: bool = False  # another rope makes exactly this recording
    right: Case | None = None  # the same, declared as it is


def swing(rope: hf.Rope, q0: Any, duration: float = 6.0, rate: float = 50.0, **drive: Any) -> tuple[Array, Array]:
    t = np.arange(round(duration * rate)) / rate
    return t, hf.simulate(rope, duration=float(t[-1]), t_eval=t, q0=q0, tol=1e-9, **drive).q


def noisy(values: Array, size: float = 2e-3, seed: int = 0) -> Array:
    return values + size * np.random.default_rng(seed).standard_normal(values.shape)


def slips(name: str, t: Array, q: Array, guess: hf.Rope, truth: dict[str, Array], **more: Any) -> Iterator[Case]:
    """Yield the angles of two links or more, declared wrongly in every usual way."""
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


def longer(rope: hf.Rope, factor: Any) -> hf.Rope:
    """The rope with all that goes with its lengths."""
    return rope.replace(length=rope.length * factor, com=rope.com * factor, inertia=rope.inertia * factor**2)


def simulated() -> Iterator[Case]:
    """Yield twins, each with the case that is declared as it is."""
    guess = DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4)
    t, q = swing(DOUBLE, [0.9, 0.6])
    q = noisy(q)
    truth = ratios(DOUBLE)
    double = [*slips("double", t, q, guess, truth), *poor(t, q, guess, truth), *held(t, q, truth)]
    for cases in (double, of_single(), of_markers(guess, truth), of_ropes()):
        yield from beside_right(cases)


def beside_right(cases: Iterable[Case]) -> Iterator[Case]:
    """Yield cases of one motion, of which the first is declared as it is, each with that one."""
    right, *others = cases
    yield right
    yield from (replace(case, right=right) for case in others)


def poor(t: Array, q: Array, guess: hf.Rope, truth: dict[str, Array]) -> Iterator[Case]:
    def case(what: str, data: Array, times: Array = t, rope: hf.Rope = guess, **more: Any) -> Case:
        return Case(f"double: {what}", lambda: hf.Recording(times, data), rope, truth, **more)

    random = np.random.default_rng(1)
    yield case("40 % of samples missing", np.where(random.random(q.shape) < 0.4, np.nan, q))
    spoiled = q.copy()
    spoiled[random.random(q.shape) < 0.03] += 2.0
    yield case("3 % outliers", spoiled)
    yield case("3 % outliers, robust", spoiled, options={"loss": "cauchy"})
    yield case("noise of a tenth of the motion", noisy(q, 0.06, 2))
    yield case("nothing moves", 1e-5 * q)
    yield case("a motor hums: a force that is not declared", q + 0.02 * np.sin(2.0 * np.pi * 3.0 * t)[:, None])
    yield case("the base sways", q + 0.1 * np.sin(2.0 * np.pi * 0.4 * t)[:, None])
    yield case("one second of it", q[:50], t[:50])
    yield case("a tenth of a second of it", q[:6], t[:6])
    yield case("guess off by 3", q, rope=guess.replace(inertia=guess.inertia * 3.0, friction=guess.friction / 3.0))
    yield case("guess of one mass for both", q, rope=guess.replace(mass=0.1))
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
    yield case("dry friction free, at 0", DOUBLE.replace(dry_friction=0.0), (*FREE, "dry_friction"))


def of_single() -> Iterator[Case]:
    t, q = swing(SINGLE, [1.0])
    q, truth = noisy(q), ratios(SINGLE)
    guess = SINGLE.replace(inertia=1e-3, friction=5e-4)

    def case(what: str, data: Array, times: Array = t, rope: hf.Rope = guess) -> Case:
        return Case(f"single: {what}", lambda: hf.Recording(times, data), rope, truth, ("inertia", "friction"))

    yield case("as it is", q)
    yield replace(case("clock x 1.1: a pendulum of more inertia", q, 1.1 * t), undetectable=True)
    yield case("half the frame rate", q, 2.0 * t)
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
    yield case("scale x 1.1", 1.1 * places)
    yield case("scale x 1.1, places fitted", 1.1 * places, options={"arc_lengths": [0.0, 0.3, 0.55]})
    yield case("millimetres read as metres", 1e3 * places)
    arcs = {"arc_lengths": [0.55], "origin": (0.0, 0.0)}
    yield case("the tip's alone", places[:, 2:], options=arcs)
    yield case("the tip's alone, the origin off by 3 cm", places[:, 2:], options=arcs | {"origin": (0.03, 0.0)})
    yield case("the tip's alone, y points down", places[:, 2:] * [1.0, -1.0], options=arcs)


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


def real(folder: Path) -> Iterator[Case]:
    """Yield real pendulums, declared wrongly; the truth is what all of a recording says, fitted by others."""
    triple = hf.Rope(length=[0.1727, 0.2286, 0.2413], mass=0.1, friction=1e-4)
    truth = {"J/p1": np.array([0.1687, 0.1644, 0.0377]), "p/p1": np.array([1.0, 0.762, 0.197])}
    path = folder / "multiarm_triple" / "TriplePendulumDataForParameterEstimation.mat"
    if path.exists():
        part = hf.read_recording(path).window(0.0, 8.0).decimate(5)
        yield from beside_right(slips("real triple", part.t, part.data, triple, truth, error=REAL_ERROR))
    path = folder / "ibm_double_pendulum" / "run16_500Hz.csv"
    if path.exists():
        markers = hf.read_recording(path, time_unit="s", unit="m", y_axis="up").window(10.0, 16.0)
        guess = hf.Rope(length=markers.link_lengths(), mass=0.1, friction=1e-5)
        own = {"J/p1": np.array([0.0906, 0.00691]), "p/p1": np.array([1.0, 0.1022])}
        part = markers.angles()
        yield from beside_right(slips("real double", part.t, part.data, guess, own, error=REAL_ERROR))


def outcome(case: Case) -> tuple[str, str]:
    """How a case ends (refused, do not use, right, suspicion, cannot be told, WRONG), and its first line."""
    try:
        found = hf.identify(case.recording(), case.guess, case.free, **case.options)
    except HyperflexError as error:
        return "refused", str(error)
    line = str(found.grade)
    if found.grade.name == "do not use":
        return "do not use", line
    off = [
        np.abs(found.ratios[name] - case.truth[name])
        > TIMES * np.hypot(found.ratio_std[name], case.error * np.abs(case.truth[name]) / TIMES) + 1e-12
        for name in ("J/p1", "p/p1")
    ]
    if not np.any(off):
        return "right", line
    said = next(
        (each for each in found.grade.reasons for words in (UNDETECTABLE_CLOCK, UNDETECTABLE_SCALE) if words in each),
        "",
    )
    if case.undetectable and said:
        return "cannot be told", line if said in line else f"{line} {said[0].upper()}{said[1:]}"
    named = [words for what, every in NAMES.items() if what in case.name for words in every]
    own = any(words in line for words in named) and case.right is not None and line != outcome(case.right)[1]
    return "suspicion" if own else "WRONG", line


def table(rows: list[tuple[str, str, str]]) -> str:
    head = "| input | ends | first line |\n|---|---|---|\n"
    return head + "".join(f"| {name} | {end} | {line.replace('|', '/')} |\n" for name, end, line in rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with the real recordings")
    parser.add_argument("--out", default="docs/wrong-input.md", help="- writes nothing")
    options = parser.parse_args()
    cases = [*simulated(), *(real(options.data) if options.data else ())]
    rows = []
    for case in cases:
        began = time.perf_counter()
        rows.append((case.name, *outcome(case)))
        sys.stderr.write(f"{time.perf_counter() - began:5.1f} s  {rows[-1][1]:10s} {case.name}: {rows[-1][2][:120]}\n")
    if options.out != "-":
        files.write_text(Path(options.out), PAGE.format(table=table(rows), count=len(rows)))
    return int(any(end == "WRONG" for _, end, _ in rows))


PAGE = """# Wrong and poor inputs

What `identify` says of {count} inputs that are not what they should be, or are. Simulated, but for those called
real. Each is refused, or graded "do not use", or its ratios hold the truth ("right"), or its first line names
what is wrong, which the right recording's does not ("suspicion"). The rest "cannot be told": exactly such a
recording comes of another rope, with a right clock and right lengths, so that nothing in it can show the slip;
the reasons say by how much each per cent counts. A test holds this, and that these motions are exactly alike;
`python -m benchmarks.wrong_input --data FOLDER` writes this page.

{table}"""

if __name__ == "__main__":
    raise SystemExit(main())
