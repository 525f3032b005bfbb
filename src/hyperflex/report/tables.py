"""Small tables for people: Markdown files and pages show the same ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hyperflex.errors import InvalidInput


@dataclass(frozen=True)
class TextTable:
    """A table of ready-made cells.

    Attributes
    ----------
    header : tuple of str
        Column names.
    rows : tuple of tuple of str
        Cells, as many in each row as there are columns.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.header):
                raise InvalidInput(
                    "table row has the wrong number of cells", got=row, allowed=f"{len(self.header)} cells"
                )


def markdown(table: TextTable) -> str:
    """Return a table as Markdown, columns padded so that it reads well as plain text too."""
    lines = [table.header, *table.rows]
    cells = [[cell.replace("|", r"\|") for cell in line] for line in lines]
    widths = [max(3, *(len(line[k]) for line in cells)) for k in range(len(table.header))]

    def row(line: Sequence[str]) -> str:
        return "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |"

    rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
    return "\n".join([row(cells[0]), rule, *map(row, cells[1:])]) + "\n"
