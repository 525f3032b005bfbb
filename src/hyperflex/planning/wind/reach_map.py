"""The reach map: for targets on a grid, whether a cast winds them, and how far round."""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import NetCDF, Variable
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, Peg, Rope, Setup, checked_obstacles
from hyperflex.planning.options import MotorLimits
from hyperflex.planning.plan import INFEASIBLE, SUCCEEDED
from hyperflex.planning.problem import Problem
from hyperflex.planning.routing import refuse_behind
from hyperflex.planning.wind.cast_plan import CastPlan
from hyperflex.planning.wind.many import plan_each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = "hyperflex reach map 1"
CELLS = 8  # from the shaft to as far as the rope comes, by default
MOST_CELLS = 100_000
TIME_BUDGET = 10.0  # s, of each target; a first plan's median is a few s, see benchmarks/results
NOT_PLANNED = -1  # status of a target that an interrupt left
OWN = ("time", "clearance", "contact", "turns", "settle", "side")  # numbers of the set-up, attributes of the file
ASKED = ("radius", "mu", "time_budget", "holding_force", "seed")  # others, of the map
# Name in the file: unit, long name
VARIABLES = {
    "status": ("1", "0: a cast winds and holds; 1: not feasible; 2: none found; 3: refuted; 4: not verified; -1: open"),
    "turns": ("1", "turns of the rope from the arm's tip to its end, of casts that stand"),
    "contact_angle": ("rad", "angle of the target that the rope covers, of casts that stand"),
    "seconds": ("s", "time of planning by the clock"),
}


@dataclass(frozen=True, eq=False)
class ReachMap:
    """What a rope on an arm can wind: casts planned for targets on a grid. Simulated.

    Attributes
    ----------
    problem : Problem
    x, y : (X,), (Y,) float64
        Of the targets' middles, m; the arm's pivot is at ``problem.arm.pivot``.
    radius, mu : float
        Of the targets, m, and their friction with the rope.
    time_budget : float
        Of each target's search, s.
    holding_force : float
        Pull that the wound ropes withstand, N.
    seed : int
        Of the searches.
    status : (Y, X) int64
        As of :attr:`CastPlan.status`: 0 where a cast stands, 1 where the target is not feasible and none was searched
        for. NOT_PLANNED where an interrupt came before, or ended the search.
    turns, contact_angle : (Y, X) float64
        Of the casts that stand: turns, and the angle of the target that the rope covers, rad; else NaN.
    seconds : (Y, X) float64
        Time of planning, s.
    """

    problem: Problem
    x: Array
    y: Array
    radius: float
    mu: float
    time_budget: float
    holding_force: float
    seed: int
    status: npt.NDArray[np.int64]
    turns: Array
    contact_angle: Array
    seconds: Array

    @property
    def complete(self) -> bool:
        """Whether no interrupt left targets out."""
        return bool((self.status != NOT_PLANNED).all())

    @property
    def wound(self) -> npt.NDArray[np.bool_]:
        """Targets (Y, X) for which a cast stands."""
        return np.asarray(self.status == SUCCEEDED)

    @property
    def infeasible(self) -> npt.NDArray[np.bool_]:
        """Targets (Y, X) that are not feasible, for which none was searched for."""
        return np.asarray(self.status == INFEASIBLE)

    def __repr__(self) -> str:
        searched = int((~self.infeasible & (self.status != NOT_PLANNED)).sum())
        rest = "" if self.complete else f", {int((self.status == NOT_PLANNED).sum())} not planned: interrupted"
        return f"ReachMap({self.status.size} targets, {searched} feasible, {int(self.wound.sum())} wound{rest})"

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
        grid = {
            name: Variable((name,), getattr(self, name), _attributes("m", f"targets' {name}")) for name in ("x", "y")
        }
        held = {
            name: Variable(("y", "x"), getattr(self, name), _attributes(*about)) for name, about in VARIABLES.items()
        }
        known = self.problem
        limits = {f"motor_{each.name}": getattr(known.limits, each.name) for each in fields(MotorLimits)}
        own = {name: getattr(known, name) for name in OWN}
        about: dict[str, Any] = {
            "format": FORMAT,
            "source": "simulated",
            "setup": Setup(known.rope, arm=known.arm, pegs=known.obstacles).dumps(),
        }
        about |= {name: getattr(self, name) for name in ASKED}
        files.write_netcdf(path, NetCDF(grid | held, about | limits | own))


@interruptible(ReachMap)
def build_reach_map(
    rope: Rope,
    arm: Arm,
    limits: MotorLimits | None = None,
    *,
    cells: int = CELLS,
    x: npt.ArrayLike | None = None,
    y: npt.ArrayLike | None = None,
    radius: float = 0.03,
    mu: float = 0.3,
    time_budget: float = TIME_BUDGET,
    executor: Executor | None = None,
    chunk_size: int | None = None,
    progress: bool = False,
    **options: Any,
) -> ReachMap:
    """Plan a cast for each target of a grid, and tell what is wound.

    Parameters
    ----------
    rope, arm, limits
        As of :func:`plan_cast`.
    cells : int
        Of the grid, from the arm's pivot to as far as the rope comes.
    x, y : array_like, optional
        Of the grid instead, m, increasing. By default all that the rope can come to on the right-hand side; on the left
        it is the mirror image where the motor's angles are alike to both sides, and obstacles too.
    radius, mu : float
        Of the targets, m, and their friction with the rope.
    time_budget : float
        Of each target, s. A search ends with the first plan that stands.
    executor, chunk_size, progress
        As of :func:`plan_casts`.
    **options
        Others of :func:`plan_cast`, the same for all targets, such as `holding_force`, `turns` and `obstacles`.

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
    "Not feasible" is what the feasibility check says, which forbids a few targets that can be wound; "none found" is
    what a search in the time budget says: more time may wind such a target, most of all with a long rope.
    ``benchmarks/results/reach-nominal.md`` tells how often the former is wrong, of targets searched for 110 s.

    Examples
    --------
    Two targets beyond the rope's end:

    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> hf.build_reach_map(cable, hf.Arm(length=0.105), x=[2.2, 2.4], y=[0.0])
    ReachMap(2 targets, 0 feasible, 0 wound)
    """
    if "obstacles" in options:
        options["obstacles"] = checked_obstacles(options["obstacles"], "obstacles")
    named = ("clearance", "turns", "settle", "side", "obstacles", "behind")
    known = {name: options[name] for name in named if options.get(name) is not None}
    known |= {"time": options.get("time_limit") or 0.0, "contact": options.get("contact") or 0.0}
    problem = Problem(rope, arm, MotorLimits() if limits is None else limits, **known)
    refuse_behind(problem.behind, "a reach map")
    if options.get("state0") is not None:
        fix = "Plan these targets one by one"
        raise InvalidInput("a reach map begins with a rope that hangs", got="state0", allowed="none", fix=fix)
    middle, far = problem.arm.pivot, problem.arm.length + problem.rope.total_length
    count = checks.count("cells", cells)
    steps = (np.arange(count) + 0.5) * far / count
    places = middle[0] + steps if x is None else _increasing("x", x)
    levels = middle[1] + np.concatenate([-steps[::-1], steps]) if y is None else _increasing("y", y)
    if places.size * levels.size > MOST_CELLS:
        raise InvalidInput(
            "the grid is too fine", got=places.size * levels.size, allowed=f"{MOST_CELLS} targets at most"
        )
    targets = [Peg(float(one), float(level), radius, mu) for level in levels for one in places]
    given = {"time_budget": time_budget, "on_plan": _first, **options}
    plans, stop = plan_each(rope, arm, targets, limits, given, executor, chunk_size, progress)
    values = {name: np.full(len(targets), np.nan) for name in VARIABLES}
    values["status"] = np.full(len(targets), NOT_PLANNED)
    for number, plan in plans.items():
        if plan.interrupted and not plan.success:
            continue
        for name, value in _figures(plan).items():
            values[name][number] = value
    shaped: dict[str, Any] = {name: each.reshape(levels.size, places.size) for name, each in values.items()}
    asked = time_budget, options.get("holding_force", 0.0), options.get("seed", 0)
    return stop.deliver(ReachMap(problem, places, levels, targets[0].radius, targets[0].mu, *asked, **shaped))


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
    limits = {each.name: f"motor_{each.name}" for each in fields(MotorLimits)}
    own = (*ASKED, *OWN, "setup")
    missing = [name for name in ("x", "y", *VARIABLES) if name not in held]
    missing += [f"attribute {name!r}" for name in (*own, *limits.values()) if name not in about]
    if missing:
        raise InvalidInput(f"{path} lacks parts of a reach map", got=missing, fix="Make it again")
    numbers: dict[str, Any] = {name: held[name].numbers(name) for name in ("x", "y", *VARIABLES)}
    shape = (numbers["y"].size, numbers["x"].size)
    for name in VARIABLES:
        checks.array(name, numbers[name], shape, gaps=name != "status")
    numbers |= {name: _increasing(name, numbers[name]) for name in ("x", "y")}
    numbers["status"] = numbers["status"].astype(np.int64)
    setup = Setup.loads(str(about["setup"]), f"the set-up in {path}")
    motor = MotorLimits(**{name: _plain(about[key]) for name, key in limits.items()})
    rest: Mapping[str, Any] = {name: _plain(about[name]) for name in OWN}
    known = Problem(
        setup.rope, setup.arm or Arm(), motor, **{**rest, "side": int(rest["side"]), "obstacles": setup.pegs}
    )
    asked: dict[str, Any] = {name: float(about[name]) for name in ASKED} | {"seed": int(about["seed"])}
    return ReachMap(known, **asked, **numbers)


def _first(plan: CastPlan) -> bool:
    """End a search with the first plan that stands."""
    return plan.success


def _figures(plan: CastPlan) -> dict[str, float]:
    found = {"status": plan.status, "seconds": plan.seconds}
    if plan.success and plan.outcome is not None:
        found |= {"turns": abs(plan.outcome.turns), "contact_angle": plan.outcome.contact_angle}
    return found


def _increasing(name: str, value: npt.ArrayLike) -> Array:
    places = checks.array(name, value, (-1,), unit="m")
    if not places.size or (np.diff(places) <= 0.0).any():
        raise InvalidInput(
            f"{name} of the grid is not increasing", got=places, allowed="one place or more, increasing, m"
        )
    return places


def _attributes(unit: str, name: str) -> dict[str, str]:
    return {"units": unit, "long_name": name}


def _plain(value: Any) -> Any:
    return tuple(float(each) for each in value) if np.ndim(value) else float(value)
