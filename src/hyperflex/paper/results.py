"""The form of the paper's results: claims with thresholds, and tables of numbers behind its figures."""

from dataclasses import dataclass
from typing import Literal, Protocol

from hyperflex.checks import Array


class Case(Protocol):
    """What a claim is measured in: a reading of the cast, or a swing of the identification twin."""

    @property
    def title(self) -> str:
        """It in words."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper: its threshold, and the measured value."""

    name: str  # "C1" to "C8"
    statement: str
    case: Case
    measured: float
    threshold: float  # value at which the claim just holds
    note: str = ""  # what else the measurement shows
    relation: Literal[">=", "<="] = ">="  # on which side of the threshold it holds

    @property
    def holds(self) -> bool:
        """Whether the measured value lies on the right side of the threshold."""
        return self.measured >= self.threshold if self.relation == ">=" else self.measured <= self.threshold


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of equal length, and notes for the head of their file."""

    name: str  # "fig10" and the like; the stem of file names
    title: str
    columns: dict[str, Array]
    notes: dict[str, str]  # units, source and parameters
