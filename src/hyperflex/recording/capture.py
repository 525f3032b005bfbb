"""Text files of optical motion capture: OptiTrack Motive, Vicon Nexus, Qualisys and OpenSim (TRC).

Each has markers in space in a wide table below a header of its own; the header gives rate, unit and names.
"""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, Table, cells_of, filled, mark_of, read_lines
from hyperflex.recording.content import Content, content_of_markers, unused
from hyperflex.recording.declare import UNITS, frames, unit_name, unit_of

_AXES = ("x", "y", "z")
_RIGID_BODY = 11  # cells of one in a frame of Motive 1.1: number, place, quaternion, three angles
_MARKER = 5  # cells of one: place, number, name


def read_motive(path: PathLike) -> Content:
    """Return the markers, and the centres of rigid bodies, of a CSV file of OptiTrack Motive 1.2 or later."""
    lines = read_lines(path)
    meta = cells_of(lines[0])
    about = dict(zip(meta[::2], meta[1::2], strict=False))
    top = next((k for k, line in enumerate(lines) if line.startswith("Frame")), None)
    if top is None:
        raise InvalidInput(f"{path} has no row that begins with Frame", fix="Export it again, with its header")
    header = [filled(cells_of(line)) for line in lines[1:top] if line.strip(",;\t ")]
    axes = cells_of(lines[top])
    if len(header) < 3:
        raise InvalidInput(f"{path} lacks the rows Type, Name and ID", fix="Export it again, with its header")
    kinds, names, parts = (row + [""] * (len(axes) - len(row)) for row in (header[0], header[1], header[-1]))
    labels = []
    for kind, name, part, axis in zip(kinds, names, parts, axes, strict=False):
        shown = name if kind in ("Marker", "Rigid Body", "Bone") else f"{name} ({kind})"
        labels.append((shown, axis.lower() if part == "Position" else f"{part} {axis}".strip()))
    declared = {"time_unit": "s"} | unit_of(about.get("Length Units"))
    time = next((k for k, axis in enumerate(axes) if axis.startswith("Time")), 1)
    return _content(path, lines, top + 1, labels, time, declared=declared)


def read_motive_frames(path: PathLike) -> Content:
    """Return the markers of a CSV file of OptiTrack Motive 1.1: a line a frame, with those markers that it shows."""
    places: dict[str, dict[int, list[float]]] = {}
    times: list[float] = []
    for number, line in enumerate(read_lines(path), 1):
        if not line.startswith("frame,"):
            continue
        cells = cells_of(line)
        try:
            time, bodies = float(cells[2]), int(cells[3])
            at = 4 + _RIGID_BODY * bodies
            count = int(cells[at])
            for k in range(count):
                *place, identity, name = cells[at + 1 + _MARKER * k : at + 1 + _MARKER * (k + 1)]
                x, y, z = map(float, place)
                places.setdefault(name or identity, {})[len(times)] = [x, y, z]
        except (ValueError, IndexError):
            raise InvalidInput(
                f"{path}, line {number}, is no frame of Motive 1.1",
                got=line[:80],
                allowed="frame,index,time,0,count and x,y,z,id,name of each marker",
                fix="Remove the line, or export the take again",
            ) from None
        times.append(time)
    markers = {name: _spread(rows, len(times)) for name, rows in places.items()}
    return content_of_markers(np.array(times), markers, declared={"time_unit": "s"}, usual={"unit": "m"})


def _spread(rows: dict[int, list[float]], count: int) -> Any:
    """Return places (T, 3) by the frame in which they are, NaN elsewhere."""
    values = np.full((count, 3), np.nan)
    values[list(rows)] = list(rows.values())
    return values


def read_vicon(path: PathLike) -> Content:
    """Return the block Trajectories of a CSV file of Vicon Nexus."""
    lines = read_lines(path)
    blocks = {cells_of(line)[0]: k for k, line in enumerate(lines[:-3]) if _begins_block(lines[k : k + 4])}
    if "Trajectories" not in blocks:
        raise InvalidInput(
            f"{path} is a Vicon Nexus file without markers",
            got=list(blocks),
            allowed="a block Trajectories",
            fix="Export the trajectories from Nexus as ASCII; devices and model outputs contain no marker positions",
        )
    at = blocks["Trajectories"]
    if len(lines) < at + 6:
        raise InvalidInput(f"{path} has a header but no rows", fix="It was probably cut off: get it again")
    end = next((k for k in range(at + 5, len(lines)) if not lines[k].strip(",; \t")), len(lines))
    names, axes, units = (cells_of(line) for line in lines[at + 2 : at + 5])
    labels = [(name, axis.lower()) for name, axis in zip(filled(names, 2), axes, strict=False)]
    declared = frames(_rate(path, cells_of(lines[at + 1])[0]))
    return _content(path, lines[:end], at + 5, labels, 0, declared=declared, last=end == len(lines), units=units)


def _begins_block(lines: Sequence[str]) -> bool:
    """Whether four lines begin a block of Vicon Nexus: its name, a rate, names, and Frame with Sub Frame."""
    return bool(re.fullmatch(r"[A-Z][^,;\t]*[,;\t]*", lines[0])) and cells_of(lines[3])[:2] == ["Frame", "Sub Frame"]


def read_qualisys(path: PathLike) -> Content:
    """Return the markers of a TSV file of Qualisys Track Manager; those at 0, 0, 0 are gaps."""
    lines, top = read_lines(path), 0
    about: dict[str, list[str]] = {}
    while top < len(lines) and lines[top].partition("\t")[0].replace("_", "").isupper():
        key, *values = lines[top].rstrip("\t ").split("\t")
        about.setdefault(key, [value.strip() for value in values])
        top += 1
    names = about.get("MARKER_NAMES", [])
    if about.get("DATA_INCLUDED", ["3D"]) != ["3D"] or not names:
        raise InvalidInput(
            f"{path} is a Qualisys file without markers in space",
            got=about.get("DATA_INCLUDED"),
            allowed="DATA_INCLUDED 3D, with MARKER_NAMES",
            fix="Export 3D data from QTM, with the TSV header",
        )
    row = lines[top].rstrip().split("\t") if top < len(lines) else [""]
    first = len(row) - len(_AXES) * len(names)  # columns before the markers, of frames and times: 0, 1 or 2
    top += row[-1].endswith("Z")  # the names of columns, such as "tip Z", may stand above the rows
    labels = [("", "frame"), ("", "time")][2 - first :] if 0 <= first <= 2 else []
    labels += [(name, axis) for name in names for axis in _AXES]
    declared: dict[str, Any] = {"time_unit": "s"}
    if first != 2:
        declared = frames(_rate(path, *about.get("FREQUENCY", [])[:1]))
    time = first - 1 if first == 2 else -1
    return _content(path, lines, top, labels, time, declared=declared, usual={"unit": "mm"}, zero_is_gap=True)


def read_trc(path: PathLike) -> Content:
    """Return the markers of a TRC file of OpenSim, with tabs or commas."""
    lines = read_lines(path)
    if len(lines) < 6:
        raise InvalidInput(f"{path} is a TRC file without rows", fix="It was probably cut off: get it again")
    about = dict(zip(cells_of(lines[1]), cells_of(lines[2]), strict=False))
    names = filled(cells_of(lines[3].rstrip("\t, ")), 2)
    names += names[-1:] * 2  # of the last marker
    axes = [cell[:1] for cell in cells_of(lines[4])]
    labels = [(name, _AXES[(k - 2) % 3] if k >= 2 else "") for k, name in enumerate(names)]
    declared = {"time_unit": "s"} | unit_of(about.get("Units"))
    top = 5 if not lines[4].strip() or {*"XYZ"} & set(axes) else 4
    return _content(path, lines, top, labels, 1, declared=declared, ragged=len(_AXES))  # tabs at the end may be missing


def _rate(path: PathLike, text: str = "") -> float:
    """Return a rate, frames/s."""
    try:
        return float(text)
    except ValueError:
        fix = "Correct its header, or export it again"
        raise InvalidInput(f"{path} has no frame rate in its header", got=text, allowed="frames/s", fix=fix) from None


def _content(
    path: PathLike,
    lines: Sequence[str],
    top: int,
    labels: Sequence[tuple[str, str]],
    time: int,
    *,
    zero_is_gap: bool = False,
    last: bool = True,
    ragged: int = 0,
    units: Sequence[str] = (),
    **more: Any,
) -> Content:
    """Return the content of a wide table.

    Parameters
    ----------
    lines, top
        The lines of the file; the index of the first row.
    labels
        Of each column the marker and the axis; markers have x, y and z.
    time
        The column of the times; -1 where rows are counted.
    zero_is_gap
        Whether a marker at 0, 0, 0 is missing.
    last
        Whether the rows go to the end of the file, which may be cut off.
    ragged
        As of :class:`Table`.
    units
        Of each column, where they have their own; what is in no unit of length is no marker.
    """
    kept = [(k, lines[k]) for k in range(top, len(lines)) if lines[k].strip(",; \t")]
    fits = time < len(labels) > 0
    if not kept or not fits:
        what = f"{path} has a header but no rows" if fits else f"{path} has rows that do not fit its header"
        raise InvalidInput(what, allowed="a row for each frame", fix="It was probably cut off: get it again")
    numbers, rows = [k + 1 for k, _ in kept], [row for _, row in kept]
    names, points = _named(labels)
    by_name = {name: unit for name, unit in zip(names, units, strict=False) if unit}
    lengths = {name for name in names if unit_name(by_name.get(name, "m")) in UNITS["markers"]}
    points = {marker: parts for marker, parts in points.items() if lengths.issuperset(parts)}
    table = Table(str(path), names, rows, numbers, mark_of(rows[0]), cut=last and bool(lines[-1]), ragged=ragged)

    def take(chosen: Sequence[str]) -> Any:
        values = table.columns(chosen)
        if zero_is_gap:
            marker = {part: parts for parts in points.values() for part in parts}
            for k, name in enumerate(chosen):
                values[(table.columns(marker[name]) == 0.0).all(axis=1), k] = np.nan
        return values

    t = np.arange(float(len(rows))) if time < 0 else table.times(names[time])
    return Content(t, names, take, points=points, units=by_name, **more)


def _named(labels: Sequence[tuple[str, str]]) -> tuple[list[str], dict[str, tuple[str, ...]]]:
    """Return a name for each column, all different, and the markers that have x, y and z."""
    names: dict[str, None] = {}
    points: dict[str, dict[str, str]] = {}
    for k, (marker, axis) in enumerate(labels):
        plain = "_".join(filter(None, (marker, axis))) or f"column {k}"
        name = unused(plain, names)
        names[name] = None
        if marker and axis in _AXES:
            points.setdefault(f"{marker}{name[len(plain) :]}", {})[axis] = name
    whole = {marker: own for marker, own in points.items() if own.keys() == set(_AXES)}
    return list(names), {marker: tuple(own[axis] for axis in _AXES) for marker, own in whole.items()}
