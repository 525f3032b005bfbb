"""Plan a cast: search for a throw that winds a rope round a target and holds, and verify it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Peg, Rope, Setup
from hyperflex.planning.cast_plan import CastPlan, come_to
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.motor_limits import MotorLimits
from hyperflex.planning.planner import NOMINAL, Course
from hyperflex.planning.robust.success_probability import success
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.search.search import Search
from hyperflex.planning.wind.fallback_targets import expected, found
from hyperflex.planning.wind.reachability import Reach, reach
from hyperflex.planning.wind.remedies import remedies
from hyperflex.simulation.rollouts import progress_bar

PATIENCE = 60.0  # s of searching by default


def plan_cast(
    rope: Rope,
    arm: Arm,
    target: Peg,
    limits: MotorLimits | None = None,
    *,
    time_limit: float | None = None,
    hold: float = 0.0,
    uncertainty: Uncertainty | None = None,
    patience: float = PATIENCE,
    regardless: bool = False,
    elsewhere: bool = False,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
) -> CastPlan:
    """Plan how an arm casts its rope round a target, winds it and holds.

    Parameters
    ----------
    rope, arm : Rope, Arm
        The rope hangs at rest from the arm, which points to one side.
    target : Peg
        To be wound by WOUND turns or more.
    limits : MotorLimits, optional
        Of the motor; by default the paper's.
    time_limit : float, optional
        Within which the rope must strike, s; by default five periods of its swing, and half as many again where these
        do not seem to give it energy enough.
    hold : float
        Pull that the wound rope should bear, N: asked of the target by a rule, before the search, and of a throw that
        winds by a simulated tug. What is stated of uncertain worlds does not ask for it.
    uncertainty : Uncertainty, optional
        Of what is given here. With it the plan is the throw that wins in most of the worlds drawn from it, and its
        success is stated from worlds drawn afresh.
    patience : float
        Time to search, s; a plan that stands ends it, one that wins in all worlds tried if they are uncertain.
    regardless : bool
        Search even for a target that is called out of reach.
    elsewhere : bool
        If the plan fails, plan for the nearest places until one stands: with throws at hand, then three times at most,
        each with as much patience. Without, the nearest place is no more than expected, by the criterion of reach.
    seed : int
        Of the search: with the same seed, and patience enough, the same plan.
    threads : int, optional
        By default one a processor.
    progress : bool
        Show a progress bar.

    Returns
    -------
    CastPlan
        Ctrl-C ends the search; the plan is the best until then.

    Raises
    ------
    InvalidInput
        If an argument is not what it should be.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> far = hf.plan_cast(cable, hf.Arm(length=0.105), hf.Peg(2.5, 0.0, 0.03))
    >>> far.success, far.reason
    (False, 'out of reach: the rope ends 0.36 m short of the target')
    >>> near = far.nearest  # no more than expected: nothing was planned for it
    >>> round(near.peg.x, 1), round(near.away, 1), near.plan
    (1.6, 0.9, None)
    >>> far.remedies
    ('a rope of 2.94 m',)
    """
    if not isinstance(target, Peg):
        raise InvalidInput("target is not a peg", got=target, allowed="hyperflex.Peg(x, y, radius, mu)")
    if target.turns:
        raise InvalidInput("casts are planned for fixed targets", got=target, fix="Leave out inertia and bearing")
    patience = checks.number("patience", patience, sign="positive", unit="s")
    thrower = Thrower(rope, arm, MotorLimits() if limits is None else limits, 0.0 if time_limit is None else time_limit)
    Setup(thrower.rope, arm=thrower.arm, pegs=(target,))  # refuses, before any search, what cannot touch a peg
    if rope.gravity[0] != 0.0 or rope.gravity[1] > 0.0:
        raise InvalidInput("casts are planned with gravity along -y", got=rope.gravity, fix="Turn the axes: y up")
    known = reach(thrower, target, hold=hold)
    search = Search(thrower, target, checks.count("seed", seed, least=0), threads, hold)
    if known.impossible or not (known.within or regardless):
        plan = CastPlan(thrower, target, known, None, None, None, known.reason, 0, 0.0)
    else:
        plan = _searched(search, known, uncertainty, patience, progress, longer=time_limit is None)
    if plan.success:
        return plan
    plan = replace(plan, remedies=remedies(thrower, target, hold=hold))
    if not elsewhere or plan.interrupted:
        return replace(plan, nearest=expected(plan, hold))
    again = partial(
        plan_cast,
        rope,
        arm,
        limits=limits,
        time_limit=time_limit,
        hold=hold,
        uncertainty=uncertainty,
        patience=patience,
        seed=seed,
        threads=threads,
        progress=progress,
    )
    return found(plan, search, hold, patience, again)


def _searched(
    search: Search, known: Reach, uncertainty: Uncertainty | None, patience: float, progress: bool, *, longer: bool
) -> CastPlan:
    """Search for a throw, verify it, and state its success."""
    work = Course(search, patience if uncertainty is None else NOMINAL * patience, longer=longer)
    interrupted = False
    with progress_bar(0.0, patience, progress, "planning") as report:
        try:
            work.go(report)
        except KeyboardInterrupt:
            interrupted = True
            with suppress(KeyboardInterrupt):
                work.settle()
        if uncertainty is not None and not interrupted:
            try:
                work.harden(uncertainty, report)
            except KeyboardInterrupt:
                interrupted = True
    throw, stated = work.best[0], None
    if uncertainty is not None and throw is not None and not interrupted:
        try:
            stated = success(search.thrower, search.peg, throw, uncertainty, seed=search.seed, threads=search.threads)
        except KeyboardInterrupt:
            interrupted = True
    return replace(come_to(work, known, interrupted), stated=stated)
