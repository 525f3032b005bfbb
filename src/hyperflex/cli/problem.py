"""Planning problems of the command line: a rope, an arm, limits and a target from files and options."""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from hyperflex import checks, files
from hyperflex.cli import output
from hyperflex.cli.command import Given, positive
from hyperflex.errors import InvalidInput
from hyperflex.options import options_of

if TYPE_CHECKING:
    from hyperflex.model import Peg
    from hyperflex.planning import Problem

_T = TypeVar("_T")
SetupFile = Annotated[
    Path | None, typer.Argument(help="TOML file with [rope], [arm], [limits] and the target; options override it.")
]
RopeFile = Annotated[
    Path | None, typer.Option("--rope", help="TOML file with the rope, such as identify writes; overrides [rope].")
]
ArmLength = Annotated[
    float | None,
    typer.Option(callback=positive("m"), help="Length of the arm that the motor turns, m. [default: 0.105]"),
]
_ROPE_AND_OBSTACLES = ("rope", "arm", "pegs", "walls", "grounds")  # tables of a set-up file, as for simulate


def read_problem(
    setup: Path | None,
    rope: Path | None,
    arm_length: float | None,
    limits: Given,
    conditions: Given,
    criteria: Given | None = None,
) -> "tuple[Problem, dict[str, Any]]":
    """Return a planning problem and the targets of the file: tables [target] and [slot], and "peg", the first peg.

    Options override the file. The first peg is a target if `criteria` of a wound rope are given, else an obstacle. A
    plan's file gives the problem that the plan was made for, with the rope before it was cut.
    """
    from hyperflex.model import PLAN, PLANNING, Arm, Rope, Setup, check_tables
    from hyperflex.planning import MotorLimits, Problem, WindCriteria

    wind, clearance = criteria is not None, conditions.get("clearance")
    criteria = criteria or {}
    content = {} if setup is None else files.read_toml(setup)
    if setup is not None and PLAN in content:
        problem, targets = _problem_of_plan(setup, criteria, clearance, wind)
        whole = problem.rope if rope is None else Rope.from_toml(rope)
        arm = problem.arm if arm_length is None else replace(problem.arm, length=arm_length)
        return replace(problem, rope=whole, arm=arm, limits=replace(problem.limits, **limits)), targets
    tables = {name: content.get(name, {}) for name in ("limits", "target", "slot", "behind")}
    for name, table in tables.items():
        if not isinstance(table, Mapping):
            raise InvalidInput(f"{name} of {setup} is not a table", got=table, allowed=f"[{name}]")
    checks.keys("the table [limits]", tables["limits"], [field.name for field in fields(MotorLimits)])
    if rope is not None:
        content = content | {"rope": Rope.from_toml(rope).table()}
    if "rope" not in content:
        raise InvalidInput("no rope is given", fix="Give --rope FILE, or a set-up file with a table [rope]")
    check_tables(str(setup or rope), content, (*PLANNING, "identification"))
    if swinging := [name for name in ("q0", "qd0") if name in content]:
        output.note(f"{' and '.join(swinging)} of {setup}: not used, plans begin with a rope that hangs at rest")
    used = {name: content[name] for name in _ROPE_AND_OBSTACLES if name in content}
    read = Setup.loads(files.dumps_toml(used), str(setup or rope))
    arm = read.arm or Arm()
    if read.arm is None and arm_length is None:
        advice = "give --arm-length, or a table [arm] in the set-up file, for another"
        output.note(f"no arm is given, so the paper's is used, {arm.length:g} m long; {advice}")
    if arm_length is not None:
        arm = replace(arm, length=arm_length)
    first = next(iter(read.round_pegs), None) if wind else None
    obstacles = tuple(each for each in read.pegs if each is not first)
    chosen = MotorLimits(**{**tables["limits"], **limits})
    required = WindCriteria(**criteria, behind=_behind(tables["behind"]))
    found = Problem(read.rope, arm, chosen, clearance=clearance or 0.0, criteria=required, obstacles=obstacles)
    return found, tables | {"peg": first}


def _behind(table: Mapping[str, Any]) -> "tuple[Peg, ...]":
    """Return the pegs of the table [behind] of a set-up file, whose keys are those of [pegs]."""
    from hyperflex.model import Peg, obstacles_of
    from hyperflex.planning import checked_behind

    checks.keys("the table [behind]", table, [field.name for field in fields(Peg)])
    return checked_behind(obstacles_of({"pegs": table}) if table else ())


def _problem_of_plan(
    path: Path, criteria: Given, clearance: float | None, wind: bool
) -> "tuple[Problem, dict[str, Any]]":
    """Return problem and target of an earlier plan; report criteria that are not the defaults."""
    from hyperflex.model import Setup
    from hyperflex.planning import CastPlan, InsertPlan, WindCriteria, read_plan

    plan = read_plan(path)
    problem, there = plan.problem, Setup.from_toml(path).pegs
    if gone := [each for each in (*problem.obstacles, *problem.criteria.behind) if each not in there]:
        fix = "Plan from a set-up file of your own that holds the present obstacles"
        raise InvalidInput(f"{path} is of a plan for other obstacles than it names", got=gone[0], fix=fix)
    if problem.q0:
        fix = "Plan in Python, with state0"
        raise InvalidInput(f"{path} was planned for a rope that swings at first", got="q0", allowed="none", fix=fix)
    kept = {
        each: getattr(problem.criteria, each.name) for each in options_of(WindCriteria) if each.name not in criteria
    }
    special = [f"--{each.name.replace('_', '-')} {value:g}" for each, value in kept.items() if value != each.default]
    special += [f"--clearance {problem.clearance:g}"] if clearance is None and problem.clearance else []
    if special:
        output.note(f"{path} was planned with {' '.join(special)}, which is required again; give another to change it")
    clearance = problem.clearance if clearance is None else clearance
    problem = replace(problem, side=0, time=0.0, clearance=clearance, criteria=replace(problem.criteria, **criteria))
    targets: dict[str, Any] = {"target": {}, "slot": {}, "peg": None}
    if not isinstance(plan, CastPlan):
        name = "slot" if isinstance(plan, InsertPlan) else "target"
        return problem, targets | {name: {each.name: getattr(plan.target, each.name) for each in fields(plan.target)}}
    if wind:
        return problem, targets | {"peg": plan.target}
    return replace(problem, obstacles=(plan.target, *problem.obstacles)), targets


def target_of(name: str, kind: Callable[..., _T], table: Mapping[str, Any], given: Given) -> _T:
    """Return a target of a dataclass `kind`: the table [name] of a set-up file, with options over it."""
    known = {each.name: each.default for each in options_of(kind)}
    checks.keys(f"the table [{name}]", table, known)
    values = {**table, **given}
    for each, default in known.items():
        if default is MISSING and each not in values:
            option = name if each in ("x", "y") else each
            raise InvalidInput(f"--{option} is missing", fix=f"Give it, or a set-up file with a table [{name}]")
    return kind(**values)


def peg_of(first: "Peg | None", place: tuple[float, float] | None, radius: float | None, mu: float | None) -> "Peg":
    """Return the target of a cast: the first peg of a set-up, or a peg as the options say."""
    from hyperflex.model import Peg

    if first is not None and place is not None and place != (first.x, first.y):
        moved = f"--target moves the first of [pegs] from ({first.x:g}, {first.y:g}) m, where no obstacle is left"
        output.note(f"{moved}. Obstacles come after it")
    given = {"radius": radius, "mu": mu} | dict(zip("xy", place or (None, None), strict=True))
    named = {name: value for name, value in given.items() if value is not None}
    if first is not None:
        return replace(first, **named)
    if missing := [option for option, value in (("--target", place), ("--radius", radius)) if value is None]:
        are = "is" if len(missing) == 1 else "are"
        raise InvalidInput(f"{' and '.join(missing)} {are} missing", fix="Or give a set-up file with a table [pegs]")
    return Peg(**named)
