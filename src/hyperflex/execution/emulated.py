"""An emulated drive with the rope of a plan behind it, and that rope as a source of its state."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hyperflex.checks import Array, ByName
from hyperflex.errors import InvalidInput
from hyperflex.execution.cast_run import observed_turns
from hyperflex.hardware import Emulator, MotorModel, emulated_device
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.planning import CastPlan, scaled_rope


def motor_model(make: str) -> MotorModel:
    """Return the emulated motor of a make: that of a moteus goes on at its goal's rate."""
    return MotorModel(extrapolates=make == "moteus")


def emulator_of(plan: CastPlan, address: str, model: MotorModel | None = None, **changes: Any) -> tuple[str, Emulator]:
    """Return the make and the emulator of "emulator:MAKE" for a plan: its arm, its target, and its rope, cut near it.

    The arm hangs down at first.

    Parameters
    ----------
    plan : CastPlan
    address : str
        "emulator:moteus", for example.
    model : MotorModel, optional
        The emulated motor; by default that of :func:`motor_model`.
    **changes
        Further arguments of :class:`hyperflex.hardware.emulate.Emulator`, or another `rope` or `obstacles`.

    Raises
    ------
    InvalidInput
        If the address is none of an emulator.
    """
    found = emulated_device(address)
    if found is None:
        raise InvalidInput("the motor is not emulated", got=address, allowed="emulator:MAKE")
    make, device = found
    rope, pegs = plan.setup().rope, (plan.target, *plan.problem.obstacles)
    given: ByName = {"rope": rope, "arm": plan.problem.arm, "obstacles": pegs}
    return make, Emulator(device, model or motor_model(make), **given | {"duration": 120.0} | changes)


class EmulatedRope:
    """The true state of an emulated rope, as that of the plan's rope (a :class:`ClockedSource`): no camera sees it.

    Links of the emulated rope must be parts of those of `rope`, or of a rope of another length with as many links.
    """

    contact = True

    def __init__(self, emulator: Emulator, rope: Rope, emulated: Rope, arm: Arm) -> None:
        self.emulator, self.emulated, self.arm = emulator, emulated, arm
        self.rope = scaled_rope(rope, emulated.total_length / rope.total_length, 1.0, 1.0)  # as long as it really is
        self._parts: dict[float, tuple[RopeState, float]] = {}  # states of all parts, and the arm's angle, by time
        ends, share = (each.link_ends / each.total_length for each in (rope, emulated))
        self._ends = np.searchsorted(ends, share - 1e-9)  # the link of the plan's rope that each part belongs to
        self._zero = time.monotonic()

    def start_clock(self, at: float | None = None) -> None:
        """Make a moment of the monotonic clock, s, or now, t = 0."""
        self._zero = time.monotonic() if at is None else at
        self._parts = {}

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the newest state; `t` and `motion` are not used."""
        at, arm_angle, q, qd = self.emulator.rope_state()
        now = at - self._zero
        self._parts[now] = RopeState(now, q, qd), arm_angle
        return RopeState(now, *self._joined(q, qd))

    def turns(self, arm_angle: Callable[[Array], Array], peg: Peg, side: int, rope: Rope) -> tuple[Array, Array]:
        """Return the times (T,) at which states were returned, s, and the true turns about a peg (T, 2), both alike."""
        parts = [self._parts[t] for t in sorted(self._parts)]
        turns = [observed_turns(self.emulated, self.arm, *each, peg) for each in parts]
        return np.array([state.t for state, _ in parts]), np.repeat(np.array(turns)[:, None], 2, axis=1)

    def _joined(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Angles and rates of the chords of the links that are made of parts."""
        length, n = self.emulated.length, self.rope.n_links
        x, y, u, v = (
            np.bincount(self._ends, length * part, n)
            for part in (np.sin(q), -np.cos(q), np.cos(q) * qd, np.sin(q) * qd)
        )
        angle = np.arctan2(x, -y)
        whole = np.bincount(self._ends, q, n) / np.bincount(self._ends, minlength=n)
        angle += 2.0 * np.pi * np.round((whole - angle) / (2.0 * np.pi))
        return angle, (u * np.cos(angle) + v * np.sin(angle)) / np.hypot(x, y)
