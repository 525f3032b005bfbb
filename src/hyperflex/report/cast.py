"""The report of a planned cast, with a tug at the wound rope: figures and film."""

import math
from collections.abc import Mapping
from dataclasses import replace
from textwrap import fill
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from hyperflex import winding
from hyperflex.checks import Array
from hyperflex.planning import BOUNCE_TIME, CastPlan, HoldingForce, WindCriteria
from hyperflex.report.curves import Panel
from hyperflex.report.maps import target_map
from hyperflex.report.page import Picture, Section
from hyperflex.report.plan import PlanReport
from hyperflex.report.scene import Line, Overlay, Plot
from hyperflex.report.style import BLUE, GREEN, GREY, RED, new_figure, note, png

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class CastReport(PlanReport[CastPlan]):
    """The report of a planned cast, and of a tug at the wound rope, if one was simulated.

    For a plan without a throw it is a page with the reason and a map of the target.

    Parameters
    ----------
    plan : CastPlan
    held : HoldingForce, optional
        Result of the tug.
    """

    name, noun, strobe, move, last_move, film_speed = "cast", "cast", "strike", "swing", True, 1.0
    layout: ClassVar = {
        "The cast": {
            "film": "The planned cast, simulated: arm, rope (ochre), path of the tip (green), target (red).",
            "strike": "The rope about the strike, early instants dark, late ones bright; simulated.",
        },
        "Time course": {
            "course": "Arm angle, turns, tension and torque over time. Dashed red: the strike. Green: slip is measured."
        },
        "Hold": {"tug": "The simulated tug that gives the hold force: pull, and slip of the rope on the target."},
    }

    def __init__(self, plan: CastPlan, held: HoldingForce | None = None) -> None:
        self.held = held
        self.sense = -1.0 if plan.outcome is not None and plan.outcome.turns < 0.0 else 1.0
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
        return math.nan if self.plan.outcome is None else self.plan.outcome.strike_time

    @property
    def stop(self) -> float:
        """When the arm stops, s."""
        return 0.0 if self.plan.motion is None else float(self.plan.motion.breaks[-1])

    def grazes(self) -> bool:
        """Whether the rope touches the target before it strikes it."""
        return bool(self.outcome.strike_time - self.outcome.touch_time > BOUNCE_TIME)

    def fold(self) -> float:
        """Return the greatest angle between links, rad, of a rope that folds flat on the way; else 0."""
        runs = (self.plan.outcome, self.plan.finer_outcome)
        return max((each.max_bend for each in runs if each is not None and each.folded), default=0.0)

    def figures(self) -> "dict[str, Figure]":
        """Draw strike, time course, and tug if there was one."""
        middle = self.event if math.isfinite(self.event) else self.stop - 0.8  # before the arm stops
        red = "the target, and pegs before it" if self.plan.problem.criteria.behind else "the target"
        drawn = {"strike": self.strobe_at(middle, 0.6, 0.8, f"red: {red}"), "course": self._course()}
        return drawn if self.held is None else drawn | {"tug": tug_figure(self.held)}

    def overlay(self) -> Overlay:
        """Return notes, turns, obstacles, and when the rope strikes."""
        return replace(super().overlay(), plots=(Plot(f"turns, {self.way}", "", (Line("", self._turns()),)),))

    def film_note(self, t: float) -> str:
        """Return the film's note at a time, s: target, arm, turns, and at the end the hold."""
        lines = [self.texts.text("film"), self.arm_note(t), "rope: in the air"]
        if t >= self.event:
            turns = np.interp(t, self.run.t, self._turns())
            lines[-1] = f"rope: {turns:.2f} turns round the target, {self.way}"
        if t > self.run.t[-1] - 2.0:
            lines.append(fill(self.texts.text("end"), 90))  # letters that fit into a line
        return "\n".join(lines)

    def _turns(self) -> Array:
        """Return the turns (T,) about the target, positive in the sense in which the rope winds."""
        return self.sense * winding.turns(self.run, self.plan.target)

    def _course(self) -> "Figure":
        """Draw arm angle, turns, tension and the motor's torque over time."""
        run, wound, criteria = self.run, winding.measure_winding(self.run, self.plan.target), self.plan.problem.criteria
        turns = Plot(f"turns about the target, {self.way} counted positive", "", (Line("", self._turns()),))
        lines = (Line("towards the arm", wound.before), Line("towards the tip", wound.after))
        tension = Plot("tension of the rope where it leaves the target", "N", lines)
        required = (criteria.turns, f"{criteria.turns:g} turns are required")
        struck = f"strikes at {self.event:.2f} s"
        figure = self.course(Panel(turns, "turns", (GREEN,), required, struck), Panel(tension, "tension"))
        for axis in figure.axes:
            axis.axvspan(self.stop + criteria.settle, run.t[-1], color=GREEN, alpha=0.10, lw=0)
        _, upper, lower, _ = figure.axes
        note(upper, run.t[-1], 0.03, "slip is measured ", GREEN, transform=upper.get_xaxis_transform(), ha="right")
        if not np.isfinite(wound.before).any():
            lower.set(ylim=(0.0, 1.0), yticks=())
            note(lower, 0.5, 0.5, "the rope does not lie on the target", transform=lower.transAxes, ha="center")
        return figure


def tug_figure(held: HoldingForce) -> "Figure":
    """Draw pull and slip of the wound rope over the distance that it was pulled."""
    run, tug = held.tug.run, held.tug
    way = 1e3 * np.hypot(*(run.joints[:, 0] - run.joints[0, 0]).T)
    with new_figure(8.6, 4.0, "A tug at the wound rope, simulated") as figure:
        pull, slip = figure.subplots(2, 1, sharex=True)
        tension, least = winding.rope_tension(run)[:, 0], "" if tug.slipped else "at least "
        capstan = f"tail weight x e^(mu angle) {held.capstan_force:.2f} N"
        pull.plot(way, tension, color=BLUE, lw=1.0, label="pull at the rope's first joint")
        pull.axhline(held.force, color=GREEN, ls="--", lw=1.2, label=f"hold force {least}{held.force:.2f} N")
        pull.axhline(held.capstan_force, color=GREY, ls=":", lw=1.4, label=capstan)
        pull.set(ylabel="pull, N", ylim=(0.0, 1.05 * max(held.force, held.capstan_force, float(tension.max()))))
        pull.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8.0)
        allowed = 1e3 * WindCriteria.max_slip
        slip.plot(way, 1e3 * np.abs(tug.slip), color=RED)
        slip.axhline(allowed, color=GREY, ls="--", lw=1.0, label=f"{allowed:g} mm: has slipped")
        slip.legend(loc="upper left", fontsize=8.0)
        slip.set(ylabel="slip, mm", xlabel="distance of the pull away from the target, mm")
    return figure
