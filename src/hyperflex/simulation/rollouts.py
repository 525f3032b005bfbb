"""Rollouts of a set-up: kernel arrays, step control, torque callbacks."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.core import joint_law, status
from hyperflex.core.chain.articulated_body import Chain, accelerations, mass_matrix, sticks_often
from hyperflex.core.chain.drive import Drive, motion_at
from hyperflex.core.integrate import rollout
from hyperflex.core.integrate.events import NEVER, Until
from hyperflex.core.integrate.observation import senses
from hyperflex.core.integrate.rollout import AFTER, CLOCK, INDEX, MARK, STEP, UNDECIDED, Limits, Progress, T
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.core.integrate.steps import MOST_ORDER, scheme
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.interruption import OutOfTime, defer_while_compiling, raise_if_cancelled
from hyperflex.model import Rope, Setup
from hyperflex.status import Status

# s of processor time: allowed to a run without a time budget, and spent before the whole is predicted
LONGEST, PREDICTED = 1800.0, 10.0


class Endless(OutOfTime):
    """Raised in a run without a time budget that would take more than LONGEST seconds."""


class Watch:
    """Called between the steps of a run with the time it has reached, s; ends the run by an exception.

    Parameters
    ----------
    given : float, Budget or None
        Time of the run, s; without one, the run ends once its progress predicts more than LONGEST s for the whole.
    span : (float, float)
        Simulated time at which the run begins and ends, s.
    report : callable, optional
        Called with the time reached, s.
    """

    def __init__(
        self,
        given: float | Budget | None,
        span: tuple[float, float],
        report: Callable[[float], None] | None = None,
    ) -> None:
        self.budget, (self._begin, self._end) = Budget.of(given), span
        self.report = report or (lambda t: None)
        self._work = Budget(clock=time.thread_time) if given is None else None  # a busy machine ends no run

    def __call__(self, t: float) -> None:
        """Report the time reached, t, s, and raise OutOfTime or KeyboardInterrupt if the run has to end there."""
        self.report(t)
        self.budget.check()
        if self._work is not None and (work := self._work.elapsed) > PREDICTED:
            done = (t - self._begin) / (self._end - self._begin)
            if work > LONGEST * done:
                raise Endless


def out_of_time(t: float, cause: BaseException | None, otherwise: str = "") -> SimulationError:
    """Return the error of a run that was ended by OutOfTime, its `cause`, at simulated time t, s."""
    why = "its time budget is over. Allow more, or loosen tol"
    if isinstance(cause, Endless):
        why = f"it would take more than {LONGEST / 60.0:g} minutes in all. Check units and gravity, loosen tol, or "
        why += f"make it shorter{otherwise}"
    return SimulationError(
        f"stopped at t = {t:.6g} s ({Status.OUT_OF_TIME}): {why}.", status=Status.OUT_OF_TIME, time=t
    )


RK4_LINKS = 1000  # beyond, eigenvalues of dense matrices take minutes


def runge_kutta_limit(chain: Chain) -> float:
    """Longest stable step of the classical Runge-Kutta method for a chain that hangs straight, s.

    The linearised chain M qdd + C qd + K q = 0 has the eigenvalues z; a step h is stable while the method's growth
    factor |1 + hz + (hz)^2 / 2 + (hz)^3 / 6 + (hz)^4 / 24| stays below 1 for all of them. Aligned links have the least
    inertia against relative motion of neighbours, so no other posture has a faster friction mode. For a uniform
    friction-bound cable this is 2.785 m l^2 / (48 eta). Infinite for a chain without gravity and joint torques.

    Raises InvalidInput for more than RK4_LINKS links.
    """
    n = chain.length.size
    if n > RK4_LINKS:
        raise InvalidInput(
            "method='rk4', a check, is not there for so many links",
            got=n,
            allowed=f"up to {RK4_LINKS}",
            fix="Take method='extrapolation', whose step does not shrink with the links",
        )
    mass = np.empty((n, n))
    mass_matrix(chain, np.zeros(n), mass)
    relative = np.eye(n) - np.eye(n, k=-1)

    def resistance(by_rate: float, by_angle: float) -> Array:
        own, back = joint_law.jacobian(chain.joints, len(chain.reaction) - 1.0, by_rate, by_angle)
        return (np.diag(own) - np.diag(back[1:], k=1)) @ relative

    weight = math.hypot(chain.gx, chain.gy) * first_moment(chain)
    damping, stiffness = resistance(1.0, 0.0), resistance(0.0, 1.0) + np.diag(weight)
    system = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]]
    )
    z = np.linalg.eigvals(system)
    if not z.any():  # nothing but inertia: every step is stable
        return math.inf
    z = z[np.abs(z) > 1e-9 * np.abs(z).max()]
    low, high = 0.0, 3.0 / float(np.abs(z).max())
    for _ in range(40):
        middle = 0.5 * (low + high)
        hz = middle * z
        growth = np.abs(1.0 + hz * (1.0 + hz / 2.0 * (1.0 + hz / 3.0 * (1.0 + hz / 4.0)))).max()
        low, high = (middle, high) if growth <= 1.0 + 1e-9 else (low, middle)
    return low


def first_moment(chain: Chain) -> Array:
    """Mass times lever of each link and of all beyond it about the link's motor-side joint (n,), kg m; p in (M.4)."""
    outer = np.cumsum(chain.mass[::-1])[::-1] - chain.mass + chain.tip_mass
    return chain.mass * chain.com + chain.length * outer


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


def balanced(floor: Array, energies: Array, held: Callable[[int], Array]) -> npt.NDArray[np.int64]:
    """Return the number of leading samples (M,) of each member whose energy balance holds.

    Parameters
    ----------
    floor : (M, 1) float64
        Scale of a run in which hardly anything happens, J (:func:`least_scale`).
    energies : (4, M, T) float64
        Kinetic and potential energy, work and dissipation, J; the balance is drawn against the first sample.
    held : callable
        Returns what a member's links store (T,), J (:func:`stored`): it may have been kinetic between two samples, so
        it counts for the scale. It is computed where the balance does not hold without.
    """
    kinetic, _, work, dissipated = energies
    gained = energies - energies[..., :1]
    change = gained[0] + gained[1]
    error = np.abs(change - gained[2] + gained[3])

    def good(rows: Any, more: float | Array) -> npt.NDArray[np.int64]:
        parts = work[rows], dissipated[rows], kinetic[rows] + more, change[rows]
        scale = sum(np.maximum.accumulate(np.abs(part), axis=1) for part in parts)
        bad = ~(error[rows] <= ENERGY_ALLOWANCE * (scale + floor[rows]) + 1e-300)
        return np.asarray(np.where(bad.any(axis=1), bad.argmax(axis=1), bad.shape[1]))

    found = good(slice(None), 0.0)
    for m in np.flatnonzero(found < error.shape[1]).tolist():
        found[m] = good([m], held(m))[0]
    return found
