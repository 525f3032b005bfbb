"""A figure of the paper as files: the picture and the numbers behind it."""

from __future__ import annotations

from pathlib import Path

from hyperflex import files
from hyperflex.paper import Table


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
