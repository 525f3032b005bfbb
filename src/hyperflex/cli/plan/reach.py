"""``hyperflex reach-map``: a rope and an arm in, a map of the targets that can be wound out."""

from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import typer

from hyperflex import files
from hyperflex.cli import output
from hyperflex.cli.plan import planner

DATA, PICTURE = "reach-map.nc", "reach-map.png"
RADIUS = 0.03  # m


def reach_map(
    out: planner.Output,
    setup: planner.Setup = None,
    rope: planner.RopeFile = None,
    radius: Annotated[
        float | None, typer.Option(callback=planner.positive("m"), help="Of the targets, m. [default: 0.03]")
    ] = None,
    mu: Annotated[float | None, typer.Option(help="Friction between rope and targets. [default: 0.3]")] = None,
    cells: Annotated[
        int, typer.Option(min=1, max=200, help="Of the grid, from the shaft to as far as the rope comes.")
    ] = 8,
    arm_length: planner.ArmLength = None,
    speed: planner.Speed = None,
    acceleration: planner.Acceleration = None,
    torque: planner.Torque = None,
    holding_force: Annotated[float, typer.Option(help="Pull that the wound rope should withstand, N.")] = 0.0,
    contact: Annotated[
        float | None, typer.Option(help="Least angle of the target that the rope must cover, rad. [default: none]")
    ] = None,
    turns: planner.Turns = None,
    settle: planner.Settle = None,
    clearance: planner.Clearance = None,
    time_budget: Annotated[
        float,
        typer.Option(callback=planner.positive("s"), help="Of each target, s; a cast that stands ends it before."),
    ] = 10.0,
    workers: Annotated[int, typer.Option(min=1, help="Processes that plan; each takes one processor.")] = 1,
    seed: planner.Seed = 0,
    json: output.Json = False,
) -> None:
    """Map which targets a rope on an arm can wind: plan a cast for each target of a grid.

    The grid is that of the right-hand side, up to where the rope ends; the left is its mirror image, but for obstacles
    and a motor that turns further to one side. Targets that are not feasible cost nothing, others a few seconds each:
    minutes in all. Writes a picture and the figures (NetCDF).

    A target that is red on the picture was not wound in the time: a longer --time-budget may wind it, the more so with
    a long rope, whose casts take longer to find.

    A set-up file is read as by cast: the targets are like the first of [pegs], all other pegs, [walls] and [grounds]
    are obstacles.

    Ctrl-C ends it; the map so far is written, and says so.
    """
    from hyperflex.planning import NOT_PLANNED, build_reach_map
    from hyperflex.report import check_folder, save_png, whole_folder

    check_folder(out)
    limits = {"speed": speed, "acceleration": acceleration, "torque": torque}
    criterion = {"clearance": clearance, "contact": contact, "turns": turns, "settle": settle}
    task = planner.read_task(setup, rope, arm_length, limits, criterion)
    first = planner.first_peg(task)
    place = (0.0, 0.0) if first is None else None
    like = planner.peg_of(task, place, radius or (RADIUS if first is None else None), mu)
    with _processes(workers) as executor:
        found = output.partial_of(
            lambda: build_reach_map(
                task.rope,
                task.arm,
                task.limits,
                cells=cells,
                radius=like.radius,
                mu=like.mu,
                time_budget=time_budget,
                holding_force=holding_force,
                contact=task.contact,
                turns=task.turns,
                settle=task.settle,
                clearance=task.clearance,
                obstacles=[each for each in task.obstacles if each is not first],
                behind=task.behind,
                seed=seed,
                threads=1,
                executor=executor,
                progress=True,
            )
        )

    def write(folder: Path) -> dict[str, Path]:
        with whole_folder(folder, (DATA, PICTURE)) as stage:
            found.to_netcdf(stage / DATA)
            save_png(found.plot(), stage / PICTURE)
        return {"map": folder / DATA, "picture": folder / PICTURE}

    written = files.rescued(write, out)
    searched = int((~found.infeasible & (found.status != NOT_PLANNED)).sum())
    result = {"source": "simulated", "targets": found.status.size, "feasible": searched}
    result |= {"wound": int(found.wound.sum()), "complete": found.complete, "files": written}
    if not found.complete:
        message = f"Interrupted; the map so far is in {out}."
        raise typer.Exit(output.interrupted(message, result, as_json=json))
    words = [
        ("targets", f"{found.status.size}, {searched} of them feasible"),
        ("wound", f"{int(found.wound.sum())} of these, in simulation"),
        ("written", ", ".join(str(each) for each in written.values())),
    ]
    output.show(result, "Reach map (simulated)", words, as_json=json)


def _processes(workers: int) -> AbstractContextManager[Executor | None]:
    """Return processes that start without what this one holds open; none for a single worker."""
    return nullcontext() if workers == 1 else ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
