"""``hyperflex whip``: a rope, an arm and a point in, strokes after which the tip passes it fast out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex.cli import output
from hyperflex.errors import FileProblem

if TYPE_CHECKING:
    from hyperflex.planning import Impact, WhipPlan


def whip(
    rope: Annotated[Path, typer.Option(help="TOML file with the rope, such as identify writes.")],
    target: Annotated[
        tuple[float, float], typer.Option(help="Point to pass, from the motor's shaft, x and y (up), m.")
    ],
    out: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to; made if need be.")],
    direction: Annotated[
        float | None,
        typer.Option(help="Of the tip there, degrees: 0 is +x, 90 is up. [default: any]", show_default=False),
    ] = None,
    within: Annotated[float, typer.Option(help="Greatest angle from that direction, degrees.")] = 20.0,
    tip_speed: Annotated[float, typer.Option(help="Least speed of the tip there, m/s.")] = 5.0,
    arm_length: Annotated[float, typer.Option(help="Of the arm that the motor turns, m.")] = 0.105,
    speed: Annotated[
        float | None, typer.Option(help="Greatest speed of the motor, rad/s. [default: 8.61, the paper's]")
    ] = None,
    acceleration: Annotated[
        float | None, typer.Option(help="Greatest acceleration, rad/s^2. [default: 23.6, the paper's]")
    ] = None,
    skip_feasibility: Annotated[
        bool, typer.Option("--regardless", help="Search even for a target that is called out of reach.")
    ] = False,
    rate: Annotated[float, typer.Option(help="Rows a second in the motor's file, Hz.")] = 200.0,
    patience: Annotated[float, typer.Option(help="Time to search, s; whips that stand end it.")] = 30.0,
    seed: Annotated[int, typer.Option(help="Of the search.")] = 0,
    json: output.Json = False,
) -> None:
    """Plan how the arm whips its rope, so that the tip passes a point at a peak of its speed.

    The plan is verified in simulation, on the rope as given and with links of half the length; the blow on a small peg
    at the target is simulated too. Writes a page, pictures, a film, the motion for the motor (CSV), the verified run
    (NetCDF) and a set-up that simulate runs.

    Ctrl-C ends the search; the best so far is written, and said to be that.

    The exit code is 4 if no whip that meets the target was found; the best is written all the same, with the reason.
    """
    from hyperflex.checks import number
    from hyperflex.model import Arm, Rope
    from hyperflex.planning import MotorLimits, plan_whip
    from hyperflex.report.whip.folder import write_whip

    if out.exists() and not out.is_dir():
        raise FileProblem(f"{out} is a file, not a folder. Give another name with -o.")
    rate = number("--rate", rate, sign="positive", unit="Hz")
    arm_length = number("--arm-length", arm_length, sign="positive", unit="m")
    given: dict[str, Any] = {"speed": speed, "acceleration": acceleration}
    limits = MotorLimits(**{name: value for name, value in given.items() if value is not None})
    angle = None if direction is None else math.radians(number("--direction", direction, unit="degrees"))
    plan = plan_whip(
        Rope.from_toml(rope),
        Arm(length=arm_length),
        target,
        None if angle is None else (math.cos(angle), math.sin(angle)),
        limits,
        least_speed=number("--tip-speed", tip_speed, sign="positive", unit="m/s"),
        angle_tolerance=math.radians(number("--within", within, sign="positive", unit="degrees")),
        skip_feasibility=skip_feasibility,
        time_budget=patience,
        seed=seed,
        progress=output.watched(json),
    )
    with output.spinner(json) as tell:
        files, blow = write_whip(out, plan, rate=rate, tell=tell)
    output.end(
        _figures(plan, blow, files),
        lambda: _show(plan, blow, files),
        success=plan.success,
        broken_off=f"Interrupted; the best so far is in {out}. {_verdict(plan)}" if plan.interrupted else None,
        as_json=json,
    )


def _figures(plan: WhipPlan, blow: Impact | None, files: dict[str, Path]) -> dict[str, Any]:
    """Return the plan for JSON."""
    told = plan.summary() | {"files": files}
    if blow is not None:
        told["blow"] = {
            "t_s": blow.t,
            "impulse_Ns": blow.impulse,
            "along_Ns": blow.impulse_along,
            "energy_J": blow.energy,
            "link": blow.link,
        }
    return told


def _verdict(plan: WhipPlan) -> str:
    from hyperflex.report.whip.words import verdict

    return verdict(plan)


def _show(plan: WhipPlan, blow: Impact | None, files: dict[str, Path]) -> None:
    """Print what was planned and what to look at."""
    from hyperflex.report.whip.words import strokes_words, target_words

    pairs = [("target", target_words(plan.target))]
    if plan.strokes is not None:
        pairs.append(("the arm makes", strokes_words(plan)))
    if plan.outcome is not None:
        seen = plan.outcome
        pairs.append(("the tip's speed peaks", f"{seen.t:.2f} s after the start, at {seen.speed:.2f} m/s"))
        pairs.append(("misses the target by", f"{1e3 * seen.miss:.2g} mm"))
    if plan.finer_outcome is not None:
        pairs.append(("with links of half the length", f"{1e3 * plan.finer_outcome.miss:.2g} mm"))
    if blow is not None and math.isfinite(blow.t):
        pairs.append(("blow on a small peg there", f"{1e3 * blow.impulse:.1f} mN s"))
    output.print_pairs("Whip (simulated)", pairs)
    output.console().print(_verdict(plan), markup=False)
    words = {
        "page": "the whole story on one page",
        "film": "the whip as a film",
        "motion": "the motion for the motor",
        "plan": "the set-up, for simulate",
        "run": "the verified run",
    }
    output.print_pairs("Written", [(told, str(files[kind])) for kind, told in words.items() if kind in files])
