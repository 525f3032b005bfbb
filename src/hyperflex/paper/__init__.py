"""The source paper: set-ups, tables behind its figures, claims. For `hyperflex reproduce` and the demo."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.paper.casting import DURATION, READINGS, T_MOVE, T_REST, Reading, cable, casting_arm
    from hyperflex.paper.report.part import verdicts
    from hyperflex.paper.report.reproduce import reproduce
    from hyperflex.paper.results import Claim, Table

__getattr__, __dir__, __all__ = attach(__name__, __file__)
