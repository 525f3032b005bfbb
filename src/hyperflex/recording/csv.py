"""Tables of angles (``t, th1, .., w1, ..``) or markers (``t, x0, y0, x1, y1, ..``), units in names or notes."""

import difflib
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, read_table
from hyperflex.recording.declare import POSITIVE, Declarations, Raw
from hyperflex.recording.recording import KINDS, Kind

_NUMBERED = {  # names of columns, by what they hold
    "angle": re.compile(r"(?:th|theta|q)_?(\d+)\Z"),
    "rate": re.compile(r"(?:w|omega|dth|dtheta|qd)_?(\d+)\Z"),
    "x": re.compile(r"x_?(\d+)\Z"),
    "y": re.compile(r"y_?(\d+)\Z"),
}
_NOISE = "std_"  # begins the name of a column with the noise of another
_WITH_UNIT = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\Z")
_TRUTH = {"true": True, "yes": True, "false": False, "no": False}
_NOTES = (*Declarations.__dataclass_fields__, "noise")
_ARGUMENTS = ("kind", "max_rate")  # only the caller can give these
FRAME = "frame"  # a column that counts frames: the time column where there is no other
_COUNTERS = (FRAME, "frames", "index")  # of rows; not needed if there are times


class _Columns(NamedTuple):
    """Names of the columns to take."""

    kind: Kind
    data: list[str]
    rates: Sequence[str] = ()
    noise: Sequence[str] = ()


def read(path: PathLike, time: str, kind: str | None, columns: Sequence[str] | None) -> Raw:
    """Return the columns of a CSV file and what its notes and header declare."""
    table = read_table(path)
    declared = _notes(path, table.notes)
    split = [match.groups() if (match := _WITH_UNIT.match(name)) else (name, None) for name in table.names]
    at, units = {name: k for k, (name, _) in enumerate(split)}, {name: unit for name, unit in split if unit is not None}
    if len(at) < len(split):
        what, fix = f"{path} has columns that differ only in their unit", "Remove one of them"
        raise InvalidInput(what, got=table.names, fix=fix)
    time = _time(path, list(at), time)
    if time == FRAME:
        declared.setdefault("time_unit", FRAME)  # as its name declares
    found = _known(path, list(at), time, kind) if columns is None else _named(path, columns, at, kind)
    if found.noise and "noise" in declared:
        raise InvalidInput(f"{path} gives its noise twice", got=[*found.noise, "# noise: .."], fix="Remove one of them")
    for key, names in (("time_unit", [time]), ("unit", found.data)):
        _declare_unit(path, declared, key, {name: units.get(name) for name in names})
    for name in found.rates:
        expected = f"{declared.get('unit', 'unit of angles')}/s"
        if units.get(name, expected) != expected:
            raise InvalidInput(f"{path}: the unit of column {name!r} does not fit", got=units[name], allowed=expected)
    data, *optional = (table.values[:, [at[name] for name in names]] for names in found[1:])
    times = table.times(table.names[at[time]])
    rates, noise = (values if values.size else None for values in optional)
    return Raw(times, data, found.kind, noise, rates, declared=declared, source=str(path))


def _time(path: PathLike, names: list[str], time: str) -> str:
    """Return the name of the time column: `time`, or where that is the default and not there, what stands for it."""
    others = [name for name in names if name.lower() in ("t", "time")] or [name for name in names if name == FRAME]
    if time not in names and (time != "t" or len(others) != 1):
        fix = "Pass time='NAME' with its time column's name"
        raise InvalidInput(f"{path} has no time column {time!r}", got=names, fix=fix)
    return time if time in names else others[0]


def _notes(path: PathLike, notes: Mapping[str, str]) -> dict[str, object]:
    """Return what the ``# key: value`` lines declare."""
    declared: dict[str, object] = {}
    for key, value in notes.items():
        what = f"{path}: the note {key!r}"
        if key in POSITIVE or key == "noise":
            numbers = [_number(what, part, POSITIVE.get(key, "")) for part in value.split(",")]
            declared[key] = numbers[0] if len(numbers) == 1 else numbers
        elif key == "wrapped":
            declared[key] = _TRUTH[checks.choice(what, value.lower(), tuple(_TRUTH))]
        elif key in _NOTES:
            declared[key] = value
        elif key != "columns" and _looks_like_declaration(key):
            raise InvalidInput(
                f"{path} has a note that looks like a declaration but is none",
                got=f"# {key}: {value}",
                allowed=", ".join(_NOTES),
                fix="Correct its name, or reword it if it is a mere comment",
            )
    return declared


def _number(what: str, text: str, unit: str) -> float:
    try:
        number = float(text.replace("_", "?"))  # 1_000 is a number to Python alone
    except ValueError:
        raise InvalidInput(f"{what} is not a number", got=text, allowed="a number such as 0.5") from None
    return checks.number(what, number, sign="positive", unit=unit)


def _looks_like_declaration(key: str) -> bool:
    """Tell misspelt or reworded declarations (``units``, ``y axis``, ``angle unit``) from comments with a colon."""
    plain = re.sub(r"[\s_-]+", "_", key)
    words = plain.split("_")
    about_units = len(words) <= 3 and not {"unit", "units"}.isdisjoint(words)
    # 0.75: one letter more, less or other in a word of five ("sence"), but not other words ("note", "source")
    return plain in _ARGUMENTS or about_units or bool(difflib.get_close_matches(plain, _NOTES, 1, 0.75))


def _named(path: PathLike, columns: Sequence[str], at: Mapping[str, int], kind: str | None) -> _Columns:
    """Return the columns that the caller names, in the caller's order."""
    if kind is None:
        raise InvalidInput("columns is given without kind", allowed="kind='angles' or kind='markers'")
    missing = [name for name in columns if name not in at]
    if missing or isinstance(columns, str) or not columns:
        raise InvalidInput(f"{path} has no such columns", got=missing or columns, allowed=", ".join(at))
    return _Columns(cast(Kind, checks.choice("kind", kind, KINDS)), list(columns))


def _known(path: PathLike, names: list[str], time: str, kind: str | None) -> _Columns:
    """Return the columns that their names tell: angles, rates, x and y of markers, ``std_`` of any of these."""
    noisy = {name.removeprefix(_NOISE): name for name in names if name.startswith(_NOISE)}
    found = {
        what: {int(match[1]): name for name in names if (match := pattern.match(name))}
        for what, pattern in _NUMBERED.items()
    }
    known = {time, *_COUNTERS, *noisy.values(), *(name for each in found.values() for name in each.values())}
    rest = [name for name in names if name not in known]
    angles, places = bool(found["angle"]), bool(found["x"] or found["y"])
    if rest or not (angles or places) or (angles and places and kind is None):
        raise InvalidInput(
            f"{path} does not say which columns to take" + (", and has others" if rest else ""),
            got=rest or names,
            allowed="th1, th2, .. (and w1, w2, ..) or x0, y0, x1, y1, .. with the time, std_.. for their noise",
            fix="Name them: columns=[..] and kind=.." if rest or not angles else "Pass kind='angles' or 'markers'",
        )
    chosen = cast(Kind, checks.choice("kind", kind or ("angles" if angles else "markers"), KINDS))
    rates: list[str] = []
    if chosen == "angles":
        data = _in_order(path, found["angle"])
        rates = _in_order(path, found["rate"], len(data)) if found["rate"] else []
    else:
        if not found["x"] or not sorted(found["x"]) == sorted(found["y"]) == list(range(len(found["x"]))):
            raise InvalidInput(f"{path} lacks coordinates of some marker", got=names, allowed="x0, y0, x1, y1, ..")
        data = [found[axis][k] for k in sorted(found["x"]) for axis in "xy"]
    noise = [noisy[name] for name in data if name in noisy]
    if noise and len(noise) < len(data):
        raise InvalidInput(f"{path} gives the noise of some columns only", got=noise, allowed="std_.. for each or none")
    return _Columns(chosen, data, rates, noise)


def _in_order(path: PathLike, numbered: dict[int, str], count: int = 0) -> list[str]:
    """Return names by ascending number, which must run without a hole from 0 or 1."""
    numbers = sorted(numbered)
    first = numbers[0] if numbers else -1
    if first not in (0, 1) or numbers != list(range(first, first + (count or len(numbers)))):
        raise InvalidInput(
            f"{path} has the wrong columns",
            got=[numbered[k] for k in numbers],
            allowed=f"{count or 'all'} links numbered without a hole from 0 or 1",
        )
    return [numbered[k] for k in numbers]


def _declare_unit(path: PathLike, declared: dict[str, object], key: str, units: dict[str, str | None]) -> None:
    """Add the unit of columns in the header to what is declared; they must agree with each other and the notes."""
    unit, *others = set(units.values())
    if others:
        raise InvalidInput(f"{path} does not give one unit to all columns", got=units, fix="Give all the same")
    if unit is None:
        return
    if declared.setdefault(key, unit) != unit:
        fix = "Mend one of them"
        raise InvalidInput(f"{path}: header and notes disagree on {key}", got=[unit, declared[key]], fix=fix)
