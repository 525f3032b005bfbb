"""Constraint torques of stuck joints, and margins to a change of mode (M.16).

A slipping joint has a constant friction torque against its sense of slipping. A stuck joint turns with its parent; its
constraint torque is at most the dry friction (M.16). The modes, `slip`, are constant within a step. A change of mode is
an event, and a step ends exactly there. Which modes hold at an instant is decided in ``slip_modes``.
"""

from typing import NamedTuple

import numpy as np

from hyperflex.core import joint_law
from hyperflex.core.chain.air import air_loads
from hyperflex.core.chain.articulated_body import Array, accelerations, joint_of
from hyperflex.core.jit import kernel, non_allocating

SAME = 4e-15  # links whose rates differ by no more than this part of them, and
STILL = 1e-12  # rad/s, this much, turn alike: one switch's rounding of the arm's rate
SLACK = 1e-12  # part of the dry friction, and
NOISE = 1e-13  # part of all torques on a link, by which a torque must exceed dry friction to count: above rounding
INSTANT = 1e-13  # s, how well an event is located
QUICK = 1e-9  # s; event after event in steps shorter than this is chatter
WIDEST = 8.0  # powers of ten by which SLACK and NOISE are widened at most, see widened
HOPELESS = 30.0  # quick events beyond those that joints may need, after which they chatter


class StictionWorkspace(NamedTuple):
    """Working arrays for one chain of n links."""

    alpha: Array  # (n,)
    load: Array  # (n,) friction torque of each joint, N m
    slack: Array  # (n,) by how much a torque must exceed dry friction to count, N m
    work: Array  # (6 n,)
    state: Array  # (2 n,) angles and rates in the middle of a step
    margin: Array  # (2, n) and the margins there


@kernel
def new_stiction_workspace(n):  # type: ignore[no-untyped-def]
    """Working arrays for n links."""
    return StictionWorkspace(np.zeros(n), np.zeros(n), np.zeros(n), np.empty(6 * n), np.empty(2 * n), np.empty((2, n)))


@non_allocating
def constraint_torques(chain, q, w, slip, base, torque, workspace):  # type: ignore[no-untyped-def]
    """Accelerations, and the friction torque of each joint, also of stuck ones; two passes, O(n).

    Newton's and Euler's equations link by link, from the tip: independent of the elimination in the sweep. Arguments as
    in ``articulated_body.accelerations``; results in ``alpha``, ``load`` and ``slack`` of `workspace`.
    """
    n = q.size
    alpha, work = workspace.alpha, workspace.work
    accelerations(chain, q, w, slip, base, torque, 0.0, alpha, work)
    air_loads(chain, w, base, work, 2 * n, 1)
    px = base[0] - chain.gx
    py = base[1] - chain.gy
    for i in range(n):  # sines and cosines are where the sweep left them; what it kept for the way back is spent
        work[i], work[n + i] = px, py
        rate2 = w[i] * w[i]
        px += chain.length[i] * (work[5 * n + i] * alpha[i] - work[4 * n + i] * rate2)
        py += chain.length[i] * (work[4 * n + i] * alpha[i] + work[5 * n + i] * rate2)
    reaction_factor = len(chain.reaction) - 1.0
    fx = chain.tip_mass * px
    fy = chain.tip_mass * py
    back = size = 0.0
    for way in range(n):
        i = n - 1 - way
        sin, cos = work[4 * n + i], work[5 * n + i]
        px, py = work[i], work[n + i]
        mass, com, length = chain.mass[i], chain.com[i], chain.length[i]
        spring = joint_law.spring(joint_of(chain, i), q[i] - (q[i - 1] if i > 0 else base[4]))
        external = work[2 * n + i] + (torque if i == 0 else 0.0)
        turn = (chain.inertia[i] + mass * com * com) * alpha[i]
        turn += mass * com * (cos * px + sin * py) + length * (cos * fx + sin * fy) + back
        size += mass * abs(com) * (abs(px) + abs(py)) + length * (abs(fx) + abs(fy)) + abs(spring) + abs(external)
        workspace.load[i] = turn - spring - external
        workspace.slack[i] = SLACK * chain.dry[i] + NOISE * size
        size = abs(turn)
        back = reaction_factor * workspace.load[i] + spring
        rate2 = w[i] * w[i]
        fx += mass * (px + com * (cos * alpha[i] - sin * rate2))
        fy += mass * (py + com * (sin * alpha[i] + cos * rate2))


@non_allocating
def chatter_allowance(n):  # type: ignore[no-untyped-def]
    """Quick events that are normal for n joints at rates near zero: each may stick, slip and stick again."""
    return 4.0 * n + 4.0


@non_allocating
def tolerance_factor(chatter, n):  # type: ignore[no-untyped-def]
    """Factor on SLACK and NOISE after `chatter` quick events; above 1.0 beyond ``chatter_allowance``."""
    return 10.0 ** min(WIDEST, max(0.0, chatter - chatter_allowance(n)))


@non_allocating
def chatter_exceeded(chatter, n):  # type: ignore[no-untyped-def]
    """Whether wider tolerances have not ended the chatter after so many quick events."""
    return chatter > chatter_allowance(n) + HOPELESS


@non_allocating
def widened_count(chatter, n):  # type: ignore[no-untyped-def]
    """Count of quick events at which ``tolerance_factor`` is ten times that at `chatter`."""
    return max(chatter, chatter_allowance(n)) + 1.0


@non_allocating
def at_rest(rate, up):  # type: ignore[no-untyped-def]
    """Whether two links' rates are the same but for rounding."""
    return abs(rate - up) <= STILL + SAME * (abs(rate) + abs(up))


@non_allocating
def margins(chain, q, w, slip, base, torque, widen, workspace, out):  # type: ignore[no-untyped-def]
    """Constraint torques, and with them what :func:`margins_of` tells."""
    constraint_torques(chain, q, w, slip, base, torque, workspace)
    margins_of(chain, w, slip, base, widen, workspace, out)


@non_allocating
def margins_of(chain, w, slip, base, widen, workspace, out):  # type: ignore[no-untyped-def]
    """Margin of each joint to a change of its mode, and its slope, where the constraint torques are known.

    ``out`` (2, n): of a slipping joint the relative rate in its sense, rad/s, and how fast that grows, rad/s^2; of a
    stuck one how far its load is below its dry friction, as a part of that, and 0.0; inf without dry friction.
    """
    for i in range(w.size):
        out[0, i], out[1, i] = np.inf, 0.0
        if chain.dry[i] > 0.0 and slip[i] == 0.0:
            out[0, i] = 1.0 + (widen * workspace.slack[i] - abs(workspace.load[i])) / chain.dry[i]
        elif chain.dry[i] > 0.0:
            out[0, i] = slip[i] * (w[i] - (w[i - 1] if i > 0 else base[3]))
            out[1, i] = slip[i] * (workspace.alpha[i] - (workspace.alpha[i - 1] if i > 0 else base[2]))


@non_allocating
def project_stuck(chain, slip, q, base_before, out, base):  # type: ignore[no-untyped-def]
    """Project ``out`` (2 n + 2,) onto stuck joints: rates become the parents', angles between links stay.

    `q` (n or more,) are the angles at an earlier instant since which no mode has changed, with its base (9,).
    """
    n = slip.size
    for i in range(n):
        if chain.dry[i] > 0.0 and slip[i] == 0.0:
            out[n + i] = out[n + i - 1] if i > 0 else base[3]
            if i > 0:
                out[i] = out[i - 1] + (q[i] - q[i - 1])
            else:
                out[0] = base[4] + (q[0] - base_before[4])


@non_allocating
def stops(margin, i):  # type: ignore[no-untyped-def]
    """Whether slipping joint i is at rest by its margin and slope (2, n), or will be within an INSTANT."""
    return margin[0, i] + INSTANT * margin[1, i] <= 0.0


@non_allocating
def stop_joints(chain, slip, margin, out, base):  # type: ignore[no-untyped-def]
    """Set the rates of joints that have just stopped, and of stuck ones, to those of their parents."""
    n = slip.size
    for i in range(n):
        if chain.dry[i] > 0.0 and (slip[i] == 0.0 or stops(margin, i)):
            out[n + i] = out[n + i - 1] if i > 0 else base[3]


@non_allocating
def midpoint_state(step, q, w, alpha, out, workspace):  # type: ignore[no-untyped-def]
    """Middle of a step, to ``workspace.state``, from its ends: q, w, alpha (n,) before, ``out``, ``alpha`` after."""
    n = q.size
    for i in range(n):
        q1, w1, a1 = out[i], out[n + i], workspace.alpha[i]
        workspace.state[i] = 0.5 * (q[i] + q1) + step * (0.15625 * (w[i] - w1) + 0.015625 * step * (alpha[i] + a1))
        workspace.state[n + i] = 1.875 * (q1 - q[i]) / step - 0.4375 * (w[i] + w1) + 0.03125 * step * (a1 - alpha[i])


@non_allocating
def stuck_power(chain, w, slip, load):  # type: ignore[no-untyped-def]
    """Power that stuck joints take from the chain, W: none if their torques act on both links, which turn alike."""
    power = 0.0
    if len(chain.reaction) == 1:
        for i in range(w.size):
            if slip[i] == 0.0:
                power -= load[i] * w[i]
    return power


@non_allocating
def stuck_loss(power, step, part):  # type: ignore[no-untyped-def]
    """Energy that stuck joints take within the first `part` of a step, J; power (3,), W, at 0, 1/2 and 1 of it."""
    p0, pm, p1 = power
    slope, bend = 4.0 * pm - 3.0 * p0 - p1, 2.0 * (p0 - 2.0 * pm + p1)
    return step * part * (p0 + part * (slope / 2.0 + part * bend / 3.0))
