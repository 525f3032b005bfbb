"""The reports of plans for the rope's tip, whips and insertions: texts, figures and film."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning import (
    Impact,
    InsertPlan,
    TipOptions,
    TipStrike,
    TipTarget,
    WhipPlan,
)
from hyperflex.report.curves import Panel, speed_plot, time_course
from hyperflex.report.pictures import draw_obstacles
from hyperflex.report.plan import PlanReport
from hyperflex.report.scene import Line, Overlay, Plot, shapes, wall_ends
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, legend, new_figure
from hyperflex.report.units import length

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TipPlanT = TypeVar("TipPlanT", WhipPlan, InsertPlan)


class TipReport(PlanReport[TipPlanT]):
    """Common parts of the reports of whips and insertions."""

    def _start(self) -> list[str]:
        """Return target, start and strokes, each in a paragraph."""
        plan, limits = self.plan, self.plan.problem.limits
        lines: list[str] = [f"Target: {self.target}."]
        if plan.moves is not None:
            begin, *angles = np.degrees(plan.moves.angles(limits))
            moves = zip(angles, plan.moves.starts(limits), strict=True)
            strokes = ", ".join(f"{angle:.0f} degrees from {start:.2f} s on" for angle, start in moves)
            lines.append(
                f"The rope hangs at rest from the arm at {begin:.0f} degrees (0 hangs down, 90 points along +x). "
                f"The arm makes {self.move_count()}: to {strokes}."
            )
        return lines

    def _end(self, place: str) -> list[str]:
        """Return the uncertainty of a `place`, and the warning, each in a paragraph."""
        lines: list[str] = []
        if math.isfinite(self.plan.position_std):
            known = TipOptions()
            lines.append(
                f"Uncertainty: {place} has a standard deviation of {1e3 * self.plan.position_std:.0f} mm if friction "
                f"is known to {100 * known.friction_std:g} %, length to {100 * known.length_std:g} % and each rest of "
                f"the arm to {1e3 * known.timing_std:g} ms."
            )
        return [*lines, self.warning] if self.warning else lines

    def film_note(self, t: float) -> str:
        """Return the film's note at a time, s: target, stroke of the arm, and what the tip does."""
        place, end = self.note_texts()
        if not self.plan.success:
            end = f"FAILS: {self.plan.message}"
        return "\n".join((place, self.arm_note(t), end if t >= self.event else ""))

    def note_texts(self) -> tuple[str, str]:
        """Return the film's texts on the target, and on its end."""
        raise NotImplementedError

    @property
    def event(self) -> float:
        """Time of the peak, or when the tip is inside, s."""
        return float(self.outcome.t)

    def overlay(self) -> Overlay:
        """Return notes and obstacles, and mark the event."""
        return Overlay(self.film_note, obstacles=self.plan.problem.obstacles, marks=(self.event,))


class WhipReport(TipReport[WhipPlan]):
    """The report of a planned whip, and of its impact on a small peg at the target, if one was simulated.

    For a plan without strokes it is a page with the reason.
    """

    name, strobe = "whip", "peak"
    layout: ClassVar = {
        "The whip": {
            "film": "The planned whip, simulated: arm, rope (ochre), path of the tip (green), target (red ring).",
            "peak": "The rope about the peak, early instants dark, late ones bright; simulated.",
            "passing": "How the tip passes the target: its path, coloured by its speed; simulated.",
        },
        "Time course": {
            "course": "Arm angle, speed of the tip, its distance from the target, and torque over time. Dashed: peak."
        },
    }
    columns: ClassVar = {
        "links": lambda seen: str(seen.n_links),
        "peak": lambda seen: f"{seen.t:.3f} s",
        "speed": lambda seen: f"{seen.speed:.2f} m/s",
        "misses by": lambda seen: length(seen.miss, 2),
        "off the direction": lambda seen: f"{np.degrees(seen.angle_error):.1f} degrees",
    }
    runs = ("as planned", "links of half the length")
    runs_note = (
        "The second run makes the same strokes with a rope cut twice as finely. Its miss, the error that cutting into "
        "links makes at a fast tip, may be as large as the uncertainty of the plan, and 3 mm in any case. If that is "
        "too much, plan with shorter links."
    )

    def __init__(self, plan: WhipPlan, impact: Impact | None = None) -> None:
        super().__init__(plan)
        self.impact, target, seen, finer = impact, plan.target, plan.outcome, plan.finer_outcome
        self.title = "A planned whip" if plan.success else "No whip found that meets its target"
        whipped = "is" if plan.success else "is to be"
        self.task = (
            f"A rope on a motor-driven arm {whipped} whipped, so that its tip passes a point at a peak of its speed."
        )
        self.target = (
            f"x = {target.x:.4g} m, y = {target.y:.4g} m, {_direction(target)}, at {target.least_speed:.3g} m/s or more"
        )
        self.verdict = f"No whip that meets the target was found: {plan.message}."
        if plan.success and seen is not None:
            self.verdict = (
                f"The tip passes the target at {seen.speed:.1f} m/s, {length(seen.miss, 2)} off, in simulation."
            )
            if impact is not None and impact.message:
                self.verdict += f" A peg there is not struck by the tip: {impact.message}."
            finer_fails = f"With links of half the length {finer.message}." if finer and finer.message else ""
            self.warning = " ".join(filter(None, (self.torque_warning(), finer_fails)))
        self.tiles, self.story = self._tiles(), self._story()

    def _tiles(self) -> tuple[tuple[str, str], ...]:
        target, seen, impact = self.plan.target, self.plan.outcome, self.impact
        shown = [(f"{target.x:.4g}, {target.y:.4g} m", "target: x and y (up)")]
        if self.plan.moves is not None:
            shown.append((self.move_count(), "of the arm to and fro"))
        if seen is not None:
            required = f"{target.least_speed:.3g} are required"
            shown.append((f"{seen.speed:.1f} m/s", f"speed of the tip at its peak; {required}"))
            shown.append((length(seen.miss, 2), "miss: from the target to the tip at its peak"))
            if not target.any_direction:
                off, allowed = np.degrees([seen.angle_error, target.angle_tolerance])
                shown.append((f"{off:.1f} degrees", f"off the required direction; {allowed:.3g} allowed"))
            shown.append((f"{seen.t:.2f} s", "after the start the tip's speed peaks"))
        shown += self.arm_tiles()
        if impact is not None and impact.success:
            words = f"impulse of the impact on a small peg of {1e3 * impact.radius:g} mm at the target"
            shown.append((f"{1e3 * impact.impulse:.1f} mN s", words))
        return tuple(shown)

    def _story(self) -> tuple[str, ...]:
        lines, seen = self._start(), self.plan.outcome
        if seen is not None:
            lines.append(_peak(seen))
            if seen.touches_later:
                lines.append(f"After the peak the rope touches {seen.touches_later}, if nothing stops it.")
        if self.impact is not None:
            lines.append(_impact(self.impact))
        return (*lines, *self._end("the place of the peak"))

    def overlay(self) -> Overlay:
        """Return notes, target and obstacles, and when the tip's speed peaks."""
        return replace(super().overlay(), targets=self.plan.target.point[None])

    def note_texts(self) -> tuple[str, str]:
        """Return target and peak."""
        target, seen = self.plan.target, self.outcome
        place = f"target: x = {target.x:.4g} m, y = {target.y:.4g} m, {target.least_speed:.3g} m/s or more"
        return place, f"passes it at {seen.t:.2f} s: {seen.speed:.1f} m/s, {length(seen.miss, 2)} off"

    def figures(self) -> "dict[str, Figure]":
        """Draw the rope about the peak, the tip's path past the target, and the time course."""
        target, run, seen = self.plan.target, self.run, self.outcome
        away = Plot("distance of the tip from the target", "m", (Line("", np.hypot(*(run.tip - target.point).T)),))
        required = (target.least_speed, f"{target.least_speed:.3g} m/s are required")
        speed = Panel(speed_plot(run), "speed", (GREEN,), required, f"peak at {seen.t:.2f} s: {seen.speed:.1f} m/s")
        return {
            "peak": self.strobe_at(seen.t, 0.5, 0.1, "ring: the target"),
            "passing": self._passing(),
            "course": time_course(run, "the whip", (speed, Panel(away, "distance")), self.moves(), seen.t),
        }

    def _passing(self) -> "Figure":
        """Draw the tip near the target: its path, coloured by its speed, and the required direction."""
        target, seen = self.plan.target, self.outcome
        half = max(0.12, 1.3 * seen.miss)  # m about the target
        time = 2.0 * half / max(seen.speed, 1e-3)
        with new_figure(7.0, 5.6, "How the tip passes the target, simulated") as figure:
            axis = _closeup(figure, self, target.point, "the target", half, (seen.t - time, seen.t + time))
            place, size = 1e3 * (seen.place - target.point), 550.0 * half
            if not target.any_direction:
                along = np.array([np.cos(target.direction), np.sin(target.direction)])
                _draw_arrow(axis, np.zeros(2), size * along, RED, "required direction")
            along = seen.velocity / max(seen.speed, 1e-9)
            _draw_arrow(axis, place, size * along, INK, f"velocity at the peak, {seen.speed:.1f} m/s")
            axis.plot(0.0, 0.0, "o", ms=13.0, mfc="none", mec=RED, mew=1.8, label="target")
            axis.plot(*place, "o", ms=4.5, color=INK, label=f"tip at its peak, {length(seen.miss, 2)} off")
            draw_obstacles(axis, self.plan.problem.obstacles, 8.0 * half, origin=target.point, scale=1e3)
            legend(figure, axis, place="lower center", columns=2)
        return figure


class InsertReport(TipReport[InsertPlan]):
    """The report of a planned insertion. For a plan without strokes it is a page with the reason."""

    name, strobe = "insert", "entry"
    layout: ClassVar = {
        "The insertion": {
            "film": "The planned insertion, simulated: arm, rope (ochre), path of the tip (green), walls (red).",
            "gap": "How the rope goes through the gap: the tip's path, coloured by its speed, and the rope; simulated.",
            "entry": "The rope until the tip is inside, early instants dark, late ones bright; simulated.",
        },
        "Time course": {
            "course": "Arm angle, speed of the tip, its depth beyond the walls, and torque over time. Dashed: inside."
        },
    }
    columns: ClassVar = {
        "links": lambda seen: str(seen.n_links),
        "inside": lambda seen: f"{seen.t:.3f} s",
        "depth": lambda seen: length(seen.depth, 2),
        "speed": lambda seen: f"{seen.speed:.2f} m/s",
        "clear of the walls": lambda seen: f"{1e3 * seen.wall_clearance:.1f} mm",
    }
    runs = ("as planned", "2.5 times the links")
    runs_note = (
        "The second run makes the same strokes between the same walls with 2.5 times the links, a fifth of the "
        "tolerance and half the step in contact."
    )

    def __init__(self, plan: InsertPlan) -> None:
        super().__init__(plan)
        slot, seen = plan.target, plan.outcome
        self.title = "A planned insertion" if plan.success else "No way through the slot found"
        swung, end = "is" if plan.success else "is to be", "." if slot.touching else " and touches neither."
        self.task = (
            f"A rope on a motor-driven arm {swung} swung so that its tip goes through a slot between two walls{end}"
        )
        self.verdict = f"No way through the slot was found: {plan.message}."
        if plan.success and seen is not None:
            clear = f"and the rope keeps clear of them by {length(seen.wall_clearance, 2)}"
            touches = "and the rope touches them on its way, as it may" if seen.wall_clearance <= 0.0 else clear
            self.verdict = (
                f"The tip is {length(slot.depth)} beyond the walls at {seen.t:.2f} s, {touches}, in simulation."
            )
        self.warning = self.torque_warning()
        tube = f", in a tube of {length(slot.tube)}" if slot.tube > 0.0 else ""
        slow = f", with {slot.max_speed:g} m/s at most" if math.isfinite(slot.max_speed) else ""
        self.target = (
            f"a slot at x = {slot.x:.3g} m, y = {slot.y:.3g} m, {length(slot.width)} wide, between walls of "
            f"{length(slot.wall)}; way in: {np.degrees(slot.direction):.3g} degrees (0 is +x, 90 up), "
            f"{length(slot.depth)} deep{tube}{slow}"
        )
        self.tiles, self.story = self._tiles(), self._story()

    def _tiles(self) -> tuple[tuple[str, str], ...]:
        plan, slot, seen = self.plan, self.plan.target, self.plan.outcome
        shown = [(length(slot.width), "width of the slot"), (length(slot.depth), "required depth beyond the walls")]
        if plan.moves is not None:
            shown.append((self.move_count(), "of the arm to and fro"))
        if seen is not None:
            shown.append((length(seen.wall_clearance, 2), "least distance of the rope from the walls until then"))
            shown.append((f"{seen.speed:.2f} m/s", "speed of the tip inside"))
            shown.append((f"{seen.t:.2f} s", "after the start the tip is inside"))
            shown.append((length(seen.depth, 2), "greatest depth before it leaves, touches or the run ends"))
        if (chance := plan.success_probability) is not None:
            words = "success probability with a slot 2 mm and strokes 2 ms off, unless planned for something else"
            if math.isfinite(plan.problem.limits.torque):
                words += "; the torque of the motor is not checked there"
            shown.append((f"{100 * chance.estimate:.0f} %", words) if chance.samples else ("?", f"{words}: {chance}"))
        return (*shown, *self.arm_tiles())

    def _story(self) -> tuple[str, ...]:
        lines, seen = self._start(), self.plan.outcome
        if seen is not None:
            lines.append(
                f"The tip comes between the walls at {seen.t_enter:.2f} s, and is inside at {seen.t:.2f} s; it stays "
                f"beyond the walls without a touch for {seen.time_inside:.2f} s of the run."
            )
        if self.plan.success_probability is not None:
            lines.append(f"Success probability: {self.plan.success_probability}.")
        return (*lines, *self._end("where the rope crosses the gap"))

    def note_texts(self) -> tuple[str, str]:
        """Return slot and entry."""
        slot, seen = self.plan.target, self.outcome
        end = f"inside at {seen.t:.2f} s: {seen.speed:.2f} m/s, {length(seen.wall_clearance, 2)} clear"
        return f"slot: x = {slot.x:.3g} m, y = {slot.y:.3g} m, {length(slot.width)} wide", end

    def figures(self) -> "dict[str, Figure]":
        """Draw the rope until the tip is inside, its way through the gap, and the time course."""
        slot, run, seen = self.plan.target, self.run, self.outcome
        inside = f"inside at {seen.t:.2f} s: {seen.speed:.2f} m/s"
        depth = Line("", (run.tip - slot.point) @ slot.axes[0])
        deep = Plot("depth of the tip beyond the line of the walls", "m", (depth,))
        required = (slot.depth, f"{1e3 * slot.depth:.3g} mm are required")
        panels = Panel(speed_plot(run), "speed", (GREEN,), event=inside), Panel(deep, "depth", (BLUE,), required)
        return {
            "entry": self.strobe_at(seen.t_enter, 0.6, seen.t - seen.t_enter + 0.05, "red: the walls"),
            "gap": self._gap(),
            "course": time_course(run, "the insertion", panels, self.moves(), seen.t),
        }

    def _gap(self) -> "Figure":
        """Draw the rope in the gap: path of the tip, coloured by its speed, and the rope at several instants."""
        slot, run, seen = self.plan.target, self.run, self.outcome
        half = max(1.6 * slot.depth, 1.5 * slot.width)  # m about the gap
        time = max(seen.t - seen.t_enter, 0.02)
        with new_figure(7.0, 6.0, "How the rope goes through the gap, simulated") as figure:
            axis = _closeup(figure, self, slot.point, "the middle of the gap", half, (seen.t_enter - time, seen.t))
            ropes = 1e3 * (shapes(run, np.linspace(seen.t_enter, seen.t, 5)).joints - slot.point)
            for rope, alpha in zip(ropes, np.linspace(0.25, 1.0, 5), strict=True):
                axis.plot(*rope.T, color=INK, lw=1.2, alpha=alpha)
            axis.plot([], [], color=INK, lw=1.2, label="rope, from the entry to the required depth")
            for number, wall in enumerate(slot.walls):
                ends = 1e3 * (np.array(wall_ends(wall)) - slot.point)
                axis.plot(*ends.T, color=RED, lw=4.0, solid_capstyle="butt", label="" if number else "walls")
            inner, across = 1e3 * slot.depth * slot.axes[0], 500.0 * slot.width * slot.axes[1]
            axis.plot(*np.transpose([inner - across, inner + across]), color=GREY, ls="--", label="required depth")
            tip = f"tip inside, {seen.speed:.2f} m/s"
            axis.plot(*(1e3 * (seen.place - slot.point)), "o", ms=5.0, color=INK, label=tip)
            legend(figure, axis, place="lower center", columns=2)
        return figure


def _closeup(
    figure: "Figure", report: TipReport[Any], point: Array, name: str, half: float, times: tuple[float, float]
) -> Any:
    """Return axes in mm about a point with the path of the tip between two times, s, in the colour of its speed."""
    from matplotlib.collections import LineCollection

    run = report.run
    t = np.linspace(max(times[0], run.t[0]), min(times[1], run.t[-1]), 400)
    path = 1e3 * (shapes(run, t).joints[:, -1] - point)
    axis: Any = figure.subplots()
    pieces, speed = list(np.stack([path[:-1], path[1:]], axis=1)), np.interp(t, run.t, np.hypot(*run.tip_velocity.T))
    lines = LineCollection(pieces, array=speed[:-1], cmap="viridis_r", linewidths=2.6)
    axis.add_collection(lines)
    figure.colorbar(lines, ax=axis, label="speed of the tip, m/s", shrink=0.8)
    limits = (-1e3 * half, 1e3 * half)
    axis.set(xlim=limits, ylim=limits, aspect="equal", xlabel=f"x from {name}, mm", ylabel=f"y from {name}, mm (up)")
    return axis


def _draw_arrow(axis: Any, start: Array, way: Array, colour: str, label: str) -> None:
    """Draw an arrow from a point (2,) along a vector (2,), and name it in the legend."""
    style = {"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", start + way, start, arrowprops=style)
    axis.plot([], [], color=colour, lw=2.0, label=label)


def _direction(target: TipTarget) -> str:
    """Return in which direction the tip must pass."""
    if target.any_direction:
        return "in any direction"
    tolerance, direction = np.degrees([target.angle_tolerance, target.direction])
    return f"within {tolerance:.3g} degrees of the direction {direction:.3g} (0 is +x, 90 up)"


def _peak(seen: TipStrike) -> str:
    direction = np.degrees(np.arctan2(*seen.velocity[::-1]))
    before = f"it reached {seen.earlier_speed:.1f} before"
    if seen.earlier_speed <= seen.speed:
        before = "it was slower at all times before"
    return (
        f"At {seen.t:.2f} s the tip's speed peaks at {seen.speed:.2f} m/s ({before}), {length(seen.miss, 2)} from "
        f"the target, in the direction {direction:.0f} degrees."
    )


def _impact(impact: Impact) -> str:
    if impact.message:
        return f"A small peg behind the target is not struck by the tip: {impact.message}."
    return (
        f"Impact: a fixed peg of {1e3 * impact.radius:g} mm radius just behind the target, struck by the rope's "
        f"link {impact.link + 1}, takes up {1e3 * impact.impulse:.1f} mN s in {1e3 * impact.duration:g} ms "
        f"({1e3 * impact.impulse_along:.1f} mN s in the tip's direction), and the rope loses "
        f"{1e3 * impact.energy:.0f} mJ."
    )
