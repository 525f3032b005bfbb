"""Many ropes at once: simulated seconds per second, at settings checked for every member."""

import math
import statistics
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import figures
import numpy as np
from cast import FRICTION, LENGTH, MASS, PAPER_LINKS, RADIUS, distance_mm
from clock import Times, alternately

import hyperflex as hf
from hyperflex.checks import Array

SIZES = ((PAPER_LINKS, 512), (PAPER_LINKS, 2048), (20, 512), (100, 512))  # links, members
QUICK = ((PAPER_LINKS, 32),)
DURATION = 2.0  # s
SPREAD = 0.2
GOOD = 0.1  # mm, the greatest error of any member
TIGHT = 1e-9  # m, tolerance of the single run by `simulate` with which a member is compared
ARM = hf.Arm(length=0.105)
THREADS = (1, 2)
BUDGET = 4.0  # s of processor time for one setting on one number of threads
# Settings from loose to tight; the first one that is accurate enough is timed. Friction is scaled with n, so these suit
# all sizes. Steps use the order of the default tolerance; higher orders allow longer steps with the same throughput (4
# to 7 were tried).
SETTINGS = {
    "tol": (2e-4, 1e-4, 7e-5, 5e-5, 3e-5, 2e-5, 1.5e-5, 1e-5, 7e-6, 5e-6, 3e-6, 2e-6, 1e-6, 5e-7),
    "step": (0.03, 0.025, 0.02, 0.0175, 0.015, 0.0125, 0.01, 0.0085, 0.007, 0.006, 0.005, 0.004, 0.003),
}
UNITS = {"tol": "m", "step": "s"}
WORDS = {"tol": "error control", "step": "step chosen beforehand"}


@dataclass(frozen=True)
class Fleet:
    """Ropes and motions that differ in every parameter, and the tips (M, 2) of single runs, m."""

    ropes: list[hf.Rope]
    motions: list[hf.Motion]
    true: Array

    def run(self, kind: str, setting: float, threads: int) -> Array:
        """Tips (M, 2), m, at the end; not a number where a member failed."""
        how: dict[str, Any] = {kind: setting}
        return hf.simulate_batch(self.ropes, self.motions, arm=ARM, duration=DURATION, threads=threads, **how).tip[
            :, -1
        ]

    def errors(self, kind: str, setting: float) -> dict[str, float | None]:
        """Quantiles of the members' errors, mm; None where members failed."""
        error = distance_mm(self.run(kind, setting, THREADS[-1]), self.true)
        found = np.quantile(error, [0.5, 0.99, 1.0], method="higher")
        names = ("median", "of 99 %", "greatest")
        return {name: float(x) if math.isfinite(x) else None for name, x in zip(names, found, strict=True)}


def fleet(links: int, members: int) -> Fleet:
    """Draw length, mass, radius (so inertia), friction and both switching times of every member within SPREAD."""
    random = np.random.default_rng(5)
    ropes, motions = [], []
    for _ in range(members):
        long, heavy, thick, rough, move, rest = random.uniform(1.0 - SPREAD, 1.0 + SPREAD, 6)
        friction = FRICTION * rough * links / PAPER_LINKS
        ropes.append(
            hf.Rope.uniform(
                length=LENGTH * long, mass=MASS * heavy, n_links=links, radius=RADIUS * thick, friction=friction
            )
        )
        motions.append(hf.arm_swings(t_move=0.73 * move, t_rest=0.53 * rest))
    alone = [
        hf.simulate(rope, motion, arm=ARM, duration=DURATION, t_eval=[DURATION], tol=TIGHT).tip[-1]
        for rope, motion in zip(ropes, motions, strict=True)
    ]
    return Fleet(ropes, motions, np.array(alone))


def measure(quick: bool, repeats: int, _peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of {links, members, control, looked_at, setting, simulated_s_per_s}.

    `looked_at` lists the settings up to the chosen one with their errors; `setting` is None if none was accurate
    enough.
    """
    rows = []
    for links, members in QUICK if quick else SIZES:
        ropes = fleet(links, members)
        found = {kind: search(ropes, kind) for kind in SETTINGS}
        chosen = {kind: looks[-1]["setting"] for kind, looks in found.items() if good(looks[-1])}
        speeds = throughput(ropes, chosen, repeats)
        for kind, looks in found.items():
            rows.append(
                {
                    "links": links,
                    "members": members,
                    "control": kind,
                    "looked_at": looks,
                    "setting": chosen.get(kind),
                    "simulated_s_per_s": speeds.get(kind),
                }
            )
    return rows


def search(ropes: Fleet, kind: str) -> list[dict[str, Any]]:
    """Errors of each setting from loose to tight, up to the first one that is accurate enough."""
    looks: list[dict[str, Any]] = []
    for setting in SETTINGS[kind]:
        looks.append({"setting": setting, "error_mm": ropes.errors(kind, setting)})
        if good(looks[-1]):
            break
    return looks


def good(look: dict[str, Any]) -> bool:
    """Whether no member's error reaches GOOD."""
    greatest = look["error_mm"]["greatest"]
    return greatest is not None and greatest < GOOD


def throughput(ropes: Fleet, chosen: dict[str, float], repeats: int) -> dict[str, dict[str, dict[str, float]]]:
    """Simulated seconds per second for each kind of control and number of threads, in alternation."""
    plan = [(kind, setting, threads) for kind, setting in chosen.items() for threads in THREADS]
    speeds: dict[str, dict[str, dict[str, float]]] = {}
    for (kind, _, threads), times in zip(
        plan, alternately([partial(ropes.run, *each) for each in plan], repeats, BUDGET), strict=True
    ):
        speeds.setdefault(kind, {})[str(threads)] = speed(times, len(ropes.ropes) * DURATION)
    return speeds


def speed(times: Times, simulated: float) -> dict[str, float]:
    """`simulated` seconds per elapsed second (processor time would add up the threads)."""
    return {
        "median": simulated / statistics.median(times.clock),
        "least": simulated / max(times.clock),
        "most": simulated / min(times.clock),
        "rounds": len(times.clock),
    }


def text(rows: list[dict[str, Any]], _peers: dict[str, ModuleType]) -> str:
    """Return the Markdown tables and their explanation."""
    head = "links | members | control | setting | greatest error, mm | of 99 %, mm | median, mm"
    lines = [
        f"| {head} | simulated s per s, 1 thread (least-most) | 2 threads (least-most) | 2 threads / 1 |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        head = f"| {row['links']} | {row['members']} | {WORDS[row['control']]} |"
        if row["setting"] is None:
            lines.append(f"{head} none down to {SETTINGS[row['control']][-1]:g} {UNITS[row['control']]} | | | | | | |")
            continue
        error = row["looked_at"][-1]["error_mm"]
        one, two = (row["simulated_s_per_s"][str(threads)] for threads in THREADS)
        cells = [
            f"{row['control']} {row['setting']:g} {UNITS[row['control']]}",
            *(f"{error[name]:.2g}" for name in ("greatest", "of 99 %", "median")),
            *(f"{x['median']:,.0f} ({x['least']:,.0f}-{x['most']:,.0f})" for x in (one, two)),
            f"{two['median'] / one['median']:.2f}",
        ]
        lines.append(f"{head} {' | '.join(cells)} |")
    return "\n".join(lines) + (
        f"\n\n{DURATION:g} s of casting. Every member has its own length, mass, radius, friction, and times of moving "
        f"and resting, each drawn within {SPREAD:.0%} of the paper's values; joint friction is scaled with the number "
        f"of links. The error of each member is that of its tip at {DURATION:g} s against a single run at tol "
        f"{TIGHT:g} m. The setting is the loosest one in a list (in benchmarks/batches.py) whose greatest error is "
        f"below {GOOD:g} mm. A call includes the input checks and the creation of the kernels' arrays, and keeps the "
        "tips. Times are elapsed times, medians of alternating runs: other load on the machine increases them, most "
        "of all with two threads."
    )


def figure(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the errors of the first batch against tolerance and step."""
    panels: dict[str, dict[str, list[tuple[float, float]]]] = {}
    labels = {"tol": "tol, m (error control)", "step": "step chosen beforehand, s"}
    for row in rows[: len(SETTINGS)]:
        groups = panels.setdefault(labels[row["control"]], {})
        for look in row["looked_at"]:
            for name, error in look["error_mm"].items():
                if error is not None:
                    groups.setdefault(name, []).append((look["setting"], error))
    title = f"{rows[0]['members']} ropes of {rows[0]['links']} links: error of the tip at {DURATION:g} s"
    figures.against_settings(panels, GOOD, title, path)
