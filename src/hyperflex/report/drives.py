"""Figures of drives: one that was identified, a cast that was carried out, and learning from casts."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hyperflex.errors import InvalidInput
from hyperflex.hardware import DriveFit
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, Figure, legend, new_figure

if TYPE_CHECKING:
    from hyperflex.execution import Attempt, CastRun


def drive_figure(fit: DriveFit) -> "Figure":
    """Draw the test motion of an identified drive: goals, measured and modelled angle, and their difference."""
    record = fit.record
    if record is None:
        raise InvalidInput(
            "an identified drive from a file has no record to draw", fix="Plot what identify_drive returned"
        )
    grid, angle, *_ = fit.model.respond(record.sent, record.goal, record.goal_rate)
    times, modelled = record.read_at, np.interp(record.read_at, grid, angle)
    missed = record.angle - modelled
    missed -= np.nanmedian(missed)  # of the zero
    fast = times[int(np.nanargmax(np.abs(np.gradient(record.goal, record.sent))))]
    with new_figure(9.0, 6.6, f"Test motion of a drive: {fit.describe()}") as figure:
        axes = figure.subplot_mosaic([["all", "all"], ["near", "missed"]])
        for name in ("all", "near"):
            axis = axes[name]
            axis.plot(record.sent, np.degrees(record.goal), color=GREY, label="goal")
            axis.plot(times, np.degrees(record.angle), ".", color=BLUE, ms=2.5, label="measured")
            axis.plot(grid, np.degrees(angle), color=RED, lw=0.8, label="model")
            axis.set(xlabel="time, s", ylabel="degrees")
        axes["all"].set(title="Angle of the arm")
        axes["near"].set(title="The fast stroke", xlim=(fast - 0.4, fast + 0.8))
        axes["missed"].plot(times, np.degrees(missed), ".", color=BLUE, ms=2.0)
        axes["missed"].set(title="Measured less model", xlabel="time, s", ylabel="degrees")
        legend(figure, axes["all"], columns=3)
    return figure


def cast_run_figure(run: "CastRun") -> "Figure":
    """Draw a run: the arm's angle and its goal, the tracking error, the torque, and the deviation of tip and middle."""
    sent, moves = run.log.column("sent"), (run.follow or run.plan).moves
    stop = run.motion.end - (0.0 if moves is None else moves.dwell)
    some = sent >= 0.0
    t = sent[some]
    with new_figure(7.2, 6.4) as figure:
        angle, error, torque, away = figure.subplots(4, 1, sharex=True, height_ratios=[2, 1, 1, 1.5])
        angle.plot(t, run.log.column("goal_angle")[some], color=GREY, linewidth=2.5, label="goal")
        angle.plot(t, run.log.column("angle")[some], color=BLUE, linewidth=1.2, label="arm")
        angle.set(ylabel="angle, rad")
        words = run.message or "the rope is wound"
        angle.set_title(f"{run.motor}: {words}".removeprefix(": "), loc="left", wrap=True)
        error.plot(t, 1e3 * run.log.tracking_error[some], color=BLUE, linewidth=1.0)
        error.set(ylabel="error, mrad")
        torque.plot(t, run.log.column("torque")[some], color=BLUE, linewidth=1.0)
        if run.prediction is not None:
            torque.plot(run.prediction.t, run.prediction.torque, color=GREY, linewidth=1.0, label="torque planned")
        torque.set(ylabel="torque, N m")
        if run.deviation is None:
            away.text(0.5, 0.5, "the rope was not observed", transform=away.transAxes, ha="center", va="center")
        else:
            times, distance = run.deviation
            middle = distance.shape[1] // 2
            for k, colour, name in ((middle, RED, "middle of the rope"), (-1, INK, "tip")):
                away.plot(times, 1e3 * distance[:, k], color=colour, linewidth=1.2, label=name)
        away.set(ylabel="off the plan, mm", xlabel="time, s")
        for axis in (angle, error, torque, away):
            axis.axvline(stop, color=GREY, linewidth=0.8, linestyle=":")
        angle.set_xlim(0.0, max(float(np.max(t, initial=stop)), stop))
        legend(figure, angle, torque, away, place="lower center", columns=5)
    return figure


def learning_figure(ways: "Mapping[str, Sequence[Attempt]]") -> "Figure":
    """Draw the attempts of one or more ways of learning: distance from the strike that winds, and what wound.

    `ways` are attempts by the name of their way, four at most.
    """
    with new_figure(6.4, 3.8, "Learning from each cast") as figure:
        axis = figure.subplots()
        for (name, attempts), colour in zip(ways.items(), (BLUE, RED, GREEN, GREY), strict=False):
            number = np.array([each.number for each in attempts])
            distance = np.array([1e3 * each.position for each in attempts])
            axis.plot(number, distance, color=colour, label=name)
            wound = np.array([bool(each.wound) for each in attempts])
            for some, face in ((wound, colour), (~wound, "white")):
                axis.scatter(number[some], distance[some], s=46, facecolor=face, edgecolor=colour, zorder=3)
        for face, label in ((INK, "wound"), ("white", "missed")):
            axis.scatter([], [], s=46, facecolor=face, edgecolor=INK, label=label)
        axis.set(xlabel="cast", ylabel="distance from the strike aimed at, mm", yscale="log")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}")
        axis.set_xticks(range(1, 1 + max(len(attempts) for attempts in ways.values())))
        legend(figure, axis, place="lower center", columns=6)
    return figure
