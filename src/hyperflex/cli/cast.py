"""``hyperflex cast``: a rope, an arm and a target in, a throw that winds and holds out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex.cli import output
from hyperflex.errors import FileProblem

if TYPE_CHECKING:
    from hyperflex.planning import CastPlan, HoldingForce, Uncertainty


def cast(
    rope: Annotated[Path, typer.Option(help="TOML file with the rope, such as identify writes.")],
    target: Annotated[
        tuple[float, float], typer.Option(help="Centre of the peg from the motor's shaft, x and y (up), m.")
    ],
    radius: Annotated[float, typer.Option(help="Of the peg, m.")],
    out: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to; made if need be.")],
    mu: Annotated[float, typer.Option(help="Friction between rope and peg.")] = 0.3,
    arm_length: Annotated[float, typer.Option(help="Of the arm that the motor turns, m.")] = 0.105,
    speed: Annotated[
        float | None, typer.Option(help="Greatest speed of the motor, rad/s. [default: 8.61, the paper's]")
    ] = None,
    acceleration: Annotated[
        float | None, typer.Option(help="Greatest acceleration, rad/s^2. [default: 23.6, the paper's]")
    ] = None,
    torque: Annotated[float | None, typer.Option(help="Greatest torque, N m. [default: not looked at]")] = None,
    hold: Annotated[float, typer.Option(help="Pull that the wound rope should bear, N.")] = 0.0,
    time_limit: Annotated[
        float | None,
        typer.Option(help="Within which the rope must strike, s. [default: five periods of its swing, or more]"),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option(
            "--robust",
            help="Plan for what is not known exactly, and say how often the throw wins then: by the covariance in the "
            "rope's file, if identify wrote it there, and else as a usual identification leaves it.",
        ),
    ] = False,
    elsewhere: Annotated[
        bool,
        typer.Option(
            "--elsewhere",
            help="If no cast is found, plan for the nearest targets until one works; takes up to five times as long.",
        ),
    ] = False,
    skip_feasibility: Annotated[
        bool, typer.Option("--regardless", help="Search even for a target that a rule of thumb calls out of reach.")
    ] = False,
    rate: Annotated[float, typer.Option(help="Rows a second in the motor's file, Hz.")] = 200.0,
    patience: Annotated[float, typer.Option(help="Time to search, s; a plan that stands ends it.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of the search.")] = 0,
    json: output.Json = False,
) -> None:
    """Plan how the arm casts its rope round a peg, winds it and holds.

    A rope is wound with 1.25 turns or more, counted from the arm's tip to its end, and holds if it slips by less than
    5 mm in 2 s. The plan is verified in simulation, with links near the target cut shorter, then with all links of half
    and of a third of the length. Writes a page, pictures, a film, the motion for the motor (CSV), the verified run
    (NetCDF) and a set-up that simulate runs; files of an earlier cast in the folder are replaced.

    Ctrl-C ends the search; the best so far is written, and said to be that.

    The exit code is 4 if no cast that winds and holds was found; the best throw is written all the same, with the
    reason and with the nearest target that should work.
    """
    from hyperflex.checks import number
    from hyperflex.model import Arm, Peg, Rope
    from hyperflex.planning import MotorLimits, Uncertainty, plan_cast
    from hyperflex.report.cast.folder import write_cast

    if out.exists() and not out.is_dir():
        raise FileProblem(f"{out} is a file, not a folder. Give another name with -o.")
    rate = number("--rate", rate, sign="positive", unit="Hz")
    arm_length = number("--arm-length", arm_length, sign="positive", unit="m")
    if time_limit is not None:
        time_limit = number("--time-limit", time_limit, sign="positive", unit="s")
    given: dict[str, Any] = {"speed": speed, "acceleration": acceleration, "torque": torque}
    uncertain = Uncertainty.from_rope_file(rope) if robust else None
    limits = MotorLimits(**{name: value for name, value in given.items() if value is not None})
    plan = plan_cast(
        Rope.from_toml(rope),
        Arm(length=arm_length),
        Peg(*target, radius, mu),
        limits,
        time_limit=time_limit,
        holding_force=hold,
        uncertainty=uncertain,
        time_budget=patience,
        skip_feasibility=skip_feasibility,
        fallback=elsewhere,
        seed=seed,
        progress=output.watched(json),
    )
    with output.spinner(json) as tell:
        files, held = write_cast(out, plan, rate=rate, tell=tell)
    output.end(
        _figures(plan, held, files, uncertain),
        lambda: _show(plan, held, files, uncertain),
        success=plan.success,
        broken_off=f"Interrupted; the best so far is in {out}. {_verdict(plan)}" if plan.interrupted else None,
        as_json=json,
    )


def _figures(
    plan: CastPlan, held: HoldingForce | None, files: dict[str, Path], uncertain: Uncertainty | None
) -> dict[str, Any]:
    """Return the plan for JSON."""
    told = plan.summary() | {"files": files}
    if uncertain is not None:
        told["uncertain"] = uncertain.describe()
    if held is not None:
        told["hold"] = {
            "force_N": held.force,
            "slipped": held.tug.slipped,
            "tail_weight_N": held.tail_weight,
            "contact_rad": held.contact_angle,
            "tail_weight_times_exp_N": held.capstan_force,
        }
    return told


def _verdict(plan: CastPlan) -> str:
    from hyperflex.report.cast.words import verdict

    return verdict(plan)


def _show(plan: CastPlan, held: HoldingForce | None, files: dict[str, Path], uncertain: Uncertainty | None) -> None:
    """Print what was planned and what to look at."""
    from hyperflex.report.cast.words import folds, instead, swings_words, target_words

    pairs = [("target", target_words(plan.target))]
    if plan.throw is not None:
        pairs.append(("the arm makes", f"{swings_words(plan)} and a last move"))
    if plan.outcome is not None and math.isfinite(plan.outcome.strike_time):
        pairs.append(("strikes", f"{plan.outcome.strike_time:.2f} s after the start"))
        pairs.append(("turns in the end", f"{abs(plan.outcome.turns):.2f}, from the arm's tip to the rope's end"))
        pairs.append(("rope on the target", f"{math.degrees(plan.outcome.contact_angle):.0f} degrees"))
    if plan.throw is not None and (plan.outcome is None or plan.run is None):
        pairs.append(("strike, turns, hold", "not known: the throw was not verified to its end"))
    if held is not None:
        pairs.append(("hold force", f"{'' if held.tug.slipped else 'at least '}{held.force:.2f} N, by a tug"))
        pairs.append(("tail weight times e^(mu angle)", f"{held.capstan_force:.2f} N"))
    if uncertain is not None:
        pairs.append(("uncertain", uncertain.describe()))
    if plan.success_probability is not None:
        pairs.append(("wins in uncertain worlds", str(plan.success_probability)))
    output.print_pairs("Cast (simulated)", pairs)
    told = (_verdict(plan), folds(plan), *instead(plan))
    output.console().print("\n".join(line for line in told if line), markup=False)
    words = {
        "page": "the whole story on one page",
        "film": "the cast as a film",
        "motion": "the motion for the motor",
        "plan": "the set-up, for simulate",
        "nearest": "the nearest target's, for simulate",
        "run": "the verified run",
    }
    output.print_pairs("Written", [(told, str(files[kind])) for kind, told in words.items() if kind in files])
