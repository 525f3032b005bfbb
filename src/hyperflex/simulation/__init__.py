"""Simulation: :func:`simulate` for whole runs, :func:`simulate_batch` for many, :func:`sensitivities` for derivatives.

:func:`angles` and :class:`AngleJacobian` give the bare arrays that identification needs.
"""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.simulation.arguments import file_size
    from hyperflex.simulation.batch.batch import Batch, simulate_batch
    from hyperflex.simulation.batch.members import BatchFields
    from hyperflex.simulation.batch.stepper import BatchState, BatchStepper
    from hyperflex.simulation.commands import arm_polynomials, set_commands, setup_for, state_directions
    from hyperflex.simulation.contact.start import check_limits, check_outside
    from hyperflex.simulation.events import Event, angle_reached, phase_reached, tip_crosses, tip_speed_peak
    from hyperflex.simulation.lyapunov import Predictability, predictability
    from hyperflex.simulation.rollouts import (
        Interval,
        finish_rollout,
        link_accelerations,
        prepare_rollout,
        rollout_limits,
    )
    from hyperflex.simulation.runs import angles, simulate
    from hyperflex.simulation.sensitivity.directions import ParameterChange, ParameterDirections
    from hyperflex.simulation.sensitivity.propagation import Propagator
    from hyperflex.simulation.sensitivity.sensitivity import (
        AngleJacobian,
        Sensitivities,
        acceleration_jacobian,
        forward_derivatives,
        record_steps,
        sensitivities,
    )
    from hyperflex.simulation.stability import runge_kutta_limit
    from hyperflex.simulation.stepper import Linearization, Stepper

__getattr__, __dir__, __all__ = attach(__name__, __file__)
