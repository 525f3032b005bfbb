"""Simulation: :func:`simulate` for whole runs, :func:`simulate_batch` for many, :func:`sensitivities` for derivatives.

:func:`angles` and :class:`Slopes` give the bare arrays that identification needs.
"""

from hyperflex.simulation.batch import Batch, simulate_batch
from hyperflex.simulation.chaos import Predictability, predictability
from hyperflex.simulation.events import Event, angle_reached, phase_reached, tip_crosses, tip_speed_peak
from hyperflex.simulation.runs import angles, simulate
from hyperflex.simulation.sensitivity import Sensitivities, Slopes, sensitivities
from hyperflex.simulation.stability import runge_kutta_limit

__all__ = [
    "Batch",
    "Event",
    "Predictability",
    "Sensitivities",
    "Slopes",
    "angle_reached",
    "angles",
    "phase_reached",
    "predictability",
    "runge_kutta_limit",
    "sensitivities",
    "simulate",
    "simulate_batch",
    "tip_crosses",
    "tip_speed_peak",
]
