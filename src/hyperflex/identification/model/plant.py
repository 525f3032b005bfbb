"""Predicted measurements of a window, with derivatives by state and parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
    motion: Motion
    arm: Arm | None
    drive: Drive
    sensor: PostureSensor
    motor: MotorTorque | None
    moving: list[int]  # which parameters move the rope
    parameter_directions: ParameterDirections  # state first, then those
    seeds: Directions  # the same for the kernels


@dataclass(frozen=True)
class PredictedChannels:
    """Predicted channels (m, C), and their derivatives by the state (m, C, 2 n) and the parameters (m, C, P)."""

    channels: Array
    state: Array
    shared: Array


class Plant:
    """Predicts the channels of a window, those of `sensor` and, with `torque`, of the arm's motor as the last.

    `motion` and `arm` move the first joint; by default it is fixed.
    """

    def __init__(
        self,
        parameters: Parameters,
        sensor: PostureSensor | None = None,
        motion: Motion | None = None,
        arm: Arm | None = None,
        *,
        torque: bool = False,
    ) -> None:
        self.parameters, self.sensor = parameters, sensor or Angles()
        self.motion, self.arm = motion, arm
        self.motor = MotorTorque(arm) if torque and arm is not None else None
        self._setup = Setup(parameters.guess, motion, arm, tol=PRECISION * parameters.guess.total_length)
        self._last: tuple[bytes | None, _Evaluation | None] = (None, None)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: not the last evaluation, whose arrays could be written to then; no kernel's may."""
        return vars(self) | {"_last": (None, None)}

    def without_torque(self) -> "Plant":
        """Return the same without the torque channel."""
        return self if self.motor is None else Plant(self.parameters, self.sensor, self.motion, self.arm)

    def with_parameters(self, parameters: Parameters) -> "Plant":
        """Return the same with other free parameters."""
        return Plant(parameters, self.sensor, self.motion, self.arm, torque=self.motor is not None)

    def cut(self, x: Array, pieces: int) -> "Plant":
        """Return the same at x, without free parameters, each link cut into pieces; InvalidInput where none can be."""
        at = self._at(x)
        if at is None:
            raise InvalidInput("the parameters describe no rope", got=x)
        rope = divided(at.rope, pieces)
        return Plant(Parameters(rope, []), at.sensor, None if self.motion is None else at.motion, at.arm)

    def predict(self, x: Array, t: Array, state: Array) -> Array | None:
        """Return the channels (m, C) at times t (m,) from `state` (2n,) at t[0]; None where the rollout fails."""
        at = self._at(x)
        if at is None or not np.isfinite(state).all():
            return None
        y = self._run(at, t, state)
        if y is None:
            return None
        seen = self._channels(at, t, y)
        return seen if np.isfinite(seen).all() else None

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
            _, dy = forward_derivatives(run, at.parameter_directions, start, t, at.seeds)
        except SimulationError:
            return None
        y = run.y[-t.size :]
        q, dq = y[:, :n], dy[:, :n, : len(at.parameter_directions.names)]
        dpivot = np.zeros((t.size, 2, at.parameter_directions.width))
        if self.sensor.placed:
            place_changes(at.drive, at.seeds, np.array(t), dpivot)
        dpivot = dpivot[:, :, : dq.shape[2]]
        seen = self._channels(at, t, y)
        moved = at.sensor.jacobian(at.rope, q, dq, dpivot, at.parameter_directions.lengths(n))
        shared = np.zeros((*moved.shape[:2], len(self.parameters)))
        shared[:, :, at.moving] = moved[:, :, 2 * n :]
        self._add_own(at, q, shared)
        if at.motor is not None:
            torque = self._torque_jacobian(at, at.motor, t, y, dy)
            moved, shared = (
                np.concatenate([before, added[:, None]], axis=1)
                for before, added in zip((moved, shared), torque, strict=True)
            )
        if not (np.isfinite(seen).all() and np.isfinite(moved).all()):
            return None
        return PredictedChannels(seen, moved[:, :, : 2 * n], shared)

    def residual(self, x: Array, window: Window, state: Array) -> Array | None:
        """Return weighted prediction errors (m C,), 0 in gaps."""
        seen = self.predict(x, window.t, state)
        return None if seen is None else ((seen - window.y) * window.weight).ravel()

    def _add_own(self, at: _Evaluation, q: Array, shared: Array) -> None:
        """Write the derivatives with respect to the sensor's own values to their columns."""
        own = at.sensor.value_jacobian(at.rope, q)
        for k, parameter in enumerate(self.parameters.all):
            if (place := _place(parameter.name, parameter.links)) is not None:
                shared[:, :, k] = parameter.scale * own[:, :, place]

    def _torque_jacobian(
        self, at: _Evaluation, motor: MotorTorque, t: Array, y: Array, dy: Array
    ) -> tuple[Array, Array]:
        """Return the derivatives of the motor's torque: (m, 2n + D) as the run's, and (m, P) by the parameters."""
        n = at.rope.n_links
        parts = at.parameter_directions.parts[2 * n :]
        moved = motor.jacobian(at.chain, at.drive, parts, t, y, dy[:, :, : len(at.parameter_directions.names)])
        shared = np.zeros((t.size, len(self.parameters)))
        shared[:, at.moving] = moved[:, 2 * n :]
        own = motor.value_jacobian(at.chain, at.drive, t, y)
        for k, parameter in enumerate(self.parameters.all):
            if parameter.name in ARM:
                shared[:, k] = parameter.scale * own[:, ARM.index(parameter.name)]
        return moved, shared

    def _limits(self, at: _Evaluation, t: Array) -> Limits:
        return rollout_limits(self._setup, at.chain, float(t[-1]))

    def _run(self, at: _Evaluation, t: Array, state: Array) -> Array | None:
        """Return the rollout's states at t (m,) from `state` (2n,), or None where it fails or takes too many steps."""
        n = at.rope.n_links
        run = prepare_rollout(at.chain, at.drive, (state[:n], state[n:]), t, self._limits(at, t))
        most = max(MOST_STEPS, MOST_STEPS_A_SECOND * float(t[-1] - t[0])) / run.limits.budget
        return run.y if finish_rollout(run, most=most) == status.OK else None

    def _channels(self, at: _Evaluation, t: Array, y: Array) -> Array:
        """Return the channels (m, C) of states y (m, 2n or more)."""
        moved = self.sensor.placed and (self.motion is not None or self.arm is not None)
        pivot = pivot_places(at.motion, at.arm, t) if moved else np.zeros((t.size, 2))
        seen = at.sensor.predict(at.rope, y[:, : at.rope.n_links], pivot)
        if at.motor is None:
            return seen
        return np.column_stack([seen, at.motor.predict(at.chain, at.drive, t, y)])

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
        motion, drive = self.motion or hold_arm(0.0), self._setup.drive()
        delay, longer = self.parameters.single("delay", x), self.parameters.single(ARM_LENGTH, x, 1.0)
        arm = self.arm if self.arm is None else replace(self.arm, length=longer * self.arm.length)
        if self.motion is not None and (delay != 0.0 or longer != 1.0):
            motion = self.motion.shifted(delay)
            drive = Setup(self.parameters.guess, motion, arm).drive()
        own = self.sensor.values.copy()
        for parameter, each in zip(self.parameters.all, x, strict=True):
            if (place := _place(parameter.name, parameter.links)) is not None:
                own[place] = parameter.value(each)
        motor = self.motor
        if motor is not None:
            held = zip(ARM, motor.values, strict=True)
            motor = motor.with_values(np.array([self.parameters.single(name, x, value) for name, value in held]))
        moving = self.parameters.parts(x, rope)
        n = rope.n_links
        unit = np.eye(n)
        parts = [{"q0": row} for row in unit] + [{"qd0": row} for row in unit]
        for _, part in moving:
            if "delay" in part:
                breaks = np.full(drive.breaks.size, part["delay"][0])
                part = {"breaks": breaks, "coef": np.zeros_like(drive.coef)}
            if ARM_LENGTH in part:
                part = {ARM_LENGTH: part[ARM_LENGTH] * drive.arm_length / longer}
            parts.append(part)
        names = tuple(str(k) for k in range(len(parts)))
        chain, directions = rope.chain(), ParameterDirections(names, tuple(parts))
        seeds, freed = directions.directions(chain, drive), [k for k, _ in moving]
        return _Evaluation(
            rope, chain, motion, arm, drive, self.sensor.with_values(own), motor, freed, directions, seeds
        )


def _place(name: str, markers: tuple[int, ...]) -> int | None:
    """Return which of the values of :class:`hyperflex.sensors.Markers` a parameter is."""
    if name == "arc":
        return 2 + markers[0]
    return {"origin_x": 0, "origin_y": 1, ANGLES: 0}.get(name)


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
    return plant.with_parameters(parameters), np.concatenate([x, [each.first for each in extra]]), groups


def scale_words(plant: Plant) -> dict[int, str]:
    """Return the words for what has a scale and is held, by number: links' lengths, gravity, the arm's length, torque.

    With lengths, what goes with those of uniform links goes along.
    """
    driven = plant.motion is not None and plant.arm is not None and plant.arm.length > 0.0
    heavy, names = plant.parameters.guess.gravity.any(), plant.parameters.names
    held = ("length" not in names, heavy and "gravity_scale" not in names, driven, plant.motor is not None)
    words = ("length:factor", "gravity_scale", ARM_LENGTH, TORQUE)
    return {k: word for k, (word, own) in enumerate(zip(words, held, strict=True)) if own}
