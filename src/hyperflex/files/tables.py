"""Tables of numbers as text: a header line, then rows; comma, semicolon, tab or spaces between cells; notes."""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import LARGEST, Array
from hyperflex.errors import InvalidInput
from hyperflex.files.reading import read_text
from hyperflex.files.writing import PathLike, atomic

_CUT = "The file ends within this line: it was probably cut off; get it again"
_MEND = "Mend or remove the line"
_EXAMPLE = f"a number such as 0.5 or 1e-3, up to {LARGEST:g}, or nothing, NA, nan or - for a gap"
_GAPS = frozenset({"", "na", "nan", "n/a", "#n/a", "null", "none", "-", "--"})  # in lower case
_MARKS = "\t;,"  # what separates cells; the first of them that is in a line; else spaces
_WITH_COMMAS = "\t;"  # between such marks a comma is a decimal comma
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}\Z", re.ASCII)
_WORDS = re.compile(r"[^\s\[(]\S*(?:\s+[\[(][^\])]*[\])])?")  # a name, and a unit in brackets behind it
_FEW, _RARE = 3, 20  # cells that show how long numbers are; one in so many may be as short as a number that is cut off


class Table(NamedTuple):
    """A table as it was read.

    Attributes
    ----------
    names : list of str
        The C column names.
    values : ndarray (T, C)
        The numbers; NaN is a gap.
    lines : list of int
        The line of the file that holds each row.
    notes : dict of str to str
        Comments of the form ``# key: value``, keys in lower case.
    path : str
        The file.
    """

    names: list[str]
    values: Array
    lines: list[int]
    notes: dict[str, str]
    path: str

    def times(self, name: str) -> Array:
        """Return a column of times (T,); InvalidInput, with line and value, for a gap or times that do not increase."""
        t = self.values[:, self.names.index(name)]
        bad = np.isnan(t)
        bad[1:] |= t[1:] <= t[:-1]
        if bad.any():
            k = int(np.argmax(bad))
            what = "is a gap" if np.isnan(t[k]) else "repeats a time" if t[k] == t[k - 1] else "goes back in time"
            allowed = "a time in each row" + ("" if np.isnan(t[k]) else f", here after {t[k - 1]:.10g}")
            fix = "Fill it in, or remove the row" if np.isnan(t[k]) else "Sort the rows by time and drop repeated ones"
            where = f"{self.path}, line {self.lines[k]}, column {name!r} {what}"
            raise InvalidInput(where, got=float(t[k]), allowed=allowed, fix=fix)
        return t


def read_table(path: PathLike) -> Table:
    """Read a table of numbers with a header line.

    Parameters
    ----------
    path : path-like
        UTF-8 text. Cells are separated by tabs, semicolons, commas or spaces; between tabs or semicolons numbers may
        have decimal commas. The first line holds the names; or a comment right above the rows does, or a note
        ``# columns: ..``. Group names above the header (of DeepLabCut, pandas, Tracker) come before the names with an
        underscore, as in hip_x. A title above it is ignored. Empty cells, NA, nan, null and - are gaps.

    Returns
    -------
    Table

    Raises
    ------
    FileProblem
        When the file is missing, empty, a device, too large, binary or not UTF-8.
    InvalidInput
        When there is no header or no row, names repeat, a row has too few or too many cells, a cell is no number,
        infinite or beyond 1e100 (line and column are named), a comma may be a decimal comma or group thousands, or the
        file ends, without a line feed, in a number with fewer digits than its column has: most likely it was cut off.
    """
    text = read_text(path, "table").replace("\r\n", "\n").replace("\r", "\n")
    numbered = [(k, line.strip(" ")) for k, line in enumerate(text.split("\n"), 1) if line.strip()]
    comments = [(k, line.lstrip("#").strip()) for k, line in numbered if line.startswith("#")]
    rows = [(k, line) for k, line in numbered if not line.startswith("#")]
    if not rows:
        raise InvalidInput(f"{path} holds no table", allowed="a header line of column names, then rows of numbers")
    parts = [each.partition(":") for _, each in comments]
    notes = {key.strip().lower(): value.strip() for key, colon, value in parts if colon}
    try:
        names, rows = _header(path, rows, comments, notes)
        if not rows:
            raise InvalidInput(f"{path} has a header but no rows", got=names, allowed="at least one row of numbers")
        mark, cut = _mark_of(rows[0][1]), not text.endswith("\n")
        split = [_cells(line, mark) for _, line in rows]
    except csv.Error as error:
        raise InvalidInput(f"{path} is no table that can be read ({error})", fix="Write it again") from None
    lines, comma = [number for number, _ in rows], mark in _WITH_COMMAS
    values = np.empty((len(rows), len(names)))
    for k, row in enumerate(split):
        last = cut and k == len(rows) - 1
        if len(row) == len(names) + 1 and not row[-1]:
            row.pop()  # a separator ends the line
        if len(row) != len(names):
            fix = "If numbers have decimal commas, separate the cells by semicolons or tabs, or write points"
            raise InvalidInput(
                f"{path}, line {lines[k]}, does not have the header's number of cells",
                got=f"{len(row)} cells: {row}",
                allowed=f"{len(names)} cells ({', '.join(names)})",
                fix=fix if len(row) > len(names) else _CUT if last else _MEND,
            )
        for c, cell in enumerate(row):
            number = _number(cell, comma)
            if number is None or abs(number) > LARGEST:
                what = "is not a number" if number is None else "is infinite" if math.isinf(number) else "is too large"
                fix = "Write times as numbers: seconds, or frames" if ":" in cell else ""
                raise InvalidInput(
                    f"{path}, line {lines[k]}, column {names[c]!r}, {what}",
                    got=cell,
                    allowed=_EXAMPLE,
                    fix=_CUT if last and c == len(names) - 1 else fix,
                )
            values[k, c] = number
    if comma:
        _check_commas(path, lines, split)
    if cut:
        _check_end(path, lines[-1], [row[-1] for row in split])
    return Table(names, values, lines, notes, str(path))


def write_table(
    path: PathLike, names: Sequence[str], values: npt.ArrayLike, *, notes: Mapping[str, str] | None = None
) -> None:
    """Write a CSV table that :func:`read_table` gives back bit for bit, wholly or not at all.

    The numbers are (T, C), a column for each name; NaN becomes an empty cell. Notes are written as ``# key: value``
    lines before the header. InvalidInput when names and columns disagree in number, or a name repeats.
    """
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != len(names):
        raise InvalidInput("the table does not fit its names", got=table.shape, allowed=f"shape any x {len(names)}")
    _no_repeats(path, list(names))
    with atomic(path) as file:
        for key, value in (notes or {}).items():
            file.write(f"# {key}: {value}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([["" if np.isnan(x) else repr(float(x)) for x in row] for row in table])


Lines = list[tuple[int, str]]  # with their numbers in the file


def _mark_of(line: str) -> str:
    """Return what separates the cells of a line: a tab, a semicolon, a comma, or a space for any white space."""
    return next((mark for mark in _MARKS if mark in line), " ")


def _cells(line: str, mark: str) -> list[str]:
    """Return the cells of a line, without the spaces about them."""
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=mark, skipinitialspace=True))]
    return [cell.strip() for cell in line.split(None if mark == " " else mark)]


def _names(line: str) -> list[str]:
    """Return the column names of a header line; between spaces a unit in brackets belongs to the name before it."""
    mark = _mark_of(line)
    return (mark == " " and '"' not in line and _WORDS.findall(line)) or _cells(line, mark)


def _is_data(line: str) -> bool:
    """Whether a line holds a number, with a decimal point or comma, so that it is no header."""
    return any(_is_number(cell, comma=True) for cell in _cells(line, _mark_of(line)))


def _is_number(cell: str, *, comma: bool = False) -> bool:
    """Whether a cell holds a number; a gap is none."""
    number = _number(cell, comma)
    return number is not None and not math.isnan(number)


def _number(cell: str, comma: bool) -> float | None:
    """Return the number in a cell, NaN for a gap, None if there is none; with `comma` also of a decimal comma."""
    if cell.isascii() and "_" not in cell:  # others Python alone reads as numbers
        try:
            return float(cell.replace(",", ".", 1) if comma else cell)
        except ValueError:
            pass
    return math.nan if cell.lower() in _GAPS else None


def _header(path: PathLike, rows: Lines, comments: Lines, notes: Mapping[str, str]) -> tuple[list[str], Lines]:
    """Return the column names, and the rows below them."""
    while len(rows) > 1 and _is_title(rows[0][1], rows[1][1]) and not _is_data(rows[1][1]):
        rows = rows[1:]
    number, line = rows[0]
    if _is_data(line):
        return _from_comment(path, rows[0], comments, notes), rows
    groups: list[list[str]] = []
    names, rows = _names(line), rows[1:]
    while (names[0] == "" or len(set(names)) < len(names)) and rows and not _is_data(rows[0][1]):
        groups.append(names)
        names, rows = _names(rows[0][1]), rows[1:]
    names = _joined(groups, names)
    if len(names) > 1 and not names[-1] and all(not _cells(row, _mark_of(row))[-1] for _, row in rows):
        names.pop()  # a separator ends each line
    if names[0] == "" and len(names) > 1:
        names[0] = "index"  # as pandas writes it
    if "" in names:
        raise InvalidInput(f"{path}, line {number}, has a column without a name", got=names, fix="Name every column")
    if "columns" in notes and _names(notes["columns"]) != names:
        what = f"{path}: the header and the note 'columns' disagree"
        raise InvalidInput(what, got=notes["columns"], allowed=", ".join(names))
    return _no_repeats(path, names), rows


def _is_title(line: str, below: str) -> bool:
    """Whether a line may stand above the header: it has one cell, or none of the marks, and that below has more."""
    first, second = ([cell for cell in each.split(_mark_of(each)) if cell.strip()] for each in (line, below))
    return _mark_of(line) == " " != _mark_of(below) or len(first) == 1 < len(second)


def _from_comment(path: PathLike, row: tuple[int, str], comments: Lines, notes: Mapping[str, str]) -> list[str]:
    """Return the names that a note ``columns`` or the comment right above the rows holds."""
    above = [text for number, text in comments if number < row[0]][-1:]
    texts = [notes["columns"]] if "columns" in notes else [text for text in above if ":" not in text]
    count = len(_cells(row[1], _mark_of(row[1])))
    for names in map(_names, texts):
        if len(names) == count and not any(map(_is_number, names)):
            return _no_repeats(path, names)
    allowed = f"a first line with the names of {count} columns"
    raise InvalidInput(f"{path} has no header", got=row[1], allowed=allowed, fix="Add one, e.g. t,th1")


def _joined(groups: list[list[str]], names: list[str]) -> list[str]:
    """Return names with those of their groups before them; an empty group is the one to its left."""
    scorer = bool(groups) and groups[0][0] == "scorer"  # DeepLabCut: of the network, the same for all columns
    for group in reversed(groups[1:] if scorer else groups):
        full = list(group)
        for k in range(1, len(full)):
            full[k] = full[k] or full[k - 1]
        pairs = zip(full, names, strict=False)
        names = [f"{above}_{name}" if above else name for above, name in pairs] + names[len(full) :]
    return ["frame", *names[1:]] if scorer else names


def _no_repeats(path: PathLike, names: list[str]) -> list[str]:
    """Return `names`; refuse them if one is repeated."""
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidInput(f"{path} has columns of the same name", got=repeated, fix="Rename or remove one of them")
    return names


def _check_commas(path: PathLike, lines: list[int], split: list[list[str]]) -> None:
    """Refuse commas that may group thousands: where there are points, or where three digits follow each comma."""
    commas = [(number, cell) for number, row in zip(lines, split, strict=True) for cell in row if "," in cell]
    points = any("." in cell for row in split for cell in row)
    if commas and (points or all(_GROUPED.match(cell) for _, cell in commas)):
        number, cell = commas[0]
        also = "; other numbers have points" if points else ""
        raise InvalidInput(
            f"{path}, line {number}: the comma may be a decimal comma or group thousands{also}",
            got=cell,
            allowed="one decimal mark in the whole table, and no marks between thousands",
            fix="Write numbers with decimal points, and without any other mark",
        )


def _check_end(path: PathLike, number: int, cells: list[str]) -> None:
    """Refuse the last cell of a file without a final line feed when it seems to be the first part of a number.

    Writers give a column the same decimals, or all that a number needs; either way a cell far shorter than the others
    is rare. So it is refused when at most one in 20 of the others is as short.
    """
    *others, last = cells
    others = [cell for cell in others if _is_number(cell)]
    decimals = any("." in cell for cell in others)
    *sizes, size = [len(cell.partition(".")[2] if decimals else cell.lstrip("+-")) for cell in (*others, last)]
    short = len(sizes) >= _FEW and _is_number(last) and size < sorted(sizes)[len(sizes) // _RARE]
    if short or (last == "-" and "-" not in cells[:-1]):  # a sign without its number, not a gap
        what = f"{path}, line {number}, ends the file in a shorter number than its column has"
        raise InvalidInput(what, got=last, fix=f"{_CUT}, or add a line feed if it is whole")
