"""The course of a whip's plan: one swing of the map after the other is aimed, and the best ones are verified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hyperflex.model import divided
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.whip.aim import Aim, aimed
from hyperflex.planning.whip.outcome import Lash, lash
from hyperflex.planning.whip.search import WhipMap, WhipSearch
from hyperflex.planning.whip.tip_target import Mark

TRIED = 8  # peaks of the map that are aimed as they are
READY, GENERATIONS = 0.06, 16  # m, cost from which on a swing is aimed; of a search before it
PLANS = 3  # whips that meet the target, of which the least uncertain one that stands is taken
MEETS = 1e-3  # m, from the target
# m. Finer links are another model of the same rope, and no plan can meet both within MEETS. What they move the peak by
# counts where it is more than a few times that, and more than what the plan says of its own doubt (one sd).
FINER_MEETS = 3.0 * MEETS
FINER = 2  # pieces of each link in the second verification


class Verified(NamedTuple):
    """A whip with what the tip does in simulated runs with the links as planned, and half as long; why it fails."""

    aim: Aim
    lash: Lash | None
    finer: Lash | None
    reason: str


class WhipCourse:
    """From one swing of the map after the other, until enough of them meet the target or patience ends.

    Parameters
    ----------
    known : WhipMap
    mark : Mark
    patience : float
        s, what compiling kernels takes aside.
    seed : int
    threads : int, optional
    """

    def __init__(self, known: WhipMap, mark: Mark, patience: float, seed: int, threads: int | None) -> None:
        self.known, self.mark, self.patience, self.seed, self.threads = known, mark, patience, seed, threads
        self.finer = replace(known.thrower, rope=divided(known.thrower.rope, FINER))
        self.clock, self.runs = Clock(), 0
        self.aims: list[Aim] = []

    def go(self, report: Callable[[float], None] | None) -> None:
        """Aim until there are enough whips, or no time is left."""
        nearest = self.known.nearest(self.mark)
        for found in nearest[:TRIED]:
            if self.add(aimed(self.known.thrower, self.mark, found), report):
                return
        for number, found in enumerate(nearest):
            search = WhipSearch(self.known.thrower, self.mark, found, self.seed + number, self.threads)
            for _ in range(GENERATIONS):
                if search.found.cost < READY or self.clock.spent > self.patience:
                    break
                search.step()
            self.runs += search.runs
            if self.add(aimed(self.known.thrower, self.mark, search.found), report):
                return

    def add(self, aim: Aim | None, report: Callable[[float], None] | None) -> bool:
        """Keep a whip; tells whether there are enough, or no time is left."""
        if aim is not None:
            self.aims.append(aim)
            self.aims.sort(key=self.rank)
        if report is not None:
            report(min(self.clock.spent, self.patience))
        return self.clock.spent > self.patience or sum(self.rank(one)[0] == 0.0 for one in self.aims) >= PLANS

    def rank(self, aim: Aim) -> tuple[float, float]:
        """The less, the better: by how much a whip fails, then how uncertain it is."""
        miss = float(np.hypot(*(aim.place - self.mark.point)))
        beyond = max(0.0, abs(float(self.mark.off(aim.velocity))) - self.mark.within)
        slow = max(0.0, 1.0 - aim.speed / self.mark.speed)
        return max(0.0, miss - MEETS) + beyond + slow, aim.doubt

    def verified(self) -> tuple[Verified | None, bool]:
        """Verify the best whip, and while none stands those after it that meet the target as the search sees it.

        Returns
        -------
        best : Verified or None
            The first that stands; if none does, the first. None where no whip was found.
        interrupted : bool
            Ctrl-C came.
        """
        best = Verified(self.aims[0], None, None, "interrupted before it was verified") if self.aims else None
        try:
            for number, aim in enumerate(self.aims[:PLANS]):
                if number and self.rank(aim)[0] > 0.0:
                    break
                seen = verify(self.known.thrower, self.finer, self.mark, aim)
                if number == 0 or not seen.reason:
                    best = seen
                if not seen.reason:
                    break
        except KeyboardInterrupt:
            return best, True
        return best, False


def verify(thrower: Thrower, finer: Thrower, mark: Mark, aim: Aim) -> Verified:
    """Simulate a whip as exactly as the library can, and with the links of a finer thrower."""
    motion = aim.strokes.motion(thrower.limits)
    seen, again = (lash(each, mark, motion, aim.t) for each in (thrower, finer))
    return Verified(aim, seen, again, why_not(thrower, seen, again, aim.doubt))


def why_not(thrower: Thrower, seen: Lash | None, finer: Lash | None, doubt: float) -> str:
    """Say why a whip fails, "" if it does not; `doubt` is its peak's standard deviation, m."""
    if seen is None:
        return "in the verified run the tip's speed has no peak there"
    if seen.reason:
        return seen.reason
    if seen.miss > MEETS:
        return f"the tip misses the target by {1e3 * seen.miss:.1f} mm"
    if seen.torque > thrower.limits.torque:
        return f"it asks {seen.torque:.3g} N m of a motor that gives {thrower.limits.torque:.3g}"
    if finer is None:
        return "with links of half the length the tip's speed has no peak there"
    allowed = max(FINER_MEETS, doubt)
    if finer.miss > allowed:
        return f"with links of half the length it misses by {1e3 * finer.miss:.1f} mm, {1e3 * allowed:.1f} allowed"
    return ""
