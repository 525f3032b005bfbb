"""``hyperflex insert``: a rope, an arm and a slot in, strokes after which the tip goes through it out."""

import math
from typing import Annotated

import typer

from hyperflex import checks
from hyperflex.checks import Sign
from hyperflex.cli import output
from hyperflex.cli.plan import planner
from hyperflex.errors import InvalidInput

_SLOT: dict[str, tuple[Sign, str]] = {  # of the set-up file, as of Slot: sign and unit
    "x": ("any", "m"),
    "y": ("any", "m"),
    "direction": ("any", "rad"),
    "width": ("positive", "m"),
    "depth": ("positive", "m"),
    "wall": ("positive", "m"),
    "tube": ("nonnegative", "m"),
    "max_speed": ("positive", "m/s"),
}


def insert(
    out: planner.Output,
    setup: planner.Setup = None,
    rope: planner.RopeFile = None,
    slot: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="Middle of its gap, x and y (up), m; the motor's shaft is at (0, 0) unless [arm] says otherwise "
            "(pivot)."
        ),
    ] = None,
    direction: Annotated[
        float | None, typer.Option(help="The way in, across the walls, rad: 0 is +x, pi/2 is up.")
    ] = None,
    width: Annotated[
        float | None, typer.Option(help="Of the gap, m, three diameters of the rope or more. [default: 0.02]")
    ] = None,
    depth: Annotated[
        float | None, typer.Option(help="How far beyond the walls the tip shall come, m. [default: 0.05]")
    ] = None,
    wall: Annotated[float | None, typer.Option(help="Length of each wall, m. [default: 0.1]")] = None,
    tube: Annotated[
        float | None, typer.Option(help="How far walls go on inwards from the gap's edges, m. [default: 0]")
    ] = None,
    max_speed: Annotated[float | None, typer.Option(help="Of the tip at that depth, m/s. [default: any]")] = None,
    touching: Annotated[bool, typer.Option("--touching", help="The rope may touch the walls.")] = False,
    arm_length: planner.ArmLength = None,
    speed: planner.Speed = None,
    acceleration: planner.Acceleration = None,
    torque: planner.Torque = None,
    time_limit: Annotated[
        float | None,
        typer.Option(
            callback=planner.positive("s"),
            help="Within which the tip must be inside, s. [default: two periods of the rope's swing]",
        ),
    ] = None,
    clearance: planner.Clearance = None,
    skip_feasibility: planner.SkipFeasibility = False,
    rate: planner.Rate = 200.0,
    time_budget: planner.TimeBudget = 30.0,
    seed: planner.Seed = 0,
    json: output.Json = False,
) -> None:
    """Plan how the arm swings its rope, so that the tip goes through a slot, to a depth, and touches no wall.

    The slot is a gap between two thin walls in one line. It is given by options, or as the table [slot] of the set-up
    file: x, y, width, depth, wall, tube (m), direction (rad), max_speed (m/s), touching. Options have the same units.
    [pegs], [walls] and [grounds] there are obstacles, which the rope must not touch.

    The plan is verified in simulation beside the walls, on the rope as given and with 2.5 times the links; the success
    probability is told for a slot that is 2 mm off and strokes that are 2 ms off. Writes a page on which the run plays,
    pictures, the motion for the motor (CSV), the verified run (NetCDF) and a set-up that simulate runs; files of an
    earlier insertion in the folder are replaced.

    Ctrl-C ends the search; the best so far is written, and marked as such, without pictures. While page and pictures
    are drawn, it leaves the plan's other files, which are written before.

    The exit code is 4 if no way through the slot was found; the best is written all the same, with the reason.
    """
    from hyperflex.planning import Conditions, SearchOptions, Slot, plan_insert, refuse_behind
    from hyperflex.report import InsertReport, check_folder

    check_folder(out)
    limits = {"speed": speed, "acceleration": acceleration, "torque": torque}
    task = planner.read_task(setup, rope, arm_length, limits, {"clearance": clearance})
    refuse_behind(task.behind, "an insertion")
    table = {name: value for name, value in task.slot.items() if value != math.inf}
    may_touch = checks.flag("slot touching", table.pop("touching", False)) or touching
    options = {"direction": direction, "width": width, "depth": depth, "wall": wall, "tube": tube}
    asked = planner.asked("slot", table, _SLOT, slot, options | {"max_speed": max_speed})
    if "direction" not in asked:
        raise InvalidInput("--direction is missing", fix="Give the way into the slot, in rad: 0 is +x, pi/2 is up")
    where = Slot(**asked, touching=may_touch)
    plan = output.partial_of(
        lambda: plan_insert(
            task.rope,
            task.arm,
            where,
            task.limits,
            conditions=Conditions(time_limit, task.clearance, task.obstacles),
            time_budget=time_budget,
            options=SearchOptions(seed, skip_feasibility=skip_feasibility, progress=True),
        )
    )
    report = InsertReport(plan)
    with planner.writing(report, out, rate=rate, as_json=json) as (files, progress):
        files |= report.add_page(out, progress=progress)
    planner.finish(report, files, plan.summary(), [report.warning] if report.warning else (), as_json=json)
