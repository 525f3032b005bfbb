"""The outcome of a rollout: energy check, errors with advice, and the Trajectory."""

from typing import Any, NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.integrate import observation as output
from hyperflex.errors import SimulationError
from hyperflex.interruption import raise_if_cancelled
from hyperflex.model import Setup
from hyperflex.simulation.contact.runs import split_samples
from hyperflex.simulation.contact.turning_pegs import shown, spin_energy
from hyperflex.simulation.restart import final_state, state_of
from hyperflex.simulation.rollouts import Rollout, balanced, least_scale, starting_clock, stored
from hyperflex.status import Status
from hyperflex.trajectory import State, Trajectory

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
    floor, count = least_scale(setup.rope), kinetic.size
    good = int(balanced(floor, kinetic, potential, 0.0, work, lost))
    if good < count:  # what is held may explain it, see there
        held = np.concatenate([stored(run.chain, states[:, :n]) for states in (y, end)])
        good = int(balanced(floor, kinetic, potential, held, work, lost))
    return min(good, run.done), None if good == count else float(np.append(run.t[: run.done], run.time)[good])


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
    return np.asarray(scalars[:, 4] + pull + arm.shaft_torque(setup.rope.gravity, angle, rate, acceleration))
