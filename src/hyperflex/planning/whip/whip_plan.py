"""A planned whip: the strokes, their outcome in simulation, or why there are none."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.stroke_plan import StrokePlan
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.whip.impact import IMPACT_RADIUS, Impact, simulate_impact
from hyperflex.planning.whip.outcome import TipStrike
from hyperflex.planning.whip.search import WhipFeasibility
from hyperflex.planning.whip.tip_target import TipTarget


@dataclass(frozen=True, eq=False, repr=False)
class WhipPlan(StrokePlan):
    """A planned whip, or why there is none.

    Attributes
    ----------
    problem, message, runs, seconds, interrupted
        As of :class:`Plan`.
    target : TipTarget
    feasibility : WhipFeasibility
        Result of the check before the search.
    strokes : Strokes or None
        The best found.
    outcome : TipStrike or None
        Their outcome in a simulated run.
    finer_outcome : TipStrike or None
        The same with links of half the length.
    position_std : float
        Standard deviation of the place of the peak, m, for a rope known as :mod:`hyperflex.planning.tip.aim` assumes;
        NaN without strokes.
    """

    kind: ClassVar[str] = "whip"
    problem: Problem
    target: TipTarget
    feasibility: WhipFeasibility
    strokes: Strokes | None = None
    outcome: TipStrike | None = None
    finer_outcome: TipStrike | None = None
    position_std: float = math.nan
    message: str = ""
    runs: int = 0
    seconds: float = 0.0
    interrupted: bool = False

    def impact(self, *, radius: float = IMPACT_RADIUS, mu: float = 0.3) -> Impact:
        """Simulate the impact on a small fixed peg whose surface is at the target; see :class:`Impact`.

        The peg has a `radius`, m, and a friction coefficient `mu`. Raises InvalidInput if the plan holds no outcome.
        """
        outcome, target = self.required(self.outcome, "outcome"), self.target
        if target.any_direction:
            target = replace(target, direction=float(np.arctan2(*outcome.velocity[::-1])))
        motion = self.required(self.motion, "motion")
        return simulate_impact(self.problem, target, motion, outcome.t, radius=radius, mu=mu)
