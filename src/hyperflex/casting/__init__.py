"""Casting: throw a rope round a target, wind it and hold; whipping: its tip fast through a point."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.casting.lash import Mark
    from hyperflex.casting.limits import MotorLimits
    from hyperflex.casting.plan import CastPlan, plan_cast
    from hyperflex.casting.reach import Reach, reach
    from hyperflex.casting.strokes import Strokes
    from hyperflex.casting.throw import Throw
    from hyperflex.casting.thrower import Thrower
    from hyperflex.casting.verify import Cast, verify
    from hyperflex.casting.whip import WhipPlan, WhipReach, plan_whip, reach_whip
    from hyperflex.casting.whip_search import WhipMap, whip_map
    from hyperflex.casting.whip_strike import Impact, Lash

_HOMES = {
    "Cast": "verify",
    "CastPlan": "plan",
    "Impact": "whip_strike",
    "Lash": "whip_strike",
    "Mark": "lash",
    "MotorLimits": "limits",
    "Reach": "reach",
    "Strokes": "strokes",
    "Throw": "throw",
    "Thrower": "thrower",
    "WhipMap": "whip_search",
    "WhipPlan": "whip",
    "WhipReach": "whip",
    "plan_cast": "plan",
    "plan_whip": "whip",
    "reach": "reach",
    "reach_whip": "whip",
    "verify": "verify",
    "whip_map": "whip_search",
}

__all__ = [
    "Cast",
    "CastPlan",
    "Impact",
    "Lash",
    "Mark",
    "MotorLimits",
    "Reach",
    "Strokes",
    "Throw",
    "Thrower",
    "WhipMap",
    "WhipPlan",
    "WhipReach",
    "plan_cast",
    "plan_whip",
    "reach",
    "reach_whip",
    "verify",
    "whip_map",
]

__getattr__ = loader(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
