"""Whole runs: from rope and motion to a Trajectory."""

from dataclasses import replace
from functools import partial
from typing import Unpack

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.integrate.events import NEVER
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import DEFAULT_TOL, Arm, Rope, Setup, SetupFields
from hyperflex.motion import Motion
from hyperflex.progress import progress_bar
from hyperflex.simulation.arguments import check_memory, output_times, per_piece, setup_of
from hyperflex.simulation.contact.runs import contact_run
from hyperflex.simulation.events import Event
from hyperflex.simulation.outcome import conclude, refuse_failure
from hyperflex.simulation.restart import resume
from hyperflex.simulation.rollouts import (
    AppliedTorques,
    Interval,
    Rollout,
    controlled,
    end_at_event,
    finish_rollout,
    prepare_rollout,
    rollout_limits,
)
from hyperflex.simulation.time_budget import Watch, out_of_time
from hyperflex.status import Status
from hyperflex.trajectory import State, Trajectory

STARTS = ("q0", "qd0", "arm_angle0", "arm_rate0")


@interruptible(Trajectory)
def simulate(
    rope: Rope | Setup,
    motion: Motion | None = None,
    *,
    t_eval: npt.ArrayLike | None = None,
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
    code, applied = status.RUNNING, AppliedTorques()
    with stoppable() as stop, progress_bar(begin, end, progress) as bar:
        watch = Watch(time_budget, (begin, end), bar)
        watch.budget.check()
        code = _finished(run, full, state, watch, applied)
        watch.report(run.time)
    if applied.times:  # for a replay
        full = replace(full, torque=applied.motion(end), control=None, control_rate=None)
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


def _finished(run: Rollout, setup: Setup, state: State | None, watch: Watch, applied: AppliedTorques) -> int:
    """Run to the end and return the status code; the torques of the set-up's control are added to `applied`."""
    free = not setup.touches or run.limits.until.kind != NEVER.kind
    if setup.control is None or setup.control_rate is None:
        return finish_rollout(run, watch) if free else contact_run(run, setup, state).finish(watch)
    interval = Interval(run.drive)
    run.drive = interval.drive
    go = partial(finish_rollout, run, watch) if free else partial(contact_run(run, setup, state).finish, watch)
    return controlled(run, interval, setup.control, 1.0 / setup.control_rate, go, watch, applied)


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
