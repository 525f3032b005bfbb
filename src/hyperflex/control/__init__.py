"""Control: pseudo-energy, the paper's timing rule, receding-horizon rules, their closed loop; postures by vibration."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.control.rules import (
        AmplitudeRule,
        ClosedLoopRun,
        CrossingRule,
        PumpingPlan,
        PumpingRule,
        Rule,
        optimize_pumping,
        run_closed_loop,
    )
    from hyperflex.control.spiral_coordinates import (
        Spiral,
        driving_constant,
        pseudo_energy,
        spiral,
    )
    from hyperflex.control.state_source import SimulatedCamera, TrueState, hanging_state
    from hyperflex.control.swing_model import SwingModel, arrival_time, swing_period
    from hyperflex.control.vibration import VibrationMap, VibrationPosture, vibration_map, vibration_posture
    from hyperflex.control.vibration_plan import MotorDemand, VibrationPlan, plan_vibration

__getattr__, __dir__, __all__ = attach(__name__, __file__)
