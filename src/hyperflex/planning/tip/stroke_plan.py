"""What plans of strokes have in common."""

from typing import Any

from hyperflex.planning.plan import Plan
from hyperflex.planning.tip.strokes import Strokes


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

    def summary(self) -> dict[str, Any]:
        """Return the plan in figures, for JSON: its fields, and each stroke's start, s, and the arm's angles, rad."""
        if self.strokes is None:
            return super().summary()
        limits = self.cast_setup.limits
        return super().summary() | {"starts": self.strokes.starts(limits), "angles": self.strokes.angles(limits)}
