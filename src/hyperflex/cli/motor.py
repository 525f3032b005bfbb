"""``hyperflex motor check``, ``identify`` and ``zero``: is it fast enough, how does it move, where is its zero."""

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hyperflex import execution, hardware, planning, report
from hyperflex.cli import output
from hyperflex.cli.command import ArmLength, Given, check_destination
from hyperflex.cli.output import Rows
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, MotorLimits, Rope

RPM = 60.0 / math.tau  # rev/min per rad/s
Address = Annotated[str, "Make and port, such as moteus:/dev/ttyACM0, or emulator:moteus."]
ZeroFile = Annotated[Path | None, "File of hyperflex motor zero; a real motor that is to move needs it."]
Yes = Annotated[bool, "Do not wait for Enter before the arm of a real motor moves."]

ClearFault = Annotated[bool, "Clear a fault of the device at the start."]


def check(
    plans: Annotated[
        list[Path] | None, typer.Argument(help="Files of plans (cast.toml, ...) that the motor is to carry out.")
    ] = None,
    *,
    rope: Annotated[Path, "TOML file with the rope that hangs from the arm."],
    motor: Annotated[str | None, "Name in the catalogue, such as XC330-M181."] = None,
    rpm: Annotated[float | None, "Speed without load", "rev/min"] = None,
    torque: Annotated[float | None, "Torque at rest (stall)", "N m"] = None,
    voltage: Annotated[float | None, "Voltage of your supply", "V", "the data sheet's"] = None,
    arm_length: ArmLength = None,
    move_time: Annotated[float, "Time of a half turn", "s"] = 0.5,
) -> None:
    """Check whether a motor is fast and strong enough, before anything is planned.

    The motor is one of the catalogue, or given by its speed and torque. Its torque is assumed to decrease linearly from
    stall to the speed without load. The command compares it with a half turn of the arm under the hanging rope, and
    with plans: each with its own arm and rope, and the torque of its simulated runs. It prints limits for the planner.
    The exit code is 4 if a half turn or a plan is not possible.
    """
    if motor is not None and (rpm or torque):
        raise InvalidInput("the motor is given twice", fix="Give --motor NAME, or --rpm and --torque")
    if motor is not None:
        data = hardware.find_motor(motor)
        data = data if voltage is None else data.at(voltage)
    elif rpm is None or torque is None:
        raise InvalidInput("no motor is given", fix="Give --motor NAME, or --rpm and --torque")
    else:
        data = hardware.MotorData(
            "your motor", rpm / RPM, torque, voltage or hardware.MotorData.voltage, source="given"
        )
    arm = Arm() if arm_length is None else Arm(length=arm_length)
    required = [
        hardware.demand(
            data, str(path), plan.required(plan.motion, "motion"), plan.problem.rope, plan.problem.arm, plan.torque
        )
        for path, plan in ((path, planning.read_plan(path)) for path in plans or ())
    ]
    found = hardware.check_motor(data, Rope.from_toml(rope), arm, move_time, *required)
    demands = {
        each.name: f"{'possible' if each.possible else 'NOT possible'}: "
        f"{each.speed * RPM:.0f} rev/min, {each.torque:.3g} N m, {_spare(each, data)}"
        for each in found.demands
    }
    limits = {"speed": found.limits.speed, "acceleration": found.limits.acceleration, "torque": found.limits.torque}
    result = {
        "motor": {**asdict(data), "rpm": data.speed * RPM},
        "holding_torque_Nm": found.holding_torque,
        "demands": [{**asdict(each), "possible": each.possible} for each in found.demands],
        "limits": limits,
    }
    words = " ".join(f"--{name} {value:.4g}" for name, value in limits.items())
    output.show(
        result,
        Rows(
            f"{data.name}: {data.speed * RPM:.0f} rev/min, {data.stall_torque:.3g} N m ({data.source})",
            [("holds the hanging rope with", f"{found.holding_torque:.3g} N m"), *demands.items()],
        ),
        f"Limits for cast, whip and insert: {words}",
        code=0 if found.success else output.ExitCode.NO_PLAN,
    )


def _spare(wanted: "hardware.Demand", motor: "hardware.MotorData") -> str:
    if wanted.possible:
        return f"{100 * wanted.margin:.0f} % to spare"
    return "the motor is too slow" if wanted.speed > motor.speed else "the motor is too weak"


def identify(
    motor: Address,
    *,
    out: Annotated[Path, "File for the identified drive, .toml."],
    zero: ZeroFile = None,
    limits: Annotated[Given, MotorLimits],
    stroke: Annotated[float, "Size of the fast strokes; large ones show the limit of speed", "rad"] = 0.3,
    picture: Annotated[Path | None, "Picture of the test motion to write, .png."] = None,
    yes: Yes = False,
    clear_fault: ClearFault = False,
    dry_run: Annotated[bool, "Print what would be done; open and move nothing."] = False,
) -> None:
    """Make a small test motion and identify lag, limits, friction, inertia and backlash of a drive.

    The arm must be free, without a rope. It moves by 0.3 rad, slowly and then faster, and makes strokes as fast as the
    limits allow; large ones (--stroke) show the drive's own limit of speed. A real drive needs a limit of --torque and
    its --zero, and the command waits for Enter. Torque is off before and after. Drives have only been emulated so far.
    """
    import numpy as np

    check_destination(out, ".toml", [])
    check_destination(picture, ".png", [])
    chosen = MotorLimits(**limits)
    if dry_run:
        motion = hardware.plan_test_motion(chosen, 0.0, stroke=stroke)
        angles = motion.angle(motion.breaks)
        plan = {"duration_s": motion.end, "least_angle": angles.min(), "greatest_angle": angles.max()}
        output.show(plan, output.rows("Test motion, from an arm that hangs", plan))
        return
    most, known = min(0.5 + 0.05 * chosen.speed, 0.6 * stroke), read_zero(motor, zero)
    with _drive(motor, chosen, known, max_deviation=most) as connect:
        if hardware.emulated_device(motor) is None:
            check_real(motor, known, chosen)
            wait_for_enter("Take the rope off and keep clear", yes)
        output.note(f"{connect().link.name}: connecting; then the arm makes the test motion")
        record = execution.record_test_motion(connect, stroke=stroke, clear_fault=clear_fault)
    fit = hardware.identify_drive(record)
    fit.to_toml(out)
    written = {"drive": out}
    if picture is not None:
        report.save_png(fit.plot(), picture)
        written["picture"] = picture
    intervals = {name: f" ({low:.4g} to {high:.4g})" for name, (low, high) in fit.intervals.items()}
    rows = [
        (name.replace("_", " "), f"{value:.4g}{intervals.get(name, ', uncertain')}")
        for name, value in fit.values.items()
    ]
    lost = int(np.isnan(record.angle).sum())
    rows.append(("lost replies, omitted", f"{lost} of {record.angle.size}"))
    if "rate_limit" not in fit.values:
        rows.append(("rate limit", f"not reached: above {fit.reached[0]:.3g} rad/s"))
    result = {"values": fit.values, "intervals": fit.intervals, "reached": fit.reached, "doubt": fit.doubt}
    result |= {"lost_replies": lost, "files": written}
    output.show(
        result,
        Rows("Identified drive, SI units, 95 % intervals", rows),
        fit.message or f"Written to {out}.",
        *([f"Doubt: {fit.doubt}"] if fit.doubt else []),
        code=output.ExitCode.NOT_USABLE if fit.message else 0,
    )


def zero(
    motor: Address,
    *,
    out: Annotated[Path, "File for the zero, .toml."],
    angle: Annotated[float, "Angle at which the arm is now, rad; 0 hangs down."] = 0.0,
    direction: Annotated[
        int | None,
        "-1 if the device's angle grows clockwise, else 1. [default: found by a quarter turn by hand]",
    ] = None,
    clear_fault: ClearFault = False,
) -> None:
    """Set the zero of a drive from the arm as it hangs now, with its torque off; nothing moves by itself.

    Then you turn the arm by hand, a quarter turn to +x: this shows the direction, and whether a gear's ratio is set.
    This step is omitted with --direction and for an emulated drive.

    Zero and direction are saved in the file, which identify and run take with --zero. Check the zero again after the
    drive was without power: some drives count turns only while they are powered.
    """
    check_destination(out, ".toml", [])
    with _drive(motor, MotorLimits(), None) as connect:
        drive = connect()
        drive.connect(clear_fault=clear_fault)
        with drive:
            name, raw = drive.link.name, drive.set_zero(0.0)
            if direction is not None:
                output.note("nothing shows whether this direction is right, or whether a gear's ratio is set")
            way = _direction(drive, hardware.emulated_device(motor) is not None) if direction is None else direction
    raw -= way * angle
    hardware.DriveZero(raw, way, motor).to_toml(out)
    result = {"motor": name, "raw_angle": raw, "direction": way, "angle": angle, "files": {"zero": out}}
    shown = [
        ("raw angle of the zero", f"{raw:.4f} rad"),
        ("direction", way),
        ("the arm is at", f"{angle:.4f} rad"),
    ]
    output.show(result, Rows(f"Zero of {name}", [*shown, ("written", out)]))


def _direction(drive: "hardware.Drive", emulated: bool) -> int:
    """Return the direction of a drive that tells raw angles from its zero, from a quarter turn by hand."""
    if emulated:
        return 1
    _press_enter("Turn the arm by hand, a quarter turn to +x, and hold it there. Then Enter")
    turned = drive.read().angle
    if not 1.2 < abs(turned) < 1.9:  # rad: by hand, within 20 degrees
        raise InvalidInput(
            "the drive has seen no quarter turn",
            got=turned,
            allowed="1.2 to 1.9 rad",
            fix="Turn the arm by a quarter turn, or set the ratio of its gear in the drive",
        )
    return 1 if turned > 0.0 else -1


def read_zero(address: str, path: Path | None) -> "hardware.DriveZero | None":
    """Return the zero in a file, None without one; refuse that of another motor, unless this one is emulated."""
    real = hardware.emulated_device(address) is None
    zero = None if path is None else hardware.DriveZero.from_toml(path)
    if zero is not None and real:
        zero.check(address)
    return zero


def check_real(address: str, zero: "hardware.DriveZero | None", limits: MotorLimits) -> None:
    """Refuse a real motor without its zero or a limit of torque, or whose watchdog lets the arm go on for long."""
    if (watchdog := hardware.open_link(address).watchdog) > 0.2:
        what, allowed = "the watchdog of a real motor is too long", "up to 0.2 s"
        raise InvalidInput(what, got=watchdog, allowed=allowed, fix="Remove ?watchdog=")
    lacking = ["needs its zero"] if zero is None else []
    lacking += [] if math.isfinite(limits.torque) else ["moves with a limit of torque only"]
    if lacking:
        fix = "Give --zero, a file of hyperflex motor zero, and --torque, N m"
        raise InvalidInput(f"a real motor {' and '.join(lacking)}", fix=fix)


def wait_for_enter(before: str, yes: bool) -> None:
    """Wait until a person allows that a real arm moves, unless that was allowed before."""
    if not yes:
        _press_enter(f"{before}: the arm will move. Enter switches the torque on")


def _press_enter(text: str) -> None:
    """Wait for Enter; Ctrl-C and an input that has ended are interrupts."""
    try:
        typer.prompt(text, default="", show_default=False, err=True)
    except typer.Abort:
        typer.echo(err=True)
        raise KeyboardInterrupt from None


@contextmanager
def _drive(
    address: str, limits: MotorLimits, zero: "hardware.DriveZero | None", max_deviation: float = 0.5
) -> "Iterator[Callable[[], hardware.Drive]]":
    """Give what returns a drive, or an emulated one that runs as long as the block; its arm has no rope."""
    connect = partial(execution.open_drive, limits=limits, zero=zero, max_deviation=max_deviation)
    device = hardware.emulated_device(address if "?" in address else f"{address}?watchdog=1")  # for a busy computer
    if device is None:
        yield partial(connect, address)
        return
    make, kind = device
    with hardware.Emulator(kind, execution.motor_model(make)) as emulator:
        yield partial(connect, f"{make}:{emulator.port}")
        warn_if_behind(emulator)


def warn_if_behind(emulator: "hardware.Emulator") -> None:
    """Warn where a busy computer has spoiled an emulated motion: motor and rope were slower than the clock."""
    if why := emulator.unfair:
        warnings.warn(f"{why}. Lower this computer's load, or plan with fewer links", UserWarning, stacklevel=2)
