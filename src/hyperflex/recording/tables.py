"""Tables of angles (``t, th1, .., w1, ..``) or markers (``t, x0, y0, ..``, or named ones), units in names or notes."""

import difflib
import re
from collections.abc import Mapping, Sequence

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, Table, read_table
from hyperflex.recording.content import ALONE, Content, Selection, likelihood_of, points_of
from hyperflex.recording.declare import POSITIVE, SECONDS, UNITS, Declarations, unit_name

_NUMBERED = {  # names of columns, by what they hold
    "angle": re.compile(r"(?:th|theta|q)_?(\d+)\Z"),
    "rate": re.compile(r"(?:w|omega|dth|dtheta|qd)_?(\d+)\Z"),
    "x": re.compile(r"x_?(\d+)\Z"),
    "y": re.compile(r"y_?(\d+)\Z"),
}
_NOISE = "std_"  # begins the name of a column with the noise of another
_INDEX = re.compile(r"_?\{(.*?)\}")  # as Tracker writes one: t_{1}
_TRUTH = {"true": True, "yes": True, "false": False, "no": False}
_NOTES = (*Declarations.__dataclass_fields__, "noise")
_LONG_NOTES = [each for each in _NOTES if each not in ("up", "plane")]  # like no word of a comment ("cup", "place")
_NO_ANGLES = (
    "Accelerations and rates are no angles: film the rope, or fasten an encoder or an inclinometer to each link"
)
_ARGUMENTS = ("kind", "max_rate")  # only the caller can give these
_TIME = re.compile(r"(?i)t|t_\d+|%?time|timestamp|seconds|__time")  # columns that stand for the default, t
_FRAME = re.compile(r"(?i)frame|fnum")  # columns that count frames: the time column where there is no other
_NANO = re.compile(r"(?i)(.*)n(?:ano)?(secs?)")  # ROS writes a stamp as two columns: whole seconds, and nanoseconds
_COUNTERS = re.compile(r"(?i)frames?|fnum|index")  # of rows; not needed if there are times


def read(path: PathLike, selection: Selection, *, sparse: bool = False) -> Content:
    """Return the content of a table, with what its notes and header declare.

    In a `sparse` one rows belong to different columns, and times may repeat until columns have been chosen.
    """
    table = read_table(path)
    declared = _notes(path, table.notes)
    split = [_name_and_unit(name) for name in table.names]
    names = [_INDEX.sub(r"_\1", name) for name, _ in split]
    if len(set(names)) < len(names):
        what, fix = f"{path} has columns that differ only in their unit", "Remove one of them"
        raise InvalidInput(what, got=table.names, fix=fix)
    at = dict(zip(names, table.names, strict=True))
    units = {name: unit for name, (_, unit) in zip(names, split, strict=True) if unit is not None}
    stamps = {
        match[1].rstrip("._/ ") or match[2]: (match[1] + match[2], name)
        for name in names
        if (match := _NANO.fullmatch(name)) and match[1] + match[2] in names
    }
    time, assumed = _time(path, table, at, stamps, selection)
    names = [name for name in names if name not in stamps.get(time, (time,))]
    if time in stamps or table.has_clock(at[time]) or time.lower() == "seconds":
        units.setdefault(time, "s")
    elif _FRAME.fullmatch(time):
        units.setdefault(time, "frame")  # as its name declares
    if time in units:
        unit = unit_name(units[time])
        if declared.setdefault("time_unit", unit) != unit:
            what = f"{path}: header and notes disagree on time_unit"
            raise InvalidInput(what, got=[unit, declared["time_unit"]], fix="Correct one of them")
    found = {
        what: {int(match[1]): name for name in names if (match := pattern.match(name))}
        for what, pattern in _NUMBERED.items()
    }
    noise = {name.removeprefix(_NOISE): name for name in names if name.startswith(_NOISE)}
    others = [name for name in names if not _COUNTERS.fullmatch(name) and name not in noise.values()]
    chosen = selection.columns is not None or selection.markers is not None
    points = {} if chosen else _numbered_points(path, found["x"], found["y"], names)
    numbered = bool(points)
    points = points or points_of([name for name in others if unit_name(units.get(name, "m")) in UNITS["markers"]])
    known = {*(name for each in found.values() for name in each.values())} if numbered or found["angle"] else set()
    angles = [] if chosen else _in_order(path, found["angle"])
    rates = (
        dict(zip(angles, _in_order(path, found["rate"], len(angles)), strict=True)) if angles and found["rate"] else {}
    )
    if time in stamps:
        t = table.columns([at[name] for name in stamps[time]]) @ [1.0, SECONDS["ns"]]
    else:
        t = table.columns([at[time]])[:, 0] if sparse else table.times(at[time])
    return Content(
        t=t,
        names=names,
        take=lambda chosen: table.columns([at[name] for name in chosen]),
        points=points,
        ordered=numbered or (points.keys() == {ALONE} and len(points[ALONE]) == 2),
        angles=angles,
        strangers=[name for name in others if name not in known] if known else [],
        rates=rates,
        noise=noise,
        likelihood=likelihood_of(points, names),
        units=units,
        assumed=assumed,
        sparse=sparse,
        declared=declared,
        advice=_NO_ANGLES if any("/s" in unit for unit in units.values()) else "",
    )


def _name_and_unit(name: str) -> tuple[str, str | None]:
    """Split ``angle (deg)``, or ``angle [deg]``, into its name and its unit."""
    inner = name[:-1]
    begin = 1 + max(inner.rfind(")"), inner.rfind("]"))
    opening = re.compile(r"[\[(]").search(inner, begin) if name.endswith((")", "]")) else None
    return (inner[: opening.start()].rstrip(), inner[opening.end() :].strip()) if opening else (name, None)


def _numbered_points(
    path: PathLike, x: Mapping[int, str], y: Mapping[int, str], names: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return markers x0, y0, x1, y1, .., in order along the rope; none if they are numbered in another way."""
    if not x or 0 not in x:
        return {}
    if not sorted(x) == sorted(y) == list(range(len(x))):
        raise InvalidInput(f"{path} lacks coordinates of some marker", got=list(names), allowed="x0, y0, x1, y1, ..")
    return {str(k): (x[k], y[k]) for k in sorted(x)}


def _time(
    path: PathLike, table: Table, at: Mapping[str, str], stamps: Mapping[str, tuple[str, str]], selection: Selection
) -> tuple[str, dict[str, str]]:
    """Return the name of the time column or of a stamp, and the argument for it if it had to be assumed."""
    time = next((name for name, parts in stamps.items() if selection.time in parts), selection.time)
    if time in at or time in stamps:
        return time, {}
    if time == "t":
        times, frames = ([name for name in at if pattern.fullmatch(name)] for pattern in (_TIME, _FRAME))
        found = times or list(stamps) or frames
        if len(found) == 1:
            return found[0], {}
        likely = sorted(at, key=lambda name: bool(_COUNTERS.fullmatch(name))) if selection.assume else []
        if found := [name for name in likely if _increases(table, at[name])]:
            return found[0], {"time": found[0]}
    fix = "Pass time='NAME' with its time column's name, or add a column of times"
    raise InvalidInput(f"{path} has no time column {selection.time!r}", got=list(at), fix=fix)


def _increases(table: Table, name: str) -> bool:
    try:
        return table.times(name).size > 1
    except InvalidInput:
        return False


def _notes(path: PathLike, notes: Mapping[str, str]) -> dict[str, object]:
    """Return what the ``# key: value`` lines declare."""
    declared: dict[str, object] = {}
    for key, value in notes.items():
        what = f"{path}: the note {key!r}"
        if key in POSITIVE or key in ("noise", "min_likelihood"):
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
    return plain in _ARGUMENTS or about_units or bool(difflib.get_close_matches(plain, _LONG_NOTES, 1, 0.75))


def _in_order(path: PathLike, numbered: dict[int, str], count: int = 0) -> list[str]:
    """Return names by ascending number, which must run without a hole from 0 or 1; none if there are none."""
    numbers = sorted(numbered)
    first = numbers[0] if numbers else 0
    if first not in (0, 1) or numbers != list(range(first, first + (count or len(numbers)))):
        raise InvalidInput(
            f"{path} has the wrong columns",
            got=[numbered[k] for k in numbers],
            allowed=f"{count or 'all'} links numbered without a hole from 0 or 1",
        )
    return [numbered[k] for k in numbers]
