"""State and bounds of a rollout with contact."""

from typing import NamedTuple

from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.contact.warm_start import ContactMemory
from hyperflex.core.jit import non_allocating

MOMENT = 1e-8  # s; forces of shorter steps are not kept for the next: they would be mostly rounding
SLIGHT, ROUNDING = 1e-5, 1e-15  # s, J; energy that may appear in a step however short: rounding of large forces
LOSS = 10.0  # how many times more energy may vanish in a step than appear

# T: time, s. STEP: next step, s. INDEX: next output. TAKEN, REJECTED: steps. UNSOLVED: steps whose contact problem was
# not solved. IMPACTS: of links that closed fast. LOST: energy that contacts took, J. DEEPEST: greatest penetration, m.
# FORCED: steps taken though their energy balance is off. ENERGY_GAIN: energy that came from nowhere, J. IMPACT_DUE: 1.0
# where a link touches or a joint reaches its limit, and an impact is due. BEND: greatest angle past a joint limit, rad.
# GIVEN: by how much the energy that contacts took has fallen since it was greatest, J. SPENT: time with contact, s.
T, STEP, INDEX, TAKEN, REJECTED, UNSOLVED, IMPACTS, LOST = range(8)
DEEPEST, FORCED, ENERGY_GAIN, IMPACT_DUE, BEND, GIVEN, SPENT, CLOCK = range(8, 16)


class Bounds(NamedTuple):
    """Bounds of a rollout with contact."""

    stop: float  # s
    step: float  # s, longest step
    tol: float  # m, error allowed in the position of any joint, as in ``rollout.run``
    rate: float  # W, at which energy may appear from nowhere
    clear: float  # m, smallest gap at which the rope has left the pegs
    slack: float  # rad, smallest gap, by the present rates, at which joints have left their limits
    budget: int  # steps of one call


class ContactState(NamedTuple):
    """State of a rollout with contact; all arrays are changed in place."""

    y: Array  # (2 n + 2,) angles, rates, work put in, energy dissipated
    clock: Array  # (CLOCK,)
    spin: Array  # (2, m) angles, rad, and rates, rad/s, of the pegs; 0 of fixed ones
    memory: ContactMemory
    torque: Array  # (k, COLUMNS) windows of ``core.chain.torque_peaks``


@non_allocating
def energy_allowance(bounds, h):  # type: ignore[no-untyped-def]
    """Energy that may appear from nowhere in a step, J."""
    return bounds.rate * max(h, SLIGHT) + ROUNDING


@non_allocating
def energy_balanced(surplus, allowed):  # type: ignore[no-untyped-def]
    """Whether the energy that appears from nowhere in a step, J, or vanishes where it is negative, may do so."""
    return -LOSS * allowed <= surplus <= allowed
