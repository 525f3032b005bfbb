"""A planned whip as files: the set-up that is simulated again, and everything that the whip was planned with."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hyperflex import files
from hyperflex.errors import InvalidInput
from hyperflex.model import PLAN, Setup
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.files import searched
from hyperflex.planning.motor_limits import MotorLimits
from hyperflex.planning.whip.tip_target import Mark

if TYPE_CHECKING:
    from hyperflex.planning.whip.outcome import Lash
    from hyperflex.planning.whip.plan import WhipPlan


def motion_of(plan: WhipPlan) -> Motion:
    """Return what the arm does; raises InvalidInput where there are no strokes."""
    if plan.motion is None:
        raise InvalidInput("the plan holds no strokes", got=plan.reason, fix="Plan for a target that is in reach")
    return plan.motion


def lash_of(plan: WhipPlan) -> Lash:
    """Return what the tip does in the verified run; raises InvalidInput where there is none."""
    if plan.lash is None:
        raise InvalidInput("the plan holds no run", got=plan.reason, fix="Plan for a target that is in reach")
    return plan.lash


def note(plan: WhipPlan) -> dict[str, str]:
    """Return the note on a whip that does not stand: whether it fails or was not verified, and why; else none."""
    if plan.success:
        return {}
    return {"not verified" if plan.lash is None else "fails": plan.reason}


def write_whip(path: files.PathLike, plan: WhipPlan) -> None:
    """Write a plan to a TOML file: the verified run's set-up, and a table ``[plan]`` with what it was planned for.

    Parameters
    ----------
    path : path-like
        Whole or not at all. ``hyperflex simulate`` and :meth:`hyperflex.Setup.from_toml` read the set-up,
        :func:`read_whip` what is needed to plan or verify again.
    plan : WhipPlan
        With strokes.

    Raises
    ------
    InvalidInput
        There are no strokes, so nothing to write.
    """
    thrower, motion = plan.thrower, motion_of(plan)
    end = float(motion.breaks[-1]) if plan.lash is None else float(plan.lash.run.t[-1])
    setup = Setup(thrower.rope, motion, thrower.arm, duration=end)
    table = {
        "time": thrower.time,
        "limits": asdict(thrower.limits),
        "target": asdict(plan.mark),
        "outcome": summary(plan),
    }
    files.write_text(path, setup.dumps() + "\n" + files.dumps_toml({PLAN: table}))


def read_whip(path: str | Path) -> tuple[Thrower, Mark, Motion]:
    """Read who whips, the target and what the arm does from a file of :func:`write_whip`.

    Raises
    ------
    FileProblem, InvalidInput
        If the file cannot be read or holds no planned whip.
    """
    setup, content = Setup.from_toml(path), files.read_toml(path)
    table = content.get(PLAN)
    if not isinstance(table, dict) or "target" not in table or setup.motion is None or setup.arm is None:
        raise InvalidInput(f"{path} holds no planned whip", got=sorted(content), allowed="a file of WhipPlan.to_toml")
    try:
        mark = Mark(**table["target"])
        thrower = Thrower(setup.rope, setup.arm, MotorLimits(**table["limits"]), table["time"])
    except (KeyError, TypeError) as error:
        raise InvalidInput(f"the plan in {path} is not whole", got=str(error), fix="Write it again") from None
    return thrower, mark, setup.motion


def summary(plan: WhipPlan) -> dict[str, Any]:
    """Return what a plan is and became, for TOML and JSON: whether it stands, why not, strokes, outcome."""
    told = searched(plan)
    if plan.strokes is not None:
        limits = plan.thrower.limits
        told |= {"strokes": int(plan.strokes.ends.size), "starts_s": plan.strokes.starts(limits)}
        told |= {"angles_rad": plan.strokes.angles(limits), "arm_stops_s": float(motion_of(plan).breaks[-1])}
        told["doubt_m"] = plan.doubt
    for name, seen in (("lash", plan.lash), ("finer", plan.finer)):
        if seen is not None:
            told[name] = _outcome(seen, plan.mark)
    return told


def _outcome(seen: Lash, mark: Mark) -> dict[str, Any]:
    told = {
        "t_s": seen.t,
        "x_m": float(seen.place[0]),
        "y_m": float(seen.place[1]),
        "miss_m": seen.miss,
        "speed_m_s": seen.speed,
        "direction_rad": math.atan2(seen.velocity[1], seen.velocity[0]),
        "fastest_before_m_s": seen.before,
        "torque_Nm": seen.torque,
        "links": seen.run.q.shape[1],
        "reason": seen.reason,
    }
    return told if mark.anyhow else told | {"off_rad": seen.off}
