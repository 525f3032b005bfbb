"""hyperflex: robots that use a rope as an arm. Identify it, simulate it, cast it.

Public names are loaded on first use, so that ``import hyperflex`` stays quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.dynamics import forward_kinematics, linearize, mass_matrix
    from hyperflex.identification import (
        Bootstrap,
        Experiment,
        ExperimentDesign,
        Identification,
        IterativeRevision,
        ModelComparison,
        bootstrap,
        compare_models,
        design_experiment,
        estimate_initial_state,
        fit_regression,
        identify,
        iterative_revision,
    )
    from hyperflex.interfaces import Motor, RopeState, StateSource
    from hyperflex.model import Arm, Ground, Peg, Rope, Setup, Wall, refine_rope
    from hyperflex.motion import (
        Motion,
        arm_moves,
        arm_strokes,
        arm_swings,
        hold_arm,
        move_arm,
        moving_pivot,
        read_motion,
        sampled_motion,
        torque_profile,
    )
    from hyperflex.planning import (
        CastPlan,
        CastSetup,
        FollowResult,
        MotorLimits,
        TipTarget,
        Uncertainty,
        WhipMap,
        WhipPlan,
        build_whip_map,
        follow_plan,
        plan_cast,
        plan_whip,
        read_plan,
    )
    from hyperflex.recording import Recording, read_recording
    from hyperflex.simulation import (
        Batch,
        BatchState,
        BatchStepper,
        Event,
        Linearization,
        Predictability,
        Sensitivities,
        Stepper,
        angle_reached,
        phase_reached,
        predictability,
        sensitivities,
        simulate,
        simulate_batch,
        tip_crosses,
        tip_speed_peak,
    )
    from hyperflex.trajectory import State, Trajectory, read_trajectory
    from hyperflex.winding import TugTest, Winding, measure_winding, rope_slip, rope_tension, tug_test

__version__ = "0.1.0"

__all__ = [
    "Arm",
    "Batch",
    "BatchState",
    "BatchStepper",
    "Bootstrap",
    "CastPlan",
    "CastSetup",
    "Event",
    "Experiment",
    "ExperimentDesign",
    "FollowResult",
    "Ground",
    "Identification",
    "IterativeRevision",
    "Linearization",
    "ModelComparison",
    "Motion",
    "Motor",
    "MotorLimits",
    "Peg",
    "Predictability",
    "Recording",
    "Rope",
    "RopeState",
    "Sensitivities",
    "Setup",
    "State",
    "StateSource",
    "Stepper",
    "TipTarget",
    "Trajectory",
    "TugTest",
    "Uncertainty",
    "Wall",
    "WhipMap",
    "WhipPlan",
    "Winding",
    "__version__",
    "angle_reached",
    "arm_moves",
    "arm_strokes",
    "arm_swings",
    "bootstrap",
    "build_whip_map",
    "compare_models",
    "design_experiment",
    "estimate_initial_state",
    "fit_regression",
    "follow_plan",
    "forward_kinematics",
    "hold_arm",
    "identify",
    "iterative_revision",
    "linearize",
    "mass_matrix",
    "measure_winding",
    "move_arm",
    "moving_pivot",
    "phase_reached",
    "plan_cast",
    "plan_whip",
    "predictability",
    "read_motion",
    "read_plan",
    "read_recording",
    "read_trajectory",
    "refine_rope",
    "rope_slip",
    "rope_tension",
    "sampled_motion",
    "sensitivities",
    "simulate",
    "simulate_batch",
    "tip_crosses",
    "tip_speed_peak",
    "torque_profile",
    "tug_test",
]


__getattr__ = loader(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
