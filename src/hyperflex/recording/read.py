"""Read recordings from files of any known format; and what a file holds, with the arguments that read it."""

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, listed
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


def read_recording(
    path: PathLike,
    *,
    kind: str | None = None,
    time: str = "t",
    columns: Sequence[str] | None = None,
    markers: Sequence[str] | None = None,
    topic: str | None = None,
    noise: object = None,
    max_rate: float = FASTEST,
    name: str | None = None,
    **declarations: Any,
) -> Recording:
    r"""Read measured angles or markers from the file of a motion tracker, a logger or a program.

    The file or the arguments must declare units, axes, scale and frame rate. A missing declaration is an error that
    names the argument; declarations in both must agree. A CSV file declares by notes before its header (``# unit:
    deg``, with the argument names below) or by units in the header (``t [ms], th1 [deg]``); ``hyperflex look FILE``
    shows what a file contains and declares, and how to read it.

    Parameters
    ----------
    path : path-like
        The format is recognised by the content: tables (CSV), NetCDF, MATLAB, HDF5, MCAP (extra ``mcap``), ROS 2 bags
        (a folder; extra ``ros``), C3D (extra ``c3d``), and the files of OptiTrack Motive, Vicon Nexus, Qualisys,
        OpenSim, Kinovea, Tracker, DeepLabCut, SLEAP, Anipose, idtracker.ai, AnimalTA and PlotJuggler.
    kind : {"angles", "markers"}, optional
        Required only if a file contains both, or with `columns` without a unit.
    time : str
        Name of the time column of a table, or path of the times in a MATLAB or HDF5 file; of messages "t", their own
        stamps, or "log", when they were recorded.
    columns : sequence of str, optional
        Names of the data columns, or paths of the datasets, in order, for other names than ``th1, ..`` or ``x0, y0,
        ..``. Other columns may contain anything. For joint states: names of the joints, from the motor to the tip; by
        default all, in the file's order.
    markers : sequence of str, optional
        Names of markers in the file, from the pivot to the tip. Required for files with several named markers.
    topic : str, optional
        Topic of an MCAP file or a bag that contains several.
    noise : float or array_like (C,) or (T, C), optional
        Standard deviation in the unit of the data; also by CSV columns ``std_th1, ..`` or a note.
    max_rate : float, rad/s
        Angles that change faster are refused as wrong units.
    name : str, optional
        Short name for reports; by default the file's.
    **declarations
        ``time_unit``: "s", "ms", "us", "ns", "min", or "frame", which counts frames and needs ``frame_rate``, frames/s.

        ``unit``: "rad", "mrad", "deg" or "turn" of angles (rates are per second); "m", "cm", "mm" or "px" of markers;
        "px" needs ``scale``, the length of a pixel, m.

        ``y_axis``: "up" or "down", the direction of the markers' y axis (mostly down for pixels).

        ``zero``: "hanging" (default) or "up" (default of ``.mat``), where angles are 0. ``sense``: "+x" (default) or
        "-x", the side to which they grow. ``angles``: "absolute" (default), against the vertical, or "relative",
        against the link before. ``wrapped``: True for angles that jump by whole turns; they are unwrapped by the
        smaller turn from sample to sample, and begin within half a turn of 0.

        ``plane``: in which the rope swings, of markers in space: the axes to the right and up, such as "xz"; or "fit",
        the plane in which the markers move, with ``up``, the axis that points up ("x", "y" or "z"). The motion out of
        it is ``recording.out_of_plane``.

        ``min_likelihood``: markers of a smaller likelihood are gaps; 0.6 for DeepLabCut, else no limit by default.

    Returns
    -------
    Recording
        In SI units and radians; angles absolute, 0 hanging, positive towards +x; markers with y up. Stamps since 1970
        become times from the first one, which is ``recording.epoch``.

    Raises
    ------
    FileProblem
        When the file is missing, empty, damaged or cut off.
    MissingPackage
        When the package that reads its format is not installed.
    InvalidInput
        When a declaration is missing or contradicts the file, or a number cannot be used (the message names its place).

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "swing.csv"
    >>> _ = path.write_text("t,th1\n0,30\n10,29.9\n20,29.6\n")
    >>> recording = read_recording(path, time_unit="ms", unit="deg")
    >>> recording.t.tolist(), recording.data[:, 0].round(4).tolist()
    ([0.0, 0.01, 0.02], [0.5236, 0.5219, 0.5166])
    """
    checks.keys("a recording", declarations, Declarations.__dataclass_fields__)
    selection = Selection(kind, time, columns, markers, topic)
    content = content_of(path, format_of(path), selection)
    raw = raw_of(content, selection)
    raw = replace(raw, name=name or raw.name or as_path(path, "recording").stem)
    return to_recording(raw, Declarations(**declarations), noise, max_rate)


def read_channels(
    path: PathLike, names: Sequence[str], *, time: str = "t", topic: str | None = None, sense: str | None = None
) -> Array:
    """Read further columns of a recording's file, such as a motor's torque, at the samples of the recording.

    Parameters
    ----------
    path, time, topic
        As of :func:`read_recording`.
    names : sequence of str
        Of the columns.
    sense : {"+x", "-x"}, optional
        Side to which the file's angles grow, by default as the file declares: a torque of an angle that grows to the
        other side changes its sign.

    Returns
    -------
    (T, K) float64
        In the file's unit, NaN in gaps.

    Raises
    ------
    FileProblem, InvalidInput
        As of :func:`read_recording`; also for a file whose rows belong to several topics.
    """
    content = content_of(path, format_of(path), Selection(None, time, names, None, topic))
    missing = [name for name in names if name not in content.names]
    if missing:
        allowed = listed(content.names) or "none"
        raise InvalidInput(f"{content.source} has no such columns", got=missing, allowed=allowed)
    if content.sparse:
        fix = "Export it with all columns at the same times"
        raise InvalidInput(f"{content.source} has columns at different times", got=list(names), fix=fix)
    declared = sense or content.declared.get("sense") or content.usual.get("sense")
    return content.take(names) * (-1.0 if declared == "-x" else 1.0)


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
