"""Online estimation: a rope's state, and what is unknown of it, from the places of its markers."""

from __future__ import annotations

from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.observations import MarkerModel, Observations
from hyperflex.estimate.parameters import EstimatedParameter

__all__ = ["EstimatedParameter", "MarkerModel", "Observations", "RopeFilter"]
