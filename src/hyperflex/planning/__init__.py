"""Planning: casts that wind a rope round a target and hold, whips whose tip passes a point fast, insertions."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.model import MotorLimits
    from hyperflex.planning.casting import plan_cast, replan_cast
    from hyperflex.planning.ensemble import SuccessProbability, estimate_success_probability
    from hyperflex.planning.feasibility import Feasibility, check_feasibility
    from hyperflex.planning.feedback import (
        Decision,
        FollowOptions,
        FollowResult,
        MotorStateSource,
        ScenarioStateSource,
        follow_plan,
    )
    from hyperflex.planning.moves import Moves
    from hyperflex.planning.options import (
        Conditions,
        SearchOptions,
        WindCriteria,
        checked_behind,
        refuse_behind,
    )
    from hyperflex.planning.outcome import (
        BOUNCE_TIME,
        CastOutcome,
        HoldingForce,
        measure_holding_force,
        verify_cast,
    )
    from hyperflex.planning.plan import RATE, CastPlan, FallbackTarget
    from hyperflex.planning.plan_files import AnyPlan, read_limits, read_plan
    from hyperflex.planning.problem import Problem
    from hyperflex.planning.reach_map import NOT_PLANNED, ReachMap, TargetGrid, build_reach_map, read_reach_map
    from hyperflex.planning.rollouts import RolloutBatch, fly_to_strikes
    from hyperflex.planning.tasks.insert import (
        InsertOutcome,
        InsertPlan,
        Slot,
        estimate_insert_probability,
        plan_insert,
    )
    from hyperflex.planning.tasks.tip import TipFeasibility, TipOptions
    from hyperflex.planning.tasks.whip import (
        Impact,
        Peaks,
        TipStrike,
        TipTarget,
        WhipMap,
        WhipPlan,
        build_whip_map,
        check_whip_feasibility,
        plan_whip,
        simulate_impact,
    )
    from hyperflex.planning.uncertainty import RopePosterior, Scenario, Uncertainty, scaled_rope
    from hyperflex.planning.verification import Accuracy

__getattr__, __dir__, __all__ = attach(__name__, __file__)
