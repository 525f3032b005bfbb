"""The ropes of an environment's members: one batch in free flight, or each with its own peg."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array, Indices
from hyperflex.core import status
from hyperflex.errors import SimulationError
from hyperflex.model import Arm, Peg, Rope, unit_along
from hyperflex.simulation import BatchState, BatchStepper, Stepper
from hyperflex.trajectory import State


class World(ABC):
    """Ropes on arms, simulated interval by interval with given accelerations of the arms.

    Attributes
    ----------
    q, qd : (M, n) float64
        Absolute link angles, rad, and rates, rad/s.
    arm_angle, arm_rate : (M,) float64
        Angle and rate of the arms, rad and rad/s.
    failed : (M,) bool
        Whether a member could not be simulated; its state is then NaN until it is restarted.
    lengths : (M, n) float64
        Lengths of the links, m.
    """

    def __init__(self, rope: Rope, arm: Arm, count: int, tol: float) -> None:
        self.arm, self.tol, self.lengths = arm, tol, np.tile(rope.length, (count, 1))
        self.q, self.qd = (np.full((count, rope.n_links), np.nan) for _ in range(2))
        self.arm_angle, self.arm_rate = np.zeros(count), np.zeros(count)
        self.failed = np.ones(count, dtype=np.bool_)

    def begin(self, which: Indices, ropes: Sequence[Rope], pegs: Sequence[Peg], q0: Array, angle: float) -> None:
        """Restart some members (K,): their ropes and pegs (K,), at rest at angles `q0` (K, n), rad.

        Their arms begin at `angle`, rad.
        """
        self.lengths[which] = [rope.length for rope in ropes]

    @abstractmethod
    def step(self, accelerations: Array, dt: float) -> None:
        """Simulate an interval of `dt`, s, with accelerations (M,) of the arms, rad/s^2."""

    def places(self) -> Array:
        """Return the positions (M, n + 1, 2) of the arms' tips and all further joints, m."""
        first, steps = self.arm.tip(self.arm_angle)[:, None], self.lengths[..., None] * unit_along(self.q)
        return np.concatenate([first, first + np.cumsum(steps, axis=1)], axis=1)


class FreeWorld(World):
    """Ropes in free flight without pegs, simulated by a :class:`hyperflex.BatchStepper`."""

    def __init__(self, rope: Rope, arm: Arm, count: int, tol: float) -> None:
        super().__init__(rope, arm, count, tol)
        self._stepper = BatchStepper(rope, members=count, arm=arm, tol=tol)
        self._show(self._stepper.start())

    def begin(self, which: Indices, ropes: Sequence[Rope], pegs: Sequence[Peg], q0: Array, angle: float) -> None:
        """Restart some members."""
        super().begin(which, ropes, pegs, q0, angle)
        self._show(self._stepper.restart(self._state, which, ropes, q0, arm_angle=angle))

    def step(self, accelerations: Array, dt: float) -> None:
        """Simulate an interval."""
        now = replace(self._state, t=0.0)  # so that a step gives the same bits at any time
        self._show(self._stepper.step(now, accelerations, dt))

    def _show(self, state: BatchState) -> None:
        self._state, self.q, self.qd = state, state.q, state.qd
        self.arm_angle, self.arm_rate, self.failed = state.arm_angle, state.arm_rate, state.codes != status.OK


class PegWorld(World):
    """Ropes with one peg each, simulated by one :class:`hyperflex.Stepper` each; links are not refined near the peg."""

    def __init__(self, rope: Rope, arm: Arm, count: int, tol: float) -> None:
        super().__init__(rope, arm, count, tol)
        self._members: dict[int, tuple[Stepper, State]] = {}

    def begin(self, which: Indices, ropes: Sequence[Rope], pegs: Sequence[Peg], q0: Array, angle: float) -> None:
        """Restart some members."""
        super().begin(which, ropes, pegs, q0, angle)
        for m, rope, peg, q in zip(which.tolist(), ropes, pegs, q0, strict=True):
            stepper = Stepper(rope, arm=self.arm, pegs=[peg], tol=self.tol, refine=False)
            self._show(m, stepper, stepper.start(q, arm_angle=angle))

    def step(self, accelerations: Array, dt: float) -> None:
        """Simulate an interval."""
        for m, (stepper, state) in list(self._members.items()):
            try:
                self._show(m, stepper, stepper.step(state, float(accelerations[m]), dt))
            except SimulationError:
                del self._members[m]
                self.failed[m] = True
                self.q[m] = self.qd[m] = self.arm_angle[m] = self.arm_rate[m] = np.nan

    def _show(self, m: int, stepper: Stepper, state: State) -> None:
        self._members[m], self.failed[m] = (stepper, state), False
        self.q[m], self.qd[m], self.arm_angle[m], self.arm_rate[m] = state.q, state.qd, state.arm_angle, state.arm_rate
