"""What the last contact steps tell of the next: forces, modes and accelerations that its search begins with."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.contact.arrays import IMPULSE, OPEN, UNHELD
from hyperflex.core.contact.gaps import Index
from hyperflex.core.jit import kernel, non_allocating

LAST, BEFORE, STEADY = range(3)  # of ContactWorkspace.pace
RELAXED = 0.99  # of the last step's forces is where the next step starts: what nothing asks for dies out


class ContactMemory(NamedTuple):
    """Contact forces and modes of the last step, the warm start of the next; by link and peg or by joint."""

    normal: Array  # (n, m) N
    tangent: Array
    mode: Index
    penalty: Array  # (1,) kg, as in Impulses
    torque: Array  # (n,) N m, of the joints' dry friction and limits
    bent: Index  # (n,) their modes


@kernel
def new_contact_memory(n, pegs):  # type: ignore[no-untyped-def]
    """An empty memory."""
    return ContactMemory(
        np.zeros((n, pegs)),
        np.zeros((n, pegs)),
        np.zeros((n, pegs), np.int64),
        np.zeros(1),
        np.zeros(n),
        np.zeros(n, np.int64),
    )


@non_allocating
def copy_memory(memory, out):  # type: ignore[no-untyped-def]
    """Copy a ContactMemory to another of the same shapes."""
    assign_rows(out.normal, memory.normal)
    assign_rows(out.tangent, memory.tangent)
    assign_rows(out.mode, memory.mode)
    assign(out.penalty, memory.penalty)
    assign(out.torque, memory.torque)
    assign(out.bent, memory.bent)


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
def is_empty(memory):  # type: ignore[no-untyped-def]
    """Whether nothing was held in the last step."""
    for i in range(memory.mode.shape[0]):
        if memory.bent[i] != OPEN:
            return False
        for p in range(memory.mode.shape[1]):
            if memory.mode[i, p] != OPEN:
                return False
    return True


@non_allocating
def warm_start(memory, contacts, impulses, h):  # type: ignore[no-untyped-def]
    """Warm start: modes and forces of the last step."""
    impulses.penalty[0] = memory.penalty[0]
    for c in range(contacts.total[0]):
        i, p = contacts.link[c], contacts.peg[c]
        impulses.mode[c] = memory.mode[i, p] if impulses.target[c] < UNHELD else OPEN
        impulses.normal0[c] = RELAXED * h * memory.normal[i, p]
        impulses.tangent0[c] = RELAXED * h * memory.tangent[i, p]


@non_allocating
def save_memory(memory, contacts, impulses, joints, h):  # type: ignore[no-untyped-def]
    """Save modes and forces for the next step; `joints` are the Joints."""
    for i in joints.which:
        memory.torque[i], memory.bent[i] = joints.of[IMPULSE, i] / h, joints.mode[i]
    memory.penalty[0] = impulses.penalty[0]
    for i in range(memory.mode.shape[0]):
        for p in range(memory.mode.shape[1]):
            memory.normal[i, p] = memory.tangent[i, p] = 0.0
            memory.mode[i, p] = OPEN
    for c in range(contacts.total[0]):
        i, p = contacts.link[c], contacts.peg[c]
        memory.mode[i, p] = impulses.mode[c]
        memory.normal[i, p], memory.tangent[i, p] = impulses.normal[c] / h, impulses.tangent[c] / h


@non_allocating
def keeps_modes(memory, contacts, impulses, joints):  # type: ignore[no-untyped-def]
    """Whether contacts and joints have the modes of the last step; `joints` are the Joints."""
    for i in joints.which:
        if memory.bent[i] != joints.mode[i]:
            return False
    changed = 0
    for c in range(contacts.total[0]):
        changed += memory.mode[contacts.link[c], contacts.peg[c]] != impulses.mode[c]
    return changed == 0


@non_allocating
def save_trend(memory, workspace, h):  # type: ignore[no-untyped-def]
    """Keep the accelerations of a step of the length h, s, and whether it changed modes; of a short one, 0.0, none."""
    motion, trend, pace = workspace.motion, workspace.trend, workspace.pace
    steady = h > 0.0 and keeps_modes(memory, workspace.contacts, workspace.impulses, workspace.joints)
    pace[BEFORE] = pace[LAST] if steady and pace[STEADY] == 1.0 else 0.0
    pace[LAST], pace[STEADY] = h, 1.0 if steady else 0.0
    for i in range(motion.w.size):
        trend[1, i] = trend[0, i]
        trend[0, i] = motion.change[i] / h if h > 0.0 else 0.0


@non_allocating
def foresight(pace, h):  # type: ignore[no-untyped-def]
    """How many times the accelerations change again in a step h, s, as they did last; 0.0 where modes changed."""
    if pace[BEFORE] == 0.0 or pace[STEADY] == 0.0:
        return 0.0
    return (h + pace[LAST]) / (pace[LAST] + pace[BEFORE])
