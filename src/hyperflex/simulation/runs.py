"""Whole runs: from rope and motion to a Trajectory."""

import hashlib
import math
import struct
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, Unpack

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex import checks, memory
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.chain.drive import TORQUE, motion_at
from hyperflex.core.integrate import observation as output
from hyperflex.core.integrate.events import NEVER
from hyperflex.core.integrate.rollout import MARK, STEP, T, restart
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.errors import Interrupted, InvalidInput, SimulationError
from hyperflex.interruption import interruptible, raise_if_cancelled, stoppable
from hyperflex.model import DEFAULT_TOL, Arm, Rope, Setup, SetupFields, checked_obstacles, cuts, refine_rope
from hyperflex.motion import Motion, hold_arm
from hyperflex.progress import progress_bar
from hyperflex.simulation.contact import contact_run, shown, spin_energy, split_samples
from hyperflex.simulation.events import Event
from hyperflex.simulation.rollouts import (
    Interval,
    Rollout,
    Watch,
    balanced,
    end_at_event,
    finish_rollout,
    least_scale,
    out_of_time,
    prepare_rollout,
    rollout_limits,
    starting_clock,
    stored,
)
from hyperflex.status import Status
from hyperflex.trajectory import State, Trajectory

Pieces = npt.NDArray[np.int64]
SAMPLE_TIME = 0.01  # s, between outputs if the user does not choose
# Numbers for each link and output, without contact and with it: in memory while a run is written, and in its file
IN_MEMORY, IN_FILE = (11, 15), (5.5, 7.5)
MOST_OUTPUTS = 1e7  # of a run whose user has not chosen; more of them would fill the memory first


def setup_of(rope: Rope | Setup, fields: Mapping[str, Any], *, refine: bool = False) -> tuple[Setup, Pieces | None]:
    """Return the set-up of a rope and of the fields that are not None; or a set-up with these fields replaced.

    With `refine` a rope is cut where its pegs need it; the second value is then the number of pieces of each link.
    """
    given = {name: value for name, value in fields.items() if value is not None}
    if isinstance(rope, Setup):
        return rope.replace(**given) if given else rope, None
    if not isinstance(rope, Rope):
        raise InvalidInput("rope is not a rope", got=rope, allowed="a Rope or a whole Setup")
    if "duration" not in given:
        raise InvalidInput("duration is missing", allowed="a number > 0, in s", fix="Give duration=10.0, say")
    names = [name for name in ("arm_angle0", "arm_rate0") if name in given]
    if names and "torque" not in given:
        fix = "A motion defines where the arm begins; without one the arm rests at 0"
        raise InvalidInput("no torque drives the arm that these begin", got=names, allowed="with torque=...", fix=fix)
    pieces, pegs = None, checked_obstacles(given.get("pegs", ()))
    if pegs and refine:
        arm = given.get("arm")
        pieces = cuts(rope, pegs, arm=arm)
        rope = refine_rope(rope, pegs, arm=arm)
        starts = {name: checks.array(name, given[name], None) for name in ("q0", "qd0") if name in given}
        given |= {name: per_piece(values, pieces) for name, values in starts.items()}
    return build(rope, given), pieces


def build(rope: Rope, given: Mapping[str, Any]) -> Setup:
    """Return a set-up of a rope; a name that is no field of a set-up is refused."""
    if not given.keys() <= Setup.__dataclass_fields__.keys():
        checks.keys("a set-up", given, Setup.__dataclass_fields__)
    return Setup(rope, **given)


def per_piece(values: Any, pieces: Pieces) -> Any:
    """Return values (n,) of links as values of the pieces that each link was cut into; others as they are."""
    return np.repeat(values, pieces) if np.shape(values) == pieces.shape else values


def check_memory(setup: Setup, samples: int) -> None:
    """Refuse a run whose result of so many samples would not fit into the memory."""
    links = setup.rope.n_links
    memory.check(
        8.0 * IN_MEMORY[setup.touches] * (links + 2) * samples,
        f"a run of {links} links with {samples} outputs",
        "Ask for fewer outputs (t_eval=[...]), a shorter duration or fewer links",
    )


def file_size(setup: Setup, duration: float) -> float:
    """Return about how large the file of a run is, bytes, that lasts `duration`, s, with the usual outputs."""
    return 8.0 * IN_FILE[setup.touches] * setup.rope.n_links * duration / SAMPLE_TIME


def output_times(t_eval: npt.ArrayLike | None, begin: float, end: float) -> Array:
    """Check the output times (T,) of a run from `begin` to `end`, s; by default every SAMPLE_TIME and the end."""
    if t_eval is None:
        count = (end - begin) / SAMPLE_TIME
        if count > MOST_OUTPUTS:
            raise InvalidInput(
                f"the run is so long that an output every {SAMPLE_TIME:g} s would make {count:.3g} of them",
                got=f"{end - begin:g} s",
                allowed=f"up to {MOST_OUTPUTS * SAMPLE_TIME:g} s without t_eval",
                fix="Say when you want to see it: t_eval=[...]",
            )
        return np.append(begin + SAMPLE_TIME * np.arange(math.ceil((end - begin) / SAMPLE_TIME - 1e-9)), end)
    t = checks.times("t_eval", t_eval)
    if t[0] < begin or t[-1] > end:
        raise InvalidInput("t_eval leaves the run", got=[float(t[0]), float(t[-1])], allowed=f"{begin:g} to {end:g} s")
    return t


def resume(run: Rollout, state: State, setup: Setup) -> bool:
    """Let a run go on from a state: bit for bit if nothing but its end has changed.

    What was saved counts while the state is as it was saved; one that was changed by hand, or saved where the arm was
    driven in another way, counts by its own values alone. Returns whether what was saved counts.
    """
    n = run.chain.length.size
    own = 1 if setup.torque_driven else 0
    y, clock = run.progress.y, run.progress.clock
    if not isinstance(state, State):
        raise InvalidInput("state is not a State", got=state, allowed="what a run, start() or step() returned")
    saved = state.checkpoint
    run.progress.slip[:] = 1.0
    as_saved = all(np.size(saved.get(name, ())) == size for name, size in (("y", y.size), ("clock", MARK)))
    as_saved = as_saved and _matches(saved, state, own)
    if as_saved and "fingerprint" in saved and saved["fingerprint"] == fingerprint(run, setup):
        y[:], run.progress.slip[:] = saved["mark"], saved["mark_slip"]
        clock[:MARK] = saved["mark_clock"]
    elif as_saved:
        y[:] = saved["y"]
        clock[:MARK] = saved["clock"]
        restart(clock)
    else:  # a torque-driven arm starts where the state says, or else the set-up
        check_state(state, n - own)
        if own:
            y[0] = setup.arm_angle0 if state.arm_angle is None else state.arm_angle
            y[n] = setup.arm_rate0 if state.arm_rate is None else state.arm_rate
        y[own:n], y[n + own : 2 * n] = state.q, state.qd
        y[2 * n :] = state.work, state.dissipated
        clock[:MARK] = starting_clock(state.t)
        clock[STEP] = state.step or FIRST_STEP
    return as_saved


def check_state(state: object, n: int) -> State:
    """Return a state of a rope of n links, or refuse what is none, or holds what no run can begin with."""
    if not isinstance(state, State):
        raise InvalidInput("state is not a State", got=state, allowed="what a run, start() or step() returned")
    checks.array("state q", state.q, (n,), unit="rad")
    checks.array("state qd", state.qd, (n,), unit="rad/s")
    checks.number("state step", state.step, sign="nonnegative", unit="s")
    for name, unit in (("t", "s"), ("work", "J"), ("dissipated", "J"), ("arm_angle", "rad"), ("arm_rate", "rad/s")):
        if (value := getattr(state, name)) is not None:
            checks.number(f"state {name}", value, unit=unit)
    return state


def _matches(saved: dict[str, Any], state: State, own: int) -> bool:
    """Return whether a state's values are as saved; the chain has `own` links of the arm (0 or 1)."""
    y, n = saved["y"], saved["y"].size // 2 - 1
    if (saved["clock"][T], saved["clock"][STEP], *y[2 * n :]) != (state.t, state.step, state.work, state.dissipated):
        return False
    if own and state.arm_angle is not None and (y[0], y[n]) != (state.arm_angle, state.arm_rate):
        return False
    return np.array_equal(y[own:n], state.q) and np.array_equal(y[n + own : 2 * n], state.qd)


def final_state(run: Rollout, setup: Setup) -> State:
    """Return the state of a run at its end, with the mark from which it resumes bit for bit."""
    y, mark, slip, mark_slip, clock, _ = run.progress
    if clock[MARK] == -np.inf:  # no step was cut: the run stands where one ended
        mark, mark_slip, clock[MARK : 2 * MARK] = y, slip, clock[:MARK]
    marked: dict[str, Any] = {
        "mark": mark.copy(),
        "mark_slip": mark_slip.copy(),
        "mark_clock": clock[MARK : 2 * MARK].copy(),
    }
    return state_of(run, setup, y, clock[:MARK], run.spin, fingerprint=fingerprint(run, setup), **marked, **run.kept)


def state_of(
    run: Rollout,
    setup: Setup,
    y: Array,
    clock: Array,
    spin: Array | None,
    arm: tuple[float, float] | None = None,
    **kept: Any,
) -> State:
    """Return a State of a run from the chain's state y (2 n + 2,), the clock (MARK,) and the spin of obstacles there.

    `arm` has angle, rad, and rate, rad/s, of a prescribed arm, by default those of the set-up's motion; `kept` is what
    a run that goes on needs beside these.
    """
    n, t = run.chain.length.size, float(clock[T])
    own = 1 if setup.torque_driven else 0
    if own:
        arm = float(y[0]), float(y[n])
    elif arm is None:
        motion = np.empty(9)
        motion_at(run.drive, t, motion)
        arm = float(motion[4]), float(motion[3])
    q, qd = y[own:n].copy(), y[n + own : 2 * n].copy()
    q.setflags(write=False)
    qd.setflags(write=False)
    return State(
        t=t,
        q=q,
        qd=qd,
        step=float(clock[STEP]),
        work=float(y[2 * n]),
        dissipated=float(y[2 * n + 1]),
        checkpoint={"y": y.copy(), "clock": clock.copy(), **kept},
        arm_angle=arm[0],
        arm_rate=arm[1],
        **shown(setup, spin),
    )


def fingerprint(run: Rollout, setup: Setup) -> float:
    """Return a fingerprint of what is integrated and how; equal for runs that can be resumed from each other."""
    digest = hashlib.sha256()
    for part in (*run.chain, *run.drive, run.limits.tol, run.limits.fixed, setup.torque_driven):
        digest.update(np.ascontiguousarray(part).tobytes())
    return float(struct.unpack("<Q", digest.digest()[:8])[0] >> 11)  # 53 bits: exact as a float


AT_ONCE = 1_000_000  # numbers of states that are observed between two looks at Ctrl-C


def status_of(code: int) -> Status:
    """Return the status of a result for the status code of the kernels."""
    return Status.SUCCESS if code in (status.OK, status.REACHED, status.LEFT) else Status(status.NAMES[code])


def failure(code: int, run: Rollout, time: float | None = None) -> SimulationError:
    """Return the error of a status code: when and where, and what to try; of a sample at `time`, s, if given."""
    where, rates = "", np.abs(run.progress.y[run.chain.length.size : 2 * run.chain.length.size])
    if time is None and np.isfinite(rates).any():
        where = f"; fastest link: {int(np.nanargmax(rates))} at {np.nanmax(rates):.3g} rad/s"
    time, name = run.time if time is None else time, status_of(code)
    message = f"stopped at t = {time:.6g} s ({name}{where}): {status.ADVICE[code]}."
    return SimulationError(message, status=name, time=time)


def refuse_failure(code: int, run: Rollout) -> None:
    """Raise the error of a status code, unless the run has come to its end."""
    if code != status.OK:
        raise failure(code, run)


def conclude(
    run: Rollout,
    setup: Setup,
    code: int,
    early: Status,
    *,
    throw: bool,
    skip: int = 0,
    event: tuple[str, float] | None = None,
) -> Trajectory:
    """Compute everything that a trajectory shows, and check the energy balance from the start to the run's end.

    A run whose code is RUNNING was ended `early`. The trajectory omits the first `skip` rows of the output, which were
    not required. With `throw` a failure is raised; otherwise the part that is valid is returned.
    """
    seen = _observe(run)
    good, bad_time = _balanced_rows(run, setup, seen)
    stopped = code == status.RUNNING
    error = None if code in (status.OK, status.RUNNING) else failure(code, run)
    if bad_time is not None and (error is None or good > 0):
        error = failure(status.ENERGY, run, bad_time)
    if error is not None and throw:
        raise error
    state = final_state(run, setup) if error is None else _state_at(run, setup, good)
    name = early if stopped else Status.SUCCESS
    message = f"{early} at t = {run.time:.6g} s" if stopped else ""
    if error is not None:
        name, message = error.status, str(error)
    return _trajectory(run, setup, seen, slice(skip, good), state=state, status=name, message=message, event=event)


def refuse_unbalanced(run: Rollout, setup: Setup) -> None:
    """Raise if the energy balance of a finished run does not hold."""
    _, bad_time = _balanced_rows(run, setup, _observe(run))
    if bad_time is not None:
        raise failure(status.ENERGY, run, bad_time)


class _Seen(NamedTuple):
    """What a run looks like at its outputs and, in the last row, where it ended; see ``observation.observe``."""

    qdd: Array  # (T + 1, n)
    base: Array  # (T + 1, 9)
    scalars: Array  # (T + 1, 5)


def _balanced_rows(run: Rollout, setup: Setup, seen: _Seen) -> tuple[int, float | None]:
    """Number of leading output rows whose energy balance holds, and the time of the first state for which it fails."""
    n, y, end = run.chain.length.size, run.y[: run.done], run.progress.y[None]
    kinetic, potential, work, lost = *seen.scalars[:, :2].T, *np.concatenate([y[:, 2 * n :], end[:, 2 * n :]]).T
    if run.seen is not None and run.spin is not None:
        rates = np.concatenate([split_samples(run.seen[: run.done], n).spin, run.spin[None]])[:, 1]
        kinetic = kinetic + spin_energy(setup, rates)
    floor, energies = np.array([[least_scale(setup.rope)]]), np.stack([kinetic, potential, work, lost])[:, None]
    good = int(balanced(floor, energies, lambda _: stored(run.chain, np.concatenate([y, end])[:, :n]))[0])
    return min(good, run.done), None if good == kinetic.size else float(np.append(run.t[: run.done], run.time)[good])


def _observe(run: Rollout) -> _Seen:
    """Observe a run at its outputs and where it ended; Ctrl-C is looked at now and then."""
    n, done = run.chain.length.size, run.done
    seen = _Seen(np.empty((done + 1, n)), np.empty((done + 1, 9)), np.empty((done + 1, 5)))
    at_once = max(1, AT_ONCE // run.y.shape[1])
    for first in range(0, done, at_once):
        rows = slice(first, min(first + at_once, done))
        raise_if_cancelled()
        slip = output.senses(run.chain, run.drive, run.t[rows], run.y[rows])
        output.observe(run.chain, run.drive, run.t[rows], run.y[rows], slip, *(each[rows] for each in seen))
    end = run.chain, run.drive, np.array([run.time]), run.progress.y[None]
    output.observe(*end, output.senses(*end), *(each[done:] for each in seen))
    return seen


def _state_at(run: Rollout, setup: Setup, count: int) -> State:
    """State of the last output that holds; a run that goes on from it begins anew there."""
    row = max(count, 1) - 1
    spin = None if run.seen is None else split_samples(run.seen[row : row + 1], run.chain.length.size).spin[0]
    return state_of(run, setup, run.y[row], starting_clock(float(run.t[row])), spin)


def _trajectory(run: Rollout, setup: Setup, seen: _Seen, rows: slice, **facts: Any) -> Trajectory:
    """Return the trajectory of some output rows; `facts` are its state, status, message and event."""
    n = run.chain.length.size
    t, y = run.t[rows], run.y[rows]
    qdd, base, scalars = (each[:-1][rows] for each in seen)
    q, qd = y[:, :n], y[:, n : 2 * n]
    if run.seen is not None:
        contact = split_samples(run.seen[rows], n)
        touched = ~contact.free  # in free flight the accelerations follow from (1)
        qdd[touched], scalars[touched, 2:] = contact.qdd[touched], contact.load[touched]
        scalars[:, 0] += spin_energy(setup, contact.spin[:, 1])
        facts |= {"contact_force": contact.force[:, n - setup.rope.n_links :], "contact_loss": contact.loss}
        facts |= shown(setup, contact.spin)
    if setup.torque is not None and setup.arm is not None:
        angle, rate, length = q[:, 0], qd[:, 0], setup.arm.length
        sin, cos = np.sin(angle), np.cos(angle)
        place = base[:, 7:9] + length * np.stack([sin, -cos], axis=1)
        velocity = base[:, 5:7] + (length * rate)[:, None] * np.stack([cos, sin], axis=1)
        q, qd, qdd = q[:, 1:], qd[:, 1:], qdd[:, 1:]
        torque = np.clip(setup.torque.torque(t), -setup.arm.torque_limit, setup.arm.torque_limit)
    else:
        angle, rate, place, velocity = base[:, 4], base[:, 3], base[:, 7:9], base[:, 5:7]
        torque = _motor_torque(setup, angle, rate, base[:, 2], scalars)
    return Trajectory(
        t=t,
        q=q,
        qd=qd,
        qdd=qdd,
        base=place,
        base_velocity=velocity,
        arm_angle=angle,
        arm_rate=rate,
        kinetic_energy=scalars[:, 0],
        potential_energy=scalars[:, 1],
        dissipated_energy=y[:, 2 * n + 1],
        motor_work=y[:, 2 * n],
        motor_torque=torque,
        setup=setup,
        attrs={"method": setup.method, "tol": setup.tol, **run.facts},
        **facts,
    )


def _motor_torque(setup: Setup, angle: Array, rate: Array, acceleration: Array, scalars: Array) -> Array:
    """Torque (T,) that turns a prescribed arm: for the rope, and for the arm's own inertia, weight and friction."""
    arm = setup.arm
    if arm is None:
        return np.zeros(angle.size)
    pull = arm.length * (np.cos(angle) * scalars[:, 2] + np.sin(angle) * scalars[:, 3])
    return scalars[:, 4] + pull + arm.shaft_torque(setup.rope.gravity, angle, rate, acceleration)


STARTS = ("q0", "qd0", "arm_angle0", "arm_rate0")


@interruptible(Trajectory)
def simulate(
    rope: Rope | Setup,
    motion: Motion | None = None,
    *,
    t_eval: ArrayLike | None = None,
    state: State | None = None,
    until: Event | None = None,
    refine: bool = True,
    throw: bool = True,
    time_budget: float | Budget | None = None,
    progress: bool = False,
    **setup: Unpack[SetupFields],
) -> Trajectory:
    """Simulate a rope on a moving arm, on a torque-driven arm, or hanging from a point.

    Parameters
    ----------
    rope : Rope or Setup
        The rope; or a whole set-up.
    motion : Motion, optional
        Prescribed motion of the arm, or of the point that the rope hangs from (``moving_pivot``).
    t_eval : (T,) array_like, optional
        Increasing times of the output, s, within the run; by default every 10 ms and the end.
    state : State, optional
        Start of the run: where another run ended (``trajectory.state``), or any other :class:`State`, also with rates
        of pegs that turn. With everything else equal, the continued run equals an uninterrupted one bit for bit; in
        contact, within the accuracy of the steps. The run begins at the state's time.
    until : Event, optional
        Ends the run where it happens (``tip_crosses``, ``tip_speed_peak``, ``phase_reached``, ``angle_reached``), or
        after the duration if it does not; ``trajectory.event`` names it. The last sample is the event then, located to
        some 1e-12 s within the run's own accuracy. Steps are 10 ms at most while an event is awaited; one that begins
        and ends within such a step can be missed. Not with pegs, nor where a joint is at its limit.
    refine : bool
        Cut links that may touch a peg to what a wound rope needs (:func:`hyperflex.refine_rope`; ``q0``, ``qd0`` and
        `state` may then be those of either rope). The trajectory's rope is the finer one. A whole set-up is not cut.
    throw : bool
        Raise an error if the run fails; False returns the part of the run that is valid, with its ``status`` and
        ``message``, also after Ctrl-C.
    time_budget : float or Budget, optional
        Time by the clock, s, after which the run ends as a failure ("out of time"). It is checked every few hundred
        steps; compiling does not count. By default the run ends as soon as its progress predicts more than half an hour
        of processor time in all; inf sets no limit.
    progress : bool
        Show a progress bar on standard error.
    **setup
        Fields of :class:`hyperflex.Setup`: ``duration``, ``arm``, ``q0``, ``qd0``, ``torque``, ``pegs``, ``tol`` and
        others. Of a whole set-up, they replace its own. With a rope, ``duration`` is required.

    Returns
    -------
    Trajectory
        Its ``qdd`` follows from (1) at each state. In a fine rope friction turns an error of the rates into one of the
        accelerations 4 eta / J times as large: for n of some hundreds ask for a tight `tol` if you need them.

    Raises
    ------
    InvalidInput
        If an argument cannot be used, or the result would not fit into the memory.
    SimulationError
        If the run diverges, cannot meet `tol`, or does not keep its energy balance; says when and what to try.
    Interrupted
        By Ctrl-C. Its ``partial`` is the trajectory until then, to go on from.

    Notes
    -----
    Model: paper section II; method: docs/models.md. Cost about 0.4 ms per simulated second for the paper's 50-link
    cable on one core of a current machine; it grows with n, and the step does not shrink with n.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> cast = hf.simulate(cable, hf.arm_swings(t_move=0.73, t_rest=0.53), arm=hf.Arm(length=0.105), duration=10.0)
    >>> bool(abs(cast.tip[:, 0]).max() > 1.5)
    True
    """
    given = {**setup, "motion": motion}
    if state is not None and (names := [name for name in STARTS if setup.get(name) is not None]):
        fix = "dataclasses.replace(state, q=...) changes a state"
        raise InvalidInput("the start is given twice, by arguments and by a state", got=names, fix=fix)
    full, pieces = setup_of(rope, given, refine=checks.flag("refine", refine))
    if isinstance(state, State) and pieces is not None and np.shape(state.q) == pieces.shape and (pieces > 1).any():
        state = replace(state, q=per_piece(state.q, pieces), qd=per_piece(state.qd, pieces), checkpoint={})
    begin = 0.0 if state is None else checks.number("state t", checks.instance("state", state, State).t, unit="s")
    end = begin + full.duration
    t = output_times(t_eval, begin, end)
    check_memory(full, t.size)
    skip = int(t[0] > begin)  # the energy account starts with the run, even if that sample is not required
    chain = full.chain()
    bounds = rollout_limits(full, chain, end, until=NEVER if until is None else _checked(until, full).packed(full))
    run = prepare_rollout(chain, full.drive(), full.start(), np.append(begin, t) if skip else t, bounds)
    if state is not None:
        resume(run, state, full)
    code, applied = status.RUNNING, list[tuple[float, float]]()
    with stoppable() as stop, progress_bar(begin, end, checks.flag("progress", progress)) as bar:
        watch = Watch(time_budget, (begin, end), bar)
        watch.budget.check()
        code = _finished(run, full, state, watch, applied)
        watch.report(run.time)
    if applied:  # for a replay
        full = replace(full, torque=_held(applied, end), control=None, control_rate=None)
        run.drive = full.drive()
    if code == status.RUNNING and throw:
        if stop.status is Status.OUT_OF_TIME:
            raise out_of_time(run.time, stop.error, "; or allow its time: time_budget=inf")
        raise Interrupted(partial(conclude, run, full, code, Status.INTERRUPTED, throw=False, skip=skip))
    event = None
    if code == status.REACHED and until is not None:
        code, event = status.OK, (until.name, run.time)
        end_at_event(run)
    early = stop.status or Status.INTERRUPTED
    return conclude(run, full, code, early, throw=throw, skip=skip, event=event)


def _finished(run: Rollout, setup: Setup, state: State | None, watch: Watch, applied: list[tuple[float, float]]) -> int:
    """Run to the end and return the status code; `applied` gets times, s, and torques, N m, of the set-up's control.

    They are complete also if an exception ends the run.
    """
    free = not setup.touches or run.limits.until.kind != NEVER.kind
    go = partial(finish_rollout, run, watch) if free else partial(contact_run(run, setup, state).finish, watch)
    if setup.control is None or setup.control_rate is None:
        return go()
    interval = Interval(run.drive)
    run.drive = interval.drive
    n, limit, begin, stop, code = run.chain.length.size, run.drive.torque_limit, run.time, run.limits.stop, status.OK
    while run.time < stop and code == status.OK:
        y, now = run.progress.y, run.time
        answer = setup.control(now, float(y[0]), float(y[n]), y[1:n].copy(), y[n + 1 : 2 * n].copy())
        commanded = checks.number(f"torque callback at t = {now:g} s", answer, unit="N m")
        applied.append((now, float(np.clip(commanded, -limit, limit))))
        until = min(begin + len(applied) / setup.control_rate, stop)
        interval.set(now, until, TORQUE, [applied[-1][1], 0.0, 0.0, 0.0, 0.0, 0.0])
        run.limits = run.limits._replace(stop=until)
        code = go()
        restart(run.progress.clock)
        if run.time < stop:
            watch(run.time)
    return code


def _held(applied: list[tuple[float, float]], end: float) -> Motion:
    """Return the torque that keeps each of the applied values until the next one, and the last beyond `end`, s."""
    times, torques = zip(*applied, strict=True)
    coef = np.zeros((len(times), *hold_arm().coef.shape[1:]))
    coef[:, TORQUE, 0] = torques
    breaks = np.append(times, max(end, times[-1]) + 1.0)
    return Motion(breaks, coef, np.ones(breaks.size, dtype=np.bool_))


def _checked(until: Event, setup: Setup) -> Event:
    """Return the event that may end a run; refuse what is none, and events with pegs."""
    if not isinstance(until, Event):
        allowed = "tip_crosses, tip_speed_peak, phase_reached or angle_reached"
        raise InvalidInput("until is not an event", got=until, allowed=allowed)
    if setup.pegs:
        raise InvalidInput("events are not available with pegs", fix="Omit until or pegs")
    return until


def angles(
    rope: Rope,
    t: Array,
    q0: Array,
    qd0: Array,
    *,
    motion: Motion | None = None,
    arm: Arm | None = None,
    tol: float = DEFAULT_TOL,
) -> tuple[Array, Array]:
    """Simulate and return only angles and rates (T, n); for callers that run thousands of short rollouts.

    The run starts at t[0] of increasing times t (T,), s, with q0 (n,), rad, and qd0 (n,), rad/s; the rest is as in
    :func:`simulate`. SimulationError if it cannot be finished within `tol`.
    """
    setup = Setup(rope, motion, arm, tol=tol)
    chain = rope.chain()
    run = prepare_rollout(chain, setup.drive(), (q0, qd0), t, rollout_limits(setup, chain, float(t[-1])))
    refuse_failure(finish_rollout(run), run)
    n = chain.length.size
    return run.y[:, :n], run.y[:, n : 2 * n]
