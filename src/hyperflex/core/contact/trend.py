"""What the last contact steps tell of the next: where its search begins, and the error that it makes."""

import math

from hyperflex.core.integrate.step_size import allowed, lasting
from hyperflex.core.jit import non_allocating

LAST, BEFORE, STEADY = range(3)  # of ContactWorkspace.pace
GROWTH = 1.5
EASY = 0.2  # relative error of a step, below which steps grow


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


@non_allocating
def step_error(chain, workspace, h):  # type: ignore[no-untyped-def]
    """Error that a step makes in the velocity of any joint, m/s, where no mode changed for three steps; else 0.0.

    A twelfth of the difference from what the last two steps foretell.
    """
    motion, trend, pace = workspace.motion, workspace.trend, workspace.pace
    further = foresight(pace, h)
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
    return GROWTH if error < EASY else 1.0 if error < 1.0 else 1.0 / GROWTH
