"""What plans of strokes have in common."""

from typing import Any

from hyperflex.model import Setup, Wall
from hyperflex.planning.plan import Plan
from hyperflex.planning.tip.outcome import WINDOW
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.verification import verified_setup


class StrokePlan(Plan):
    """A planned motion of strokes; `strokes` are the best found, or None."""

    strokes: Strokes | None

    @property
    def moves(self) -> Strokes | None:
        """The strokes."""
        return self.strokes

    @property
    def refuted(self) -> bool:
        """Whether a simulated run shows that the plan fails."""
        return self.outcome is not None and not self.success

    @property
    def walls(self) -> tuple[Wall, ...]:
        """Walls that the strokes were verified beside."""
        return ()

    def setup(self) -> Setup:
        """Return the set-up of a run until after the instant that counts, beside the walls.

        Until the arm stops if nothing was verified.
        """
        motion = self.required(self.motion, "motion")
        end = float(motion.breaks[-1]) if self.outcome is None else self.outcome.t + WINDOW
        return verified_setup(self.problem, motion, end, self.walls)

    def summary(self) -> dict[str, Any]:
        """Return the plan in figures, for JSON: its fields, and each stroke's start, s, and the arm's angles, rad."""
        if self.strokes is None:
            return super().summary()
        limits = self.problem.limits
        return super().summary() | {"starts": self.strokes.starts(limits), "angles": self.strokes.angles(limits)}
