"""Predicted measurements of a window, with derivatives by state and parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import Drive
from hyperflex.core.integrate.rollout import Limits
from hyperflex.core.tangent.extrapolation import Directions, place_changes
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.identification.fit.windows import Window
from hyperflex.identification.model.parameters import ARM, Parameter, Parameters, parse
from hyperflex.model import Arm, Rope, Setup, divided, parse_label
from hyperflex.motion import Motion, hold_arm
from hyperflex.sensors import Angles, Markers, MotorTorque, PostureSensor
from hyperflex.simulation import (
    ParameterDirections,
    finish_rollout,
    forward_derivatives,
    prepare_rollout,
    record_steps,
    rollout_limits,
)

# Factors that are tested, and cannot be free: of the angles and torque as read, and of the arm's length
ANGLES, TORQUE, ARM_LENGTH = "angle_factor", "torque_factor", "arm_length"
PRECISION = 1e-7  # tolerance of a rollout over the rope's length, far below any measured angle's error
# Steps of a rollout, beyond which it counts as failed: real ropes take some tens a second. A rope whose last
# link has hardly an inertia turns it at 1e3 rad/s, and a fit that goes there would take minutes.
MOST_STEPS, MOST_STEPS_A_SECOND = 2000, 1000


@dataclass(frozen=True)
class _Evaluation:
    """All that follows from one x."""

    rope: Rope
    chain: Chain
    motion: Motion | None
    arm: Arm | None
    drive: Drive
    sensor: PostureSensor
    motor: MotorTorque | None
    moving: list[int]  # which parameters move the rope
    directions: ParameterDirections  # state first, then those
    seeds: Directions  # the same for the kernels


@dataclass(frozen=True)
class PredictedChannels:
    """Predicted channels (m, C), and their derivatives by the state (m, C, 2 n) and the parameters (m, C, P)."""

    channels: Array
    state: Array
    shared: Array


@dataclass(eq=False)
class Plant:
    """Predicts the channels of a window, those of `sensor` and, with `torque`, of the arm's motor as the last.

    `motion` and `arm` move the first joint; by default it is fixed.
    """

    parameters: Parameters
    sensor: PostureSensor = field(default_factory=Angles)
    motion: Motion | None = None
    arm: Arm | None = None
    torque: bool = False

    def __post_init__(self) -> None:
        guess = self.parameters.guess
        self.motor = MotorTorque(self.arm) if self.torque and self.arm is not None else None
        self._setup = Setup(guess, self.motion, self.arm, tol=PRECISION * guess.total_length)
        self._last: tuple[bytes | None, _Evaluation | None] = (None, None)
        # parameters that are values of the sensor or, numbered after those, of the motor: number, number of the value
        places = {"origin_x": 0, "origin_y": 1, ANGLES: 0}
        if self.motor is not None:
            places |= {name: self.sensor.values.size + k for k, name in enumerate(ARM)}
        own = [places.get(p.name, 2 + p.links[0] if p.name == "arc" else None) for p in self.parameters.all]
        self._own = [(k, place) for k, place in enumerate(own) if place is not None]

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: not the last evaluation, whose arrays could be written to then; no kernel's may."""
        return vars(self) | {"_last": (None, None)}

    def cut(self, x: Array, pieces: int) -> "Plant":
        """Return the same at x, without free parameters, each link cut into pieces; InvalidInput where none can be."""
        at = self._at(x)
        if at is None:
            raise InvalidInput("the parameters describe no rope", got=x)
        return Plant(Parameters(divided(at.rope, pieces), []), at.sensor, at.motion, at.arm)

    def predict(self, x: Array, t: Array, state: Array) -> Array | None:
        """Return the channels (m, C) at times t (m,) from `state` (2n,) at t[0]; None where the rollout fails."""
        at = self._at(x)
        y = None if at is None else self._run(at, t, state)
        seen = None if at is None or y is None else self._channels(at, t, y)
        return seen if seen is not None and np.isfinite(seen).all() else None

    def propagate(self, x: Array, t: float, state: Array, until: float) -> Array | None:
        """Return the state (2n,) at `until`, s, from `state` at t; None where the rollout fails."""
        at = self._at(x)
        y = None if at is None else self._run(at, np.array([t, until]), state)
        return None if y is None or not np.isfinite(y[-1]).all() else np.asarray(y[-1, : state.size].copy())

    def jacobian(self, x: Array, t: Array, state: Array) -> PredictedChannels | None:
        """Return the same with exact derivatives, or None."""
        at = self._at(x)
        if at is None or not np.isfinite(state).all():
            return None
        n, start = at.rope.n_links, (state[: state.size // 2], state[state.size // 2 :])
        try:
            run = record_steps(at.chain, at.drive, start, self._limits(at, t), float(t[0]), t=t)
            _, dy = forward_derivatives(run, at.directions, start, t, at.seeds)
        except SimulationError:
            return None
        y, count = run.y[-t.size :], len(at.directions.names)
        q, dy = y[:, :n], dy[:, :, :count]
        dpivot = np.zeros((t.size, 2, at.directions.width))
        if self.sensor.placed:
            place_changes(at.drive, at.seeds, np.array(t), dpivot)
        seen, own = self._channels(at, t, y), at.sensor.value_jacobian(at.rope, q)
        moved = at.sensor.jacobian(at.rope, q, dy[:, :n], dpivot[:, :, :count], at.directions.lengths(n))
        if at.motor is not None:
            by_run = at.motor.jacobian(at.chain, at.drive, at.directions.parts[2 * n :], t, y, dy)
            moved, by_sensor = np.concatenate([moved, by_run[:, None]], axis=1), own
            own = np.zeros((*moved.shape[:2], own.shape[2] + len(ARM)))
            own[:, :-1, : -len(ARM)] = by_sensor
            own[:, -1, -len(ARM) :] = at.motor.value_jacobian(at.chain, at.drive, t, y)
        shared = np.zeros((*moved.shape[:2], len(self.parameters)))
        shared[:, :, at.moving] = moved[:, :, 2 * n :]
        for k, place in self._own:
            shared[:, :, k] = self.parameters.all[k].derivative(float(x[k])) * own[:, :, place]
        if not (np.isfinite(seen).all() and np.isfinite(moved).all()):
            return None
        return PredictedChannels(seen, moved[:, :, : 2 * n], shared)

    def residual(self, x: Array, window: Window, state: Array) -> Array | None:
        """Return weighted prediction errors (m C,), 0 in gaps."""
        seen = self.predict(x, window.t, state)
        return None if seen is None else ((seen - window.y) * window.weight).ravel()

    def _limits(self, at: _Evaluation, t: Array) -> Limits:
        return rollout_limits(self._setup, at.chain, float(t[-1]))

    def _run(self, at: _Evaluation, t: Array, state: Array) -> Array | None:
        """Return the rollout's states at t (m,) from `state` (2n,), or None where it fails or takes too many steps."""
        if not np.isfinite(state).all():
            return None
        n = at.rope.n_links
        run = prepare_rollout(at.chain, at.drive, (state[:n], state[n:]), t, self._limits(at, t))
        most = max(MOST_STEPS, MOST_STEPS_A_SECOND * float(t[-1] - t[0])) / run.limits.budget
        return run.y if finish_rollout(run, most=most) == status.OK else None

    def _channels(self, at: _Evaluation, t: Array, y: Array) -> Array:
        """Return the channels (m, C) of states y (m, 2n or more)."""
        moved = self.sensor.placed and (self.motion is not None or self.arm is not None)
        pivot = pivot_places(at.motion, at.arm, t) if moved else np.zeros((t.size, 2))
        seen = at.sensor.predict(at.rope, y[:, : at.rope.n_links], pivot)
        return seen if at.motor is None else np.column_stack([seen, at.motor.predict(at.chain, at.drive, t, y)])

    def _at(self, x: Array) -> _Evaluation | None:
        key = x.tobytes()
        if self._last[0] != key:
            self._last = (key, self._prepared(x))
        return self._last[1]

    def _prepared(self, x: Array) -> _Evaluation | None:
        """Return what follows from x, or None where x describes no rope."""
        rope = self.parameters.possible(x)
        if rope is None:
            return None
        motion, arm, drive = self.motion, self.arm, self._setup.drive()
        delay, longer = self.parameters.single("delay", x), self.parameters.single(ARM_LENGTH, x, 1.0)
        if motion is not None and (delay != 0.0 or longer != 1.0):
            arm = None if arm is None else replace(arm, length=longer * arm.length)
            motion = motion.shifted(delay)
            drive = Setup(self.parameters.guess, motion, arm).drive()
        own = np.append(self.sensor.values, [] if self.motor is None else self.motor.values)
        for k, place in self._own:
            own[place] = self.parameters.all[k].value(x[k])
        sensor = self.sensor.with_values(own[: self.sensor.values.size])
        motor = None if self.motor is None else self.motor.with_values(own[self.sensor.values.size :])
        moving, unit = self.parameters.parts(x, rope), np.eye(rope.n_links)
        parts = [{name: row} for name in ("q0", "qd0") for row in unit]
        for _, part in moving:
            if "delay" in part:
                breaks = np.full(drive.breaks.size, part["delay"][0])
                part = {"breaks": breaks, "coef": np.zeros_like(drive.coef)}
            if ARM_LENGTH in part:
                part = {ARM_LENGTH: part[ARM_LENGTH] * drive.arm_length / longer}
            parts.append(part)
        chain, directions = rope.chain(), ParameterDirections(tuple(map(str, range(len(parts)))), tuple(parts))
        seeds, freed = directions.directions(chain, drive), [k for k, _ in moving]
        return _Evaluation(rope, chain, motion, arm, drive, sensor, motor, freed, directions, seeds)


def pivot_places(motion: Motion | None, arm: Arm | None, t: Array) -> Array:
    """Return the places of the first joint (m, 2), m, in the frame of its motion."""
    motion = motion or hold_arm(0.0)
    place: Array = motion.point(t)
    return place if arm is None else place + arm.tip(motion.angle(t))


def extended(plant: Plant, x: Array, words: Sequence[str]) -> tuple[Plant, Array, list[list[Parameter]]]:
    """Return the model at x (P,) with more free parameters, its x, and these word by word; words that fail are out."""
    rope, groups = plant.parameters.rope(plant.parameters.rounded(x)), []
    arcs = plant.sensor.arc_lengths if isinstance(plant.sensor, Markers) else None
    for word in words:
        if word in (ANGLES, TORQUE, ARM_LENGTH):
            groups.append([Parameter(word, (), word, 1.0, 1.0, "factor")])
            continue
        label = parse_label(word.removesuffix(":pivot"))
        if word.endswith(":pivot") and label is not None:
            if getattr(rope, label.name)[0] > 0.0:
                every = tuple(range(rope.n_links))
                groups.append([Parameter(label.name, every, word, 1.0, 1.0, "pivot")])
            continue
        try:
            arm = None if plant.motor is None else plant.arm
            groups.append(parse(rope, [word], arcs, moved=plant.motion is not None, arm=arm))
        except InvalidInput:  # a mass of 0 has no logarithm, say
            continue
    extra = [each for group in groups for each in group]
    parameters = Parameters(plant.parameters.guess, [*plant.parameters.all, *extra])
    return replace(plant, parameters=parameters), np.append(x, [each.first for each in extra]), groups


def scale_words(plant: Plant) -> dict[int, str]:
    """Return the words for what has a scale and is held, by number: links' lengths, gravity, the arm's length, torque.

    With lengths, what goes with those of uniform links goes along.
    """
    driven = plant.motion is not None and plant.arm is not None and plant.arm.length > 0.0
    heavy, names = plant.parameters.guess.gravity.any(), plant.parameters.names
    held = ("length" not in names, heavy and "gravity_scale" not in names, driven, plant.motor is not None)
    words = ("length:factor", "gravity_scale", ARM_LENGTH, TORQUE)
    return {k: word for k, (word, own) in enumerate(zip(words, held, strict=True)) if own}
