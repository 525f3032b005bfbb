"""The arm's moves as they are decided one by one, each from rest to rest: what is done stays as it was."""

import math

from hyperflex.motion import Motion, arm_moves, hold_arm

MOST_MOVES = 120  # that are remembered


class ArmProgram:
    """Moves of an arm that begins at rest.

    Attributes
    ----------
    angle : float
        Where the arm is once all moves are done, rad.
    end : float
        When they are done, s.
    """

    def __init__(self, angle: float, begin: float = 0.0) -> None:
        self.angle, self.end = angle, begin
        self._angles, self._rests = [angle], [begin]
        self._durations: list[float] = []
        self._ramps: list[float] = []

    @property
    def begun(self) -> bool:
        """Whether the arm has moved."""
        return bool(self._durations)

    @property
    def full(self) -> bool:
        """Whether it remembers all that it may."""
        return len(self._durations) >= MOST_MOVES

    @property
    def motion(self) -> Motion:
        """The moves as a motion."""
        if not self._durations:
            return hold_arm(self.angle)
        return arm_moves(self._angles, self._rests[: len(self._durations)], self._durations, self._ramps)

    def move(self, angle: float, start: float, duration: float, ramp: float = 0.5) -> None:
        """Add a move to an `angle`, rad, that starts at a time, s, not before `end`."""
        rest = max(start - self.end, 0.0)
        if self._durations:
            self._rests.append(rest)
        else:
            self._rests[0] += rest
        self._angles.append(angle)
        self._durations.append(duration)
        self._ramps.append(ramp)
        self.angle, self.end = angle, self.end + rest + duration

    @property
    def made(self) -> int:
        """Half turns made, as far as the next one's side tells: an even number from -pi/2, else an odd one."""
        return 2 * len(self._durations) + (self.angle > 0.0)

    def next_end(self) -> float:
        """Return where the next half turn through the bottom ends, rad; from elsewhere the arm goes to -pi/2 first."""
        return 0.5 * math.pi if abs(self.angle + 0.5 * math.pi) < 1e-9 else -0.5 * math.pi
