"""The chain against the continuous rope: order of convergence, conversion of ropes, limits with error bars.

python -m benchmarks.continuum            results in benchmarks/results/continuum.md; half a minute
python -m benchmarks.continuum --seed 3   other ropes for the error bars

The paper's cable is released from a bent shape or cast, with 25 to 800 links, with and without friction of its hinge.
The error bars of ``extrapolate=True`` are checked with 16 times the links. All simulated.
"""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex.model import divided

RESULTS = Path(__file__).parent / "results"
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
LINKS, END, SEED = (25, 50, 100, 200, 400, 800), 6.0, 57
Start = Callable[[np.ndarray], np.ndarray]


def bent(parts: np.ndarray) -> np.ndarray:
    """Angles, rad, of a rope that is released, at fractions of its length."""
    return np.cos(0.5 * np.pi * parts)


def path(rope: hf.Rope, t: np.ndarray, start: Start | None, **how: Any) -> np.ndarray:
    """Return the joints (T, n + 1, 2), m, from a start, or of a cast."""
    if start is not None:
        how["q0"] = start(rope.link_middles / rope.total_length)
    return hf.simulate(rope, duration=float(t[-1]), t_eval=t, tol=1e-9, **how).joints


CASES: dict[str, tuple[Start | None, dict[str, Any]]] = {
    "free swing": (bent, {}),
    "cast": (None, {"motion": hf.arm_swings(), "arm": hf.Arm()}),
    "cast over the top": (None, {"motion": hf.arm_swings(path="over"), "arm": hf.Arm()}),
}


def orders() -> list[str]:
    """Rows of greatest differences of the tip between successive numbers of links, and their orders."""
    rows, t = [], np.linspace(0.0, END, 61)
    for name, (start, how) in CASES.items():
        for hinge in (0.0, CABLE.friction[0]):
            tips = []
            for n in LINKS:
                rope = hf.with_links(CABLE, n)
                rope = rope.replace(friction=[hinge, *rope.friction[1:]])
                tips.append(path(rope, t, start, **how)[:, -1])
            apart = np.array([np.linalg.norm(a - b, axis=1).max() for a, b in itertools.pairwise(tips)])
            found = " | ".join(f"{1e3 * each:.3g}" for each in apart)
            order = ", ".join(f"{each:.2f}" for each in np.log2(apart[:-1] / apart[1:]))
            rows.append(f"| {name} | {hinge:g} | {found} | {order} |")
            print(rows[-1], flush=True)
    return rows


def converted() -> list[str]:
    """Rows of swings of the paper's cable, converted to other numbers of links."""
    rows, t = [], np.linspace(0.0, END, 61)
    own = path(CABLE, t, bent)[:, -1]
    kept = CABLE.friction[0]
    for n in (10, 25, 35, 100, 300, 800):
        rope = hf.with_links(CABLE, n)
        size = np.abs(own[:, 0]).max()
        plain = rope.replace(friction=np.full(n, kept))
        off = [np.linalg.norm(path(each, t, bent)[:, -1] - own, axis=1).max() / size for each in (rope, plain)]
        rows.append(f"| {n} | {rope.friction[-1]:.2e} | {100 * off[0]:.2f} | {100 * off[1]:.2f} |")
        print(rows[-1], flush=True)
    return rows


def bars(seed: int) -> list[str]:
    """Rows of limits and their error bars, for the paper's cable and for random ropes."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 8.0, 161)
    cases = [(f"paper's cable, {name}", CABLE, start, how) for name, (start, how) in CASES.items()]
    for k in range(12):
        n, length, friction = int(rng.integers(12, 50)), rng.uniform(0.5, 2.0), 10.0 ** rng.uniform(-4.3, -3.0)
        rope = hf.Rope.uniform(length, rng.uniform(0.02, 0.2), n, radius=0.002, friction=friction)
        size, phase = rng.uniform(0.1, 1.5), rng.uniform(0.0, 2.0)
        move, rest, reach = rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.6), rng.uniform(0.05, 0.2)
        if k % 2:
            cases.append((f"{n} links, free swing", rope, lambda s, a=size, p=phase: a * np.cos(p + 2.0 * s), {}))
        else:
            cast = {"motion": hf.arm_swings(t_move=move, t_rest=rest), "arm": hf.Arm(length=reach)}
            cases.append((f"{n} links, cast", rope, None, cast))
    rows = []
    for name, rope, start, how in cases:
        given = dict(how) if start is None else {**how, "q0": start(rope.link_middles / rope.total_length)}
        run = hf.simulate(rope, duration=8.0, t_eval=t, extrapolate=True, **given)
        truth = path(divided(rope, 16), t, start, **how)[:, ::16]
        own, error = (np.linalg.norm(each - truth, axis=2).max(axis=1) for each in (run.joints, run.limit))
        values = " | ".join(f"{1e3 * np.median(each):.2g}" for each in (own, error, run.limit_error))
        rows.append(f"| {name} | {values} | {100 * (error <= run.limit_error).mean():.0f} |")
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, print and write."""
    seed, about = machine.seeded(__doc__, SEED)
    steps = " | ".join(f"{a} to {b}" for a, b in itertools.pairwise(LINKS))
    layer = math.sqrt(2e-5 * math.tau / 1.6 / (0.125 * 9.81))
    text = [
        "# The chain and the continuous rope",
        (
            f"Greatest distance between the tips, mm, within {END:g} s, of runs with n and 2 n links, and the "
            "resulting order. Friction of the hinge in N m s/rad. Without hinge friction the order is 2. The hinge's "
            f"friction moment bends the first {1e3 * layer:.1f} mm or so of the rope (a swing of 1.6 s). This is "
            "shorter than most links here, so the remaining error is of first order."
        ),
        f"| motion | hinge | {steps} | orders |\n|---|---|{'---|' * len(LINKS[1:])}---|\n" + "\n".join(orders()),
        (
            "The paper's cable, converted by `hf.with_links`, and with the same friction in each joint for any number "
            "of links: greatest distance of the tip from that of 50 links in a free swing of 6 s, % of the swing's "
            "width."
        ),
        "| links | friction, N m s/rad | converted | same friction |\n|---|---|---|---|\n" + "\n".join(converted()),
        (
            f"Limits of `simulate(..., extrapolate=True)`, 8 s, against 16 times the links (the paper's cable: 800), "
            f"seed {seed}. Medians over time at the worst joint, mm."
        ),
        "| run | error of the run | of the limit | error bar | contained, % of the time |\n|---|---|---|---|---|\n"
        + "\n".join(bars(seed)),
        machine.sentence(about),
        f"`python -m benchmarks.continuum --seed {seed}`",
    ]
    (RESULTS / "continuum.md").write_text("\n\n".join(text) + "\n")


if __name__ == "__main__":
    main()
