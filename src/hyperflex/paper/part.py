"""A part of the paper as it is reproduced: figures and tables with their numbers, claims, and text of the page."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from hyperflex.checks import Array
from hyperflex.report import Figure, Section, TextTable


class Case(Protocol):
    """The subject of a claim: a reading of the cast, or a swing."""

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


class Table:
    """Columns of equal length, and notes for the head of their file: title, source, units, parameters and others."""

    def __init__(self, columns: dict[str, Array], source: str = "simulated", **notes: str) -> None:
        self.columns, self.notes = columns, {"source": source, **notes}


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


def claims_table(claims: Sequence[Claim], *, short: bool = False) -> TextTable:
    """Return measured values, thresholds and verdicts of the paper's claims; `short` omits statements and notes."""
    rows = []
    for each in claims:
        value = f"{each.measured:.3g}" if each.measured < 0.1 else f"{each.measured:.4f}"
        verdict = "holds" if each.holds else "does not hold"
        row = (each.name, each.case.title, value, f"{each.relation} {each.threshold:g}", verdict)
        rows.append(row if short else (*row, each.statement, each.note))
    header = ("claim", "in", "value", "threshold", "verdict")
    return TextTable(header if short else (*header, "what is measured", "note"), tuple(rows))


def verdicts(claims: Sequence[Claim]) -> tuple[str, ...]:
    """Return a sentence for each claim on where it holds and where not."""
    sentences = []
    for name in dict.fromkeys(claim.name for claim in claims):
        cases = dict.fromkeys(each.case.title for each in claims if each.name == name)
        broken = dict.fromkeys(each.case.title for each in claims if each.name == name and not each.holds)
        where = f"{len(cases) - len(broken)} of {len(cases)} cases, not in these: {'; '.join(broken)}"
        sentences.append(f"{name} holds in {where if broken else f'all {len(cases)} cases'}.")
    return tuple(sentences)
