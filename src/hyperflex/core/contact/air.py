"""Impulses of air drag in a contact step (M.34)."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.chain.air import air_loads
from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.jit import kernel, non_allocating


class Air(NamedTuple):
    """Working arrays, and what the air does in a step."""

    work: Array  # (6 n,) torque on each link first, N m
    rate: Array  # (n,) rad/s, in the middle of the step
    total: Array  # (3,) force x, y on the rope, N, and all torques together, N m


@kernel
def new_air(n):  # type: ignore[no-untyped-def]
    """Working arrays for n links."""
    return Air(np.zeros(6 * n), np.zeros(n), np.zeros(3))


@non_allocating
def add_drag_impulses(chain, air, motion, base, h):  # type: ignore[no-untyped-def]
    """Add the impulses of air drag in a step h to those of the joints in `motion`; `base` (9,) in its middle.

    A torque on link i alone equals torques of all joints up to i, each on its link and back on its parent. What
    the first joint bears so, :func:`drag_work` takes off what the rope asks of its base.
    """
    n = motion.w.size
    for i in range(n):
        air.rate[i] = motion.w[i] + 0.5 * motion.change[i]  # as the accelerations of the last step foretell
        air.work[4 * n + i], air.work[5 * n + i] = motion.trig[i], motion.trig[n + i]
    air.total[0], air.total[1], _ = air_loads(chain, air.rate, base, air.work, 0, 1)
    air.total[2] = 0.0
    for way in range(n):
        i = n - 1 - way
        air.total[2] += air.work[i]
        motion.joint[i, 0] += h * air.total[2]


@non_allocating
def drag_work(air, motion, rates, before, after, h):  # type: ignore[no-untyped-def]
    """Subtract the drag from the impulses at the first joint; returns the energy lost to drag in the step, J.

    `rates` (n,) are those after the step; `before`, `after` (9,) the motion of the first joint.
    """
    given = 0.5 * (air.total[0] * (before[5] + after[5]) + air.total[1] * (before[6] + after[6]))
    for k in range(3):
        motion.load[k] -= h * air.total[k]
    for i in range(rates.size):
        given += 0.5 * air.work[i] * (motion.w[i] + rates[i])
    return -h * given
