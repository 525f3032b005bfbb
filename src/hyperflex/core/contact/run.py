"""Run loop with contact: impacts, steps, outputs between their ends, and where the rope leaves."""

import math

import numpy as np

from hyperflex.core import status
from hyperflex.core.assign import assign
from hyperflex.core.chain.articulated_body import sines
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.core.contact.bounds import IMPACT_DUE, INDEX, T
from hyperflex.core.contact.gaps import find, joint_positions, new_contacts, speeds
from hyperflex.core.contact.joints import bend_clearance
from hyperflex.core.contact.output import new_branch, write
from hyperflex.core.contact.step import new_contact_workspace
from hyperflex.core.contact.step_control import choose_step, complete_step, impact
from hyperflex.core.contact.warm_start import clear_memory, is_empty, new_contact_memory
from hyperflex.core.jit import kernel, non_allocating


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
    pull : (2,) force on the tip beside gravity, N
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
