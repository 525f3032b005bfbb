"""The reach map: for targets on a grid, whether a cast winds them, and how far round."""

import math
import operator
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, files
from hyperflex.checks import Array, Flags, Integers
from hyperflex.errors import InvalidInput
from hyperflex.files import NetCDF, Variable
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, MotorLimits, Peg, Rope
from hyperflex.options import check, option
from hyperflex.planning.casting import CastRequest, plan_each
from hyperflex.planning.options import Conditions, SearchOptions, WindCriteria, refuse_behind
from hyperflex.planning.plan import from_table, to_table
from hyperflex.planning.problem import Problem
from hyperflex.status import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = "hyperflex reach map 2"
STATUSES = (Status.SUCCESS, Status.INFEASIBLE, Status.OUT_OF_TIME, Status.FAILED)  # by their numbers in a map
NOT_PLANNED = -1  # of a target that was not planned before an interrupt
ATTRIBUTES = ("radius", "mu", "time_budget", "seed")  # of the file, with format and problem
VARIABLES = {  # name: dimensions, unit, long name
    "x": (("x",), "m", "targets' x"),
    "y": (("y",), "m", "targets' y"),
    "status": (
        ("y", "x"),
        "1",
        "0: a cast succeeds; 1: infeasible; 2: none found in the time; 3: fails; -1: not planned",
    ),
    "turns": (("y", "x"), "1", "turns of the rope from the arm's tip to its end, of casts that succeed"),
    "contact_angle": (("y", "x"), "rad", "angle of the target that the rope covers, of casts that succeed"),
    "seconds": (("y", "x"), "s", "time of planning by the clock"),
}


@dataclass(frozen=True, eq=False)
class ReachMap:
    """Targets round which a rope on an arm can be wound: casts planned for a grid. Simulated.

    Attributes
    ----------
    problem : Problem
    x, y : (X,), (Y,) float64
        Of the targets' middles, m; the arm's pivot is at ``problem.arm.pivot``.
    radius, mu : float
        Of the targets, m, and their friction with the rope.
    time_budget : float
        Of each target's search, s.
    seed : int
        Of the searches.
    status : (Y, X) int64
        Number in STATUSES of :attr:`CastPlan.status`: 0 if a cast succeeds, 1 if the target is infeasible and was not
        searched. NOT_PLANNED if an interruption came before or during the search.
    turns, contact_angle : (Y, X) float64
        Of the casts that succeed: turns, and the angle of the target that the rope covers, rad; else NaN.
    seconds : (Y, X) float64
        Time of planning, s.
    """

    problem: Problem
    x: Array
    y: Array
    radius: float
    mu: float
    time_budget: float
    seed: int
    status: Integers
    turns: Array
    contact_angle: Array
    seconds: Array

    @property
    def complete(self) -> bool:
        """Whether all targets were planned, without an interrupt."""
        return bool((self.status != NOT_PLANNED).all())

    @property
    def wound(self) -> Flags:
        """Targets (Y, X) for which a cast succeeds."""
        return np.asarray(self.status == STATUSES.index(Status.SUCCESS))

    @property
    def infeasible(self) -> Flags:
        """Infeasible targets (Y, X), which were not searched."""
        return np.asarray(self.status == STATUSES.index(Status.INFEASIBLE))

    @property
    def counts(self) -> dict[str, int]:
        """Number of targets, of those that are feasible, and of those that are wound."""
        feasible = ~self.infeasible & (self.status != NOT_PLANNED)
        return {"targets": self.status.size, "feasible": int(feasible.sum()), "wound": int(self.wound.sum())}

    def in_short(self) -> str:
        """Return the counts as text, and how many targets were not planned, or not to the end of their time."""
        shown = ", ".join(f"{count} {name}" for name, count in self.counts.items())
        if late := int((self.status == STATUSES.index(Status.OUT_OF_TIME)).sum()):
            shown += f", {late} not found within {self.time_budget:g} s: more time may wind them"
        missing = int((self.status == NOT_PLANNED).sum())
        return shown if self.complete else f"{shown}, {missing} not planned: interrupted"

    def __repr__(self) -> str:
        return f"ReachMap({self.in_short()})"

    def plot(self) -> "Figure":
        """Draw the map: return a Matplotlib figure."""
        from hyperflex.report import reach_figure

        return reach_figure(self)

    def to_netcdf(self, path: str | Path) -> None:
        """Write the map to a NetCDF-4 file; :func:`read_reach_map` reads it.

        Parameters
        ----------
        path : str or Path

        Raises
        ------
        FileProblem
            It cannot be written.
        """
        held = {
            name: Variable(dimensions, getattr(self, name), {"units": unit, "long_name": text})
            for name, (dimensions, unit, text) in VARIABLES.items()
        }
        about = {name: getattr(self, name) for name in ATTRIBUTES}
        about |= {"format": FORMAT, "source": "simulated", "problem": files.dumps_toml(to_table(self.problem))}
        files.write_netcdf(path, NetCDF(held, about))


@dataclass(frozen=True, eq=False)
class TargetGrid:
    """Targets on a grid.

    Parameters
    ----------
    cells : int
        Number of cells from the arm's pivot to the rope's reach.
    x, y : array_like, optional
        Coordinates of the targets' middles, m, increasing. By default the rope's reach on the right-hand side; the left
        is its mirror image if the motor's angles and the obstacles are symmetric.
    radius, mu : float
        Of the targets, m, and their friction with the rope.
    """

    cells: int = option(8, "Cells of the grid, from the arm's pivot to as far as the rope comes.", sign="positive")
    x: ArrayLike | None = None
    y: ArrayLike | None = None
    radius: float = option(0.03, "Radius of the targets.", "m", sign="positive")
    mu: float = option(0.3, "Coefficient of friction between rope and targets.", sign="nonnegative")

    def __post_init__(self) -> None:
        check(self, "grid")

    def places(self, problem: Problem) -> tuple[Array, Array]:
        """Return x (X,) and y (Y,) of the targets for a problem, m."""
        (x0, y0), count = problem.arm.pivot, self.cells
        steps = (np.arange(count) + 0.5) * (problem.arm.length + problem.rope.total_length) / count
        x = x0 + steps if self.x is None else _increasing("x", self.x)
        y = y0 + np.concatenate([-steps[::-1], steps]) if self.y is None else _increasing("y", self.y)
        if x.size * y.size > 100_000:
            raise InvalidInput("the grid is too fine", got=x.size * y.size, allowed="100000 targets at most")
        return x, y


@checks.arguments(limits=MotorLimits, criteria=WindCriteria, conditions=Conditions, options=SearchOptions)
@interruptible(ReachMap)
def build_reach_map(
    rope: Rope,
    arm: Arm,
    limits: MotorLimits | None = None,
    *,
    grid: TargetGrid | None = None,
    criteria: WindCriteria | None = None,
    conditions: Conditions | None = None,
    time_budget: float = 10.0,
    options: SearchOptions | None = None,
) -> ReachMap:
    """Plan a cast for each target of a grid.

    Parameters
    ----------
    rope, arm, limits, criteria, conditions, options
        As in :func:`plan_cast`, without pegs to run behind; the rope hangs at the start.
    grid : TargetGrid, optional
    time_budget : float
        Time for each target, s. A search ends with the first plan that succeeds.

    Returns
    -------
    ReachMap

    Raises
    ------
    InvalidInput
        If an argument is out of range or of another class, or there are pegs `behind`.
    WorkerLost
        If targets kill the workers of the executor.
    Interrupted
        By Ctrl-C. Its ``partial`` is the map until then.

    Notes
    -----
    "Infeasible" is the result of the feasibility check, which wrongly rejects a few targets
    (``benchmarks/results/reach-nominal.md`` counts them); "none found" is the result of a search in the time budget:
    more time may give a plan, most of all with a long rope.

    Examples
    --------
    Two targets beyond the rope's end:

    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> hf.build_reach_map(cable, hf.Arm(length=0.105), grid=hf.planning.TargetGrid(x=[2.2, 2.4], y=[0.0]))
    ReachMap(2 targets, 0 feasible, 0 wound)
    """
    grid, given = grid or TargetGrid(), conditions or Conditions()
    chosen = replace(options or SearchOptions(), fallback=False)
    refuse_behind((criteria or WindCriteria()).behind, "a reach map")
    if given.state0 is not None:
        fix = "Plan these targets one by one"
        raise InvalidInput("a reach map begins with a rope that hangs", got="state0", allowed="none", fix=fix)
    first = operator.attrgetter("success")
    parts = limits or MotorLimits(), criteria or WindCriteria(), given, None, time_budget, chosen, first
    request = CastRequest(rope, arm, *parts)
    problem = request.problem()
    x, y = grid.places(problem)
    targets = [Peg(float(one), float(level), grid.radius, grid.mu) for level in y for one in x]
    plans, stop = plan_each(request, targets)
    rows = []
    for number in range(len(targets)):
        status, turns, contact, seconds = NOT_PLANNED, math.nan, math.nan, math.nan
        plan = plans.get(number)
        if plan is not None and (plan.success or not plan.interrupted):
            status, seconds = STATUSES.index(plan.status), plan.seconds
            if plan.success and plan.outcome is not None:
                turns, contact = abs(plan.outcome.turns), plan.outcome.contact_angle
        rows.append((status, turns, contact, seconds))
    shaped = np.array(rows).T.reshape(4, y.size, x.size)
    about = targets[0].radius, targets[0].mu, time_budget, chosen.seed
    return stop.deliver(ReachMap(problem, x, y, *about, shaped[0].astype(np.int64), *shaped[1:]))


def read_reach_map(path: str | Path) -> ReachMap:
    """Read a map that :meth:`ReachMap.to_netcdf` wrote.

    Parameters
    ----------
    path : str or Path
        The NetCDF file.

    Raises
    ------
    FileProblem
        There is no such file, or it is cut off or damaged.
    InvalidInput
        It is another kind of file.
    """
    content = files.read_netcdf(path)
    about, held = dict(content.attributes), content.variables
    if about.get("format") != FORMAT:
        raise InvalidInput(
            f"{path} is not a reach map", got=about.get("format"), allowed=f"a file of format {FORMAT!r}"
        )
    try:
        numbers: dict[str, Any] = {name: held[name].numbers(name) for name in VARIABLES}
        given: dict[str, Any] = {name: float(about[name]) for name in ATTRIBUTES} | {"seed": int(about["seed"])}
        problem = from_table(Problem, tomllib.loads(str(about["problem"])))
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInput(f"{path} is not a complete reach map", got=str(error), fix="Make it again") from None
    shape = (numbers["y"].size, numbers["x"].size)
    for name, (dimensions, _, _) in VARIABLES.items():
        if len(dimensions) == 1:
            numbers[name] = _increasing(name, numbers[name])
        else:
            checks.array(name, numbers[name], shape, gaps=name != "status")
    return ReachMap(problem, **given, **numbers | {"status": numbers["status"].astype(np.int64)})


def _increasing(name: str, value: ArrayLike) -> Array:
    places = checks.array(name, value, (-1,), unit="m")
    if not places.size or (np.diff(places) <= 0.0).any():
        raise InvalidInput(
            f"{name} of the grid is not increasing", got=places, allowed="one place or more, increasing, m"
        )
    return places
