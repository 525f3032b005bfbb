"""Work-precision diagram: error of the tip against time, every simulator on the same cast in the same run."""

import math
from pathlib import Path
from types import ModuleType
from typing import Any

import figures
import numpy as np
from cast import distance_mm, paper_cast
from clock import NOTE, alternately

GOOD = 1.0  # mm at 2 s and at 5 s
BUDGET, QUICK_BUDGET = 8.0, 1.0  # s of processor time for one setting


def measure(quick: bool, repeats: int, peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of {simulator, method, setting, arm, adaptive, error_mm: [at 2, 5, 10 s], ms_per_simulated_s: {...}}."""
    cast = paper_cast()
    true = cast.reference()
    entries = [(module.DRIVE, one) for module in peers.values() for one in module.contestants(cast, quick)]
    budget = QUICK_BUDGET if quick else BUDGET
    with np.errstate(all="ignore"):  # an unstable step gives errors that are not numbers, and is shown so
        timed = alternately([one.run for _, one in entries], repeats, budget)
        errors = [distance_mm(times.result, true) for times in timed]
    rows = [
        {
            "simulator": one.simulator,
            "method": one.method,
            "setting": one.setting,
            "arm": arm,
            "adaptive": one.adaptive,
            "error_mm": [float(x) if math.isfinite(x) else None for x in error],
            "ms_per_simulated_s": times.scaled(1e3 / cast.duration),
        }
        for (arm, one), error, times in zip(entries, errors, timed, strict=True)
    ]
    strangers = {row["simulator"] for row in rows} - set(fastest(rows))
    if strangers:
        raise RuntimeError(f"{strangers} give another tip at every setting: not the same model")
    return rows


def good(row: dict[str, Any]) -> bool:
    """Whether a setting stays within GOOD at 2 s and 5 s, and finite to the end."""
    return None not in row["error_mm"] and max(row["error_mm"][:2]) < GOOD


def fastest(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """The fastest accurate setting of each simulator, fastest first."""
    best: dict[str, dict[str, Any]] = {}
    for row in sorted(filter(good, rows), key=lambda row: row["ms_per_simulated_s"]["median"]):
        best.setdefault(row["simulator"], row)
    return best


def text(rows: list[dict[str, Any]], peers: dict[str, ModuleType]) -> str:
    """Return the Markdown tables and their explanation."""
    head = "simulator | method | setting | error at 2 s, mm | at 5 s, mm"
    lines = [
        f"| {head} | ms per simulated s (least-most) | adaptive | arm |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        two, five, _ = (f"{x:.2g}" if x is not None else "lost" for x in row["error_mm"])
        cost = row["ms_per_simulated_s"]
        spread = f"{cost['median']:.3g} ({cost['least']:.3g}-{cost['most']:.3g})"
        adaptive = "yes" if row["adaptive"] else "no"
        lines.append(f"| {_names(row)} | {two} | {five} | {spread} | {adaptive} | {row['arm']} |")
    best = fastest(rows)
    lines += ["", f"Fastest setting of each simulator below {GOOD:g} mm at 2 s and at 5 s:", ""]
    lines += ["| simulator | method | setting | ms per simulated s | times hyperflex |", "|---|---|---|---|---|"]
    own = best["hyperflex"]["ms_per_simulated_s"]["median"]
    for row in best.values():
        cost = row["ms_per_simulated_s"]["median"]
        lines.append(f"| {_names(row)} | {cost:.3g} | {cost / own:.3g} |")
    lines += ["", "How the arm is driven:", ""]
    lines += [f"- {module.NAME}: {module.ARM}." for module in peers.values()]
    return (
        verdict(best)
        + "\n".join(lines)
        + (
            "\n\n50 links, 10 s of casting from rest (t_a = 0.73 s, t_c = 0.53 s, bang-bang). Reference: classical "
            "Runge-Kutta with steps of 0.1 ms on the O(n) accelerations; Pinocchio's rows share no code with it. "
            "hyperflex is called as users call it: checks, output, energies and guards are part of its time. The "
            "times of the peers are those of the integration only, without building the model. Each peer has its best "
            f"settings; benchmarks/peers_*.py list the other ones tried. 'Lost': not a number before 10 s. {NOTE}"
        )
    )


def verdict(best: dict[str, dict[str, Any]]) -> str:
    """Time of the fastest accurate setting of each other simulator, relative to hyperflex."""
    own = best["hyperflex"]
    cost = own["ms_per_simulated_s"]["median"]
    lines = (
        f"With errors of the tip below {GOOD:g} mm both at 2 s and at 5 s, hyperflex ({own['setting']}) takes "
        f"**{cost:.3g} ms per simulated second**. The fastest setting of each other simulator below {GOOD:g} mm:\n\n"
    )
    for name, row in best.items():
        if row is not own:
            other = row["ms_per_simulated_s"]["median"]
            lines += (
                f"- {name} ({row['method']}, {row['setting']}): {other:.3g} ms, **{other / cost:.0f} times** that\n"
            )
    return f"{lines}\n" if len(best) > 1 else ""


def _names(row: dict[str, Any]) -> str:
    return f"{row['simulator']} | {row['method']} | {row['setting']}"


def figure(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the larger of the errors at 2 s and 5 s against time."""
    groups: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in rows:
        if None not in row["error_mm"]:
            point = (max(row["error_mm"][:2]), row["ms_per_simulated_s"]["median"])
            groups.setdefault((row["simulator"], row["method"]), []).append(point)
    arms: dict[str, dict[str, None]] = {}  # simulators by the way of driving the arm
    for row in rows:
        arms.setdefault(row["arm"], {})[row["simulator"].split(",")[0]] = None
    driven = "; ".join(f"{arm} ({', '.join(names)})" for arm, names in arms.items())
    figures.work_precision(groups, GOOD, f"How the arm is driven: {driven}", path)
