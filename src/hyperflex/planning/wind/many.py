"""Casts for many targets: each search starts from the throws that stand for the nearest targets planned before."""

import math
from collections.abc import Sequence
from typing import Any

from hyperflex import checks
from hyperflex.interruption import caught, interruptible
from hyperflex.model import Arm, Peg, Rope
from hyperflex.planning.cast_setup import MotorLimits
from hyperflex.planning.wind.cast_plan import CastPlan
from hyperflex.planning.wind.casting import plan_cast

NEIGHBOURS = 3  # plans that a search starts from
NEAR = 0.2  # rope lengths, how far at most their targets are away


@interruptible(list)
def plan_casts(
    rope: Rope, arm: Arm, targets: Sequence[Peg], limits: MotorLimits | None = None, **options: Any
) -> list[CastPlan]:
    """Plan casts for many targets, one after another; throws for targets near by are tried first.

    Parameters
    ----------
    rope, arm, limits
        As of :func:`plan_cast`.
    targets : sequence of Peg
        Each is planned for after the ones near it where that can be: the next is always the one nearest to any before.
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
    Interrupted
        By Ctrl-C. Its ``partial`` is the list of the plans until then, of the targets in the order of planning.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> plans = hf.plan_casts(cable, hf.Arm(length=0.105), [hf.Peg(2.5, 0.0, 0.03), hf.Peg(2.4, 0.2, 0.03)])
    >>> [plan.message for plan in plans]  # doctest: +NORMALIZE_WHITESPACE
    ['out of reach: the rope ends 0.36 m short of the target', 'out of reach: the rope ends 0.27 m short of the target']
    """
    left = list(enumerate(checks.sequence("targets", targets, "pegs")))
    plans: dict[int, CastPlan] = {}
    while left:
        left.sort(key=lambda each: min((_apart(each[1], plan) for plan in plans.values()), default=0.0))
        number, target = left.pop(0)
        near = sorted((one for one in plans.values() if one.success), key=lambda one: _apart(target, one))
        near = [one for one in near[:NEIGHBOURS] if _apart(target, one) <= NEAR * rope.total_length]
        with caught() as stop:
            plans[number] = plan_cast(rope, arm, target, limits, start_from=near, **options)
        if stop.met:
            found = [stop.partial] if isinstance(stop.partial, CastPlan) else []
            stop.deliver([*plans.values(), *found])
    return [plans[number] for number in sorted(plans)]


def _apart(target: Peg, plan: CastPlan) -> float:
    return math.dist((target.x, target.y), (plan.target.x, plan.target.y))
