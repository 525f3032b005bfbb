"""Peaks of the torque that a rope in contact asks of the motor: greatest means over short windows, impacts included."""

import math

from hyperflex.core.jit import non_allocating

WINDOWS = (5e-4, 5e-3)  # s; an impact takes no time, so its torque is a mean over some
SPENT, SUM, END, PEAK, WHEN, COLUMNS = range(6)  # of a window: time so far, s, angular impulse, end, peak, its time


@non_allocating
def watch_torque(peaks, arm_length, workspace, t, h):  # type: ignore[no-untyped-def]
    """Add a step from t, s, of length h, s, to windows (k, COLUMNS), which begin anew after free flight.

    ``PEAK`` is the mean torque about the shaft of greatest size, N m, with the motor's sign; ``WHEN`` is its time.
    """
    load, angle = workspace.motion.load, workspace.base[1, 4]
    impulse = load[2] + arm_length * (math.cos(angle) * load[0] + math.sin(angle) * load[1])
    for k, window in enumerate(WINDOWS):
        row = peaks[k]
        if t > row[END] + 1e-12:
            row[SPENT] = row[SUM] = 0.0
        row[SUM] += impulse
        row[SPENT] += h
        row[END] = t + h
        mean = row[SUM] / max(row[SPENT], window)
        if abs(mean) > abs(row[PEAK]):
            row[PEAK], row[WHEN] = mean, t
        if row[SPENT] >= window:
            row[SPENT] = row[SUM] = 0.0
