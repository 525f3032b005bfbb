"""hyperflex: robots that use a rope as an arm. Identify it, simulate it, cast it.

Public names are loaded on first use, so that ``import hyperflex`` stays quick.
"""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.control import (
        VibrationMap,
        VibrationPlan,
        VibrationPosture,
        plan_vibration,
        vibration_map,
        vibration_posture,
    )
    from hyperflex.dynamics import forward_kinematics, linearize, mass_matrix
    from hyperflex.errors import (
        EstimatorLost,
        FileProblem,
        HyperflexError,
        IdentificationError,
        Interrupted,
        InvalidInput,
        MissingPackage,
        SimulationError,
        WorkerLost,
    )
    from hyperflex.exchange import read_mjcf, write_mcap, write_mjcf
    from hyperflex.identification import (
        Experiment,
        ExperimentDesign,
        FitOptions,
        Identification,
        ModelComparison,
        RecordingSetup,
        compare_models,
        design_experiment,
        identify,
    )
    from hyperflex.interfaces import Motor, RopeState, StateSource
    from hyperflex.model import Arm, Ground, Peg, Rope, Setup, Wall, refine_rope, with_links
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
        vibrate_arm,
        vibrating_pivot,
    )
    from hyperflex.paper import IterativeRevision, estimate_initial_state, fit_regression, iterative_revision
    from hyperflex.planning import (
        CastPlan,
        Conditions,
        FollowOptions,
        FollowResult,
        InsertPlan,
        MotorLimits,
        Problem,
        ReachMap,
        SearchOptions,
        Slot,
        TargetGrid,
        TipTarget,
        Uncertainty,
        WhipMap,
        WhipPlan,
        WindCriteria,
        build_reach_map,
        build_whip_map,
        follow_plan,
        plan_cast,
        plan_insert,
        plan_whip,
        read_plan,
        read_reach_map,
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
        Sideways,
        Stepper,
        angle_reached,
        phase_reached,
        predictability,
        sensitivities,
        sideways,
        simulate,
        simulate_batch,
        tip_crosses,
        tip_speed_peak,
    )
    from hyperflex.trajectory import State, Trajectory, read_trajectory
    from hyperflex.winding import TugTest, Winding, measure_winding, rope_slip, rope_tension, tug_test

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = attach(__name__, __file__)
