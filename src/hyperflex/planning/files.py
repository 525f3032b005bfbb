"""A planned cast as files: the arm's motion for a motor, and everything that the cast was planned with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import checks, files
from hyperflex.errors import InvalidInput
from hyperflex.model import PLAN, Peg, Rope, Setup
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.motor_limits import MotorLimits
from hyperflex.planning.wind.outcome import SETTLING, WATCH
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from hyperflex.planning.cast_plan import CastPlan
    from hyperflex.planning.whip.plan import WhipPlan
    from hyperflex.planning.wind.outcome import Cast

RATE = 200.0  # Hz
MOST_ROWS = 10_000_000


def write_motion(
    path: files.PathLike, motion: Motion, rate: float = RATE, *, notes: Mapping[str, str] | None = None
) -> None:
    """Write what the arm does at a motor's rate, for :func:`hyperflex.read_motion` and for drivers.

    Parameters
    ----------
    path : path-like
        CSV file with the columns ``t`` (s) and ``angle`` (rad), whole or not at all.
    motion : Motion
        That ends; the last row is the arm at rest.
    rate : float
        Rows a second, Hz.
    notes : mapping of str to str, optional
        Written before all else in the file's head, as lines ``# key: value``.
    """
    rate = checks.number("rate", rate, sign="positive", unit="Hz")
    count = math.ceil(float(motion.breaks[-1]) * rate - 1e-9) + 1
    if not 2 < count <= MOST_ROWS:
        raise InvalidInput("rate does not suit the motion", got=rate, allowed="some rows a move, and 10 million in all")
    t = np.arange(count) / rate
    told = {"contents": "planned motion of the arm", "rate": f"{rate:g} Hz", "t": "s", "angle": "rad, 0 hangs down"}
    files.write_table(path, ["t", "angle"], np.column_stack([t, motion.angle(t)]), notes={**(notes or {}), **told})


def notes(plan: CastPlan) -> dict[str, str]:
    """Return what a throw is for, first whether it fails or was not verified, and why, if it does not stand."""
    peg, rope = plan.peg, plan.thrower.rope
    told = {"target": f"x {peg.x:g} m, y {peg.y:g} m, radius {peg.radius:g} m, mu {peg.mu:g}"}
    told["rope"] = f"{rope.total_length:.4g} m, {rope.total_mass:.4g} kg"
    told["arm"] = f"{plan.thrower.arm.length:g} m, begins at {motion_of(plan).angle(0.0):.4f} rad"
    if plan.success:
        return told
    failed = any(cast is not None and cast.run is not None and cast.reason for cast in (plan.cast, plan.finer))
    return {"fails" if failed else "not verified": plan.reason, **told}


def write_plan(path: files.PathLike, plan: CastPlan) -> None:
    """Write a plan to a TOML file: the verified run's set-up, and a table ``[plan]`` with what it was planned for.

    Parameters
    ----------
    path : path-like
        Whole or not at all. ``hyperflex simulate`` and :meth:`hyperflex.Setup.from_toml` read the set-up,
        :func:`read_plan` what is needed to plan or verify again.
    plan : CastPlan
        With a throw.

    Raises
    ------
    InvalidInput
        There is no throw, so nothing to write.
    """
    files.write_text(path, setup_of(plan).dumps() + "\n" + files.dumps_toml({PLAN: _table(plan)}))


def motion_of(plan: CastPlan) -> Motion:
    """Return what the arm does; raises InvalidInput where there is no throw."""
    if plan.motion is None:
        raise InvalidInput("the plan holds no throw", got=plan.reason, fix="Plan for a target that is in reach")
    return plan.motion


def run_of(plan: CastPlan) -> Trajectory:
    """Return the verified run; raises InvalidInput where there is none."""
    if plan.cast is None or plan.cast.run is None:
        raise InvalidInput("the plan holds no run", got=plan.reason, fix="Plan for a target that is in reach")
    return plan.cast.run


def setup_of(plan: CastPlan) -> Setup:
    """Return the set-up of the verified run; where there was none, of one as long, with the rope as given."""
    motion = motion_of(plan)
    if plan.cast is not None and plan.cast.run is not None:
        return plan.cast.run.setup
    thrower, end = plan.thrower, float(motion.breaks[-1]) + SETTLING + WATCH
    return Setup(thrower.rope, motion, thrower.arm, duration=end, pegs=(plan.peg,))


def read_plan(path: str | Path) -> tuple[Thrower, Peg, Motion]:
    """Read who throws, the target and what the arm does from a file of :func:`write_plan`.

    Parameters
    ----------
    path : path-like
        TOML file.

    Raises
    ------
    FileProblem, InvalidInput
        If the file cannot be read or holds no plan.
    """
    setup, content = Setup.from_toml(path), files.read_toml(path)
    table = content.get(PLAN)
    pegs = [peg for peg in setup.pegs if isinstance(peg, Peg)]
    if not isinstance(table, dict) or len(pegs) != 1 or setup.motion is None or setup.arm is None:
        raise InvalidInput(f"{path} holds no plan", got=sorted(content), allowed="a file of CastPlan.to_toml")
    try:
        limits = MotorLimits(**table["limits"])
        thrower = Thrower(Rope.from_table(table["rope"]), setup.arm, limits, table["time"])
    except (KeyError, TypeError) as error:
        raise InvalidInput(f"the plan in {path} is not whole", got=str(error), fix="Write it again") from None
    return thrower, pegs[0], setup.motion


def searched(plan: CastPlan | WhipPlan) -> dict[str, Any]:
    """Return what is told of every plan: whether it stands, why not, and what the search took."""
    return {
        "source": "simulated",
        "success": plan.success,
        "reason": plan.reason,
        "interrupted": plan.interrupted,
        "searched_s": plan.seconds,
        "runs": plan.runs,
    }


def summary(plan: CastPlan) -> dict[str, Any]:
    """Return what a plan is and became, for TOML and JSON: whether it stands, why not, strokes, outcome."""
    told = searched(plan)
    if plan.throw is not None:
        limits = plan.thrower.limits
        starts = plan.throw.starts(limits)
        told |= {"strokes": plan.throw.count, "starts_s": starts[:-1], "last_move_s": float(starts[-1])}
        told |= {"arm_stops_s": plan.throw.stops(limits)}
    if plan.stated is not None:
        stated = plan.stated
        told["stated"] = {"wins": stated.wins, "draws": stated.draws, "interval_95": list(stated.interval)}
    if plan.remedies:
        told["remedies"] = list(plan.remedies)
    if plan.nearest is not None:
        near = plan.nearest
        told["nearest"] = {"x_m": near.peg.x, "y_m": near.peg.y, "away_m": near.away, "planned": near.plan is not None}
        told["nearest"] |= {"tried_in_vain": near.tried}
    for name, cast in (("cast", plan.cast), ("finer", plan.finer)):
        if cast is not None:
            told[name] = _outcome(cast)
    return told


def _outcome(cast: Cast) -> dict[str, Any]:
    if cast.run is None:  # nothing is known of it
        return {"reason": cast.reason}
    return {
        "wound": cast.wound,
        "held": cast.held,
        "turns": cast.turns,
        "slipped_m": cast.slipped,
        "grip": cast.grip,
        "strike_s": cast.strike,
        "first_touch_s": cast.touch,
        "contact_rad": cast.contact,
        "sharpest_bend_rad": cast.bend,
        "torque_Nm": cast.torque,
        "links": cast.run.q.shape[1],
        "reason": cast.reason,
    }


def _table(plan: CastPlan) -> dict[str, Any]:
    thrower = plan.thrower
    return {
        "time": thrower.time,
        "limits": asdict(thrower.limits),
        "rope": thrower.rope.table(),
        "outcome": summary(plan),
    }
