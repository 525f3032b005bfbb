"""``hyperflex cast``, ``whip``, ``insert`` and ``reach-map``: a rope, an arm and a target in, a motion out."""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex import checks, files
from hyperflex.cli import output
from hyperflex.cli.command import Given, OutFolder, TimeBudget, Workers, positive
from hyperflex.cli.output import Rows
from hyperflex.cli.problem import ArmLength, RopeFile, SetupFile, peg_of, read_problem, target_of
from hyperflex.errors import InvalidInput
from hyperflex.planning import Conditions, MotorLimits, SearchOptions, Slot, TipTarget, WindCriteria

if TYPE_CHECKING:
    from hyperflex.planning import CastPlan
    from hyperflex.report import PlanReport

_DATA, _PICTURE = "reach-map.nc", "reach-map.png"  # files of a reach map
_RADIUS = 0.03  # m, of its targets by default
_WRITTEN = {
    "page": "all results on one page",
    "motion": "the motion for the motor",
    "plan": "the set-up, for simulate",
    "nearest": "the nearest target's, for simulate",
    "run": "the verified run",
}


def _rate(option: typer.CallbackParam, value: float) -> float:
    """Refuse, before the search, a rate that would give too few rows, or too many, of any plan."""
    if not 10.0 <= checks.number(option.opts[0], value, sign="positive", unit="Hz") <= 1e5:
        raise InvalidInput("--rate suits no motor", got=value, allowed="10 to 100,000 rows a second")
    return value


Target = Annotated[
    tuple[float, float] | None,
    typer.Option(help="Place of the target: x to the right and y up, m; the motor's shaft is at [arm] pivot."),
]
Radius = Annotated[float | None, typer.Option(callback=positive("m"), help="Radius of the target, a peg, m.")]
Friction = Annotated[float | None, typer.Option(help="Coefficient of friction between rope and target. [default: 0.3]")]
Rate = Annotated[float, typer.Option(callback=_rate, help="Rows a second in the motor's file, Hz, 10 to 100,000.")]
Limits = Annotated[Given, MotorLimits]
Winding = Annotated[Given, WindCriteria, "turns", "contact", "settle", "holding_force"]
Search = Annotated[Given, SearchOptions, "seed", "skip_feasibility"]
When = Annotated[Given, Conditions, "time_limit", "clearance"]


def cast(
    out: OutFolder,
    setup: SetupFile = None,
    rope: RopeFile = None,
    target: Target = None,
    radius: Radius = None,
    mu: Friction = None,
    *,
    criteria: Winding,
    conditions: When,
    arm_length: ArmLength = None,
    limits: Limits,
    robust: Annotated[
        bool,
        typer.Option(
            "--robust",
            help="Plan for uncertain rope, target and motor, and print how often the rope stays wound: by the "
            "covariance that identify wrote into the rope's file, else with that of a usual identification.",
        ),
    ] = False,
    search: Annotated[Given, SearchOptions, "seed", "skip_feasibility", "fallback"],
    rate: Rate = 200.0,
    time_budget: TimeBudget = 60.0,
) -> None:
    """Plan a cast that winds the rope round a peg and holds.

    The target is given by options, or as the first of [pegs] in the set-up file. All other pegs, [walls] and [grounds]
    of the file are obstacles, which the rope must not touch. The table [behind], with the keys of [pegs], holds pegs
    behind which the rope must run: in the end it touches each of them between the arm and the target. An earlier plan's
    file can be given as set-up; its criteria count unless options say otherwise.

    A rope is wound with --turns turns, counted from the arm's tip to its end, and holds if it slips by less than 5 mm
    in 2 s. A rope that goes through itself, its arm or the motor's shaft fails.

    The first plan that succeeds, and each better one, is reported on standard error. The search ends with a plan that
    has a margin, or with the time. The plan is verified in simulation with shorter links. The command writes a page
    that plays the run, pictures, the motion for the motor (CSV), the verified run (NetCDF) and a set-up for simulate;
    it replaces the files of an earlier cast in the folder.

    Ctrl-C ends the search; the best plan so far is written, marked as interrupted. The exit code is 4 if no cast
    succeeds; the best throw is written with the reason and with the nearest target that should work.
    """
    from hyperflex.planning import Uncertainty, plan_cast
    from hyperflex.report import CastReport, check_folder

    check_folder(out)
    problem, targets = read_problem(setup, rope, arm_length, limits, conditions, criteria)
    uncertainty = Uncertainty.from_rope_file(rope or setup or Path()) if robust else None
    peg = peg_of(targets["peg"], target, radius, mu)
    plan, _ = output.run(
        lambda: plan_cast(
            problem.rope,
            problem.arm,
            peg,
            problem.limits,
            criteria=problem.criteria,
            conditions=Conditions(**conditions | {"clearance": problem.clearance, "obstacles": problem.obstacles}),
            uncertainty=uncertainty,
            time_budget=time_budget,
            options=SearchOptions(**search, progress=True),
            on_plan=_report_plan,
        )
    )
    written, result = _write(CastReport(plan, None), out, rate)
    if uncertainty is not None:
        result["uncertainty"] = uncertainty.describe()
    with output.keeping(written, "the page and its figures", result), output.spinner() as progress:
        progress("simulating a tug at the rope")
        held = None if plan.interrupted else plan.measure_holding_force()
        report = CastReport(plan, held)
        written |= report.add_page(out, progress=progress)
    if held is not None:
        result["holding_force"] = {
            "force": held.force,
            "slipped": held.tug.slipped,
            "tail_weight": held.tail_weight,
            "contact_angle": held.contact_angle,
            "capstan_force": held.capstan_force,
        }
    notes = [] if uncertainty is None else [f"Uncertain: {uncertainty.describe()}."]
    if plan.success_probability is not None:
        notes.append(f"Probability that the rope stays wound (slip is not checked): {plan.success_probability}.")
    _finish(report, written, result, [*notes, *report.advice])


def _report_plan(plan: "CastPlan") -> None:
    """Report a plan that succeeds on standard error."""
    outcome = plan.required(plan.outcome, "outcome")
    got = f"{abs(outcome.turns):.2f} turns, {math.degrees(outcome.contact_angle):.0f} degrees of the target"
    output.note(f"a cast succeeds after {plan.seconds:.1f} s: {got}")


def whip(
    out: OutFolder,
    setup: SetupFile = None,
    rope: RopeFile = None,
    *,
    target: Annotated[Given, TipTarget],
    conditions: When,
    arm_length: ArmLength = None,
    limits: Limits,
    search: Search,
    rate: Rate = 200.0,
    time_budget: TimeBudget = 30.0,
) -> None:
    """Plan a whip whose tip passes a point at a peak of its speed.

    The target is given by options, or as the table [target] of the set-up file with the same names and units. [pegs],
    [walls] and [grounds] of the file are obstacles, which the rope must not touch.

    The plan is verified in simulation, also with links of half the length; the impact on a small peg at the target is
    simulated too. The command writes the same files as cast.

    Ctrl-C ends the search; the best plan so far is written, marked as interrupted. The exit code is 4 if no whip meets
    the target; the best is written with the reason.
    """
    from hyperflex.planning import plan_whip, refuse_behind
    from hyperflex.report import WhipReport, check_folder

    check_folder(out)
    problem, targets = read_problem(setup, rope, arm_length, limits, conditions)
    refuse_behind(problem.criteria.behind, "a whip")
    aim = target_of("target", TipTarget, targets["target"], target)
    plan, _ = output.run(
        lambda: plan_whip(
            problem.rope,
            problem.arm,
            aim,
            problem.limits,
            conditions=Conditions(**conditions | {"clearance": problem.clearance, "obstacles": problem.obstacles}),
            time_budget=time_budget,
            options=SearchOptions(**search, progress=True),
        )
    )
    written, result = _write(WhipReport(plan, None), out, rate)
    with output.keeping(written, "the page and its figures", result), output.spinner() as progress:
        progress("simulating the impact on a small peg")
        impact = None if plan.outcome is None or plan.interrupted else plan.impact()
        report = WhipReport(plan, impact)
        written |= report.add_page(out, progress=progress)
    _finish(report, written, result | ({} if impact is None else {"impact": asdict(impact)}))


def insert(
    out: OutFolder,
    setup: SetupFile = None,
    rope: RopeFile = None,
    *,
    slot: Annotated[Given, Slot],
    conditions: When,
    arm_length: ArmLength = None,
    limits: Limits,
    search: Search,
    rate: Rate = 200.0,
    time_budget: TimeBudget = 30.0,
) -> None:
    """Plan strokes after which the tip enters a slot between walls.

    The slot is a gap between two thin walls in one line. It is given by options, or as the table [slot] of the set-up
    file with the same names and units. [pegs], [walls] and [grounds] of the file are obstacles, which the rope must not
    touch.

    The plan is verified in simulation beside the walls, also with 2.5 times the links. The success probability is that
    for a slot that is displaced by 2 mm and strokes that are mistimed by 2 ms. The command writes the same files as
    cast.

    Ctrl-C ends the search; the best plan so far is written, marked as interrupted. The exit code is 4 if no way through
    the slot was found; the best is written with the reason.
    """
    from hyperflex.planning import plan_insert, refuse_behind
    from hyperflex.report import InsertReport, check_folder

    check_folder(out)
    problem, targets = read_problem(setup, rope, arm_length, limits, conditions)
    refuse_behind(problem.criteria.behind, "an insertion")
    where = target_of("slot", Slot, targets["slot"], slot)
    plan, _ = output.run(
        lambda: plan_insert(
            problem.rope,
            problem.arm,
            where,
            problem.limits,
            conditions=Conditions(**conditions | {"clearance": problem.clearance, "obstacles": problem.obstacles}),
            time_budget=time_budget,
            options=SearchOptions(**search, progress=True),
        )
    )
    report = InsertReport(plan)
    written, result = _write(report, out, rate)
    with output.keeping(written, "the page and its figures", result), output.spinner() as progress:
        written |= report.add_page(out, progress=progress)
    _finish(report, written, result)


def _write(report: "PlanReport[Any]", out: Path, rate: float) -> tuple[dict[str, Path], dict[str, Any]]:
    """Write a plan's files; return them by kind, and the plan for JSON."""
    written = files.rescued(lambda folder: report.write_plan(folder, rate=rate), out)
    return written, report.plan.summary() | {"verdict": report.verdict}


def _finish(
    report: "PlanReport[Any]", written: Mapping[str, Path], result: Mapping[str, Any], notes: Sequence[str] = ()
) -> None:
    """Print a plan, its verdict with notes, and the files that were written; end with the plan's exit code."""
    plan = report.plan
    stopped = f"Interrupted; the best plan so far is in {written['page'].parent}. {report.verdict}"
    output.show(
        {**result, "files": written},
        Rows(f"{report.name.capitalize()} (simulated)", report.tiles),
        "\n".join((report.verdict, *filter(None, [getattr(report, "warning", "")]), *notes)),
        Rows("Written", [(text, str(written[kind])) for kind, text in _WRITTEN.items() if kind in written]),
        interrupted=stopped if plan.interrupted else "",
        code=0 if plan.success else output.NO_PLAN,
    )


def reach_map(
    out: OutFolder,
    setup: SetupFile = None,
    rope: RopeFile = None,
    radius: Radius = None,
    mu: Friction = None,
    *,
    cells: Annotated[
        int, typer.Option(min=1, max=200, help="Cells of the grid, from the shaft to the rope's reach.")
    ] = 8,
    criteria: Winding,
    conditions: Annotated[Given, Conditions, "clearance"],
    arm_length: ArmLength = None,
    limits: Limits,
    search: Annotated[Given, SearchOptions, "seed"],
    time_budget: Annotated[float, typer.Option(callback=positive("s"), help="Time for each target, s.")] = 10.0,
    workers: Workers = 1,
) -> None:
    """Map the targets that a rope can wind.

    The command plans a cast for each target of a grid. The grid covers the right-hand side, up to the rope's reach; the
    left is its mirror image, but for obstacles and for a motor that turns further to one side. Targets that are not
    feasible take no time, others a few seconds each: minutes in all. The command writes a picture and the data
    (NetCDF).

    A target that is red on the picture was not wound in the time: a longer --time-budget may wind it, above all with a
    long rope.

    A set-up file is read as by cast: the targets are like the first of [pegs], by default of radius 0.03 m; all other
    pegs, [walls] and [grounds] are obstacles.

    Ctrl-C ends it; the map so far is written, marked as incomplete.
    """
    from hyperflex.planning import NOT_PLANNED, TargetGrid, build_reach_map
    from hyperflex.report import check_folder, save_png, whole_folder

    check_folder(out)
    problem, targets = read_problem(setup, rope, arm_length, limits, conditions, criteria)
    first = targets["peg"]
    like = peg_of(first, None if first else (0.0, 0.0), radius or (None if first else _RADIUS), mu)
    with _processes(workers) as executor:
        found, stopped = output.run(
            lambda: build_reach_map(
                problem.rope,
                problem.arm,
                problem.limits,
                grid=TargetGrid(cells=cells, radius=like.radius, mu=like.mu),
                criteria=problem.criteria,
                conditions=Conditions(clearance=problem.clearance, obstacles=problem.obstacles),
                time_budget=time_budget,
                options=SearchOptions(**search, threads=1, executor=executor, progress=True),
            )
        )

    def write(folder: Path) -> dict[str, Path]:
        with whole_folder(folder, (_DATA, _PICTURE)) as stage:
            found.to_netcdf(stage / _DATA)
            save_png(found.plot(), stage / _PICTURE)
        return {"map": folder / _DATA, "picture": folder / _PICTURE}

    written = files.rescued(write, out)
    targets_, wound = found.status.size, int(found.wound.sum())
    searched = int((~found.infeasible & (found.status != NOT_PLANNED)).sum())
    result = {"source": "simulated", "targets": targets_, "feasible": searched, "wound": wound}
    rows = [
        ("targets", f"{targets_}, {searched} of them feasible"),
        ("wound", f"{wound} of these, in simulation"),
        ("written", ", ".join(map(str, written.values()))),
    ]
    output.show(
        result | {"complete": found.complete, "files": written},
        Rows("Reach map (simulated)", rows),
        interrupted=f"Interrupted; the map so far is in {out}." if stopped else "",
    )


def _processes(workers: int) -> AbstractContextManager[Executor | None]:
    """Return processes that inherit no open files from this one; none for a single worker."""
    return nullcontext() if workers == 1 else ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
