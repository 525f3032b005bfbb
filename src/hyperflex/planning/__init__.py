"""Casting: throw a rope round a target, wind it and hold; whip: bring its tip fast through a point."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.planning.cast_plan import CastPlan
    from hyperflex.planning.cast_setup import Thrower
    from hyperflex.planning.feedback.closed_loop import Followed, Look, follow
    from hyperflex.planning.feedback.simulated_ropes import DrawnWorld, DrivenWorld
    from hyperflex.planning.files import read_plan
    from hyperflex.planning.motor_limits import MotorLimits
    from hyperflex.planning.plan import plan_cast
    from hyperflex.planning.robust.success_probability import Success, success
    from hyperflex.planning.robust.uncertainty import Draw, Uncertainty
    from hyperflex.planning.whip.files import read_whip
    from hyperflex.planning.whip.impact import Impact
    from hyperflex.planning.whip.outcome import Lash
    from hyperflex.planning.whip.plan import WhipPlan, plan_whip
    from hyperflex.planning.whip.reachability import WhipReach, reach_whip
    from hyperflex.planning.whip.search import WhipMap, whip_map
    from hyperflex.planning.whip.strokes import Strokes
    from hyperflex.planning.whip.tip_target import Mark
    from hyperflex.planning.wind.holding import Holding, tug_wound
    from hyperflex.planning.wind.nearest_target import Nearest
    from hyperflex.planning.wind.outcome import Cast, verify
    from hyperflex.planning.wind.reachability import Reach, reach
    from hyperflex.planning.wind.throw import Throw

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
    "tug_wound",
    "verify",
    "whip_map",
]

__getattr__ = loader(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
