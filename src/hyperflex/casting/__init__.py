"""Casting: throw a rope round a target, wind it and hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.casting.hold import Holding
    from hyperflex.casting.limits import MotorLimits
    from hyperflex.casting.outcome import Cast, verify
    from hyperflex.casting.plan import CastPlan, plan_cast
    from hyperflex.casting.tables import read_plan
    from hyperflex.casting.targets import Reach, reach
    from hyperflex.casting.throw import Throw
    from hyperflex.casting.thrower import Thrower

_HOMES = {
    "Cast": "outcome",
    "CastPlan": "plan",
    "Holding": "hold",
    "MotorLimits": "limits",
    "Reach": "targets",
    "Throw": "throw",
    "Thrower": "thrower",
    "plan_cast": "plan",
    "read_plan": "tables",
    "reach": "targets",
    "verify": "outcome",
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
