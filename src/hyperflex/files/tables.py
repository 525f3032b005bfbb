"""Tables of numbers as text: a header line, then rows; comma, semicolon, tab or spaces between cells; notes."""

import csv
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import cells as _cells
from hyperflex.files.reading import read_text
from hyperflex.files.writing import PathLike, atomic

_CUT = "The file ends within this line: it was probably cut off; get it again"
_MEND = "Mend or remove the line"
_EXAMPLE = "a number such as 0.5 or 1e-3, or nothing, NA, nan or - for a gap"


class Table(NamedTuple):
    """A table as it was read.

    Attributes
    ----------
    names : list of str
        The C column names.
    values : ndarray (T, C)
        The numbers; NaN is a gap.
    lines : list of int
        The line of the file that each row stands in.
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
            raise InvalidInput(
                f"{self.path}, line {self.lines[k]}, column {name!r} {what}",
                got=float(t[k]),
                allowed="a time in each row" + ("" if np.isnan(t[k]) else f", here after {t[k - 1]:.10g}"),
                fix="Sort the rows by time and drop repeated ones" if t[k] == t[k] else "Fill it in, or remove the row",
            )
        return t


def read_table(path: PathLike) -> Table:
    """Read a table of numbers with a header line.

    Parameters
    ----------
    path : path-like
        UTF-8 text. Cells are separated by tabs, semicolons, commas or spaces; between tabs or semicolons numbers may
        have decimal commas. The first line holds the names; or a comment right above the rows does, or a note
        ``# columns: ..``. Group names above the header (of DeepLabCut, pandas, Tracker) come before the names with an
        underscore, as in hip_x. A title above it is left out. Empty cells, NA, nan, null and - are gaps.

    Returns
    -------
    Table

    Raises
    ------
    FileProblem
        When the file is missing, empty, a device, too large, binary or not UTF-8.
    InvalidInput
        When there is no header or no row, names repeat, a row has too few or too many cells, a cell is no number or
        infinite (line and column are named), a comma may be a decimal comma or group thousands, or the file ends,
        without a line feed, in a number with fewer digits than its column has: most likely it was cut off there.
    """
    text = read_text(path, "table").replace("\r\n", "\n").replace("\r", "\n")
    numbered = [(k, line) for k, line in enumerate(text.split("\n"), 1) if line.strip()]
    comments = [(k, line.strip().lstrip("#").strip()) for k, line in numbered if line.lstrip().startswith("#")]
    rows = [(k, line) for k, line in numbered if not line.lstrip().startswith("#")]
    if not rows:
        raise InvalidInput(f"{path} holds no table", allowed="a header line of column names, then rows of numbers")
    notes = {
        key.strip().lower(): value.strip()
        for _, each in comments
        for key, colon, value in [each.partition(":")]
        if colon
    }
    names, rows = _header(path, rows, comments, notes)
    if not rows:
        raise InvalidInput(f"{path} has a header but no rows", got=names, allowed="at least one row of numbers")
    mark = _cells.mark_of(rows[0][1])
    cut = not text.endswith("\n")
    split = [_split(path, number, line, mark) for number, line in rows]
    values = np.empty((len(rows), len(names)))
    for k, ((number, _), row) in enumerate(zip(rows, split, strict=True)):
        values[k] = _row(path, number, row, names, mark in _cells.WITH_COMMAS, cut and k == len(rows) - 1)
    if mark in _cells.WITH_COMMAS:
        _check_commas(path, rows, split)
    if cut:
        _check_end(path, rows[-1][0], [row[len(names) - 1] for row in split])
    return Table(names, values, [number for number, _ in rows], notes, str(path))


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


def _header(path: PathLike, rows: Lines, comments: Lines, notes: Mapping[str, str]) -> tuple[list[str], Lines]:
    """Return the column names, and the rows below them."""
    number, line = rows[0]
    if len(rows) > 1 and _is_title(line, rows[1][1]) and not _is_data(path, rows[1]):
        return _header(path, rows[1:], comments, notes)
    if _is_data(path, rows[0]):
        return _from_comment(path, rows[0], comments, notes), rows
    names = _names(path, number, line)
    groups: list[list[str]] = []
    while (names[0] == "" or len(set(names)) < len(names)) and len(rows) > 1 and not _is_data(path, rows[1]):
        groups.append(names)
        rows = rows[1:]
        names = _names(path, *rows[0])
    names = _joined(groups, names)
    rows = rows[1:]
    if len(names) > 1 and not names[-1] and all(not _split(path, *row, _cells.mark_of(row[1]))[-1] for row in rows):
        names.pop()  # a separator ends each line
    if names[0] == "" and len(names) > 1:
        names[0] = "index"  # as pandas writes it
    if "" in names:
        raise InvalidInput(f"{path}, line {number}, has a column without a name", got=names, fix="Name every column")
    said = _cells.names_in(notes["columns"]) if "columns" in notes else names
    if said != names:
        raise InvalidInput(
            f"{path}: the header and the note 'columns' disagree", got=notes["columns"], allowed=", ".join(names)
        )
    return _no_repeats(path, names), rows


def _is_title(line: str, below: str) -> bool:
    """Whether a line may stand above the header: it has one cell, or none of the marks, and that below has more."""
    first, second = ([cell for cell in each.split(_cells.mark_of(each)) if cell.strip()] for each in (line, below))
    plain = _cells.mark_of(line) == " " != _cells.mark_of(below)
    return plain or len(first) == 1 < len(second)


def _from_comment(path: PathLike, row: tuple[int, str], comments: Lines, notes: Mapping[str, str]) -> list[str]:
    """Return the names that a note ``columns`` or the comment right above the rows holds."""
    above = [text for number, text in comments if number < row[0]][-1:]
    texts = [notes["columns"]] if "columns" in notes else [text for text in above if ":" not in text]
    row_cells = _split(path, *row, _cells.mark_of(row[1]))
    for text in texts:
        names = _names(path, row[0], text)
        if len(names) == len(row_cells) and not any(map(_cells.is_number, names)):
            return _no_repeats(path, names)
    raise InvalidInput(
        f"{path} has no header",
        got=row[1].strip(),
        allowed=f"a first line with the names of {len(row_cells)} columns",
        fix="Add one, e.g. t,th1",
    )


def _joined(groups: list[list[str]], names: list[str]) -> list[str]:
    """Return names with those of their groups before them; an empty group is the one to its left."""
    scorer = bool(groups) and groups[0][0] == "scorer"  # DeepLabCut: of the network, the same for all columns
    for group in reversed(groups[1:] if scorer else groups):
        full = list(group)
        for k in range(1, len(full)):
            full[k] = full[k] or full[k - 1]
        pairs = zip(full, names, strict=False)
        names = [f"{above}_{name}" if above else name for above, name in pairs] + names[len(full) :]
    if scorer:
        names[0] = "frame"
    return names


def _names(path: PathLike, number: int, line: str) -> list[str]:
    try:
        return _cells.names_in(line)
    except ValueError as error:
        raise InvalidInput(f"{path}, line {number}, cannot be read ({error})", got=line.strip(), fix=_MEND) from None


def _split(path: PathLike, number: int, line: str, mark: str) -> list[str]:
    try:
        return _cells.cells(line, mark)
    except ValueError as error:
        raise InvalidInput(f"{path}, line {number}, cannot be read ({error})", got=line.strip(), fix=_MEND) from None


def _is_data(path: PathLike, row: tuple[int, str]) -> bool:
    """Whether a line holds a number, so that it is no header."""
    return any(map(_cells.is_number, _split(path, *row, _cells.mark_of(row[1]))))


def _no_repeats(path: PathLike, names: list[str]) -> list[str]:
    """Return `names`, or refuse them because one stands twice."""
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidInput(f"{path} has columns of the same name", got=repeated, fix="Rename or remove one of them")
    return names


def _row(path: PathLike, number: int, row: list[str], names: list[str], comma: bool, cut: bool) -> list[float]:
    """Return one row of numbers; `cut` says that it is the last line and has no line feed."""
    if len(row) == len(names) + 1 and not row[-1]:
        row = row[:-1]  # a separator ends the line
    if len(row) != len(names):
        why = _CUT if cut else _MEND
        if len(row) > len(names):
            why = "If numbers have decimal commas, separate the cells by semicolons or tabs, or write points"
        raise InvalidInput(
            f"{path}, line {number}, does not have the header's number of cells",
            got=f"{len(row)} cells: {row}",
            allowed=f"{len(names)} cells ({', '.join(names)})",
            fix=why,
        )
    if all(cell.isascii() and "_" not in cell for cell in row):  # which Python, but nobody else, reads as numbers
        try:
            numbers = list(map(float, row))
            if not any(map(math.isinf, numbers)):
                return numbers
        except ValueError:
            pass
    numbers = []
    for name, cell in zip(names, row, strict=True):
        try:
            numbers.append(_cells.number(cell, comma=comma))
        except ValueError:
            why = "Write times as numbers: seconds, or frames" if ":" in cell else ""
            why = _CUT if cut and name == names[-1] else why
            raise InvalidInput(
                f"{path}, line {number}, column {name!r}, is not a number", got=cell, allowed=_EXAMPLE, fix=why
            ) from None
        if math.isinf(numbers[-1]):
            raise InvalidInput(
                f"{path}, line {number}, column {name!r}, is infinite", got=cell, allowed="a finite number, or a gap"
            )
    return numbers


def _check_commas(path: PathLike, rows: Lines, split: list[list[str]]) -> None:
    """Refuse commas that may group thousands: beside points, or where each stands before three digits."""
    where = [(number, cell) for (number, line), row in zip(rows, split, strict=True) if "," in line for cell in row]
    with_comma = [(number, cell) for number, cell in where if "," in cell]
    if not with_comma:
        return
    points = any("." in cell for row in split for cell in row)
    if points or all(_cells.could_be_grouped(cell) for _, cell in with_comma):
        number, cell = with_comma[0]
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
    half = cells[-1] in ("-", "+") and cells[-1] not in cells[:-1]  # a sign without its number, not a gap
    *others, last = [cell.lstrip("+-") for cell in cells]
    others = [cell for cell in others if cell[:1].isdigit() or cell[:1] == "."]
    if not half and (len(others) < 3 or not (last[:1].isdigit() or last[:1] == ".")):
        return
    decimals = [len(cell.partition(".")[2]) for cell in others]
    whole = not any(decimals)
    usual = [len(cell) for cell in others] if whole else decimals
    size = len(last) if whole else len(last.partition(".")[2])
    if half or sum(one <= size for one in usual) <= len(usual) / 20:
        raise InvalidInput(
            f"{path}, line {number}, ends the file in a shorter number than its column has",
            got=cells[-1],
            fix=f"{_CUT}, or add a line feed if it is whole",
        )
