"""Tables of numbers as CSV: one header line, commas between cells, points in numbers, notes at the head."""

import csv
import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files.reading import read_text
from hyperflex.files.writing import PathLike, atomic

_CUT = "The file ends within this line: it was probably cut off; get it again"


def read_table(path: PathLike) -> tuple[list[str], Array]:
    """Read a CSV table of numbers with one header line.

    Parameters
    ----------
    path : path-like
        UTF-8 text; commas between cells, points in numbers. Lines that start with ``#`` before the header are notes
        (see :func:`read_notes`). An empty cell is a gap (NaN).

    Returns
    -------
    names : list of str
        The C column names, stripped.
    values : ndarray (T, C)
        The numbers, one row a line.

    Raises
    ------
    FileProblem
        When the file is missing, empty, binary or not UTF-8.
    InvalidInput
        When there is no header or no row, names repeat, a row has too few or too many cells, or a cell is no number
        or infinite (line and column are named), when another separator is used, or when the file ends, without a line
        feed, in a number with fewer digits than its column has: most likely it was cut off there.
    """
    text = read_text(path, "table")
    rows = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    while rows and rows[0][1].lstrip().startswith("#"):
        rows.pop(0)
    if not rows:
        raise InvalidInput(f"{path} holds no table", allowed="a header line of column names, then rows of numbers")
    names = _header(path, rows[0][1])
    if len(rows) == 1:
        raise InvalidInput(f"{path} has a header but no rows", got=names, allowed="at least one row of numbers")
    cut = not text.endswith(("\n", "\r"))
    values = np.empty((len(rows) - 1, len(names)))
    for k, (number, line) in enumerate(rows[1:]):
        values[k] = _row(path, number, _cells(line), names, cut and k == len(rows) - 2)
    if cut:
        _check_end(path, rows[-1][0], [_cells(line)[-1].strip() for _, line in rows[1:]])
    return names, values


def read_notes(path: PathLike) -> dict[str, str]:
    """Return the notes at the head of a CSV table: lines ``# key: value`` before the header, keys in lower case."""
    notes: dict[str, str] = {}
    for line in read_text(path, "table").splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            break
        key, colon, value = line.strip().lstrip("#").partition(":")
        if colon:
            notes[key.strip().lower()] = value.strip()
    return notes


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


def _header(path: PathLike, line: str) -> list[str]:
    """Return the column names, or say what is wrong with the header line."""
    names = [name.strip() for name in _cells(line)]
    for mark, word in ((";", "semicolons"), ("\t", "tabs")):
        if mark in line and (len(names) == 1 or mark == ";"):
            raise InvalidInput(
                f"{path} separates its cells by {word}",
                got=line.strip(),
                allowed="commas between cells and points in numbers",
                fix=f"Save the table as plain CSV: replace decimal commas by points, then {word} by commas",
            )
    if any(_is_number(name) for name in names):
        raise InvalidInput(
            f"{path} has no header", got=line.strip(), allowed="a first line of column names", fix="Add one, e.g. t,th1"
        )
    if "" in names:
        raise InvalidInput(f"{path} has a column without a name", got=names, fix="Name every column in the first line")
    return _no_repeats(path, names)


def _cells(line: str) -> list[str]:
    return next(csv.reader([line], skipinitialspace=True)) if '"' in line else line.split(",")


def _no_repeats(path: PathLike, names: list[str]) -> list[str]:
    """Return `names`, or refuse them because one stands twice."""
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidInput(f"{path} has columns of the same name", got=repeated, fix="Rename or remove one of them")
    return names


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _row(path: PathLike, number: int, row: list[str], names: list[str], cut: bool) -> list[float]:
    """Return one row of numbers; `cut` says that it is the last line and has no line feed."""
    if len(row) != len(names) or (cut and not row[-1].strip()):
        why = _CUT if cut else "Mend or remove the line"
        if len(row) > len(names):
            why = "If numbers are written with a decimal comma, write them with a point"
        raise InvalidInput(
            f"{path}, line {number}, does not have the header's number of cells",
            got=row,
            allowed=f"{len(names)} cells ({', '.join(names)})",
            fix=why,
        )
    try:
        numbers = [float(cell) if cell.strip() else math.nan for cell in row]
    except ValueError:
        column = next(k for k, cell in enumerate(row) if cell.strip() and not _is_number(cell))
        raise InvalidInput(
            f"{path}, line {number}, column {names[column]!r}, is not a number",
            got=row[column],
            allowed="a number with a decimal point, or nothing for a gap",
            fix=_CUT if cut and column == len(row) - 1 else "",
        ) from None
    for column, value in enumerate(numbers):
        if math.isinf(value):
            raise InvalidInput(
                f"{path}, line {number}, column {names[column]!r}, is infinite",
                got=row[column].strip(),
                allowed="a finite number, or nothing for a gap",
            )
    return numbers


def _check_end(path: PathLike, number: int, cells: list[str]) -> None:
    """Refuse the last cell of a file without a final line feed when it seems to be the first part of a number.

    Writers give a column the same decimals, or all that a number needs; either way a cell far shorter than the others
    is rare. So it is refused when at most one in 20 of the others is as short.
    """
    *others, last = [cell.lstrip("+-") for cell in cells]
    others = [cell for cell in others if cell[:1].isdigit() or cell[:1] == "."]
    if len(others) < 3 or not (last[:1].isdigit() or last[:1] == "."):
        return
    decimals = [len(cell.partition(".")[2]) for cell in others]
    whole = not any(decimals)
    usual = [len(cell) for cell in others] if whole else decimals
    size = len(last) if whole else len(last.partition(".")[2])
    if sum(one <= size for one in usual) <= len(usual) / 20:
        raise InvalidInput(
            f"{path}, line {number}, ends the file in a shorter number than its column has",
            got=cells[-1],
            fix=f"{_CUT}, or add a line feed if it is whole",
        )
