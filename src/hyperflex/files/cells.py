"""Cells of a line of a table: what separates them, and the numbers that stand in them."""

import csv
import math
import re

GAPS = frozenset({"", "na", "nan", "n/a", "#n/a", "null", "none", "-", "--"})  # in lower case
MARKS = ("\t", ";", ",")  # what separates cells; the first of them that stands in a line; else spaces
WITH_COMMAS = ("\t", ";")  # between such marks a comma is a decimal comma

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\Z", re.ASCII)
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}\Z", re.ASCII)
_WORDS = re.compile(r"[^\s\[(]\S*(?:\s+[\[(][^\])]*[\])])?")  # a name, and a unit in brackets behind it


def mark_of(line: str) -> str:
    """Return what separates the cells of a line: a tab, a semicolon, a comma, or a space for any white space."""
    return next((mark for mark in MARKS if mark in line), " ")


def cells(line: str, mark: str) -> list[str]:
    """Return the cells of a line, without the spaces about them. ValueError where its quotes cannot be read."""
    if '"' in line:
        try:
            row = next(csv.reader([line.strip() if mark == " " else line], delimiter=mark, skipinitialspace=True))
        except csv.Error as error:
            raise ValueError(str(error)) from None
        return [cell.strip() for cell in row]
    return [cell.strip() for cell in line.split(None if mark == " " else mark)]


def names_in(line: str) -> list[str]:
    """Return the column names of a header line; between spaces a unit in brackets belongs to the name before it."""
    mark = mark_of(line)
    if mark == " " and '"' not in line:
        return _WORDS.findall(line) or line.split()
    return cells(line, mark)


def is_number(cell: str) -> bool:
    """Whether a cell looks like a number, with a decimal point or comma, or infinite."""
    return bool(_NUMBER.match(cell.replace(",", ".", 1))) or cell.lower().lstrip("+-") in ("inf", "infinity")


def number(cell: str, *, comma: bool) -> float:
    """Return the number in a cell, NaN for a gap; ValueError where there is none. `comma` lets decimal commas pass."""
    if cell.lower().lstrip("+-") in ("inf", "infinity"):
        return math.inf
    plain = cell.replace(",", ".", 1) if comma else cell
    if _NUMBER.match(plain):
        return float(plain)
    if cell.lower() in GAPS:
        return math.nan
    raise ValueError(cell)


def could_be_grouped(cell: str) -> bool:
    """Whether the comma in a cell may group thousands: 1,234 is 1.234 to some and 1234 to others."""
    return bool(_GROUPED.match(cell))
