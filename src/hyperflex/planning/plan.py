"""Plans, casts among them: their fields, success, the motor's file, and their TOML files."""

import json
import math
import types
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from hyperflex import checks, files
from hyperflex.errors import InvalidInput
from hyperflex.model import PLAN, Peg, Rope, Setup, obstacle_tables, obstacles_of
from hyperflex.motion import MOVES, Motion
from hyperflex.planning.ensemble import SuccessProbability
from hyperflex.planning.feasibility import Feasibility
from hyperflex.planning.moves import Moves
from hyperflex.planning.outcome import CastOutcome, HoldingForce, measure_holding_force
from hyperflex.planning.problem import Problem
from hyperflex.planning.verification import CAST_ACCURACY, verified_setup
from hyperflex.status import Status
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

T = TypeVar("T")

RATE = 200.0  # Hz
MAX_ROWS = 10_000_000
# At the beginning of a plan's TOML file
HEAD = """# A planned {kind}. SI units: m, kg, s, N, N m, J; angles in rad: an arm or link at 0 hangs
# down, at pi/2 it points along +x (to the right; y is up).
# First the set-up of the verified run, its links cut where they may touch: hyperflex simulate runs it. From [plan] on,
# what was planned for whom: the rope as given and the motor's limits (plan.problem), the moves, and what became of
# them in simulation (plan.outcome; with shorter links, plan.finer_outcome). A plan that succeeds has no message.

"""
OF_OBSTACLES = {"obstacles", "behind"}  # fields that hold obstacles, in a file by their kind


@dataclass(frozen=True, eq=False, repr=False)
class Plan(ABC):
    """A planned motion, or why there is none.

    Attributes
    ----------
    problem : Problem
        Rope, arm, motor limits and time.
    target
        What is wound, whipped or entered.
    feasibility
        Result of the check before the search.
    moves : Moves or None
        The best moves found.
    outcome : CastOutcome, TipStrike or InsertOutcome, or None
        Their outcome in a simulated run; None if there was none, or if a cast's run with shorter links failed first.
    finer_outcome
        Their outcome with shorter links.
    message : str
        Why the plan fails; empty if it succeeds.
    runs : int
        Simulated runs of the search; of whips and insertions without the random swings at its beginning.
    seconds : float
        Time that the search took, s.
    interrupted : bool
        Whether Ctrl-C ended the search; the plan is the best until then.
    success_probability : SuccessProbability or None
        In sampled scenarios that the search has not used; None if it was not required, or the plan fails. Of 0 samples
        where no time was left.
    """

    kind: ClassVar[str]  # in files
    problem: Problem
    target: Any
    feasibility: Any
    moves: Moves | None = None
    outcome: Any = None
    finer_outcome: Any = None
    message: str = ""
    runs: int = 0
    seconds: float = 0.0
    interrupted: bool = False
    success_probability: SuccessProbability | None = None

    @property
    def motion(self) -> Motion | None:
        """Motion of the arm, from rest at t = 0; None if no motion was found."""
        return None if self.moves is None else self.moves.motion(self.problem.limits)

    @property
    def seen(self) -> Any:
        """Outcome of the run as planned, or of that with shorter links if this failed first; None without a run."""
        return self.finer_outcome if self.outcome is None else self.outcome

    @property
    def run(self) -> Trajectory | None:
        """The run of :attr:`seen`; None if there is none, or if the plan was read from a file."""
        return None if self.seen is None else self.seen.run

    @property
    def clearance(self) -> float:
        """Least distance between rope and own arm, shaft or obstacles in the verified runs, m; NaN without."""
        return min(self._known("clearance"), default=math.nan)

    @property
    def torque(self) -> float:
        """Greatest torque of the motor in the verified runs as a mean over 5 ms, N m; 0 if it is not known."""
        return max(self._known("torque"), default=0.0)

    @property
    def outcomes(self) -> list[Any]:
        """Outcomes of the verified runs."""
        return [each for each in (self.outcome, self.finer_outcome) if each is not None]

    def _known(self, name: str) -> list[float]:
        """Return a figure of the verified runs, where it is known."""
        return [value for each in self.outcomes if not math.isnan(value := getattr(each, name))]

    @property
    @abstractmethod
    def refuted(self) -> bool:
        """Whether a simulated run to the end shows that the plan fails."""

    @abstractmethod
    def setup(self) -> Setup:
        """Return the set-up of the verified run. Raises InvalidInput if no motion was found."""

    def notes(self) -> dict[str, str]:
        """Return notes for the head of the motor's file."""
        problem, motion = self.problem, self.required(self.motion, "motion")
        failure = {} if self.success else {"fails" if self.refuted else "not verified": self.message}
        return failure | {
            "target": f"x {self.target.x:g} m, y {self.target.y:g} m",
            "rope": f"{problem.rope.total_length:.4g} m, {problem.rope.total_mass:.4g} kg",
            "arm": f"{problem.arm.length:g} m, begins at {motion.angle(0.0):.4f} rad",
            "start": "the rope swings, by q0 and qd0 of the plan" if problem.q0 else "the rope hangs at rest",
        }

    @property
    def success(self) -> bool:
        """Whether the plan meets all criteria in its verified runs; of a whip's finer run not all are required."""
        return not self.message

    @property
    def status(self) -> Status:
        """Why the planner ended.

        FAILED: a verified run fails, or there was nothing more to try. OUT_OF_TIME: nothing was found, or it was not
        verified to the end.
        """
        if self.success:
            return Status.SUCCESS
        if self.interrupted:
            return Status.INTERRUPTED
        if self.moves is None and not self.runs and not self.feasibility.feasible:
            return Status.INFEASIBLE
        return Status.FAILED if self.refuted else Status.OUT_OF_TIME

    def required(self, value: T | None, name: str) -> T:
        """Return a part of the plan, its `value`; raises InvalidInput, with its `name`, if that is None."""
        if value is None:
            read = "A plan that is read from a file has no runs: hyperflex.simulate(plan.setup()) makes one"
            fix = "Plan for a target that is feasible" if self.motion is None else read
            raise InvalidInput(f"the plan has no {name}", got=self.message or "a plan that succeeds", fix=fix)
        return value

    def __repr__(self) -> str:
        ended = "succeeds" if self.success else f"fails: {self.message}"
        if self.success and self.outcome is not None:
            ended += f": {self.outcome.in_short()}"
        place = f"target ({self.target.x:.4g}, {self.target.y:.4g}) m"
        return f"{type(self).__name__}({place}, {self.problem.rope!r}, {self.runs} runs, {ended})"

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the verified run about the strike, the peak or the entry: return a Matplotlib figure.

        It is drawn into the axes `ax` if given. Raises InvalidInput if there is no run: a plan that is read from a file
        has none, and ``hyperflex.simulate(plan.setup()).plot()`` draws it.
        """
        from hyperflex.report import plan_figure

        return plan_figure(self, ax)  # type: ignore[arg-type] # all plans are casts, whips or insertions

    def _repr_html_(self) -> str:
        from hyperflex.report import plan_html

        return plan_html(self)  # type: ignore[arg-type] # all plans are casts or whips

    def summary(self) -> dict[str, Any]:
        """Return the plan in figures, for JSON: all fields but the set-up, status, clearance, and times of the moves.

        `starts` are those of the moves, `stop` is the arm's, s; `angles` are the arm's, rad.
        """
        found = {"success": self.success, "status": self.status, "clearance": self.clearance}
        table = {"source": "simulated", **found, **to_table(self)}
        del table["problem"]
        if self.moves is not None:
            moves, limits = self.moves, self.problem.limits
            table |= {"starts": moves.starts(limits), "stop": moves.stops(limits), "angles": moves.angles(limits)}
        if self.success_probability is not None:
            table["success_probability"]["interval"] = self.success_probability.interval
        return table

    def to_csv(self, path: files.PathLike, *, rate: float = RATE) -> None:
        """Write the motion at a motor's rate to a CSV file that :func:`hyperflex.read_motion` reads back exactly.

        A plan that fails is marked in the file's head, ``# not verified: ...`` or ``# fails: ...``.

        Parameters
        ----------
        path : path-like
            CSV file with the columns ``t`` (s) and ``angle`` (rad), written whole or not at all. The last row is the
            arm at rest.
        rate : float
            Rows a second, Hz.

        Raises
        ------
        InvalidInput
            If no motion was found, or the rate gives fewer than 3 or more than MAX_ROWS rows.
        """
        motion = self.required(self.motion, "motion")
        rate = checks.number("rate", rate, sign="positive", unit="Hz")
        count = math.ceil(motion.end * rate - 1e-9) + 1
        if not 2 < count <= MAX_ROWS:
            raise InvalidInput(
                "rate does not suit the motion", got=rate, allowed="some rows a move, and 10 million in all"
            )
        t = np.arange(count) / rate
        columns = {
            "contents": "planned motion of the arm",
            "rate": f"{rate:g} Hz",
            "t": "s",
            "angle": "rad, 0 hangs down, pi/2 points along +x",
            MOVES: json.dumps({name: part for name, part in motion.spec.items() if name != "kind"}),
        }
        files.write_table(path, ["t", "angle"], np.column_stack([t, motion.angle(t)]), notes=self.notes() | columns)

    def to_netcdf(self, path: str | Path) -> None:
        """Write the verified run to a NetCDF file `path`, whole or not at all; raises InvalidInput if there is none."""
        self.required(self.run, "run").to_netcdf(path)

    def to_toml(self, path: files.PathLike) -> None:
        """Write the plan to a TOML file `path`, whole or not at all; raises InvalidInput if no motion was found.

        :func:`hyperflex.read_plan` reads all of it but the runs, ``hyperflex simulate`` and
        :meth:`hyperflex.Setup.from_toml` the set-up of the verified run.
        """
        table = {"kind": self.kind, "source": "simulated", **to_table(self)}
        text = self.setup().dumps() + "\n" + files.dumps_toml({PLAN: table})
        files.write_text(path, HEAD.format(kind=self.kind) + text)


@dataclass(frozen=True, eq=False, repr=False)
class CastPlan(Plan):
    """A planned cast, or why there is none.

    Attributes
    ----------
    finer_outcome : CastOutcome or None
        With links of a third of the length.
    margin : float
        Smallest distance of a criterion from its limit in both runs, divided by a usual amount; see
        :func:`hyperflex.planning.ensemble.margin`. A robust plan that succeeds in all scenarios has 1.
    fallback : FallbackTarget or None
        For a plan that fails: the nearest target with a plan that succeeds, or that is expected to be feasible.
    remedies : tuple of str
        For an infeasible target: changes of rope, arm, motor, time, peg or required turns that would each make it
        feasible. Otherwise the turns that the plan's runs keep, if fewer are required and nothing else fails.
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
        return any(each.completed and not each.success for each in self.outcomes)

    def refuse_earlier_touch(self, what: str) -> None:
        """Raise InvalidInput if the rope touches the target in a swing before the strike, as `what` stops there."""
        seen = self.outcome
        if seen is not None and seen.strike_time - seen.touch_time > 0.5 * self.problem.period:
            raise InvalidInput(
                f"{what} must not touch the target before the swing that strikes it",
                got=f"touched at {seen.touch_time:.2f} s, struck at {seen.strike_time:.2f} s",
                fix="Carry it out without: its motion is complete",
            )

    @property
    def unfinished(self) -> bool:
        """Whether the plan fails although its target is feasible: by Ctrl-C, or a run that was not completed."""
        if self.success or not self.feasibility.feasible:
            return False
        return self.interrupted or any(not each.completed for each in self.outcomes)

    @property
    def refused_by_rule(self) -> bool:
        """Whether no search was made because of a rule of thumb: geometry and the motor do not rule the target out."""
        known = self.feasibility
        return self.moves is None and not (self.seconds or known.feasible or known.impossible)

    def setup(self) -> Setup:
        """Return the set-up of the verified run, with links refined near the target, and joint limits."""
        motion, criteria = self.required(self.motion, "motion"), self.problem.criteria
        end = motion.end + criteria.settle + criteria.watch
        return verified_setup(self.problem, motion, end, (self.target,), CAST_ACCURACY)

    def measure_holding_force(self) -> HoldingForce | None:
        """Pull at the rope from the end of the verified run; None unless it is wound and does not slip by itself."""
        outcome, most = self.seen, self.problem.criteria.max_slip
        if outcome is None or self.run is None or not (outcome.wound and outcome.slip < most):
            return None
        return measure_holding_force(self.run, self.target, max_slip=most)

    def notes(self) -> dict[str, str]:
        """Return notes for the head of the motor's file."""
        known = super().notes()
        return known | {"target": f"{known['target']}, radius {self.target.radius:g} m, mu {self.target.mu:g}"}

    def summary(self) -> dict[str, Any]:
        """Return the plan in figures, for JSON; see :meth:`Plan.summary`."""
        table = super().summary()
        if self.fallback is not None and self.fallback.plan is not None:
            table["fallback"]["plan"] = self.fallback.plan.summary()
        return table


@dataclass(frozen=True, eq=False)
class FallbackTarget:
    """The nearest target with a plan that succeeds, or that is expected to be feasible.

    `target` is like the given one, `distance`, m, from it. `plan` succeeds; None if the target is only expected to
    be feasible. `failed_plans` counts nearer targets for which planning failed.
    """

    target: Peg
    distance: float
    plan: CastPlan | None = None
    failed_plans: int = 0


def to_table(value: Any) -> Any:
    """Turn a dataclass into nested tables for TOML; fields that are None and runs are omitted."""
    if isinstance(value, Rope):
        return value.table()
    if not is_dataclass(value):
        return value
    parts = {field.name: getattr(value, field.name) for field in fields(value)}
    for name in OF_OBSTACLES & parts.keys():
        parts[name] = obstacle_tables(parts[name])
    return {name: to_table(part) for name, part in parts.items() if not (part is None or isinstance(part, Trajectory))}


def from_table(kind: type[T], table: Mapping[str, Any]) -> T:
    """Build a dataclass from what :func:`to_table` returned; raises TypeError where a field lacks or is unknown."""
    if kind is Rope:
        return Rope.from_table(table)  # type: ignore[return-value]
    hints = get_type_hints(kind)
    table = {**table, **{name: obstacles_of(table.get(name, {})) for name in OF_OBSTACLES & hints.keys()}}
    return kind(**{name: _from_value(hints.get(name), value) for name, value in table.items()})


def _from_value(hint: Any, value: Any) -> Any:
    if isinstance(hint, types.UnionType):
        (hint,) = (each for each in get_args(hint) if each is not types.NoneType)
    if isinstance(value, Mapping):
        return from_table(hint, value)
    if isinstance(value, list):
        return np.array(value, dtype=np.float64) if get_origin(hint) is np.ndarray else tuple(value)
    return value
