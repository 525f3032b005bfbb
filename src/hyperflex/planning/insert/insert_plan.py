"""A planned insertion: the strokes, their outcome in simulation, or why there are none."""

import math
from dataclasses import dataclass
from typing import ClassVar

from hyperflex.model import Wall
from hyperflex.planning.insert.outcome import InsertOutcome
from hyperflex.planning.insert.search import InsertFeasibility
from hyperflex.planning.insert.slot import Slot
from hyperflex.planning.problem import Problem
from hyperflex.planning.robust.scenario_rollouts import SuccessProbability
from hyperflex.planning.tip.stroke_plan import StrokePlan
from hyperflex.planning.tip.strokes import Strokes


@dataclass(frozen=True, eq=False, repr=False)
class InsertPlan(StrokePlan):
    """A planned insertion, or why there is none.

    Attributes
    ----------
    problem, message, runs, seconds, interrupted
        As of :class:`Plan`.
    target : Slot
    feasibility : InsertFeasibility
        Result of the check before the search.
    strokes : Strokes or None
        The best found.
    outcome : InsertOutcome or None
        Their outcome in a run beside the walls.
    finer_outcome : InsertOutcome or None
        The same with more, shorter links and a tighter tolerance.
    position_std : float
        Standard deviation, m, of where the rope crosses the gap, for a rope known as :mod:`hyperflex.planning.tip.aim`
        assumes; NaN without strokes.
    success_probability : SuccessProbability or None
        In sampled scenarios; None if the plan fails. Of 0 samples where no time was left.
    """

    kind: ClassVar[str] = "insert"
    problem: Problem
    target: Slot
    feasibility: InsertFeasibility
    strokes: Strokes | None = None
    outcome: InsertOutcome | None = None
    finer_outcome: InsertOutcome | None = None
    position_std: float = math.nan
    success_probability: SuccessProbability | None = None
    message: str = ""
    runs: int = 0
    seconds: float = 0.0
    interrupted: bool = False

    @property
    def walls(self) -> tuple[Wall, ...]:
        """The walls of the slot."""
        return self.target.walls
