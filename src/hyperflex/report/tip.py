"""The reports of plans for the rope's tip, whips and insertions: figures and film."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from hyperflex.planning import Impact, InsertPlan, WhipPlan
from hyperflex.report.plan import PlanReport
from hyperflex.report.scene import Line, Overlay, Plot
from hyperflex.report.style import RED, Axes, Figure


class WhipReport(PlanReport[WhipPlan]):
    """The report of a planned whip, and of its impact on a small peg at the target, if one was simulated.

    For a plan without strokes it is a page with the reason.
    """

    name, noun, strobe = "whip", "whip", "peak"
    captions: ClassVar = {
        "film": "The planned whip, simulated: arm, rope (ochre), path of the tip (green), target (red ring).",
        "peak": "The rope about the peak, early instants dark, late ones bright; simulated.",
        "passing": "The tip at the target, close up: white, its velocity; red, the required direction.",
    }

    def __init__(self, plan: WhipPlan, impact: Impact | None = None) -> None:
        self.impact = impact
        super().__init__(plan)

    def overlay(self) -> Overlay:
        """Return notes, target and obstacles, when the tip's speed peaks, and its distance from the target."""
        away = Line("", np.hypot(*(self.run.tip - self.plan.target.point).T))
        plots = (Plot("distance of the tip from the target", "m", (away,)),)
        return replace(super().overlay(), targets=self.plan.target.point[None], plots=plots)

    def strobe_of_event(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the rope about the peak."""
        return self.strobe_at(self.outcome.t, 0.5, 0.1, "ring: the target", ax=ax)

    def figures(self) -> "dict[str, Figure]":
        """Draw the rope about the peak, and close to the target."""
        seen = self.outcome
        half = max(0.12, 1.3 * seen.miss)  # m about the target
        time = 2.0 * half / max(seen.speed, 1e-3)
        near = self.plan.target.point, half
        passing = self.strobe_at(seen.t, time, time, "ring: the target", near=near, width=6.0)
        target, ways = self.plan.target, [(seen.velocity / seen.speed, "white")]
        if not target.any_direction:
            ways.append((np.array([np.cos(target.direction), np.sin(target.direction)]), RED))
        for way, colour in ways:
            passing.axes[0].quiver(
                *target.point, *(0.6 * half * way), color=colour, angles="xy", scale_units="xy", scale=1.0
            )
        return {"peak": self.strobe_of_event(), "passing": passing}


class InsertReport(PlanReport[InsertPlan]):
    """The report of a planned insertion. For a plan without strokes it is a page with the reason."""

    name, noun, strobe = "insert", "insertion", "entry"
    captions: ClassVar = {
        "film": "The planned insertion, simulated: arm, rope (ochre), path of the tip (green), walls (red).",
        "entry": "The rope until the tip is inside, early instants dark, late ones bright; simulated.",
        "gap": "How the rope goes through the gap: the same close to it.",
    }

    def overlay(self) -> Overlay:
        """Return notes, obstacles, when the tip is inside, and its depth."""
        slot = self.plan.target
        depth = Line("", (self.run.tip - slot.point) @ slot.axes[0])
        title = f"depth of the tip beyond the walls ({1e3 * slot.depth:.3g} mm required)"
        return replace(super().overlay(), plots=(Plot(title, "m", (depth,), slot.depth),))

    def strobe_of_event(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the rope until the tip is inside."""
        seen = self.outcome
        return self.strobe_at(seen.t_enter, 0.6, seen.t - seen.t_enter + 0.05, "red: the walls", ax=ax)

    def figures(self) -> "dict[str, Figure]":
        """Draw the rope until the tip is inside, and close to the gap."""
        slot, seen = self.plan.target, self.outcome
        half = max(1.6 * slot.depth, 1.5 * slot.width)  # m about the gap
        time = max(seen.t - seen.t_enter, 0.02)
        near = slot.point, half
        return {
            "entry": self.strobe_of_event(),
            "gap": self.strobe_at(seen.t_enter, time, seen.t - seen.t_enter, "red: the walls", near=near, width=6.0),
        }
