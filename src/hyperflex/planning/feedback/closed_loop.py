"""A planned throw in closed loop: at each rest the rope is looked at and what is left of the throw planned anew."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.interfaces import Motor, RopeState, StateSource
from hyperflex.model import Peg
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.feedback.belief import Belief
from hyperflex.planning.feedback.matching import Goal, match
from hyperflex.planning.robust import scenarios as flights
from hyperflex.planning.robust.refinement import worth
from hyperflex.planning.robust.uncertainty import Draw, Uncertainty
from hyperflex.planning.search.batch_rollout import Flights
from hyperflex.planning.wind.outcome import WOUND
from hyperflex.planning.wind.throw import SLOWEST, Throw

DRAWN, WORLDS = 48, 4  # worlds that may be the true one, and those that agree best, in which what is left is tried
SHY = 0.15  # s before the expected strike within which the rope is no longer looked at
THINKING = 0.1  # s, that a decision may take: nothing changes sooner after a look
LIKELY = 0.2  # part of the worlds; with fewer wins before the last stroke or move, a throw is given up
BETTER = 0.05  # worth by which another way must beat the planned one
ASTRAY = 0.2  # rad by which the arm may be away from where it should rest; more, and a throw is given up
LATEST = 1  # before the last of the moves that start before the strike, a throw may be given up, and later


@dataclass(frozen=True)
class Look:
    """What was seen and decided at one rest.

    Attributes
    ----------
    move : int
        Which move comes next.
    t : float
        When the rope was looked at, s.
    left : float
        Time until that move, as planned until then, s.
    before, after : float
        Part of the tried worlds in which the throw would win, as planned until then and as decided.
    decided : str
        "kept", "changed" or "aborted".
    seconds : float
        Time that the decision took, s; it may be more than `left`.
    astray : float
        Angle that the motor's encoder shows less that which was asked for, rad; NaN without a motor.
    """

    move: int
    t: float
    left: float
    before: float
    after: float
    decided: str
    seconds: float
    astray: float = float("nan")


@dataclass(frozen=True, eq=False)
class Followed:
    """What a closed loop made of a plan.

    Attributes
    ----------
    throw : Throw
        What was asked of the motor in the end.
    motion : Motion
        The same as a motion.
    looks : tuple of Look
    aborted : bool
        The throw was given up, and the arm went slowly to hanging.
    """

    throw: Throw
    motion: Motion
    looks: tuple[Look, ...]
    aborted: bool


def follow(
    thrower: Thrower,
    peg: Peg,
    throw: Throw,
    source: StateSource,
    *,
    motor: Motor | None = None,
    uncertainty: Uncertainty | None = None,
    thinking: float = THINKING,
    likely: float = LIKELY,
    seed: int = 0,
    threads: int | None = None,
) -> Followed:
    """Follow a planned throw; at each rest before the strike, plan what is left anew from the state that is seen.

    Parameters
    ----------
    thrower : Thrower
    peg : Peg
    throw : Throw
        The plan.
    source : StateSource
        Tells the rope's state; with as many links as the thrower's rope.
    motor : Motor, optional
        Is asked for the plan at t = 0 and for what it is changed to at each look; its angle is read there, and a throw
        is given up if the arm is astray. Without one, `source` alone learns what is asked for.
    uncertainty : Uncertainty, optional
        From which the worlds are drawn that may be the true one; by default realistic.
    thinking : float
        Time that a decision may take, s: moves that are due sooner are made as they were planned.
    likely : float
        Part of the tried worlds that must be won before the last stroke and the last move; else the throw is given up.
    seed : int
    threads : int, optional

    Returns
    -------
    Followed
        The decisions are made from the states seen alone; contact before the last look is not noticed.

    Notes
    -----
    Of many drawn worlds those are tried that agree best with what has been seen (:class:`belief.Belief`). A plan that
    wins in all of them is kept. Else another way on is sought in free flights of the best one, for the state in which
    the plan was to strike (:func:`matching.match`), and taken if it wins more often beside the peg. Simulated
    time stands still while a decision is made: `thinking` is kept by what may change, and :attr:`Look.seconds` says
    what it really took.
    """
    pause = checks.number("thinking", thinking, sign="nonnegative", unit="s")
    known = uncertainty or Uncertainty()
    belief = Belief(thrower, known.draws(DRAWN, thrower, peg, seed=[checks.count("seed", seed, least=0), 1]))
    goal = Goal.of(thrower, peg, throw)
    loop = _Loop(thrower, throw, belief, threads)
    if motor is not None:
        motor.set_motion(loop.motion(), 0.0)
    looks: list[Look] = []
    while goal is not None and loop.move <= loop.throw.count:
        now = loop.rested()
        if now > goal.t + loop.late - SHY:
            break
        begin = time.monotonic()
        left = float(loop.throw.starts(thrower.limits)[loop.move]) - now
        state = source.state(now, loop.motion())
        astray = float("nan") if motor is None else motor.angle(now) - float(loop.motion().angle(now))
        loop.first = loop.move if left >= pause else loop.move + 1
        if abs(astray) > ASTRAY:
            before, after, decided = 0.0, 0.0, loop.give_up(pause)
        else:
            before, after, decided = loop.decide(goal, state, pause, likely)
        looks.append(Look(loop.move, now, left, before, after, decided, time.monotonic() - begin, astray))
        if motor is not None and decided != "kept":
            motor.set_motion(loop.motion(), now)
        if decided == "aborted":
            break
        loop.move += 1
    aborted = bool(looks) and looks[-1].decided == "aborted"
    return Followed(loop.throw, loop.motion(), tuple(looks), aborted)


def swing_down(throw: Throw, made: int, rest: float = 0.0) -> Throw:
    """Return a throw that makes `made` moves and, after a rest, s, takes the arm slowly to hanging."""
    return replace(throw, count=made, end=0.0, rest=rest, speed=SLOWEST)


class _Loop:
    """The throw as it is planned by now, the next move, and the first one that may still be changed."""

    def __init__(self, thrower: Thrower, throw: Throw, belief: Belief, threads: int | None) -> None:
        self.thrower, self.throw, self.belief, self.threads = thrower, throw, belief, threads
        self.move, self.first, self.late = 1, 1, 0.0

    def motion(self) -> Motion:
        """Return what is asked of the motor."""
        return self.throw.motion(self.thrower.limits)

    def rested(self) -> float:
        """When the arm comes to rest before the next move, s."""
        rests = np.append(self.throw.rests[: self.throw.count], self.throw.rest)
        return float(self.throw.starts(self.thrower.limits)[self.move] - abs(rests[self.move]))

    def decide(self, goal: Goal, state: RopeState, pause: float, likely: float) -> tuple[float, float, str]:
        """Decide what is left; returns chances before and after, and the decision in a word."""
        self.belief.see(state, self.motion(), threads=self.threads)
        worlds = self.belief.worlds(WORLDS)
        ways = [self.throw]
        chance, value = self.chances(ways, state, worlds)
        if self.first < self.throw.count and chance[0] < 1.0:
            known = worlds[0].punctual()
            others = match(self.thrower, known, goal, self.throw, self.first, state, pause, threads=self.threads)
            if others:
                first = self.chances(others, state, worlds[:1])[1]
                ways.append(others[int(np.argmax(first))])
                more = self.chances(ways[1:], state, worlds)
                chance, value = np.append(chance, more[0]), np.append(value, more[1])
        best = int(np.argmax(value))
        best = best if value[best] > value[0] + BETTER else 0
        begun = int((self.throw.starts(self.thrower.limits) < goal.t + self.late).sum())
        if chance[best] < likely and self.move >= begun - LATEST and self.first <= self.throw.count:
            return float(chance[0]), float(chance[best]), self.give_up(pause)
        changed = ways[best] is not self.throw
        old = self.throw.starts(self.thrower.limits)[-1]
        self.throw = ways[best]
        self.late += float(self.throw.starts(self.thrower.limits)[-1] - old)
        return float(chance[0]), float(chance[best]), "changed" if changed else "kept"

    def give_up(self, pause: float) -> str:
        """Let the arm go slowly to hanging as soon as it can; returns the decision."""
        self.throw = swing_down(self.throw, min(self.first, self.throw.count), pause)
        return "aborted"

    def chances(self, ways: Sequence[Throw], state: RopeState, worlds: Sequence[Draw]) -> tuple[Array, Array]:
        """Return the part of the worlds in which each way wins, and its mean worth (W,)."""
        pairs = [(way, world) for way in ways for world in worlds]
        motions = [world.motion(way, self.thrower).shifted(-state.t) for way, world in pairs]
        q, qd = (np.broadcast_to(part, (len(pairs), part.size)) for part in (state.q, state.qd))
        ropes, pegs = [world.rope for _, world in pairs], [world.peg for _, world in pairs]
        batch = Flights(ropes, pegs, motions, q, qd, state.t)
        found = flights.ends(batch, self.thrower.arm, self.thrower.time, threads=self.threads)
        shape = (len(ways), len(worlds))
        return (found.turns >= WOUND).reshape(shape).mean(axis=1), worth(found).reshape(shape).mean(axis=1)
