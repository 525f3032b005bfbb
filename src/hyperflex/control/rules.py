"""Rules for the start of half turns, the paper's timing control, and their closed loop.

At each rest of the arm the rule gets the rope's state and returns the next start.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control.state_source import hanging_state
from hyperflex.control.swing_model import SOON, SwingModel, arrival_time
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState, StateSource
from hyperflex.interruption import interruptible, stoppable
from hyperflex.motion import Motion


class Rule(Protocol):
    """A rule for the start of the next half turn."""

    def next_start(self, now: RopeState, made: int) -> float:
        """Return the start of the next half turn, s, not before `now`, after `made` half turns; inf for none.

        The arm rests. It is called once in each rest.
        """


class CrossingRule:
    """The paper's timing rule: start `lead` before the tip crosses x = 0, the crossing predicted with the arm at rest.

    Parameters
    ----------
    model : SwingModel
        For the prediction.
    lead : float
        t_b of the paper, s; negative: that long after the crossing.

    Notes
    -----
    Paper section IV.B and Fig. 13. What the paper leaves open is read like this: the crossing is the next one, in
    either sense, after the arm has come to rest, and where it is nearer than `lead` the arm starts at once. With a
    negative `lead`, which the paper does not try, a crossing no longer ago than that counts too: it happens while the
    arm still moves, and is predicted from the state in which that half turn was decided.
    """

    def __init__(self, model: SwingModel, lead: float = 0.0) -> None:
        self.model = model
        self.lead = checks.number("lead", lead, unit="s")
        # half turns after the last decision, the state that it saw, and its start, s; the first one is not decided
        self._last = 1, hanging_state(model.rope), 0.0

    def next_start(self, now: RopeState, made: int) -> float:
        """Return the start of the next half turn, s; now if the tip does not cross within a period."""
        crossing, (count, before, start) = math.inf, self._last
        if self.lead < 0.0 and count == made:
            moving = self.model.motion([start], made - 1)
            crossing = self.model.crossing(before, moving, after=now.t + self.lead, until=now.t)
        if math.isinf(crossing):
            resting = self.model.motion([], made)
            crossing = self.model.crossing(now, resting, after=now.t + SOON, until=now.t + self.model.period)
        start = now.t if math.isinf(crossing) else max(now.t, crossing - self.lead)
        self._last = made + 1, now, start
        return start


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """Half turns of a closed loop: the `starts` (k,), s, and the motion of the arm."""

    starts: Array
    motion: Motion


@interruptible()
def run_closed_loop(source: StateSource, rule: Rule, model: SwingModel, *, duration: float) -> ClosedLoopRun:
    """Swing a rope that hangs at rest; the rule determines the start of each half turn.

    Parameters
    ----------
    source : StateSource
    rule : Rule
    model : SwingModel
        Its half turns are made. The first one starts at t = 0.
    duration : float
        No half turn starts at or after this, s.

    Raises
    ------
    InvalidInput
        A duration that is not positive.
    SimulationError
        A prediction failed.

    Examples
    --------
    >>> import hyperflex as hf
    >>> from hyperflex.control import CrossingRule, SwingModel, TrueState, run_closed_loop
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> model = SwingModel(cable, hf.Arm())
    >>> swung = run_closed_loop(TrueState(cable, hf.Arm()), CrossingRule(model, 0.0), model, duration=3.0)
    >>> [round(float(start), 2) for start in swung.starts]
    [0.0, 1.03, 1.78, 2.99]
    """
    end = checks.positive("duration", duration, "s")
    starts = [0.0]
    while True:
        motion, now = model.motion(starts), starts[-1] + model.t_move
        start = end if now >= end else rule.next_start(source.state(now, motion), len(starts))
        if start >= end:
            return ClosedLoopRun(np.array(starts), motion)
        starts.append(start)


class LookaheadRule(ABC):
    """Receding horizon: the next rests by coordinate search over the model's predictions; each sweep is one batch.

    Parameters
    ----------
    model : SwingModel
    target : float
        Amplitude ``|x|`` of the tip, m, > 0.
    depth : int
        Rests that are optimized together; the first one is used, the others are the next search's start.
    """

    coarse, fine = 0.04, 0.01  # s, between rests that are tried
    horizon = 1.38  # periods to look ahead: the next half turn and the swing that it drives

    def __init__(self, model: SwingModel, target: float, *, depth: int = 2) -> None:
        self.model = model
        self.target = checks.positive("target", target, "m")
        self.rests = np.full(checks.count("depth", depth), model.usual_rest)

    @abstractmethod
    def cost(self, t: Array, amplitude: Array) -> Array:
        """Return the cost (m,) of predicted amplitudes (m, T), m, at times `t` (T,) from now on, s."""

    def next_start(self, now: RopeState, made: int) -> float:
        """Return the start of the next half turn, s."""
        self.rests = np.append(self.rests[1:], self.model.usual_rest)
        span, longest = self.horizon * self.model.period, 0.6 * self.model.period
        for k in range(self.rests.size):
            self._choose(k, np.arange(0.0, longest, self.coarse), span, now, made)
        for k in range(self.rests.size):
            self._choose(k, self.rests[k] + self.fine * np.arange(-4, 5), span, now, made)
        return now.t + float(self.rests[0])

    def _choose(self, k: int, tried: Array, span: float, now: RopeState, made: int) -> None:
        """Replace rest k by the best of the values `tried` (m,), s, and its own, looking ahead by a span, s."""
        values = np.unique(np.append(np.maximum(tried, 0.0), self.rests[k]))
        plans = np.tile(self.rests, (values.size, 1))
        plans[:, k] = values
        self.rests = plans[int(np.argmin(self.cost(*self.model.predict(now, made, plans, span))))]


class PumpingRule(LookaheadRule):
    """Pump the tip to a target amplitude as soon as possible.

    Parameters
    ----------
    model, target, depth
        As of :class:`LookaheadRule`.
    rests : (k,) array_like, optional
        Planned rests after the first, second, ... half turn, s, from :func:`optimize_pumping`. All that are left are
        adjusted at each call, over the rest of the plan.
    arrival_time : float, optional
        Time at which the plan reaches the amplitude, s.

    Notes
    -----
    If the model predicts the amplitude within the horizon, the earliest arrival is chosen; else the greatest amplitude.
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
        rests: ArrayLike | None = None,
        arrival_time: float | None = None,
        depth: int = 2,
    ) -> None:
        super().__init__(model, target, depth=depth)
        self.plan = None if rests is None else checks.array("rests", rests, (-1,), sign="nonnegative", unit="s")
        self.arrival_time = 0.0 if arrival_time is None else checks.positive("arrival_time", arrival_time, "s")
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
        left = max(0.5 * self.model.period, self.arrival_time - now.t) + self.margin * self.model.period
        for step in self.steps:
            for k in range(self.rests.size):
                self._choose(k, self.rests[k] + step * np.arange(-2, 3), left, now, made)
        return now.t + float(self.rests[0])


class AmplitudeRule(LookaheadRule):
    """Bring the swing to a target amplitude and keep it near there, never beyond.

    Parameters
    ----------
    model, target, depth
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
        end, half = self.horizon * self.model.period, 0.55 * self.model.period
        late, before = t > end - half, (t <= end - half) & (t > end - 2.0 * half)
        short = np.abs(self.target - amplitude[:, late].max(axis=1))
        short = short + 0.2 * np.abs(self.target - amplitude[:, before].max(axis=1, initial=0.0))
        return np.asarray(short + self.overshoot_cost * np.maximum(amplitude.max(axis=1) - self.target, 0.0))


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
    search cannot prove that there is nothing better. Costs thousands of rollouts per deadline.
    """
    from scipy.optimize import differential_evolution

    want = checks.positive("target", target, "m")
    rounds = checks.count("rounds", rounds, least=0)
    begin, most, rollouts = hanging_state(model.rope), 0.5 * model.period, 0

    def predicted(rests: Array, until: float) -> tuple[Array, Array]:
        """Predict half turns of which the first starts at once, and the others after rests (m, k), s."""
        nonlocal rollouts
        rollouts += len(rests)
        return model.predict(begin, 0, np.pad(rests, ((0, 0), (1, 0))), until)

    def shortfall(rests: Array, deadline: float) -> Array:
        return np.asarray(want - predicted(rests.T, deadline)[1].max(axis=1))

    constants = np.arange(0.0, most, 0.01)
    t, amplitude = predicted(np.tile(constants[:, None], (1, max(2, math.ceil(longest / model.t_move)))), longest)
    times = arrival_time(t, amplitude, want)
    arrival, rest = float(times.min()), float(constants[np.argmin(times)])
    if not math.isfinite(arrival):
        raise InvalidInput(
            "no constant rest pumps the rope up so far",
            got=want,
            allowed=f"at most {amplitude.max():.2f} m in {longest:g} s",
        )
    rests = np.full(max(1, int(arrival / (model.t_move + rest))), rest)
    found = PumpingPlan(rests, arrival, rest, arrival, rollouts)
    low, high = arrival - 0.6 * model.period, arrival
    with stoppable() as stop:
        while rounds and high - low > 0.04:  # s, to which the deadline is bisected
            deadline = 0.5 * (low + high)
            count = max(1, math.ceil(deadline / (model.t_move + rest)))
            random = np.random.default_rng(seed)
            members, spread = 60, 0.08  # of a generation; s, of the first one about constant rests
            middle = rest * np.linspace(0.4, 1.6, members)
            first = np.clip(middle[:, None] + spread * random.standard_normal((members, count)), 0.0, most)
            first[0] = np.resize(found.rests, count)
            result = differential_evolution(
                shortfall,
                [(0.0, most)] * count,
                args=(deadline,),
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
            arrival = float(arrival_time(*predicted(result.x[None], deadline), want)[0])
            if math.isfinite(arrival):
                found, high = replace(found, rests=result.x, arrival_time=arrival), arrival
            else:
                low = deadline
    return stop.deliver(replace(found, rollouts=rollouts, interrupted=stop.received))
