"""Dense output with contact: a sample within a step is reached by a shorter step, or by several."""

import math

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.contact.account import CONTACT, FRICTION, WORK, energy
from hyperflex.core.contact.arrays import OPEN
from hyperflex.core.contact.bounds import (
    IMPACT_DUE,
    INDEX,
    LOST,
    MOMENT,
    ContactState,
    T,
    energy_allowance,
    energy_balanced,
)
from hyperflex.core.contact.step import try_step
from hyperflex.core.contact.step_control import choose_step, complete_step, impact
from hyperflex.core.contact.turning_pegs import turning_energy
from hyperflex.core.contact.warm_start import copy_memory, new_contact_memory, save_memory
from hyperflex.core.jit import kernel, non_allocating

MOST_STEPS = 100  # of its own to a sample


@kernel
def new_branch(state):  # type: ignore[no-untyped-def]
    """A ContactState of the same shapes, for :func:`branch_off`."""
    memory = new_contact_memory(*state.memory.normal.shape)
    return ContactState(state.y.copy(), state.clock.copy(), state.spin.copy(), memory, state.torque.copy())


@non_allocating
def copy_before(workspace, aside):  # type: ignore[no-untyped-def]
    """Copy what a step begins with beside the state, from its workspace to another.

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

    Returns whether it gets there with its energy kept. The run itself goes on from the end of its step. `struck` tells
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
