"""Cost of exact derivatives of the paper's cast, in units of a plain rollout with the same tolerance and outputs."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from cast import cable
from clock import NOTE, alternately

import hyperflex as hf
from hyperflex.simulation import AngleJacobian, Rollout

LINKS, TOL, DURATION = 50, 1e-5, 10.0
OUTPUTS = {"the end alone": 2, "every 33 ms": 301, "every 10 ms": 1001}
WRT: dict[str, list[str]] = {
    "2 parameters": ["friction", "inertia"],
    "2 times of the motion": ["motion.t_move", "motion.t_rest"],
    "100 initial states": ["q0", "qd0"],
}
SPACING, AGREEMENT = 1e-6, 1e-3  # tolerance of the check against one-sided differences of runs with their own steps


def measure(quick: bool, repeats: int, _peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of {outputs, what, directions, milliseconds: {...}, ratio}; a derivative that is wrong is an error."""
    rope, motion, arm = cable(LINKS), hf.arm_swings(), hf.Arm()
    setup = hf.Setup(rope, motion, arm, duration=DURATION, tol=TOL)
    q0, qd0 = setup.start()
    check(rope, motion, arm, q0, qd0)  # compiles as well
    rows = []
    for outputs, count in list(OUTPUTS.items())[: 1 if quick else None]:
        t = np.linspace(0.0, DURATION, count)
        slopes = {what: AngleJacobian(setup, names) for what, names in WRT.items()}

        def plain(t: Any = t) -> Any:
            return angles(setup, t, q0, qd0)

        runs: list[Callable[[], Any]] = [plain]
        runs += [lambda one=one, t=t: one(t, q0, qd0) for one in slopes.values()]
        times = alternately(runs, repeats, 5.0)
        for what, directions, timed in zip(
            ["plain", *WRT], [0, *(len(one.names) for one in slopes.values())], times, strict=True
        ):
            ratio = timed.median / times[0].median
            cost = timed.scaled(1e3)
            rows.append(
                {"outputs": outputs, "what": what, "directions": directions, "milliseconds": cost, "ratio": ratio}
            )
    return rows


def angles(setup: hf.Setup, t: Any, q0: Any, qd0: Any) -> Any:
    """Return the angles (T, n) of a run from a start, rad."""
    run = Rollout(setup, t, (q0, qd0))
    run.complete()
    return run.y[:, : q0.size]


def check(rope: hf.Rope, motion: hf.Motion, arm: hf.Arm, q0: Any, qd0: Any) -> None:
    """Compare a derivative with a difference of two tight runs."""
    t = np.linspace(0.0, 2.0, 21)
    setup = hf.Setup(rope, motion, arm, duration=2.0, tol=1e-9)
    slope = AngleJacobian(setup, "q0[0]")(t, q0, qd0)[2][:, :, 0]
    nudge = SPACING * np.eye(LINKS)[0]
    near, far = (angles(setup, t, q, qd0) for q in (q0, q0 + nudge))
    want = (far - near) / SPACING
    gap = float(np.abs(slope - want).max() / np.abs(want).max())
    if not gap < AGREEMENT:
        raise RuntimeError(f"the derivative differs from a difference of runs by {gap:.2g} of the largest")


def text(rows: list[dict[str, Any]], _peers: dict[str, ModuleType]) -> str:
    """Return the Markdown table."""
    lines = ["| outputs | derivatives | ms | plain rollouts |", "|---|---|---|---|"]
    lines += [f"| {r['outputs']} | {r['what']} | {r['milliseconds']['median']:.3g} | {r['ratio']:.2f} |" for r in rows]
    return "\n".join(lines) + (
        f"\n\nThe paper's cast, n = {LINKS}, {DURATION:g} s, tol = {TOL:g} m: angles and rates, and their derivatives "
        f"at every output, including the plain rollout. One thread. {NOTE}"
    )
