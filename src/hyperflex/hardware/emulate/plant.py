"""An emulated motor that turns an arm with a rope: the physics behind an emulated drive."""

import math
import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from hyperflex import checks, options
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.hardware.drive import Goal
from hyperflex.model import Arm, Obstacle, Rope
from hyperflex.options import option
from hyperflex.simulation import Stepper

GEAR = 0.1, 0.6  # stiffness and damping of gear teeth and stops, in parts of inertia / step^2 and inertia / step


@dataclass(frozen=True)
class MotorModel:
    """An emulated motor with its position loop, seen at the output shaft.

    The torque is kp (goal - angle) + kd (rate of the goal - rate) + the goal's torque, within what the controller and
    the supply allow: at most `max_torque`, and at most stall_torque (voltage / rated voltage - rate / max_speed). At a
    constant speed the angle lags behind by latency + friction / kp, and by another kd / kp if goals come without rates.

    What is read is noisy; the loop has the true values. Not validated against a real drive.
    """

    inertia: float = option(3e-4, "inertia of the rotor", "kg m^2", sign="positive")
    friction: float = option(1e-3, "viscous friction", "N m s/rad", sign="nonnegative")
    dry_friction: float = option(0.0, "Coulomb friction", "N m", sign="nonnegative")
    kp: float = option(20.0, "stiffness of the position loop", "N m/rad", sign="nonnegative")
    kd: float = option(0.2, "damping of the position loop", "N m s/rad", sign="nonnegative")
    latency: float = option(0.0, "time from a goal's arrival to its effect", "s", sign="nonnegative")
    max_torque: float = option(2.0, "greatest torque that the controller applies", "N m", sign="positive")
    max_speed: float = option(40.0, "speed without load at the rated voltage", "rad/s", sign="positive")
    stall_torque: float = option(4.0, "torque at rest that the rated voltage allows", "N m", sign="positive")
    voltage: float = option(24.0, "rated voltage of the supply", "V", sign="positive")
    torque_constant: float = option(0.1, "torque per current", "N m/A", sign="positive")
    backlash: float = option(0.0, "play between the motor, where the encoder is, and the arm", "rad")
    angle_noise: float = option(0.0, "standard deviation of the angle that is read", "rad", sign="nonnegative")
    rate_noise: float = option(0.0, "standard deviation of the rate that is read", "rad/s", sign="nonnegative")
    torque_noise: float = option(0.0, "standard deviation of the torque that is read", "N m", sign="nonnegative")
    ambient: float = option(25.0, "ambient temperature", "C")
    heating: float = option(0.5, "temperature rise per time and square of the torque", "K/(N^2 m^2 s)")
    cooling_time: float = option(100.0, "time constant of cooling", "s", sign="positive")
    extrapolates: bool = option(False, "whether the goal's angle advances with the goal's rate until the next goal")

    def __post_init__(self) -> None:
        options.check(self, "motor")


class Plant:
    """A motor, its arm and a rope that pulls at it, advanced on a clock of its own.

    Angles are raw: those of the encoder on the motor's shaft, which shows the arm's angle until
    :meth:`impose` moves it. The torque of the position loop is held over each step; in between, arm and rope move as
    by :class:`hyperflex.Stepper`. Watchdogs, latched faults and wire formats belong to the devices built on it.

    Parameters
    ----------
    model : MotorModel
    rope : Rope or None
        Not cut at obstacles: give a refined one.
    arm : Arm
        Its inertia and friction are added to the motor's.
    obstacles : sequence of Peg, Wall or Ground
    angle : float
        Of the arm at t = 0, rad, at rest; the rope hangs straight down.
    step : float
        Period of the position loop, s; by default that of common servos.
    tol : float, optional
        As in :class:`hyperflex.Setup`, m.

    Raises
    ------
    InvalidInput
        If a value cannot be used, or the sampled position loop would be unstable.
    """

    def __init__(
        self,
        model: MotorModel,
        rope: Rope | None,
        arm: Arm,
        obstacles: Sequence[Obstacle] = (),
        angle: float = 0.0,
        *,
        step: float = 1e-3,
        tol: float | None = None,
    ) -> None:
        self.model = checks.instance("model", model, MotorModel)
        self.step = checks.positive("step", step, "s")
        if model.backlash > 0.0:  # the rotor turns apart from the arm
            driven = replace(arm, torque_limit=math.inf)
        else:
            own = {name: getattr(arm, name) + getattr(model, name) for name in ("inertia", "friction", "dry_friction")}
            driven = replace(arm, torque_limit=math.inf, **own)
        inertia = driven.inertia + driven.mass * driven.com**2
        turned = model.inertia if model.backlash > 0.0 else inertia  # by the motor, between the teeth
        light = min(inertia, turned)
        self._gear = GEAR[0] * light / self.step**2, GEAR[1] * light / self.step
        most, least = 2.0 * turned / self.step, 0.5 * model.kp * self.step
        if not least <= model.kd < most:
            raise InvalidInput(
                "the sampled position loop is unstable: kd",
                got=model.kd,
                allowed=f"kp step / 2 = {least:.3g} to 2 inertia / step = {most:.3g} N m s/rad",
            )
        rope = rope or Rope.uniform(length=0.01, mass=1e-6, n_links=1, friction=1e-3)  # too light to be felt
        self._stepper = Stepper(rope, command="torque", refine=False, arm=driven, pegs=tuple(obstacles), tol=tol)
        self._ticks, self._now = 0, 0.0
        self.hang(angle)
        self._held = False
        self._offset = 0.0  # of the encoder
        self._stops = -math.inf, math.inf
        self._goals: deque[tuple[float, Goal]] = deque()  # with the time at which each takes effect
        self._goal: tuple[float, Goal] | None = None  # in effect, since when
        self.enabled = False
        self.on_goal: Callable[[Goal], None] = lambda goal: None  # called with each goal, for a log
        self.voltage, self.temperature = model.voltage, model.ambient
        self._torque = 0.0
        self._noise = random.Random(0)

    # ------------------------------------------------------------------ what a device does

    def set_goal(self, goal: Goal) -> None:
        """Give a raw goal now; it takes effect after the latency."""
        self._goals.append((self._now + self.model.latency, goal))
        self.on_goal(goal)

    def set_enabled(self, on: bool) -> None:
        """Switch the torque on, with the present angle as the goal, or off: the shaft then coasts."""
        if on and not self.enabled:
            self._goals.clear()
            self._goal = self._now, Goal(self.angle)
        self.enabled, self._held = on, self._held and not on

    def advance(self, t: float) -> None:
        """Integrate to time t, s, of the plant's own clock."""
        while (self._ticks + 1) * self.step <= t + 1e-9:
            self._tick()
        self._now = max(self._now, t)

    # ------------------------------------------------------------------ what a device sees

    @property
    def t(self) -> float:
        """Time reached, s."""
        return self._now

    @property
    def angle(self) -> float:
        """Raw angle of the encoder, rad."""
        angle, rate = self._rotor
        angle += rate * (self._now - self._ticks * self.step)
        return self._offset + self._noise.gauss(angle, self.model.angle_noise)

    @property
    def rate(self) -> float:
        """Rate of the motor's shaft, rad/s."""
        return self._noise.gauss(self._rotor[1], self.model.rate_noise)

    @property
    def torque(self) -> float:
        """Torque of the motor in the last step, N m."""
        return self._noise.gauss(self._torque, self.model.torque_noise)

    # ------------------------------------------------------------------ what a test or a renderer does

    @property
    def arm_angle(self) -> float:
        """True angle of the arm at the last step, rad."""
        return float(self._state.arm_angle or 0.0)

    @property
    def arm_rate(self) -> float:
        """True rate of the arm at the last step, rad/s."""
        return float(self._state.arm_rate or 0.0)

    def hang(self, angle: float) -> None:
        """Hang the rope from the arm at an angle, rad, and hold both still until the torque is switched on."""
        self._state = self._stepper.start(arm_angle=angle)
        self._rotor = angle, 0.0  # angle and rate, apart from the arm's if there is backlash
        self._held = True

    def rope_state(self) -> tuple[Array, Array]:
        """Return link angles q (n,), rad, and rates qd (n,), rad/s, at the last step."""
        return self._state.q, self._state.qd

    def warm(self) -> None:
        """Load all kernels, so that no later step waits for them; arm and rope stay where they are."""
        setup = self._stepper.setup
        for force in ((0.0, 0.0), (0.0, -1e-9)) if setup.pegs else ((0.0, 0.0),):  # a force: a step as in contact
            Stepper(setup, command="torque", tip_force=force).step(self._state, 0.0, self.step)

    def impose(
        self,
        *,
        voltage: float | None = None,
        temperature: float | None = None,
        stops: tuple[float, float] | None = None,
        encoder_turns: float = 0.0,
    ) -> None:
        """Impose a disturbance from now on.

        Parameters
        ----------
        voltage : float, optional
            Of the supply, V.
        temperature : float, optional
            Of the motor, degrees Celsius; it cools from there.
        stops : (float, float), optional
            Hard stops: least and greatest angle of the arm, rad.
        encoder_turns : float
            Turns by which the encoder jumps.
        """
        self.voltage = self.voltage if voltage is None else voltage
        self.temperature = self.temperature if temperature is None else temperature
        self._stops = self._stops if stops is None else stops
        self._offset += math.tau * encoder_turns

    # ------------------------------------------------------------------ one step

    def _tick(self) -> None:
        if self._held:
            self._ticks += 1
            return
        model, step, now = self.model, self.step, self._ticks * self.step
        while self._goals and self._goals[0][0] <= now + 1e-9:
            self._goal = self._goals.popleft()
        self._torque = self._motor_torque(now) if self.enabled else 0.0
        angle, rate = self._rotor
        load = self._torque
        if model.backlash > 0.0:
            load = self._tooth(
                angle - self.arm_angle, rate - self.arm_rate, -0.5 * model.backlash, 0.5 * model.backlash
            )
            rate += step * (self._torque - load) / model.inertia
            rate /= 1.0 + step * model.friction / model.inertia
            rate = math.copysign(max(0.0, abs(rate) - step * model.dry_friction / model.inertia), rate)
            angle += step * rate
        load -= self._tooth(self.arm_angle, self.arm_rate, *self._stops)
        self._state = self._stepper.step(self._state, load, step)
        self._rotor = (angle, rate) if model.backlash > 0.0 else (self.arm_angle, self.arm_rate)
        self._ticks += 1
        warming = model.heating * self._torque**2 - (self.temperature - model.ambient) / model.cooling_time
        self.temperature += step * warming

    def _motor_torque(self, now: float) -> float:
        """Torque of the position loop, N m, within the limits."""
        if self._goal is None:
            return 0.0
        model, (since, goal), (angle, rate) = self.model, self._goal, self._rotor
        aim = goal.angle - self._offset + (goal.rate * (now - since) if model.extrapolates else 0.0)
        wanted = model.kp * (aim - angle) + model.kd * (goal.rate - rate) + goal.torque
        supply, back = self.voltage / model.voltage, rate / model.max_speed
        least, greatest = model.stall_torque * (-supply - back), model.stall_torque * (supply - back)
        return max(-model.max_torque, least, min(model.max_torque, greatest, wanted))

    def _tooth(self, angle: float, rate: float, least: float, greatest: float) -> float:
        """Torque, N m, of what is hit beyond an angle, rad: it pushes and never pulls."""
        stiffness, damping = self._gear
        if angle > greatest:
            return max(0.0, stiffness * (angle - greatest) + damping * rate)
        if angle < least:
            return min(0.0, stiffness * (angle - least) + damping * rate)
        return 0.0
