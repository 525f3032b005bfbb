"""Who throws, in words: the rope, the arm, and what is asked of the motor."""

from __future__ import annotations

import math

import numpy as np

from hyperflex.motion import Motion
from hyperflex.planning import CastSetup, MotorLimits
from hyperflex.report.tables import TextTable
from hyperflex.trajectory import Trajectory

NOT_KNOWN = "not known"


def rope_words(cast_setup: CastSetup) -> str:
    """Return what the rope is, without a full stop."""
    rope = cast_setup.rope
    name = f" ({rope.name})" if rope.name else ""
    tip = f", tip weight {1e3 * rope.tip_mass:.3g} g" if rope.tip_mass else ""
    return (
        f"Rope{name}: {rope.total_length:.4g} m, {1e3 * rope.total_mass:.4g} g, radius {1e3 * rope.radius:.3g} mm, "
        f"{rope.n_links} links{tip}"
    )


def arm_words(cast_setup: CastSetup) -> str:
    """Return how long the arm is."""
    return f"Arm: {1e3 * cast_setup.arm.length:.4g} mm."


def asked_of_motor(limits: MotorLimits, motion: Motion | None, run: Trajectory | None) -> TextTable:
    """Return what a motion asks of the motor, and the rope in a run of it, beside what the motor can do."""
    if motion is None:
        return TextTable(("motor", "asked", "limit"), ())
    t = np.linspace(0.0, float(motion.breaks[-1]), 4001)
    torque = NOT_KNOWN if run is None else f"{np.abs(run.motor_torque).max():.3g} N m"
    most = f"{limits.torque:.3g} N m" if math.isfinite(limits.torque) else "none given"
    rows = (
        ("greatest speed", f"{np.abs(motion.rate(t)).max():.3g} rad/s", f"{limits.speed:.3g} rad/s"),
        (
            "greatest acceleration",
            f"{np.abs(motion.acceleration(t)).max():.3g} rad/s²",
            f"{limits.acceleration:.3g} rad/s²",
        ),
        ("greatest torque for the rope", torque, most),
    )
    return TextTable(("motor", "asked", "limit"), rows)
