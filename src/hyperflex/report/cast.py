"""The report of a planned cast, with a tug at the wound rope: figures and film."""

import math
from collections.abc import Mapping
from dataclasses import replace
from textwrap import fill
from typing import ClassVar

import numpy as np

from hyperflex import winding
from hyperflex.planning import CastPlan, HoldingForce
from hyperflex.report.curves import sideways_figure
from hyperflex.report.plan import PlanReport
from hyperflex.report.scene import Line, Overlay, Plot
from hyperflex.report.style import Axes, Figure
from hyperflex.simulation import sideways


class CastReport(PlanReport[CastPlan]):
    """The report of a planned cast, and of a tug at the wound rope, if one was simulated.

    For a plan without moves it is a page with the reason.

    Parameters
    ----------
    plan : CastPlan
    held : HoldingForce, optional
        Result of the tug.
    """

    name, noun, strobe, move, last_move, film_speed = "cast", "cast", "strike", "swing", True, 1.0
    captions: ClassVar = {
        "film": "The planned cast, simulated: arm, rope (ochre), path of the tip (green), target (red).",
        "strike": "The rope around the time of the strike, from dark (early) to bright (late); simulated.",
        "sideways": "Distance of the rope from the plane until its first touch, if it begins with the angle named: to "
        "first order, simulated; joint limits are ignored.",
    }

    def __init__(self, plan: CastPlan, held: HoldingForce | None = None) -> None:
        self.held = held
        self.sense = -1.0 if plan.seen is not None and plan.seen.turns < 0.0 else 1.0
        self.way = "clockwise" if self.sense < 0.0 else "counterclockwise"
        super().__init__(plan)

    def other_plans(self) -> Mapping[str, CastPlan | None]:
        """Return the plan for the nearest target that works."""
        return {"nearest": None if self.plan.fallback is None else self.plan.fallback.plan}

    @property
    def event(self) -> float:
        """When the rope strikes the target, s."""
        return math.nan if self.plan.seen is None else self.plan.seen.strike_time

    @property
    def stop(self) -> float:
        """When the arm stops, s."""
        return 0.0 if self.plan.moves is None else self.plan.moves.stops(self.plan.problem.limits)

    def strobe_of_event(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the rope about the strike, or before the arm stops."""
        middle = self.event if math.isfinite(self.event) else self.stop - 0.8
        red = "the target, and pegs before it" if self.plan.problem.criteria.behind else "the target"
        return self.strobe_at(middle, 0.6, 0.8, f"red: {red}", ax=ax)

    def figures(self) -> "dict[str, Figure]":
        """Draw the strike, and the motion sideways if the rope strikes."""
        drawn = {"strike": self.strobe_of_event()}
        if self.outcome.half_width > 0.0:
            tilt = self.plan.problem.criteria.tilt
            title = f"Out of the plane, begun {np.degrees(tilt):.3g}\u00b0 out of it, simulated to first order"
            drawn["sideways"] = sideways_figure(sideways(self.run, tilt=tilt), title)
        return drawn

    def overlay(self) -> Overlay:
        """Return notes, turns, obstacles, and when the rope strikes."""
        return replace(super().overlay(), plots=(self._turns(),))

    def rope_note(self, t: float) -> str:
        """Return the rope's turns round the target at a time, s, and at the end the hold."""
        doing = "in the air"
        if t >= self.event:
            turns = np.interp(t, self.run.t, self._turns().lines[0].values)
            doing = f"{turns:.2f} turns round the target, {self.way}"
        end = fill(self.texts.text("end"), 90) if t > self.run.t[-1] - 2.0 else ""  # letters that fit into a line
        return f"rope: {doing}\n{end}".rstrip()

    def _turns(self) -> Plot:
        """Return the turns about the target, positive in the sense in which the rope winds."""
        turns, required = self.sense * winding.turns(self.run, self.plan.target), self.plan.problem.criteria.turns
        return Plot(f"turns, {self.way} ({required:g} required)", "", (Line("", turns),), required)
