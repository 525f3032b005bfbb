"""Casting: throw a rope round a target, wind it and hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.casting.holding import Holding
    from hyperflex.casting.limits import MotorLimits
    from hyperflex.casting.plan import CastPlan, plan_cast
    from hyperflex.casting.reach import Reach, reach
    from hyperflex.casting.tables import read_plan
    from hyperflex.casting.throw import Throw
    from hyperflex.casting.thrower import Thrower
    from hyperflex.casting.verify import Cast, verify

_HOMES = {
    "Cast": "verify",
    "CastPlan": "plan",
    "Holding": "holding",
    "MotorLimits": "limits",
    "Reach": "reach",
    "Throw": "throw",
    "Thrower": "thrower",
    "plan_cast": "plan",
    "read_plan": "tables",
    "reach": "reach",
    "verify": "verify",
}

__all__ = [
    "Cast",
    "CastPlan",
    "Holding",
    "MotorLimits",
    "Reach",
    "Throw",
    "Thrower",
    "plan_cast",
    "reach",
    "read_plan",
    "verify",
]

__getattr__ = loader(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
