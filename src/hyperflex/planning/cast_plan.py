"""A planned cast: the throw, its outcome in simulation, or why there is none."""

from dataclasses import dataclass
from typing import Any, ClassVar

from hyperflex.model import Peg, Setup
from hyperflex.planning.feasibility import Feasibility
from hyperflex.planning.outcome import CastOutcome, HoldingForce, measure_holding_force
from hyperflex.planning.plan import Plan
from hyperflex.planning.verification import verified_setup


@dataclass(frozen=True, eq=False, repr=False)
class CastPlan(Plan):
    """A planned cast, or why there is none.

    Attributes
    ----------
    finer_outcome : CastOutcome or None
        With links of a third of the length.
    margin : float
        How much of each criterion is to spare in both runs, over what is usual: the least; see
        :func:`hyperflex.planning.ensemble.margin`. Of a robust plan it is 1 if it succeeds in all scenarios.
    fallback : FallbackTarget or None
        For a plan that fails: the nearest target with a plan that succeeds, or that is expected to be feasible.
    remedies : tuple of str
        For an infeasible target: changes of rope, arm, motor, time or peg that would each make it feasible.
    problem, target, feasibility, moves, outcome, message, runs, seconds, interrupted, success_probability
        As of :class:`hyperflex.planning.plan.Plan`.
    """

    kind: ClassVar[str] = "cast"
    target: Peg
    feasibility: Feasibility
    outcome: CastOutcome | None = None
    finer_outcome: CastOutcome | None = None
    margin: float = 0.0
    fallback: "FallbackTarget | None" = None
    remedies: tuple[str, ...] = ()

    @property
    def refuted(self) -> bool:
        """Whether a simulated run to the end shows that the plan fails."""
        return any(each.completed and not each.success for each in self._outcomes())

    @property
    def unfinished(self) -> bool:
        """Whether the plan fails although its target is feasible: by Ctrl-C, or a run that was not completed."""
        if self.success or not self.feasibility.feasible:
            return False
        return self.interrupted or any(not each.completed for each in self._outcomes())

    def _outcomes(self) -> list[CastOutcome]:
        return [each for each in (self.outcome, self.finer_outcome) if each is not None]

    def setup(self) -> Setup:
        """Return the set-up of the verified run, with links refined near the target, and joint limits."""
        motion, criteria = self.required(self.motion, "motion"), self.problem.criteria
        end = float(motion.breaks[-1]) + criteria.settle + criteria.watch
        return verified_setup(self.problem, motion, end, (self.target,))

    def measure_holding_force(self) -> HoldingForce | None:
        """Tug at the rope from the end of the verified run; None unless it is wound and does not slip by itself."""
        outcome = self.outcome
        if outcome is None or self.run is None or not (outcome.wound and outcome.slip < self.problem.criteria.max_slip):
            return None
        return measure_holding_force(self.run, self.target)

    def notes(self) -> dict[str, str]:
        """Return notes for the head of the motor's file."""
        peg, rope, motion = self.target, self.problem.rope, self.required(self.motion, "motion")
        return super().notes() | {
            "target": f"x {peg.x:g} m, y {peg.y:g} m, radius {peg.radius:g} m, mu {peg.mu:g}",
            "rope": f"{rope.total_length:.4g} m, {rope.total_mass:.4g} kg",
            "arm": f"{self.problem.arm.length:g} m, begins at {motion.angle(0.0):.4f} rad",
            "start": "the rope swings, by q0 and qd0 of the plan" if self.problem.q0 else "the rope hangs at rest",
        }

    def summary(self) -> dict[str, Any]:
        """Return the plan in figures, for JSON; see :meth:`Plan.summary`."""
        table = super().summary()
        if self.fallback is not None and self.fallback.plan is not None:
            table["fallback"]["plan"] = self.fallback.plan.summary()
        return table


@dataclass(frozen=True, eq=False)
class FallbackTarget:
    """The nearest target with a plan that succeeds, or that is expected to be feasible.

    `target` is like the one asked for, `distance`, m, from it. `plan` succeeds; None if the target is only expected to
    be feasible. `failed_plans` counts nearer targets for which planning failed.
    """

    target: Peg
    distance: float
    plan: CastPlan | None = None
    failed_plans: int = 0
