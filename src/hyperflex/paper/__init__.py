"""The source paper: set-ups, tables behind its figures, claims. For `hyperflex reproduce` and the demo."""

from hyperflex.paper.casting import DURATION, READINGS, T_MOVE, T_REST, Reading, cable, casting_arm
from hyperflex.paper.results import Claim, Table

__all__ = ["DURATION", "READINGS", "T_MOVE", "T_REST", "Claim", "Reading", "Table", "cable", "casting_arm"]
