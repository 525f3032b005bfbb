"""Control of a swing: pseudo-energy, the paper's timing rule, receding-horizon rules, and their closed loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.control.closed_loop import ClosedLoopRun, run_closed_loop
    from hyperflex.control.pumping import AmplitudeRule, PumpingRule
    from hyperflex.control.pumping_optimizer import PumpingPlan, optimize_pumping
    from hyperflex.control.spiral_coordinates import (
        PhasePortrait,
        Spiral,
        driving_constant,
        phase_portrait,
        pseudo_energy,
        spiral,
    )
    from hyperflex.control.state_source import SimulatedCamera, TrueState, hanging_state
    from hyperflex.control.swing_model import SwingModel, arrival_time, swing_period
    from hyperflex.control.timing import CrossingRule, Rule

__all__ = [
    "AmplitudeRule",
    "ClosedLoopRun",
    "CrossingRule",
    "PhasePortrait",
    "PumpingPlan",
    "PumpingRule",
    "Rule",
    "SimulatedCamera",
    "Spiral",
    "SwingModel",
    "TrueState",
    "arrival_time",
    "driving_constant",
    "hanging_state",
    "optimize_pumping",
    "phase_portrait",
    "pseudo_energy",
    "run_closed_loop",
    "spiral",
    "swing_period",
]

__getattr__ = loader(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
