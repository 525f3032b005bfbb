"""Identification: from a recording and a first guess to a rope with uncertainties."""

from __future__ import annotations

from hyperflex.identification._choice import FittedModel, ModelComparison, compare_models
from hyperflex.identification._design import Design, Plan, design
from hyperflex.identification._experiments import Experiment
from hyperflex.identification._identify import identify
from hyperflex.identification._parameters import lumped
from hyperflex.identification._prediction import HeldOut
from hyperflex.identification._result import Identification
from hyperflex.identification._uncertainty import ratios

__all__ = [
    "Design",
    "Experiment",
    "FittedModel",
    "HeldOut",
    "Identification",
    "ModelComparison",
    "Plan",
    "compare_models",
    "design",
    "identify",
    "lumped",
    "ratios",
]
