"""Identification: from a recording and a first guess to a rope with uncertainties."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.identification.comparison import FittedModel, ModelComparison, compare_models
    from hyperflex.identification.declarations.faults import faults
    from hyperflex.identification.declarations.score_tests import ScoreTest
    from hyperflex.identification.experiment_design import (
        Experiment,
        ExperimentDesign,
        ExperimentPlan,
        design_experiment,
    )
    from hyperflex.identification.findings import Finding, Grade, Kind, Severity, text
    from hyperflex.identification.measurements import check_motion, check_times
    from hyperflex.identification.model import lumped, perturbed
    from hyperflex.identification.options import FitOptions, RecordingSetup
    from hyperflex.identification.pipeline import identify
    from hyperflex.identification.prediction import BAND, HeldOut
    from hyperflex.identification.result import Identification
    from hyperflex.identification.uncertainty.covariance import Basis, Interval, ratios
    from hyperflex.identification.uncertainty.profile import Profile, profile

__getattr__, __dir__, __all__ = attach(__name__, __file__)
