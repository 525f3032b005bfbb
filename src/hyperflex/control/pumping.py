"""Better than the paper's rule: half turns started when, as the model foresees it, they serve the swing best."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control.caster import Caster
from hyperflex.control.reach import soonest
from hyperflex.interfaces import RopeState

COARSE, FINE = 0.04, 0.01  # s, between rests that are tried
STEPS = (0.05, 0.02, 0.007)  # s, by which the rests of a plan are moved
HORIZON = 1.38  # periods of the rope that are looked ahead: the next half turn and the swing that it drives
MARGIN = 0.1  # periods beyond the end of a plan that are looked ahead
OVERSHOOT_COST = 20.0  # of a metre too far, in metres too little


class Lookahead(ABC):
    """Chooses the next rests by coordinate search over what the model foresees; each sweep is one batch.

    Parameters
    ----------
    caster : Caster
        The model.
    wanted : float
        ``|x|`` of the tip, m, > 0.
    depth : int
        Rests that are chosen together; the first one is used, the others are where the next search starts.
    horizon : float, optional
        How far to look ahead, s; 1.38 periods if not given.
    """

    def __init__(self, caster: Caster, wanted: float, *, depth: int = 2, horizon: float | None = None) -> None:
        self.caster = caster
        self.wanted = checks.number("wanted", wanted, sign="positive", unit="m")
        depth = checks.count("depth", depth)
        period = caster.period
        self.horizon = HORIZON * period
        if horizon is not None:
            self.horizon = checks.number("horizon", horizon, sign="positive", unit="s")
        self.longest = 0.6 * period
        self.rests = np.full(depth, caster.usual_rest)
        self._before = (0, 0.0)  # half turns made, and time, s, at the last look

    @abstractmethod
    def cost(self, t: Array, reach: Array) -> Array:
        """Return the cost (m,) of foreseen ways (m, T) of ``|x|``, m, at times `t` (T,) from now on, s."""

    def next_start(self, now: RopeState, made: int) -> float:
        """Return when the next half turn shall start, s."""
        if not self._waited(now, made):
            self.rests = np.append(self.rests[1:], self.caster.usual_rest)
        coarse, fine = np.arange(0.0, self.longest, COARSE), FINE * np.arange(-4, 5)
        for k in range(self.rests.size):
            self._choose(k, coarse, self.horizon, now, made)
        for k in range(self.rests.size):
            self._choose(k, self.rests[k] + fine, self.horizon, now, made)
        return now.t + float(self.rests[0])

    def _waited(self, now: RopeState, made: int) -> bool:
        """Whether this is another look in the same rest, of which a part is over then."""
        again = made == self._before[0]
        if again:
            self.rests[0] = max(0.0, self.rests[0] - (now.t - self._before[1]))
        self._before = (made, now.t)
        return again

    def _choose(self, k: int, tried: Array, horizon: float, now: RopeState, made: int) -> None:
        """Replace rest k by the best of those `tried` (m,), s, or leave it."""
        values = np.unique(np.append(np.maximum(tried, 0.0), self.rests[k]))
        plans = np.tile(self.rests, (values.size, 1))
        plans[:, k] = values
        costs = self.cost(*self.caster.foresee(now, made, plans, horizon))
        self.rests = plans[int(np.argmin(costs))]


class Pump(Lookahead):
    """Pump the tip out to a wanted ``|x|`` as soon as possible.

    Parameters
    ----------
    caster, wanted, depth, horizon
        As of :class:`Lookahead`.
    plan : (k,) array_like, optional
        Rests after the first, second, ... half turn, s, as :func:`plan_pumping` finds them. They are followed, and at
        each look all that are left are adjusted to where the rope is, over the whole rest of the plan.
    reached : float, optional
        When the plan reaches what is wanted, s.

    Notes
    -----
    Where the wanted reach is foreseen, the soonest wins; else the greatest reach within the horizon. Without a plan
    this is greedy: a horizon that is fixed in time trades power against time, half turn by half turn. Not from the
    paper, which leaves more efficient casting to future work.
    """

    def __init__(
        self,
        caster: Caster,
        wanted: float,
        *,
        plan: npt.ArrayLike | None = None,
        reached: float | None = None,
        depth: int = 2,
        horizon: float | None = None,
    ) -> None:
        super().__init__(caster, wanted, depth=depth, horizon=horizon)
        self.plan = None if plan is None else checks.array("plan", plan, (-1,), sign="nonnegative", unit="s")
        self.reached = 0.0 if reached is None else checks.number("reached", reached, sign="positive", unit="s")
        if self.plan is not None:
            self.rests = np.append(0.0, self.plan)

    def cost(self, t: Array, reach: Array) -> Array:
        """Return the time to the wanted reach, s, if it is foreseen; else more than any such time, less the reach."""
        return soonest(t, reach, self.wanted)

    def next_start(self, now: RopeState, made: int) -> float:
        """Return when the next half turn shall start, s."""
        if self.plan is None or made > self.plan.size:
            return super().next_start(now, made)
        self.rests = self.rests[-(self.plan.size - made + 1) :].copy()
        self._waited(now, made)
        left = max(0.5 * self.caster.period, self.reached - now.t) + MARGIN * self.caster.period
        for step in STEPS:
            for k in range(self.rests.size):
                self._choose(k, self.rests[k] + step * np.arange(-2, 3), left, now, made)
        return now.t + float(self.rests[0])


class Regulate(Lookahead):
    """Bring the swing to a wanted ``|x|`` and keep it near there, never beyond.

    Parameters
    ----------
    caster, wanted, depth, horizon
        As of :class:`Lookahead`.

    Notes
    -----
    The cost is how far the farthest point in the last half period of the horizon, and less so in the half before, falls
    short, and twenty times what any point overshoots. Half turns are all of one size, so the swing cannot be kept
    exactly: half turns that drive and half turns that brake alternate.
    """

    def cost(self, t: Array, reach: Array) -> Array:
        """Return what is missing, m, and twenty times what is too much, m."""
        half = 0.55 * self.caster.period
        late, before = t > self.horizon - half, (t <= self.horizon - half) & (t > self.horizon - 2.0 * half)
        short = np.abs(self.wanted - reach[:, late].max(axis=1))
        short = short + 0.2 * np.abs(self.wanted - reach[:, before].max(axis=1, initial=0.0))
        return np.asarray(short + OVERSHOOT_COST * np.maximum(reach.max(axis=1) - self.wanted, 0.0))
