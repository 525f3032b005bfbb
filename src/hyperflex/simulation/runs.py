"""Whole runs: from rope and motion to a Trajectory."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.chain.drive import TORQUE
from hyperflex.core.integrate.end_conditions import NEVER, Until
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import DEFAULT_TOL, Arm, Obstacle, Rope, Setup, checked_obstacles
from hyperflex.motion import Motion, hold_arm
from hyperflex.progress import progress_bar
from hyperflex.simulation.arguments import check_memory, chosen, needed, output_times, whole_setup
from hyperflex.simulation.contact.runs import contact_run, refine_arguments
from hyperflex.simulation.events import Event
from hyperflex.simulation.outcome import conclude, refuse_failure
from hyperflex.simulation.restart import resume
from hyperflex.simulation.rollouts import (
    Control,
    Interval,
    Rollout,
    controlled,
    end_at_event,
    finish_rollout,
    prepare_rollout,
    rollout_limits,
)
from hyperflex.simulation.time_budget import INTERRUPTED, OUT_OF_TIME, Deadline, Watch, out_of_time
from hyperflex.trajectory import State, Trajectory


@interruptible(Trajectory)
def simulate(
    rope: Rope | Setup,
    motion: Motion | None = None,
    *,
    arm: Arm | None = None,
    duration: float | None = None,
    q0: npt.ArrayLike | None = None,
    qd0: npt.ArrayLike | None = None,
    t_eval: npt.ArrayLike | None = None,
    tol: float | None = None,
    method: str | None = None,
    step: float | None = None,
    torque: Motion | float | Control | None = None,
    control_rate: float | None = None,
    arm_angle0: float | None = None,
    arm_rate0: float | None = None,
    state: State | None = None,
    until: Event | None = None,
    pegs: Sequence[Obstacle] = (),
    contact_step: float | None = None,
    tip_force: npt.ArrayLike | None = None,
    refine: bool = True,
    throw: bool = True,
    time_budget: float | Budget | Deadline | None = None,
    progress: bool = False,
) -> Trajectory:
    """Simulate a rope on a moving arm, on a torque-driven arm, or hanging from a point.

    Parameters
    ----------
    rope : Rope or Setup
        The rope; or a whole set-up, and then only `duration`, `t_eval`, `state`, `until`, `throw`, `time_budget` and
        `progress` may be given beside it.
    motion : Motion, optional
        Prescribed motion of the arm, or of the point that the rope hangs from (``moving_pivot``).
    arm : Arm, optional
        The arm; without one the rope hangs from the point itself.
    duration : float
        Simulated time, s, counted from the start (or from `state`).
    q0, qd0 : (n,) array_like, optional
        Absolute link angles, rad, and rates, rad/s, at the start. By default the rope hangs at rest.
    t_eval : (T,) array_like, optional
        Increasing times of the output, s, within the run; by default every 10 ms and the end.
    tol : float, optional
        Error that one step may make in the position of any joint, m; by default 1e-5. The error at the tip after some
        seconds of casting is of the order of ten times as much (docs/models.md). Beside pegs it also bounds the energy
        that may come from nowhere, in proportion: by default a millionth of what is at stake in a second; 1e-3 is for
        a search.
    method : {"extrapolation", "rk4"}, optional
        The linearly implicit extrapolation with error control (by default), or classical Runge-Kutta with a fixed
        `step`, s, as a check; a step beyond its stability limit is refused. The limit holds for a rope that hangs: one
        that whips about with little friction may need less.
    step : float, optional
        Of ``"rk4"``, s.
    torque : Motion, float or callable, optional
        Drives the arm by a torque, N m: a ``torque_profile``, a constant, or ``torque(t, arm_angle, arm_rate, q, qd)``
        called at the control rate and held in between.
    control_rate : float, optional
        How often a torque callback is called, Hz.
    arm_angle0, arm_rate0 : float, optional
        Start of a torque-driven arm, rad and rad/s; by default 0.
    state : State, optional
        Go on from where another run ended (``trajectory.state``), or begin with what a :class:`State` says, the rates
        of pegs that turn included. With everything else equal, a run that goes on is bit for bit one that was not
        stopped. (A torque callback's instants count from where the run goes on.)
    until : Event, optional
        Ends the run where it happens (``tip_crosses``, ``tip_speed_peak``, ``phase_reached``, ``angle_reached``), or
        after `duration` if it does not; ``trajectory.event`` tells. The last sample is the event then, located to some
        1e-12 s within the run's own accuracy. Steps are 10 ms at most while an event is awaited; one that comes and
        goes within such a step can be missed.
    pegs : sequence of Peg, Wall or Ground, optional
        What the rope may touch and wind round. Events are not there yet with pegs, nor where a joint is at its limit.
    contact_step : float, optional
        Longest step with a peg or with a joint at its limit, s; by default 2e-4. A run that goes on from a `state`
        takes its steps elsewhere than one that was not stopped, so the two agree within the accuracy of these steps
        only.
    tip_force : (2,) array_like, optional
        Constant force on the tip beside gravity, N; only with pegs.
    refine : bool
        Cut links that may touch a peg to what a wound rope needs (:func:`hyperflex.refine_rope`; `q0`, `qd0` and
        `state` may then be those of either rope). The trajectory's rope is the finer one. A whole set-up is taken as it
        is.
    throw : bool
        False returns the part that holds, with its ``status`` and ``message``, where True raises; also after Ctrl-C,
        with the status "interrupted".
    time_budget : float or Budget, optional
        Time by the clock, s, after which the run ends as a failure ("out of time"). It is checked every few hundred
        steps; compiling does not count. By default the run ends as soon as its progress predicts more than half an hour
        of processor time in all; inf lets it take as long as it needs.
    progress : bool
        Show a progress bar on standard error.

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
    control = torque if callable(torque) else None
    start: dict[str, Any] = {"q0": q0, "qd0": qd0, "arm_angle0": arm_angle0, "arm_rate0": arm_rate0}
    given: dict[str, Any] = {"tol": tol, "method": method, "step": step, "contact_step": contact_step}
    given["tip_force"] = tip_force
    if isinstance(rope, Rope):
        _refuse_two_starts(start, state, torque)
        pegs = checked_obstacles(pegs)
        if pegs and checks.flag("refine", refine):
            rope, start["q0"], start["qd0"], state = refine_arguments(rope, pegs, arm, q0, qd0, state)
        drive = _torque_motion(torque, control, control_rate)
        setup = Setup(
            rope, motion, arm, torque=drive, duration=needed(duration), pegs=pegs, **chosen({**start, **given})
        )
    else:
        given |= {"motion": motion, "arm": arm, "torque": torque, "control_rate": control_rate}
        given["pegs"] = pegs or None
        setup = whole_setup(rope, {**start, **given}, "duration, t_eval, state, until, throw, time_budget, progress")
    length = setup.duration if duration is None else checks.number("duration", duration, sign="positive", unit="s")
    begin = _begin(state)
    t = output_times(t_eval, begin, begin + length)
    check_memory(setup, t.size)
    skip = int(t[0] > begin)  # the energy account starts where the run does, whether or not that is asked for
    chain = setup.chain()
    bounds = rollout_limits(setup, chain, begin + length, until=_ending(until, setup))
    run = prepare_rollout(chain, setup.drive(), setup.start(), np.append(begin, t) if skip else t, bounds)
    if state is not None:
        resume(run, state, setup)
    code, applied = status.RUNNING, list[tuple[float, float]]()
    with stoppable() as stop, progress_bar(begin, begin + length, progress) as bar:
        watch = Watch(time_budget, (begin, begin + length), bar)
        watch.budget.check()
        code = _finished(run, setup, state, watch, control, control_rate, applied)
        watch.report(run.time)
    if applied and control_rate is not None:  # for a replay
        times, torques = np.transpose(applied)
        setup = replace(setup, torque=_constant_torques(times, torques, begin + length + 1.0 / control_rate))
        run.drive = setup.drive()
    if code == status.RUNNING and throw:
        if stop.status is OUT_OF_TIME:
            raise out_of_time(run.time, stop.error, "; or allow its time: time_budget=inf")
        raise Interrupted(partial(conclude, run, setup, code, INTERRUPTED, throw=False, skip=skip))
    event = None
    if code == status.REACHED and until is not None:
        code, event = status.OK, (until.name, run.time)
        end_at_event(run)
    name = stop.status or INTERRUPTED if code == status.RUNNING else status.NAMES[code]
    trajectory = conclude(run, setup, code, name, throw=throw, skip=skip)
    return trajectory if event is None else replace(trajectory, event=event)


def _refuse_two_starts(start: dict[str, Any], state: State | None, torque: object) -> None:
    """Refuse what a `state` or a prescribed arm says already."""
    names = list(chosen(start))
    if state is not None and names:
        fix = "dataclasses.replace(state, q=...) changes a state"
        raise InvalidInput("the start is given twice, by arguments and by a state", got=names, fix=fix)
    if torque is None and (names := [name for name in names if name.startswith("arm_")]):
        fix = "A motion says itself where the arm begins; arms rest at 0 without one"
        raise InvalidInput("no torque drives the arm that these begin", got=names, allowed="with torque=...", fix=fix)


def _begin(state: State | None) -> float:
    """Return when a run begins, s: where the one before it ended, if there was one."""
    if state is None:
        return 0.0
    if not isinstance(state, State):
        raise InvalidInput("state is not a State", got=state, allowed="trajectory.state of an earlier run, or None")
    return checks.number("state t", state.t, unit="s")


def _finished(
    run: Rollout,
    setup: Setup,
    state: State | None,
    watch: Watch,
    control: Control | None,
    control_rate: float | None,
    applied: list[tuple[float, float]],
) -> int:
    """Run to the end and return the status code; the torques that `control` sets join `applied`."""
    if control is None or control_rate is None:
        return runner(run, setup, state)(watch)
    interval = Interval(run.drive)
    run.drive = interval.drive
    go = partial(runner(run, setup, state), watch)
    return controlled(run, interval, control, 1.0 / control_rate, go, watch, applied)


def runner(run: Rollout, setup: Setup, state: State | None) -> Callable[..., int]:
    """Return the function that finishes a run, with contact or without: from a progress callable to the code."""
    free = not setup.touches or run.limits.until.kind != NEVER.kind
    return partial(finish_rollout, run) if free else contact_run(run, setup, state).finish


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


def _ending(until: Event | None, setup: Setup) -> Until:
    """Return the event that may end the run, as kernels take it."""
    if until is not None and not isinstance(until, Event):
        allowed = "tip_crosses, tip_speed_peak, phase_reached or angle_reached"
        raise InvalidInput("until is not an event", got=until, allowed=allowed)
    if setup.pegs and until is not None:
        raise InvalidInput("events are not there yet with pegs", fix="Leave out until or pegs")
    return NEVER if until is None else until.packed(setup)


def _torque_motion(torque: Any, control: Control | None, control_rate: float | None) -> Motion | None:
    if (control is None) != (control_rate is None):
        raise InvalidInput("control_rate belongs to a torque callback", got=control_rate, allowed="both, or neither")
    if control_rate is not None:
        checks.number("control_rate", control_rate, sign="positive", unit="Hz")
    if torque is None or isinstance(torque, Motion):
        return torque
    return _constant_torques(np.array([0.0]), np.array([0.0 if control else checks.number("torque", torque)]), math.inf)


def _constant_torques(times: Array, torques: Array, end: float) -> Motion:
    """A torque that keeps each value (m,) from its time (m,) to the next one; the last one until `end`."""
    breaks = np.append(times, end if math.isfinite(end) else 1e6)
    coef = np.zeros((times.size, *hold_arm().coef.shape[1:]))
    coef[:, TORQUE, 0] = torques
    return Motion(breaks, coef, np.ones(breaks.size, dtype=np.bool_))
