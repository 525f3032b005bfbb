"""Simulation: :func:`simulate` for whole runs, :func:`simulate_batch` for many, :func:`sensitivities` for derivatives.

:class:`AngleJacobian` gives the bare arrays that filters and fits need.
"""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.simulation.batch import Batch, BatchFields, BatchState, BatchStepper, simulate_batch
    from hyperflex.simulation.contact import check_outside
    from hyperflex.simulation.events import Event, angle_reached, phase_reached, tip_crosses, tip_speed_peak
    from hyperflex.simulation.out_of_plane import Sideways, lean_warning, refuse_rope, sideways
    from hyperflex.simulation.rollouts import (
        Interval,
        Rollout,
        base_motion,
        first_moment,
        link_accelerations,
        rollout_limits,
        runge_kutta_limit,
    )
    from hyperflex.simulation.runs import SAMPLE_TIME, RunFields, angles, file_size, simulate, tighter_run
    from hyperflex.simulation.sensitivity import (
        AngleJacobian,
        ParameterChange,
        ParameterDirections,
        Predictability,
        Sensitivities,
        forward_derivatives,
        predictability,
        sensitivities,
    )
    from hyperflex.simulation.stepper import Linearization, Stepper, arm_polynomials, commanded_accelerations, setup_for

__getattr__, __dir__, __all__ = attach(__name__, __file__)
