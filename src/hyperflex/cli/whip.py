"""``hyperflex whip``: a rope, an arm and a point in, strokes after which the tip passes it fast out."""

import math
from dataclasses import asdict
from typing import Annotated

import typer

from hyperflex.checks import number
from hyperflex.cli import output, planner
from hyperflex.errors import InvalidInput

_TARGET = ("x", "y", "direction", "speed", "angle_tolerance")  # of the set-up file, as of TipTarget


def whip(
    out: planner.Output,
    setup: planner.Setup = None,
    rope: planner.RopeFile = None,
    target: planner.Target = None,
    direction: Annotated[
        float | None,
        typer.Option(help="Of the tip there, degrees: 0 is +x, 90 is up. [default: any]", show_default=False),
    ] = None,
    angle_tolerance: Annotated[
        float | None, typer.Option(help="Greatest angle from that direction, degrees. [default: 20]")
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
    skip_feasibility: planner.SkipFeasibility = False,
    rate: planner.Rate = 200.0,
    time_budget: planner.TimeBudget = 30.0,
    seed: planner.Seed = 0,
    json: output.Json = False,
) -> None:
    """Plan how the arm whips its rope, so that the tip passes a point at a peak of its speed.

    The target is given by options, or as the table [target] of the set-up file: x, y (m), direction, angle_tolerance
    (rad), speed (m/s).

    The plan is verified in simulation, on the rope as given and with links of half the length; the impact on a small
    peg at the target is simulated too. Writes a page, pictures, a film, the motion for the motor (CSV), the verified
    run (NetCDF) and a set-up that simulate runs; files of an earlier whip in the folder are replaced.

    Ctrl-C ends the search; the best so far is written, and marked as such.

    The exit code is 4 if no whip that meets the target was found; the best is written all the same, with the reason.
    """
    from hyperflex.planning import plan_whip
    from hyperflex.report import WhipReport

    planner.check_folder(out)
    limits = {"speed": speed, "acceleration": acceleration, "torque": torque}
    task = planner.read_task(setup, rope, arm_length, limits)
    if task.obstacles:
        raise InvalidInput("whips are planned without obstacles", got=task.obstacles, fix="Leave them out")
    asked = _target(task, target, direction, angle_tolerance, least_speed)
    angle = asked.get("direction")
    plan = plan_whip(
        task.rope,
        task.arm,
        (asked["x"], asked["y"]),
        None if angle is None else (math.cos(angle), math.sin(angle)),
        task.limits,
        least_speed=asked.get("speed", 5.0),
        angle_tolerance=asked.get("angle_tolerance", math.radians(20.0)),
        time_limit=time_limit,
        skip_feasibility=skip_feasibility,
        time_budget=time_budget,
        seed=seed,
        progress=output.watched(json),
    )
    with output.spinner(json) as progress:
        progress("striking a small peg")
        impact = None if plan.outcome is None else plan.impact()
        report = WhipReport(plan, impact)
        files = report.write(out, rate=rate, progress=progress)
    result = plan.summary() | ({} if impact is None else {"impact": asdict(impact)})
    planner.finish(report, files, result, (), as_json=json)


def _target(
    task: planner.Task,
    place: tuple[float, float] | None,
    direction: float | None,
    angle_tolerance: float | None,
    least_speed: float | None,
) -> dict[str, float]:
    """Return the target of the set-up file with what the options say, in SI units."""
    if set(task.target) - set(_TARGET):
        raise InvalidInput("the table [target] does not fit", got=sorted(task.target), allowed=", ".join(_TARGET))
    asked = {name: number(f"target {name}", value) for name, value in task.target.items()}
    if place is not None:
        asked |= {"x": place[0], "y": place[1]}
    if direction is not None:
        asked["direction"] = math.radians(number("--direction", direction, unit="degrees"))
    if angle_tolerance is not None:
        tolerance = number("--angle-tolerance", angle_tolerance, sign="positive", unit="degrees")
        asked["angle_tolerance"] = math.radians(tolerance)
    if least_speed is not None:
        asked["speed"] = number("--least-speed", least_speed, sign="positive", unit="m/s")
    if not {"x", "y"} <= set(asked):
        raise InvalidInput("--target is missing", fix="Give it, or a set-up file with a table [target]")
    return asked
