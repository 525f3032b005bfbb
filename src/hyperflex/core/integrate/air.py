"""Error of a step by drag reversal, the kink of quadratic drag (M.35)."""

import numpy as np

from hyperflex.core.chain.articulated_body import sines
from hyperflex.core.chain.drive import base_state
from hyperflex.core.integrate.step_size import allowed, lasting
from hyperflex.core.jit import kernel, non_allocating

NEAR = 2.0  # looks from the ends of a step


@non_allocating
def across_ends(chain, y, base, trig, out):  # type: ignore[no-untyped-def]
    """Velocities across each link at its near and far joint to ``out`` (2, n), m/s; `trig` (2 n,) is scratch.

    `y` (2 n or more,) are angles and rates, `base` (7 or more,) as in ``accelerations``.
    """
    n = out.shape[1]
    sines(y[:n], trig, 0)
    vx, vy = base[5], base[6]
    for i in range(n):
        turn = chain.length[i] * y[n + i]
        out[0, i] = vx * trig[n + i] + vy * trig[i]
        out[1, i] = out[0, i] + turn
        vx += turn * trig[n + i]
        vy += turn * trig[i]


@non_allocating
def unseen(chain, before, after, step, order):  # type: ignore[no-untyped-def]
    """Error of velocities, m/s, by air that begins to pull the other way where no column of a step looks.

    A kink amid the looks of the finest column, `order` a step, shows in the error estimate. One before the second look
    or after the last is taken for smooth by all columns, and one beyond the next hardly shows: what those do is
    estimated here.

    Parameters
    ----------
    before, after : (2, n) velocities across the links at the step's ends, see :func:`across_ends`
    step, order : s, int
    """
    length, mass, worst = 0.0, chain.tip_mass, 0.0
    for i in range(before.shape[1]):
        length += chain.length[i]
        mass += chain.mass[i]
        for end in range(2):
            first, last = before[end, i], after[end, i]
            if first * last < 0.0:
                least = min(abs(first), abs(last))
                part = least / (abs(first) + abs(last))
                if part * order < NEAR:
                    now = before if abs(first) < abs(last) else after
                    width = least / max(abs(now[1, i] - now[0, i]), least)
                    worst = max(worst, chain.drag[i] * least * least * part * width)
    return (2.0 / 3.0) * step * worst * length / mass


@kernel
def air_size(chain, drive, part, limits, table, t, step, y, workspace):  # type: ignore[no-untyped-def]
    """Error of the step from y to ``workspace.out`` that the air makes unseen, in units of what is allowed."""
    base, trig, ends = workspace.after, workspace.stiction.work, np.empty((2, 2, chain.length.size))
    for k in range(2):
        base_state(drive, part, min(t + k * step, part.end), base)
        across_ends(chain, workspace.out if k == 1 else y, base, trig, ends[k])
    error = unseen(chain, ends[0], ends[1], step, table.order)
    return error * lasting(step) / allowed(limits.tol, step, table.rounding)
