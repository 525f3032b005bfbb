"""Run loop with contact: steps that end at touchdown, impacts, and an energy check."""

import math

import numpy as np

from hyperflex.core import status
from hyperflex.core.assign import assign
from hyperflex.core.chain.articulated_body import sines
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.core.contact.account import CONTACT, FRICTION, WORK, energy
from hyperflex.core.contact.arrays import OPEN
from hyperflex.core.contact.bounds import (
    BEND,
    DEEPEST,
    ENERGY_GAIN,
    FORCED,
    GIVEN,
    IMPACT_DUE,
    IMPACTS,
    INDEX,
    LOST,
    MOMENT,
    REJECTED,
    SPENT,
    STEP,
    TAKEN,
    UNSOLVED,
    T,
    energy_allowance,
    energy_balanced,
)
from hyperflex.core.contact.gaps import find, joint_positions, new_contacts, speeds
from hyperflex.core.contact.joints import BEYOND, bend_clearance
from hyperflex.core.contact.modes import USUAL_TOL
from hyperflex.core.contact.output import write
from hyperflex.core.contact.step import (
    begin_step,
    finish_step,
    new_contact_memory,
    new_contact_workspace,
    save_memory,
    try_step,
)
from hyperflex.core.contact.torque_peaks import watch_torque
from hyperflex.core.contact.trend import growth, relative_error, save_trend
from hyperflex.core.contact.turning_pegs import turning_energy
from hyperflex.core.integrate.step_size import fitted
from hyperflex.core.jit import absorbed, kernel, non_allocating

SHORTEST = 2.0**-10  # of the step, the shortest that is tried
COARSEST = 2.0**5  # times as long it is at most, in proportion to a tolerance above the usual one, where that is safe
BRIEF = 1e-9  # s, the shortest step to an impact
RESOLVED = 0.12  # of the longest step: errors of positions shorten none that is shorter
REJECTED_ERROR = 4.0  # relative error of a step that is tried again at half its length
SAFE = 0.5  # of the smallest reach of a peg that links near one may move in a step
GENEROUS = 100.0  # how many times more energy than may appear contacts may give a rope that they push out
DEEPER = 5e-5  # m, penetration at which a step is tried again at half its length
SINKING = 1.02  # times the greatest depth until then, which a step may have: what sinks slowly sinks at any step


@absorbed
def accept_step(drive, state, workspace, h, rounds, least):  # type: ignore[no-untyped-def]
    """Accept the step to ``workspace.out``."""
    watch_torque(state.torque, drive.arm_length, workspace, state.clock[T], h)
    y, clock, account = state.y, state.clock, workspace.account
    n = workspace.motion.w.size
    for i in range(2 * n):
        y[i] = workspace.out[i]
    y[2 * n] += account[WORK]
    y[2 * n + 1] += account[FRICTION] + account[CONTACT]
    clock[LOST] += account[CONTACT]
    clock[GIVEN] = max(0.0, clock[GIVEN] - account[CONTACT])
    clock[SPENT] += h
    clock[DEEPEST] = max(clock[DEEPEST], -least)
    clock[BEND] = max(clock[BEND], -workspace.bend[0])
    clock[TAKEN] += 1.0
    if rounds < 0:
        clock[UNSOLVED] += 1.0
    for p in workspace.spin.which:
        state.spin[0, p] += 0.5 * h * (workspace.spin.before[p] + workspace.spin.after[p])
        state.spin[1, p] = workspace.spin.before[p] = workspace.spin.after[p]
    long = h > MOMENT
    save_trend(state.memory, workspace, h if long else 0.0)
    if long:
        save_memory(state.memory, workspace.contacts, workspace.impulses, workspace.joints, h)


@non_allocating
def clear_memory(memory):  # type: ignore[no-untyped-def]
    """Clear the modes and forces of the last step."""
    memory.penalty[0] = 0.0
    for i in range(memory.mode.shape[0]):
        for p in range(memory.mode.shape[1]):
            memory.normal[i, p] = memory.tangent[i, p] = 0.0
            memory.mode[i, p] = OPEN
        memory.torque[i], memory.bent[i] = 0.0, OPEN


@non_allocating
def impact(chain, drive, part, pegs, pull, state, workspace):  # type: ignore[no-untyped-def]
    """Let the links that touch a peg come to rest on it, or bounce, in no time, in the last step's modes if they do.

    Newton's restitution with friction may give energy; where it does, nothing bounces.
    """
    t, y, memory = state.clock[T], state.y, state.memory
    least, rounds = try_step(chain, drive, part, pegs, pull, t, 0.0, y, memory, workspace, True, 1.0, True)
    if pegs.bounce.any() and workspace.account[CONTACT] < 0.0:
        least, rounds = try_step(chain, drive, part, pegs, pull, t, 0.0, y, memory, workspace, True, 0.0, True)
    accept_step(drive, state, workspace, 0.0, rounds, least)
    state.clock[IMPACTS] += 1.0
    state.clock[IMPACT_DUE] = 0.0


@non_allocating
def gives_little(bounds, clock, workspace, h):  # type: ignore[no-untyped-def]
    """Whether contacts give back no more of what they took than may come from nowhere in all the time."""
    given = clock[GIVEN] - workspace.account[CONTACT]
    return given <= bounds.rate * (clock[SPENT] + h) or workspace.account[CONTACT] >= -energy_allowance(bounds, h)


@non_allocating
def longest_safe_step(chain, pegs, workspace):  # type: ignore[no-untyped-def]
    """Longest step, s, in which no link near a peg moves by more than SAFE of the smallest reach."""
    speed = workspace.motion.speed
    fastest = 0.0
    for c in range(workspace.contacts.total[0]):
        i = workspace.contacts.link[c]
        for j in range(i, i + 2):
            fastest = max(fastest, abs(speed[0, j]), abs(speed[1, j]))
    smallest = np.inf
    for p in range(pegs.reach.size):
        smallest = min(smallest, pegs.reach[p])
    return SAFE * smallest / fastest if fastest > 0.0 else np.inf


@absorbed
def choose_step(chain, drive, part, pegs, pull, bounds, state, workspace, nothing, h, wanted, struck, had):  # type: ignore[no-untyped-def]
    """Try a step, and shorter ones, until one will do; it is left in `workspace`.

    Parameters
    ----------
    chain, drive, part, pegs, pull, bounds, state, workspace : as for :func:`run` and :func:`try_step`
    nothing : ContactMemory, empty
    h, wanted : s, first step to try, and the one that the run would take next
    struck : bool, an impact was made already at this instant
    had : J, energy before the step, NaN if it is not known

    Returns
    -------
    h, wanted : s
    least : m, smallest gap
    touch : s, until a link touches
    rounds : int, of the search; negative if it failed
    surplus, has : J, energy from nowhere, and energy after the step
    good : bool, False where the shortest step had to be taken as it was
    """
    y, clock, t, trig = state.y, state.clock, state.clock[T], workspace.ahead_trig
    coarse = max(1.0, min(bounds.tol / USUAL_TOL, COARSEST))
    finest, shortest = SHORTEST * bounds.step, min(coarse * SHORTEST * bounds.step, h)
    push, anew, back, stale = True, False, False, np.inf
    while True:
        begin = nothing if anew else state.memory
        least, torque = begin_step(chain, drive, part, pegs, pull, t, h, y, begin, workspace, push, 0.0, struck)
        touch = workspace.touch[0]
        if touch == 0.0:
            impact(chain, drive, part, pegs, pull, state, workspace)
            struck, had = True, math.nan
            continue
        if touch < 0.999 * h:
            h = max(touch, BRIEF)
            shortest = min(shortest, h)
            continue
        rounds = finish_step(chain, workspace, torque, h)
        given = energy_allowance(bounds, h)
        if push and workspace.account[CONTACT] < -GENEROUS * given:
            push = False
            continue
        longest = longest_safe_step(chain, pegs, workspace)
        if h > longest:  # a peg may be passed: no tolerance allows that
            shortest = min(finest, shortest)
        error = relative_error(chain, bounds, state.memory, workspace, h)
        if math.isnan(had):
            had = energy(chain, y, workspace.base[0], trig) + turning_energy(workspace.spin, workspace.spin.before)
        has = energy(chain, workspace.out, workspace.base[2], trig)
        has += turning_energy(workspace.spin, workspace.spin.after)
        surplus = has - had + workspace.account[FRICTION] + workspace.account[CONTACT] - workspace.account[WORK]
        good = energy_balanced(surplus, given) and rounds > 0 and h <= longest
        good = good and (least > -DEEPER or -least <= SINKING * clock[DEEPEST])
        good = good and (error <= REJECTED_ERROR or h <= RESOLVED * bounds.step)
        little = gives_little(bounds, clock, workspace, h)
        if push and not little:  # a shorter step would be pushed out with as much power
            push = False
            continue
        good = good and little
        good = good and (workspace.bend[0] > -BEYOND or -workspace.bend[0] <= SINKING * clock[BEND])
        if good or back or (h <= shortest and (surplus <= stale if anew else rounds > 0)):
            return h, wanted, least, touch, rounds, surplus, has, good, error
        if h <= shortest:  # the last resort: a search from nothing, unless that gives more energy
            anew, back, stale = not anew, anew, surplus
            continue
        h = max(0.5 * h, shortest)
        wanted, push = h, True
        clock[REJECTED] += 1.0


@kernel
def run(chain, drive, pegs, pull, bounds, state, t_out, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Run until ``bounds.stop`` or until the budget is spent.

    Parameters
    ----------
    chain, drive, pegs, bounds, state : Chain, Drive, Pegs, Bounds, ContactState
    pull : (2,) force on the tip beside gravity, N
    t_out : (k,) increasing times, s; y_out : (k, 2 n + 2) out, as in ``rollout.run``
    seen_out : (k, 3 n + 4 + 2 m) out: ``see``, energy lost to contact, J, angles, rad, and rates, rad/s, of the m pegs

    Returns
    -------
    int : OK, RUNNING (call again), LEFT (no link is near a peg, no joint near its limit), or why it failed
    """
    clock, memory = state.clock, state.memory
    n, m = chain.length.size, pegs.x.size
    rate, longest = bounds.rate, bounds.step
    workspace = new_contact_workspace(chain, pegs, rate, longest, bounds.tol)
    aside = new_contact_workspace(chain, pegs, rate, longest, bounds.tol)
    assign(workspace.spin.before, state.spin[1])
    nothing, found = new_contact_memory(n, m), new_contact_memory(n, m)
    part = segment(drive, clock[T])
    had = math.nan  # energy before the step, where it is known
    for _ in range(bounds.budget):
        t = clock[T]
        if t >= bounds.stop:
            break
        if t >= part.end:
            part = segment(drive, t)
        struck = clock[IMPACT_DUE] == 1.0
        if struck:
            impact(chain, drive, part, pegs, pull, state, workspace)
            had = math.nan
        end = min(part.end, bounds.stop)
        wanted = min(clock[STEP], bounds.step)
        h = fitted(wanted, end - t)
        h, wanted, least, touch, rounds, surplus, has, good, error = choose_step(
            chain, drive, part, pegs, pull, bounds, state, workspace, nothing, h, wanted, struck, had
        )
        if not (abs(surplus) < np.inf):
            if memory.mode.any() or memory.bent.any():  # begin anew, from nothing
                clear_memory(memory)
                continue
            return status.NOT_FINITE
        if not good:
            clock[FORCED] += 1.0
        clock[ENERGY_GAIN] += surplus
        if clock[INDEX] < t_out.size:
            account = workspace.account
            had = has - surplus + account[FRICTION] + account[CONTACT] - account[WORK]
            rest = aside, h, had, t_out, y_out, seen_out
            write(chain, drive, part, pegs, pull, bounds, state, workspace, found, *rest)
        had = has
        accept_step(drive, state, workspace, h, rounds, least)
        clock[IMPACT_DUE] = 1.0 if touch <= 1.001 * h else 0.0
        clock[T] = end if h >= end - t else t + h
        clock[STEP] = max(wanted * growth(error), min(wanted, RESOLVED * bounds.step))
        if least > bounds.clear and workspace.bend[1] > bounds.slack and clock[T] < bounds.stop:
            return status.LEFT
    return status.RUNNING if clock[T] < bounds.stop else status.OK


@kernel
def clearance(chain, drive, pegs, t, y, near):  # type: ignore[no-untyped-def]
    """What is left at time t until rope and pegs, or joints and their limits, meet; y as in ``ContactState``.

    Gaps above `near`, m, may be told too small.

    Returns
    -------
    gap, speed : float, smallest gap between rope and pegs, m, and the greatest speed of a joint, m/s
    left : float, rad, as ``joints.bend_clearance`` gives it
    """
    n = chain.length.size
    base, trig = np.empty(9), np.empty(2 * n)
    base_state(drive, segment(drive, t), t, base)
    xy, speed, contacts = np.empty((2, n + 1)), np.empty((2, n + 1)), new_contacts(n * pegs.x.size)
    sines(y[:n], trig, 0)
    joint_positions(chain, trig, base[7], base[8], xy)
    speeds(chain, trig, y[n : 2 * n], base[5], base[6], speed)
    fastest = 0.0
    for i in range(n + 1):
        fastest = max(fastest, math.hypot(speed[0, i], speed[1, i]))
    _, left = bend_clearance(chain, y[:n], y[n : 2 * n], base[4], base[3])
    return find(chain, pegs, y[:n], trig, xy, np.full(n, near), contacts), fastest, left
