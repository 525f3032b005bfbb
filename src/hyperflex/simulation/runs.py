"""Whole runs: from rope and motion to a Trajectory."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, memory
from hyperflex.budget import Budget
from hyperflex.checks import Array, Integers
from hyperflex.core import status
from hyperflex.core.chain.drive import TORQUE
from hyperflex.core.integrate import observation as output
from hyperflex.core.integrate.events import NEVER
from hyperflex.core.integrate.rollout import restart
from hyperflex.errors import Interrupted, InvalidInput, SimulationError
from hyperflex.interruption import interruptible, raise_if_cancelled, stoppable
from hyperflex.model import (
    DEFAULT_TOL,
    Rope,
    Setup,
    SetupFields,
    checked_obstacles,
    cuts,
    divided,
    refine_rope,
    unit_along,
)
from hyperflex.motion import Motion, hold_arm
from hyperflex.progress import progress_bar
from hyperflex.simulation.contact import ContactRollout
from hyperflex.simulation.events import Event
from hyperflex.simulation.rollouts import Interval, Rollout, Watch, balanced, out_of_time, rollout_limits, stored
from hyperflex.status import Status
from hyperflex.trajectory import State, Trajectory

SAMPLE_TIME = 0.01  # s, between outputs if the user does not choose
# Numbers for each link and output, without contact and with it: in memory while a run is written, and in its file
IN_MEMORY, IN_FILE = (11, 15), (5.5, 7.5)
MOST_OUTPUTS = 1e7  # of a run whose user has not chosen; more of them would fill the memory first


def setup_of(
    rope: Rope | Setup, fields: Mapping[str, Any], *, refine: bool | None = False
) -> tuple[Setup, Integers | None]:
    """Return the set-up of a rope and of the fields that are not None; or a set-up with these fields replaced.

    Unless `refine` is False a rope is cut where its pegs need it; the second value is then the number of pieces of each
    link. A set-up is not cut; True is refused.
    """
    given = {name: value for name, value in fields.items() if value is not None}
    refine = None if refine is None else checks.flag("refine", refine)
    if isinstance(rope, Setup):
        if refine:
            fix = "Cut its rope before: refine_rope(setup.rope, setup.pegs, arm=setup.arm)"
            raise InvalidInput("a whole set-up is not cut", got="refine=True", fix=fix)
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
    if pegs and refine is not False:
        arm = given.get("arm")
        pieces = cuts(rope, pegs, arm=arm)
        rope = refine_rope(rope, pegs, arm=arm)
        starts = {name: checks.array(name, given[name], None) for name in ("q0", "qd0") if name in given}
        given |= {name: per_piece(values, pieces) for name, values in starts.items()}
    checks.keys("a set-up", given, Setup.__dataclass_fields__)
    return Setup(rope, **given), pieces


def per_piece(values: Any, pieces: Integers) -> Any:
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


def output_times(t_eval: ArrayLike | None, begin: float, end: float) -> Array:
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


AT_ONCE = 1_000_000  # numbers of states that are observed between two looks at Ctrl-C


def observed(run: Rollout) -> tuple[tuple[Array, Array, Array], int, SimulationError | None]:
    """Observe a run at its outputs and, in the last row, where it ended; Ctrl-C is looked at now and then.

    Returns
    -------
    seen : (T + 1, n), (T + 1, 9), (T + 1, 5) float64
        As ``observation.observe`` writes it.
    good : int
        Number of leading output rows whose energy balance holds.
    error : SimulationError or None
        Of the first state for which it fails.
    """
    chain, drive, n, done = run.chain, run.drive, run.chain.length.size, run.done
    seen = np.empty((done + 1, n)), np.empty((done + 1, 9)), np.empty((done + 1, 5))

    def see(t: Array, y: Array, rows: slice) -> None:
        output.observe(chain, drive, t, y, output.senses(chain, drive, t, y), *(each[rows] for each in seen))

    at_once, end = max(1, AT_ONCE // run.y.shape[1]), run.progress.y[None]
    for first in range(0, done, at_once):
        rows = slice(first, min(first + at_once, done))
        raise_if_cancelled()
        see(run.t[rows], run.y[rows], rows)
    see(np.array([run.time]), end, slice(done, None))
    if isinstance(run, ContactRollout):
        seen[2][:, 0] += run.spin_energy(np.append(run.spins[:done, 1], run.contact.spin[None, 1], axis=0))
    y = run.y[:done]
    energies = np.stack([*seen[2][:, :2].T, *np.concatenate([y[:, 2 * n :], end[:, 2 * n :]]).T])[:, None]
    good = int(balanced([run.setup], energies, lambda _: stored(chain, np.concatenate([y, end])[:, :n]))[0])
    if good > done:
        return seen, done, None
    return seen, good, run.failure(status.ENERGY, float(np.append(run.t[:done], run.time)[good]))


def _torque(setup: Setup, t: Array, base: Array, scalars: Array) -> Array:
    """Return the motor's torque (T,), N m, at times t, from what ``observation.observe`` writes."""
    if setup.arm is None:
        return np.zeros(t.size) if setup.torque is None else setup.torque.torque(t)
    if setup.torque is not None:
        return np.clip(setup.torque.torque(t), -setup.arm.torque_limit, setup.arm.torque_limit)
    angle, rate, acceleration = base[:, 4], base[:, 3], base[:, 2]  # of the arm, with inertia, weight and friction
    own = setup.arm.shaft_torque(setup.rope.gravity, angle, rate, acceleration)
    return setup.arm.rope_torque(angle, scalars[:, 2:]) + own


def motor_torque(setup: Setup, t: Array, y: Array) -> Array:
    """Return the motor's torque (T,), N m, in states y (T, 2 n + 2) at times t, s, without contact."""
    chain, drive, count = setup.chain(), setup.drive(), t.size
    seen = np.empty((count, chain.length.size)), np.empty((count, 9)), np.empty((count, 5))
    output.observe(chain, drive, t, y, output.senses(chain, drive, t, y), *seen)
    return _torque(setup, t, *seen[1:])


def conclude(
    run: Rollout, code: int, early: Status, *, throw: bool, skip: int = 0, event: tuple[str, float] | None = None
) -> Trajectory:
    """Compute everything that a trajectory shows, and check the energy balance from the start to the run's end.

    A run whose code is RUNNING was ended `early`. The trajectory omits the first `skip` rows of the output, which were
    not required. With `throw` a failure is raised; otherwise the part that is valid is returned.
    """
    setup, n = run.setup, run.chain.length.size
    seen, good, unbalanced = observed(run)
    stopped = code == status.RUNNING
    error = None if code in (status.OK, status.RUNNING) else run.failure(code)
    if unbalanced is not None and (error is None or good > 0):
        error = unbalanced
    if error is not None and throw:
        raise error
    state = run.state(end=True) if error is None else run.state(max(good, 1) - 1)
    name, message = Status.SUCCESS, ""
    if stopped:
        name, message = early, f"{early} at t = {run.time:.6g} s"
    if error is not None:
        name, message = error.status, str(error)
    rows = slice(skip, good)
    t, y, (qdd, base, scalars) = run.t[rows], run.y[rows], (each[rows] for each in seen)
    q, qd, attrs, contact = y[:, :n], y[:, n : 2 * n], {"tol": setup.tol}, dict[str, Any]()
    if isinstance(run, ContactRollout):
        attrs |= run.facts()
        contact = run.outputs(rows, qdd, scalars)
    if setup.torque is not None and setup.arm is not None:
        angle, rate = q[:, 0], qd[:, 0]
        place = base[:, 7:9] + setup.arm.length * unit_along(angle)
        velocity = base[:, 5:7] + setup.arm.tip_velocity(angle, rate)
        q, qd, qdd = q[:, 1:], qd[:, 1:], qdd[:, 1:]
    else:
        angle, rate, place, velocity = base[:, 4], base[:, 3], base[:, 7:9], base[:, 5:7]
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
        motor_torque=_torque(setup, t, base, scalars),
        setup=setup,
        state=state,
        start=run.state(0),
        status=name,
        message=message,
        attrs=attrs,
        event=event,
        **contact,
    )


STARTS = ("q0", "qd0", "arm_angle0", "arm_rate0")


class RunFields(SetupFields, total=False):
    """Fields of a set-up by name, and whether the limit of many links is wanted as well."""

    extrapolate: bool


@interruptible(Trajectory)
def simulate(
    rope: Rope | Setup,
    motion: Motion | None = None,
    *,
    t_eval: ArrayLike | None = None,
    state: State | None = None,
    until: Event | None = None,
    refine: bool | None = None,
    throw: bool = True,
    time_budget: float | Budget | None = None,
    progress: bool = False,
    **setup: Unpack[RunFields],
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
        Ends the run at an event (``tip_crosses``, ``tip_speed_peak``, ``phase_reached``, ``angle_reached``), or after
        the duration if there is none; ``trajectory.event`` names it. The last sample is then the event, located to
        about 1e-12 s within the run's own accuracy. Steps are at most 10 ms while an event is awaited; one that begins
        and ends within such a step can be missed. Not with pegs, nor if a joint reaches its limit.
    refine : bool, optional
        Divide links that may touch a peg as a wound rope requires (:func:`hyperflex.refine_rope`; ``q0``, ``qd0`` and
        `state` may then be those of either rope). The trajectory's rope is the finer one. By default a rope is divided;
        a whole set-up cannot be.
    throw : bool
        Raise an error if the run fails; False returns the part of the run that is valid, with its ``status`` and
        ``message``, also after Ctrl-C.
    time_budget : float or Budget, optional
        Wall-clock time, s, after which the run ends as a failure ("out of time"). It is checked every few hundred
        steps; compiling does not count. By default the run ends when its progress predicts a total of more than half an
        hour of processor time; inf sets no limit.
    progress : bool
        Show a progress bar on standard error.
    **setup
        Fields of :class:`hyperflex.Setup`: ``duration``, ``arm``, ``q0``, ``qd0``, ``torque``, ``pegs``, ``tol`` and
        others. They replace those of a whole set-up. With a rope, ``duration`` is required. ``extrapolate=True`` also
        simulates the rope with links of half and of a quarter of the length, from q0 and qd0 as samples of a smooth
        shape, and gives the trajectory its ``limit`` of ever shorter links with its ``limit_error``
        (docs/theory/continuum.md). Free flight only.

    Returns
    -------
    Trajectory
        ``print`` shows until when inputs and tolerance determine it (without friction not for long): see its
        ``predictable_until``. Its ``qdd`` follows from (1) at each state. In a fine rope friction amplifies an error of
        the rates to one of the accelerations 4 eta / J times as large: for n of some hundreds use a tight `tol` if you
        need them.

    Raises
    ------
    InvalidInput
        If an argument cannot be used, or the result would not fit into the memory.
    SimulationError
        If the run diverges, cannot meet `tol`, or violates its energy balance; the message states the time and what to
        try.
    Interrupted
        By Ctrl-C. Its ``partial`` is the trajectory until then, from which a run can continue.

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
    extrapolate = checks.flag("extrapolate", setup.pop("extrapolate", False))
    given = {**setup, "motion": motion}
    if state is not None and (names := [name for name in STARTS if setup.get(name) is not None]):
        fix = "dataclasses.replace(state, q=...) changes a state"
        raise InvalidInput("the start is given twice, by arguments and by a state", got=names, fix=fix)
    full, pieces = setup_of(rope, given, refine=refine)
    if isinstance(state, State) and pieces is not None and np.shape(state.q) == pieces.shape and (pieces > 1).any():
        state = replace(state, q=per_piece(state.q, pieces), qd=per_piece(state.qd, pieces), checkpoint={})
    begin = 0.0 if state is None else checks.number("state t", checks.instance("state", state, State).t, unit="s")
    end = begin + full.duration
    finer = _finer(full, state, until) if extrapolate else []
    t = output_times(t_eval, begin, end)
    check_memory(full, t.size)
    skip = int(t[0] > begin)  # the energy account starts with the run, even if that sample is not required
    times = np.append(begin, t) if skip else t
    event = NEVER if until is None else _checked(until, full).packed(full)
    kind = ContactRollout if full.touches and until is None else Rollout
    run = kind(full, times, limits=rollout_limits(full, full.chain(), end, event))
    goes_on = state is not None and run.resume(state) and run.fingerprint() in state.checkpoint.get("end", ())[:1]
    if isinstance(run, ContactRollout) and not goes_on:  # where a run has ended a rope may be deeper in a peg
        run.check_start()
    code, applied = status.RUNNING, list[tuple[float, float]]()
    with stoppable() as stop, progress_bar(begin, end, checks.flag("progress", progress)) as bar:
        watch = Watch(time_budget, (begin, end), bar)
        watch.budget.check()
        code = _finished(run, watch, applied)
        watch.report(run.time)
    if applied:  # for a replay
        run.setup = replace(full, torque=_held(applied, end), control=None, control_rate=None)
        run.drive = run.setup.drive()
    if code == status.RUNNING and throw:
        if stop.status is Status.OUT_OF_TIME:
            raise out_of_time(run.time, stop.error, "; or allow its time: time_budget=inf")
        raise Interrupted(partial(conclude, run, code, Status.INTERRUPTED, throw=False, skip=skip))
    reached = None
    if code == status.REACHED and until is not None:
        code, reached = status.OK, (until.name, run.time)
        run.end_at_event()
    found = conclude(run, code, stop.status or Status.INTERRUPTED, throw=throw, skip=skip, event=reached)
    if not finer or not found.success:
        return found
    return _limit(found, finer, {"t_eval": t, "time_budget": watch.budget, "progress": progress, "throw": throw})


def _limit(run: Trajectory, finer: list[Setup], how: dict[str, Any]) -> Trajectory:
    """Return a run with the limit of ever shorter links, from runs with links of half and of a quarter of the length.

    The limit supposes errors of second order. How wrong it may be is the last change, and how far the limit is that
    supposes errors of first order as well; no less than it was before, since errors may cancel for a while
    (docs/theory/continuum.md).
    """
    runs = [simulate(each, **how) for each in finer]
    failed = [each.message for each in runs if not each.success]
    if failed:
        return replace(run, message=f"no limit, since the run with shorter links failed: {failed[0]}")
    half, quarter = (each.joints[:, :: 2 ** (k + 1)] for k, each in enumerate(runs))
    first, last = half - run.joints, quarter - half
    error = sum(np.linalg.norm(each, axis=2).max(axis=1) for each in (last, (4.0 * last - first) / 3.0))
    return replace(run, limit=quarter + last / 3.0, limit_error=np.maximum.accumulate(error + run.setup.tol))


def _finer(setup: Setup, state: State | None, until: Event | None) -> list[Setup]:
    """Return set-ups whose ropes have links of half and of a quarter of the length, and starts as smooth as the old."""
    from scipy.interpolate import CubicSpline

    inner = setup.torque is not None and setup.torque.joints > 1
    if state is not None or until is not None or setup.control is not None or setup.touches or inner:
        fix = "Omit state, until, pegs, max_bend, a torque callback and torques of inner joints"
        raise InvalidInput("the limit of many links is that of a free run from its start", fix=fix)
    old, result = setup.rope.link_middles, []
    starts = {name: value for name in ("q0", "qd0") if (value := getattr(setup, name)) is not None}
    if (bend := float(np.abs(np.diff(starts.get("q0", np.zeros(1)))).max(initial=0.0))) > 1.0:
        allowed = "up to 1 rad from link to link"
        raise InvalidInput("q0 is no smooth shape, which shorter links need", got=bend, allowed=allowed)
    for pieces in (2, 4):
        rope = divided(setup.rope, pieces)
        smooth = {
            name: CubicSpline(old, values)(rope.link_middles) if old.size > 1 else np.full(pieces, values[0])
            for name, values in starts.items()
        }
        result.append(setup.replace(rope=rope, **smooth))
    return result


def _finished(run: Rollout, watch: Watch, applied: list[tuple[float, float]]) -> int:
    """Run to the end and return the status code; `applied` gets times, s, and torques, N m, of the set-up's control.

    They are complete also if an exception ends the run.
    """
    setup = run.setup
    if setup.control is None or setup.control_rate is None:
        return run.finish(watch)
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
        code = run.finish(watch)
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


def tighter_run(run: Trajectory) -> Trajectory:
    """Simulate a run again at a tenth of its tolerance, and half of its steps where a tolerance does not control them.

    Where that fails the samples end; KeyboardInterrupt after Ctrl-C.
    """
    setup, start = run.setup, run.start
    end = math.nextafter(max(float(run.t[-1]), start.t), math.inf)  # the sum of start and duration may be less
    step = None if setup.step is None else 0.5 * setup.step
    changes = {"tol": 0.1 * setup.tol, "contact_step": 0.5 * setup.contact_step, "step": step}
    found = simulate(setup.replace(duration=end - start.t, **changes), t_eval=run.t, state=start, throw=False)
    if found.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return found


def angles(rope: Rope, t: Array, q0: Array, qd0: Array, *, tol: float = DEFAULT_TOL) -> tuple[Array, Array]:
    """Simulate a rope that hangs from a point, and return only angles and rates (T, n): for thousands of short runs.

    The run starts at t[0] of increasing times t (T,), s, with q0 (n,), rad, and qd0 (n,), rad/s. SimulationError if it
    cannot be finished within `tol`, m.
    """
    run = Rollout(Setup(rope, tol=tol), t, (q0, qd0))
    run.complete()
    return run.y[:, run.links[0]], run.y[:, run.links[1]]
