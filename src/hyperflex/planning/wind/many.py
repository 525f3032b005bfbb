"""Casts for many targets: some are planned for themselves, those near by from the throws that stand for these."""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any, NamedTuple

from hyperflex import checks
from hyperflex.executor import checked_chunks, refuse_lost, run_chunks
from hyperflex.interruption import CaughtInterrupt, catch_interrupt, interruptible
from hyperflex.model import Arm, Peg, Rope, checked_obstacles
from hyperflex.planning.options import MotorLimits
from hyperflex.planning.routing import checked_behind
from hyperflex.planning.wind.cast_plan import CastPlan
from hyperflex.planning.wind.casting import plan_cast
from hyperflex.progress import progress_bar

NEIGHBOURS = 3  # plans that a search starts from
NEAR = 0.2  # rope lengths, how far at most their targets are away
CHUNK = 1  # targets


class _Asked(NamedTuple):
    """A target by its number, and the plans that its search starts from."""

    number: int
    target: Peg
    near: list[CastPlan]


@interruptible(list)
def plan_casts(
    rope: Rope,
    arm: Arm,
    targets: Sequence[Peg],
    limits: MotorLimits | None = None,
    *,
    executor: Executor | None = None,
    chunk_size: int | None = None,
    progress: bool = False,
    **options: Any,
) -> list[CastPlan]:
    """Plan casts for many targets: first for some that lie apart, then for the others, from the throws that stand.

    Parameters
    ----------
    rope, arm, limits
        As of :func:`plan_cast`.
    targets : sequence of Peg
        The first, and each that is more than NEAR of the rope's length from all such before it, is planned for itself.
        The search for any other begins with the throws for the nearest of these, NEIGHBOURS at most.
    executor : concurrent.futures.Executor, optional
        Where plans are made: processes, or other machines (``docs/how-to/many-machines.md``). What a search
        looks at depends on the clock, and so may a plan. Give ``threads=1`` where workers share a machine.
    chunk_size : int, optional
        Targets that a worker of the executor takes at once; by default CHUNK.
    progress : bool
        Show how many targets are done.
    **options
        Those of :func:`plan_cast`, the same for all; the time budget is that of each target.

    Returns
    -------
    list of CastPlan
        One for each target, in the order given.

    Raises
    ------
    InvalidInput
        If an argument is out of range or of another class.
    WorkerLost
        If targets kill the workers of the executor.
    Interrupted
        By Ctrl-C. Its ``partial`` is the list of the plans until then, in the order of their targets.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> plans = hf.plan_casts(cable, hf.Arm(length=0.105), [hf.Peg(2.5, 0.0, 0.03), hf.Peg(2.4, 0.2, 0.03)])
    >>> [plan.message for plan in plans]  # doctest: +NORMALIZE_WHITESPACE
    ['out of reach: the rope ends 0.36 m short of the target', 'out of reach: the rope ends 0.27 m short of the target']
    """
    asked = [checks.instance("target", each, Peg) for each in checks.sequence("targets", targets, "pegs")]
    plans, stop = plan_each(rope, arm, asked, limits, options, executor, chunk_size, progress)
    return stop.deliver([plans[number] for number in sorted(plans)])


def plan_each(
    rope: Rope,
    arm: Arm,
    targets: Sequence[Peg],
    limits: MotorLimits | None,
    options: Mapping[str, Any],
    executor: Executor | None,
    chunk_size: int | None,
    progress: bool,
) -> tuple[dict[int, CastPlan], CaughtInterrupt]:
    """Plan as :func:`plan_casts` does; returns plans by the targets' numbers, and the interrupt."""
    executor, size = checked_chunks(executor, chunk_size, CHUNK)
    options = {**options, "start_from": list(options.get("start_from", ()))}
    if "obstacles" in options:
        options = {**options, "obstacles": checked_obstacles(options["obstacles"], "obstacles")}
    if "behind" in options:
        options = {**options, "behind": checked_behind(options["behind"])}
    alone = _apart(targets, NEAR * checks.instance("rope", rope, Rope).total_length)
    plans: dict[int, CastPlan] = {}
    todo: list[_Asked] = []
    with catch_interrupt() as stop, progress_bar(0, len(targets), progress, "planning", "targets") as report:

        def done(low: int, found: list[CastPlan]) -> None:
            plans.update(zip((each.number for each in todo[low:]), found, strict=False))
            if report is not None:
                report(len(plans))

        work = partial(_plan, rope=rope, arm=arm, limits=limits, **options)
        for chosen in (alone, [number for number in range(len(targets)) if number not in alone]):
            known = [plans[number] for number in alone if number in plans and plans[number].success]
            todo = [_Asked(k, targets[k], _nearest(targets[k], known, rope)) for k in chosen]
            refuse_lost(run_chunks(work, todo, executor, size if executor else 1, done), "targets")
    if isinstance(stop.partial, CastPlan):  # of the one that was planned in this process
        plans[next(each.number for each in todo if each.number not in plans)] = stop.partial
    return plans, stop


def _plan(
    chunk: list[_Asked],
    *,
    rope: Rope,
    arm: Arm,
    limits: MotorLimits | None,
    start_from: list[CastPlan],
    **options: Any,
) -> list[CastPlan]:
    return [plan_cast(rope, arm, each.target, limits, start_from=each.near + start_from, **options) for each in chunk]


def _apart(targets: Sequence[Peg], least: float) -> list[int]:
    """Return the numbers of targets that are more than `least`, m, from all such before them."""
    found: list[int] = []
    for number, target in enumerate(targets):
        if all(_distance(target, targets[other]) > least for other in found):
            found.append(number)
    return found


def _nearest(target: Peg, plans: list[CastPlan], rope: Rope) -> list[CastPlan]:
    """Return the plans whose targets lie near by, the nearest first."""
    near = [plan for plan in plans if _distance(target, plan.target) <= NEAR * rope.total_length]
    return sorted(near, key=lambda plan: _distance(target, plan.target))[:NEIGHBOURS]


def _distance(one: Peg, other: Peg) -> float:
    return math.dist((one.x, one.y), (other.x, other.y))
