"""Rollouts of a set-up: kernel arrays, step control, the state from which a run continues, energy balance."""

import hashlib
import math
import struct
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, extras, memory
from hyperflex.budget import DEFAULT_TIME, Budget
from hyperflex.checks import Array, Integers
from hyperflex.core import joint_law, status
from hyperflex.core.chain.articulated_body import Chain, accelerations, can_stick, mass_matrix, sticks_often
from hyperflex.core.chain.drive import Drive, base_size, motion_at
from hyperflex.core.integrate import rollout
from hyperflex.core.integrate.events import NEVER, Until
from hyperflex.core.integrate.observation import senses
from hyperflex.core.integrate.rollout import (
    AFTER,
    CLOCK,
    INDEX,
    JOINT,
    MARK,
    MODES,
    REJECTED,
    STEP,
    TAKEN,
    UNDECIDED,
    Limits,
    Progress,
    T,
    restart,
)
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.core.integrate.steps import MOST_ORDER, scheme
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.interruption import OutOfTime, defer_while_compiling, raise_if_cancelled
from hyperflex.model import Setup
from hyperflex.status import Status
from hyperflex.trajectory import State

if TYPE_CHECKING:
    import xarray as xr

PREDICTED = 10.0  # s of work, from which the time of a whole run is predicted


class Endless(OutOfTime):
    """Raised in a run without a time budget that would take more than DEFAULT_TIME seconds."""


class Watch:
    """Called between the steps of a run with the time it has reached, s; ends the run by an exception.

    Parameters
    ----------
    given : float, Budget or None
        Time of the run, s; without one, the run ends once its progress predicts more than DEFAULT_TIME s for the whole.
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
            if work > DEFAULT_TIME * done:
                raise Endless


def out_of_time(t: float, cause: BaseException | None, otherwise: str = "") -> SimulationError:
    """Return the error of a run that was ended by OutOfTime, its `cause`, at simulated time t, s."""
    why = "its time budget is over. Allow more, or loosen tol"
    if isinstance(cause, Endless):
        why = (
            f"it would take more than {DEFAULT_TIME / 60.0:g} minutes in all. Check units and gravity, loosen tol, or "
        )
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
            "a fixed step, a check, is not there for so many links",
            got=n,
            allowed=f"up to {RK4_LINKS}",
            fix="Leave it out: the step of the extrapolation does not shrink with the links",
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
BUDGET, SHORT = 2000, 100  # steps between two looks at progress and Ctrl-C, of a rope of so many links or fewer

defer_while_compiling()


def rollout_limits(setup: Setup, chain: Chain, stop: float, until: Until = NEVER) -> Limits:
    """Return the bounds of a run until `stop`, s, or what ends it before; refuses an unstable Runge-Kutta step."""
    budget = max(1, BUDGET * SHORT // max(SHORT, chain.length.size))
    weight, reach = float(chain.mass.sum() + chain.tip_mass) * math.hypot(chain.gx, chain.gy), float(chain.length.sum())
    scale = weight * reach + float(chain.dry.sum())  # dry friction takes its torque times a radian
    least = DRY_ORDER if sticks_often(chain) else LEAST_ORDER
    if setup.step is not None and setup.step > (longest := runge_kutta_limit(chain)):
        raise InvalidInput(
            "step is beyond the stability limit of Runge-Kutta, where results look smooth and are wrong",
            got=setup.step,
            allowed=f"at most {longest:.3e} s for this rope",
            fix="Take a smaller step, or none: the extrapolation has no such limit",
        )
    return Limits(stop, setup.tol, lever(chain), reach, scale, setup.step or 0.0, least, MOST_ORDER, budget, until)


class Rollout:
    """A run of a set-up in progress, in free flight, on plain arrays.

    Parameters
    ----------
    setup : Setup
    t : (T,) float64
        Output times, s; the run begins at the first.
    start : (array, array), optional
        Angles, rad, and rates, rad/s, of the chain (n,); by default those of the set-up.
    chain, drive : Chain, Drive, optional
        Others than the set-up's.
    limits : Limits, optional
        From :func:`rollout_limits`; by default the run ends with the last output.
    logged : bool
        Keep each step, for derivatives; events end steps exactly then.

    Attributes
    ----------
    progress : Progress
    log : (m, 3) float64, or (m, 4 + n) where joints may stick
        The steps taken, as in ``rollout.Progress.log``, of a run that is `logged`.
    y : (T, 2 n + 2) float64
        States at the output times: angles, rates, work, dissipation; the first `done` rows are filled.
    """

    def __init__(
        self,
        setup: Setup,
        t: Array,
        start: tuple[Array, Array] | None = None,
        *,
        chain: Chain | None = None,
        drive: Drive | None = None,
        limits: Limits | None = None,
        logged: bool = False,
    ) -> None:
        self.setup, self.chain, self.drive = setup, chain or setup.chain(), drive or setup.drive()
        self.limits = limits or rollout_limits(setup, self.chain, float(t[-1]) if t.size else 0.0)
        n, own = self.chain.length.size, int(setup.torque_driven)
        self.links = slice(own, n), slice(n + own, 2 * n)  # of a state y: the rope's angles and rates
        y = np.concatenate([*(setup.start() if start is None else start), np.zeros(2)])
        clock = np.zeros(CLOCK)
        clock[:MARK], clock[MARK] = starting_clock(t[0] if t.size else 0.0), -np.inf
        self.log = np.empty((0, MODES + n if can_stick(self.chain) else JOINT))
        room = np.empty((self.limits.budget if logged else 0, self.log.shape[1]))
        self.progress = Progress(y, y.copy(), np.ones(n), np.ones(n), clock, room)
        # A copy of the times, which may be read-only or not: the kernels are compiled for one kind.
        self.t, self.y = np.array(t), np.empty((t.size, y.size))
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
        code = int(rollout.run(*given, self.t, self.y))
        if self.progress.log.size:
            counts = self.progress.clock[[TAKEN, REJECTED]]
            if self.log.size:
                what = f"a run of more than {len(self.log)} steps"
                memory.check(2.0 * self.log.nbytes, what, "Make it shorter, or loosen tol")
            self.log = np.concatenate([self.log, self.progress.log[: int(counts[0] - counts[1])]])
            self.progress.clock[[TAKEN, REJECTED]] = 0.0
        return code

    def finish(self, watch: Callable[[float], None] | None = None, most: float = np.inf) -> int:
        """Run to the end and return the status code; `watch` is called with the time reached, s, between its budgets.

        After `most` budgets of steps the code is RUNNING.
        """
        code, budgets = status.RUNNING, 0
        self.progress.clock[MARK] = -np.inf
        while code in (status.RUNNING, status.LEFT) and budgets < most:
            code, budgets = self.advance(), budgets + 1
            raise_if_cancelled()
            if watch is not None and code in (status.RUNNING, status.LEFT):
                watch(self.time)
        return code

    def complete(self, watch: Callable[[float], None] | None = None) -> None:
        """Run to the end, as :meth:`finish` does; raise the error of a run that fails, or that `watch` ends.

        Without `watch` a `logged` run ends once it would take more than DEFAULT_TIME s.
        """
        if watch is None and self.progress.log.size:
            watch = Watch(None, (self.time, self.limits.stop))
        try:
            code = self.finish(watch)
        except OutOfTime as cause:
            raise out_of_time(self.time, cause) from None
        if code != status.OK:
            raise self.failure(code)

    def failure(self, code: int, time: float | None = None) -> SimulationError:
        """Return the error of a status code: when and where, and what to try; of a sample at `time`, s, if given."""
        n, where = self.chain.length.size, ""
        rates = np.abs(self.progress.y[n : 2 * n])
        if time is None and np.isfinite(rates).any():
            where = f"; fastest link: {int(np.nanargmax(rates))} at {np.nanmax(rates):.3g} rad/s"
        time, name = self.time if time is None else time, status_of(code)
        message = f"stopped at t = {time:.6g} s ({name}{where}): {status.ADVICE[code]}."
        return SimulationError(message, status=name, time=time)

    def end_at_event(self) -> None:
        """Make the instant at which an event ended the run its last output, and the place from which it continues."""
        done, clock = self.done, self.progress.clock
        self.t, self.y = self.t[:done], self.y[:done]
        if done == 0 or self.t[-1] < self.time:
            self.t, self.y = np.append(self.t, self.time), np.concatenate([self.y, self.progress.y[None]])
        clock[INDEX], clock[MARK] = self.t.size, -np.inf

    def resume(self, state: State) -> bool:
        """Continue from a state: bit for bit if nothing but the run's end has changed.

        What was saved counts while the state is as it was saved; one that was changed by hand, or saved where the arm
        was driven in another way, counts by its own values alone. Returns whether what was saved counts.
        """
        rope = self.setup.rope
        shape = (rope.n_links,)
        if not (np.shape(checks.instance("state", state, State).q) == np.shape(state.qd) == shape):
            check_state(state, rope.n_links)
        y, clock, slip, saved = self.progress.y, self.progress.clock, self.progress.slip, state.checkpoint
        slip[:], self.log = 1.0, self.log[:0]
        if self.setup.torque_driven:  # the arm starts where the state says, or else the set-up
            y[0] = self.setup.arm_angle0 if state.arm_angle is None else state.arm_angle
            y[self.chain.length.size] = self.setup.arm_rate0 if state.arm_rate is None else state.arm_rate
        y[self.links[0]], y[self.links[1]], y[-2:] = state.q, state.qd, (state.work, state.dissipated)
        now = saved.get("clock", y[:0])
        as_saved = np.shape(now) == (MARK,) and (now[T], now[STEP]) == (state.t, state.step)
        as_saved = as_saved and np.array_equal(saved.get("y", ()), y)
        if as_saved and "end" in saved and saved["end"][0] == self.fingerprint():
            y[:], slip[:], clock[:MARK] = np.split(saved["end"][1:], [y.size, y.size + slip.size])
        elif as_saved:
            clock[:MARK] = now
            restart(clock)
        else:
            check_state(state, rope.n_links)
            clock[:MARK] = starting_clock(state.t)
            clock[STEP] = state.step or FIRST_STEP
        return bool(as_saved)

    def state(self, row: int | None = None, *, arm: tuple[float, float] | None = None, end: bool = False) -> State:
        """Return the state that the run has reached, or that of an output `row`, where a run begins anew.

        `arm` has angle, rad, and rate, rad/s, of a prescribed arm, by default those of the set-up's motion. With `end`
        it has what a run needs that continues bit for bit.
        """
        y, slip, clock = self.progress.y, self.progress.slip, self.progress.clock
        now, kept = clock[:MARK], {} if row is not None else self.kept()
        if row is not None:
            y, now = self.y[row], starting_clock(float(self.t[row]))
        elif end:  # of a step that was cut, where it began
            cut = self.progress.mark, self.progress.mark_slip, clock[MARK : 2 * MARK]
            kept["end"] = np.concatenate([[self.fingerprint()], *((y, slip, now) if cut[2][0] == -np.inf else cut)])
        if self.setup.torque_driven:
            arm = float(y[0]), float(y[self.chain.length.size])
        elif arm is None:
            motion = base_motion(self.drive, float(now[T]))
            arm = float(motion[4]), float(motion[3])
        q, qd = (y[part].copy() for part in self.links)
        q.setflags(write=False)
        qd.setflags(write=False)
        return State(
            t=float(now[T]),
            q=q,
            qd=qd,
            step=float(now[STEP]),
            work=float(y[-2]),
            dissipated=float(y[-1]),
            checkpoint={"y": y.copy(), "clock": now.copy(), **kept},
            arm_angle=arm[0],
            arm_rate=arm[1],
            **self.shown(row),
        )

    def kept(self) -> dict[str, Any]:
        """Return what else a run that continues needs, by name; nothing in free flight."""
        return {}

    def shown(self, row: int | None) -> dict[str, Any]:
        """Return what a State has of pegs that turn, by name, at an output `row` or at the time reached."""
        return {}

    def fingerprint(self) -> float:
        """Return a fingerprint of what is integrated and how; equal for runs that can be resumed from each other."""
        digest = hashlib.sha256()
        acting = *self.chain, *self.drive, *self.setup.contacts()
        for part in (*acting, self.limits.tol, self.limits.fixed, self.setup.torque_driven):
            digest.update(np.ascontiguousarray(part).tobytes())
        return float(struct.unpack("<Q", digest.digest()[:8])[0] >> 11)  # 53 bits: exact as a float


def dataset_of(t: Array, variables: dict[str, Any]) -> "xr.Dataset":
    """Return an ``xarray.Dataset`` of variables with the dimensions time, s, and perhaps axis, among others."""
    variables |= {"time": ("time", t, {"units": "s"}), "axis": ("axis", np.array(["x", "y"]))}
    made: xr.Dataset = extras.load("xarray", "xarray", "Datasets").Dataset(variables, attrs={"source": "simulated"})
    return made


def status_of(code: int) -> Status:
    """Return the status of a result for the status code of the kernels."""
    return Status.SUCCESS if code in (status.OK, status.REACHED, status.LEFT) else Status(status.NAMES[code])


def check_state(given: object, n: int) -> None:
    """Refuse a state that no run of a rope of n links can begin with."""
    state = checks.instance("state", given, State)
    checks.array("state q", state.q, (n,), unit="rad")
    checks.array("state qd", state.qd, (n,), unit="rad/s")
    checks.number("state step", state.step, sign="nonnegative", unit="s")
    for name, unit in (("t", "s"), ("work", "J"), ("dissipated", "J"), ("arm_angle", "rad"), ("arm_rate", "rad/s")):
        if (value := getattr(state, name)) is not None:
            checks.number(f"state {name}", value, unit=unit)


def starting_clock(t: float) -> Array:
    """Return the clock (MARK,) of a run that begins at time t, s."""
    clock = np.zeros(MARK)
    clock[T], clock[STEP], clock[AFTER], clock[UNDECIDED] = t, FIRST_STEP, np.inf, 1.0
    return clock


def link_accelerations(chain: Chain, drive: Drive, t: float, q: Array, qd: Array) -> Array:
    """Return the links' accelerations (n,), rad/s^2, at time t, s; joints that dry friction holds are locked."""
    n = q.size
    y, base, alphas = np.concatenate([q, qd]), np.empty(base_size(drive)), np.empty(n)
    torque = motion_at(drive, t, base)
    slip = senses(chain, drive, np.array([t]), y[None])
    y.setflags(write=False)  # the kernel is compiled for one kind
    accelerations(chain, y[:n], y[n:], slip[0], base, torque, 0.0, alphas, np.empty(6 * n))
    return alphas


def base_motion(drive: Drive, t: float) -> Array:
    """Return the motion (9,) of the chain's first joint at time t, s, as ``drive.base_state`` orders it."""
    base = np.empty(9)
    motion_at(drive, t, base)
    return base


def lever(chain: Chain) -> Array:
    """Return the lever of each link's mass (n,), m: the larger of its length and its radius of gyration."""
    gyration = np.sqrt(chain.inertia / np.maximum(chain.mass, 1e-300) + chain.com**2)
    return np.maximum(chain.length, np.where(chain.mass > 0.0, np.minimum(gyration, 1e3 * chain.length), 0.0))


class Interval:
    """What drives a run over one interval, written in place: a polynomial for each of its channels.

    They go on beyond the interval's end, so that a run that ends there sees what led to it and not a rest behind it.
    The arrays of `drive`, for the kernels, follow :meth:`set`.
    """

    def __init__(self, drive: Drive) -> None:
        self._breaks, self._coef = np.array([0.0, 1.0]), drive.coef[:1].copy()
        switch = np.ones(2, dtype=np.bool_)
        self.drive = read_only(drive._replace(breaks=self._breaks, coef=self._coef, switch=switch, loop=-1))

    def set(self, begin: float, end: float, channel: int, powers: ArrayLike) -> None:
        """Set a channel to the polynomial `powers` (6,) of the time since `begin`, s, until `end`."""
        self._breaks[:] = begin, 2.0 * end - begin
        self._coef[0, channel] = powers


# A run is refused when its energy balance is off by more than this part of the energy that went through it. Of a rope
# that hardly moves it is compared with a fall by the second part of its length.
ENERGY_ALLOWANCE, LEAST_FALL = 0.02, 0.01


def stored(chain: Chain, q: Array) -> Array:
    """Return the energy (..., T) that links (..., T, n) store above hanging straight, and bent joints, J.

    The first joint is left out, whose parent turns on its own account.
    """
    weight = math.hypot(chain.gx, chain.gy) * first_moment(chain)
    hanging = math.atan2(chain.gx, -chain.gy) if weight.any() else 0.0
    bent = joint_law.spring_energy([value[1:] for value in chain.joints], np.diff(q, axis=-1))
    raised = (weight * (1.0 - np.cos(q - hanging))).sum(axis=-1)
    return np.asarray(raised + bent.sum(axis=-1))


def balanced(setups: Sequence[Setup], energies: Array, held: Callable[[int], Array]) -> Integers:
    """Return the number of leading samples (M,) of each member whose energy balance holds.

    Parameters
    ----------
    setups : sequence of M Setup
    energies : (4, M, T) float64
        Kinetic and potential energy, work and dissipation, J; the balance is drawn against the first sample.
    held : callable
        Returns what a member's links store (T,), J (:func:`stored`): it may have been kinetic between two samples, so
        it counts for the scale. It is computed where the balance does not hold without.
    """
    kinetic, _, work, dissipated = energies
    ropes = [setup.rope for setup in setups]
    floor = LEAST_FALL * np.array([[each.total_mass * each.total_length * each.g] for each in ropes])
    gained = energies - energies[..., :1]
    change = gained[0] + gained[1]
    error = np.abs(change - gained[2] + gained[3])

    def good(rows: Any, more: float | Array) -> Integers:
        parts = work[rows], dissipated[rows], kinetic[rows] + more, change[rows]
        scale = sum(np.maximum.accumulate(np.abs(part), axis=1) for part in parts)
        bad = ~(error[rows] <= ENERGY_ALLOWANCE * (scale + floor[rows]) + 1e-300)
        return np.asarray(np.where(bad.any(axis=1), bad.argmax(axis=1), bad.shape[1]))

    found = good(slice(None), 0.0)
    for m in np.flatnonzero(found < error.shape[1]).tolist():
        found[m] = good([m], held(m))[0]
    return found
