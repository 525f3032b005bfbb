"""The figure of an identified drive: goal, measured and modelled angle, and what the model misses."""

import numpy as np

from hyperflex.errors import InvalidInput
from hyperflex.hardware import DriveFit
from hyperflex.report.style import BLUE, GREY, RED, Figure, legend, new_figure


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
