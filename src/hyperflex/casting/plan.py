"""Plan a cast: search for a throw that winds a rope round a target and holds, and verify it."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hyperflex import checks
from hyperflex.casting import tables
from hyperflex.casting.chance import Success, success
from hyperflex.casting.course import NOMINAL, Course, why_not
from hyperflex.casting.limits import MotorLimits
from hyperflex.casting.outcome import Cast
from hyperflex.casting.search import Search
from hyperflex.casting.targets import Reach, reach
from hyperflex.casting.throw import Throw
from hyperflex.casting.thrower import Thrower
from hyperflex.casting.uncertainty import Uncertainty
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.model import Arm, Peg, Rope, Setup
from hyperflex.motion import Motion
from hyperflex.simulation.rollouts import progress_bar

PATIENCE = 60.0  # s of searching by default


@dataclass(frozen=True, eq=False)
class CastPlan:
    """A planned cast, or why there is none.

    Attributes
    ----------
    thrower : Thrower
        Rope, arm and limits.
    peg : Peg
        The target.
    reach : Reach
        What could be said before searching.
    throw : Throw or None
        The best throw found; None where nothing strikes the peg.
    cast : Cast or None
        What became of it in a verified, simulated run.
    finer : Cast or None
        The same with links of half the length: what of it stands when the model is better.
    reason : str
        Why the plan fails; empty if it does not.
    runs : int
        Simulated runs of the search.
    seconds : float
        Time that it took, s.
    interrupted : bool
        Ctrl-C came; the plan is the best until then.
    stated : Success or None
        How often the throw winds in simulated worlds drawn afresh, where an uncertainty was given.
    """

    thrower: Thrower
    peg: Peg
    reach: Reach
    throw: Throw | None
    cast: Cast | None
    finer: Cast | None
    reason: str
    runs: int
    seconds: float
    interrupted: bool = False
    stated: Success | None = None

    @property
    def success(self) -> bool:
        """Wound and held, in both verified runs."""
        return not self.reason

    @property
    def motion(self) -> Motion | None:
        """What the arm does, from rest at t = 0; None where there is no throw."""
        return None if self.throw is None else self.throw.motion(self.thrower.limits)

    def to_csv(self, path: PathLike, *, rate: float = tables.RATE) -> None:
        """Write what the arm does at a motor's rate to a CSV file that :func:`hyperflex.read_motion` reads.

        Parameters
        ----------
        path : path-like
            Where to write, whole or not at all.
        rate : float
            Rows a second, Hz.
        """
        tables.write_motion(path, tables.motion_of(self), rate)

    def to_netcdf(self, path: str | Path) -> None:
        """Write the verified run to NetCDF.

        Parameters
        ----------
        path : path-like
            Where to write, whole or not at all.
        """
        tables.run_of(self).to_netcdf(path)

    def to_toml(self, path: PathLike) -> None:
        """Write set-up, limits and outcome to TOML: ``hyperflex simulate`` runs it, ``casting.read_plan`` reads it.

        Parameters
        ----------
        path : path-like
            Where to write, whole or not at all.
        """
        tables.write_plan(path, self)


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
        Within which the rope must strike, s; by default five periods of its swing.
    hold : float
        Pull that the wound rope should bear, N; only asked of what can be reached at all.
    uncertainty : Uncertainty, optional
        Of what is given here. With it the plan is the throw that wins in most of the worlds drawn from it, and its
        success is stated from worlds drawn afresh.
    patience : float
        Time to search, s; a plan that stands ends it, one that wins in all worlds tried if they are uncertain.
    regardless : bool
        Search even for a target that is called out of reach.
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
    (False, 'out of reach: the rope ends 0.43 m short of the target')
    """
    begin = time.monotonic()
    if not isinstance(target, Peg):
        raise InvalidInput("target is not a peg", got=target, allowed="hyperflex.Peg(x, y, radius, mu)")
    patience = checks.number("patience", patience, sign="positive", unit="s")
    thrower = Thrower(rope, arm, MotorLimits() if limits is None else limits, 0.0 if time_limit is None else time_limit)
    Setup(thrower.rope, arm=thrower.arm, pegs=(target,))  # refuses, before any search, what cannot touch a peg
    known = reach(thrower, target, hold=hold)
    if known.impossible or not (known.within or regardless):
        return CastPlan(thrower, target, known, None, None, None, known.reason, 0, time.monotonic() - begin)
    nominal = patience if uncertainty is None else NOMINAL * patience
    work = Course(Search(thrower, target, checks.count("seed", seed, least=0), threads), begin, nominal)
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
    throw, cast, finer = work.best
    stated = None
    if uncertainty is not None and throw is not None and not interrupted:
        stated = success(thrower, target, throw, uncertainty, seed=seed, threads=threads)
    return CastPlan(
        thrower,
        target,
        known,
        throw,
        cast,
        finer,
        why_not(cast, finer, interrupted),
        work.search.runs,
        time.monotonic() - begin,
        interrupted,
        stated,
    )
