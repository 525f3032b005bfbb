"""Control of a swing: pseudo-energy, the paper's timing rule, receding-horizon rules, and their closed loop."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.control.closed_loop import ClosedLoopRun, run_closed_loop
    from hyperflex.control.period import swing_period
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
    from hyperflex.control.swing_model import SwingModel, arrival_time
    from hyperflex.control.timing import CrossingRule, Rule

__getattr__, __dir__, __all__ = attach(__name__, __file__)
