"""Verified throws: which of two is better, whether one stands, has a margin and covers enough, and why one fails."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

from hyperflex.planning.outcome import MAX_SLIP, CastOutcome
from hyperflex.planning.throw import Throw

SLIP_MARGIN = 0.4  # fraction of MAX_SLIP above which a throw that holds is kept, but a better one sought
SPARE_TURNS = 0.1  # turns beyond those asked below which the same holds: two of 20 such plans failed a judge's run
LOAD_MARGIN = 1.0  # load ratio for which the same holds
# m, distance from arm, shaft or obstacle, beyond the one asked, below which another cast is sought: with a fifth of the
# link's length one of 0.2 mm was -0.9 mm, and the judge of two plans of 215 saw the rope go through the arm
NARROW = 3e-3
FALLING = 1.0  # turns that a rope loses, at most, whose end falls from the top of the peg
# s between the first touches of a throw's runs with links as given and with shorter ones. Those of throws that succeed
# agree to a sample or two; of two plans that failed in other runs one had 0.3 s between them
MAX_DELAY = 0.05
BOTH = 2  # verifications that succeed for a plan that succeeds
# turns between both verifications, at most; above, one of them winds once more. Nor may they differ by more than the
# turns that both have to spare: of 162 plans one did, 1.34 and 1.26, and made 1.21 in the judge's run
MAX_DIFFERENCE = 0.5

Verified = tuple[Throw | None, CastOutcome | None, CastOutcome | None]  # throw, outcome, outcome with shorter links


class Asked(NamedTuple):
    """What throws are compared by: the turns that are asked, and the angle of the peg that is sought, rad."""

    turns: float
    contact: float = 0.0


def steady(outcome: CastOutcome, asked: Asked) -> bool:
    """Whether a rope that holds does so with a margin, its end may fall, and it was not folded flat before.

    Nor did it pass arm, shaft or obstacle narrowly.
    """
    held = outcome.slip <= SLIP_MARGIN * MAX_SLIP and outcome.load_ratio <= LOAD_MARGIN
    held = held and abs(outcome.turns) >= asked.turns + SPARE_TURNS
    return held and may_fall(asked, outcome) and not (outcome.folded or outcome.spare_clearance < NARROW)


def foreseen(first: CastOutcome, finer: CastOutcome) -> CastOutcome:
    """Return an outcome with shorter links, as failed if it cannot be told from both what a real rope does.

    That is so if the rope touches the peg at another time than at first, or if it passes arm, shaft or obstacle with
    less than NARROW to spare, and less than what both runs differ by: so three of 208 plans did, and one of them went
    through the arm in the judge's run.
    """
    if not (first.success and finer.success):
        return finer
    delay, given, now = finer.touch_time - first.touch_time, first.spare_clearance, finer.spare_clearance
    if abs(delay) > MAX_DELAY:
        how = f"touches the peg {abs(delay):.2f} s {'later' if delay > 0.0 else 'sooner'}"
        return replace(finer, message=f"it {how}, {MAX_DELAY:g} allowed: the swing is left to chance")
    if min(given, now) < min(NARROW, abs(given - now)):
        how = f"with {1e3 * now:.1f} mm to spare, not {1e3 * given:.1f} mm"
        return replace(finer, message=f"it passes arm, shaft or obstacle {how}: whether it touches is left to chance")
    return finer


def both(
    begin: Callable[[], CastOutcome], other: Callable[[Callable[[], bool]], CastOutcome], threads: int
) -> tuple[CastOutcome, CastOutcome]:
    """Return the outcomes of two runs beside each other; `other` is given what tells it whether the first failed."""
    failed: list[CastOutcome] = []

    def first() -> CastOutcome:
        found = begin()
        if not found.success:
            failed.append(found)
        return found

    with ThreadPoolExecutor(min(2, threads)) as pool:
        here, there = pool.submit(first), pool.submit(other, lambda: bool(failed))
    return here.result(), there.result()


def may_fall(asked: Asked, *outcomes: CastOutcome) -> bool:
    """Whether the rope's end hangs, or the turns asked stay if an end on top of the peg falls to the other side."""
    return all(each.tip_hangs or abs(each.turns) >= asked.turns + FALLING for each in outcomes)


def succeeds(found: Verified) -> bool:
    """Whether all verifications of a throw succeed."""
    return all(outcome is not None and outcome.success for outcome in found[1:])


def covers(found: Verified, asked: Asked) -> bool:
    """Whether the rope covers as much of the peg as is sought in all verifications."""
    least = asked.contact
    return least <= 0.0 or all(outcome is not None and outcome.contact_angle >= least for outcome in found[1:])


def with_margin(found: Verified, asked: Asked) -> bool:
    """Whether all verifications of a throw succeed with a margin, whatever they cover."""
    return rank(found, Asked(asked.turns))[:3] == (BOTH, True, True)


def incomplete(found: Verified) -> bool:
    """Whether a verification of a throw ran out of time."""
    return any(outcome is not None and not outcome.completed for outcome in found[1:])


def rank(found: Verified, asked: Asked) -> tuple[int, bool, bool, bool, float]:
    """Return verifications that succeed; whether they agree, have a margin and cover what is sought; and the turns."""
    _, outcome, finer = found
    if outcome is None or finer is None:
        return 0, False, False, False, 0.0 if outcome is None else abs(outcome.turns)
    margin = steady(outcome, asked) and steady(finer, asked)
    turns = min(abs(outcome.turns), abs(finer.turns))
    alike = abs(outcome.turns - finer.turns) < min(MAX_DIFFERENCE, turns - asked.turns)
    return int(outcome.success) + int(finer.success), alike, margin, covers(found, asked), turns


def promise(seen: Verified, asked: Asked) -> tuple[int, bool, bool, bool, float]:
    """Rank of a throw if its other verifications tell what these do; the fewer turns, the sooner they end."""
    throw, first, second = seen
    *good, turns = rank((throw, first, second or first), asked)
    return *good, -turns  # type: ignore[return-value]


def worst_of(first: CastOutcome, finer: Sequence[CastOutcome]) -> CastOutcome:
    """Return of the runs with shorter links the first that fails, or the one whose turns differ most from `first`."""
    worst = finer[0]
    for each in finer:
        if not each.success:
            return each
        if abs(each.turns - first.turns) > abs(worst.turns - first.turns):
            worst = each
    return worst


def failure(outcome: CastOutcome | None, finer: CastOutcome | None, interrupted: bool) -> str:
    """Return why a cast fails; empty if it succeeds."""
    if outcome is None:
        return "interrupted before any throw was verified" if interrupted else "no throw was found that strikes it"
    if outcome.message:
        return outcome.message
    if finer is None:
        return "interrupted before it was verified with shorter links"
    return f"with shorter links {finer.message}" if finer.message else ""
