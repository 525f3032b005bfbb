"""A rollout with contact: step-size control, impacts, outputs within steps, and where the rope leaves.

A step is tried, and shorter ones, until its energy, depth and error are accepted. A sample within a step is reached by
a shorter step, or by several.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from hyperflex.core import status
from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain.articulated_body import Array, sines
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.core.chain.torque_peaks import watch_torque
from hyperflex.core.contact.arrays import (
    OPEN,
    ContactMemory,
    clear_memory,
    copy_memory,
    is_empty,
    keeps_modes,
    new_contact_memory,
    save_memory,
    save_trend,
    trend_factor,
)
from hyperflex.core.contact.gaps import find, joint_positions, new_contacts, speeds
from hyperflex.core.contact.joints import JOINTS, bend_clearance
from hyperflex.core.contact.modes import USUAL_TOL
from hyperflex.core.contact.step import (
    CONTACT,
    FRICTION,
    WORK,
    begin_step,
    energy,
    finish_step,
    new_contact_workspace,
    try_step,
)
from hyperflex.core.contact.turning_pegs import turning_energy
from hyperflex.core.integrate.step_size import allowed, fitted, lasting
from hyperflex.core.jit import absorbed, kernel, non_allocating

MOMENT = 1e-8  # s; forces of shorter steps are not kept for the next: they would be mostly rounding
SLIGHT, ROUNDING = 1e-5, 1e-15  # s, J; energy that may appear in a step however short: rounding of large forces
LOSS = 10.0  # how many times more energy may vanish in a step than appear

# T: time, s. STEP: next step, s. INDEX: next output. TAKEN, REJECTED: steps. UNSOLVED: steps whose contact problem was
# not solved. IMPACTS: of links that closed fast. LOST: energy that contacts took, J. DEEPEST: greatest penetration, m.
# FORCED: steps taken though their energy balance is off. ENERGY_GAIN: energy that came from nowhere, J. IMPACT_DUE: 1.0
# where a link touches or a joint reaches its limit, and an impact is due. BEND: greatest angle past a joint limit, rad.
# GIVEN: by how much the energy that contacts took has fallen since it was greatest, J. SPENT: time with contact, s.
T, STEP, INDEX, TAKEN, REJECTED, UNSOLVED, IMPACTS, LOST = range(8)
DEEPEST, FORCED, ENERGY_GAIN, IMPACT_DUE, BEND, GIVEN, SPENT, CLOCK = range(8, 16)


class Bounds(NamedTuple):
    """Bounds of a rollout with contact."""

    stop: float  # s
    step: float  # s, longest step
    tol: float  # m, error allowed in the position of any joint, as in ``rollout.run``
    rate: float  # W, at which energy may appear from nowhere
    clear: float  # m, smallest gap at which the rope has left the pegs
    slack: float  # rad, smallest gap, by the present rates, at which joints have left their limits
    budget: int  # steps of one call


class ContactState(NamedTuple):
    """State of a rollout with contact; all arrays are changed in place."""

    y: Array  # (2 n + 2,) angles, rates, work put in, energy dissipated
    clock: Array  # (CLOCK,)
    spin: Array  # (2, m) angles, rad, and rates, rad/s, of the pegs; 0 of fixed ones
    memory: ContactMemory
    torque: Array  # (k, COLUMNS) windows of ``core.chain.torque_peaks``


@non_allocating
def energy_allowance(bounds, h):  # type: ignore[no-untyped-def]
    """Energy that may appear from nowhere in a step, J."""
    return bounds.rate * max(h, SLIGHT) + ROUNDING


@non_allocating
def energy_balanced(surplus, allowed):  # type: ignore[no-untyped-def]
    """Whether the energy that appears from nowhere in a step, J, or vanishes where it is negative, may do so."""
    return -LOSS * allowed <= surplus <= allowed


class Control(NamedTuple):
    """Numbers that decide which steps in contact are accepted, and how long the next one is."""

    # of the longest step, the shortest that is tried
    shortest: float = 2.0**-10
    # times as long it is at most, in proportion to a tolerance above the usual one, where that is safe
    coarsest: float = 2.0**5
    # s, the shortest step to an impact
    brief: float = 1e-9
    # of the longest step: errors of positions shorten no step that is shorter
    resolved: float = 0.12
    # relative error of a step that is tried again at half its length
    rejected_error: float = 4.0
    # of the smallest reach of a peg that links near one may move in a step
    safe: float = 0.5
    # how many times more energy than may appear contacts may give a rope that they push out
    generous: float = 100.0
    # m, penetration at which a step is tried again at half its length
    deeper: float = 5e-5
    # factor from a step to the next
    growth: float = 1.5
    # relative error of a step, below which steps grow
    easy: float = 0.2
    # times the greatest depth until then, which a step may have: what sinks slowly sinks at any step
    sinking: float = 1.02


CONTROL: Final = Control()


class Chosen(NamedTuple):
    """The step that :func:`choose_step` left in a workspace."""

    h: float  # s
    wanted: float  # s; h is shorter where touchdown or an end cut it, or where equal steps lead to an end
    least: float  # m, smallest gap
    touch: float  # s, until a link touches
    rounds: int  # of the search; negative if it failed
    surplus: float  # J, energy from nowhere
    had: float  # J, energy before it
    has: float  # J, and after it
    good: bool  # False where the shortest step had to be taken as it was
    error: float  # of positions, relative to what is allowed
    push: bool  # whether contacts might push the rope out
    struck: bool  # whether an impact was made at the instant at which it begins


@absorbed
def accept_step(drive, state, workspace, h, rounds, least):  # type: ignore[no-untyped-def]
    """Accept the step to ``workspace.out``."""
    load, angle = workspace.motion.load, workspace.base[1, 4]
    about_shaft = load[2] + drive.arm_length * (math.cos(angle) * load[0] + math.sin(angle) * load[1])
    watch_torque(state.torque, about_shaft, state.clock[T], h)
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
    """Longest step, s, in which no link near a peg moves by more than CONTROL.safe of the smallest reach."""
    speed = workspace.motion.speed
    fastest = 0.0
    for c in range(workspace.contacts.total[0]):
        i = workspace.contacts.link[c]
        for j in range(i, i + 2):
            fastest = max(fastest, abs(speed[0, j]), abs(speed[1, j]))
    smallest = np.inf
    for p in range(pegs.reach.size):
        smallest = min(smallest, pegs.reach[p])
    return CONTROL.safe * smallest / fastest if fastest > 0.0 else np.inf


@non_allocating
def step_error(chain, workspace, h):  # type: ignore[no-untyped-def]
    """Error that a step makes in the velocity of any joint, m/s, where no mode changed for three steps; else 0.0.

    A twelfth of the difference from the extrapolation of the last two steps.
    """
    motion, trend, pace = workspace.motion, workspace.trend, workspace.pace
    further = trend_factor(pace, h)
    if further == 0.0:
        return 0.0
    n = motion.w.size
    x = y = worst = 0.0
    for i in range(n):
        off = motion.change[i] - h * (trend[0, i] + further * (trend[0, i] - trend[1, i]))
        x += chain.length[i] * motion.trig[n + i] * off
        y += chain.length[i] * motion.trig[i] * off
        worst = max(worst, x * x + y * y)
    return math.sqrt(worst) / 12.0


@non_allocating
def relative_error(chain, bounds, memory, workspace, h):  # type: ignore[no-untyped-def]
    """Error of a step in units of what is allowed, as in free flight; 0.0 where modes change."""
    if not keeps_modes(memory, workspace.contacts, workspace.impulses, workspace.joints):
        return 0.0
    return step_error(chain, workspace, h) * lasting(h) / allowed(bounds.tol, h, 0.0)


@non_allocating
def growth(error):  # type: ignore[no-untyped-def]
    """Factor from a step with a relative error to the next one."""
    return CONTROL.growth if error < CONTROL.easy else 1.0 if error < 1.0 else 1.0 / CONTROL.growth


@non_allocating
def choose_step(chain, drive, part, pegs, pull, bounds, state, workspace, nothing, end, struck, had):  # type: ignore[no-untyped-def]
    """Try a step, and shorter ones, until one will do; it is left in `workspace`.

    Parameters
    ----------
    chain, drive, part, pegs, pull, bounds, state, workspace : as for ``run.run`` and :func:`try_step`
    nothing : ContactMemory, empty
    end : s, time that no step goes beyond
    struck : bool, an impact was made already at this instant
    had : J, energy before the step, NaN if it is not known

    Returns
    -------
    Chosen
    """
    y, clock, t, trig = state.y, state.clock, state.clock[T], workspace.ahead_trig
    wanted = min(clock[STEP], bounds.step)
    h = fitted(wanted, end - t)
    coarse = max(1.0, min(bounds.tol / USUAL_TOL, CONTROL.coarsest))
    finest, shortest = CONTROL.shortest * bounds.step, min(coarse * CONTROL.shortest * bounds.step, h)
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
            h = max(touch, CONTROL.brief)
            shortest = min(shortest, h)
            continue
        rounds = finish_step(chain, workspace, torque, h)
        given = energy_allowance(bounds, h)
        if push and workspace.account[CONTACT] < -CONTROL.generous * given:
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
        good = good and (least > -CONTROL.deeper or -least <= CONTROL.sinking * clock[DEEPEST])
        good = good and (error <= CONTROL.rejected_error or h <= CONTROL.resolved * bounds.step)
        little = gives_little(bounds, clock, workspace, h)
        if push and not little:  # a shorter step would be pushed out with as much power
            push = False
            continue
        good = good and little
        good = good and (workspace.bend[0] > -JOINTS.beyond or -workspace.bend[0] <= CONTROL.sinking * clock[BEND])
        if good or back or (h <= shortest and (surplus <= stale if anew else rounds > 0)):
            return Chosen(h, wanted, least, touch, rounds, surplus, had, has, good, error, push, struck)
        if h <= shortest:  # the last resort: a search from nothing, unless that gives more energy
            anew, back, stale = not anew, anew, surplus
            continue
        h = max(0.5 * h, shortest)
        wanted, push = h, True
        clock[REJECTED] += 1.0


@non_allocating
def complete_step(drive, bounds, state, workspace, chosen, end):  # type: ignore[no-untyped-def]
    """Accept what :func:`choose_step` returned, and set the clock for the next step; none goes beyond `end`, s."""
    clock, h = state.clock, chosen.h
    t = clock[T]
    if not chosen.good:
        clock[FORCED] += 1.0
    clock[ENERGY_GAIN] += chosen.surplus
    accept_step(drive, state, workspace, h, chosen.rounds, chosen.least)
    clock[IMPACT_DUE] = 1.0 if chosen.touch <= 1.001 * h else 0.0
    clock[T] = end if h >= end - t else t + h
    clock[STEP] = max(chosen.wanted * growth(chosen.error), min(chosen.wanted, CONTROL.resolved * bounds.step))


MOST_STEPS = 100  # to a sample


@kernel
def new_branch(state):  # type: ignore[no-untyped-def]
    """A ContactState of the same shapes, for :func:`branch_off`."""
    memory = new_contact_memory(*state.memory.normal.shape)
    return ContactState(state.y.copy(), state.clock.copy(), state.spin.copy(), memory, state.torque.copy())


@non_allocating
def copy_before(workspace, aside):  # type: ignore[no-untyped-def]
    """Copy what a step begins with, except the state, from its workspace to another.

    Of ``motion.pull`` that is what the step itself found, the best guess at hand: what it began with is gone.
    """
    assign_rows(aside.trend, workspace.trend)
    assign(aside.pace, workspace.pace)
    assign_rows(aside.motion.pull, workspace.motion.pull)
    aside.motion.span[0] = workspace.motion.span[0]
    assign(aside.spin.before, workspace.spin.before)


@non_allocating
def partial_step(chain, drive, part, pegs, pull, bounds, state, workspace, aside, branch, chosen, x):  # type: ignore[no-untyped-def]
    """Take the part x of the step `chosen`, in `workspace`, to `aside`; returns whether that keeps the energy.

    The rates are off the straight line between the ends of a step by a term of second order, and their energy with
    them, so a sample within a step is a shorter step: from the modes and forces that the whole step found, which go to
    ``branch.memory``. Links that touch are held: the whole step found no impact to make.
    """
    copy_before(workspace, aside)
    found, h = branch.memory, chosen.h
    save_memory(found, workspace.contacts, workspace.impulses, workspace.joints, h)
    try_step(chain, drive, part, pegs, pull, state.clock[T], x * h, state.y, found, aside, chosen.push, 0.0, True)
    taken = aside.account[FRICTION] + aside.account[CONTACT] - aside.account[WORK]
    has = energy(chain, aside.out, aside.base[2], aside.ahead_trig) + turning_energy(aside.spin, aside.spin.after)
    return energy_balanced(has - chosen.had + taken, energy_allowance(bounds, h))


@non_allocating
def branch_off(chain, drive, part, pegs, pull, bounds, state, workspace, aside, branch, nothing, struck, end):  # type: ignore[no-untyped-def]
    """Go from before the step of `workspace` to the time `end`, s, by steps chosen as those of a run, in `branch`.

    Returns whether it gets there with its energy kept. The run itself continues from the end of its step. `struck`:
    whether an impact was made where the step begins.
    """
    copy_before(workspace, aside)
    assign(branch.y, state.y)
    assign(branch.clock, state.clock)
    assign_rows(branch.spin, state.spin)
    assign_rows(branch.torque, state.torque)
    copy_memory(state.memory, branch.memory)
    for _ in range(MOST_STEPS):
        if branch.clock[IMPACT_DUE] == 1.0:
            impact(chain, drive, part, pegs, pull, branch, aside)
            struck = True
        chosen = choose_step(chain, drive, part, pegs, pull, bounds, branch, aside, nothing, end, struck, math.nan)
        if not (chosen.good and abs(chosen.surplus) < math.inf):
            return False
        complete_step(drive, bounds, branch, aside, chosen, end)
        if branch.clock[T] >= end - MOMENT:
            return True
        struck = False
    return False


@non_allocating
def write_state(state, n, k, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Write a ContactState of n links as output k."""
    for i in range(state.y.size):
        y_out[k, i] = state.y[i]
    seen_out[k, 3 * n + 3] = state.clock[LOST]
    m = state.spin.shape[1]
    for p in range(m):
        seen_out[k, 3 * n + 4 + p], seen_out[k, 3 * n + 4 + m + p] = state.spin[0, p], state.spin[1, p]


@non_allocating
def write_sample(workspace, h, x, state, k, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Write the part x of the step in `workspace`, of length h, as output k: rates straight between its ends."""
    y, clock, change = state.y, state.clock, workspace.motion.change
    n = change.size
    for i in range(n):
        y_out[k, i] = y[i] + x * h * (y[n + i] + 0.5 * x * change[i])
        y_out[k, n + i] = y[n + i] + x * change[i]
    y_out[k, 2 * n] = y[2 * n] + x * workspace.account[WORK]
    y_out[k, 2 * n + 1] = y[2 * n + 1] + x * (workspace.account[FRICTION] + workspace.account[CONTACT])
    seen_out[k, 3 * n + 3] = clock[LOST] + x * workspace.account[CONTACT]
    o, m = 3 * n + 4, workspace.spin.reach.size
    for p in range(m):
        more = workspace.spin.after[p] - workspace.spin.before[p]
        seen_out[k, o + p] = state.spin[0, p] + x * h * (workspace.spin.before[p] + 0.5 * x * more)
        seen_out[k, o + m + p] = workspace.spin.before[p] + x * more


@non_allocating
def write(  # type: ignore[no-untyped-def]
    chain, drive, part, pegs, pull, bounds, state, workspace, aside, branch, nothing, chosen, t_out, y_out, seen_out
):
    """Write the outputs within the step `chosen` to ``workspace.out``.

    A sample is a partial step; where that does not keep the energy it is reached by steps of its own, in `aside` and
    `branch`, a workspace and a state, and `nothing` is as for :func:`choose_step`. Where these fail, too, it lies on
    the straight line between the ends of the step. Accelerations and forces are the means over the whole step.
    """
    clock, h = state.clock, chosen.h
    while clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] <= clock[T] + h:
        k = int(clock[INDEX])
        x = (t_out[k] - clock[T]) / h
        if x * h <= MOMENT:  # the ends of a step keep the energy
            x = 0.0
        elif (1.0 - x) * h <= MOMENT:
            x = 1.0
        step = chain, drive, part, pegs, pull, bounds, state, workspace, aside, branch
        if x == 0.0 or x == 1.0:
            write_sample(workspace, h, x, state, k, y_out, seen_out)
        elif partial_step(*step, chosen, x):
            write_sample(aside, x * h, 1.0, state, k, y_out, seen_out)
        elif branch_off(*step, nothing, chosen.struck, t_out[k]):
            write_state(branch, chain.length.size, k, y_out, seen_out)
        else:
            write_sample(workspace, h, x, state, k, y_out, seen_out)
        step_means(workspace, h, seen_out[k])
        clock[INDEX] += 1


@non_allocating
def step_means(workspace, h, out):  # type: ignore[no-untyped-def]
    """Means over a step, to the first 3 n + 3 entries of ``out``.

    Accelerations, rad/s^2; forces of the pegs on the links, first x, then y, N; force on the rope at its first joint,
    x and y, N, and torque through that joint, N m.
    """
    contacts, impulses, motion = workspace.contacts, workspace.impulses, workspace.motion
    n = motion.w.size
    for i in range(n):
        out[i] = motion.change[i] / h
        out[n + i] = out[2 * n + i] = 0.0
    for k in range(3):
        out[3 * n + k] = motion.load[k] / h
    for c in range(contacts.total[0]):
        if impulses.mode[c] != OPEN:
            i, nx, ny = contacts.link[c], contacts.nx[c], contacts.ny[c]
            out[n + i] += (impulses.normal[c] * nx - impulses.tangent[c] * ny) / h
            out[2 * n + i] += (impulses.normal[c] * ny + impulses.tangent[c] * nx) / h


@non_allocating
def take_steps(  # type: ignore[no-untyped-def]
    chain, drive, pegs, pull, bounds, state, workspace, aside, branch, nothing, t_out, y_out, seen_out
):
    """Take the steps of :func:`run`, apart: a function that makes arrays counts references to all that it handles."""
    clock, memory = state.clock, state.memory
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
        chosen = choose_step(chain, drive, part, pegs, pull, bounds, state, workspace, nothing, end, struck, had)
        if not (abs(chosen.surplus) < math.inf):
            if not is_empty(memory):  # begin anew, from nothing
                clear_memory(memory)
                continue
            return status.NOT_FINITE
        if clock[INDEX] < t_out.size:
            rest = nothing, chosen, t_out, y_out, seen_out
            write(chain, drive, part, pegs, pull, bounds, state, workspace, aside, branch, *rest)
        had = chosen.has
        complete_step(drive, bounds, state, workspace, chosen, end)
        if chosen.least > bounds.clear and workspace.bend[1] > bounds.slack and clock[T] < bounds.stop:
            return status.LEFT
    return status.RUNNING if clock[T] < bounds.stop else status.OK


@kernel
def run(chain, drive, pegs, pull, bounds, state, t_out, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Run until ``bounds.stop`` or until the budget is spent.

    Parameters
    ----------
    chain, drive, pegs, bounds, state : Chain, Drive, Pegs, Bounds, ContactState
    pull : (2,) force on the tip in addition to gravity, N
    t_out : (k,) increasing times, s; y_out : (k, 2 n + 2) out, as in ``rollout.run``
    seen_out : (k, 3 n + 4 + 2 m) out: ``see``, energy lost to contact, J, angles, rad, and rates, rad/s, of the m pegs

    Returns
    -------
    int : OK, RUNNING (call again), LEFT (no link is near a peg, no joint near its limit), or why it failed
    """
    workspace = new_contact_workspace(chain, pegs, bounds.rate, bounds.step, bounds.tol)
    aside = new_contact_workspace(chain, pegs, bounds.rate, bounds.step, bounds.tol)
    assign(workspace.spin.before, state.spin[1])
    nothing = new_contact_memory(chain.length.size, pegs.x.size)
    rest = new_branch(state), nothing, t_out, y_out, seen_out
    return take_steps(chain, drive, pegs, pull, bounds, state, workspace, aside, *rest)


@kernel
def clearance(chain, drive, pegs, t, y, near):  # type: ignore[no-untyped-def]
    """What is left at time t until rope and pegs, or joints and their limits, meet; y as in ``ContactState``.

    Gaps above `near`, m, may be reported too small.

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
