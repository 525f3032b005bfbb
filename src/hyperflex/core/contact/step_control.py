"""Step-size control with contact: a step is tried, and shorter ones, until its energy, depth and errors will do."""

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core.chain.torque_peaks import watch_torque
from hyperflex.core.contact.account import CONTACT, FRICTION, WORK, energy
from hyperflex.core.contact.bounds import (
    BEND,
    DEEPEST,
    ENERGY_GAIN,
    FORCED,
    GIVEN,
    IMPACT_DUE,
    IMPACTS,
    LOST,
    MOMENT,
    REJECTED,
    SPENT,
    STEP,
    TAKEN,
    UNSOLVED,
    T,
    energy_allowance,
    energy_balanced,
)
from hyperflex.core.contact.joints import BEYOND
from hyperflex.core.contact.modes import USUAL_TOL
from hyperflex.core.contact.step import begin_step, finish_step, try_step
from hyperflex.core.contact.turning_pegs import turning_energy
from hyperflex.core.contact.warm_start import foresight, keeps_modes, save_memory, save_trend
from hyperflex.core.integrate.step_size import allowed, fitted, lasting
from hyperflex.core.jit import absorbed, non_allocating

SHORTEST = 2.0**-10  # of the step, the shortest that is tried
COARSEST = 2.0**5  # times as long it is at most, in proportion to a tolerance above the usual one, where that is safe
BRIEF = 1e-9  # s, the shortest step to an impact
RESOLVED = 0.12  # of the longest step: errors of positions shorten none that is shorter
REJECTED_ERROR = 4.0  # relative error of a step that is tried again at half its length
SAFE = 0.5  # of the smallest reach of a peg that links near one may move in a step
GENEROUS = 100.0  # how many times more energy than may appear contacts may give a rope that they push out
DEEPER = 5e-5  # m, penetration at which a step is tried again at half its length
GROWTH = 1.5
EASY = 0.2  # relative error of a step, below which steps grow
SINKING = 1.02  # times the greatest depth until then, which a step may have: what sinks slowly sinks at any step


class Chosen(NamedTuple):
    """The step that :func:`choose_step` left in a workspace."""

    h: float  # s
    wanted: float  # s; h is shorter where touchdown or an end cut it, or where equal steps lead to an end
    least: float  # m, smallest gap
    touch: float  # s, until a link touches
    rounds: int  # of the search; negative if it failed
    surplus: float  # J, energy from nowhere
    had: float  # J, energy before it
    has: float  # J, and after it
    good: bool  # False where the shortest step had to be taken as it was
    error: float  # of positions, relative to what is allowed
    push: bool  # whether contacts might push the rope out
    struck: bool  # whether an impact was made at the instant at which it begins


@absorbed
def accept_step(drive, state, workspace, h, rounds, least):  # type: ignore[no-untyped-def]
    """Accept the step to ``workspace.out``."""
    load, angle = workspace.motion.load, workspace.base[1, 4]
    about_shaft = load[2] + drive.arm_length * (math.cos(angle) * load[0] + math.sin(angle) * load[1])
    watch_torque(state.torque, about_shaft, state.clock[T], h)
    y, clock, account = state.y, state.clock, workspace.account
    n = workspace.motion.w.size
    for i in range(2 * n):
        y[i] = workspace.out[i]
    y[2 * n] += account[WORK]
    y[2 * n + 1] += account[FRICTION] + account[CONTACT]
    clock[LOST] += account[CONTACT]
    clock[GIVEN] = max(0.0, clock[GIVEN] - account[CONTACT])
    clock[SPENT] += h
    clock[DEEPEST] = max(clock[DEEPEST], -least)
    clock[BEND] = max(clock[BEND], -workspace.bend[0])
    clock[TAKEN] += 1.0
    if rounds < 0:
        clock[UNSOLVED] += 1.0
    for p in workspace.spin.which:
        state.spin[0, p] += 0.5 * h * (workspace.spin.before[p] + workspace.spin.after[p])
        state.spin[1, p] = workspace.spin.before[p] = workspace.spin.after[p]
    long = h > MOMENT
    save_trend(state.memory, workspace, h if long else 0.0)
    if long:
        save_memory(state.memory, workspace.contacts, workspace.impulses, workspace.joints, h)


@non_allocating
def impact(chain, drive, part, pegs, pull, state, workspace):  # type: ignore[no-untyped-def]
    """Let the links that touch a peg come to rest on it, or bounce, in no time, in the last step's modes if they do.

    Newton's restitution with friction may give energy; where it does, nothing bounces.
    """
    t, y, memory = state.clock[T], state.y, state.memory
    least, rounds = try_step(chain, drive, part, pegs, pull, t, 0.0, y, memory, workspace, True, 1.0, True)
    if pegs.bounce.any() and workspace.account[CONTACT] < 0.0:
        least, rounds = try_step(chain, drive, part, pegs, pull, t, 0.0, y, memory, workspace, True, 0.0, True)
    accept_step(drive, state, workspace, 0.0, rounds, least)
    state.clock[IMPACTS] += 1.0
    state.clock[IMPACT_DUE] = 0.0


@non_allocating
def gives_little(bounds, clock, workspace, h):  # type: ignore[no-untyped-def]
    """Whether contacts give back no more of what they took than may come from nowhere in all the time."""
    given = clock[GIVEN] - workspace.account[CONTACT]
    return given <= bounds.rate * (clock[SPENT] + h) or workspace.account[CONTACT] >= -energy_allowance(bounds, h)


@non_allocating
def longest_safe_step(chain, pegs, workspace):  # type: ignore[no-untyped-def]
    """Longest step, s, in which no link near a peg moves by more than SAFE of the smallest reach."""
    speed = workspace.motion.speed
    fastest = 0.0
    for c in range(workspace.contacts.total[0]):
        i = workspace.contacts.link[c]
        for j in range(i, i + 2):
            fastest = max(fastest, abs(speed[0, j]), abs(speed[1, j]))
    smallest = np.inf
    for p in range(pegs.reach.size):
        smallest = min(smallest, pegs.reach[p])
    return SAFE * smallest / fastest if fastest > 0.0 else np.inf


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


@non_allocating
def choose_step(chain, drive, part, pegs, pull, bounds, state, workspace, nothing, end, struck, had):  # type: ignore[no-untyped-def]
    """Try a step, and shorter ones, until one will do; it is left in `workspace`.

    Parameters
    ----------
    chain, drive, part, pegs, pull, bounds, state, workspace : as for ``run.run`` and :func:`try_step`
    nothing : ContactMemory, empty
    end : s, time that no step goes beyond
    struck : bool, an impact was made already at this instant
    had : J, energy before the step, NaN if it is not known

    Returns
    -------
    Chosen
    """
    y, clock, t, trig = state.y, state.clock, state.clock[T], workspace.ahead_trig
    wanted = min(clock[STEP], bounds.step)
    h = fitted(wanted, end - t)
    coarse = max(1.0, min(bounds.tol / USUAL_TOL, COARSEST))
    finest, shortest = SHORTEST * bounds.step, min(coarse * SHORTEST * bounds.step, h)
    push, anew, back, stale = True, False, False, np.inf
    while True:
        begin = nothing if anew else state.memory
        least, torque = begin_step(chain, drive, part, pegs, pull, t, h, y, begin, workspace, push, 0.0, struck)
        touch = workspace.touch[0]
        if touch == 0.0:
            impact(chain, drive, part, pegs, pull, state, workspace)
            struck, had = True, math.nan
            continue
        if touch < 0.999 * h:
            h = max(touch, BRIEF)
            shortest = min(shortest, h)
            continue
        rounds = finish_step(chain, workspace, torque, h)
        given = energy_allowance(bounds, h)
        if push and workspace.account[CONTACT] < -GENEROUS * given:
            push = False
            continue
        longest = longest_safe_step(chain, pegs, workspace)
        if h > longest:  # a peg may be passed: no tolerance allows that
            shortest = min(finest, shortest)
        error = relative_error(chain, bounds, state.memory, workspace, h)
        if math.isnan(had):
            had = energy(chain, y, workspace.base[0], trig) + turning_energy(workspace.spin, workspace.spin.before)
        has = energy(chain, workspace.out, workspace.base[2], trig)
        has += turning_energy(workspace.spin, workspace.spin.after)
        surplus = has - had + workspace.account[FRICTION] + workspace.account[CONTACT] - workspace.account[WORK]
        good = energy_balanced(surplus, given) and rounds > 0 and h <= longest
        good = good and (least > -DEEPER or -least <= SINKING * clock[DEEPEST])
        good = good and (error <= REJECTED_ERROR or h <= RESOLVED * bounds.step)
        little = gives_little(bounds, clock, workspace, h)
        if push and not little:  # a shorter step would be pushed out with as much power
            push = False
            continue
        good = good and little
        good = good and (workspace.bend[0] > -BEYOND or -workspace.bend[0] <= SINKING * clock[BEND])
        if good or back or (h <= shortest and (surplus <= stale if anew else rounds > 0)):
            return Chosen(h, wanted, least, touch, rounds, surplus, had, has, good, error, push, struck)
        if h <= shortest:  # the last resort: a search from nothing, unless that gives more energy
            anew, back, stale = not anew, anew, surplus
            continue
        h = max(0.5 * h, shortest)
        wanted, push = h, True
        clock[REJECTED] += 1.0


@non_allocating
def complete_step(drive, bounds, state, workspace, chosen, end):  # type: ignore[no-untyped-def]
    """Accept what :func:`choose_step` returned, and set the clock for the next step; none goes beyond `end`, s."""
    clock, h = state.clock, chosen.h
    t = clock[T]
    if not chosen.good:
        clock[FORCED] += 1.0
    clock[ENERGY_GAIN] += chosen.surplus
    accept_step(drive, state, workspace, h, chosen.rounds, chosen.least)
    clock[IMPACT_DUE] = 1.0 if chosen.touch <= 1.001 * h else 0.0
    clock[T] = end if h >= end - t else t + h
    clock[STEP] = max(chosen.wanted * growth(chosen.error), min(chosen.wanted, RESOLVED * bounds.step))
