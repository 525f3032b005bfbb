"""Candidates of a search: swings that strike and throws that were simulated in contact; which of them are alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.outcome import MIN_TURNS
from hyperflex.planning.throw import LAST, Throw

APART = 0.1  # least difference of two swings that are not alike: strokes in half turns, or rests in periods
SCREENED = 4  # throws at once that are simulated with shorter links too
SHARED = 0.8  # fraction of a throw's loss with better links that other throws of the same swing lose too


class Swing(NamedTuple):
    """A free swing that strikes the peg at time t, s; x is its point (2 k + 4,)."""

    score: float
    side: int
    x: Array
    t: float


class Candidate(NamedTuple):
    """A throw that was simulated in contact with the peg: its score, and the turns that stay."""

    score: float
    turns: float
    side: int
    x: Array
    throw: Throw
    confirmed: bool = False  # whether score and turns take a run with shorter links into account


def distinct(swings: Sequence[Swing], others: Sequence[Swing], count: int) -> list[Swing]:
    """Return the first swings, `count` at most, that are not like each other, nor like others."""
    found: list[Swing] = []
    for one in swings:
        if len(found) == count:
            break
        if all(one.side != other.side or np.abs(one.x - other.x).max() > APART for other in [*others, *found]):
            found.append(one)
    return found


def same_swing(one: Candidate, other: Candidate) -> bool:
    """Whether two throws are alike until the strike."""
    count, k = min(one.throw.count, other.throw.count), (one.x.size - LAST) // 2
    way = (one.x - other.x)[: 2 * k].reshape(2, k)[:, :count]
    return one.side == other.side and bool(np.abs(way).max() <= APART)


def unconfirmed(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return throws that wind and score better than the best confirmed one; the best of each swing."""
    found: list[Candidate] = []
    for one in candidates:
        if one.turns >= MIN_TURNS and (one.confirmed or len(found) == SCREENED):
            break
        if one.turns >= MIN_TURNS and not any(same_swing(one, other) for other in found):
            found.append(one)
    return found


def corrected(candidates: Sequence[Candidate], one: Candidate, turns: float, score: float) -> list[Candidate]:
    """Return the candidates, best first, with one corrected to the turns and the score of a better run.

    If it does not wind then, throws of the same swing, which mostly fail alike, lose SHARED of its loss; confirmed ones
    do so only if it was confirmed itself.
    """
    known = one._replace(score=min(one.score, score), turns=min(one.turns, turns), confirmed=True)
    lost, undone = SHARED * (one.score - known.score), SHARED * (one.turns - known.turns)

    def correct(each: Candidate) -> Candidate:
        if each.x is one.x:
            return known
        share = known.turns < MIN_TURNS and (one.confirmed or not each.confirmed) and same_swing(each, one)
        return each._replace(score=each.score - lost, turns=each.turns - undone) if share else each

    return sorted(map(correct, candidates), key=lambda each: -each.score)
