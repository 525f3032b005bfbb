"""A part of the paper as it is reproduced: what was written, what was measured, and what the page says of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hyperflex import files
from hyperflex.paper import Claim, Table
from hyperflex.report.page import Section


@dataclass(frozen=True)
class Part:
    """What became of one part of the paper.

    Attributes
    ----------
    written : list of str
        Names of files, in order.
    claims : list of Claim
        Its claims with their verdicts.
    sections : list of Section
        Of the page.
    """

    written: list[str]
    claims: list[Claim]
    sections: list[Section]


def write_picture(folder: Path, name: str, content: bytes, table: Table) -> list[str]:
    """Write a PNG and the CSV file behind it to `folder`; return their names."""
    with files.atomic(folder / f"{name}.png", "wb") as file:
        file.write(content)
    return [f"{name}.png", *write_numbers(folder, name, table)]


def write_numbers(folder: Path, name: str, table: Table) -> list[str]:
    """Write a table to a CSV file in `folder`; return its name."""
    rows = list(zip(*table.columns.values(), strict=True))
    files.write_table(folder / f"{name}.csv", list(table.columns), rows, notes=table.notes)
    return [f"{name}.csv"]
