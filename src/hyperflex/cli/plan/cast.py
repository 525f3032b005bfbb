"""``hyperflex cast``: a rope, an arm and a target in, a throw that winds and holds out."""

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex.cli import output
from hyperflex.cli.plan import planner

if TYPE_CHECKING:
    from hyperflex.planning import CastPlan, HoldingForce, Uncertainty


def cast(
    out: planner.Output,
    setup: planner.Setup = None,
    rope: planner.RopeFile = None,
    target: planner.Target = None,
    radius: Annotated[float | None, typer.Option(help="Of the target, a peg, m.")] = None,
    mu: Annotated[float | None, typer.Option(help="Friction between rope and peg. [default: 0.3]")] = None,
    arm_length: planner.ArmLength = None,
    speed: planner.Speed = None,
    acceleration: planner.Acceleration = None,
    torque: planner.Torque = None,
    holding_force: Annotated[float, typer.Option(help="Pull that the wound rope should withstand, N.")] = 0.0,
    contact: Annotated[
        float | None,
        typer.Option(
            help="Least angle of the target that the rope must cover, rad. [default: none, but a full turn is sought]",
        ),
    ] = None,
    turns: planner.Turns = None,
    settle: planner.Settle = None,
    clearance: planner.Clearance = None,
    time_limit: Annotated[
        float | None,
        typer.Option(
            callback=planner.positive("s"),
            help="Within which the rope must strike, s. [default: five periods of its swing, or more]",
        ),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option(
            "--robust",
            help="Plan for what is not known exactly, and print how often the rope stays wound: by the covariance in "
            "the rope's file, if identify wrote it there, and else as a usual identification leaves it.",
        ),
    ] = False,
    fallback: Annotated[
        bool,
        typer.Option(
            "--fallback",
            help="If no cast is found, plan for the nearest targets until one works; takes up to five times as long.",
        ),
    ] = False,
    skip_feasibility: planner.SkipFeasibility = False,
    rate: planner.Rate = 200.0,
    time_budget: planner.TimeBudget = 60.0,
    seed: planner.Seed = 0,
    json: output.Json = False,
) -> None:
    """Plan how the arm casts its rope round a peg, winds it and holds.

    The target is given by options, or as the first of [pegs] in the set-up file, which options then move or change. All
    other pegs, [walls] and [grounds] there are obstacles, which the rope must not touch. A table [behind], with the
    keys of [pegs], holds pegs that the rope is to run behind: in the end it touches each of them between the arm and
    the target.

    A rope is wound with 1.25 turns or more (--turns), counted from the arm's tip to its end, and holds if it slips by
    less than 5 mm in 2 s, from 1 s after the arm's stop on (--settle). How much of the target it covers is told beside
    the turns; where the rope is long enough, the search goes on for a full turn of contact. A rope that goes through
    itself, its arm or the motor's shaft fails.

    The first plan that stands, and each better one, is told on standard error when it is found. The search ends with a
    plan that has a margin, or with the time.

    The plan is verified in simulation, with links near the target cut shorter, then with all links of a third of the
    length and, without a margin, of half. Writes a page on which the run plays, pictures, the motion for the motor
    (CSV), the verified run (NetCDF) and a set-up that simulate runs; files of an earlier cast in the folder are
    replaced.

    Ctrl-C ends the search; the best so far is written, and marked as such, without pictures (in the first seconds,
    while the target is checked, there is nothing yet). While page and pictures are drawn, it leaves the plan's other
    files, which are written before.

    The exit code is 4 if no cast that winds and holds was found; the best throw is written all the same, with the
    reason and with the nearest target that should work.
    """
    from hyperflex.planning import Uncertainty, plan_cast
    from hyperflex.report import CastReport, check_folder

    check_folder(out)
    limits = {"speed": speed, "acceleration": acceleration, "torque": torque}
    criterion = {"clearance": clearance, "contact": contact, "turns": turns, "settle": settle}
    task = planner.read_task(setup, rope, arm_length, limits, criterion)
    uncertainty = Uncertainty.from_rope_file(rope or setup or Path()) if robust else None
    peg, first = planner.peg_of(task, target, radius, mu), planner.first_peg(task)
    plan = output.partial_of(
        lambda: plan_cast(
            task.rope,
            task.arm,
            peg,
            task.limits,
            time_limit=time_limit,
            holding_force=holding_force,
            contact=task.contact,
            turns=task.turns,
            settle=task.settle,
            clearance=task.clearance,
            obstacles=[each for each in task.obstacles if each is not first],
            behind=task.behind,
            uncertainty=uncertainty,
            time_budget=time_budget,
            skip_feasibility=skip_feasibility,
            fallback=fallback,
            seed=seed,
            progress=True,
            on_plan=_tell,
        )
    )
    with planner.writing(CastReport(plan, None), out, rate=rate, as_json=json) as (files, progress):
        progress("tugging at the rope")
        held = None if plan.interrupted else plan.measure_holding_force()
        report = CastReport(plan, held)
        files |= report.add_page(out, progress=progress)
    notes = [report.warning] if report.warning else []
    if uncertainty is not None:
        notes.append(f"Uncertain: {uncertainty.describe()}.")
    if plan.success_probability is not None:
        notes.append(
            f"Success probability, of a rope that stays wound (slip is not asked): {plan.success_probability}."
        )
    planner.finish(report, files, _result(plan, held, uncertainty), [*notes, *report.advice], as_json=json)


def _tell(plan: "CastPlan") -> None:
    """Say on standard error that a plan stands."""
    outcome = plan.required(plan.outcome, "outcome")
    got = f"{abs(outcome.turns):.2f} turns, {math.degrees(outcome.contact_angle):.0f} degrees of the target"
    sys.stderr.write(f"hyperflex: a cast stands after {plan.seconds:.1f} s: {got}\n")


def _result(plan: "CastPlan", held: "HoldingForce | None", uncertainty: "Uncertainty | None") -> dict[str, Any]:
    """Return the plan for JSON."""
    result = plan.summary()
    if uncertainty is not None:
        result["uncertainty"] = uncertainty.describe()
    if held is not None:
        result["holding_force"] = {
            "force": held.force,
            "slipped": held.tug.slipped,
            "tail_weight": held.tail_weight,
            "contact_angle": held.contact_angle,
            "capstan_force": held.capstan_force,
        }
    return result
