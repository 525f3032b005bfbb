"""The source paper: set-ups, tables behind its figures, claims. For `hyperflex reproduce` and the demo."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.paper.casting import READINGS, T_MOVE, T_REST, Reading, cable, casting_arm
    from hyperflex.paper.natural_frequency import (
        cylinder_inertia,
        natural_frequency_inertia,
        natural_period,
        swing_period,
    )
    from hyperflex.paper.part import Claim, Table, claims_table, verdicts
    from hyperflex.paper.regression import LeastSquares, Regression, fit_regression
    from hyperflex.paper.reproduction import reproduce
    from hyperflex.paper.revision import (
        InitialState,
        IterativeRevision,
        RevisionProfile,
        Round,
        estimate_initial_state,
        iterative_revision,
        squared_error,
    )

__getattr__, __dir__, __all__ = attach(__name__, __file__)
