"""Casting: throw a rope round a target, wind it and hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.casting.chance import Success, success
    from hyperflex.casting.following import DrawnWorld, Followed, Look, follow
    from hyperflex.casting.hold import Holding
    from hyperflex.casting.limits import MotorLimits
    from hyperflex.casting.outcome import Cast, verify
    from hyperflex.casting.plan import CastPlan, plan_cast
    from hyperflex.casting.tables import read_plan
    from hyperflex.casting.targets import Reach, reach
    from hyperflex.casting.throw import Throw
    from hyperflex.casting.thrower import Thrower
    from hyperflex.casting.uncertainty import Draw, Uncertainty

_HOMES = {
    "Cast": "outcome",
    "CastPlan": "plan",
    "Holding": "hold",
    "Draw": "uncertainty",
    "DrawnWorld": "following",
    "Followed": "following",
    "Look": "following",
    "MotorLimits": "limits",
    "Reach": "targets",
    "Success": "chance",
    "Throw": "throw",
    "Thrower": "thrower",
    "Uncertainty": "uncertainty",
    "follow": "following",
    "plan_cast": "plan",
    "read_plan": "tables",
    "reach": "targets",
    "success": "chance",
    "verify": "outcome",
}

__all__ = [
    "Cast",
    "CastPlan",
    "Draw",
    "DrawnWorld",
    "Followed",
    "Holding",
    "Look",
    "MotorLimits",
    "Reach",
    "Success",
    "Throw",
    "Thrower",
    "Uncertainty",
    "follow",
    "plan_cast",
    "reach",
    "read_plan",
    "success",
    "verify",
]

__getattr__ = loader(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
