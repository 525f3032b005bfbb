"""The figure of a cast that was carried out: the drive and its goals, and how far the rope was from the plan."""

from typing import TYPE_CHECKING

import numpy as np

from hyperflex.report.style import BLUE, GREY, INK, RED, Figure, legend, new_figure

if TYPE_CHECKING:
    from hyperflex.execution import CastRun


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
