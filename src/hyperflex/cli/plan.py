"""``hyperflex cast``, ``whip``, ``insert`` and ``reach-map``: a rope, an arm and a target in, a motion out."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import MISSING, asdict, dataclass, fields, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import typer

from hyperflex import checks, files, hardware, planning, report
from hyperflex.checks import ByName
from hyperflex.cli import output
from hyperflex.cli.command import ArmLength, Given, OutFolder, Workers
from hyperflex.cli.output import Rows
from hyperflex.errors import InvalidInput, located
from hyperflex.model import PLAN, PLANNING, Arm, Obstacle, Peg, Rope, Setup, check_tables, obstacles_of, warn_of_grade
from hyperflex.options import options_of
from hyperflex.planning import (
    Conditions,
    MotorLimits,
    SearchOptions,
    Slot,
    TargetGrid,
    TipTarget,
    WindCriteria,
    checked_behind,
    refuse_behind,
)

_T = TypeVar("_T")
_DATA, _PICTURE = "reach-map.nc", "reach-map.png"  # files of a reach map
_WRITTEN = {
    "page": "all results on one page",
    "motion": "the motion for the motor",
    "plan": "the set-up, for simulate",
    "nearest": "the nearest target's, for simulate",
    "run": "the verified run",
}


def _rate(option: typer.CallbackParam, value: float) -> float:
    """Refuse, before the search, a rate that would give too few rows, or too many, of any plan."""
    if not 10.0 <= checks.positive(option.opts[0], value, "Hz") <= 1e5:
        raise InvalidInput("--rate suits no motor", got=value, allowed="10 to 100,000 rows a second")
    return value


TimeBudget = Annotated[float, "Time for the search and its verification, without compiling", "s"]
Winding = Annotated[Given, WindCriteria, "turns", "contact", "settle", "holding_force", "max_sideways", "tilt"]


class Problem(NamedTuple):
    """What is planned for, and the targets of a set-up file: its tables by name, and "peg", the first peg."""

    rope: Rope
    arm: Arm
    limits: MotorLimits
    criteria: WindCriteria
    conditions: Conditions
    targets: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Source:
    """Options of all planners: files with rope, arm, limits and target, and the folder for the results."""

    out: OutFolder
    setup: Annotated[
        Path | None,
        typer.Argument(help="TOML file with [rope], [arm], [limits] and the target; options override it."),
    ] = None
    rope: Annotated[Path | None, "TOML file with the rope, such as identify writes; overrides [rope]."] = None
    arm_length: ArmLength = None
    drive: Annotated[
        Path | None,
        "File of hyperflex motor identify: its lag counts with --robust, its limits always.",
    ] = None
    limits: Annotated[Given, MotorLimits]

    def identified(self) -> "hardware.DriveFit | None":
        """Return the identified drive; None without."""
        return None if self.drive is None else hardware.DriveFit.from_toml(self.drive)

    def read(self, conditions: Given, criteria: Given | None = None, aim: "Aim | None" = None) -> Problem:
        """Return what is planned for, after a check of the folder for the results; options override the file.

        The first peg is the target if `criteria` of a wound rope are given, else an obstacle. A plan's file gives the
        problem that the plan was made for, with the rope before it was cut. Without a rope, the options that `aim`
        lacks are named as well.
        """
        report.check_folder(self.out)
        content = {} if self.setup is None else files.read_toml(self.setup)
        if PLAN in content and self.setup is not None:
            found = _of_plan(self.setup, {**conditions, **(criteria or {})})
            rope = found.rope if self.rope is None else Rope.from_toml(self.rope)
        else:
            found = self._of_tables(content, aim)
            rope = found.rope
        arm = found.arm if self.arm_length is None else replace(found.arm, length=self.arm_length)
        obstacles = list(found.conditions.obstacles)
        first = None
        if criteria is None:
            refuse_behind(found.criteria.behind, "a whip or an insertion")
        else:
            first = next((each for each in obstacles if isinstance(each, Peg)), None)
            obstacles = [each for each in obstacles if each is not first]
        drive = self.identified()
        limits = found.limits if drive is None else drive.motor_limits(found.limits)
        return Problem(
            rope,
            arm,
            replace(limits, **self.limits),
            replace(found.criteria, **(criteria or {})),
            replace(found.conditions, obstacles=tuple(obstacles), **conditions),
            {**found.targets, "peg": first},
        )

    def _of_tables(self, content: ByName, aim: "Aim | None") -> Problem:
        """Return the problem and the targets of a set-up file's tables, or of the rope's file alone."""
        tables = {name: content.get(name, {}) for name in ("limits", "target", "slot")}
        for name, table in tables.items():
            checks.mapping(f"{name} of {self.setup}", table)
        checks.keys("the table [limits]", tables["limits"], [each.name for each in fields(MotorLimits)])
        if self.rope is not None:
            content["rope"] = Rope.from_toml(self.rope).table()
        elif self.setup is not None:
            warn_of_grade(self.setup, content)
        if "rope" not in content:
            also = aim.missing(content.get(aim.name, {})) if aim else ""
            raise InvalidInput(
                f"no rope is given{also and f', and {also}'}",
                fix="Give --rope FILE, or a set-up file with a table [rope]",
            )
        where = str(self.setup or self.rope)
        check_tables(where, content, (*PLANNING, "identification"))
        if swinging := [name for name in ("q0", "qd0") if name in content]:
            output.note(f"{' and '.join(swinging)} of {where}: not used, plans begin with a rope that hangs at rest")
        with located(where, files.toml_words):
            rope, arm = Rope.from_table(content["rope"]), Arm.from_table(content.get("arm", {}))
            obstacles = obstacles_of(content)
            behind = obstacles_of({"pegs": content.get("behind", [])})
        if "arm" not in content and self.arm_length is None:
            advice = "give --arm-length, or a table [arm] in the set-up file, for another"
            output.note(f"no arm is given, so the paper's is used, {arm.length:g} m long; {advice}")
        criteria, conditions = WindCriteria(behind=checked_behind(behind)), Conditions(obstacles=tuple(obstacles))
        return Problem(rope, arm, MotorLimits(**tables["limits"]), criteria, conditions, tables)


def _of_plan(path: Path, given: Given) -> Problem:
    """Return problem and target of an earlier plan; report criteria that are neither given nor the defaults."""
    plan = planning.read_plan(path)
    known, there = plan.problem, Setup.from_toml(path).pegs
    if gone := [each for each in (*known.obstacles, *known.criteria.behind) if each not in there]:
        fix = "Plan from your own set-up file with the present obstacles"
        raise InvalidInput(f"{path} is of a plan for other obstacles than it names", got=gone[0], fix=fix)
    if known.q0:
        fix = "Plan in Python, with state0"
        raise InvalidInput(f"{path} was planned for a rope that swings at first", got="q0", allowed="none", fix=fix)
    required = {each.name: (getattr(known.criteria, each.name), each.default) for each in options_of(WindCriteria)}
    required["clearance"] = known.clearance, Conditions.clearance
    special = [
        f"--{name.replace('_', '-')} {value:g}"
        for name, (value, default) in required.items()
        if value != default and name not in given
    ]
    if special:
        output.note(f"{path} was planned with {' '.join(special)}, which is required again; give another to change it")
    obstacles: tuple[Obstacle, ...] = known.obstacles
    targets: ByName = {"target": {}, "slot": {}}
    if isinstance(plan, planning.CastPlan):
        obstacles = (plan.target, *obstacles)
    else:
        kind: type = type(plan.target)
        values = {each.name: getattr(plan.target, each.name) for each in options_of(kind)}
        targets["slot" if isinstance(plan, planning.InsertPlan) else "target"] = values
    conditions = Conditions(clearance=known.clearance, obstacles=obstacles)
    return Problem(known.rope, known.arm, known.limits, known.criteria, conditions, targets)


class Aim(NamedTuple):
    """A target of a dataclass `kind`: the table [name] of a set-up file, with `given` options over it."""

    name: str
    kind: Any
    given: Given
    option: str  # of its place

    def missing(self, table: Mapping[str, Any]) -> str:
        """Return that options are missing which the table does not hold either; empty if none is."""
        lacking = [each.name for each in options_of(self.kind) if each.default is MISSING and each.name != "y"]
        names = [f"--{self.option if each == 'x' else each}" for each in lacking if each not in {*table, *self.given}]
        return f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} missing" if names else ""

    def target(self, table: Mapping[str, Any]) -> Any:
        """Return the target."""
        checks.keys(f"the table [{self.name}]", table, [each.name for each in options_of(self.kind)])
        if missing := self.missing(table):
            raise InvalidInput(missing, fix=f"Give the missing values, or a set-up file with a table [{self.name}]")
        return self.kind(**{**table, **self.given})


@dataclass(frozen=True, kw_only=True)
class Task(Source):
    """Options of the planners of one target."""

    conditions: Annotated[Given, Conditions, "time_limit", "clearance"]
    search: Annotated[Given, SearchOptions, "seed", "skip_feasibility"]
    rate: Annotated[
        float, typer.Option(callback=_rate, help="Rows a second in the motor's file, Hz, 10 to 100,000.")
    ] = 200.0

    def plan(self, planner: Callable[..., _T], problem: Problem, target: Any, **more: Any) -> _T:
        """Return a plan for a target; after Ctrl-C the best so far. `more` are further arguments of the planner."""
        options = SearchOptions(**self.search, **more.pop("search", {}), progress=True)
        base = problem.rope, problem.arm, target, problem.limits
        return output.run(lambda: planner(*base, conditions=problem.conditions, options=options, **more))[0]

    def finish(
        self,
        plan: Any,
        report_of: "Callable[[Any, Any], report.PlanReport[Any]]",
        measure: Callable[[], tuple[Any, ByName]],
        doing: str,
        notes: Sequence[str] = (),
        **more: Any,
    ) -> None:
        """Write a plan, then what is measured on it and its page; print it, and end with its exit code.

        `measure` returns what the report takes, and the same for JSON; `doing` says what it does. `notes` and `more`
        are further text and JSON.
        """
        report = report_of(plan, None)
        written = files.rescued(lambda folder: report.write_plan(folder, rate=self.rate), self.out)
        result = {**plan.summary(), "verdict": report.verdict, **more}
        with output.keeping(written, "the page and its figures", result), output.spinner() as progress:
            progress(doing)
            if plan.seen is not None and not plan.interrupted:
                measured, values = measure()
                report, result = report_of(plan, measured), result | values
            written |= report.add_page(self.out, progress=progress, remarks=output.WARNED)
        kept = "the page" if plan.moves is None else "the best plan so far"
        stopped = f"Interrupted; {kept} is in {written['page'].parent}. {report.verdict}"
        output.show(
            {**result, "files": written},
            Rows(f"{report.name.capitalize()} (simulated)", report.tiles),
            "\n".join(filter(None, (report.verdict, report.warning, *notes, *report.advice))),
            Rows("Written", [(text, written[kind]) for kind, text in _WRITTEN.items() if kind in written]),
            interrupted=stopped if plan.interrupted else "",
            code=0 if plan.success else output.ExitCode.NO_PLAN,
        )


def cast(
    target: Annotated[Given, Peg, "x", "radius", "mu"],
    task: Task,
    *,
    criteria: Winding,
    robust: Annotated[
        bool,
        "Plan for uncertain rope, target and motor, and print the success probability. The covariance is that "
        "in the rope's file, else that of a usual identification.",
    ] = False,
    search: Annotated[Given, SearchOptions, "fallback"],
    time_budget: TimeBudget = 60.0,
) -> None:
    """Plan a cast that winds the rope round a peg and holds.

    The target is given by options, or as the first of [[pegs]] in the set-up file. All other pegs, [[walls]] and
    [[grounds]] of the file are obstacles, which the rope must not touch. Each table [[behind]], with the keys of
    [[pegs]], is a peg behind which the rope must run: in the end it touches it between the arm and the target. An
    earlier plan's file can be given as set-up; its criteria count unless options say otherwise.

    A rope is wound with --turns turns, counted from the arm's tip to its end, and holds if it slips by less than 5 mm
    in 2 s. A cast fails if the rope passes through itself, its arm or the motor's shaft.

    The first plan that succeeds, and each better one, is reported on standard error. The search ends when a plan has a
    margin, or when the time runs out. The plan is verified in simulation with shorter links. The command writes a page
    that plays the run, pictures, the motion for the motor (CSV), the verified run (NetCDF) and a set-up for simulate;
    it replaces the files of an earlier cast in the folder.

    Ctrl-C ends the search; the best plan so far is written, marked as interrupted. The exit code is 4 if no cast
    succeeds; the best is written with the reason and with the nearest target that should work.
    """
    aim = Aim("pegs", Peg, target, "target")
    problem = task.read(task.conditions, criteria, aim)
    first: Peg | None = problem.targets["peg"]
    peg = aim.target({} if first is None else asdict(first))
    if first is not None and (peg.x, peg.y) != (first.x, first.y):
        moved = f"--target moves the first of [[pegs]] from ({first.x:g}, {first.y:g}) m, where no obstacle is left"
        output.note(f"{moved}. Obstacles come after it")
    uncertainty = None
    if robust:
        uncertainty = replace(
            planning.Uncertainty.from_rope_file(task.rope or task.setup or Path()), drive=task.identified()
        )
    more = {"criteria": problem.criteria, "uncertainty": uncertainty, "on_plan": _report_plan, "search": search}
    plan = task.plan(planning.plan_cast, problem, peg, time_budget=time_budget, **more)

    def measure() -> tuple[Any, ByName]:
        held = plan.measure_holding_force()
        if held is None:
            return None, {}
        names = ("force", "tail_weight", "contact_angle", "capstan_force")
        values = {name: getattr(held, name) for name in names}
        return held, {"holding_force": values | {"slipped": held.tug.slipped}}

    known = {} if uncertainty is None else {"uncertainty": uncertainty.describe()}
    notes = [f"Uncertain: {text}." for text in known.values()]
    if plan.success_probability is not None:
        notes.append(f"Probability that the rope stays wound (slip is not checked): {plan.success_probability}.")
    task.finish(plan, report.CastReport, measure, "simulating a tug at the rope", notes, **known)


def _report_plan(plan: "planning.CastPlan") -> None:
    """Report a plan that succeeds on standard error."""
    outcome = plan.required(plan.outcome, "outcome")
    got = f"{abs(outcome.turns):.2f} turns, {math.degrees(outcome.contact_angle):.0f} degrees of the target"
    output.note(f"a cast succeeds after {plan.seconds:.1f} s: {got}")


def whip(target: Annotated[Given, TipTarget], task: Task, *, time_budget: TimeBudget = 30.0) -> None:
    """Plan a whip whose tip passes a point at a peak of its speed.

    The target is given by options, or as the table [target] of the set-up file with the same names and units. [[pegs]],
    [[walls]] and [[grounds]] of the file are obstacles, which the rope must not touch.

    The plan is verified in simulation, also with links of half the length; the impact on a small peg at the target is
    simulated too. The command writes the same files as cast, with pictures of the rope at the peak (peak.png) and of
    the tip at the target (passing.png).

    Ctrl-C ends the search; the best plan so far is written, marked as interrupted. The exit code is 4 if no whip meets
    the target; the best is written with the reason.
    """
    aim = Aim("target", TipTarget, target, "target")
    problem = task.read(task.conditions, aim=aim)
    plan = task.plan(planning.plan_whip, problem, aim.target(problem.targets["target"]), time_budget=time_budget)

    def measure() -> tuple[Any, ByName]:
        impact = plan.impact()
        return impact, {"impact": asdict(impact)}

    task.finish(plan, report.WhipReport, measure, "simulating the impact on a small peg")


def insert(slot: Annotated[Given, Slot], task: Task, *, time_budget: TimeBudget = 30.0) -> None:
    """Plan strokes after which the tip enters a slot between walls.

    The slot is a gap between two thin walls in one line. It is given by options, or as the table [slot] of the set-up
    file with the same names and units. [[pegs]], [[walls]] and [[grounds]] of the file are obstacles, which the rope
    must not touch.

    The plan is verified in simulation with the walls, also with 2.5 times the links. The success probability assumes
    standard deviations of 2 mm for the slot's position and of 2 ms for the times of the strokes. The command writes the
    same files as cast, with pictures of the rope in the gap (gap.png) and of its entry (entry.png).

    Ctrl-C ends the search; the best plan so far is written, marked as interrupted. The exit code is 4 if no way through
    the slot was found; the best is written with the reason.
    """
    aim = Aim("slot", Slot, slot, "slot")
    problem = task.read(task.conditions, aim=aim)
    plan = task.plan(planning.plan_insert, problem, aim.target(problem.targets["slot"]), time_budget=time_budget)
    task.finish(plan, lambda plan, _: report.InsertReport(plan), lambda: (None, {}), "drawing the page")


def reach_map(
    source: Source,
    grid: Annotated[Given, TargetGrid],
    *,
    criteria: Winding,
    conditions: Annotated[Given, Conditions, "clearance"],
    search: Annotated[Given, SearchOptions, "seed"],
    time_budget: Annotated[float, "Time for each target", "s"] = 10.0,
    workers: Workers = 1,
) -> None:
    """Map the targets round which a rope can be wound.

    The command plans a cast for each target of a grid. The grid covers the right-hand side, up to the rope's reach; the
    left is its mirror image, unless there are obstacles or the motor turns further to one side. Infeasible targets take
    no time, others a few seconds each: minutes in all. The command writes a picture and the data (NetCDF).

    For a target that is red on the picture no plan was found in time: a longer --time-budget may find one, above all
    with a long rope.

    A set-up file is read as by cast: the targets are like the first of [[pegs]], by default of radius 0.03 m; all other
    pegs, [[walls]] and [[grounds]] are obstacles.

    Ctrl-C ends it; the map so far is written, marked as incomplete.
    """
    problem = source.read(conditions, criteria)
    first = problem.targets["peg"]
    like: Given = {} if first is None else {"radius": first.radius, "mu": first.mu}
    targets = TargetGrid(**like | grid)
    # spawned processes inherit no open files
    pool = nullcontext() if workers == 1 else ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    with pool as executor:
        found, stopped = output.run(
            lambda: planning.build_reach_map(
                problem.rope,
                problem.arm,
                problem.limits,
                grid=targets,
                criteria=problem.criteria,
                conditions=problem.conditions,
                time_budget=time_budget,
                options=SearchOptions(**search, threads=1, executor=executor, progress=True),
            )
        )

    def write(folder: Path) -> dict[str, Path]:
        with report.whole_folder(folder, (_DATA, _PICTURE)) as stage:
            found.to_netcdf(stage / _DATA)
            report.save_png(found.plot(), stage / _PICTURE)
        return {"map": folder / _DATA, "picture": folder / _PICTURE}

    written = files.rescued(write, source.out)
    result = {"source": "simulated", **found.counts, "complete": found.complete, "files": written}
    stopped_text = f"Interrupted; the map so far is in {source.out}." if stopped else ""
    output.show(result, output.rows("Reach map", result), interrupted=stopped_text)
