"""``hyperflex vibrate``: the posture that a vibration holds, or the vibration and motor that a posture takes."""

from pathlib import Path
from typing import Annotated

import numpy as np

from hyperflex import control, report
from hyperflex.checks import ByName
from hyperflex.cli import output
from hyperflex.cli.command import ArmLength, Given, check_destination
from hyperflex.cli.output import Rows
from hyperflex.control import VibrationPosture
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, MotorLimits, Rope


def vibrate(
    rope: Annotated[Path, "TOML file with the rope."],
    *,
    tilt: Annotated[float | None, "Tilt to hold, rad: 0 hangs, 1.57 is horizontal, 3.14 is upright."] = None,
    stiffness: Annotated[float | None, "Required stiffness of the tip", "N/m"] = None,
    push: Annotated[
        float | None,
        "Direction of the stiffness, rad, as a link's angle. [default: across the tilt]",
    ] = None,
    amplitude: Annotated[float | None, "Amplitude of the rope's first joint", "m"] = None,
    frequency: Annotated[float | None, "Frequency of the vibration", "Hz"] = None,
    direction: Annotated[float | None, "Line of the vibration, rad: 0 is vertical, 1.57 horizontal."] = None,
    arm_length: ArmLength = None,
    limits: Annotated[Given, MotorLimits],
    out: Annotated[Path | None, "Picture of tilt over amplitude and frequency, .png."] = None,
) -> None:
    """Hold a rope at a tilt against gravity by vibrating the arm, or list the postures of a vibration.

    With --tilt the command finds the weakest vibration that holds this tilt, and compares the motor that it requires
    with the limits; the exit code is 4 if the motor is too weak. With --amplitude, --frequency and --direction it lists
    the postures.
    """
    if out is not None:
        check_destination(out, ".png", [rope])
    cord, motor = Rope.from_toml(rope), MotorLimits(**limits)
    arm = Arm() if arm_length is None else Arm(length=arm_length)
    if tilt is None:
        if amplitude is None or frequency is None or direction is None:
            raise InvalidInput(
                "nothing to hold is given", fix="Give --tilt, or --amplitude, --frequency and --direction"
            )
        if stiffness is not None:
            raise InvalidInput("a stiffness is required of a tilt", got="--stiffness", fix="Give --tilt, or omit it")
        found = control.vibration_posture(cord, amplitude, frequency, direction, arm=arm)
        result: ByName = {"postures": [_posture(each, push) for each in found]}
        shown, code = Rows("Postures", [(str(k + 1), repr(each)) for k, each in enumerate(found)]), 0
    else:
        if amplitude is not None:
            raise InvalidInput("the amplitude follows from the tilt", got="--amplitude", fix="Omit it, or --tilt")
        plan = control.plan_vibration(
            cord, tilt, motor, arm=arm, stiffness=stiffness, push=push, frequency=frequency, direction=direction
        )
        found = [] if plan.posture is None else [plan.posture]
        result = {"posture": _posture(found[0], push) if found else None, "message": plan.message}
        result |= {"motor": plan.motor and plan.motor._asdict(), "missing": plan.missing}
        rows = [("posture", repr(each)) for each in found]
        if m := plan.motor:
            rows.append(("motor", f"{m.speed:.3g} rad/s, {m.acceleration:.3g} rad/s^2, {m.torque:.3g} N m"))
        rows += [("NOT possible", plan.message)] if plan.message else []
        shown, code = Rows("Vibration", rows), 0 if plan.success else output.ExitCode.NO_PLAN
    if out is not None and found:
        first = found[0]
        parts = np.linspace(0.05, 2.5, 50)
        ways = parts * first.amplitude
        ways = ways[ways < arm.length]
        report.save_png(
            control.vibration_map(cord, ways, parts * first.frequency, first.direction, arm=arm).plot(motor), out
        )
        result["picture"] = out
    output.show(result, shown, code=code)


def _posture(found: VibrationPosture, push: float | None) -> ByName:
    """Return the numbers of a posture."""
    across = found.tilt + 0.5 * np.pi if push is None else push
    return {
        "tilt_rad": found.tilt,
        "q_rad": found.q,
        "stable": found.stable,
        "amplitude_m": found.amplitude,
        "frequency_Hz": found.frequency,
        "direction_rad": found.direction,
        "averaging_holds": found.holds,
        "least_frequency_Hz": found.least_frequency,
        "slow_frequencies_Hz": found.frequencies,
        "ripple_rad": np.abs(found.ripple),
        "tip_stiffness_N_m": found.stiffness(across),
    }
