"""Base reactions of the rope: the load on the motor of a prescribed arm."""

import numpy as np

from hyperflex.core.chain.articulated_body import accelerations, dry_joints
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.core.jit import kernel
from hyperflex.core.stiction import find_modes, new_stiction_workspace


def senses(chain, drive, t, y, slip):  # type: ignore[no-untyped-def]
    """Sense in which each joint slips, 1.0 or -1.0, or 0.0 where it sticks, to `slip` (m, n); t (m,), y (m, 2 n)."""
    write_senses(chain, drive, dry_joints(chain.dry), t, y, slip)


@kernel
def write_senses(chain, drive, dry, t, y, slip):  # type: ignore[no-untyped-def]
    """Do what :func:`senses` does; `dry` is SLIDING or STICKING."""
    n = chain.length.size
    base, workspace = np.empty(9), new_stiction_workspace(n)
    for k in range(t.size):
        torque = base_state(drive, segment(drive, t[k]), t[k], base)
        up = base[3]
        for i in range(n):
            slip[k, i] = -1.0 if y[k, n + i] < up else 1.0
            up = y[k, n + i]
        if len(dry) > 0:
            find_modes(chain, y[k, :n], y[k, n : 2 * n], base[:7], torque, 1.0, slip[k], workspace)


@kernel
def reactions(chain, drive, t, y, slip, out):  # type: ignore[no-untyped-def]
    """Load of the rope on the motor at given states, and the motion of the arm there.

    Parameters
    ----------
    t : (m,) times, s; y : (m, 2 n or more) angles and rates; slip : (m, n), see :func:`senses`
    out : (m, 4) out: torque about the shaft, N m; angle, rate and acceleration of the arm, rad, rad/s, rad/s^2
    """
    n = chain.length.size
    base, alpha, work = np.empty(9), np.empty(n), np.empty(6 * n)
    for k in range(t.size):
        torque = base_state(drive, segment(drive, t[k]), t[k], base)
        q, w = y[k, :n], y[k, n : 2 * n]
        fx, fy, moment = accelerations(chain, q, w, slip[k], base[:7], torque, 0.0, alpha, work)
        pull = drive.arm_length * (np.cos(base[4]) * fx + np.sin(base[4]) * fy)
        out[k, 0] = moment + torque + pull
        out[k, 1], out[k, 2], out[k, 3] = base[4], base[3], base[2]
