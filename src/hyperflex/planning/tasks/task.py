"""What a planner needs of a task: winding a target, a whip, an insertion.

A task works at three levels of cost. It **samples** moves of the arm with a cheap score, **rolls out** some of them
with a dear one, and **verifies** those whose rollout meets the criterion.
:class:`hyperflex.planning.planner.Planner` decides when each level is next.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hyperflex.budget import Budget
from hyperflex.planning.moves import Moves
from hyperflex.planning.problem import Problem


@dataclass(frozen=True, eq=False)
class Candidate:
    """Moves of the arm with what is known of them.

    Attributes
    ----------
    moves : Moves
    score : float
        Greater is better. Scores of samples and of rollouts need not be comparable.
    t : float
        When the moves reach their goal, s: the strike, the tip's pass, its entry.
    good : bool
        Whether a rollout meets the task's criterion, so that the candidate is worth a verification.
    """

    moves: Moves
    score: float
    t: float
    good: bool = False


@dataclass(frozen=True, eq=False)
class Verified:
    """Moves with the outcomes of their verified runs.

    Attributes
    ----------
    candidate : Candidate
    outcome, finer_outcome
        With the links as planned, and with finer links; None if there was no such run.
    message : str
        Why the moves fail; empty if they succeed.
    margin : float
        How much of each criterion is to spare, over what is usual: the least. Below 0 for moves that fail.
    """

    candidate: Candidate
    outcome: Any
    finer_outcome: Any
    message: str
    margin: float = 0.0


class Task(ABC):
    """A task of the planner.

    Attributes
    ----------
    problem : Problem
    batch : int
        Candidates that are rolled out at once.
    enough : float
        Margin with which a search ends.
    runs : int
        Simulated runs so far.
    """

    problem: Problem
    batch: int = 1
    enough: float = 0.0
    runs: int = 0

    @abstractmethod
    def sample(self, found: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Return new candidates with cheap scores; none if there are no more. `found` are rollouts, the best first."""

    @abstractmethod
    def rollout(self, some: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Return candidates with dear scores, made from `some` samples: fewer, as many or more."""

    def alike(self, one: Candidate, other: Candidate) -> bool:
        """Whether two candidates are so alike that they mostly fail alike."""
        return False

    @abstractmethod
    def verify(self, one: Candidate, budget: Budget) -> Verified:
        """Verify a candidate; ends at the first reason to fail. Raises OutOfTime if the budget ends before."""
