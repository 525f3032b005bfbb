"""Rows of a long benchmark, one JSON object per line, from which an interrupted run continues.

A process that is killed while writing leaves an incomplete line. It is removed before the next row is written. Other
lines that are not rows are ignored.
"""

import hashlib
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import hyperflex
from hyperflex.core.cache import SOURCE_HASH

Row = dict[str, Any]


def sources(*packages: str) -> str:
    """A hash of the sources of packages, like ``SOURCE_HASH`` of the kernels."""
    digest = hashlib.sha256()
    for package in packages:
        folder = Path(hyperflex.__file__).parent / package
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def planner() -> str:
    """A hash of the sources of the cast planner."""
    return sources("planning")


def read(path: Path | None) -> list[Row]:
    """Rows of a file, none where there is no file."""
    if path is None or not path.exists():
        return []
    rows = []
    for line in path.read_bytes().split(b"\n"):
        try:
            row = json.loads(line)
        except ValueError:
            continue
        if isinstance(row, dict):
            rows.append(row)
    return rows


def append(path: Path, row: Row) -> None:
    """Append a row after the last complete line; a last line that lacks only its end of line is kept."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(row).encode() + b"\n"
    with path.open("ab+") as file:
        file.seek(0)
        there = file.read()
        last = there[there.rfind(b"\n") + 1 :]
        if last and _whole(last):
            text = b"\n" + text
        elif last:
            file.truncate(len(there) - len(last))
        file.write(text)


def go_on(path: Path, marks: Sequence[Any], measure: Callable[[int, Any], Row]) -> list[Row]:
    """Measure the rows that a file lacks, by number and mark; print and keep each row, and return all rows."""
    rows = read(path)
    warn_of_others(rows)
    for index in range(len(rows), len(marks)):
        rows.append(measure(index, marks[index]))
        print(json.dumps(rows[-1]), flush=True)
        append(path, rows[-1])
    return rows


def _whole(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line), dict)
    except ValueError:
        return False


def made(rows: Iterable[Row], by: str = "kernels") -> str:
    """A sentence for a page: the number of rows by kernels or planner."""
    counted = Counter(str(row.get(by, "not recorded")) for row in rows)
    return f"Rows by {by}: {', '.join(f'{name} {count}' for name, count in counted.most_common())}."


def warn_of_others(rows: Iterable[Row], planned: bool = False) -> None:
    """Warn how many reused rows were made with other kernels, or another planner, than the present ones."""
    rows = list(rows)
    for by, present in (("kernels", SOURCE_HASH), *((("planner", planner()),) if planned else ())):
        others = [row.get(by) for row in rows if row.get(by) != present]
        if others:
            names = ", ".join(sorted({str(each) for each in others}))
            sys.stderr.write(f"{len(others)} of {len(rows)} reused rows were made with other {by}: {names}\n")
