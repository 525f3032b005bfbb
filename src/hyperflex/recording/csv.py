"""Tables of angles (``t, th1, .., w1, ..``) or markers (``t, x0, y0, x1, y1, ..``), units in names or notes."""

import difflib
import re
from collections.abc import Mapping, Sequence
from typing import cast

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, read_table
from hyperflex.recording.declare import METRES, OPTIONS, RADIANS, SECONDS, Declarations, Raw
from hyperflex.recording.recording import Kind

_ANGLE = re.compile(r"(?:th|theta|q)_?(\d+)\Z")
_RATE = re.compile(r"(?:w|omega|dth|dtheta|qd)_?(\d+)\Z")
_PLACE = re.compile(r"([xy])_?(\d+)\Z")
_NOISE = re.compile(r"std_(.+)\Z")
_WITH_UNIT = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\Z")
_RATE_UNIT = re.compile(r"(\w+)/s\Z")
_NUMBERS = {"frame_rate": "frames/s", "scale": "m per pixel"}
_TRUTH = {"true": True, "yes": True, "false": False, "no": False}
_WORDS = {"unit": (*RADIANS, *METRES, "px"), **OPTIONS}
_NOTES = (*Declarations.__dataclass_fields__, "noise")
_ARGUMENTS = {"kind", "max_rate"}  # only the caller can say these
FRAME = "frame"  # a column that counts frames: the time column where there is no other
_COUNTERS = {FRAME, "frames", "index"}  # of rows; beside the time they tell nothing


def read(path: PathLike, time: str, kind: str | None, columns: Sequence[str] | None) -> Raw:
    """Return the columns of a CSV file and what its notes and header declare."""
    table = read_table(path)
    declared = _notes(path, table.notes)
    plain, units = _units(table.names)
    if len(set(plain)) < len(plain):
        raise InvalidInput(
            f"{path} has columns that differ only in their unit", got=table.names, fix="Remove one of them"
        )
    at = {name: k for k, name in enumerate(plain)}
    time = _time(path, plain, time)
    if time == FRAME:
        declared.setdefault("time_unit", FRAME)  # as its name declares
    found = _named(path, columns, at, kind) if columns is not None else _known(path, plain, time, kind)
    data_kind, data, rates, noise = found
    if noise and "noise" in declared:
        raise InvalidInput(f"{path} gives its noise twice", got=[*noise, "# noise: .."], fix="Remove one of them")
    _declare_units(path, declared, units, time, data, rates)
    return Raw(
        t=table.times(table.names[at[time]]),
        data=table.values[:, [at[name] for name in data]],
        kind=data_kind,
        rates=table.values[:, [at[name] for name in rates]] if rates else None,
        noise=table.values[:, [at[name] for name in noise]] if noise else None,
        declared=declared,
        source=str(path),
        lines=table.lines,
    )


def _time(path: PathLike, names: list[str], time: str) -> str:
    """Return the name of the time column: `time`, or where that is the default and not there, what stands for it."""
    others = [name for name in names if name.lower() in ("t", "time")] or [name for name in names if name == FRAME]
    if time not in names and (time != "t" or len(others) != 1):
        raise InvalidInput(
            f"{path} has no time column {time!r}", got=names, fix="Pass time='NAME' with its time column's name"
        )
    return time if time in names else others[0]


def _notes(path: PathLike, notes: Mapping[str, str]) -> dict[str, object]:
    """Return what the ``# key: value`` lines declare."""
    declared: dict[str, object] = {}
    for key, value in notes.items():
        what = f"{path}: the note {key!r}"
        if key in _NUMBERS:
            declared[key] = checks.number(what, _number(what, value), sign="positive", unit=_NUMBERS[key])
        elif key == "noise":
            numbers = [checks.number(what, _number(what, part), sign="positive") for part in value.split(",")]
            declared[key] = numbers[0] if len(numbers) == 1 else numbers
        elif key == "wrapped":
            declared[key] = _TRUTH[checks.choice(what, value.lower(), tuple(_TRUTH))]
        elif key in _WORDS:
            declared[key] = checks.choice(what, value, _WORDS[key])
        elif key != "columns" and _looks_like_declaration(key):
            raise InvalidInput(
                f"{path} has a note that looks like a declaration but is none",
                got=f"# {key}: {value}",
                allowed=", ".join(_NOTES),
                fix="Correct its name, or reword it if it is a mere comment",
            )
    return declared


def _number(what: str, text: str) -> float:
    try:
        return float(text.replace("_", "?"))  # 1_000 is a number to Python alone
    except ValueError:
        raise InvalidInput(f"{what} is not a number", got=text, allowed="a number such as 0.5") from None


def _looks_like_declaration(key: str) -> bool:
    """Tell misspelt or reworded declarations (``units``, ``y axis``, ``angle unit``) from comments with a colon."""
    plain = re.sub(r"[\s_-]+", "_", key)
    words = plain.split("_")
    about_units = len(words) <= 3 and not {"unit", "units"}.isdisjoint(words)
    # 0.75: one letter more, less or other in a word of five ("sence"), but not other words ("note", "source")
    return plain in _ARGUMENTS or about_units or bool(difflib.get_close_matches(plain, _NOTES, 1, 0.75))


def _units(header: list[str]) -> tuple[list[str], dict[str, str]]:
    """Split ``th1 [deg]`` into name and unit."""
    plain, units = [], {}
    for name in header:
        match = _WITH_UNIT.match(name)
        plain.append(match[1] if match else name)
        if match:
            units[plain[-1]] = match[2]
    return plain, units


Found = tuple[Kind, list[str], list[str], list[str]]


def _named(path: PathLike, columns: Sequence[str], at: dict[str, int], kind: str | None) -> Found:
    """Return the columns that the caller names, in the caller's order."""
    if kind is None:
        raise InvalidInput("columns is given without kind", allowed="kind='angles' or kind='markers'")
    chosen = cast(Kind, checks.choice("kind", kind, ("angles", "markers")))
    missing = [name for name in columns if name not in at]
    if missing or isinstance(columns, str) or not columns:
        raise InvalidInput(f"{path} has no such columns", got=missing or columns, allowed=", ".join(at))
    return chosen, list(columns), [], []


def _known(path: PathLike, names: list[str], time: str, kind: str | None) -> Found:
    """Return the columns that their names tell: angles, rates, x and y of markers, ``std_`` of any of these."""
    noisy = {match[1]: name for name in names if (match := _NOISE.match(name))}
    angles = {int(match[1]): name for name in names if (match := _ANGLE.match(name))}
    rates = {int(match[1]): name for name in names if (match := _RATE.match(name))}
    places = {(int(match[2]), match[1]): name for name in names if (match := _PLACE.match(name))}
    known = {time, *_COUNTERS, *noisy.values(), *angles.values(), *rates.values(), *places.values()}
    rest = [name for name in names if name not in known]
    both = bool(angles) and bool(places)
    if rest or not (angles or places) or (both and kind is None):
        raise InvalidInput(
            f"{path} does not say which columns to take" + (", and has others" if rest else ""),
            got=rest or names,
            allowed="th1, th2, .. (and w1, w2, ..) or x0, y0, x1, y1, .. beside the time, std_.. for their noise",
            fix="Pass kind='angles' or 'markers'" if both and not rest else "Name them: columns=[..] and kind=..",
        )
    chosen = cast(Kind, checks.choice("kind", kind or ("angles" if angles else "markers"), ("angles", "markers")))
    if chosen == "angles":
        data = _in_order(path, angles)
        speed = _in_order(path, rates, len(data)) if rates else []
    else:
        joints = sorted({number for number, _ in places})
        pairs = [(number, axis) for number in joints for axis in "xy"]
        if not joints or joints != list(range(len(joints))) or set(pairs) != set(places):
            raise InvalidInput(f"{path} lacks coordinates of some marker", got=names, allowed="x0, y0, x1, y1, ..")
        data, speed = [places[pair] for pair in pairs], []
    noise = [noisy[name] for name in data if name in noisy]
    if noise and len(noise) < len(data):
        raise InvalidInput(f"{path} gives the noise of some columns only", got=noise, allowed="std_.. for each or none")
    return chosen, data, speed, noise


def _in_order(path: PathLike, numbered: dict[int, str], count: int = 0) -> list[str]:
    """Return names by ascending number, which must run without a hole from 0 or 1."""
    numbers = sorted(numbered)
    whole = bool(numbers) and numbers[0] in (0, 1) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    if not whole or (count and len(numbers) != count):
        raise InvalidInput(
            f"{path} has the wrong columns",
            got=[numbered[k] for k in numbers],
            allowed=f"{count or 'all'} links numbered without a hole from 0 or 1",
        )
    return [numbered[k] for k in numbers]


def _declare_units(
    path: PathLike, declared: dict[str, object], units: dict[str, str], time: str, data: list[str], rates: list[str]
) -> None:
    """Add the units that stand in the header to what is declared; they must agree with each other and the notes."""
    for key, names, known in (
        ("time_unit", [time], (*SECONDS, "frame")),
        ("unit", data, (*RADIANS, *METRES, "px")),
    ):
        said = {units[name] for name in names if name in units}
        if not said:
            continue
        if len(said) > 1 or any(name not in units for name in names):
            raise InvalidInput(f"{path} does not give one unit to all columns", got=units, allowed=", ".join(known))
        unit = checks.choice(f"{path}: the unit of {names[0]}", said.pop(), known)
        if declared.get(key, unit) != unit:
            raise InvalidInput(
                f"{path}: header and notes disagree on {key}", got=[unit, declared[key]], fix="Mend one of them"
            )
        declared[key] = unit
    for name in rates:
        match = _RATE_UNIT.match(units.get(name, ""))
        if name in units and (match is None or match[1] != declared.get("unit")):
            raise InvalidInput(
                f"{path}: column {name!r} is in {units[name]!r}", allowed=f"{declared.get('unit', 'unit of angles')}/s"
            )
