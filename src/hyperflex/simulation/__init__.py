"""Simulation: :func:`simulate` for whole runs, :func:`angles` for the bare arrays that identification needs."""

from hyperflex.simulation.batch import Batch, simulate_batch
from hyperflex.simulation.chaos import Predictability, predictability
from hyperflex.simulation.runs import angles, simulate
from hyperflex.simulation.stability import runge_kutta_limit

__all__ = ["Batch", "Predictability", "angles", "predictability", "runge_kutta_limit", "simulate", "simulate_batch"]
