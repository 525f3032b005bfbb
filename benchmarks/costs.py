"""Cost and error of a run against tolerance, friction, springs, dry friction, motion and outputs."""

from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
from cast import FRICTION, Cast, distance_mm, paper_cast
from clock import NOTE, alternately
from peers_hyperflex import run, steps

import hyperflex as hf
from hyperflex.model import DEFAULT_TOL

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)  # m
SPACING = 0.01  # s, between the samples of the greatest error
OUTPUTS = (1, 10, 100, 1000)  # per simulated second
BUDGET, QUICK_BUDGET = 3.0, 0.5  # s of processor time for one entry


@dataclass(frozen=True)
class Entry:
    """The paper's cast with one thing changed."""

    group: str
    value: str
    cast: Cast
    tol: float = DEFAULT_TOL


def changed(cast: Cast, group: str, unit: str, **values: tuple[float, ...]) -> list[Entry]:
    """Entries with one property of the rope changed, equal for all joints."""
    ((name, each),) = values.items()
    return [Entry(group, f"{x:g} {unit}", replace(cast, rope=cast.rope.replace(**{name: x}))) for x in each]


def entries(quick: bool) -> list[Entry]:
    """All entries; with --quick one or two of each group."""
    cast = paper_cast()
    every = [Entry("tol", f"{tol:g} m", cast, tol) for tol in TOLERANCES]
    every += changed(cast, "friction of a joint", "N m s/rad", friction=(0.05, 5e-3, FRICTION, 5e-5, 5e-6, 0.0))
    every += changed(cast, "stiffness of a joint", "N m/rad", stiffness=(0.0, 0.01, 0.1, 1.0, 10.0))
    every += changed(cast, "dry friction of a joint", "N m", dry_friction=(0.0, 1e-4, 1e-3, 1e-2))
    for profile in ("bang-bang", "ramp", "minimum-jerk"):
        motion = hf.arm_swings(t_move=0.73, t_rest=0.53, profile=profile)
        every.append(Entry("the arm's way", profile, replace(cast, motion=motion)))
    for rate in OUTPUTS:
        times = np.arange(1, round(rate * cast.duration) + 1) / rate
        every.append(Entry("outputs", f"{rate} a second", replace(cast, times=times)))
    return [one for k, one in enumerate(every) if not quick or k % 5 == 1]


def measure(quick: bool, repeats: int, _peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of {group, value, steps_per_simulated_s, ms_per_simulated_s}; rows of tolerances have errors as well."""
    every = entries(quick)
    run(paper_cast(times=(SPACING,)))  # loads the kernels
    runs = [lambda one=one: run(one.cast, tol=one.tol) for one in every]
    rows = []
    for one, times in zip(every, alternately(runs, repeats, QUICK_BUDGET if quick else BUDGET), strict=True):
        row = {
            "group": one.group,
            "value": one.value,
            "steps_per_simulated_s": steps(one.cast, one.tol) / one.cast.duration,
            "ms_per_simulated_s": times.scaled(1e3 / one.cast.duration),
        }
        rows.append(row | (errors(one) if one.group == "tol" else {}))
    return rows


def errors(one: Entry) -> dict[str, Any]:
    """Errors of the tip, mm, and of the energy, J, at every SPACING."""
    times = SPACING * np.arange(1, round(one.cast.duration / SPACING) + 1)
    cast = replace(one.cast, times=times)
    found = hf.simulate(cast.rope, cast.motion, arm=cast.arm, duration=cast.duration, t_eval=times, tol=one.tol)
    gap = distance_mm(found.tip, cast.reference())
    at = {f"at {t:g} s": float(gap[np.argmin(np.abs(times - t))]) for t in (2.0, 5.0)}
    return {"error_mm": at | {"greatest": float(gap.max())}, "energy_J": float(np.abs(found.energy_error).max())}


def text(rows: list[dict[str, Any]], _peers: dict[str, ModuleType]) -> str:
    """Return the Markdown tables."""
    lines = [
        "| tol | error at 2 s, mm | at 5 s, mm | greatest in 10 s, mm | greatest energy error, J |",
        "|---" * 5 + "|",
    ]
    for row in rows:
        if "error_mm" in row:
            cells = [*row["error_mm"].values(), row["energy_J"]]
            lines.append(f"| {row['value']} | {' | '.join(f'{x:.2g}' for x in cells)} |")
    lines += ["", "| what | value | steps per simulated s | ms per simulated s (least-most) |", "|---" * 4 + "|"]
    for row in rows:
        cost = row["ms_per_simulated_s"]
        spread = f"{cost['median']:.3g} ({cost['least']:.3g}-{cost['most']:.3g})"
        lines.append(f"| {row['group']} | {row['value']} | {row['steps_per_simulated_s']:.3g} | {spread} |")
    return "\n".join(lines) + (
        f"\n\nThe paper's cast, 50 links, 10 s, with one thing changed in each row. tol is {DEFAULT_TOL:g} m unless it "
        "is changed, and the outputs are at 2 s, 5 s and 10 s. Errors of the tip are differences from classical "
        f"Runge-Kutta with steps of 0.1 ms, every 10 ms. The number of steps includes rejected ones. {NOTE}"
    )
