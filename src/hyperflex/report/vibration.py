"""The map of a posture by vibration: tilt over amplitude and frequency, and what a motor reaches."""

import math
from typing import Any

import numpy as np

from hyperflex.control import VibrationMap
from hyperflex.model import MotorLimits
from hyperflex.report.style import GREEN, GREY, RED, Figure, legend, new_figure


def vibration_figure(found: VibrationMap, limits: MotorLimits | None = None) -> "Figure":
    """Draw the tilt over amplitude and frequency, and what a motor of these limits reaches with the map's arm."""
    line, rope = math.degrees(found.direction), found.rope
    title = (
        f"Tilt of a rope of {rope.total_length:.3g} m, vibrated along {line:.3g} degrees\n"
        "0 hangs, 90 is horizontal, 180 is upright; averaged equations"
    )
    with new_figure(7.6, 5.4, title) as figure:
        axis: Any = figure.subplots()
        ways, tilt = 1e3 * found.amplitude, np.ma.masked_invalid(np.degrees(found.tilt))
        axis.grid(visible=False)
        mesh = axis.pcolormesh(ways, found.frequency, tilt, alpha=np.where(found.holds, 1.0, 0.35), cmap="YlGnBu")
        figure.colorbar(mesh, ax=axis, label="tilt, degrees")
        axis.plot([], [], "s", color="#b9c6d8", ms=9.0, label="pale: averaging does not apply")
        axis.plot([], [], "s", color="white", mec=GREY, ms=9.0, label="white: not held")
        if limits is not None and found.arm is not None:
            omega, reach = math.tau * found.frequency, 1e3 * found.arm.length
            for way, colour, name in (
                (reach * limits.speed / omega, GREEN, "limit of the motor's speed"),
                (reach * limits.acceleration / omega**2, RED, "limit of the motor's acceleration"),
            ):
                axis.plot(way, found.frequency, color=colour, label=name)
        axis.set(xlim=ways[[0, -1]], ylim=found.frequency[[0, -1]])
        axis.set(xlabel="amplitude of the first joint, mm", ylabel="frequency, Hz")
        legend(figure, axis, place="lower center", columns=2)
    return figure
