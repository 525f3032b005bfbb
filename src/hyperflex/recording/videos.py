"""Files of programs that mark points in videos: Kinovea's trajectories (text and .kva), Tracker's .trk."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element, ParseError, fromstring

import numpy as np

from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.files import PathLike, read_bytes, read_lines
from hyperflex.recording.content import Content, content_of_markers, unused
from hyperflex.recording.declare import unit_of

_TIMECODE = re.compile(r"(\d+):(\d\d):(\d\d):(\d\d\d?)", re.ASCII)  # h:mm:ss and hundredths or thousandths of a second
_STEP = re.compile(r"\[(\d{1,7})\]", re.ASCII)  # the name of an element of an array
_FRAMES = 10_000_000  # most frames of a video, 46 hours at 60 frames/s
_TRACKER = "org.opensourcephysics.cabrillo.tracker."
Track = dict[float, tuple[float, float]]  # places by time


def read_kinovea(path: PathLike) -> Content:
    """Return the trajectories of a text file of Kinovea, which are below each other.

    A name that returns continues its trajectory. Trajectories without a name are numbered.
    """
    tracks: dict[str, Track] = {}
    name, coarse = "", False
    for number, line in enumerate(read_lines(path), 1):
        cells = line.split()
        if line.startswith("#"):
            title = line[1:].strip()
            name = title if title and title != "T X Y" and not title.startswith("Kinovea ") else name
        elif not cells:
            name = ""  # the next rows without a name begin another trajectory
        else:
            name = name or str(len(tracks) + 1)
            coarse = coarse or bool(_TIMECODE.fullmatch(cells[0]))
            _add(tracks, name, *_row(path, number, cells), f"{path}, line {number}")
    declared = {"time_unit": "s"} if coarse else {}
    return _content(path, tracks, declared=declared, remarks=("times to 1/100 s as written",) if coarse else ())


def _row(path: PathLike, number: int, cells: Sequence[str]) -> tuple[float, float, float]:
    """Return the time and the place of a row."""
    try:
        first, x, y = cells
        if match := _TIMECODE.fullmatch(first):
            hours, minutes, seconds = map(int, match.groups()[:3])
            time = 3600 * hours + 60 * minutes + float(f"{seconds}.{match[4]}")
        else:
            time = float(first.replace(",", "."))
        place = float(x.replace(",", ".")), float(y.replace(",", "."))
    except ValueError:
        raise InvalidInput(
            f"{path}, line {number}, is no row of a Kinovea trajectory",
            got=" ".join(cells),
            allowed="a time, x and y",
            fix="Correct or remove the line, or export the trajectories again",
        ) from None
    return time, *place


def read_kva(path: PathLike) -> Content:
    """Return the trajectories of an annotation file of Kinovea, in the unit of its calibration, y up."""
    root = _xml(path, "Kinovea file")
    per_frame = _float(path, root.findtext("AverageTimeStampsPerFrame"), "AverageTimeStampsPerFrame")
    tracks: dict[str, Track] = {}
    units: dict[str, str] = {}  # each track has its own: some may not be calibrated
    for track in root.iter("Track"):
        points = track.find("TrackPointList")
        label = track.find("MainLabel")
        title = track.get("name") or (label.get("Text") if label is not None else None) or f"{len(tracks) + 1}"
        name = unused(title.strip(), tracks)
        if points is None:
            continue
        if unit := points.get("UserUnitLength"):
            units |= {f"{name}_{axis}": unit for axis in "xy"}
        tracks[name] = {}
        for point in points.iter("TrackPoint"):
            stamp = (point.text or "").split(";")[-1]
            x, y = (
                _float(path, point.get(f"User{axis}Invariant", point.get(f"User{axis}")), f"User{axis}")
                for axis in "XY"
            )
            _add(tracks, name, _float(path, stamp, "TrackPoint") / per_frame, x, y, str(path))
    declared: dict[str, Any] = {"time_unit": "frame"}
    if rate := root.findtext("CaptureFramerate"):
        declared["frame_rate"] = _float(path, rate, "CaptureFramerate")
    return _content(path, tracks, declared=declared, units=units, usual={"y_axis": "up"})


def _add(tracks: dict[str, Track], name: str, time: float, x: float, y: float, where: str) -> None:
    track = tracks.setdefault(name, {})
    if time in track:
        what = f"{where}: trajectory {name!r} has two places at one time"
        raise InvalidInput(what, got=time, fix="Give trajectories different names, or remove one of the places")
    track[time] = x, y


def _content(path: PathLike, tracks: Mapping[str, Track], **more: Any) -> Content:
    """Return the content of a file of trajectories, NaN at times at which one has no place."""
    if not any(tracks.values()):
        raise InvalidInput(f"{path} has no trajectories", fix="Track a point of the video, and export again")
    times = sorted({time for track in tracks.values() for time in track})
    at = {time: k for k, time in enumerate(times)}
    markers = {}
    for name, track in tracks.items():
        values = np.full((len(times), 2), np.nan)
        values[[at[time] for time in track]] = list(track.values())
        markers[name] = values
    return content_of_markers(np.array(times), markers, **more)


def read_trk(path: PathLike) -> Content:
    """Return the point masses of a .trk file of Tracker in the coordinates of its axes and calibration.

    The file holds places in the image, px; origin, angle and scale of the axes may differ from frame to frame. Times
    are counted from the first step of the clip.
    """
    panel = _xml(path, "Tracker file")
    clip, control, axes = (_object(panel, name) for name in ("videoclip", "clipcontrol", "coords"))
    if clip is None or control is None or axes is None:
        raise InvalidInput(f"{path} has no clip or no coordinate system", fix="Save it again in Tracker")
    begin, size = (_number(path, clip, name, default) for name, default in (("startframe", 0.0), ("stepsize", 1.0)))
    count, step = _number(path, clip, "stepcount", math.inf), _number(path, control, "delta_t", math.nan)
    if not (step > 0.0 and size >= 1.0):
        raise InvalidInput(f"{path} has no duration of a frame", got=[step, size], fix="Save it again in Tracker")
    frames = {k: _axes(path, each) for k, each in _elements(axes)}
    if not frames or min(min(scale) for _, _, scale in frames.values()) <= 0.0:
        raise InvalidInput(f"{path} has no calibration", fix="Save it again in Tracker, with axes and a calibration")
    tracks: dict[str, Track] = {}
    for track in panel.iter("object"):
        if track.get("class") != f"{_TRACKER}PointMass":
            continue
        name = unused(_text(track, "name") or f"mass {len(tracks) + 1}", tracks)
        places = {}
        for k, point in _elements(track):
            if k >= begin and (k - begin) % size == 0.0 and (k - begin) / size < count:
                origin, turn, scale = frames.get(k, frames[min(frames)])
                u, v = (_number(path, point, axis, math.nan) - at for axis, at in zip("xy", origin, strict=True))
                u, v = u / scale[0], v / scale[1]
                place = math.cos(turn) * u - math.sin(turn) * v, -math.sin(turn) * u - math.cos(turn) * v
                places[1e-3 * step * (k - begin)] = place
        tracks[name] = places
    calibrated = any(scale != (1.0, 1.0) for _, _, scale in frames.values())
    declared = {"time_unit": "s"} | unit_of(_text(panel, "length_unit") if calibrated else "px")
    return _content(path, tracks, declared=declared, usual={"y_axis": "up"})


def _axes(path: PathLike, frame: Element) -> tuple[tuple[float, float], float, tuple[float, float]]:
    """Return the origin (px), the angle (rad) and the scales (px per unit) of the axes in a frame."""
    x, y, angle, across, up = (
        _number(path, frame, name, math.nan) for name in ("xorigin", "yorigin", "angle", "xscale", "yscale")
    )
    return (x, y), math.radians(angle), (across, up)


def _property(element: Element, name: str) -> Element | None:
    return next((each for each in element.findall("property") if each.get("name") == name), None)


def _object(element: Element, name: str) -> Element | None:
    held = _property(element, name)
    return None if held is None else held.find("object")


def _text(element: Element, name: str) -> str:
    held = _property(element, name)
    return "" if held is None or held.text is None else held.text.strip()


def _number(path: PathLike, element: Element, name: str, default: float) -> float:
    text = _text(element, name)
    return _float(path, text, name) if text else default


def _elements(element: Element) -> Iterator[tuple[int, Element]]:
    """Yield number and object of each element of the array framedata."""
    held = _property(element, "framedata")
    for each in [] if held is None else held.findall("property"):
        match, content = _STEP.fullmatch(each.get("name", "")), each.find("object")
        if match and content is not None and int(match[1]) < _FRAMES:
            yield int(match[1]), content


def _float(path: PathLike, text: str | None, name: str) -> float:
    """Return a finite number of a file."""
    try:
        number = float((text or "").replace("_", "?"))
        if math.isfinite(number):
            return number
    except ValueError:
        pass
    raise InvalidInput(f"{path}: {name} is no number", got=text, allowed="a finite number", fix="Save the file again")


def _xml(path: PathLike, what: str) -> Element:
    """Return the root of an XML file. Entities, which may expand without end, are refused."""
    content = read_bytes(path, what)
    try:
        if b"<!ENTITY" in content:
            raise ValueError("it declares entities")
        return fromstring(content)
    except (ParseError, LookupError, ValueError) as error:
        raise FileProblem(f"The {what} {path} cannot be read: it is damaged or cut off. Get it again.") from error
