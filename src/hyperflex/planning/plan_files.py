"""Plans, and limits of a motor, read back from the files that they were written to."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from hyperflex import checks, files
from hyperflex.errors import InvalidInput
from hyperflex.model import PLAN, MotorLimits
from hyperflex.planning.plan import CastPlan, from_table
from hyperflex.planning.tasks.insert import InsertPlan
from hyperflex.planning.tasks.whip import WhipPlan

_AGAIN = "Write it again with to_toml, or plan again"
AnyPlan = CastPlan | WhipPlan | InsertPlan
KINDS: dict[str, type[AnyPlan]] = {kind.kind: kind for kind in (CastPlan, WhipPlan, InsertPlan)}


def read_plan(path: files.PathLike) -> AnyPlan:
    """Read a plan from a file of its method ``to_toml``.

    Parameters
    ----------
    path : path-like
        TOML file.

    Returns
    -------
    CastPlan, WhipPlan or InsertPlan
        Equal to the plan that was written, but without its runs.

    Raises
    ------
    FileProblem, InvalidInput
        If the file cannot be read or has no plan.
    """
    content = files.read_toml(path)
    table = dict(content.get(PLAN) or {})
    if table.pop("source", None) != "simulated" or (kind := KINDS.get(table.pop("kind", ""))) is None:
        raise InvalidInput(f"{path} has no plan", got=sorted(content), allowed="a file that a plan's to_toml wrote")
    try:
        plan = from_table(kind, table)
        whole = plan.motion is None or _carries(content, plan)
    except InvalidInput as error:
        raise InvalidInput(f"the plan in {path} is not complete: {error.what}", got=error.got, fix=_AGAIN) from None
    except (AttributeError, KeyError, IndexError, OverflowError, RecursionError, TypeError, ValueError) as error:
        missing = f"the key {error}" if isinstance(error, KeyError) else "a value of the right kind"
        raise InvalidInput(f"the plan in {path} is not complete: it lacks {missing}", fix=_AGAIN) from None
    if not whole:
        raise InvalidInput(f"the moves in {path} no longer fit their limits or arm", fix="Plan again")
    return plan


def _carries(content: Mapping[str, Any], plan: AnyPlan) -> bool:
    """Whether the set-up of a file is that of the plan in it: its arm, and its motion but for rounding."""
    moves, written = {**plan.required(plan.motion, "motion").spec}, {**content["motion"]}
    same = moves.pop("kind") == written.pop("kind") and moves.keys() == written.keys()
    same = same and content["arm"] == content[PLAN]["problem"]["arm"]
    return same and all(np.allclose(value, written[name]) for name, value in moves.items())


def read_limits(path: files.PathLike) -> MotorLimits | None:
    """Read the motor's limits from the table [limits] of a set-up's TOML file, or from a plan's; None without them.

    Raises FileProblem or InvalidInput if the file cannot be read, or has limits that are out of range.
    """
    content: Mapping[str, Any] = files.read_toml(path)
    for name in (PLAN, "problem") if PLAN in content else ():
        content = checks.mapping(f"{name} of {path}", content.get(name, {}))
    if "limits" not in content:
        return None
    table = checks.mapping(f"limits of {path}", content["limits"])
    checks.keys(f"the table [limits] of {path}", table, [each.name for each in fields(MotorLimits)])
    return MotorLimits(**table)
