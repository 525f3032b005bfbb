"""Data that a step in contact passes to the next one: forces, modes, accelerations and their changes."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.contact.arrays import IMPULSE, OPEN, RELAXED, RUBBED, UNHELD
from hyperflex.core.contact.gaps import Index
from hyperflex.core.contact.joints import seen_mode
from hyperflex.core.jit import kernel, non_allocating, zeros

LATEST, EARLIER, STEADY = range(3)  # of ContactWorkspace.pace


class ContactMemory(NamedTuple):
    """Contact forces and modes of the last step, the warm start of the next; by link and peg or by joint."""

    normal: Array  # (n, m) N
    tangent: Array
    mode: Index
    penalty: Array  # (1,) kg, as in Impulses
    torque: Array  # (n,) N m, of the joints' dry friction and limits
    bent: Index  # (n,) their modes, as ``seen_mode``


@kernel
def new_contact_memory(n, pegs):  # type: ignore[no-untyped-def]
    """An empty memory."""
    modes, joints = np.zeros((n, pegs), np.int64), np.zeros(n, np.int64)
    return ContactMemory(*zeros((n, pegs), (n, pegs)), modes, *zeros(1, n), joints)  # type: ignore[call-arg]


@non_allocating
def clear_memory(memory):  # type: ignore[no-untyped-def]
    """Clear the modes and forces of the last step."""
    memory.penalty[0] = 0.0
    memory.normal[:] = memory.tangent[:] = memory.torque[:] = 0.0
    memory.mode[:] = OPEN
    memory.bent[:] = OPEN


@non_allocating
def warm_start(memory, contacts, impulses, h):  # type: ignore[no-untyped-def]
    """Warm start: modes and forces of the last step."""
    impulses.penalty[0] = memory.penalty[0]
    for c in range(contacts.total[0]):
        i, p = contacts.link[c], contacts.peg[c]
        impulses.mode[c] = memory.mode[i, p] if impulses.target[c] < UNHELD else OPEN
        impulses.start[0, c] = RELAXED * h * memory.normal[i, p]
        impulses.start[1, c] = RELAXED * h * memory.tangent[i, p]


@non_allocating
def save_memory(memory, contacts, impulses, joints, h):  # type: ignore[no-untyped-def]
    """Save modes and forces for the next step; `joints` are the Joints."""
    clear_memory(memory)
    memory.penalty[0] = impulses.penalty[0]
    for i in joints.which:
        memory.torque[i] = (joints.of[IMPULSE, i] + joints.of[RUBBED, i]) / h
        memory.bent[i] = seen_mode(joints, i)
    for c in range(contacts.total[0]):
        i, p = contacts.link[c], contacts.peg[c]
        memory.mode[i, p] = impulses.mode[c]
        memory.normal[i, p], memory.tangent[i, p] = impulses.normal[c] / h, impulses.tangent[c] / h


@non_allocating
def keeps_modes(memory, contacts, impulses, joints):  # type: ignore[no-untyped-def]
    """Whether contacts and joints have the modes of the last step; `joints` are the Joints."""
    for i in joints.which:
        if memory.bent[i] != seen_mode(joints, i):
            return False
    changed = 0
    for c in range(contacts.total[0]):
        changed += memory.mode[contacts.link[c], contacts.peg[c]] != impulses.mode[c]
    return changed == 0


@non_allocating
def save_trend(memory, workspace, h):  # type: ignore[no-untyped-def]
    """Keep the accelerations of a step of length h, s, and whether it changed modes; none for a short step, 0.0."""
    motion, trend, pace = workspace.motion, workspace.trend, workspace.pace
    steady = h > 0.0 and keeps_modes(memory, workspace.contacts, workspace.impulses, workspace.joints)
    pace[EARLIER] = pace[LATEST] if steady and pace[STEADY] == 1.0 else 0.0
    pace[LATEST], pace[STEADY] = h, 1.0 if steady else 0.0
    for i in range(motion.w.size):
        trend[1, i] = trend[0, i]
        trend[0, i] = motion.change[i] / h if h > 0.0 else 0.0


@non_allocating
def trend_factor(pace, h):  # type: ignore[no-untyped-def]
    """Factor on the last change of the accelerations that extrapolates it over a step h, s; 0.0 if modes changed."""
    if pace[EARLIER] == 0.0 or pace[STEADY] == 0.0:
        return 0.0
    return (h + pace[LATEST]) / (pace[LATEST] + pace[EARLIER])
