"""What a run beside pegs writes at its samples."""

from __future__ import annotations

from hyperflex.core.assign import assign
from hyperflex.core.contact.arrays import OPEN
from hyperflex.core.contact.bounds import INDEX, LOST, MOMENT, T, allowance, balanced
from hyperflex.core.contact.step import CONTACT, FRICTION, WORK, attempt, energy
from hyperflex.core.contact.turning_pegs import turning_energy
from hyperflex.core.jit import lean


@lean
def part_way(chain, drive, part, pegs, pull, bounds, course, desk, aside, h, x, had):  # type: ignore[no-untyped-def]
    """Take the part x of the step of the desk to the desk `aside`; False if the run would not take such a step.

    The rates are off the straight line between the ends of a step by a term of second order, and their energy with
    them, so a sample within a step is a shorter step. `had` is the energy before it, J.
    """
    if x * h <= MOMENT:
        return False
    assign(aside.trend, desk.trend)
    assign(aside.spin.before, desk.spin.before)
    t, y = course.clock[T], course.y
    _, rounds = attempt(chain, drive, part, pegs, pull, t, x * h, y, course.kept, aside, True, 0.0, True)
    taken = aside.account[FRICTION] + aside.account[CONTACT] - aside.account[WORK]
    has = energy(chain, aside.out, aside.base[2]) + turning_energy(aside.spin, aside.spin.after)
    return rounds > 0 and balanced(has - had + taken, allowance(bounds, h))


@lean
def put_down(desk, h, x, course, k, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Write the part x of the step on the desk, of length h, as output k: rates straight between its ends."""
    y, clock, change = course.y, course.clock, desk.motion.change
    n = change.size
    for i in range(n):
        y_out[k, i] = y[i] + x * h * (y[n + i] + 0.5 * x * change[i])
        y_out[k, n + i] = y[n + i] + x * change[i]
    y_out[k, 2 * n] = y[2 * n] + x * desk.account[WORK]
    y_out[k, 2 * n + 1] = y[2 * n + 1] + x * (desk.account[FRICTION] + desk.account[CONTACT])
    seen_out[k, 3 * n + 3] = clock[LOST] + x * desk.account[CONTACT]
    o, m = 3 * n + 4, desk.spin.reach.size
    for p in range(m):
        more = desk.spin.after[p] - desk.spin.before[p]
        seen_out[k, o + p] = course.spin[0, p] + x * h * (desk.spin.before[p] + 0.5 * x * more)
        seen_out[k, o + m + p] = desk.spin.before[p] + x * more


@lean
def write(chain, drive, part, pegs, pull, bounds, course, desk, aside, h, had, t_out, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Write the outputs within the step to ``desk.out``, which had the energy `had` before it, J."""
    clock = course.clock
    while clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] <= clock[T] + h:
        k = int(clock[INDEX])
        x = (t_out[k] - clock[T]) / h
        if x < 1.0 and part_way(chain, drive, part, pegs, pull, bounds, course, desk, aside, h, x, had):
            put_down(aside, x * h, 1.0, course, k, y_out, seen_out)
        else:
            put_down(desk, h, x, course, k, y_out, seen_out)
        see(desk, h, seen_out[k])
        clock[INDEX] += 1


@lean
def see(desk, h, out):  # type: ignore[no-untyped-def]
    """Means over a step, to the first 3 n + 3 entries of ``out``.

    Accelerations, rad/s^2; forces of the pegs on the links, first x, then y, N; force on the rope at its first joint,
    x and y, N, and torque through that joint, N m.
    """
    found, impulses, motion = desk.found, desk.impulses, desk.motion
    n = motion.w.size
    for i in range(n):
        out[i] = motion.change[i] / h
        out[n + i] = out[2 * n + i] = 0.0
    for k in range(3):
        out[3 * n + k] = motion.load[k] / h
    for c in range(found.total[0]):
        if impulses.mode[c] != OPEN:
            i, nx, ny = found.link[c], found.nx[c], found.ny[c]
            out[n + i] += (impulses.normal[c] * nx - impulses.tangent[c] * ny) / h
            out[2 * n + i] += (impulses.normal[c] * ny + impulses.tangent[c] * nx) / h
