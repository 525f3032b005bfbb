"""Rollouts of a set-up: kernel arrays, step control, torque callbacks."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core import joint_law, status
from hyperflex.core.chain.articulated_body import Chain, accelerations, sticks_often
from hyperflex.core.chain.drive import TORQUE, Drive, motion_at
from hyperflex.core.integrate import rollout
from hyperflex.core.integrate.events import NEVER, Until
from hyperflex.core.integrate.observation import senses
from hyperflex.core.integrate.rollout import AFTER, CLOCK, INDEX, MARK, STEP, UNDECIDED, Limits, Progress, T, restart
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.core.integrate.steps import MOST_ORDER, scheme
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput
from hyperflex.interruption import defer_while_compiling, raise_if_cancelled
from hyperflex.model import Control, Rope, Setup
from hyperflex.motion import Motion, hold_arm
from hyperflex.simulation.stability import first_moment, runge_kutta_limit

# Orders that a run chooses from, step by step: seven fills four lanes without a gap, lower ones save no time, and eight
# (MOST_ORDER) is worth its rounds at tight tolerances.
LEAST_ORDER = 7
DRY_ORDER = 3  # the least where many joints may stick, whose events cut steps short
TABLES = tuple(scheme(order) for order in range(DRY_ORDER - 1, MOST_ORDER + 1))
# A run is refused when its energy balance is off by more than this part of the energy that went through it.
ENERGY_ALLOWANCE = 0.02
BUDGET, SHORT = 2000, 100  # steps between two looks at progress and Ctrl-C, of a rope of so many links or fewer

defer_while_compiling()


@dataclass
class Rollout:
    """A run in progress on plain arrays.

    Attributes
    ----------
    chain, drive : Chain, Drive
    limits : Limits
    progress : Progress
    t : (T,) float64
        Output times, s.
    y : (T, 2 n + 2) float64
        States at those times: angles, rates, work, dissipation; the first `done` rows are filled.
    seen : (T, 3 n + 4 + 2 m) float64, optional
        Beside m obstacles: what ``contact_run.run`` saw at each time; NaN in free flight, but for pegs that turn.
    spin : (2, m) float64, optional
        Beside obstacles: their angles, rad, and rates, rad/s, at the time reached.
    facts, kept : dict
        Beside pegs: counts and extremes of contacts for the trajectory, and what a run that goes on needs of them.
    """

    chain: Chain
    drive: Drive
    limits: Limits
    progress: Progress
    t: Array
    y: Array
    seen: Array | None = None
    spin: Array | None = None
    facts: dict[str, float] = field(default_factory=dict)
    kept: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Find out which events are watched; neither the chain nor what ends the run changes."""
        self._events = rollout.watched(self.chain, self.limits.until)

    @property
    def done(self) -> int:
        """Number of output rows written."""
        return int(self.progress.clock[INDEX])

    @property
    def time(self) -> float:
        """Time reached, s."""
        return float(self.progress.clock[T])

    def advance(self) -> int:
        """Run for one budget of steps and return the status code."""
        given = self.chain, self.drive, TABLES, self.limits, self._events, self.progress
        return int(rollout.run(*given, self.t, self.y))


def prepare_rollout(
    chain: Chain, drive: Drive, start: tuple[Array, Array], t: Array, limits: Limits, log: Array | None = None
) -> Rollout:
    """Make a rollout of angles and rates `start` (n,) from time ``t[0]`` with outputs at `t`; steps go to the `log`."""
    n = chain.length.size
    y = np.zeros(2 * n + 2)
    y[:n], y[n : 2 * n] = start
    clock = np.zeros(CLOCK)
    clock[:MARK] = starting_clock(t[0])
    clock[MARK] = -np.inf
    noted = np.empty((0, 3)) if log is None else log
    progress = Progress(y, y.copy(), np.ones(n), np.ones(n), clock, noted)
    # A copy of the times, which may be read-only or not: the kernels are compiled for one kind.
    return Rollout(chain, drive, limits, progress, np.array(t), np.empty((t.size, 2 * n + 2)))


def starting_clock(t: float) -> Array:
    """Return the clock (MARK,) of a run that begins at time t, s."""
    clock = np.zeros(MARK)
    clock[T], clock[STEP], clock[AFTER], clock[UNDECIDED] = t, FIRST_STEP, np.inf, 1.0
    return clock


def link_accelerations(chain: Chain, drive: Drive, t: float, q: Array, qd: Array) -> Array:
    """Return the links' accelerations (n,), rad/s^2, at time t, s; joints that dry friction holds are locked."""
    n = q.size
    y, base, alphas = np.concatenate([q, qd]), np.empty(9), np.empty(n)
    torque = motion_at(drive, t, base)
    slip = senses(chain, drive, np.array([t]), y[None])
    y.setflags(write=False)  # the kernel is compiled for one kind
    accelerations(chain, y[:n], y[n:], slip[0], base, torque, 0.0, alphas, np.empty(6 * n))
    return alphas


def lever(chain: Chain) -> Array:
    """Return the lever of each link's mass (n,), m: the larger of its length and its radius of gyration."""
    gyration = np.sqrt(chain.inertia / np.maximum(chain.mass, 1e-300) + chain.com**2)
    return np.maximum(chain.length, np.where(chain.mass > 0.0, np.minimum(gyration, 1e3 * chain.length), 0.0))


def rollout_limits(setup: Setup, chain: Chain, stop: float, budget: int = BUDGET, until: Until = NEVER) -> Limits:
    """Return the bounds of a run until `stop`, s, or what ends it before; refuses an unstable Runge-Kutta step."""
    budget = max(1, budget * SHORT // max(SHORT, chain.length.size))
    weight, reach = float(chain.mass.sum() + chain.tip_mass) * math.hypot(chain.gx, chain.gy), float(chain.length.sum())
    scale = weight * reach + float(chain.dry.sum())  # dry friction takes its torque times a radian
    least = DRY_ORDER if sticks_often(chain) else LEAST_ORDER
    bounds = Limits(stop, setup.tol, lever(chain), reach, scale, setup.step or 0.0, least, MOST_ORDER, budget, until)
    if setup.step is None:
        return bounds
    longest = runge_kutta_limit(chain)
    if setup.step > longest:
        raise InvalidInput(
            "step is beyond the stability limit of rk4, where results look smooth and are wrong",
            got=setup.step,
            allowed=f"at most {longest:.3e} s for this rope",
            fix="Take a smaller step, or method='extrapolation', which has no such limit",
        )
    return bounds


def end_at_event(run: Rollout) -> None:
    """Make the instant at which an event ended a run its last output, and the place from which it goes on."""
    done, clock = run.done, run.progress.clock
    if done == 0 or run.t[done - 1] < run.time:
        run.t = np.append(run.t[:done], run.time)
        run.y = np.concatenate([run.y[:done], run.progress.y[None]])
    else:
        run.t, run.y = run.t[:done], run.y[:done]
    clock[INDEX], clock[MARK] = run.t.size, -np.inf


def finish_rollout(run: Rollout, watch: Callable[[float], None] | None = None, most: float = np.inf) -> int:
    """Run to the end and return the status code; `watch` is called with the time reached, s, between its budgets.

    After `most` budgets of steps the code is RUNNING.
    """
    code, budgets = status.RUNNING, 0
    run.progress.clock[MARK] = -np.inf
    while code == status.RUNNING and budgets < most:
        code, budgets = run.advance(), budgets + 1
        raise_if_cancelled()
        if watch is not None and code == status.RUNNING:
            watch(run.time)
    return code


class Interval:
    """What drives a run over one interval, written in place: a polynomial for each of its channels.

    They go on beyond the interval's end, so that a run that ends there sees what led to it and not a rest behind it.
    The arrays of `drive`, for the kernels, follow :meth:`set`.
    """

    def __init__(self, drive: Drive) -> None:
        self._breaks, self._coef = np.array([0.0, 1.0]), drive.coef[:1].copy()
        switch = np.ones(2, dtype=np.bool_)
        self.drive = read_only(drive._replace(breaks=self._breaks, coef=self._coef, switch=switch, loop=-1))

    def set(self, begin: float, end: float, channel: int, powers: npt.ArrayLike) -> None:
        """Set a channel to the polynomial `powers` (6,) of the time since `begin`, s, until `end`."""
        self._breaks[:] = begin, 2.0 * end - begin
        self._coef[0, channel] = powers


@dataclass
class AppliedTorques:
    """Torques of a callback, N m, each with the time when it was set, s."""

    times: list[float] = field(default_factory=list)
    torques: list[float] = field(default_factory=list)

    def motion(self, end: float) -> Motion:
        """Return the torque that keeps each value until the next one, and the last one beyond `end`, s."""
        coef = np.zeros((len(self.times), *hold_arm().coef.shape[1:]))
        coef[:, TORQUE, 0] = self.torques
        breaks = np.append(self.times, max(end, self.times[-1]) + 1.0)
        return Motion(breaks, coef, np.ones(breaks.size, dtype=np.bool_))


def controlled(
    run: Rollout,
    interval: Interval,
    control: Control,
    period: float,
    go: Callable[[], int],
    watch: Callable[[float], None],
    applied: AppliedTorques,
) -> int:
    """Run with a torque that `control` sets every `period`, s; return the last status code.

    The interval's drive drives the run; `go` runs until ``run.limits.stop`` and returns the status code. `watch` is
    called after each period with the time reached, s. Torques are added to `applied`, also if an exception ends the
    run.
    """
    n, limit = run.chain.length.size, run.drive.torque_limit
    begin, stop, code = run.time, run.limits.stop, status.OK
    while run.time < stop and code == status.OK:
        y, now = run.progress.y, run.time
        answer = control(now, float(y[0]), float(y[n]), y[1:n].copy(), y[n + 1 : 2 * n].copy())
        commanded = checks.number(f"torque callback at t = {now:g} s", answer, unit="N m")
        applied.times.append(now)
        applied.torques.append(float(np.clip(commanded, -limit, limit)))
        until = min(begin + len(applied.times) * period, stop)
        interval.set(now, until, TORQUE, [applied.torques[-1], 0.0, 0.0, 0.0, 0.0, 0.0])
        run.limits = run.limits._replace(stop=until)
        code = go()
        restart(run.progress.clock)
        if run.time < stop:
            watch(run.time)
    return code


def stored(chain: Chain, q: Array) -> Array:
    """Return the energy (..., T) that links (..., T, n) store above hanging straight, and bent joints, J.

    The first joint is left out, whose parent turns on its own account.
    """
    weight = math.hypot(chain.gx, chain.gy) * first_moment(chain)
    hanging = math.atan2(chain.gx, -chain.gy) if weight.any() else 0.0
    bent = joint_law.spring_energy([value[1:] for value in chain.joints], np.diff(q, axis=-1))
    raised = (weight * (1.0 - np.cos(q - hanging))).sum(axis=-1)
    return np.asarray(raised + bent.sum(axis=-1))


def least_scale(rope: Rope) -> float:
    """Return the energy, J, that a rope that hardly moves is compared with: a fall by a hundredth of its length."""
    return 0.01 * rope.total_mass * rope.total_length * float(np.hypot(*rope.gravity))


def balanced(
    floor: float | Array, kinetic: Array, potential: Array, held: float | Array, work: Array, dissipated: Array
) -> npt.NDArray[np.int64]:
    """Return the number of leading samples whose energy balance holds.

    Parameters
    ----------
    floor : float or (..., 1) array
        Scale of a run in which hardly anything happens, J (:func:`least_scale`).
    kinetic, potential, held, work, dissipated : (..., T) float64
        J; the first sample is what the balance is drawn against. What is held (:func:`stored`) may have been kinetic
        between two samples, so it counts for the scale.

    Returns
    -------
    (...,) int64
    """
    energy = kinetic + potential
    change = energy - energy[..., :1]
    error = change - (work - work[..., :1]) + (dissipated - dissipated[..., :1])

    def peak(value: Array) -> Array:
        return np.maximum.accumulate(np.abs(value), axis=-1)

    scale = peak(work) + peak(dissipated) + peak(kinetic + held) + peak(change)
    bad = ~(np.abs(error) <= ENERGY_ALLOWANCE * (scale + floor) + 1e-300)
    return np.asarray(np.where(bad.any(axis=-1), bad.argmax(axis=-1), bad.shape[-1]))
