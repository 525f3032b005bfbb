"""Identification: from a recording and a first guess to a rope with uncertainties."""

from __future__ import annotations

from hyperflex.identification._choice import FittedModel, ModelComparison, compare_models
from hyperflex.identification._identify import identify
from hyperflex.identification._parameters import lumped
from hyperflex.identification._prediction import HeldOut
from hyperflex.identification._result import Identification
from hyperflex.identification._uncertainty import ratios

__all__ = [
    "FittedModel",
    "HeldOut",
    "Identification",
    "ModelComparison",
    "compare_models",
    "identify",
    "lumped",
    "ratios",
]
