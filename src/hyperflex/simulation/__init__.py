"""Simulation: :func:`simulate` for whole runs, :func:`simulate_batch` for many, :func:`sensitivities` for derivatives.

:func:`angles` and :class:`AngleJacobian` give the bare arrays that identification needs.
"""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.simulation.batch.batch import Batch, simulate_batch
    from hyperflex.simulation.batch.stepper import BatchState, BatchStepper
    from hyperflex.simulation.events import Event, angle_reached, phase_reached, tip_crosses, tip_speed_peak
    from hyperflex.simulation.lyapunov import Predictability, predictability
    from hyperflex.simulation.runs import angles, simulate
    from hyperflex.simulation.sensitivity.propagation import Propagator
    from hyperflex.simulation.sensitivity.sensitivity import AngleJacobian, Sensitivities, sensitivities
    from hyperflex.simulation.stability import runge_kutta_limit
    from hyperflex.simulation.stepper import Linearization, Stepper

__getattr__, __dir__, __all__ = attach(__name__, __file__)
