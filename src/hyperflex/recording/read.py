"""Read recordings from files of any known format."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Unpack

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, listed
from hyperflex.files import PathLike, as_path
from hyperflex.recording.content import Selection, raw_of
from hyperflex.recording.declare import FASTEST, DeclarationFields, Declarations, to_recording
from hyperflex.recording.formats import content_of, format_of
from hyperflex.recording.recording import Recording


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
    **declarations: Unpack[DeclarationFields],
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
