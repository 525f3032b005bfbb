"""Read recordings from files of any known format, NetCDF-4 with its attributes among them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Unpack

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, as_path, read_netcdf, regular_file
from hyperflex.recording import csv as _csv
from hyperflex.recording import matfile as _matfile
from hyperflex.recording import messages
from hyperflex.recording.declare import FASTEST, DeclarationFields, Declarations, Raw, to_recording
from hyperflex.recording.recording import VARIABLE, Kind, Recording


def read_recording(
    path: PathLike,
    *,
    kind: str | None = None,
    time: str = "t",
    columns: Sequence[str] | None = None,
    topic: str | None = None,
    plane: str | None = None,
    noise: object = None,
    max_rate: float = FASTEST,
    name: str | None = None,
    **declarations: Unpack[DeclarationFields],
) -> Recording:
    r"""Read measured angles or markers from a CSV, NetCDF, MCAP or MultiArm-pendulum ``.mat`` file, or a ROS 2 bag.

    The file or the arguments must declare units, axes, scale and frame rate. A missing declaration is an error that
    names the argument; declarations in both must agree. A CSV file declares by notes before its header (``# unit:
    deg``, with the argument names below) or by units in the header (``t [ms], th1 [deg]``).

    Parameters
    ----------
    path : path-like
        The format follows from the suffix: ``.csv`` (also ``.txt``), ``.nc``, ``.mat``, ``.mcap`` or ``.db3``; a bag
        is a folder. MCAP needs the extra ``mcap``, bags the extra ``ros``.
    kind : {"angles", "markers"}, optional
        Required only if a file contains both, or with `columns` of a CSV file.
    time : str
        Name of the time column (CSV); of messages "t", their own stamps, or "log", when they were recorded.
    columns : sequence of str, optional
        Names of the data columns in order (CSV), for other names than ``th1, ..`` or ``x0, y0, ..``; needs `kind`. Of
        joint states the names of the joints, from the motor to the tip; by default all, in the file's order.
    topic : str, optional
        Of an MCAP file or a bag that holds several.
    plane : {"xz", "xy", "yz"}, optional
        In which the rope swings, of poses in space: the axes to the right and up.
    noise : float or array_like (C,) or (T, C), optional
        Standard deviation in the unit of the data; also by CSV columns ``std_th1, ..`` or a note.
    max_rate : float, rad/s
        Angles that change faster are refused as wrong units.
    name : str, optional
        Short name for reports; by default the file's.
    **declarations
        ``time_unit``: "s", "ms", "us", "min", or "frame", which counts frames and needs ``frame_rate``, frames/s.

        ``unit``: "rad", "mrad", "deg" or "turn" of angles (rates are per second); "m", "cm", "mm" or "px" of markers;
        "px" needs ``scale``, the length of a pixel, m.

        ``y_axis``: "up" or "down", the direction of the markers' y axis (mostly down for pixels).

        ``zero``: "hanging" (default) or "up" (default of ``.mat``), where angles are 0. ``sense``: "+x" (default) or
        "-x", the side to which they grow. ``angles``: "absolute" (default), against the vertical, or "relative",
        against the link before. ``wrapped``: True for angles that jump by whole turns; they are unwrapped by the
        smaller turn from sample to sample.

    Returns
    -------
    Recording
        In SI units and radians; angles absolute, 0 hanging, positive towards +x; markers with y up.

    Raises
    ------
    FileProblem
        When the file is missing, empty, damaged or cut off.
    MissingPackage
        When the package that reads its format is not installed.
    InvalidInput
        When something is not declared, contradicts the file, or the numbers cannot be used (the place is named).

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
    file = as_path(path, "recording")
    suffix = file.suffix.lower()
    bag = suffix == ".db3" or messages.is_bag(file)
    if bag or suffix == ".mcap":
        read = messages.read_bag if bag else messages.read_mcap
        raw = read(path, messages.Selection(topic, kind, columns, plane, time))
    elif topic is not None or plane is not None:
        raise InvalidInput(f"topic and plane are for MCAP files and bags, {path} is neither", fix="Omit them")
    elif suffix in (".csv", ".txt"):
        raw = _csv.read(path, time, kind, columns)
    elif suffix in (".nc", ".mat"):
        if columns is not None or time != "t":
            raise InvalidInput(f"time and columns are for CSV files, {path} names its own", fix="Omit them")
        raw = _netcdf(path) if suffix == ".nc" else _matfile.read(path)
        if kind not in (None, raw.kind):
            raise InvalidInput(f"{path} holds {raw.kind}", got=kind, fix="Omit kind")
    else:
        regular_file(file, "recording")  # reports one that is missing
        allowed = ".csv, .txt, .nc, .mat, .mcap, .db3, the folder of a bag"
        raise InvalidInput(f"{path} has no known suffix", got=suffix, allowed=allowed)
    return to_recording(replace(raw, name=name or raw.name or file.stem), Declarations(**declarations), noise, max_rate)


AXES = ("zero", "sense", "angles", "y_axis")  # declarations that such a file has as attributes


def _netcdf(path: PathLike) -> Raw:
    """Return the columns of a file of :meth:`Recording.to_netcdf`, with what its attributes declare."""
    content = read_netcdf(path)
    attributes, found = content.attributes, content.variables
    kind: Kind = "angles" if "angle" in found else "markers"
    name = VARIABLE[kind]
    if "time" not in found or name not in found:
        raise InvalidInput(
            f"{path} holds no recording",
            got=sorted(found),
            allowed="variables time and angle (time, link) or position (time, marker, axis)",
            fix="A trajectory is opened by read_trajectory",
        )
    t, declared = found["time"].numbers("time"), {key: attributes[key] for key in AXES if key in attributes}
    columns = {}
    for key in {name, "noise", "rate"} & found.keys():
        values = found[key].numbers(key)
        if t.ndim != 1 or values.ndim != (2 if kind == "angles" else 3) or values.shape[0] != t.size:
            what = f"{path}: variable {key!r} has the wrong shape"
            raise InvalidInput(what, got=values.shape, fix="Write it again")
        columns[key] = values.reshape(t.size, -1)
    for key, variable in (("time_unit", "time"), ("unit", name)):
        if "units" in found[variable].attributes:
            declared[key] = found[variable].attributes["units"]
    expected = f"{declared.get('unit')}/s"
    if "rate" in found and "unit" in declared and (unit := found["rate"].attributes.get("units")) != expected:
        raise InvalidInput(f"{path}: the unit of the rates does not fit", got=unit, allowed=repr(expected))
    convention, own = (str(attributes.get(key, "")) for key in ("convention", "name"))
    given = columns[name], kind, columns.get("noise"), columns.get("rate"), declared
    return Raw(t, *given, convention=convention, name=own, source=str(path))
