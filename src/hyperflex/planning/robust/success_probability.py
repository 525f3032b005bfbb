"""The probability that a throw winds, from draws of what is not known, with an interval that says how sure it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.model import Peg
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.robust import scenarios as flights
from hyperflex.planning.robust.uncertainty import Draw, Uncertainty
from hyperflex.planning.wind.outcome import WOUND
from hyperflex.planning.wind.throw import Throw

SURE = 1.959963984540054  # standard deviations on either side that hold 95 %
DRAWS = 40
STREAM = 7001  # draws for a stated probability, apart from those that a search has seen


@dataclass(frozen=True)
class Success:
    """How often a throw wins.

    Attributes
    ----------
    wins, draws : int
    """

    wins: int
    draws: int

    def __post_init__(self) -> None:
        checks.count("draws", self.draws)
        if not 0 <= self.wins <= self.draws:
            raise InvalidInput("there are more wins than draws", got=self.wins, allowed=f"0 to {self.draws}")

    @property
    def probability(self) -> float:
        """Wins over draws."""
        return self.wins / self.draws

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the probability (Wilson, 1927)."""
        n, p, z = self.draws, self.probability, SURE
        centre = (p + z**2 / (2.0 * n)) / (1.0 + z**2 / n)
        half = z / (1.0 + z**2 / n) * math.sqrt(p * (1.0 - p) / n + z**2 / (4.0 * n**2))
        low, high = max(0.0, centre - half), min(1.0, centre + half)
        return (0.0 if self.wins == 0 else low), (1.0 if self.wins == n else high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.probability:.0f} % ({100 * low:.0f} to {100 * high:.0f} %, {self.wins} of {self.draws})"


def difference(one: Success, other: Success) -> tuple[float, float]:
    """95 % interval of the difference of two probabilities, `one` less `other`, from draws of their own.

    Notes
    -----
    Newcombe (1998), method 10: at either end, the distances to the ends of both Wilson intervals add up as squares do.
    """
    (low, high), (low_other, high_other) = one.interval, other.interval
    p, q = one.probability, other.probability
    return p - q - math.hypot(p - low, high_other - q), p - q + math.hypot(high - p, q - low_other)


def success(
    thrower: Thrower,
    peg: Peg,
    throw: Throw,
    uncertainty: Uncertainty | None = None,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    threads: int | None = None,
) -> Success:
    """Say how often a throw winds and stays wound in drawn, simulated worlds.

    Parameters
    ----------
    thrower : Thrower
    peg : Peg
    throw : Throw
        Made in open loop: its moves start when planned, but for the timing noise of each draw.
    uncertainty : Uncertainty, optional
        By default a realistic identification's.
    draws : int
    seed : int
        Of the draws; those of a search are others in any case.
    threads : int, optional
    """
    known = uncertainty or Uncertainty()
    worlds = known.draws(draws, thrower, peg, seed=[STREAM, checks.count("seed", seed, least=0)])
    won = wins(thrower, [(throw, world) for world in worlds], threads=threads)
    return Success(int(won.sum()), draws)


def wins(thrower: Thrower, pairs: list[tuple[Throw, Draw]], *, threads: int | None = None) -> npt.NDArray[np.bool_]:
    """Whether each throw winds by WOUND turns that stay, in its own world (M,)."""
    found = flights.ends(flights.from_rest(thrower, pairs), thrower.arm, thrower.time, threads=threads)
    return np.asarray(found.turns >= WOUND)
