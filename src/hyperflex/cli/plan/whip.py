"""``hyperflex whip``: a rope, an arm and a point in, strokes after which the tip passes it fast out."""

from dataclasses import asdict
from typing import Annotated

import typer

from hyperflex.checks import Sign
from hyperflex.cli import output
from hyperflex.cli.plan import planner

_TARGET: dict[str, tuple[Sign, str]] = {  # of the set-up file, as of TipTarget: sign and unit
    "x": ("any", "m"),
    "y": ("any", "m"),
    "direction": ("any", "rad"),
    "least_speed": ("positive", "m/s"),
    "angle_tolerance": ("positive", "rad"),
}


def whip(
    out: planner.Output,
    setup: planner.Setup = None,
    rope: planner.RopeFile = None,
    target: planner.Target = None,
    direction: Annotated[
        float | None,
        typer.Option(help="Of the tip there, rad: 0 is +x, pi/2 is up. [default: any]"),
    ] = None,
    angle_tolerance: Annotated[
        float | None, typer.Option(help="Greatest angle from that direction, rad. [default: 0.349, 20 degrees]")
    ] = None,
    least_speed: Annotated[float | None, typer.Option(help="Of the tip there, m/s. [default: 5]")] = None,
    arm_length: planner.ArmLength = None,
    speed: planner.Speed = None,
    acceleration: planner.Acceleration = None,
    torque: planner.Torque = None,
    time_limit: Annotated[
        float | None,
        typer.Option(
            callback=planner.positive("s"),
            help="Within which the tip must pass, s. [default: three periods of the rope's swing]",
        ),
    ] = None,
    clearance: planner.Clearance = None,
    skip_feasibility: planner.SkipFeasibility = False,
    rate: planner.Rate = 200.0,
    time_budget: planner.TimeBudget = 30.0,
    seed: planner.Seed = 0,
    json: output.Json = False,
) -> None:
    """Plan how the arm whips its rope, so that the tip passes a point at a peak of its speed.

    The target is given by options, or as the table [target] of the set-up file: x, y (m), direction, angle_tolerance
    (rad), least_speed (m/s). Options have the same units. [pegs], [walls] and [grounds] there are obstacles, which the
    rope must not touch.

    The plan is verified in simulation, on the rope as given and with links of half the length; the impact on a small
    peg at the target is simulated too. Writes a page on which the run plays, pictures, the motion for the motor (CSV),
    the verified run (NetCDF) and a set-up that simulate runs; files of an earlier whip in the folder are replaced.

    Ctrl-C ends the search; the best so far is written, and marked as such, without pictures. While page and pictures
    are drawn, it leaves the plan's other files, which are written before.

    The exit code is 4 if no whip that meets the target was found; the best is written all the same, with the reason.
    """
    from hyperflex.planning import Conditions, SearchOptions, TipTarget, plan_whip, refuse_behind
    from hyperflex.report import WhipReport, check_folder

    check_folder(out)
    limits = {"speed": speed, "acceleration": acceleration, "torque": torque}
    task = planner.read_task(setup, rope, arm_length, limits, {"clearance": clearance})
    refuse_behind(task.behind, "a whip")
    options = {"direction": direction, "angle_tolerance": angle_tolerance, "least_speed": least_speed}
    asked = planner.asked("target", task.target, _TARGET, target, options)
    conditions = Conditions(time_limit, task.clearance, task.obstacles)
    plan = output.partial_of(
        lambda: plan_whip(
            task.rope,
            task.arm,
            TipTarget(**asked),
            task.limits,
            conditions=conditions,
            time_budget=time_budget,
            options=SearchOptions(seed, skip_feasibility=skip_feasibility, progress=True),
        )
    )
    with planner.writing(WhipReport(plan, None), out, rate=rate, as_json=json) as (files, progress):
        progress("striking a small peg")
        impact = None if plan.outcome is None or plan.interrupted else plan.impact()
        report = WhipReport(plan, impact)
        files |= report.add_page(out, progress=progress)
    result = plan.summary() | ({} if impact is None else {"impact": asdict(impact)})
    planner.finish(report, files, result, [report.warning] if report.warning else (), as_json=json)
