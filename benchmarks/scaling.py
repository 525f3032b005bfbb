"""Cost of a simulated second against the number of links."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import figures
import numpy as np
from cast import PAPER_LINKS, Cast, distance_mm, paper_cast
from clock import NOTE, alternately
from peers_hyperflex import run, steps

from hyperflex.checks import Array

SIZES = (10, 20, 50, 100, 200, 400, 1000, 2000)
QUICK = (10, 50, 200)
TOL, TIGHT = 1e-4, 1e-9  # m, of the timed run and of its reference
TIMES = (2.0, 5.0)
PEER_TIMES = (2.0,)  # shorter, because their cost grows fast
MUJOCO_STEP = 1.93e-4  # s: 1 mm at 2 s and n = 50; friction does not limit it
PEER_SIZES = {"mujoco": (10, 20, 50, 100, 200), "scipy": (10, 20, 50, 100, 200)}
FIXED, SCALED = "friction per joint fixed", "friction scaled"


@dataclass
class Entry:
    """One timing on one rope."""

    what: str
    links: int
    cast: Cast
    run: Callable[[], Array]
    steps: int | None = None  # steps of the cast, including rejected ones, where available


def own(n: int, *, scaled: bool) -> Entry:
    """hyperflex at TOL."""
    cast = paper_cast(n, TIMES, scaled=scaled)
    return Entry(f"hyperflex, {SCALED if scaled else FIXED}", n, cast, lambda: run(cast, tol=TOL), steps(cast, TOL))


def mujoco(peer: ModuleType, n: int) -> Entry:
    """MuJoCo with a step that its implicit friction does not limit."""
    cast = paper_cast(n, PEER_TIMES)
    compiled = peer.model(cast.rope, cast.arm, "implicitfast", MUJOCO_STEP)
    what = f"MuJoCo, {FIXED}"
    return Entry(what, n, cast, lambda: peer.run(cast, compiled, MUJOCO_STEP))


def scipy(peer: ModuleType, n: int) -> Entry:
    """LSODA on hyperflex's accelerations."""
    cast = paper_cast(n, PEER_TIMES)
    function = peer.right_hand_side(cast)
    what = f"scipy LSODA, {FIXED}"
    return Entry(what, n, cast, lambda: peer.run(cast, function, "LSODA", 1e-4, 1e-3))


PEERS = {"mujoco": mujoco, "scipy": scipy}


def measure(quick: bool, repeats: int, peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of {what, links, steps, error_mm: [...], at_s: [...], ms_per_simulated_s: {...}}."""
    entries = [own(n, scaled=scaled) for scaled in (False, True) for n in (QUICK if quick else SIZES)]
    for name, make in PEERS.items():
        if name in peers and not quick:
            entries += [make(peers[name], n) for n in PEER_SIZES[name]]
    timed = alternately([entry.run for entry in entries], min(repeats, 5), 3.0)
    return [
        {
            "what": entry.what,
            "links": entry.links,
            "steps": entry.steps,
            "at_s": list(map(float, entry.cast.times)),
            "error_mm": distance_mm(times.result, run(entry.cast, tol=TIGHT)).tolist(),
            "ms_per_simulated_s": times.scaled(1e3 / entry.cast.duration),
        }
        for entry, times in zip(entries, timed, strict=True)
    ]


def text(rows: list[dict[str, Any]], _peers: dict[str, ModuleType]) -> str:
    """Return the Markdown table and the measured powers of n."""
    sizes = sorted({row["links"] for row in rows})
    lines = ["| ms per simulated s (error at the end, mm) at n = | " + " | ".join(map(str, sizes)) + " |"]
    lines.append("|---" * (len(sizes) + 1) + "|")
    powers = []
    for what in dict.fromkeys(row["what"] for row in rows):
        mine = {row["links"]: row for row in rows if row["what"] == what}
        cells = [_cell(mine[n]) if n in mine else "" for n in sizes]
        lines.append(f"| {what} | {' | '.join(cells)} |")
        powers.append(f"{_power(mine):.2f} ({what})")
    lines += ["", "| steps per simulated s at n = | " + " | ".join(map(str, sizes)) + " |"]
    lines.append("|---" * (len(sizes) + 1) + "|")
    for what in dict.fromkeys(row["what"] for row in rows if row["steps"]):
        mine = {row["links"]: row for row in rows if row["what"] == what}
        rates = [f"{mine[n]['steps'] / mine[n]['at_s'][-1]:.3g}" for n in sizes]
        lines.append(f"| {what} | {' | '.join(rates)} |")
    return "\n".join(lines) + (
        f"\n\nhyperflex: {TIMES[-1]:g} s of casting at tol {TOL:g} m. MuJoCo (implicitfast, dt {MUJOCO_STEP:g} s) and "
        f"scipy (rtol 1e-4, atol 1e-3): {PEER_TIMES[-1]:g} s. Errors are against hyperflex at tol {TIGHT:g} m. "
        f"Exponent of n in the cost from n = 50 on: {'; '.join(powers)}. Friction scaled: joint friction times link "
        f"length is constant, so that all n represent one continuous cable; both agree at n = {PAPER_LINKS}. With "
        "fixed friction per joint, a finer cable is softer and moves differently. The number of steps includes "
        f"rejected ones; that of an explicit method would grow with the third power of n (docs/models.md). {NOTE}"
    )


def _cell(row: dict[str, Any]) -> str:
    return f"{row['ms_per_simulated_s']['median']:.3g} ({row['error_mm'][-1]:.1g})"


def _power(rows: dict[int, dict[str, Any]]) -> float:
    """Slope of the logarithm of the cost from n = 50 on."""
    sizes = [n for n in rows if n >= 50]
    cost = [rows[n]["ms_per_simulated_s"]["median"] for n in sizes]
    return float(np.polyfit(np.log(sizes), np.log(cost), 1)[0])


def figure(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw time against n."""
    groups: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        groups.setdefault(row["what"], []).append((row["links"], row["ms_per_simulated_s"]["median"]))
    figures.against_links(groups, "The paper's cast with n links", "ms per simulated second", path)
