"""Calls of the kernels with the tests' links, state and base."""

from typing import Any, NamedTuple

import numba
import numpy as np

import hyperflex as hf
from hyperflex.core.chain import articulated_body as kernels
from hyperflex.core.chain.drive import Drive
from hyperflex.core.contact.run import Scene
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
    """The kernel's parameters from the reference's (same names, except for the reaction of friction)."""
    values = links._asdict()
    reaction = kernels.MUTUAL if values.pop("reaction") == 1.0 else kernels.ONE_SIDED
    return kernels.Chain(**values, reaction=reaction)


def senses(state: State) -> Real:
    """Senses in which the joints slip at a state (n,); 1.0 where they do not turn, so that none is locked."""
    return np.where(np.diff(state.w, prepend=state.base[3]) < 0.0, -1.0, 1.0)


def lost_power(links: Any, state: State) -> float:
    """What friction and the air take by the kernel, W, with every joint slipping."""
    n = len(state.q)
    alpha, work = np.empty(n), np.empty(6 * n)
    kernels.accelerations(chain_of(links), state.q, state.w, senses(state), state.base, 0.0, 0.0, alpha, work)
    return float(kernels.lost_power(chain_of(links), state.w, senses(state), state.base, work))


def sweep(links: Any, state: State, torque: float = 0.0, h: float = 0.0, grip: Real | None = None) -> Sweep:
    """One call of the accelerations kernel, by default with every joint slipping."""
    n = len(state.q)
    alpha, work = np.full(n, np.nan), np.full(6 * n, np.nan)
    modes = senses(state) if grip is None else grip
    call = chain_of(links), state.q, state.w, modes, state.base, torque, h
    fx, fy, moment = kernels.accelerations(*call, alpha, work)
    return Sweep(alpha, np.array([fx, fy]), moment)


def scene_of(setup: hf.Setup) -> Scene:
    """What runs of a set-up in contact know, with arrays as a run has them, for which the kernels are compiled."""
    chain, drive = (
        kind(*(np.array(each) if isinstance(each, np.ndarray) else each for each in given))
        for kind, given in ((kernels.Chain, setup.chain()), (Drive, setup.drive()))
    )
    return Scene(chain, drive, setup.contacts(), np.zeros(2))


def rise(values: Real) -> float:
    """By how much values (T,) rise at most above what they were before."""
    return float((values - np.minimum.accumulate(values)).max())
