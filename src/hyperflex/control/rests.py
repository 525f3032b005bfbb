"""The rests with which a rope is pumped up soonest: a search over free rests, beside the best constant one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control.caster import Caster
from hyperflex.control.reach import reach_time
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState

MEMBERS = 60  # of a generation
SPREAD = 0.08  # s, of the first generation about constant rests
LEAST_GAIN = 0.04  # s: deadlines are tried until they are as close as this


@dataclass(frozen=True, eq=False)
class PumpPlan:
    """Rests that pump a rope up from rest.

    Attributes
    ----------
    rests : (k,) float64
        After the first, second, ... half turn, s. The first half turn starts at t = 0.
    reached : float
        When the wanted reach is there, s, as the model foresees it.
    constant_rest, constant_reached : float
        The best constant rest among those tried, s, and when that reaches it, s.
    tried : int
        Number of rollouts.
    """

    rests: Array
    reached: float
    constant_rest: float
    constant_reached: float
    tried: int


def plan_pumping(caster: Caster, wanted: float, *, longest: float = 16.0, rounds: int = 40, seed: int = 0) -> PumpPlan:
    """Search the rests with which the tip of a hanging rope first is at a wanted ``|x|``.

    Parameters
    ----------
    caster : Caster
        Rope, arm and half turns.
    wanted : float
        ``|x|`` of the tip, m.
    longest : float
        How long constant rests may take, s.
    rounds : int
        Generations of differential evolution for each deadline that is tried; 0: constant rests alone.
    seed : int
        Of the search; the same seed finds the same plan.

    Returns
    -------
    PumpPlan
        If Ctrl-C ends the search, the best so far.

    Raises
    ------
    InvalidInput
        No constant rest reaches what is wanted.

    Notes
    -----
    The time of arrival jumps by half a swing where a swing just fails, so it is not searched for directly: for a
    deadline, the greatest reach before it is maximised, and the deadline is halved in between what was met and what was
    not. A local search cannot prove that there is nothing better. Costs some thousands of rollouts a deadline.
    """
    want = checks.number("wanted", wanted, sign="positive", unit="m")
    rounds = checks.count("rounds", rounds, least=0)
    rest = RopeState(0.0, np.full(caster.rope.n_links, caster.rope.hanging_angle), np.zeros(caster.rope.n_links))
    constants = np.arange(0.0, 0.5 * caster.period, 0.01)
    count = max(2, math.ceil(longest / caster.t_move))
    t, reach = caster.foresee(rest, 0, _all(np.tile(constants[:, None], (1, count))), longest)
    times = reach_time(t, reach, want)
    best = int(np.argmin(times))
    if not math.isfinite(times[best]):
        raise InvalidInput(
            "no constant rest pumps the rope up so far",
            got=want,
            allowed=f"at most {reach.max():.2f} m in {longest:g} s",
        )
    found = PumpPlan(
        np.full(max(1, int(times[best] / (caster.t_move + constants[best]))), constants[best]),
        float(times[best]),
        float(constants[best]),
        float(times[best]),
        constants.size,
    )
    low, high = found.reached - 0.6 * caster.period, found.reached
    try:
        while rounds and high - low > LEAST_GAIN:
            deadline = 0.5 * (low + high)
            found, met = _before(deadline, caster, want, rest, found, rounds, seed)
            low, high = (low, found.reached) if met else (deadline, high)
    except KeyboardInterrupt:
        pass
    return found


def _all(later: Array) -> Array:
    """Rests before each half turn, of which the first starts at once."""
    return np.concatenate([np.zeros((len(later), 1)), later], axis=1)


def _before(
    deadline: float, caster: Caster, wanted: float, rest: RopeState, found: PumpPlan, rounds: int, seed: int
) -> tuple[PumpPlan, bool]:
    """Search a plan that reaches what is wanted by a deadline, s; return the better plan, and whether it does."""
    from scipy.optimize import differential_evolution

    count = max(1, math.ceil(deadline / (caster.t_move + found.constant_rest)))
    random = np.random.default_rng(seed)
    middle = found.constant_rest * np.linspace(0.4, 1.6, MEMBERS)
    first = np.clip(middle[:, None] + SPREAD * random.standard_normal((MEMBERS, count)), 0.0, 0.5 * caster.period)
    first[0] = np.resize(found.rests, count)
    rollouts = 0

    def shortfall(rests: Array) -> Array:
        nonlocal rollouts
        rollouts += rests.shape[1]
        return np.asarray(wanted - caster.foresee(rest, 0, _all(rests.T), deadline)[1].max(axis=1))

    result = differential_evolution(
        shortfall,
        [(0.0, 0.5 * caster.period)] * count,
        vectorized=True,
        updating="deferred",
        strategy="best1bin",
        mutation=(0.4, 0.9),
        recombination=0.8,
        init=first,
        maxiter=rounds,
        tol=1e-4,
        polish=False,
        rng=random,
        callback=lambda intermediate_result: intermediate_result.fun <= 0.0,
    )
    tried = found.tried + rollouts
    t, reach = caster.foresee(rest, 0, _all(result.x[None]), deadline)
    time = float(reach_time(t, reach, wanted)[0])
    if not math.isfinite(time):
        return PumpPlan(found.rests, found.reached, found.constant_rest, found.constant_reached, tried), False
    return PumpPlan(result.x, time, found.constant_rest, found.constant_reached, tried), True
