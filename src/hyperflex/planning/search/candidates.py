"""What a search has found: swings that strike and throws that were run beside the peg, and which of them are alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.search.parametrization import LAST
from hyperflex.planning.wind.outcome import WOUND
from hyperflex.planning.wind.throw import Throw

APART = 0.1  # strokes, in half turns, or rests, in periods, by which two swings differ that are not alike
SCREENED = 4  # throws at once that are run with shorter links too
SHARED = 0.8  # part of what a throw loses in a better run that others of the same swing lose too


class Swing(NamedTuple):
    """A free swing that strikes the peg."""

    score: float
    side: int
    x: Array
    t: float  # s, of the strike


class Landing(NamedTuple):
    """A throw that was run beside the peg, its score and the turns that stay."""

    score: float
    turns: float
    side: int
    x: Array
    throw: Throw
    firm: bool = False  # whether score and turns are also those with shorter links


def apart(swings: Sequence[Swing], others: Sequence[Swing], count: int) -> list[Swing]:
    """The first swings, `count` at most, that are not alike, nor like others."""
    found: list[Swing] = []
    for one in swings:
        if len(found) == count:
            break
        if all(one.side != other.side or np.abs(one.x - other.x).max() > APART for other in [*others, *found]):
            found.append(one)
    return found


def same_swing(one: Landing, other: Landing) -> bool:
    """Whether two throws come to their strikes alike."""
    count, k = min(one.throw.count, other.throw.count), (one.x.size - LAST) // 2
    way = (one.x - other.x)[: 2 * k].reshape(2, k)[:, :count]
    return one.side == other.side and bool(np.abs(way).max() <= APART)


def unsure(landings: Sequence[Landing]) -> list[Landing]:
    """Throws, best first, that look better than the best one that is sure to wind; the best of each swing."""
    found: list[Landing] = []
    for one in landings:
        if one.turns >= WOUND and (one.firm or len(found) == SCREENED):
            break
        if one.turns >= WOUND and not any(same_swing(one, other) for other in found):
            found.append(one)
    return found


def corrected(landings: Sequence[Landing], one: Landing, turns: float, score: float) -> list[Landing]:
    """Throws, best first, of which one counts what a better run made of it.

    If it does not wind then, throws of the same swing, which mostly fail as it does, lose SHARED of what it loses; firm
    ones do so only with one that was firm itself.
    """
    known = one._replace(score=min(one.score, score), turns=min(one.turns, turns), firm=True)
    lost, undone = SHARED * (one.score - known.score), SHARED * (one.turns - known.turns)

    def judged(each: Landing) -> Landing:
        if each.x is one.x:
            return known
        share = known.turns < WOUND and (one.firm or not each.firm) and same_swing(each, one)
        return each._replace(score=each.score - lost, turns=each.turns - undone) if share else each

    return sorted(map(judged, landings), key=lambda each: -each.score)
