"""Kernels give back the memory that they take: nothing that numba allocated is left after a call."""

from collections.abc import Callable

import numba
import pytest
from numba.core.runtime import _nrt_python, rtsys

import hyperflex as hf

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

ROPE = hf.Rope.uniform(length=1.0, mass=0.05, n_links=4, radius=0.0025, friction=5e-4)
DRY = ROPE.replace(dry_friction=[1e-4] * 4)
MOTION, ARM = hf.arm_swings(), hf.Arm(length=0.1)

CALLS: dict[str, Callable[[], object]] = {
    "a batch": lambda: hf.simulate_batch([ROPE] * 20, MOTION, arm=ARM, duration=0.2),
    "a batch with dry friction": lambda: hf.simulate_batch([DRY] * 3, MOTION, arm=ARM, duration=0.2),
    "a run": lambda: hf.simulate(ROPE, MOTION, arm=ARM, duration=0.2),
    "a run with dry friction": lambda: hf.simulate(DRY, MOTION, arm=ARM, duration=0.2),
    "a run beside a peg": lambda: hf.simulate(ROPE, MOTION, arm=ARM, pegs=[hf.Peg(-0.4, -0.5, 0.1)], duration=0.2),
    "derivatives": lambda: hf.sensitivities(ROPE, MOTION, arm=ARM, duration=0.2, wrt=["friction", "q0"]),
    "derivatives with dry friction": lambda: hf.sensitivities(DRY, MOTION, arm=ARM, duration=0.2, wrt="dry_friction"),
}


def living() -> int:
    """Return how many blocks of memory kernels have taken and not given back."""
    stats = rtsys.get_allocation_stats()
    return int(stats.alloc - stats.free)


@pytest.mark.parametrize("name", CALLS)
def test_nothing_is_left_of_a_call(name):
    _nrt_python.memsys_enable_stats()
    results = [CALLS[name]()]  # what is compiled may stay
    del results[:]
    before = living()
    for _ in range(3):
        CALLS[name]()
    assert living() == before
