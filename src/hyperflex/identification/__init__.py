"""Identification: from a recording and a first guess to a rope with uncertainties."""

from __future__ import annotations

from hyperflex.identification._baselines import (
    cylinder_inertia,
    natural_frequency_inertia,
    natural_period,
    swing_period,
)
from hyperflex.identification._bootstrap import Bootstrap, bootstrap
from hyperflex.identification._choice import compare_models
from hyperflex.identification._comparison import FittedModel, ModelComparison
from hyperflex.identification._correlogram import correlogram
from hyperflex.identification._design import Design, Plan, design
from hyperflex.identification._experiments import Experiment
from hyperflex.identification._identify import identify
from hyperflex.identification._intervals import Interval
from hyperflex.identification._parameters import lumped
from hyperflex.identification._prediction import BAND, HeldOut
from hyperflex.identification._profile import Profile, profile
from hyperflex.identification._regression import LeastSquares, Regression, regression
from hyperflex.identification._result import Identification
from hyperflex.identification._revision import Revision, RevisionProfile, Round, revise
from hyperflex.identification._simplex import InitialState, initial_state, squared_error
from hyperflex.identification._uncertainty import ratios

__all__ = [
    "BAND",
    "Bootstrap",
    "Design",
    "Experiment",
    "FittedModel",
    "HeldOut",
    "Identification",
    "InitialState",
    "Interval",
    "LeastSquares",
    "ModelComparison",
    "Plan",
    "Profile",
    "Regression",
    "Revision",
    "RevisionProfile",
    "Round",
    "bootstrap",
    "compare_models",
    "correlogram",
    "cylinder_inertia",
    "design",
    "identify",
    "initial_state",
    "lumped",
    "natural_frequency_inertia",
    "natural_period",
    "profile",
    "ratios",
    "regression",
    "revise",
    "squared_error",
    "swing_period",
]
