"""What `cast`, `whip` and `insert` share: options, the set-up file, and how they end."""

from __future__ import annotations

import math
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from hyperflex import checks, files
from hyperflex.cli import output
from hyperflex.errors import InvalidInput

if TYPE_CHECKING:
    from hyperflex.model import Arm, Ground, Peg, Rope, Wall
    from hyperflex.planning import MotorLimits
    from hyperflex.report import PlanReport, Progress

    Obstacle = Peg | Wall | Ground


def positive(unit: str) -> Callable[[typer.CallbackParam, float | None], float | None]:
    """Return the check of an option whose value, if given, is positive and finite."""

    def check(option: typer.CallbackParam, value: float | None) -> float | None:
        return None if value is None else checks.number(option.opts[0], value, sign="positive", unit=unit)

    return check


def _rate(option: typer.CallbackParam, value: float) -> float:
    """Refuse, before the search, a rate that would give too few rows, or too many, of whatever is found."""
    if not 10.0 <= checks.number(option.opts[0], value, sign="positive", unit="Hz") <= 1e5:
        raise InvalidInput("--rate suits no motor", got=value, allowed="10 to 100,000 rows a second")
    return value


Setup = Annotated[
    Path | None,
    typer.Argument(help="TOML file with [rope], [arm], [limits] and the target; options override it."),
]
RopeFile = Annotated[
    Path | None, typer.Option("--rope", help="TOML file with the rope, such as identify writes; in place of [rope].")
]
Target = Annotated[
    tuple[float, float] | None,
    typer.Option(
        help="The target's place, x and y (up), m; the motor's shaft is at (0, 0) unless [arm] says otherwise (pivot)."
    ),
]
Output = Annotated[Path, typer.Option("--output", "-o", help="Folder to write to; made if need be.")]
ArmLength = Annotated[
    float | None, typer.Option(callback=positive("m"), help="Of the arm that the motor turns, m. [default: 0.105]")
]
Speed = Annotated[float | None, typer.Option(help="Greatest speed of the motor, rad/s. [default: 8.61, the paper's]")]
Acceleration = Annotated[
    float | None, typer.Option(help="Greatest acceleration, rad/s^2. [default: 23.6, the paper's]")
]
Torque = Annotated[float | None, typer.Option(help="Greatest torque, N m. [default: not limited]")]
Clearance = Annotated[
    float | None,
    typer.Option(
        help="Least distance of the rope from arm, shaft and obstacles, m; -inf: none from arm and shaft. [default: 0, "
        "or an earlier plan's whose file is given]",
    ),
]
Turns = Annotated[
    float | None,
    typer.Option(
        help="Least turns of the rope about the target, from the arm's tip to its end. [default: 1.25, or an earlier "
        "plan's whose file is given]"
    ),
]
Settle = Annotated[
    float | None,
    typer.Option(
        help="Time from the arm's stop, s, after which the rope is watched for 2 s. [default: 1, or an earlier plan's "
        "whose file is given]"
    ),
]
SkipFeasibility = Annotated[
    bool, typer.Option("--skip-feasibility", help="Search even for a target that is called out of reach.")
]
Rate = Annotated[float, typer.Option(callback=_rate, help="Rows a second in the motor's file, Hz, 10 to 100,000.")]
TimeBudget = Annotated[
    float,
    typer.Option(callback=positive("s"), help="Of planning, verifications included, s; a good plan ends it before."),
]
Seed = Annotated[int, typer.Option(help="Of the search.")]

CRITERION = ("clearance", "contact", "turns", "settle")  # of a wound rope
_TABLES = ("rope", "arm", "pegs", "walls", "grounds")  # of a set-up file, as for simulate
_WRITTEN = {
    "page": "the whole story on one page",
    "motion": "the motion for the motor",
    "plan": "the set-up, for simulate",
    "nearest": "the nearest target's, for simulate",
    "run": "the verified run",
}


class Task(NamedTuple):
    """What is planned with: rope, arm, limits of the motor, obstacles, and [target] and [slot] of a set-up file.

    And the criterion, which an earlier plan's file says where no option does: `clearance`, m, `contact`, rad or None,
    `turns`, and `settle`, s. And the pegs of [behind], which the rope of a cast is to run behind.
    """

    rope: Rope
    arm: Arm
    limits: MotorLimits
    obstacles: tuple[Obstacle, ...]
    target: Mapping[str, Any]
    slot: Mapping[str, Any]
    clearance: float
    contact: float | None
    turns: float
    settle: float
    behind: tuple[Peg, ...]


def read_task(
    setup: Path | None,
    rope: Path | None,
    arm_length: float | None,
    limits: Mapping[str, Any],
    criterion: Mapping[str, float | None],
) -> Task:
    """Return what the TOML files and the options give; options override the set-up file.

    `limits` are arguments of MotorLimits, `criterion` has clearance, and of CRITERION what else can be asked for; those
    that are not given are None.
    """
    from hyperflex.model import PLAN, PLANNING, Arm, Rope, Setup, check_tables
    from hyperflex.planning import MotorLimits, Problem

    content = {} if setup is None else files.read_toml(setup)
    again = dict(criterion)
    if setup is not None and PLAN in content:
        content = _of_plan(setup, again)
    for name in ("limits", "target", "slot"):
        if not isinstance(content.get(name, {}), Mapping):
            raise InvalidInput(f"{name} of {setup} is not a table", got=content[name], allowed=f"[{name}]")
    given = content.get("limits", {}) | {name: value for name, value in limits.items() if value is not None}
    checks.keys("the table [limits]", given, [field.name for field in fields(MotorLimits)])
    if rope is not None:
        content = content | {"rope": Rope.from_toml(rope).table()}
    if "rope" not in content:
        raise InvalidInput("no rope is given", fix="Give --rope FILE, or a set-up file with a table [rope]")
    check_tables(str(setup or rope), content, (*PLANNING, "identification"))
    if swinging := [name for name in ("q0", "qd0") if name in content]:
        words = f"{' and '.join(swinging)} of {setup} {'are' if len(swinging) == 2 else 'is'} not used"
        sys.stderr.write(f"hyperflex: {words}: plans begin with a rope that hangs at rest\n")
    tables = {name: content[name] for name in _TABLES if name in content}
    read = Setup.loads(files.dumps_toml(tables), str(setup or rope))
    arm = read.arm or Arm()
    if read.arm is None and arm_length is None:
        words = "in place of it give --arm-length, or a table [arm] in the set-up file"
        sys.stderr.write(f"hyperflex: no arm is given, so the paper's is taken, {arm.length:g} m long; {words}\n")
    if arm_length is not None:
        arm = replace(arm, length=arm_length)
    places = (content.get("target", {}), content.get("slot", {}))
    usual: dict[str, Any] = {each.name: each.default for each in fields(Problem)} | {"contact": None}
    asked: dict[str, Any] = {name: usual[name] if again.get(name) is None else again[name] for name in CRITERION}
    return Task(read.rope, arm, MotorLimits(**given), read.pegs, *places, **asked, behind=_behind(content))


def _behind(content: Mapping[str, Any]) -> tuple[Peg, ...]:
    """Return the pegs of the table [behind] of a set-up file, whose keys are those of [pegs]."""
    from hyperflex.model import Peg, obstacles_of
    from hyperflex.planning import checked_behind

    table = content.get("behind", {})
    if not isinstance(table, Mapping):
        raise InvalidInput("behind is not a table", got=table, allowed="[behind], with the keys of [pegs]")
    if not table:
        return ()
    checks.keys("the table [behind]", table, [field.name for field in fields(Peg)])
    return checked_behind(obstacles_of({"pegs": table}))


def _of_plan(path: Path, again: dict[str, float | None]) -> dict[str, Any]:
    """Return the tables of a set-up for what an earlier plan was made for: its rope before it was cut, and its limits.

    What the file says beside it is the verified run, whose rope is cut for the target of then. What was asked then, and
    is not usual, is put into `again`, where no option gives it, and told on standard error.
    """
    from hyperflex.model import Setup, obstacle_tables
    from hyperflex.planning import CastPlan, InsertPlan, read_plan

    plan = read_plan(path)
    known = plan.problem
    there = Setup.from_toml(path).pegs
    if gone := [each for each in (*known.obstacles, *known.behind) if each not in there]:
        fix = "Plan from a set-up file of your own, with the obstacles that stand there now"
        raise InvalidInput(f"{path} is of a plan for other obstacles than it names", got=gone[0], fix=fix)
    if known.q0:
        fix = "Plan in Python, with state0"
        raise InvalidInput(f"{path} was planned for a rope that swings at first", got="q0", allowed="none", fix=fix)
    usual = {each.name: each.default for each in fields(known)}
    asked = {name: getattr(known, name) for name, given in again.items() if given is None}
    then = {name: value for name, value in asked.items() if value != usual[name]}
    again |= then
    if then:
        words = " ".join(f"--{name} {value:g}" for name, value in then.items())
        sys.stderr.write(
            f"hyperflex: {path} was planned with {words}, which is asked again; give another to change it\n"
        )
    cast = isinstance(plan, CastPlan)
    pegs = (plan.target, *known.obstacles) if isinstance(plan, CastPlan) else known.obstacles
    setup = Setup(known.rope, None, known.arm, pegs=pegs)
    tables: dict[str, Any] = tomllib.loads(setup.dumps())
    tables["limits"] = {field.name: getattr(known.limits, field.name) for field in fields(known.limits)}
    tables |= {"behind": obstacle_tables(known.behind).get("pegs", {})}
    name = "slot" if isinstance(plan, InsertPlan) else "target"
    return tables if cast else tables | {name: {f.name: getattr(plan.target, f.name) for f in fields(plan.target)}}


def asked(
    name: str,
    table: Mapping[str, Any],
    known: Mapping[str, tuple[checks.Sign, str]],
    place: tuple[float, float] | None,
    options: Mapping[str, float | None],
) -> dict[str, float]:
    """Return a target of the set-up file with what the options say, in SI units; its place is an option of its `name`.

    `known` has sign and unit of all that there may be.
    """
    checks.keys(f"the table [{name}]", table, known)
    given = {key: (f"{name} {key}", value) for key, value in table.items()}
    given |= {key: (f"--{name}", value) for key, value in zip("xy", place or (), strict=False)}
    given |= {key: (f"--{key.replace('_', '-')}", each) for key, each in options.items() if each is not None}
    found = {}
    for key, (words, value) in given.items():
        sign, unit = known[key]
        found[key] = checks.number(words, value, sign=sign, unit=unit)
        if unit == "rad" and abs(found[key]) > math.tau:
            fix = f"If these are degrees, give {math.radians(found[key]):.4g}"
            raise InvalidInput(f"{words} is more than a turn", got=found[key], allowed="up to 2 pi, in rad", fix=fix)
    if not {"x", "y"} <= set(found):
        raise InvalidInput(f"--{name} is missing", fix=f"Give it, or a set-up file with a table [{name}]")
    return found


def first_peg(task: Task) -> Peg | None:
    """Return the first peg of a set-up, the target of its casts; None without."""
    from hyperflex.model import Peg

    return next((each for each in task.obstacles if isinstance(each, Peg)), None)


def peg_of(task: Task, place: tuple[float, float] | None, radius: float | None, mu: float | None) -> Peg:
    """Return the target of a cast: the set-up's first peg, or a peg as the options say.

    That the first peg is moved by a `place`, and is no obstacle where it was, is told on standard error.
    """
    from hyperflex.model import Peg

    first = first_peg(task)
    if first is not None and place is not None and place != (first.x, first.y):
        words = f"the first of [pegs] is the target: --target moves it from ({first.x:g}, {first.y:g}) m"
        sys.stderr.write(f"hyperflex: {words}, where no obstacle is left. Name obstacles after it\n")
    given = {"radius": radius, "mu": mu} | dict(zip("xy", place or (None, None), strict=True))
    named = {name: value for name, value in given.items() if value is not None}
    if first is not None:
        return replace(first, **named)
    missing = [option for option, value in (("--target", place), ("--radius", radius)) if value is None]
    if missing:
        are, them = ("is", "it") if len(missing) == 1 else ("are", "them")
        fix = f"Give {them}, or a set-up file with a table [pegs]"
        raise InvalidInput(f"{' and '.join(missing)} {are} missing", fix=fix)
    return Peg(**named)


@contextmanager
def writing(
    report: PlanReport[Any], out: Path, *, rate: float, as_json: bool
) -> Iterator[tuple[dict[str, Path], Progress]]:
    """Write a plan's files; yield them by kind, and the progress callable of what is then drawn beside them.

    Ctrl-C in the block leaves them, says what is missing and exits.
    """
    written = files.rescued(lambda folder: report.write_plan(folder, rate=rate), out)
    result = report.plan.summary() | {"verdict": report.verdict}
    missing = "the page and its figures"
    with output.keeping(written, missing, result, as_json=as_json), output.spinner() as progress:
        yield written, progress


def finish(
    report: PlanReport[Any],
    files: Mapping[str, Path],
    result: Mapping[str, Any],
    notes: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Print what a planner found, with sentences after the verdict, or print `result` as JSON, and exit with its code.

    `files` are those that were written, by kind. Raises typer.Exit with NO_PLAN, or as interrupted, unless the
    plan succeeds.
    """
    result = {**result, "files": files}
    if not as_json:
        output.print_pairs(f"{report.name.capitalize()} (simulated)", report.tiles)
        output.console().print("\n".join((report.verdict, *notes)), markup=False)
        written = [(words, str(files[kind])) for kind, words in _WRITTEN.items() if kind in files]
        output.print_pairs("Written", written)
    if report.plan.interrupted:
        message = f"Interrupted; the best so far is in {files['page'].parent}. {report.verdict}"
        raise typer.Exit(output.interrupted(message, result, as_json=as_json))
    if as_json:
        output.print_json(result)
    if not report.plan.success:
        raise typer.Exit(output.NO_PLAN)
