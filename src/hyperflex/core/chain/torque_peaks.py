"""Peak motor torques of a rope in contact: greatest means over short windows, impacts included."""

import math

from hyperflex.core.jit import non_allocating

WINDOWS = (5e-4, 5e-3)  # s; an impact has no duration, so its torque is a mean over a window
PARTS = 10  # cells of a sliding window; the cell that it leaves counts partially
CELLS = PARTS + 1
END, CELL, SUM, PEAK, WHEN, FIRST = range(6)  # of a window: end, last cell, N m s, peak, its time, first cell
COLUMNS = FIRST + CELLS


@non_allocating
def watch_torque(peaks, impulse, t, h):  # type: ignore[no-untyped-def]
    """Add a step from t, s, of length h, s, to sliding windows (k, COLUMNS), which restart after free flight.

    `impulse` is that of the torque about the shaft, N m s. ``PEAK`` is the mean torque of greatest size, N m, with the
    motor's sign; ``WHEN`` is its time.
    """
    for k, window in enumerate(WINDOWS):
        add_impulse(peaks[k], window / PARTS, impulse, t, h)


@non_allocating
def add_impulse(row, width, impulse, t, h):  # type: ignore[no-untyped-def]
    """Add an angular impulse, N m s, spread evenly over t..t + h, to a window with cells of a `width`, s."""
    if t > row[END] + 1e-12:
        move_window(row, int(row[CELL]) + CELLS)
    row[END] = t + h
    first, last = math.floor(t / width), math.floor((t + h) / width)
    for j in range(first, last + 1):
        if j > row[CELL]:
            move_window(row, j)
        end = min(t + h, (j + 1) * width)
        part = impulse * (end - max(t, j * width)) / h if h > 0.0 else impulse
        row[FIRST + int(row[CELL]) % CELLS] += part
        row[SUM] += part
        left = (end - j * width) / width
        mean = (row[SUM] - left * row[FIRST + (j + 1) % CELLS]) / (PARTS * width)
        if abs(mean) > abs(row[PEAK]):
            row[PEAK], row[WHEN] = mean, t


@non_allocating
def move_window(row, cell):  # type: ignore[no-untyped-def]
    """Move a window to a later cell; earlier cells are dropped."""
    last = int(row[CELL])
    for j in range(max(last, cell - CELLS) + 1, cell + 1):
        at = FIRST + j % CELLS
        row[SUM] -= row[at]
        row[at] = 0.0
    if cell - last >= CELLS:
        row[SUM] = 0.0
    row[CELL] = cell
