"""What a file of a recording holds, and the arguments that read it: those that it declares, and assumptions."""

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, as_path
from hyperflex.recording.content import Content, Selection, raw_of
from hyperflex.recording.declare import (
    FASTEST,
    RADIANS,
    SECONDS,
    Declarations,
    Raw,
    missing_declarations,
    to_recording,
    unit_name,
)
from hyperflex.recording.formats import content_of, format_of
from hyperflex.recording.recording import Recording

_ASSUMED = {"frame_rate": 30.0, "scale": 0.001}  # frames/s; m per pixel: of nothing in the file, to be replaced
_LIKELY = re.compile(r"(?i)\bang\b|angle|position|theta|phi\b")  # in the name of a column of angles
_FAST = 0.75  # of a turn, from sample to sample: a jump by a whole turn


@dataclass(frozen=True)
class Proposal:
    """How a file can be read.

    Attributes
    ----------
    format : str
        The name of its format.
    content : Content
        What it holds.
    arguments : dict
        Arguments of :func:`hyperflex.read_recording`.
    assumed : tuple of str
        Those of them that nothing in the file declares: the user must check these.
    unused : tuple of str
        Markers or channels that are not read.
    recording : Recording, optional
        What these arguments give; None if they give an error.
    problem : str
        That error, or what is undecided.
    """

    format: str
    content: Content
    arguments: Mapping[str, Any]
    assumed: tuple[str, ...]
    unused: tuple[str, ...]
    recording: Recording | None
    problem: str = ""


def propose(path: PathLike) -> Proposal:
    """Return what a file holds and how it can be read.

    Raises
    ------
    FileProblem
        The file cannot be read.
    InvalidInput
        It is of no known format, or holds no times, angles or markers; the message says what to do.
    """
    kind = format_of(path)
    content = content_of(path, kind, Selection(assume=True))
    chosen, assumed = _choice(content)
    chosen, assumed = {**content.assumed, **chosen}, (*content.assumed, *assumed)
    try:
        raw = raw_of(content, Selection(**chosen))
    except InvalidInput as error:
        return Proposal(kind.name, content, chosen, assumed, (), None, str(error))
    declared = {**raw.usual, **raw.declared}
    arguments: dict[str, Any] = {}
    recording, problem = None, ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numpy on columns without a number; what is warned of is also in the result
        while missing := missing_declarations(raw, declared | arguments):
            arguments |= {key: _assumption(key, raw, declared | arguments) for key in list(missing)[:1]}
        assumed += tuple(arguments)
        if raw.kind == "angles" and _jumps(raw, str({**declared, **arguments}["unit"])):
            arguments, assumed = arguments | {"wrapped": True}, (*assumed, "wrapped")
        try:
            named = replace(raw, name=raw.name or as_path(path, "recording").stem)
            recording = to_recording(named, Declarations(**arguments), None, FASTEST)
        except InvalidInput as error:
            problem = str(error)
        if recording is not None and arguments.get("unit") == "rad" and (size := _range(raw)) > math.tau:
            problem = (
                f"the unit may be deg: the angles range over {size:.3g}, which is {size / math.tau:.2g} turns in rad"
            )
    return Proposal(kind.name, content, chosen | arguments, assumed, _unused(content, raw), recording, problem)


def _choice(content: Content) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return which channels to take, as arguments, and which of these arguments are assumed."""
    if content.angles:
        return ({"columns": list(content.angles), "kind": "angles"} if content.strangers else {}), ()
    if content.points and not content.ordered:
        return {"markers": _group(list(content.points))}, ("markers",)
    angular = [name for name in content.names if unit_name(content.units.get(name, "")) in RADIANS]
    if not content.points and angular:
        return {"columns": angular}, ("columns",) if len(angular) > 1 else ()
    likely = [name for name in content.names if _LIKELY.search(name)]
    if likely and not content.points:
        return {"columns": likely, "kind": "angles"}, ("columns", "kind")
    return {}, ()


def _group(names: list[str]) -> list[str]:
    """Return the markers of the body, subject or animal with most of them, as names such as rope:tip or cat_tail tell.

    All of them where names tell no such groups.
    """
    mark = ":" if any(":" in name for name in names) else "_" if all("_" in name for name in names) else None
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name.partition(mark)[0] if mark else "", []).append(name)
    largest = max(groups.values(), key=len)
    return largest if len(largest) > 1 else names


def _unused(content: Content, raw: Raw) -> tuple[str, ...]:
    """Return markers that are not read; of angles all channels that are not, but for rates, noise and likelihood."""
    if raw.kind == "markers":
        return tuple(name for name, parts in content.points.items() if not {*parts} & {*raw.columns})
    beside = {name for each in (content.rates, content.noise, content.likelihood) for name in each.values()}
    return tuple(name for name in content.names if name not in beside and name not in raw.columns)


def _range(raw: Raw) -> float:
    """Return by how much the angle moves that moves most, in their unit."""
    return float(np.nanmax(np.nanmax(raw.data, axis=0) - np.nanmin(raw.data, axis=0), initial=0.0))


def _assumption(key: str, raw: Raw, declared: Mapping[str, Any]) -> Any:
    """Return a likely value of a declaration."""
    if key in _ASSUMED:
        return _ASSUMED[key]
    if key == "time_unit":
        step = float(np.median(np.diff(raw.t))) if raw.t.size > 1 else 1.0
        return next((unit for unit, size in SECONDS.items() if 1e-4 < step * size < 0.2), "s")  # 5 Hz to 10 kHz
    if key == "unit":
        if raw.kind == "angles":
            fastest = np.nanmax(np.abs(np.diff(raw.data, axis=0)), initial=0.0)
            return "deg" if _range(raw) > math.tau and fastest > math.pi else "rad"  # half a turn between samples
        size = float(np.nanmax(np.abs(raw.data), initial=0.0))
        return "m" if size < 20.0 else "mm" if raw.in_space else "px"
    if key == "y_axis":
        return "down" if declared.get("unit") == "px" else "up"
    if key == "plane":
        spread = np.nanmean(np.nanstd(raw.data.reshape(raw.t.size, -1, 3), axis=0), axis=0)
        right, up = (axis for k, axis in enumerate("xyz") if k != int(np.argmin(spread)))
        return f"{right}{up}" if declared.get("up") in (None, up) else f"{up}{right}"
    return "z"


def _jumps(raw: Raw, unit: str) -> bool:
    """Whether angles jump by whole turns, or begin beyond one."""
    turns = raw.data * RADIANS[unit] / math.tau
    steps = np.abs(np.diff(turns, axis=0))
    return bool((steps > _FAST).any() or (np.abs(turns[:1]) > _FAST).any())


def python_line(path: PathLike, proposal: Proposal) -> str:
    """Return the line of Python that reads the file."""
    arguments = "".join(f", {key}={value!r}" for key, value in proposal.arguments.items())
    return f"hf.read_recording({str(path)!r}{arguments})"
