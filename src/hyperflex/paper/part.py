"""A part of the paper as it is reproduced: figures and tables with their numbers, claims, and text of the page."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

from hyperflex.checks import Array
from hyperflex.report import Section, TextTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Case(Protocol):
    """What a claim is measured in: a reading of the cast, or a swing."""

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


class Table(NamedTuple):
    """Columns of equal length, and notes for the head of their file: title, source, units, parameters."""

    columns: dict[str, Array]
    notes: dict[str, str]


@dataclass(frozen=True)
class Item:
    """A figure or table of the paper: its numbers, and what draws it with a caption, or its sections of the page."""

    table: Callable[[], Table]
    draw: "Callable[[], Figure] | None" = None
    caption: str = ""
    sections: Callable[[], list[Section]] = list


@dataclass(frozen=True)
class Part:
    """A part of the paper."""

    title: str
    lead: str
    message: str  # on what takes long
    items: dict[str, Item]  # by name, in the paper's order
    measures: Mapping[Callable[[Any], Claim], Iterable[Case]]  # claims, and what each is measured in
    sections: Callable[[], list[Section]]  # below the figures

    def claims(self) -> list[Claim]:
        """Measure the claims."""
        return [measure(case) for measure, cases in self.measures.items() for case in cases]


_CLAIM_COLUMNS: dict[str, Callable[[Claim], str]] = {
    "claim": lambda claim: claim.name,
    "what is measured": lambda claim: claim.statement,
    "in": lambda claim: claim.case.title,
    "value": lambda claim: f"{claim.measured:.3g}" if claim.measured < 0.1 else f"{claim.measured:.4f}",
    "threshold": lambda claim: f"{claim.relation} {claim.threshold:g}",
    "verdict": lambda claim: "holds" if claim.holds else "does not hold",
    "note": lambda claim: claim.note,
}


def claims_table(claims: Sequence[Claim], *, short: bool = False) -> TextTable:
    """Return measured values, thresholds and verdicts of the paper's claims; `short` omits statements and notes."""
    shown = [name for name in _CLAIM_COLUMNS if not short or name not in ("what is measured", "note")]
    return TextTable(tuple(shown), tuple(tuple(_CLAIM_COLUMNS[name](claim) for name in shown) for claim in claims))


def verdicts(claims: Sequence[Claim]) -> tuple[str, ...]:
    """Return a sentence for each claim on where it holds and where not."""
    sentences = []
    for name in dict.fromkeys(claim.name for claim in claims):
        holds: dict[str, bool] = {}
        for claim in claims:
            if claim.name == name:
                holds[claim.case.title] = holds.get(claim.case.title, True) and claim.holds
        broken = [title for title, kept in holds.items() if not kept]
        where = f"holds in {len(holds) - len(broken)} of {len(holds)} cases, not in these: {'; '.join(broken)}"
        sentences.append(f"{name} {where if broken else f'holds in all {len(holds)} cases'}.")
    return tuple(sentences)
