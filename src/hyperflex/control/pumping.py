"""Receding-horizon rules: half turns start when the model predicts the best swing (better than the paper's rule)."""

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control.swing_model import SwingModel, arrival_time
from hyperflex.interfaces import RopeState


class LookaheadRule(ABC):
    """Receding horizon: the next rests by coordinate search over the model's predictions; each sweep is one batch.

    Parameters
    ----------
    model : SwingModel
    target : float
        Amplitude ``|x|`` of the tip, m, > 0.
    depth : int
        Rests that are optimized together; the first one is used, the others are the next search's start.
    horizon : float, optional
        Time to look ahead, s; by default 1.38 periods of the rope: the next half turn and the swing that it drives.
    """

    coarse, fine = 0.04, 0.01  # s, between rests that are tried

    def __init__(self, model: SwingModel, target: float, *, depth: int = 2, horizon: float | None = None) -> None:
        self.model = model
        self.target = checks.number("target", target, sign="positive", unit="m")
        depth = checks.count("depth", depth)
        period = model.period
        self.horizon = 1.38 * period
        if horizon is not None:
            self.horizon = checks.number("horizon", horizon, sign="positive", unit="s")
        self.longest = 0.6 * period
        self.rests = np.full(depth, model.usual_rest)
        self._before = (0, 0.0)  # half turns made, and time, s, at the last call

    @abstractmethod
    def cost(self, t: Array, amplitude: Array) -> Array:
        """Return the cost (m,) of predicted amplitudes (m, T), m, at times `t` (T,) from now on, s."""

    def next_start(self, now: RopeState, made: int) -> float:
        """Return the start of the next half turn, s."""
        if not self._waited(now, made):
            self.rests = np.append(self.rests[1:], self.model.usual_rest)
        for k in range(self.rests.size):
            self._choose(k, np.arange(0.0, self.longest, self.coarse), self.horizon, now, made)
        for k in range(self.rests.size):
            self._choose(k, self.rests[k] + self.fine * np.arange(-4, 5), self.horizon, now, made)
        return now.t + float(self.rests[0])

    def _waited(self, now: RopeState, made: int) -> bool:
        """Whether this is another call in the same rest; then the time since the last call is taken off its rest."""
        again = made == self._before[0]
        if again:
            self.rests[0] = max(0.0, self.rests[0] - (now.t - self._before[1]))
        self._before = (made, now.t)
        return again

    def _choose(self, k: int, tried: Array, horizon: float, now: RopeState, made: int) -> None:
        """Replace rest k by the best of the values `tried` (m,), s, and its own."""
        values = np.unique(np.append(np.maximum(tried, 0.0), self.rests[k]))
        plans = np.tile(self.rests, (values.size, 1))
        plans[:, k] = values
        costs = self.cost(*self.model.predict(now, made, plans, horizon))
        self.rests = plans[int(np.argmin(costs))]


class PumpingRule(LookaheadRule):
    """Pump the tip to a target amplitude as soon as possible.

    Parameters
    ----------
    model, target, depth, horizon
        As of :class:`LookaheadRule`.
    rests : (k,) array_like, optional
        Planned rests after the first, second, ... half turn, s, from :func:`optimize_pumping`. All that are left are
        adjusted at each call, over the rest of the plan.
    arrival_time : float, optional
        Time at which the plan reaches the amplitude, s.

    Notes
    -----
    Where the model predicts the amplitude within the horizon, the soonest arrival wins; else the greatest amplitude.
    Without a plan this is greedy: a fixed horizon trades power against time, half turn by half turn. Not from the
    paper, which leaves more efficient casting to future work.
    """

    shortfall_cost = 3.0  # s/m
    steps = (0.05, 0.02, 0.007)  # s, by which the rests of a plan are moved
    margin = 0.1  # periods to look ahead beyond the end of a plan

    def __init__(
        self,
        model: SwingModel,
        target: float,
        *,
        rests: npt.ArrayLike | None = None,
        arrival_time: float | None = None,
        depth: int = 2,
        horizon: float | None = None,
    ) -> None:
        super().__init__(model, target, depth=depth, horizon=horizon)
        self.plan = None if rests is None else checks.array("rests", rests, (-1,), sign="nonnegative", unit="s")
        self.arrival_time = 0.0
        if arrival_time is not None:
            self.arrival_time = checks.number("arrival_time", arrival_time, sign="positive", unit="s")
        if self.plan is not None:
            self.rests = np.append(0.0, self.plan)

    def cost(self, t: Array, amplitude: Array) -> Array:
        """Return the arrival time, s; without arrival the end and `shortfall_cost` times the shortfall."""
        first = arrival_time(t, amplitude, self.target)
        return np.where(np.isfinite(first), first, t[-1] + self.shortfall_cost * (self.target - amplitude.max(axis=1)))

    def next_start(self, now: RopeState, made: int) -> float:
        """Return the start of the next half turn, s."""
        if self.plan is None or made > self.plan.size:
            return super().next_start(now, made)
        self.rests = self.rests[-(self.plan.size - made + 1) :].copy()
        self._waited(now, made)
        left = max(0.5 * self.model.period, self.arrival_time - now.t) + self.margin * self.model.period
        for step in self.steps:
            for k in range(self.rests.size):
                self._choose(k, self.rests[k] + step * np.arange(-2, 3), left, now, made)
        return now.t + float(self.rests[0])


class AmplitudeRule(LookaheadRule):
    """Bring the swing to a target amplitude and keep it near there, never beyond.

    Parameters
    ----------
    model, target, depth, horizon
        As of :class:`LookaheadRule`.

    Notes
    -----
    The cost is the shortfall of the greatest amplitude in the last half period of the horizon, a fifth of that in the
    half before, and `overshoot_cost` times the overshoot of any point. Half turns are all of one size, so the amplitude
    cannot be kept exactly: half turns that drive and half turns that brake alternate.
    """

    overshoot_cost = 20.0  # of an overshoot, relative to a shortfall

    def cost(self, t: Array, amplitude: Array) -> Array:
        """Return the shortfall, m, and `overshoot_cost` times the overshoot, m."""
        half = 0.55 * self.model.period
        late, before = t > self.horizon - half, (t <= self.horizon - half) & (t > self.horizon - 2.0 * half)
        short = np.abs(self.target - amplitude[:, late].max(axis=1))
        short = short + 0.2 * np.abs(self.target - amplitude[:, before].max(axis=1, initial=0.0))
        return np.asarray(short + self.overshoot_cost * np.maximum(amplitude.max(axis=1) - self.target, 0.0))
