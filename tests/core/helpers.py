"""Calls of the kernels with what the tests have: links, a state and a base."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from hyperflex.core import chain as kernels
from tests.reference.cases import State
from tests.reference.dense import Real

# Without the compiler a sweep over 200 links takes some ten milliseconds: every size still runs, with fewer examples.
EXAMPLES = 20 if numba.config.DISABLE_JIT else 200


class Sweep(NamedTuple):
    """What the kernel answers: alpha (n,), force (2,), torque through the first joint."""

    alpha: Real
    force: Real
    torque: float


def chain_of(links: Any) -> kernels.Chain:
    """The kernel's parameters from the reference's (same names)."""
    return kernels.Chain(**links._asdict())


def sweep(links: Any, state: State, torque: float = 0.0, h: float = 0.0) -> Sweep:
    """One call of the accelerations kernel."""
    n = len(state.q)
    alpha, work = np.full(n, np.nan), np.full((n, 8), np.nan)
    fx, fy, moment = kernels.accelerations(chain_of(links), state.q, state.w, state.base, torque, h, alpha, work)
    return Sweep(alpha, np.array([fx, fy]), moment)
