"""Feasibility of a cast before any search: necessary conditions, changes that would meet them, the nearest target.

A rope that swings as far as the target lets it is modelled as a rigid rod, its tail beyond the target as another rod. A
wound rope runs straight to the target, round it, and hangs from it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Peg, Rope, gap_of, named, obstacle_gaps
from hyperflex.planning.moves import PUMPING
from hyperflex.planning.problem import Problem


@dataclass(frozen=True)
class SwingCoefficients:
    """Coefficients of the feasibility check.

    They were chosen by hand for the paper's cable: searches of two minutes found plans for all feasible targets of
    ``benchmarks/reach.py``, up to 127 degrees from hanging, and for none higher. ``benchmarks/results`` counts the
    targets that are called infeasible and can be wound.

    Parameters
    ----------
    spare_turns : float
        Turns beyond the required ones that a plan aims at, since the tail still swings.
    hanging : float
        Length of the rope's end that hangs from the target, at least, in radii of the target.
    gain : float
        Angle by which one stroke widens a swing, in units of the arm tip's way aside over the length of the equivalent
        pendulum.
    mean_gain : float
        Mean fraction of the gain that a stroke adds on the way from rest to level: ten strokes bring the paper's cable
        there.
    first_gain, room : float
        Below the target a swing has little room: the last stroke adds this fraction of the gain where the target leaves
        no room at all, and all of it from this angle, rad, on.
    outward, widest : (float, float)
        Greatest angle of a swing, rad, for two lengths of the equivalent pendulum over the rope's, linear in between: a
        uniform rope, and one with a weight at its end, which jerks it after it was slack.
    energy_ratio : float
        Least energy at the strike over the energy that lifts the tail over the target.
    spare_periods, max_periods : float
        Swing periods that a search allows beyond the pumping, and in all.
    """

    spare_turns: float = 0.05
    hanging: float = 2.0
    gain: float = 2.2
    mean_gain: float = 0.5
    first_gain: float = 0.5
    room: float = 0.05
    outward: tuple[float, float] = (2.0 / 3.0, 0.74)
    widest: tuple[float, float] = (2.3, 1.7)
    energy_ratio: float = 0.2
    spare_periods: float = 2.0
    max_periods: float = 11.0


SWING = SwingCoefficients()
FACTOR = 1.05  # between changes that are tried as remedies
RING, DIRECTIONS = 1.2, 72  # of the search for the nearest feasible target


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
        ``SwingCoefficients.energy_ratio``.
    holding_force : float
        Greatest pull that the wound rope can withstand, N: weight of the hanging end times e^(mu angle of contact).
    impossible : bool
        Whether geometry or the motor's torque rule the target out; then no search is made.
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
        """Return the least relative margin of all requirements, including a force, N; below 0: infeasible."""
        ratios = [self.available_turns / self.needed_turns, self.energy_ratio / SWING.energy_ratio]
        if holding_force > 0.0:
            ratios.append(self.holding_force / holding_force)
        return -1.0 if self.impossible else min(ratios) - 1.0


def check_feasibility(problem: Problem, peg: Peg) -> Feasibility:
    """Check whether a target is feasible by necessary conditions alone.

    Notes
    -----
    Turns are quantised: a wound rope runs straight from the arm to the target, lies on it and hangs from its side, so
    its angle of contact is a whole number of turns plus an angle that the direction of the target fixes. A long end
    hangs nearly below the target's centre, a short one at its side and makes up to a quarter turn less. The swing is
    limited on the target's side by the target itself, on the other side by that and the gain of one stroke.
    """
    target, required = _Target(problem, peg), problem.criteria.holding_force
    energy, holding = target.energy_ratio(problem.time), target.holding_force()
    impossible, message = target.geometry()
    inside = [each for each in (*problem.criteria.behind, *problem.obstacles) if gap_of(each, peg.point) <= 0.0]
    torque = _start_torque(problem)
    if torque > problem.limits.torque:
        needs = f"the rope that hangs from the arm needs {torque:.3g} N m at the start"
        impossible, message = True, f"the motor is too weak: {needs}"
    elif inside:
        impossible, message = True, f"the target lies in {named(inside[0])}"
    elif message:
        pass
    elif blocked := _blocked(problem, peg):
        message = f"out of reach: {blocked}"
    elif energy < SWING.energy_ratio:
        slow = _gain(problem) < 0.5 * _gain(problem, fast=True)
        late = target.energy_ratio(math.inf) >= SWING.energy_ratio
        why = f"{problem.time:.3g} s are too short a time to swing the rope up" if late else "too little energy"
        why = "the motor is too slow to swing the rope up" if slow else why
        wide = math.degrees(target.widest(problem.time))
        high = f"it is higher than the rope swings, {wide:.0f} degrees from hanging"
        ratio = f"{energy:.2f} of what lifts the tail over it at the strike, {SWING.energy_ratio:g} needed"
        message = f"out of reach: {why}: {high if energy < 0.0 else ratio}"
    elif holding < required:
        message = f"out of reach: its holding force is {holding:.3g} N at most, {required:g} N required"
    return Feasibility(target.available_turns, target.needed_turns, energy, holding, impossible, message)


def search_time(problem: Problem, peg: Peg) -> float:
    """Time, s, until the strike that a search allows by default.

    The strokes that swing the rope up from rest to the target and a stroke's gain beyond it, and
    ``SwingCoefficients.spare_periods``; at least the time of the set-up.
    """
    gain = _gain(problem)
    strokes = (_Target(problem, peg).angle + gain) / (SWING.mean_gain * gain)
    periods = min(PUMPING * strokes + SWING.spare_periods, SWING.max_periods)
    return max(problem.time, periods * problem.period)


def longest_time(problem: Problem) -> float:
    """Time, s, until the strike of a rope that swings on through contact, by default; at least that of the set-up."""
    return max(problem.time, SWING.max_periods * problem.period)


class _Target:
    """A target as the rope finds it from the shaft.

    Its `distance`, m, and `angle` from hanging, rad, in [0, pi]; the radius of the rope's `axis` round it and the `way`
    of the rope to it, m; `available_turns` and `needed_turns` of rope beyond its near side.
    """

    def __init__(self, problem: Problem, peg: Peg) -> None:
        self.problem, self.peg, self.rope = problem, peg, problem.rope
        (gx, gy), (x0, y0) = self.rope.gravity, problem.arm.pivot
        x, y = peg.x - x0, peg.y - y0
        self.distance, self.angle = math.hypot(x, y), math.atan2(abs(x * gy - y * gx), x * gx + y * gy)
        self.axis = peg.radius + self.rope.radius
        way = self.distance
        for each in problem.criteria.behind:
            near = math.hypot(each.x - x0, each.y - y0) + math.hypot(peg.x - each.x, peg.y - each.y)
            way = max(way, near - 2.0 * (each.radius + self.rope.radius))
        self.way, turn = way, 2.0 * math.pi
        self.available_turns = (self.rope.total_length - way + self.axis) / (turn * self.axis)
        touching = math.acos(min(1.0, self.axis / way)) if way > 0.0 else 0.0
        # Least angle of contact of a taut rope that is struck from below and hangs from the side, in (-pi, pi]
        self.contact = 0.5 * math.pi - self.angle - touching if way > 0.0 else 0.0
        # Rope beyond the target's near side that is not on it, in radii
        self.straight = (math.sqrt(max(way**2 - self.axis**2, 0.0)) - way + self.axis) / self.axis
        # Least room of a rope that makes the required turns, covers the required angle, and hangs, in turns
        angle, rooms = self.contact, list[float]()
        while len(rooms) < 2:  # a turn more may need less rope: its end may be shorter
            end = turn * (problem.criteria.turns + SWING.spare_turns) - touching - angle if way > 0.0 else 0.0
            if angle > 0.0 and angle >= problem.criteria.contact and end < 0.5 * math.pi:
                rooms.append((self.straight + angle + max(SWING.hanging, math.tan(max(end, 0.0)))) / turn)
            angle += turn
        self.needed_turns = min(rooms)

    def geometry(self) -> tuple[bool, str]:
        """Return whether distance and length rule the target out, and why it is infeasible; empty if it is not."""
        turns, behind = self.problem.criteria.turns, self.problem.criteria.behind
        arm, length = self.problem.arm, self.rope.total_length
        short = self.way - self.axis - length - arm.length
        if short > 0.0:
            return True, f"out of reach: the rope ends {short:.2f} m short of the target"
        if self.distance - self.axis <= arm.length:
            return True, "inside the arm's circle: the arm would strike the target"
        near = self.way - arm.length  # the arm points to the target, and all that remains of the rope lies on it
        straight = math.sqrt(near**2 - self.axis**2)
        most = (math.acos(self.axis / near) + (length - straight) / self.axis) / (2.0 * math.pi)
        if most < turns and not behind:  # round a peg it comes to the target from another side
            reason = f"with all of the rope round the target it makes {most:.2f} turns, {turns:g} required"
            return True, f"out of reach: {reason}"
        if self.available_turns < self.needed_turns:
            left = f"rope for {max(self.available_turns, 0.0):.2f} turns remains beyond the target"
            wound = f" to wind {turns:g}" if turns != 1.25 else ""
            return False, f"out of reach: {left}, {self.needed_turns:.2f} needed{wound}"
        return False, ""

    def widest(self, time: float) -> float:
        """Angle to which the rope swings in a time, s, for rods, rad."""
        gain, near = _gain(self.problem), self.angle - math.asin(min(1.0, self.axis / self.distance))
        last = gain * float(np.interp(near, (0.0, SWING.room), (SWING.first_gain, 1.0)))
        most = float(np.interp(_pendulum(self.problem) / self.rope.total_length, SWING.outward, SWING.widest))
        return min(near + last, gain * time / (0.5 * self.problem.period), most)

    def energy_ratio(self, time: float) -> float:
        """Energy ratio of the tail at a strike within a time, s, for rods; below 0 if the swing does not get there."""
        rope, far = self.rope, self.distance
        if not 0.0 < far < rope.total_length:
            return 0.0
        wide = self.widest(time)
        mass = np.append(rope.mass, rope.tip_mass)
        along = np.append(rope.link_ends - rope.length + rope.com, rope.total_length)
        tail = np.where(along > far, mass, 0.0)
        share = (tail * along**2).sum() / (mass * along**2).sum()
        drop = (mass * along).sum() * (math.cos(self.angle) - math.cos(wide))
        lift = (tail * (along - far)).sum() * (1.0 + math.cos(self.angle))
        return float(share * drop / max(lift, 1e-12))

    def holding_force(self) -> float:
        """Greatest pull that a wound rope withstands, N, of all the turns that it has room for (capstan equation)."""
        rope, contact, best = self.rope, self.contact, 0.0
        # Mass beyond each joint over the length of rope there, from the tip on
        beyond = np.cumsum(np.append(0.0, rope.length[::-1])), np.cumsum(np.append(rope.tip_mass, rope.mass[::-1]))
        hanging = self.axis * (2.0 * math.pi * self.available_turns - self.straight - contact)
        while hanging > 0.0:
            if contact > 0.0:
                weight = float(np.interp(hanging, *beyond)) * rope.g
                best = max(best, weight * math.exp(min(self.peg.mu * contact, 700.0)))
            contact += 2.0 * math.pi
            hanging -= 2.0 * math.pi * self.axis
        return best


def _blocked(problem: Problem, peg: Peg) -> str:
    """Return which obstacle leaves a wound rope no room, and where; "" if there is room.

    The rope goes round the target, and straight to one of its sides from the arm's tip at one of 73 angles, unless it
    is to run behind pegs.
    """
    obstacles, rope, arm = (*problem.criteria.behind, *problem.obstacles), problem.rope, problem.arm
    if not obstacles:
        return ""
    centre = peg.point[None]
    room = obstacle_gaps(obstacles, centre, centre)[:, 0] - peg.radius
    clearance = np.where(np.arange(len(obstacles)) < len(problem.criteria.behind), 0.0, max(problem.clearance, 0.0))
    nearest = int((room - clearance).argmin())
    needed = 2.0 * rope.radius + clearance[nearest]
    if room[nearest] < needed:
        gap = f"is {1e3 * max(room[nearest], 0.0):.3g} mm from the target"
        return f"{named(obstacles[nearest])} {gap}, the rope needs {1e3 * needed:.3g}"
    if problem.criteria.behind:
        return ""
    tips = arm.tip(np.linspace(*problem.limits.angles, 73))
    ways = centre - tips
    aside = (peg.radius + rope.radius) * np.stack([-ways[:, 1], ways[:, 0]], axis=-1) / np.hypot(*ways.T)[:, None]
    ends = np.concatenate([centre + side * aside for side in (-1.0, 0.0, 1.0)])
    gaps = obstacle_gaps(obstacles, np.tile(tips, (3, 1)), ends) - rope.radius
    if gaps.min(axis=0).max() > 0.0:
        return ""
    return f"{named(obstacles[int((gaps <= 0.0).sum(axis=1).argmax())])} is between the arm and the target"


def _start_torque(problem: Problem) -> float:
    """Torque that holds the hanging rope before the cast, N m: the lesser of the two sides."""
    gx, gy = problem.rope.gravity
    starts = [problem.limits.start_angle(side) for side in (-1, 1)]
    lever = min(abs(math.cos(angle) * gx + math.sin(angle) * gy) for angle in starts)
    return float(problem.rope.total_mass * problem.arm.length * lever)


def _gain(problem: Problem, *, fast: bool = False) -> float:
    """Angle by which one stroke widens a swing, rad; `fast`: with a motor without limits of speed."""
    least, greatest = problem.limits.angles
    stroke = min(math.pi, greatest - least)
    aside = np.ptp(np.sin(np.linspace(least, greatest, 721) - problem.rope.hanging_angle))
    gain = SWING.gain * problem.arm.length * float(aside) / _pendulum(problem)
    time = float(problem.limits.fastest_moves([stroke])[0][0])
    return gain if fast else gain * min(1.0, 0.5 * problem.period / time)


def _pendulum(problem: Problem) -> float:
    """Length of the pendulum with the period of the rope's small swing, m."""
    return problem.rope.g * (problem.period / (2.0 * math.pi)) ** 2


def find_remedies(problem: Problem, peg: Peg) -> tuple[str, ...]:
    """Return changes, as text, that would each make a target feasible; none if it is feasible.

    By a factor of three at most, of the motor by one of 100, which is then fast enough for a stroke in half a period; a
    longer time is that of a search. With less, what is feasible is seldom found. Factors are found to 1 %.
    """
    rope, arm, limits, criteria = problem.rope, problem.arm, problem.limits, problem.criteria

    def faster(speed: float, acceleration: float = 1.0) -> tuple[Problem, Peg]:
        changed = replace(limits, speed=speed * limits.speed, acceleration=acceleration * limits.acceleration)
        return replace(problem, limits=changed), peg

    def longer(f: float) -> Rope:
        return rope.replace(length=f * rope.length, mass=f * rope.mass, com=f * rope.com, inertia=f**3 * rope.inertia)

    def remedy(
        text: Callable[[Problem, Peg], str], changed: Callable[[float], tuple[Problem, Peg]], most: float = 3.0
    ) -> list[str]:
        """Return the text of a change by the least feasible factor from 1 up: in steps of FACTOR, then bisection."""

        def feasible(factor: float) -> bool:
            try:
                of, to = changed(factor)
                usual = of.limits == limits or _gain(of) == _gain(of, fast=True)
                usual = usual and (of.time == problem.time or of.time >= search_time(of, to))
                return usual and check_feasibility(of, to).feasible
            except InvalidInput:  # no such set-up: a longer arm hits an obstacle, for example
                return False

        tried = np.geomspace(1.0, most, math.ceil(math.log(most, FACTOR)) + 1).tolist()
        high = next((factor for factor in tried if feasible(factor)), 1.0)
        if high == 1.0:
            return []
        return [text(*changed(_least(feasible, high / FACTOR, high, 0.01)))]

    def speed(of: Problem, _: Peg) -> str:
        return f"a motor of {_rounded(of.limits.speed)} rad/s"

    def acceleration(of: Problem, _: Peg) -> str:
        return f"{_rounded(of.limits.acceleration)} rad/s^2"

    found = remedy(speed, faster, 100.0)
    found += remedy(lambda *to: f"a motor of {acceleration(*to)}", lambda f: faster(1.0, f), 100.0)
    if not found:  # one limit alone is enough
        found = remedy(lambda *to: f"{speed(*to)} and {acceleration(*to)}", lambda f: faster(f, f**2), 100.0)
    least, greatest = min(limits.angles[0], -0.5 * math.pi), max(limits.angles[1], 0.5 * math.pi)
    freer = replace(problem, limits=replace(limits, angles=(least, greatest)))
    if not check_feasibility(problem, peg).feasible and check_feasibility(freer, peg).feasible:
        found.append(f"a motor that turns from {least:.3g} to {greatest:.3g} rad")
    found += remedy(
        lambda of, _: f"an arm of {_rounded(1e3 * of.arm.length)} mm",
        lambda f: (replace(problem, arm=replace(arm, length=f * arm.length)), peg),
    )
    found += remedy(
        lambda of, _: f"a rope of {_rounded(of.rope.total_length)} m",
        lambda f: (replace(problem, rope=longer(f)), peg),
    )
    found += remedy(
        lambda of, _: f"{_rounded(of.time)} s to strike",
        lambda f: (replace(problem, time=f * problem.time), peg),
        max(3.0, 1.01 * SWING.max_periods * problem.period / problem.time),
    )
    found += remedy(
        lambda _, to: f"a peg of {_rounded(1e3 * to.radius, up=False)} mm radius",
        lambda f: (problem, replace(peg, radius=peg.radius / f)),
    )
    found += remedy(
        lambda of, _: f"{_rounded(of.criteria.turns, up=False)} turns",
        lambda f: (replace(problem, criteria=replace(criteria, turns=criteria.turns / f)), peg),
    )
    return tuple(found)


def _least(feasible: Callable[[float], bool], low: float, high: float, within: float) -> float:
    """Return the least feasible number by bisection, from one that is not feasible and one that is."""
    while high - low > within:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return high


def _rounded(value: float, *, up: bool = True) -> str:
    """Write a value with three digits, rounded to the side on which it is enough."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    digits = math.ceil(value / unit - 1e-9) if up else math.floor(value / unit + 1e-9)
    return f"{digits * unit:.3g}"


def nearest_feasible(problem: Problem, peg: Peg, *, margin: float = 0.0) -> Peg | None:
    """Find the nearest place at which a peg passes the feasibility check; None if there is none.

    `margin` is the least :meth:`Feasibility.margin`.

    Notes
    -----
    Rings about the target, each wider by RING, are tried in DIRECTIONS until some place on one is feasible; then
    bisection on the rays of these places. Places are rounded to a thousandth of the rope's length or less.
    """
    unit = 10.0 ** math.floor(math.log10(1e-3 * problem.rope.total_length))
    farthest = math.dist(peg.point, problem.arm.pivot) + problem.rope.total_length + problem.arm.length

    def at(distance: float, angle: float) -> Peg:
        x, y = peg.x + distance * math.sin(angle), peg.y + distance * math.cos(angle)
        return moved(peg, np.array([unit * round(x / unit), unit * round(y / unit)]))

    def feasible(angle: float, distance: float) -> bool:
        there = at(distance, angle)
        if _Target(problem, there).geometry()[1]:  # most places, at little cost
            return False
        known = check_feasibility(problem, there)
        return known.feasible and known.margin(problem.criteria.holding_force) >= margin

    inner, found = 0.0, list[tuple[float, float]]()
    while not found and inner < farthest:
        outer = max(unit, RING * inner)
        for angle in np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False).tolist():
            if feasible(angle, outer):
                found.append((_least(partial(feasible, angle), inner, outer, 0.5 * unit), angle))
        inner = outer
    return at(*min(found)) if found else None


def moved(peg: Peg, place: Array) -> Peg:
    """Return the same peg at a `place` (2,), m, rounded to a nanometre."""
    return replace(peg, x=round(float(place[0]), 9) + 0.0, y=round(float(place[1]), 9) + 0.0)
