"""Simulated recordings of ropes whose truth is known, and how most tests fit them."""

from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import FitOptions
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.simulation import simulate

QUICK = FitOptions(intervals=None)
WHOLE = FitOptions(train=np.inf)  # nothing is held out
WHOLE_QUICK = FitOptions(train=np.inf, intervals=None)
EXACT = FitOptions(length_std=0.0, clock_std=0.0)  # lengths and times err by nothing


def recorded(
    rope: Rope, q0: Any, t: Array, noise: float, seed: int = 0, *, declared: float | None = None, **how: Any
) -> Recording:
    """Angles at times `t`, s, of a rope that is let go at `q0`, rad, with white noise, rad; `how` it is simulated."""
    run = simulate(rope, duration=float(t[-1]), t_eval=t, q0=q0, **{"tol": 1e-9} | how)
    return Recording(t, run.q + noise * np.random.default_rng(seed).standard_normal(run.q.shape), noise=declared)
