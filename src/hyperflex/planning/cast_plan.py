"""A planned cast: what it is, what became of it in simulation, or why it fails, and its files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hyperflex.files import PathLike
from hyperflex.model import Peg
from hyperflex.motion import Motion
from hyperflex.planning import files as tables
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.planner import Course, why_not
from hyperflex.planning.robust.success_probability import Success
from hyperflex.planning.wind.nearest_target import Nearest
from hyperflex.planning.wind.outcome import Cast
from hyperflex.planning.wind.reachability import Reach
from hyperflex.planning.wind.throw import Throw


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
        What became of it in a verified, simulated run; None where Ctrl-C came before that.
    finer : Cast or None
        The same with links of half or of a third of the length, of these the one that fails or differs more: what of it
        stands when the model is better.
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
    nearest : Nearest or None
        For a plan that fails: the nearest place for which one stands (`nearest.plan`), or is expected to.
    remedies : tuple of str
        For a target out of reach: what would bring it in reach where it is, each for itself; by the criterion of reach.
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
    nearest: Nearest | None = None
    remedies: tuple[str, ...] = ()

    @property
    def success(self) -> bool:
        """Wound and held, in both verified runs."""
        return not self.reason

    @property
    def unfinished(self) -> bool:
        """Whether it fails for no fault of its target: that is in reach, and Ctrl-C or a run without an end came."""
        if self.success or not self.reach.within:
            return False
        return self.interrupted or any(cast is not None and cast.run is None for cast in (self.cast, self.finer))

    @property
    def motion(self) -> Motion | None:
        """What the arm does, from rest at t = 0; None where there is no throw."""
        return None if self.throw is None else self.throw.motion(self.thrower.limits)

    def to_csv(self, path: PathLike, *, rate: float = tables.RATE) -> None:
        """Write what the arm does at a motor's rate to a CSV file that :func:`hyperflex.read_motion` reads.

        A throw that does not stand is marked in the file's head, ``# not verified: ...`` or ``# fails: ...``.

        Parameters
        ----------
        path : path-like
            Where to write, whole or not at all.
        rate : float
            Rows a second, Hz.
        """
        tables.write_motion(path, tables.motion_of(self), rate, notes=tables.notes(self))

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


def come_to(work: Course, known: Reach, interrupted: bool = False) -> CastPlan:
    """Return what a search has come to; where nothing was verified, its best throw without a run.

    Parameters
    ----------
    work : Course
    known : Reach
        What could be said before searching.
    interrupted : bool
    """
    search, (throw, cast, finer) = work.search, work.best
    if throw is None and search.landings:
        throw = search.landings[0].throw
    why = why_not(cast, finer, interrupted)
    return CastPlan(search.thrower, search.peg, known, throw, cast, finer, why, search.runs, work.spent, interrupted)
