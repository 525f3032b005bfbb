"""Whether a motor is fast and strong enough for a half turn of the arm, and for given plans."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hyperflex import checks, files
from hyperflex.checks import Array, ByName
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, MotorLimits, Rope
from hyperflex.motion import Motion, move_arm
from hyperflex.options import check, option


@dataclass(frozen=True)
class MotorData:
    """What a motor can do at its shaft, from its data sheet; the torque falls linearly with the speed.

    Parameters
    ----------
    name : str
    speed : float
        Without load at the voltage used, rad/s.
    stall_torque : float
        At rest, N m; where the controller limits the torque, that limit.
    voltage : float
        V.
    counts : int
        Encoder steps per turn; 0 if not known.
    watchdog : float
        Shortest time, s, after which the device stops by itself; inf without one.
    make : str
        As in the address of :func:`hyperflex.hardware.open_link`; empty if it is of no make known here.
    source : str
        Where the figures are from.
    """

    name: str
    speed: float = option(math.nan, "Speed without load.", "rad/s", sign="positive")
    stall_torque: float = option(math.nan, "Torque at rest.", "N m", sign="positive")
    voltage: float = option(12.0, "Voltage of the supply.", "V", sign="positive")
    counts: int = 0
    watchdog: float = math.inf
    make: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        check(self, "motor")

    def torque(self, speed: Array) -> Array:
        """Return the greatest driving torque at speeds, rad/s, of any sign: N m."""
        return self.stall_torque * np.maximum(0.0, 1.0 - np.abs(speed) / self.speed)

    def at(self, voltage: float) -> "MotorData":
        """Return the motor at another voltage, V: speed and stall torque in proportion."""
        factor = checks.positive("voltage", voltage, "V") / self.voltage
        return replace(self, voltage=voltage, speed=factor * self.speed, stall_torque=factor * self.stall_torque)


@functools.cache
def motor_catalogue() -> Mapping[str, MotorData]:
    """Return common drives by name, with the sources of their figures.

    Examples
    --------
    >>> round(motor_catalogue()["XL430-W250"].speed, 2)
    6.39
    """
    tables: ByName = files.read_toml(Path(__file__).with_name("catalogue.toml"))
    return {
        name: MotorData(name, speed=table.pop("speed_rpm") * math.tau / 60.0, **table) for name, table in tables.items()
    }


def find_motor(name: str) -> MotorData:
    """Return a motor of the catalogue; letters of either case. Raises InvalidInput with the names there are."""
    motors = {each.lower(): motor for each, motor in motor_catalogue().items()}
    if name.lower() not in motors:
        raise InvalidInput(
            "motor is not in the catalogue",
            got=name,
            allowed=", ".join(motor_catalogue()),
            fix="Or give speed, torque and voltage",
        )
    return motors[name.lower()]


@dataclass(frozen=True)
class Demand:
    """What a motion asks of a motor.

    Attributes
    ----------
    name : str
        The motion's.
    speed : float
        Greatest speed, rad/s.
    torque : float
        Greatest torque, N m: inertia of the arm, and weight of arm and rope, which hangs straight down.
    margin : float
        Least of what the motor has left over what it has, of speed and of torque at the speed of each instant; negative
        if the motion is not possible, at least -1.
    """

    name: str
    speed: float
    torque: float
    margin: float

    @property
    def possible(self) -> bool:
        """Whether the motor can make the motion."""
        return self.margin >= 0.0


@dataclass(frozen=True)
class Suitability:
    """Result of :func:`check_motor`.

    Attributes
    ----------
    motor : MotorData
    holding_torque : float
        That holds the hanging rope and the arm at a quarter turn, N m.
    demands : tuple of Demand
        Of a half turn, bang-bang and with minimum jerk, then those that were given.
    limits : MotorLimits
        What a planner may ask of the motor: see :func:`check_motor`.
    """

    motor: MotorData
    holding_torque: float
    demands: tuple[Demand, ...]
    limits: MotorLimits

    @property
    def success(self) -> bool:
        """Whether a half turn is possible in one of the two ways, and whatever else was demanded."""
        return any(each.possible for each in self.demands[:2]) and all(each.possible for each in self.demands[2:])


def check_motor(
    motor: MotorData,
    rope: Rope,
    arm: Arm | None = None,
    move_time: float = 0.5,
    *more: Demand,
) -> Suitability:
    """Check whether a motor can turn an arm with a rope by half a turn in a time, and meet further demands.

    Parameters
    ----------
    motor : MotorData
        Of :func:`find_motor`, or made from a data sheet.
    rope : Rope
    arm : Arm, optional
        By default the paper's.
    move_time : float
        Time of a half turn, s.
    *more : Demand
        Of plans, for example, each with its own arm and rope: :func:`demand`.

    Returns
    -------
    Suitability
        Its limits are speed and acceleration of the fastest half turn, bang-bang, with a tenth of the motor unused.

    Notes
    -----
    The rope's pull is its weight at the arm's tip; that of a swinging rope is up to some times as large, which a plan's
    own torque shows.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, friction=5e-4)
    >>> found = check_motor(find_motor("XL430-W250"), cable, move_time=0.5)
    >>> [round(each.speed * 60 / (2 * math.pi), 1) for each in found.demands], round(found.holding_torque, 3)
    ([120.0, 112.5], 0.129)
    """
    arm = arm or Arm()
    move_time = checks.positive("move_time", move_time, "s")
    hanging = float(arm.weight_torque(rope, rope.hanging_angle + 0.5 * math.pi))
    half = (-0.5 * math.pi, 0.5 * math.pi, move_time)
    quick, smooth = move_arm(*half, "bang-bang"), move_arm(*half, "minimum-jerk")
    turns = {"half turn, bang-bang": quick, "half turn, minimum jerk": smooth}
    demands = (*(demand(motor, name, each, rope, arm) for name, each in turns.items()), *more)
    return Suitability(motor, hanging, demands, _limits(motor, hanging, arm.inertia + arm.mass * arm.com**2))


def demand(motor: MotorData, name: str, motion: Motion, rope: Rope, arm: Arm, torque: float = 0.0) -> Demand:
    """Return what a motion asks of a motor with an arm and a rope; a simulated run of it may show a greater `torque`.

    That torque, N m, may be needed at any speed: it is compared with the torque at rest.
    """
    times = np.linspace(motion.breaks[0], motion.breaks[-1], 2001)
    angle, speed = motion.angle(times), motion.rate(times)
    weight = np.append(-rope.total_mass * rope.gravity, 0.0)
    needed = arm.shaft_torque(rope.gravity, angle, speed, motion.acceleration(times)) + arm.rope_torque(angle, weight)
    driving = needed * speed > 0.0  # a braking torque is not limited by the speed
    most = np.where(driving, motor.torque(speed), motor.stall_torque)
    left = np.minimum(1.0 - np.abs(needed) / np.maximum(most, 1e-12), 1.0 - np.abs(speed) / motor.speed)
    spare = max(-1.0, min(float(left.min()), 1.0 - torque / motor.stall_torque))
    return Demand(name, float(np.abs(speed).max()), max(float(np.abs(needed).max()), torque), spare)


def _limits(motor: MotorData, hanging: float, inertia: float, used: float = 0.9) -> MotorLimits:
    """Return the limits of the fastest half turn (bang-bang) that a part `used` of the motor's torque can make.

    At its greatest speed v it takes the torque inertia v^2 / pi + hanging, which must be left there.
    """
    torque = used * motor.stall_torque
    if torque <= hanging:
        raise InvalidInput(
            "motor is too weak to hold the hanging rope",
            got=motor.stall_torque,
            allowed=f"more than {hanging / used:.3g} N m",
            fix="Use a shorter arm or a lighter rope",
        )
    slope, spare = torque / (used * motor.speed), torque - hanging
    speed = 2.0 * spare / (slope + math.sqrt(slope**2 + 4.0 * inertia / math.pi * spare))
    return MotorLimits(speed=speed, acceleration=speed**2 / math.pi, torque=torque)
