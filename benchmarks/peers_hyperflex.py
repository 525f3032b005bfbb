"""hyperflex, called as by a user: the time includes checks, output, energies and the energy guard."""

from collections.abc import Iterator

import numpy as np
from cast import Cast, Contestant

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.integrate.rollout import TAKEN
from hyperflex.model import Setup
from hyperflex.simulation import Rollout, runge_kutta_limit

NAME = "hyperflex"
ARM = "prescribed exactly: the arm's end moves the first joint and its angle turns it; restart at every switch"
DRIVE = "prescribed"
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-8)  # m


def run(cast: Cast, **how: object) -> Array:
    """Return the tip (T, 2)."""
    return hf.simulate(cast.rope, cast.motion, arm=cast.arm, duration=cast.duration, t_eval=cast.times, **how).tip


def steps(cast: Cast, tol: float) -> int:
    """Steps for the whole cast, rejected ones too."""
    setup = Setup(cast.rope, cast.motion, cast.arm, duration=cast.duration, tol=tol)
    rollout = Rollout(setup, np.array([0.0, cast.duration]))
    rollout.complete()
    return int(rollout.progress.clock[TAKEN])


def contestants(cast: Cast, quick: bool) -> Iterator[Contestant]:
    """The tolerance is the only option. Classical Runge-Kutta on the same kernel separates method from kernel."""
    for tol in TOLERANCES[1:3] if quick else TOLERANCES:
        yield Contestant(NAME, "extrapolation", f"tol {tol:g} m", lambda tol=tol: run(cast, tol=tol), adaptive=True)
    step = 0.99 * runge_kutta_limit(cast.rope.chain())
    yield Contestant(f"{NAME}, explicit", "rk4", f"step {step:.3g} s", lambda: run(cast, step=step))
