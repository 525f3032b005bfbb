"""The reports of plans for the rope's tip, whips and insertions: figures and film."""

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning import Impact, InsertPlan, WhipPlan
from hyperflex.report.curves import speed_plot
from hyperflex.report.pictures import draw_obstacles, pieces
from hyperflex.report.plan import PlanReport
from hyperflex.report.scene import Line, Overlay, Plot, shapes, wall_ends
from hyperflex.report.style import GREY, INK, RED, Axes, Figure, legend, new_figure
from hyperflex.report.units import length
from hyperflex.trajectory import Trajectory


class WhipReport(PlanReport[WhipPlan]):
    """The report of a planned whip, and of its impact on a small peg at the target, if one was simulated.

    For a plan without strokes it is a page with the reason.
    """

    name, noun, strobe = "whip", "whip", "peak"
    captions: ClassVar = {
        "film": "The planned whip, simulated: arm, rope (ochre), path of the tip (green), target (red ring).",
        "peak": "The rope about the peak, early instants dark, late ones bright; simulated.",
        "passing": "How the tip passes the target: its path, coloured by its speed; simulated.",
        "course": "Arm angle, speed of the tip, its distance from the target, and torque over time. Dashed: peak.",
    }

    def __init__(self, plan: WhipPlan, impact: Impact | None = None) -> None:
        self.impact = impact
        super().__init__(plan)

    def overlay(self) -> Overlay:
        """Return notes, target and obstacles, and when the tip's speed peaks."""
        return replace(super().overlay(), targets=self.plan.target.point[None])

    def strobe_of_event(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the rope about the peak."""
        return self.strobe_at(self.outcome.t, 0.5, 0.1, "ring: the target", ax)

    def figures(self) -> "dict[str, Figure]":
        """Draw the rope about the peak, the tip's path past the target, and the time course."""
        target, run, seen = self.plan.target, self.run, self.outcome
        speed = speed_plot(run)._replace(level=(target.least_speed, f"{target.least_speed:.3g} m/s are required"))
        away = Plot("distance of the tip from the target", "m", (Line("", np.hypot(*(run.tip - target.point).T)),))
        return {
            "peak": self.strobe_of_event(),
            "passing": self._passing(),
            "course": self.course(f"peak at {seen.t:.2f} s: {seen.speed:.1f} m/s", speed, away),
        }

    def _passing(self) -> "Figure":
        """Draw the tip near the target: its path, coloured by its speed, and the required direction."""
        from matplotlib.transforms import Affine2D

        target, seen = self.plan.target, self.outcome
        half = max(0.12, 1.3 * seen.miss)  # m about the target
        time = 2.0 * half / max(seen.speed, 1e-3)
        place, along = 1e3 * (seen.place - target.point), seen.velocity / max(seen.speed, 1e-9)
        with new_figure(7.0, 5.6, "How the tip passes the target, simulated") as figure:
            axis = _closeup(figure, self.run, target.point, "the target", half, (seen.t - time, seen.t + time))
            arrows = [(place, along, INK, f"velocity at the peak, {seen.speed:.1f} m/s")]
            if not target.any_direction:
                required = np.array([np.cos(target.direction), np.sin(target.direction)])
                arrows.insert(0, (np.zeros(2), required, RED, "required direction"))
            style = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.006}
            for start, way, colour, label in arrows:
                axis.quiver(*start, *(550.0 * half * way), color=colour, label=label, **style)
            axis.plot(0.0, 0.0, "o", ms=13.0, mfc="none", mec=RED, label="target")
            axis.plot(*place, "o", color=INK, label=f"tip at its peak, {length(seen.miss, 2)} off")
            place = Affine2D().translate(*-target.point).scale(1e3)
            draw_obstacles(axis, self.plan.problem.obstacles, 8.0 * half, place)
            legend(figure, axis, place="lower center", columns=2)
        return figure


class InsertReport(PlanReport[InsertPlan]):
    """The report of a planned insertion. For a plan without strokes it is a page with the reason."""

    name, noun, strobe = "insert", "insertion", "entry"
    captions: ClassVar = {
        "film": "The planned insertion, simulated: arm, rope (ochre), path of the tip (green), walls (red).",
        "gap": "How the rope goes through the gap: the tip's path, coloured by its speed, and the rope; simulated.",
        "entry": "The rope until the tip is inside, early instants dark, late ones bright; simulated.",
        "course": "Arm angle, speed of the tip, its depth beyond the walls, and torque over time. Dashed: inside.",
    }

    def strobe_of_event(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the rope until the tip is inside."""
        seen = self.outcome
        return self.strobe_at(seen.t_enter, 0.6, seen.t - seen.t_enter + 0.05, "red: the walls", ax)

    def figures(self) -> "dict[str, Figure]":
        """Draw the rope until the tip is inside, its way through the gap, and the time course."""
        slot, run, seen = self.plan.target, self.run, self.outcome
        depth = Line("", (run.tip - slot.point) @ slot.axes[0])
        required = (slot.depth, f"{1e3 * slot.depth:.3g} mm are required")
        deep = Plot("depth of the tip beyond the line of the walls", "m", (depth,), required)
        inside = f"inside at {seen.t:.2f} s: {seen.speed:.2f} m/s"
        return {
            "gap": self._gap(),
            "entry": self.strobe_of_event(),
            "course": self.course(inside, speed_plot(run), deep),
        }

    def _gap(self) -> "Figure":
        """Draw the rope in the gap: path of the tip, coloured by its speed, and the rope at several instants."""
        slot, run, seen = self.plan.target, self.run, self.outcome
        half = max(1.6 * slot.depth, 1.5 * slot.width)  # m about the gap
        time = max(seen.t - seen.t_enter, 0.02)
        with new_figure(7.0, 6.0, "How the rope goes through the gap, simulated") as figure:
            axis = _closeup(figure, run, slot.point, "the middle of the gap", half, (seen.t_enter - time, seen.t))
            ropes = 1e3 * (shapes(run, np.linspace(seen.t_enter, seen.t, 5)).joints - slot.point)
            for rope, alpha in zip(ropes, np.linspace(0.25, 1.0, 5), strict=True):
                axis.plot(*rope.T, color=INK, lw=1.2, alpha=alpha)
            axis.plot([], [], color=INK, label="rope, from the entry to the required depth")
            for label, wall in zip(("walls", ""), slot.walls, strict=True):
                ends = 1e3 * (np.array(wall_ends(wall)) - slot.point)
                axis.plot(*ends.T, color=RED, lw=4.0, solid_capstyle="butt", label=label)
            inner, across = 1e3 * slot.depth * slot.axes[0], 500.0 * slot.width * slot.axes[1]
            axis.plot(*np.transpose([inner - across, inner + across]), color=GREY, ls="--", label="required depth")
            tip = f"tip inside, {seen.speed:.2f} m/s"
            axis.plot(*(1e3 * (seen.place - slot.point)), "o", color=INK, label=tip)
            legend(figure, axis, place="lower center", columns=2)
        return figure


def _closeup(
    figure: "Figure", run: Trajectory, point: Array, name: str, half: float, times: tuple[float, float]
) -> Any:
    """Return axes in mm about a point with the path of the tip between two times, s, in the colour of its speed."""
    from matplotlib.collections import LineCollection

    t = np.linspace(max(times[0], run.t[0]), min(times[1], run.t[-1]), 400)
    path = 1e3 * (shapes(run, t).joints[:, -1] - point)
    axis: Any = figure.subplots()
    speed = np.interp(t, run.t, np.hypot(*run.tip_velocity.T))
    lines = LineCollection(pieces(path), array=speed[:-1], cmap="viridis_r", linewidths=2.6)
    axis.add_collection(lines)
    figure.colorbar(lines, ax=axis, label="speed of the tip, m/s", shrink=0.8)
    limits = (-1e3 * half, 1e3 * half)
    axis.set(xlim=limits, ylim=limits, aspect="equal", xlabel=f"x from {name}, mm", ylabel=f"y from {name}, mm (up)")
    return axis
