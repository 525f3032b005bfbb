"""Time of an identification: the paper's problem from many starts, compared with the paper's method; a 50-link rope."""

import statistics
import time
from dataclasses import replace
from types import ModuleType
from typing import Any, Literal

import numpy as np
import recorded
from clock import NOTE, alternately

import hyperflex as hf
from hyperflex.identification import identify
from hyperflex.identification.measurements import measure as measured
from hyperflex.identification.measurements import usual_length
from hyperflex.identification.model import Parameters, Plant, parse
from hyperflex.identification.multi_start import MultiStart
from hyperflex.paper import iterative_revision

RATE = 7.5  # frames a second
# The paper's identification rope, as far as it can be inferred: 1.0 m, cylinder moment for a first guess
PAPER = hf.Rope(length=np.full(5, 0.2), mass=1.53e-3, inertia=0.143e-6, friction=0.631e-3)
GUESS = {"inertia": 5.09e-6, "friction": 1.26e-3}
FREE = ["inertia:shared", "friction:shared"]
ANGLE_NOISE = 0.01  # rad: leaves the paper's 0.04 rad^2
STARTS, DECADES, SHIFT = 20, 2.0, 0.2  # draws: over two decades in J and eta, 0.2 rad in the angles
SAME = 1e-3  # of the cost: optima that differ by less count as equal
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
MARKERS, PLACE_NOISE = 10, 2e-3  # m


def measure(quick: bool, repeats: int, _peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of {problem, method, seconds, error, ...}; a fit that does not converge is an error."""
    recording = paper_recording()
    rows = [*paper_problem(recording, repeats), *starts(recording, 4 if quick else STARTS)]
    if not quick:
        rows.append(paper_method(recording))
    rows.append(cable_problem(3 if quick else repeats))
    return [*rows, *recorded.measure(quick)]


def paper_recording() -> hf.Recording:
    """81 frames of the 5-link rope, swinging freely (simulated)."""
    t = np.arange(81) / RATE
    run = hf.simulate(PAPER, duration=t[-1], t_eval=t, q0=np.linspace(0.9, 1.3, 5), tol=1e-9)
    return hf.Recording(t, run.q + ANGLE_NOISE * np.random.default_rng(0).standard_normal(run.q.shape))


def row(
    problem: str, method: str, seconds: float, error: float, values: tuple[float, float], clock: float | None = None
) -> dict[str, Any]:
    """A row of the table; `values` are J and eta, `seconds` processor time, `clock` elapsed time."""
    row = {"problem": problem, "method": method, "seconds": seconds, "clock": clock or seconds, "error": error}
    return row | {"inertia": float(values[0]), "friction": float(values[1])}


def paper_problem(recording: hf.Recording, repeats: int) -> list[dict[str, Any]]:
    """hyperflex's method from the cylinder's moment: the fit with its covariance, and with profiled intervals too."""

    def run(intervals: Literal["profile"] | None = None) -> hf.Identification:
        return identify(
            recording,
            PAPER.replace(**GUESS),
            FREE,
            options=hf.FitOptions(window=np.inf, train=np.inf, intervals=intervals),
        )

    def profiled() -> hf.Identification:
        return run("profile")

    found = run()
    if not found.success:
        raise RuntimeError(f"the paper's problem: {found.message}")
    profiled()
    error = float((found.residuals**2).sum())
    values = found.values["inertia"][0], found.values["friction"][0]
    names = "shooting, from the cylinder's moment", "shooting, with profiled intervals"
    timed = alternately([run, profiled], repeats, 10.0)
    return [
        row("5 links, 81 frames", name, one.median, error, values, statistics.median(one.clock))
        for name, one in zip(names, timed, strict=True)
    ]


def starts(recording: hf.Recording, count: int) -> list[dict[str, Any]]:
    """The fit from random starts: how many reach the same optimum."""
    rows = []
    for number in range(count):
        rng = np.random.default_rng([1, number])
        wide = 0.5 * DECADES * np.log(10.0)
        inertia, friction = (
            PAPER.inertia[0] * np.exp(rng.uniform(-wide, wide)),
            PAPER.friction[0] * np.exp(rng.uniform(-wide, wide)),
        )
        guess = PAPER.replace(inertia=inertia, friction=friction)
        plant = Plant(Parameters(guess, parse(guess, FREE)))
        exact = measured(recording, guess, None).channels
        shifted = hf.Recording(exact.t, exact.data + rng.uniform(-SHIFT, SHIFT, 5))
        began = time.perf_counter()
        usual = usual_length(exact, guess)
        seen = replace(measured(exact, guess, None), shape=shifted)
        *_, last = MultiStart(plant, seen, 1.001 * exact.duration, usual).fits()
        found = last.fit
        values = plant.parameters.values(found.x)
        rows.append(row("5 links, 81 frames", f"start {number}", time.perf_counter() - began, found.cost, values))
    return rows


def paper_method(recording: hf.Recording) -> dict[str, Any]:
    """The paper's method on the same frames: downhill simplex and least squares in turn."""
    found = iterative_revision(recording, PAPER.replace(**GUESS))
    method, values = f"downhill simplex (IR): {found.message}", (found.best.inertia, found.best.friction)
    return row("5 links, 81 frames", method, found.seconds, found.error, values)


def cable_problem(repeats: int) -> dict[str, Any]:
    """Ten markers on the paper's cable for three seconds: friction and the initial state of 50 links."""
    t = np.arange(23) / RATE
    run = hf.simulate(CABLE, duration=t[-1], t_eval=t, q0=0.9 + 0.5 * (np.arange(50) + 0.5) / 50, tol=1e-8)
    joints = 5 * (np.arange(MARKERS) + 1)
    places = run.joints[:, joints] + PLACE_NOISE * np.random.default_rng(0).standard_normal((t.size, MARKERS, 2))
    recording = hf.Recording(t, places.reshape(t.size, -1), kind="markers", noise=PLACE_NOISE)
    guess = CABLE.replace(friction=1.5e-3)

    def fit() -> hf.Identification:
        return identify(
            recording,
            guess,
            ["friction:shared"],
            setup=hf.RecordingSetup(arc_lengths=0.04 * joints),
            options=hf.FitOptions(window=np.inf, train=np.inf),
        )

    found = fit()
    if not found.success:
        raise RuntimeError(f"50 links: {found.message}")
    (timed,) = alternately([fit], repeats, 10.0)
    error, friction = float((found.residuals**2).mean()) ** 0.5, float(found.values["friction"][0])
    clock = statistics.median(timed.clock)
    made = row("50 links, 10 markers, 3 s", "shooting", timed.median, error, (float("nan"), friction), clock)
    return made | {"std": float(found.std["friction"][0])}


def text(rows: list[dict[str, Any]], _peers: dict[str, ModuleType]) -> str:
    """Return the Markdown page."""
    demanding = [r for r in rows if "accuracy" in r]
    rows = [r for r in rows if r not in demanding]
    ours, cable = rows[0], rows[-1]
    drawn = [r for r in rows if r["method"].startswith("start")]
    same = [r for r in drawn if abs(r["error"] / ours["error"] - 1.0) < SAME]
    slowest = max(r["seconds"] for r in drawn)
    lines = [
        "| problem | method | s | elapsed, s | error | J, kg m^2 | eta, N m s/rad |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [line(r, f"{r['error']:.5f} rad^2") for r in rows if r not in drawn and r is not cable]
    lines.append(line(cable, f"{1e3 * cable['error']:.2f} mm rms"))
    return "\n".join(lines) + (
        f"\n\nSimulated recordings, {RATE:g} frames a second. True values: J {PAPER.inertia[0]:.3g}, eta "
        f"{PAPER.friction[0]:.4g}; of the cable eta {CABLE.friction[0]:.3g}, estimated with a standard deviation of "
        f"{cable['std']:.1g} (J fixed). {len(same)} of {len(drawn)} starts, drawn over {DECADES:g} decades in J and "
        f"eta and {SHIFT:g} rad in the angles, reach the same optimum (cost within {SAME:g}); the slowest took "
        f"{slowest:.2g} s. {NOTE}\n\n{recorded.text(demanding)}"
    )


def line(row: dict[str, Any], error: str) -> str:
    """A line of the Markdown table."""
    inertia = "held" if np.isnan(row["inertia"]) else f"{row['inertia']:.3g}"
    return (
        f"| {row['problem']} | {row['method']} | {row['seconds']:.3g} | {row['clock']:.3g} | {error} | {inertia} | "
        f"{row['friction']:.4g} |"
    )
