"""The run loop beside pegs: steps that end where a link touches, impacts, and a guard on the energy."""

from __future__ import annotations

import math

import numpy as np

from hyperflex.core import status
from hyperflex.core.assign import assign
from hyperflex.core.chain.articulated_body import sines
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.core.contact.arrays import OPEN
from hyperflex.core.contact.bounds import (
    APPEARED,
    BENT,
    DEEPEST,
    DUE,
    FORCED,
    IMPACTS,
    INDEX,
    LOST,
    MOMENT,
    REJECTED,
    STEP,
    TAKEN,
    UNSOLVED,
    T,
    allowance,
    balanced,
)
from hyperflex.core.contact.gaps import find, joints, new_contacts, speeds
from hyperflex.core.contact.joints import BEYOND, room_to_bend
from hyperflex.core.contact.output import write
from hyperflex.core.contact.step import (
    CONTACT,
    FRICTION,
    WORK,
    attempt,
    energy,
    keep,
    new_desk,
    new_kept,
)
from hyperflex.core.contact.turning_pegs import turning_energy
from hyperflex.core.integrate.step_size import fitted
from hyperflex.core.jit import kernel, lean

SHORTEST = 2.0**-10  # of the step, the shortest that is tried
BRIEF = 1e-9  # s, the shortest step to an impact
GROWTH = 1.5
EASY = 0.2  # part of the energy allowed, below which steps grow
SAFE = 0.5  # of the smallest reach of a peg that links near one may move in a step
GENEROUS = 100.0  # how many times more energy than may appear contacts may give a rope that they push out
DEEPER = 5e-5  # m, penetration at which a step is tried again at half its length
SINKING = 1.02  # times the greatest depth until then, which a step may have: what sinks slowly sinks at any step


@lean
def commit(course, desk, h, rounds, least):  # type: ignore[no-untyped-def]
    """Take the step to ``desk.out``."""
    y, clock, account = course.y, course.clock, desk.account
    n = desk.motion.w.size
    for i in range(2 * n):
        y[i] = desk.out[i]
    y[2 * n] += account[WORK]
    y[2 * n + 1] += account[FRICTION] + account[CONTACT]
    clock[LOST] += account[CONTACT]
    clock[DEEPEST] = max(clock[DEEPEST], -least)
    clock[BENT] = max(clock[BENT], -desk.bend[0])
    clock[TAKEN] += 1.0
    if rounds < 0:
        clock[UNSOLVED] += 1.0
    for p in desk.spin.which:
        course.spin[0, p] += 0.5 * h * (desk.spin.before[p] + desk.spin.after[p])
        course.spin[1, p] = desk.spin.before[p] = desk.spin.after[p]
    long = h > MOMENT
    for i in range(n):
        desk.trend[i] = desk.motion.change[i] / h if long else 0.0
    if long:
        keep(course.kept, desk.found, desk.impulses, desk.held, h)


@lean
def forget(kept):  # type: ignore[no-untyped-def]
    """Forget the modes and forces of the last step."""
    kept.heavy[0] = 0.0
    for i in range(kept.mode.shape[0]):
        for p in range(kept.mode.shape[1]):
            kept.normal[i, p] = kept.tangent[i, p] = 0.0
            kept.mode[i, p] = OPEN
        kept.torque[i], kept.bent[i] = 0.0, OPEN


@lean
def impact(chain, drive, part, pegs, pull, course, desk, nothing):  # type: ignore[no-untyped-def]
    """Let the links that touch a peg come to rest on it, or bounce, in no time; `nothing` is a Kept without contacts.

    Newton's restitution with friction may give energy; where it does, nothing bounces.
    """
    t, y = course.clock[T], course.y
    least, rounds = attempt(chain, drive, part, pegs, pull, t, 0.0, y, nothing, desk, True, 1.0, True)
    if pegs.bounce.any() and desk.account[CONTACT] < 0.0:
        least, rounds = attempt(chain, drive, part, pegs, pull, t, 0.0, y, nothing, desk, True, 0.0, True)
    commit(course, desk, 0.0, rounds, least)
    course.clock[IMPACTS] += 1.0
    course.clock[DUE] = 0.0


@lean
def too_fast(chain, pegs, desk):  # type: ignore[no-untyped-def]
    """Longest step, s, in which no link near a peg moves by more than SAFE of the smallest reach."""
    speed = desk.motion.speed
    fastest = 0.0
    for c in range(desk.found.total[0]):
        i = desk.found.link[c]
        for j in range(i, i + 2):
            fastest = max(fastest, abs(speed[0, j]), abs(speed[1, j]))
    smallest = np.inf
    for p in range(pegs.reach.size):
        smallest = min(smallest, pegs.reach[p])
    return SAFE * smallest / fastest if fastest > 0.0 else np.inf


@lean
def choose(chain, drive, part, pegs, pull, bounds, course, desk, nothing, h, wanted, struck, had):  # type: ignore[no-untyped-def]
    """Try a step, and shorter ones, until one will do; it is left on the desk.

    Parameters
    ----------
    chain, drive, part, pegs, pull, bounds, course, desk : as for :func:`run` and :func:`attempt`
    nothing : Kept, with nothing in it
    h, wanted : s, first step to try, and the one that the run would take next
    struck : bool, an impact was made already at this instant
    had : J, energy before the step, NaN if it is not known

    Returns
    -------
    h, wanted : s
    least : m, smallest gap
    touch : s, until a link touches
    rounds : int, of the search; negative if it failed
    surplus, has : J, energy from nowhere, and energy after the step
    good : bool, False where the shortest step had to be taken as it was
    """
    y, clock, t = course.y, course.clock, course.clock[T]
    shortest = min(SHORTEST * bounds.step, h)
    push, anew, back, stale = True, False, False, np.inf
    while True:
        begin = nothing if anew else course.kept
        least, rounds = attempt(chain, drive, part, pegs, pull, t, h, y, begin, desk, push, 0.0, struck)
        touch = desk.touch[0]
        if touch == 0.0:
            impact(chain, drive, part, pegs, pull, course, desk, nothing)
            struck, had = True, math.nan
            continue
        if touch < 0.999 * h:
            h = max(touch, BRIEF)
            shortest = min(shortest, h)
            continue
        allowed = allowance(bounds, h)
        if push and desk.account[CONTACT] < -GENEROUS * allowed:
            push = False
            continue
        longest = too_fast(chain, pegs, desk)
        if math.isnan(had):
            had = energy(chain, y, desk.base[0]) + turning_energy(desk.spin, desk.spin.before)
        has = energy(chain, desk.out, desk.base[2]) + turning_energy(desk.spin, desk.spin.after)
        surplus = has - had + desk.account[FRICTION] + desk.account[CONTACT] - desk.account[WORK]
        good = balanced(surplus, allowed) and rounds > 0 and h <= longest
        good = good and (least > -DEEPER or -least <= SINKING * clock[DEEPEST])
        good = good and (desk.bend[0] > -BEYOND or -desk.bend[0] <= SINKING * clock[BENT])
        if good or back or (h <= shortest and (surplus <= stale if anew else rounds > 0)):
            return h, wanted, least, touch, rounds, surplus, has, good
        if h <= shortest:  # the last resort: a search from nothing, unless that gives more energy
            anew, back, stale = not anew, anew, surplus
            continue
        h = max(0.5 * h, shortest)
        wanted, push = h, True
        clock[REJECTED] += 1.0


@kernel
def run(chain, drive, pegs, pull, bounds, course, t_out, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Run until ``bounds.stop`` or until the budget is spent.

    Parameters
    ----------
    chain, drive, pegs, bounds, course : Chain, Drive, Pegs, Bounds, Course
    pull : (2,) force on the tip beside gravity, N
    t_out : (k,) increasing times, s; y_out : (k, 2 n + 2) out, as in ``rollout.run``
    seen_out : (k, 3 n + 4 + 2 m) out: ``see``, energy lost to contact, J, angles, rad, and rates, rad/s, of the m pegs

    Returns
    -------
    int : OK, RUNNING (call again), LEFT (no link is near a peg, no joint near its limit), or why it failed
    """
    clock, kept = course.clock, course.kept
    n, m = chain.length.size, pegs.x.size
    rate, longest = bounds.rate, bounds.step
    desk, aside = new_desk(chain, pegs, rate, longest), new_desk(chain, pegs, rate, longest)
    assign(desk.spin.before, course.spin[1])
    nothing = new_kept(n, m)
    part = segment(drive, clock[T])
    had = math.nan  # energy before the step, where it is known
    for _ in range(bounds.budget):
        t = clock[T]
        if t >= bounds.stop:
            break
        if t >= part.end:
            part = segment(drive, t)
        struck = clock[DUE] == 1.0
        if struck:
            impact(chain, drive, part, pegs, pull, course, desk, nothing)
            had = math.nan
        end = min(part.end, bounds.stop)
        wanted = min(clock[STEP], bounds.step)
        h = fitted(wanted, end - t)
        h, wanted, least, touch, rounds, surplus, has, good = choose(
            chain, drive, part, pegs, pull, bounds, course, desk, nothing, h, wanted, struck, had
        )
        if not (abs(surplus) < np.inf):
            if kept.mode.any() or kept.bent.any():  # begin anew, from nothing
                forget(kept)
                continue
            return status.NOT_FINITE
        if not good:
            clock[FORCED] += 1.0
        clock[APPEARED] += surplus
        if clock[INDEX] < t_out.size:
            account = desk.account
            had = has - surplus + account[FRICTION] + account[CONTACT] - account[WORK]
            write(chain, drive, part, pegs, pull, bounds, course, desk, aside, h, had, t_out, y_out, seen_out)
        had = has
        commit(course, desk, h, rounds, least)
        clock[DUE] = 1.0 if touch <= 1.001 * h else 0.0
        clock[T] = end if h >= end - t else t + h
        clock[STEP] = wanted * GROWTH if abs(surplus) < EASY * allowance(bounds, h) else wanted
        if least > bounds.clear and desk.bend[1] > bounds.slack and clock[T] < bounds.stop:
            return status.LEFT
    return status.RUNNING if clock[T] < bounds.stop else status.OK


@kernel
def clearance(chain, drive, pegs, t, y):  # type: ignore[no-untyped-def]
    """What is left at time t until rope and pegs, or joints and their limits, meet; y as in ``Course``.

    Returns
    -------
    gap, speed : float, smallest gap between rope and pegs, m, and the greatest speed of a joint, m/s
    left : float, rad, as ``joints.room_to_bend`` gives it
    """
    n = chain.length.size
    base, trig = np.empty(9), np.empty(2 * n)
    base_state(drive, segment(drive, t), t, base)
    xy, speed, found = np.empty((2, n + 1)), np.empty((2, n + 1)), new_contacts(n * pegs.x.size)
    sines(y[:n], trig, 0)
    joints(chain, trig, base[7], base[8], xy)
    speeds(chain, trig, y[n : 2 * n], base[5], base[6], speed)
    fastest = 0.0
    for i in range(n + 1):
        fastest = max(fastest, math.hypot(speed[0, i], speed[1, i]))
    _, left = room_to_bend(chain, y[:n], y[n : 2 * n], base[4], base[3])
    return find(chain, pegs, y[:n], trig, xy, np.zeros(n), found), fastest, left
