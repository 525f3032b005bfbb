"""Outputs of a rollout with contact."""

import math

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.contact.account import CONTACT, FRICTION, WORK, energy
from hyperflex.core.contact.arrays import OPEN
from hyperflex.core.contact.bounds import INDEX, LOST, MOMENT, T, energy_allowance, energy_balanced
from hyperflex.core.contact.step import save_memory, try_step
from hyperflex.core.contact.turning_pegs import turning_energy
from hyperflex.core.jit import non_allocating


@non_allocating
def partial_step(chain, drive, part, pegs, pull, bounds, state, workspace, found, aside, h, x, had):  # type: ignore[no-untyped-def]
    """Take the part x of the step of `workspace` to `aside`; returns the energy from nowhere, J.

    The rates are off the straight line between the ends of a step by a term of second order, and their energy with
    them, so a sample within a step is a shorter step. Three are tried until one keeps the energy: from the modes and
    forces that the whole step `found`, a ContactMemory; from those before it; and without pushing the rope out of a
    peg, as the whole step may have been taken. `had` is the energy before it, J.
    """
    surplus = math.inf
    for attempt in range(3):
        assign_rows(aside.trend, workspace.trend)
        assign(aside.pace, workspace.pace)
        assign_rows(aside.motion.pull, workspace.motion.pull)
        aside.motion.span[0] = workspace.motion.span[0]
        assign(aside.spin.before, workspace.spin.before)
        begin, push, t = state.memory if attempt == 1 else found, attempt < 2, state.clock[T]
        try_step(chain, drive, part, pegs, pull, t, x * h, state.y, begin, aside, push, 0.0, True)
        taken = aside.account[FRICTION] + aside.account[CONTACT] - aside.account[WORK]
        has = energy(chain, aside.out, aside.base[2], aside.ahead_trig) + turning_energy(aside.spin, aside.spin.after)
        surplus = has - had + taken
        if energy_balanced(surplus, energy_allowance(bounds, h)):
            break
    return surplus


@non_allocating
def straight_surplus(chain, state, workspace, aside, h, x, had):  # type: ignore[no-untyped-def]
    """Energy from nowhere, J, of the sample that :func:`write_sample` writes at the part x of the step of `workspace`.

    `aside` holds the base there, of :func:`partial_step`.
    """
    y, change, out, spin = state.y, workspace.motion.change, aside.out, workspace.spin
    n = change.size
    for i in range(n):
        out[i] = y[i] + x * h * (y[n + i] + 0.5 * x * change[i])
        out[n + i] = y[n + i] + x * change[i]
    taken = workspace.account[FRICTION] + workspace.account[CONTACT] - workspace.account[WORK]
    turning = (1.0 - x) * turning_energy(spin, spin.before) + x * turning_energy(spin, spin.after)
    return energy(chain, out, aside.base[2], aside.ahead_trig) + turning - had + x * taken


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
def write(chain, drive, part, pegs, pull, bounds, state, workspace, found, aside, h, had, t_out, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Write the outputs within the step to ``workspace.out``, which had the energy `had` before it, J.

    A sample is a partial step; where that does not keep the energy, and is further off than the straight line between
    the ends of the step, it lies on that line. `found` is room for a ContactMemory.
    """
    clock, allowed, saved = state.clock, energy_allowance(bounds, h), False
    while clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] <= clock[T] + h:
        k = int(clock[INDEX])
        x = (t_out[k] - clock[T]) / h
        if x * h <= MOMENT:  # the ends of a step keep the energy
            x = 0.0
        elif (1.0 - x) * h <= MOMENT:
            x = 1.0
        straight = x == 0.0 or x == 1.0
        if not (straight or saved):
            save_memory(found, workspace.contacts, workspace.impulses, workspace.joints, h)
            saved = True
        if not straight:
            surplus = partial_step(chain, drive, part, pegs, pull, bounds, state, workspace, found, aside, h, x, had)
            if not energy_balanced(surplus, allowed):
                straight = not (abs(surplus) < abs(straight_surplus(chain, state, workspace, aside, h, x, had)))
        if straight:
            write_sample(workspace, h, x, state, k, y_out, seen_out)
        else:
            write_sample(aside, x * h, 1.0, state, k, y_out, seen_out)
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
