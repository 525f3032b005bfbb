"""A task of the tip: what its planner asks of it, and what it answers."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from hyperflex.checks import Array
from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.simulation import Deadline

AFTER = 0.3  # s, after the time at which a swing does nearly what is asked: until then searches about it simulate
NEVER = 10.0  # m, cost of a swing after which the tip does nothing of what is asked


class TipCandidate(NamedTuple):
    """Strokes with their cost, m, and the time at which the tip does nearly what is asked, s."""

    cost: float
    t: float
    strokes: Strokes


@dataclass(frozen=True, eq=False)
class Aimed:
    """Strokes and what the tip does after them.

    `t` is the instant that counts, s, and `dt` (P,) its derivative by the P parameters of the strokes. `position_std`
    is a standard deviation of the tip's place then, m.
    """

    strokes: Strokes
    t: float
    dt: Array
    position_std: float


AimedT = TypeVar("AimedT", bound=Aimed)


class Verified(NamedTuple):
    """Strokes with their outcomes, with the links as planned and finer ones; the message tells why they fail."""

    aim: Any
    outcome: Any
    finer_outcome: Any
    message: str


class TipTask(ABC, Generic[AimedT]):
    """What the tip is to do, and how near some strokes come to it.

    Residuals below `close`, m, are small enough. The `direct` first candidates are aimed before any search. A search
    ends at a cost below `ready`, m; the cheapest ones go on, in up to `rounds`. `runs` counts the runs that were
    simulated since.
    """

    problem: Problem
    close: float
    direct: int
    ready: float
    rounds: int
    runs = 0

    @abstractmethod
    def candidates(self) -> list[TipCandidate]:
        """Return swings to begin with, the cheapest first."""

    @abstractmethod
    def score(self, strokes: list[Strokes], threads: int | None, until: float) -> tuple[Array, Array]:
        """Simulate free swings (M) coarsely until a time, s; return the cost (M,), m, and the time, s, of each."""

    def starts(self) -> Iterator[TipCandidate]:
        """Yield swings that searches begin with."""
        yield from self.candidates()

    def freed(self, found: TipCandidate, number: int) -> TipCandidate:
        """Return what a search about a swing begins with; `number` tells how many went before."""
        return found

    @abstractmethod
    def find(self, strokes: Strokes, near: float) -> AimedT | None:
        """Return what the tip does about time `near`, s, with derivatives; None if it does not do it at all."""

    @abstractmethod
    def residuals(self, aim: AimedT) -> tuple[Array, Array]:
        """Return what is to become 0 (m,), m, and its Jacobian (m, P)."""

    @abstractmethod
    def shortfall(self, aim: AimedT) -> float:
        """Return by how much strokes fail, 0 if they do not."""

    def uncertainty(self, aim: AimedT) -> float:
        """Return how uncertain strokes are that do not fail; of several the least uncertain ones are taken."""
        return aim.position_std

    @abstractmethod
    def verify(self, aim: AimedT, end: Deadline | None) -> Verified:
        """Simulate strokes at a tight tolerance, with links as planned and finer; raises OutOfTime at the `end`."""


Left = Callable[[], float]  # time that is left, s
