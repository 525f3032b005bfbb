"""Tables of numbers as text: a header line, then rows; comma, semicolon, tab or spaces between cells; notes."""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hyperflex.checks import LARGEST, Array
from hyperflex.errors import InvalidInput
from hyperflex.files.reading import read_text
from hyperflex.files.writing import PathLike, atomic

_CUT = "The file ends within this line: it was probably cut off; get it again"
_MEND = "Correct or remove the line"
_EXAMPLE = f"a number such as 0.5 or 1e-3, up to {LARGEST:g}, or nothing, NA, nan or - for a gap"
_GAPS = frozenset({"", "na", "nan", "n/a", "#n/a", "null", "none", "-", "--"})  # in lower case
_MARKS = "\t;,"  # what separates cells; the first of them that is in a line; else spaces
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}\Z", re.ASCII)
_WORDS = re.compile(r"[^\s\[(]\S*(?:\s+[\[(][^\])]*[\])])?")  # a name, and a unit in brackets behind it
_SEPARATOR = re.compile(r"sep=(.)\s*\Z")  # a first line that tells a spreadsheet what separates cells
_CLOCK = re.compile(r"(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:[.,]\d*)?)\Z", re.ASCII)
_FEW, _RARE = 3, 20  # cells that show how long numbers are; one in so many may be as short as a number that is cut off

Lines = list[tuple[int, str]]  # with their numbers in the file


@dataclass(frozen=True)
class Table:
    """A table of text, whose columns become numbers when they are used.

    Attributes
    ----------
    path : str
        The file.
    names : list of str
        The C column names.
    rows : list of str
        The T lines below the header.
    numbers : sequence of int
        The number of each of these lines in the file.
    mark : str
        What separates cells: a tab, a semicolon, a comma, or a space for any white space.
    notes : dict of str to str
        Comments of the form ``# key: value``, keys in lower case.
    cut : bool
        The file has no final line feed, so that its last number may be cut off.
    ragged : int
        Rows may lack this many cells at their end, or a multiple; those are gaps. 0: none may.
    """

    path: str
    names: list[str]
    rows: list[str]
    numbers: Sequence[int]
    mark: str = ","
    notes: Mapping[str, str] = field(default_factory=dict)
    cut: bool = False
    ragged: int = 0

    @cached_property
    def values(self) -> Array:
        """All columns (T, C); NaN is a gap."""
        return self.columns(self.names)

    def columns(self, names: Sequence[str]) -> Array:
        """Return columns (T, K); NaN is a gap. Columns that are not named may hold anything.

        InvalidInput, with line and column, for a row with too few or too many cells, a cell that is no number, infinite
        or beyond 1e100, a comma that may be a decimal comma or group thousands, and a last number that is shorter than
        its column's, in a file without a final line feed: most likely it was cut off.
        """
        at = [self.names.index(name) for name in names]
        values = self._numbers(at)
        self._check_commas(at)
        if self.cut and len(self.names) - 1 in at:
            self._check_end()
        return values

    def times(self, name: str) -> Array:
        """Return a column of times (T,); InvalidInput, with line and value, for a gap or times that do not increase."""
        t = self.moments(name) if self.has_clock(name) else self.columns([name])[:, 0]
        bad = np.isnan(t)
        bad[1:] |= t[1:] <= t[:-1]
        if bad.any():
            k = int(np.argmax(bad))
            what = "is a gap" if np.isnan(t[k]) else "repeats a time" if t[k] == t[k - 1] else "goes back in time"
            allowed = "a time in each row" + ("" if np.isnan(t[k]) else f", here after {t[k - 1]:.10g}")
            fix = "Fill it in, or remove the row" if np.isnan(t[k]) else "Sort the rows by time and drop repeated ones"
            if 2 * np.count_nonzero(np.diff(t) == 0.0) > t.size:  # not of some rows, but of the column
                fix = "Write times with more digits, or pass another column as time"
            where = f"{self.path}, line {self.numbers[k]}, column {name!r} {what}"
            raise InvalidInput(where, got=float(t[k]), allowed=allowed, fix=fix)
        return t

    def has_clock(self, name: str) -> bool:
        """Whether a column holds times of day or dates, such as 0:01:10.25 or 2026-06-02 12:09:45."""
        return ":" in self.cells(0)[self.names.index(name)]

    def moments(self, name: str) -> Array:
        """Return a column of times of day, s, or of dates, s since 1970 (UTC where they name no zone)."""
        at, t = self.names.index(name), np.empty(len(self.rows))
        for k in range(len(self.rows)):
            cell = self.cells(k)[at]
            if (moment := _moment(cell)) is None:
                raise InvalidInput(
                    f"{self.path}, line {self.numbers[k]}, column {name!r}, is not a time",
                    got=cell,
                    allowed="h:mm:ss.ff, mm:ss.ff or a date such as 2026-06-02 12:09:45.25, in each row",
                    fix="A fourth part may count frames or hundredths: write seconds, or frames",
                )
            t[k] = moment
        return t

    def cells(self, k: int) -> list[str]:
        """Return the cells of a row, as many as the header has; InvalidInput where there are others."""
        row = _cells(self.rows[k], self.mark)
        count = len(self.names)
        if len(row) > count and not any(row[count:]):
            del row[count:]  # separators end the line
        if self.ragged and len(row) < count and (count - len(row)) % self.ragged == 0:
            row += [""] * (count - len(row))
        if len(row) != count:
            last = self.cut and k == len(self.rows) - 1
            fix = "If numbers have decimal commas, separate the cells by semicolons or tabs, or write points"
            raise InvalidInput(
                f"{self.path}, line {self.numbers[k]}, does not have the header's number of cells",
                got=f"{len(row)} cells: {row}",
                allowed=f"{count} cells ({', '.join(self.names)})",
                fix=fix if len(row) > count else _CUT if last else _MEND,
            )
        return row

    def _numbers(self, at: list[int]) -> Array:
        """Return columns as they stand."""
        values = np.empty((len(self.rows), len(at)))
        for k in range(len(self.rows)):
            row = self.cells(k)
            for c, column in enumerate(at):
                number = _number(row[column])
                if number is None or abs(number) > LARGEST:
                    what = (
                        "is not a number" if number is None else "is infinite" if math.isinf(number) else "is too large"
                    )
                    last = self.cut and k == len(self.rows) - 1 and column == len(self.names) - 1
                    raise InvalidInput(
                        f"{self.path}, line {self.numbers[k]}, column {self.names[column]!r}, {what}",
                        got=row[column],
                        allowed=_EXAMPLE,
                        fix=_CUT if last else "",
                    )
                values[k, c] = number
        return values

    def _check_commas(self, at: list[int]) -> None:
        """Refuse commas that may group thousands: where there are points, or where three digits follow each comma."""
        if self.mark == "," and not any('"' in row for row in self.rows):
            return
        first, points, grouped = None, False, True
        for k in range(len(self.rows)):
            for cell in map(self.cells(k).__getitem__, at):
                points = points or "." in cell
                if "," in cell:
                    first, grouped = first or (self.numbers[k], cell), grouped and bool(_GROUPED.match(cell))
        if first is not None and (points or grouped):
            also = "; other numbers have points" if points else ""
            raise InvalidInput(
                f"{self.path}, line {first[0]}: the comma may be a decimal comma or group thousands{also}",
                got=first[1],
                allowed="one decimal mark in the whole table, and no marks between thousands",
                fix="Write numbers with decimal points, and without any other mark",
            )

    def _check_end(self) -> None:
        """Refuse the last cell of a file without a final line feed when it seems to be the first part of a number.

        Writers give a column the same decimals, or all that a number needs; either way a cell far shorter than the
        others is rare. So it is refused when at most one in 20 of the others is as short.
        """
        *others, last = (self.cells(k)[-1] for k in range(len(self.rows)))
        gap = "-" not in others
        others = [cell for cell in others if _is_number(cell)]
        decimals = any("." in cell for cell in others)
        *sizes, size = [len(cell.partition(".")[2] if decimals else cell.lstrip("+-")) for cell in (*others, last)]
        short = len(sizes) >= _FEW and _is_number(last) and size < sorted(sizes)[len(sizes) // _RARE]
        if short or (last == "-" and gap):  # a sign without its number
            what = f"{self.path}, line {self.numbers[-1]}, ends the file in a shorter number than its column has"
            raise InvalidInput(what, got=last, fix=f"{_CUT}, or add a line feed if it is whole")


def read_table(path: PathLike) -> Table:
    """Read a table of numbers with a header line.

    Parameters
    ----------
    path : path-like
        Text in UTF-8, UTF-16 or Latin-1. Cells are separated by tabs, semicolons, commas or spaces; between tabs or
        semicolons, and in quotes, numbers may have decimal commas. The first line holds the names; or a comment right
        above the rows does, or a note ``# columns: ..``. Group names above the header (of DeepLabCut, pandas, Tracker)
        come before the names with an underscore, as in hip_x. A title above it is ignored. Empty cells, NA, nan, null
        and - are gaps.

    Returns
    -------
    Table

    Raises
    ------
    FileProblem
        When the file is missing, empty, a device, too large or binary.
    InvalidInput
        When there is no header or no row, or names repeat. Faults of numbers are found when columns are used.
    """
    return table_of(path, read_lines(path))


def read_lines(path: PathLike) -> list[str]:
    """Return the lines of a text table; the last one is empty if a line feed ends the file."""
    text = read_text(path, "table", any_encoding=True)
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text.split("\n")


def table_of(path: PathLike, lines: list[str]) -> Table:
    """Return the table that lines of a file hold; arguments and errors as for :func:`read_table`."""
    rows, comments, numbers = [], [], []
    separator = next(iter(_SEPARATOR.findall(lines[0])), None)
    for k, line in enumerate(lines[1:] if separator else lines, 2 if separator else 1):
        if line.startswith("#") or (line[:1] == " " and line.lstrip(" ").startswith("#")):
            comments.append((k, line.lstrip(" #").rstrip()))
        elif line and not line.isspace():
            rows.append(line)
            numbers.append(k)
    if not rows:
        raise InvalidInput(f"{path} contains no table", allowed="a header line of column names, then rows of numbers")
    parts = [each.partition(":") for _, each in comments]
    notes = {key.strip().lower(): value.strip() for key, colon, value in parts if colon}
    try:
        names, top = _header(path, rows, numbers, comments, notes)
        if top == len(rows):
            raise InvalidInput(f"{path} has a header but no rows", got=names, allowed="at least one row of numbers")
        mark = separator or mark_of(rows[top])
        return Table(str(path), names, rows[top:], numbers[top:], mark, notes, cut=bool(lines[-1]))
    except csv.Error as error:
        raise InvalidInput(f"{path} is no table that can be read ({error})", fix="Write it again") from None


def write_table(
    path: PathLike, names: Sequence[str], values: ArrayLike, *, notes: Mapping[str, str] | None = None
) -> None:
    """Write a CSV table that :func:`read_table` gives back bit for bit, wholly or not at all.

    The numbers are (T, C), a column for each name; NaN becomes an empty cell. Notes are written as ``# key: value``
    lines before the header. InvalidInput when names and columns disagree in number, or a name repeats.
    """
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != len(names):
        raise InvalidInput("the table does not fit its names", got=table.shape, allowed=f"shape any x {len(names)}")
    no_repeats(path, list(names))
    with atomic(path) as file:
        for key, value in (notes or {}).items():
            file.write(f"# {key}: {value}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([["" if np.isnan(x) else repr(float(x)) for x in row] for row in table])


def mark_of(line: str) -> str:
    """Return what separates the cells of a line: a tab, a semicolon, a comma, or a space for any white space."""
    bare = re.sub(r'"[^"]*"', "", line) if '"' in line else line
    return next((mark for mark in _MARKS if mark in bare), " ")


def _cells(line: str, mark: str) -> list[str]:
    """Return the cells of a line, without the spaces about them."""
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=mark, skipinitialspace=True))]
    return [cell.strip() for cell in line.split(None if mark == " " else mark)]


def cells_of(line: str) -> list[str]:
    """Return the cells of a line, by the separator that it has."""
    return _cells(line, mark_of(line))


def _names(line: str) -> list[str]:
    """Return the column names of a header line; between spaces a unit in brackets belongs to the name before it."""
    mark = mark_of(line)
    return (mark == " " and '"' not in line and _WORDS.findall(line)) or _cells(line, mark)


def _is_data(line: str) -> bool:
    """Whether a line holds a number, with a decimal point or comma, so that it is no header."""
    return any(_is_number(cell) for cell in cells_of(line))


def _is_number(cell: str) -> bool:
    """Whether a cell holds a number; a gap is none."""
    number = _number(cell)
    return number is not None and not math.isnan(number)


def _number(cell: str) -> float | None:
    """Return the number in a cell, also with a decimal comma; NaN for a gap, None if there is none."""
    if cell.isascii() and "_" not in cell:  # others Python alone reads as numbers
        try:
            return float(cell.replace(",", ".", 1) if "," in cell else cell)
        except ValueError:
            pass
    return math.nan if cell.lower() in _GAPS else None


def _moment(cell: str) -> float | None:
    """Return a time of day, s, or a date, s since 1970; None if a cell holds neither."""
    if match := _CLOCK.match(cell):
        hours, minutes, seconds = match.groups()
        return 3600.0 * int(hours or 0) + 60.0 * int(minutes) + float(seconds.replace(",", "."))
    try:
        moment = datetime.fromisoformat(cell)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _header(
    path: PathLike, rows: list[str], numbers: list[int], comments: Lines, notes: Mapping[str, str]
) -> tuple[list[str], int]:
    """Return the column names, and the index of the first row below them."""
    top = 0
    while len(rows) > top + 1 and _is_title(rows[top], rows[top + 1]) and not _is_data(rows[top + 1]):
        top += 1
    if _is_data(rows[top]):
        return _from_comment(path, (numbers[top], rows[top]), comments, notes), top
    groups: list[list[str]] = []
    names, number, top = _names(rows[top]), numbers[top], top + 1
    while (names[0] == "" or len(set(names)) < len(names)) and top < len(rows) and not _is_data(rows[top]):
        groups.append(names)
        names, top = _names(rows[top]), top + 1
    names = joined_names(groups, names)
    if len(names) > 1 and not names[-1] and all(not _cells(row, mark_of(row))[-1] for row in rows[top:]):
        names.pop()  # a separator ends each line
    if names[0] == "" and len(names) > 1:
        names[0] = "index"  # as pandas writes it
    if "" in names:
        raise InvalidInput(f"{path}, line {number}, has a column without a name", got=names, fix="Name every column")
    if "columns" in notes and _names(notes["columns"]) != names:
        what = f"{path}: the header and the note 'columns' disagree"
        raise InvalidInput(what, got=notes["columns"], allowed=", ".join(names))
    return no_repeats(path, names), top


def _is_title(line: str, below: str) -> bool:
    """Whether a line may precede the header: it has one cell, or none of the marks, and the next line has more."""
    first, second = ([cell for cell in each.split(mark_of(each)) if cell.strip()] for each in (line, below))
    return mark_of(line) == " " != mark_of(below) or len(first) == 1 < len(second)


def _from_comment(path: PathLike, row: tuple[int, str], comments: Lines, notes: Mapping[str, str]) -> list[str]:
    """Return the names that a note ``columns`` or the comment right above the rows holds."""
    above = [text for number, text in comments if number < row[0]][-1:]
    texts = [notes["columns"]] if "columns" in notes else [text for text in above if ":" not in text]
    count = len(cells_of(row[1]))
    for names in map(_names, texts):
        if len(names) == count and not any(map(_is_number, names)):
            return no_repeats(path, names)
    allowed = f"a first line with the names of {count} columns"
    raise InvalidInput(f"{path} has no header", got=row[1], allowed=allowed, fix="Add one, e.g. t,th1")


def joined_names(groups: list[list[str]], names: list[str]) -> list[str]:
    """Return names with those of their groups before them; an empty group is the one to its left."""
    scorer = bool(groups) and groups[0][0] == "scorer"  # DeepLabCut: of the network, the same for all columns
    for group in reversed(groups[1:] if scorer else groups):
        full = filled(group)
        pairs = zip(full, names, strict=False)
        names = [f"{above}_{name}" if above else name for above, name in pairs] + names[len(full) :]
    return ["frame", *names[1:]] if scorer else names


def filled(names: Sequence[str], first: int = 0) -> list[str]:
    """Return names in which an empty one, after that of an index, is the one to its left."""
    full = list(names)
    for k in range(first + 1, len(full)):
        full[k] = full[k] or full[k - 1]
    return full


def no_repeats(path: PathLike, names: list[str]) -> list[str]:
    """Return `names`; refuse them if one is repeated."""
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidInput(f"{path} has columns of the same name", got=repeated, fix="Rename or remove one of them")
    return names
