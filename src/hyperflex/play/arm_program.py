"""Moves of the arm, appended one by one, each from rest to rest. Earlier moves do not change."""

import math

from hyperflex.motion import Motion, arm_moves, hold_arm

MOST_MOVES = 120  # in one motion: each frame evaluates all of them


class ArmProgram:
    """Moves of an arm that begins at rest.

    Attributes
    ----------
    angles : list of float
        Arm angle at the start and after each move, rad.
    end : float
        End of the last move, s.
    """

    def __init__(self, angle: float, begin: float = 0.0) -> None:
        self.angles, self.end = [angle], begin
        self._timing: list[tuple[float, float, float]] = []  # rest before each move, s, its duration, s, and its ramp

    @property
    def angle(self) -> float:
        """Arm angle after all moves, rad."""
        return self.angles[-1]

    @property
    def count(self) -> int:
        """Number of moves."""
        return len(self._timing)

    @property
    def motion(self) -> Motion:
        """The moves as a motion."""
        return arm_moves(self.angles, *zip(*self._timing, strict=True)) if self._timing else hold_arm(self.angle)

    def move(self, angle: float, start: float, duration: float, ramp: float = 0.5) -> None:
        """Add a move to an `angle`, rad, that starts at a time, s, not before `end`."""
        start = max(start, self.end)
        self._timing.append((start - self.end if self._timing else start, duration, ramp))
        self.angles.append(angle)
        self.end = start + duration

    @property
    def half_turns(self) -> int:
        """Number of half turns, as a rule counts them: even if the arm is at -pi/2, odd at pi/2."""
        return 2 * self.count + (self.angle > 0.0)

    def next_end(self) -> float:
        """Return the end of the next half turn through the bottom, rad; from other angles the arm moves to -pi/2."""
        return 0.5 * math.pi if abs(self.angle + 0.5 * math.pi) < 1e-9 else -0.5 * math.pi
