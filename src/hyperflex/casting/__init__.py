"""Casting: throw a rope round a target, wind it and hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.casting.limits import MotorLimits
    from hyperflex.casting.outcome import Cast, verify
    from hyperflex.casting.plan import CastPlan, plan_cast
    from hyperflex.casting.targets import Reach, reach
    from hyperflex.casting.throw import Throw
    from hyperflex.casting.thrower import Thrower

_HOMES = {
    "Cast": "outcome",
    "CastPlan": "plan",
    "MotorLimits": "limits",
    "Reach": "targets",
    "Throw": "throw",
    "Thrower": "thrower",
    "plan_cast": "plan",
    "reach": "targets",
    "verify": "outcome",
}

__all__ = ["Cast", "CastPlan", "MotorLimits", "Reach", "Throw", "Thrower", "plan_cast", "reach", "verify"]

__getattr__ = loader(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
