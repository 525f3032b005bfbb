"""Checkpoints: save the state of a run and resume from it."""

import hashlib
import struct
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.drive import motion_at
from hyperflex.core.integrate.rollout import MARK, STEP, T, restart
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.errors import InvalidInput
from hyperflex.model import Setup
from hyperflex.simulation.contact.turning_pegs import shown
from hyperflex.simulation.rollouts import Rollout, starting_clock
from hyperflex.trajectory import State


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
    saved = state.checkpoint if np.size(state.checkpoint.get("y", ())) == 2 * n + 2 else {}
    if saved and np.size(saved.get("clock", ())) != MARK:
        raise InvalidInput(
            "state was saved by another version",
            got=np.size(saved.get("clock", ())),
            allowed=f"a clock of {MARK} numbers",
            fix="Give its q and qd: State(t=..., q=..., qd=...)",
        )
    run.progress.slip[:] = 1.0
    as_saved = bool(saved) and _matches(saved, state, own)
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
