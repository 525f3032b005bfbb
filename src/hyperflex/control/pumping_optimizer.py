"""Optimization of the rests with which a rope is pumped up soonest, compared with the best constant rest."""

import math
from dataclasses import dataclass, replace

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control.state_source import hanging_state
from hyperflex.control.swing_model import SwingModel, arrival_time
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState
from hyperflex.interruption import interruptible, stoppable


@dataclass(frozen=True, eq=False)
class PumpingPlan:
    """Rests that pump a rope from rest to an amplitude.

    `rests` (k,), s, are those after the first, second, ... half turn; the first half turn starts at t = 0. The
    amplitude is predicted to be reached at `arrival_time`, s. `constant_rest`, s, is the best constant rest among those
    tried, `constant_arrival_time`, s, its arrival time; `rollouts` counts the simulated runs. `interrupted`: Ctrl-C
    ended the search.
    """

    rests: Array
    arrival_time: float
    constant_rest: float
    constant_arrival_time: float
    rollouts: int
    interrupted: bool = False


@interruptible(PumpingPlan)
def optimize_pumping(
    model: SwingModel, target: float, *, longest: float = 16.0, rounds: int = 40, seed: int = 0
) -> PumpingPlan:
    """Search the rests with which the tip of a hanging rope reaches a target amplitude ``|x|`` soonest.

    Parameters
    ----------
    model : SwingModel
    target : float
        Amplitude, m.
    longest : float
        Greatest arrival time of constant rests, s.
    rounds : int
        Generations of differential evolution for each deadline that is tried; 0: constant rests alone.
    seed : int
        Of the search; the same seed finds the same plan.

    Returns
    -------
    PumpingPlan

    Raises
    ------
    InvalidInput
        No constant rest reaches the amplitude.
    Interrupted
        By Ctrl-C. Its ``partial`` is the best plan until then.

    Notes
    -----
    The arrival time jumps by half a swing where a swing just fails, so it is not minimized directly. Instead the
    greatest amplitude before a deadline is maximized by differential evolution, and the deadline is bisected. A local
    search cannot prove that there is nothing better. Costs some thousands of rollouts a deadline.
    """
    want = checks.number("target", target, sign="positive", unit="m")
    rounds = checks.count("rounds", rounds, least=0)
    rest = hanging_state(model.rope)
    constants = np.arange(0.0, 0.5 * model.period, 0.01)
    count = max(2, math.ceil(longest / model.t_move))
    t, amplitude = model.predict(rest, 0, _from_first(np.tile(constants[:, None], (1, count))), longest)
    times = arrival_time(t, amplitude, want)
    best = int(np.argmin(times))
    if not math.isfinite(times[best]):
        raise InvalidInput(
            "no constant rest pumps the rope up so far",
            got=want,
            allowed=f"at most {amplitude.max():.2f} m in {longest:g} s",
        )
    found = PumpingPlan(
        np.full(max(1, int(times[best] / (model.t_move + constants[best]))), constants[best]),
        float(times[best]),
        float(constants[best]),
        float(times[best]),
        constants.size,
    )
    low, high = found.arrival_time - 0.6 * model.period, found.arrival_time
    with stoppable() as stop:
        while rounds and high - low > 0.04:  # s, to which the deadline is bisected
            deadline = 0.5 * (low + high)
            found, reached = _before(deadline, model, want, rest, found, rounds, seed)
            low, high = (low, found.arrival_time) if reached else (deadline, high)
    return stop.deliver(replace(found, interrupted=stop.received))


def _from_first(later: Array) -> Array:
    """Rests before each half turn (m, k + 1), s; the first one starts at once."""
    return np.pad(later, ((0, 0), (1, 0)))


def _before(
    deadline: float, model: SwingModel, target: float, rest: RopeState, found: PumpingPlan, rounds: int, seed: int
) -> tuple[PumpingPlan, bool]:
    """Search a plan that reaches the amplitude by a deadline, s; return the better plan, and whether it does."""
    from scipy.optimize import differential_evolution

    count = max(1, math.ceil(deadline / (model.t_move + found.constant_rest)))
    random = np.random.default_rng(seed)
    members, spread = 60, 0.08  # of a generation; s, of the first one about constant rests
    middle = found.constant_rest * np.linspace(0.4, 1.6, members)
    first = np.clip(middle[:, None] + spread * random.standard_normal((members, count)), 0.0, 0.5 * model.period)
    first[0] = np.resize(found.rests, count)
    rollouts = 0

    def shortfall(rests: Array) -> Array:
        nonlocal rollouts
        rollouts += rests.shape[1]
        return np.asarray(target - model.predict(rest, 0, _from_first(rests.T), deadline)[1].max(axis=1))

    result = differential_evolution(
        shortfall,
        [(0.0, 0.5 * model.period)] * count,
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
    tried = found.rollouts + rollouts
    t, amplitude = model.predict(rest, 0, _from_first(result.x[None]), deadline)
    time = float(arrival_time(t, amplitude, target)[0])
    if not math.isfinite(time):
        return replace(found, rollouts=tried), False
    return replace(found, rests=result.x, arrival_time=time, rollouts=tried), True
