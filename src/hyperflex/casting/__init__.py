"""Casting: throw a rope round a target, wind it and hold; whip: bring its tip fast through a point."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.casting.blow import Impact
    from hyperflex.casting.cast_plan import CastPlan
    from hyperflex.casting.chance import Success, success
    from hyperflex.casting.following import Followed, Look, follow
    from hyperflex.casting.hold import Holding
    from hyperflex.casting.lash import Mark
    from hyperflex.casting.limits import MotorLimits
    from hyperflex.casting.nearest import Nearest
    from hyperflex.casting.outcome import Cast, verify
    from hyperflex.casting.plan import plan_cast
    from hyperflex.casting.strokes import Strokes
    from hyperflex.casting.tables import read_plan
    from hyperflex.casting.targets import Reach, reach
    from hyperflex.casting.throw import Throw
    from hyperflex.casting.thrower import Thrower
    from hyperflex.casting.uncertainty import Draw, Uncertainty
    from hyperflex.casting.whip import WhipPlan, plan_whip
    from hyperflex.casting.whip_reach import WhipReach, reach_whip
    from hyperflex.casting.whip_search import WhipMap, whip_map
    from hyperflex.casting.whip_strike import Lash
    from hyperflex.casting.whip_tables import read_whip
    from hyperflex.casting.worlds import DrawnWorld, DrivenWorld

_HOMES = {
    "Cast": "outcome",
    "CastPlan": "cast_plan",
    "Draw": "uncertainty",
    "DrawnWorld": "worlds",
    "DrivenWorld": "worlds",
    "Followed": "following",
    "Holding": "hold",
    "Impact": "blow",
    "Lash": "whip_strike",
    "Look": "following",
    "Mark": "lash",
    "MotorLimits": "limits",
    "Nearest": "nearest",
    "Reach": "targets",
    "Strokes": "strokes",
    "Success": "chance",
    "Throw": "throw",
    "Thrower": "thrower",
    "Uncertainty": "uncertainty",
    "WhipMap": "whip_search",
    "WhipPlan": "whip",
    "WhipReach": "whip_reach",
    "follow": "following",
    "plan_cast": "plan",
    "plan_whip": "whip",
    "reach": "targets",
    "reach_whip": "whip_reach",
    "read_plan": "tables",
    "read_whip": "whip_tables",
    "success": "chance",
    "verify": "outcome",
    "whip_map": "whip_search",
}

__all__ = [
    "Cast",
    "CastPlan",
    "Draw",
    "DrawnWorld",
    "DrivenWorld",
    "Followed",
    "Holding",
    "Impact",
    "Lash",
    "Look",
    "Mark",
    "MotorLimits",
    "Nearest",
    "Reach",
    "Strokes",
    "Success",
    "Throw",
    "Thrower",
    "Uncertainty",
    "WhipMap",
    "WhipPlan",
    "WhipReach",
    "follow",
    "plan_cast",
    "plan_whip",
    "reach",
    "reach_whip",
    "read_plan",
    "read_whip",
    "success",
    "verify",
    "whip_map",
]

__getattr__ = loader(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
