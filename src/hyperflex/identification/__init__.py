"""Identification: from a recording and a first guess to a rope with uncertainties."""

from __future__ import annotations

from hyperflex.identification._baselines import (
    cylinder_inertia,
    natural_frequency_inertia,
    natural_period,
    swing_period,
)
from hyperflex.identification._bootstrap import Bootstrap, bootstrap
from hyperflex.identification._correlogram import correlogram
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
    "HeldOut",
    "Identification",
    "InitialState",
    "Interval",
    "LeastSquares",
    "Profile",
    "Regression",
    "Revision",
    "RevisionProfile",
    "Round",
    "bootstrap",
    "correlogram",
    "cylinder_inertia",
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
