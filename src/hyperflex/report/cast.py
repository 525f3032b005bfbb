"""The report of a planned cast, with a tug at the wound rope: figures and film."""

import math
from collections.abc import Mapping
from dataclasses import replace
from textwrap import fill
from typing import ClassVar

import numpy as np

from hyperflex import winding
from hyperflex.planning import CastPlan, HoldingForce
from hyperflex.report.curves import sideways_figure, speed_plot
from hyperflex.report.maps import target_map
from hyperflex.report.page import Picture, Section
from hyperflex.report.plan import PlanReport
from hyperflex.report.scene import Line, Overlay, Plot
from hyperflex.report.style import BLUE, GREEN, GREY, RED, Axes, Figure, new_figure, png
from hyperflex.simulation import sideways


class CastReport(PlanReport[CastPlan]):
    """The report of a planned cast, and of a tug at the wound rope, if one was simulated.

    For a plan without moves it is a page with the reason and a map of the target.

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
        "course": "Arm angle, turns, tension and torque over time. Dashed red: the strike. Green: slip is measured.",
        "sideways": "Distance of the rope from the plane until its first touch, if it begins with the angle named: to "
        "first order, simulated; joint limits are ignored.",
        "tug": "The simulated pull that gives the holding force: force, and slip of the rope on the target.",
    }

    def __init__(self, plan: CastPlan, held: HoldingForce | None = None) -> None:
        self.held = held
        self.sense = -1.0 if plan.seen is not None and plan.seen.turns < 0.0 else 1.0
        self.way = "clockwise" if self.sense < 0.0 else "counterclockwise"
        super().__init__(plan)

    def without_run(self) -> tuple[Section, ...]:
        """Return a section with a map of the target."""
        nearest = self.texts.text("nearest")
        near = "" if self.plan.fallback is None else f" Green: {nearest}."
        caption = f"Arm and rope at the start, and the target (red), to scale; nothing here was simulated.{near}"
        return (Section("Where the target is", pictures=(Picture(png(target_map(self.plan, nearest)), caption),)),)

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
        return self.strobe_at(middle, 0.6, 0.8, f"red: {red}", ax)

    def figures(self) -> "dict[str, Figure]":
        """Draw strike, time course, motion sideways if the rope strikes, and tug if there was one."""
        drawn = {"strike": self.strobe_of_event(), "course": self._course()}
        if self.outcome.half_width > 0.0:
            tilt = self.plan.problem.criteria.tilt
            title = f"Out of the plane, begun {np.degrees(tilt):.3g}\u00b0 out of it, simulated to first order"
            drawn["sideways"] = sideways_figure(sideways(self.run, tilt=tilt), title)
        return drawn if self.held is None else drawn | {"tug": tug_figure(self.held)}

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
        return Plot(f"turns, {self.way}", "", (Line("", turns),), (required, f"{required:g} turns are required"))

    def _course(self) -> "Figure":
        """Draw arm angle, turns, tension and the motor's torque over time."""
        wound = winding.measure_winding(self.run, self.plan.target)
        second = speed_plot(self.run)  # where the rope does not lie on the target
        if np.isfinite(wound.before).any():
            lines = (Line("towards the arm", wound.before), Line("towards the tip", wound.after))
            second = Plot("tension of the rope where it leaves the target", "N", lines)
        figure = self.course(f"strikes at {self.event:.2f} s", self._turns(), second)
        watched = self.plan.required(self.plan.motion, "motion").end + self.plan.problem.criteria.settle
        for axis in figure.axes:
            axis.axvspan(watched, self.run.t[-1], color=GREEN, alpha=0.1, lw=0)
        return figure


def tug_figure(held: HoldingForce) -> "Figure":
    """Draw pull and slip of the wound rope over the distance that it was pulled."""
    run, tug = held.tug.run, held.tug
    way = 1e3 * np.hypot(*(run.joints[:, 0] - run.joints[0, 0]).T)
    with new_figure(8.6, 4.0, "A pull at the wound rope, simulated") as figure:
        pull, slip = figure.subplots(2, 1, sharex=True)
        tension, least = winding.rope_tension(run)[:, 0], "" if tug.slipped else "at least "
        capstan = f"tail weight x e^(mu angle) {held.capstan_force:.2f} N"
        pull.plot(way, tension, color=BLUE, label="pull at the rope's first joint")
        pull.axhline(held.force, color=GREEN, ls="--", label=f"hold force {least}{held.force:.2f} N")
        pull.axhline(held.capstan_force, color=GREY, ls=":", label=capstan)
        pull.set(ylabel="pull, N", ylim=(0.0, 1.05 * max(held.force, held.capstan_force, float(tension.max()))))
        pull.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
        allowed = 1e3 * tug.allowed
        slip.plot(way, 1e3 * np.abs(tug.slip), color=RED)
        slip.axhline(allowed, color=GREY, ls="--", label=f"{allowed:g} mm: has slipped")
        slip.legend(loc="upper left")
        slip.set(ylabel="slip, mm", xlabel="distance of the pull away from the target, mm")
    return figure
