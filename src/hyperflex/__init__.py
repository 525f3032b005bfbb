"""hyperflex: robots that use a rope as an arm. Identify it, simulate it, cast it.

Public names are loaded on first use, so that ``import hyperflex`` stays quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.casting import CastPlan, MotorLimits, plan_cast
    from hyperflex.identification import (
        Bootstrap,
        Design,
        Experiment,
        Identification,
        ModelComparison,
        Revision,
        bootstrap,
        compare_models,
        design,
        identify,
        initial_state,
        regression,
        revise,
    )
    from hyperflex.model import Arm, Ground, Peg, Rope, Setup, Wall, refined
    from hyperflex.motion import (
        Motion,
        hold,
        move,
        moves,
        moving_point,
        read_motion,
        sampled,
        strokes,
        swings,
        torque_profile,
    )
    from hyperflex.recording import Recording, read_recording
    from hyperflex.simulation import (
        Batch,
        Event,
        Predictability,
        Sensitivities,
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
    from hyperflex.winding import Tug, Winding, slip, tension, tug, wound

__version__ = "0.1.0"

_HOMES = {
    "CastPlan": "casting",
    "MotorLimits": "casting",
    "plan_cast": "casting",
    "Arm": "model",
    "Batch": "simulation",
    "Bootstrap": "identification",
    "Design": "identification",
    "Event": "simulation",
    "Experiment": "identification",
    "Ground": "model",
    "Identification": "identification",
    "ModelComparison": "identification",
    "Motion": "motion",
    "Peg": "model",
    "Predictability": "simulation",
    "Recording": "recording",
    "Revision": "identification",
    "Rope": "model",
    "Sensitivities": "simulation",
    "Setup": "model",
    "State": "trajectory",
    "Trajectory": "trajectory",
    "Tug": "winding",
    "Wall": "model",
    "Winding": "winding",
    "angle_reached": "simulation",
    "bootstrap": "identification",
    "compare_models": "identification",
    "design": "identification",
    "hold": "motion",
    "identify": "identification",
    "initial_state": "identification",
    "move": "motion",
    "moves": "motion",
    "moving_point": "motion",
    "phase_reached": "simulation",
    "predictability": "simulation",
    "read_motion": "motion",
    "read_recording": "recording",
    "read_trajectory": "trajectory",
    "refined": "model",
    "regression": "identification",
    "revise": "identification",
    "sampled": "motion",
    "sensitivities": "simulation",
    "simulate": "simulation",
    "simulate_batch": "simulation",
    "slip": "winding",
    "strokes": "motion",
    "swings": "motion",
    "tension": "winding",
    "tip_crosses": "simulation",
    "tip_speed_peak": "simulation",
    "torque_profile": "motion",
    "tug": "winding",
    "wound": "winding",
}

__all__ = [
    "Arm",
    "Batch",
    "Bootstrap",
    "CastPlan",
    "Design",
    "Event",
    "Experiment",
    "Ground",
    "Identification",
    "ModelComparison",
    "Motion",
    "MotorLimits",
    "Peg",
    "Predictability",
    "Recording",
    "Revision",
    "Rope",
    "Sensitivities",
    "Setup",
    "State",
    "Trajectory",
    "Tug",
    "Wall",
    "Winding",
    "__version__",
    "angle_reached",
    "bootstrap",
    "compare_models",
    "design",
    "hold",
    "identify",
    "initial_state",
    "move",
    "moves",
    "moving_point",
    "phase_reached",
    "plan_cast",
    "predictability",
    "read_motion",
    "read_recording",
    "read_trajectory",
    "refined",
    "regression",
    "revise",
    "sampled",
    "sensitivities",
    "simulate",
    "simulate_batch",
    "slip",
    "strokes",
    "swings",
    "tension",
    "tip_crosses",
    "tip_speed_peak",
    "torque_profile",
    "tug",
    "wound",
]


__getattr__ = loader(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
