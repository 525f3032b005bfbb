"""Feasibility check of a target before any search: length of rope left, energy at the strike, and holding force.

A rope that swings as far as the target lets it is taken as a rigid rod, and its tail beyond the target as another; a
wound rope as one that runs straight to the target, round it and down. MARGIN, HANGING, GAIN, WIDEST and MIN_ENERGY were
chosen by hand: searches of two minutes of one processor found plans that succeed for all feasible targets of
``benchmarks/reach.py``, up to 127 degrees from hanging, and for none higher; for 4 of 16 with too little
energy, all of them more than 15 degrees aside, and for 2 of 16 with too little rope. With 20 g at the tip of the same
rope they found some for two of nine between 92 and 108 degrees: its swings beyond level differ from those of shorter
links, or gain less. ``benchmarks/results`` has the counts, and the part of the targets that a search winds though they
are called infeasible.
"""

import math
from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.model import Peg
from hyperflex.planning.clearance import holds, named, obstacle_gaps
from hyperflex.planning.problem import Problem
from hyperflex.planning.routing import refuse_behind
from hyperflex.planning.throw import KEEPING_STEP

MARGIN = 0.05  # turns beyond those asked that a plan aims at, since the tail still swings
HANGING = 2.0  # radii of the target that the rope's end hangs from it, at least
GAIN = 2.2  # by which one stroke widens a swing, in units of the arm tip's way over the length of an equal pendulum
GROWN = 0.5  # part of it that a stroke adds on average from rest to level: ten strokes bring the paper's cable there
# Part of it that the first stroke of a rope at rest adds. It counts where the target is below and leaves the rope less
# than so many rad to swing beside it: of 15 such targets 2 were wound in a minute or less, of 18 others beside it all
FROM_REST, SWINGING_ROOM = 0.5, 0.05
SPARE, MOST_TIME = 2.0, 11.0  # periods beyond the pumping, and periods at most, that a search allows until the strike
# How far out a rope's weight is (length of an equal pendulum over its own: 2/3 of a uniform rope, 1 of a bob), and to
# which angle it can be swung then, rad. Beyond level it goes slack: a weight at its end jerks it when it is taut again
OUTWARD, WIDEST = (2.0 / 3.0, 0.74), (2.3, 1.7)
MIN_ENERGY = 0.2  # energy ratio at the strike
ARM_ANGLES = 73  # angles of the arm from which a straight way to the target is looked for


@dataclass(frozen=True)
class Feasibility:
    """Result of the feasibility check of a target.

    Attributes
    ----------
    available_turns : float
        Length of the rope beyond the target, in turns about it.
    needed_turns : float
        The same length for a wound rope and its hanging end; `available_turns` must be more.
    energy_ratio : float
        Energy of the tail at the strike, over the energy that lifts its centre of mass over the target; at least
        MIN_ENERGY.
    holding_force : float
        Greatest pull that the wound rope can withstand, N: weight of the hanging end times e^(mu angle of contact).
    impossible : bool
        Whether geometry or the motor's torque rule the target out; then a search is never made.
    message : str
        Why the target is not feasible; empty if it is.
    """

    available_turns: float
    needed_turns: float
    energy_ratio: float
    holding_force: float
    impossible: bool
    message: str

    @property
    def feasible(self) -> bool:
        """Whether the target is feasible."""
        return not self.message

    def margin(self, holding_force: float = 0.0) -> float:
        """Return the least relative margin of all requirements, those of a force, N, included; below 0: infeasible."""
        parts = [self.available_turns / self.needed_turns, self.energy_ratio / MIN_ENERGY]
        if holding_force > 0.0:
            parts.append(self.holding_force / holding_force)
        return -1.0 if self.impossible else min(parts) - 1.0


def check_feasibility(problem: Problem, peg: Peg, *, holding_force: float = 0.0) -> Feasibility:
    """Check whether a target is feasible; `holding_force` is the pull that the wound rope must withstand, N.

    Notes
    -----
    Turns are quantised: a wound rope runs straight from the arm to the target, lies on it and hangs from its side, so
    its angle of contact is a whole number of turns and what the direction of the target fixes. A long end hangs nearly
    below the target's centre, a short one beside it and makes up to a quarter turn less. The swing is limited on the
    target's side by the target itself, on the other side by that and what one stroke adds.
    """
    asked = checks.number("holding_force", holding_force, sign="nonnegative", unit="N")
    if asked > 0.0:
        refuse_behind(problem.behind, "a holding force")
    rope = problem.rope
    far, aside, axis, way, room, needed = _distances(problem, peg)
    energy = _energy(problem, far, aside, axis) if 0.0 < far < rope.total_length else 0.0
    holding = _hold(problem, peg, room, _contact(way, aside, axis), _straight(way, axis))
    impossible, message = _geometry(problem, far, way, axis, room, needed)
    if inside := [each for each in (*problem.behind, *problem.obstacles) if holds(each, peg.x, peg.y)]:
        impossible, message = True, f"the target lies in {named(inside[0])}"
    elif not message and (blocked := _blocked(problem, peg)):
        message = f"out of reach: {blocked}"
    if (torque := _start_torque(problem)) > problem.limits.torque:
        impossible = True
        message = f"the motor is too weak: the rope that hangs from the arm asks {torque:.3g} N m of it at the start"
    if not message and energy < MIN_ENERGY:
        slow = _gain(problem) < 0.5 * _gain(problem, fast=True)
        why = "the motor is too slow to swing the rope up" if slow else "too little energy"
        high = f"it is higher than the rope swings, {math.degrees(_widest(problem)):.0f} degrees from hanging"
        ratio = f"at the strike {energy:.2f} of what lifts the tail over it, {MIN_ENERGY:g} needed"
        message = f"out of reach: {why}: {high if energy < 0.0 else ratio}"
    if not message and holding < asked:
        message = f"out of reach: its holding force is {holding:.3g} N at most, {asked:g} N asked"
    return Feasibility(room, needed, energy, holding, impossible, message)


def geometry_allows(problem: Problem, peg: Peg) -> bool:
    """Return whether distance and length of rope do not rule a target out, as :func:`check_feasibility` begins."""
    far, _, axis, way, room, needed = _distances(problem, peg)
    return not _geometry(problem, far, way, axis, room, needed)[1]


def _distances(problem: Problem, peg: Peg) -> tuple[float, float, float, float, float, float]:
    """Distance of a target, m, angle from hanging, rad, radius of the rope's axis on it and way to it, m.

    And turns for which there is rope beyond its near side, and that are needed.
    """
    far, aside = _place(problem, peg)
    axis, way = peg.radius + problem.rope.radius, _way(problem, peg, far)
    room = (problem.rope.total_length - way + axis) / (2.0 * math.pi * axis)
    return far, aside, axis, way, room, _needed(problem, way, aside, axis)


def _geometry(problem: Problem, far: float, way: float, axis: float, room: float, needed: float) -> tuple[bool, str]:
    """Return whether geometry alone rules the target out, and a message; empty if nothing is wrong."""
    short = way - axis - problem.rope.total_length - problem.arm.length
    if short > 0.0:
        return True, f"out of reach: the rope ends {short:.2f} m short of the target"
    if far - axis <= problem.arm.length:
        return True, "inside the arm's circle: the arm would strike the target"
    most = _most(problem, way, axis)
    if most < problem.turns and not problem.behind:  # round a peg it comes to the target from another side
        reason = f"with all of the rope round the target it makes {most:.2f} turns, {problem.turns:g} asked"
        return True, f"out of reach: {reason}"
    if room < needed:
        left = f"rope for {max(room, 0.0):.2f} turns is left beyond the target"
        wound = f" to wind {problem.turns:g}" if problem.more_turns else ""
        return False, f"out of reach: {left}, {needed:.2f} needed{wound}"
    return False, ""


def _blocked(problem: Problem, peg: Peg) -> str:
    """Return which obstacle leaves a wound rope no room, and where, in words; "" if there is room.

    It goes round the target, and straight to one of its sides from where the arm may stand, unless behind pegs.
    """
    obstacles, rope, arm = (*problem.behind, *problem.obstacles), problem.rope, problem.arm
    if not obstacles:
        return ""
    centre: Array = np.array([[peg.x, peg.y]])
    room = obstacle_gaps(obstacles, centre, centre)[:, 0] - peg.radius
    free = np.where(np.arange(len(obstacles)) < len(problem.behind), 0.0, max(problem.clearance, 0.0))
    beside = int((room - free).argmin())
    needed = 2.0 * rope.radius + free[beside]
    if room[beside] < needed:
        left = f"leaves {1e3 * max(room[beside], 0.0):.3g} mm beside the target"
        return f"{named(obstacles[beside])} {left}, the rope takes {1e3 * needed:.3g}"
    if problem.behind:  # its way is not straight
        return ""
    tips = arm.tip(np.linspace(*problem.limits.angles, ARM_ANGLES))
    ways = centre - tips
    aside = (peg.radius + rope.radius) * np.stack([-ways[:, 1], ways[:, 0]], axis=-1) / np.hypot(*ways.T)[:, None]
    ends = np.concatenate([centre + side * aside for side in (-1.0, 0.0, 1.0)])
    gaps = obstacle_gaps(obstacles, np.tile(tips, (3, 1)), ends) - rope.radius
    if gaps.min(axis=0).max() > 0.0:
        return ""
    return f"{named(obstacles[int((gaps <= 0.0).sum(axis=1).argmax())])} stands between the arm and the target"


def _start_torque(problem: Problem) -> float:
    """Torque that holds the hanging rope before the cast, N m: the lesser of the two sides."""
    rope = problem.rope
    gx, gy = rope.gravity
    starts = [problem.limits.start_angle(side) for side in (-1, 1)]
    lever = problem.arm.length * min(abs(math.cos(angle) * gx + math.sin(angle) * gy) for angle in starts)
    return float(rope.total_mass * lever)


def _most(problem: Problem, far: float, axis: float) -> float:
    """Turns that no rope of this length can exceed: the arm points to the target, all that is left lies on it."""
    near = far - problem.arm.length
    straight = math.sqrt(near**2 - axis**2)
    return (math.acos(axis / near) + (problem.rope.total_length - straight) / axis) / (2.0 * math.pi)


def _contact(far: float, aside: float, axis: float) -> float:
    """Least angle of contact of a taut rope that is struck from below and hangs from the side, rad; in (-pi, pi]."""
    return 0.5 * math.pi - aside - math.acos(min(1.0, axis / far)) if far > 0.0 else 0.0


def _straight(far: float, axis: float) -> float:
    """Rope that is not beyond the target and not on it, beyond the target's near side, in radii."""
    return (math.sqrt(max(far**2 - axis**2, 0.0)) - far + axis) / axis


def _needed(problem: Problem, far: float, aside: float, axis: float) -> float:
    """Least room of a rope that makes the turns asked and MARGIN turns, covers what is asked, and hangs, in turns."""
    turns, contact = problem.turns + MARGIN, problem.contact
    angle = _contact(far, aside, axis)
    rooms: list[float] = []
    while len(rooms) < 2:
        end = 2.0 * math.pi * turns - math.acos(min(1.0, axis / far)) - angle if far > 0.0 else 0.0
        if angle > 0.0 and angle >= contact and end < 0.5 * math.pi:  # else even a long end makes too few turns
            hanging = max(HANGING, math.tan(max(end, 0.0)))
            rooms.append((_straight(far, axis) + angle + hanging) / (2.0 * math.pi))
        angle += 2.0 * math.pi
    return min(rooms)


def _gain(problem: Problem, *, fast: bool = False) -> float:
    """Angle by which one stroke widens a swing, rad; `fast`: with a motor without limits."""
    least, greatest = problem.limits.angles
    stroke = min(math.pi, greatest - least)
    gain = GAIN * 2.0 * problem.arm.length * math.sin(0.5 * stroke) / _pendulum(problem)
    time = float(problem.limits.fastest_moves([stroke])[0][0])
    return gain if fast else gain * min(1.0, 0.5 * problem.period / time)


def search_time(problem: Problem, peg: Peg) -> float:
    """Time, s, until the strike that a search allows if nobody says: what strokes take to swing the rope up, and SPARE.

    They swing it from rest to the target and a stroke's gain beyond it. At least the time of the set-up, and MOST_TIME
    periods at most. At three targets 89, 104 and 108 degrees from hanging a beam search found strikes of scores 0.7, 0
    and none in five periods, and of 3.7, 2.8 and 3.4 in seven and a half.
    """
    gain = _gain(problem)
    strokes = (_place(problem, peg)[1] + gain) / (GROWN * gain)
    return max(problem.time, min(KEEPING_STEP * strokes + SPARE, MOST_TIME) * problem.period)


def _place(problem: Problem, peg: Peg) -> tuple[float, float]:
    """Distance of a target from the shaft, m, and its angle from straight down, rad, in [0, pi]."""
    down, (x0, y0) = np.array(problem.rope.gravity), problem.arm.pivot
    x, y = peg.x - x0, peg.y - y0
    return math.hypot(x, y), math.atan2(abs(x * down[1] - y * down[0]), x * down[0] + y * down[1])


def _way(problem: Problem, peg: Peg, far: float) -> float:
    """Least way from the shaft to a target at distance `far`, all in m, by any one of the pegs to run behind."""
    (x0, y0), ways = problem.arm.pivot, [far]
    for each in problem.behind:
        past = math.hypot(each.x - x0, each.y - y0) + math.hypot(peg.x - each.x, peg.y - each.y)
        ways.append(past - 2.0 * (each.radius + problem.rope.radius))
    return max(ways)


def _widest(problem: Problem) -> float:
    """Angle to which the rope can be swung, rad."""
    return float(np.interp(_pendulum(problem) / problem.rope.total_length, OUTWARD, WIDEST))


def _pendulum(problem: Problem) -> float:
    """Length of a pendulum that swings as the rope does, m."""
    return math.hypot(*problem.rope.gravity) * (problem.period / (2.0 * math.pi)) ** 2


def _energy(problem: Problem, far: float, aside: float, axis: float) -> float:
    """Energy ratio of the tail at the strike, for rods; below 0 if the swing does not get there."""
    rope, gain = problem.rope, _gain(problem)
    near = aside - math.asin(min(1.0, axis / far))
    strokes = problem.time / (0.5 * problem.period)
    last = gain * float(np.interp(near, (0.0, SWINGING_ROOM), (FROM_REST, 1.0)))
    wide = min(near + last, gain * strokes, _widest(problem))
    mass = np.append(rope.mass, rope.tip_mass)
    along = np.append(np.cumsum(rope.length) - rope.length + rope.com, rope.total_length)
    tail = np.where(along > far, mass, 0.0)
    share = (tail * along**2).sum() / (mass * along**2).sum()
    drop = (mass * along).sum() * (math.cos(aside) - math.cos(wide))
    lift = (tail * (along - far)).sum() * (1.0 + math.cos(aside))
    return float(share * drop / max(lift, 1e-12))


def _hold(problem: Problem, peg: Peg, room: float, contact: float, straight: float) -> float:
    """Greatest pull that a wound rope withstands, N, of all the turns that it has room for."""
    rope, axis = problem.rope, peg.radius + problem.rope.radius
    weight = math.hypot(*rope.gravity)
    # Mass beyond each joint over the length of rope there, from the tip on
    beyond = np.cumsum(np.append(0.0, rope.length[::-1])), np.cumsum(np.append(rope.tip_mass, rope.mass[::-1]))
    best, hanging = 0.0, axis * (2.0 * math.pi * room - straight - contact)
    while hanging > 0.0:
        if contact > 0.0:
            mass = float(np.interp(hanging, *beyond))
            best = max(best, mass * weight * math.exp(min(peg.mu * contact, 700.0)))
        contact += 2.0 * math.pi
        hanging -= 2.0 * math.pi * axis
    return best
