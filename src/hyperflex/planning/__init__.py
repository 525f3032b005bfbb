"""Planning: casts that wind a rope round a target and hold, whips whose tip passes a point fast, insertions."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.planning.feasibility import Feasibility, check_feasibility
    from hyperflex.planning.feedback import (
        Decision,
        FollowOptions,
        FollowResult,
        MotorStateSource,
        ScenarioStateSource,
        follow_plan,
    )
    from hyperflex.planning.insert.chance import estimate_insert_probability
    from hyperflex.planning.insert.insert_plan import InsertPlan
    from hyperflex.planning.insert.outcome import InsertOutcome
    from hyperflex.planning.insert.planner import plan_insert
    from hyperflex.planning.insert.search import InsertFeasibility
    from hyperflex.planning.insert.slot import Slot
    from hyperflex.planning.options import MotorLimits
    from hyperflex.planning.outcome import (
        BOUNCE_TIME,
        MAX_SLIP,
        WATCH_TIME,
        CastOutcome,
        HoldingForce,
        measure_holding_force,
        verify_cast,
    )
    from hyperflex.planning.plan import RATE
    from hyperflex.planning.plan_files import read_limits, read_plan
    from hyperflex.planning.problem import MIN_TURNS, SETTLING_TIME, Problem
    from hyperflex.planning.robust.posterior import RopePosterior
    from hyperflex.planning.robust.scenario_rollouts import SuccessProbability, estimate_success_probability
    from hyperflex.planning.robust.uncertainty import Scenario, Uncertainty, scaled_rope
    from hyperflex.planning.routing import checked_behind, refuse_behind
    from hyperflex.planning.throw import Throw
    from hyperflex.planning.tip.aim import FRICTION_STD, LENGTH_STD, TIMING_STD
    from hyperflex.planning.tip.strokes import Strokes
    from hyperflex.planning.tip.task import TipCandidate
    from hyperflex.planning.whip.impact import IMPACT_RADIUS, IMPACT_TIME, Impact
    from hyperflex.planning.whip.outcome import TipStrike
    from hyperflex.planning.whip.planner import plan_whip
    from hyperflex.planning.whip.search import (
        WhipFeasibility,
        WhipMap,
        build_whip_map,
        check_whip_feasibility,
    )
    from hyperflex.planning.whip.tip_target import Peaks, TipTarget
    from hyperflex.planning.whip.whip_plan import WhipPlan
    from hyperflex.planning.wind.cast_plan import CastPlan, FallbackTarget
    from hyperflex.planning.wind.casting import plan_cast
    from hyperflex.planning.wind.many import plan_casts
    from hyperflex.planning.wind.reach_map import NOT_PLANNED, ReachMap, build_reach_map, read_reach_map

__getattr__, __dir__, __all__ = attach(__name__, __file__)
