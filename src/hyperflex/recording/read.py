"""Read recordings from files of any known format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, as_path
from hyperflex.recording import csv as _csv
from hyperflex.recording import matfile as _matfile
from hyperflex.recording import netcdf as _netcdf
from hyperflex.recording.declare import FASTEST, to_recording
from hyperflex.recording.recording import Recording


def read_recording(
    path: PathLike,
    *,
    kind: str | None = None,
    time: str = "t",
    time_unit: str | None = None,
    unit: str | None = None,
    frame_rate: float | None = None,
    y_axis: str | None = None,
    scale: float | None = None,
    zero: str | None = None,
    sense: str | None = None,
    angles: str | None = None,
    wrapped: bool | None = None,
    columns: Sequence[str] | None = None,
    noise: object = None,
    max_rate: float = FASTEST,
    name: str | None = None,
) -> Recording:
    r"""Read measured angles or markers from a CSV, NetCDF or MultiArm-pendulum ``.mat`` file.

    Units, axes, scale and frame rate are what the file or the arguments declare. What neither declares is refused
    with the name of the argument; what both declare must agree. A CSV file declares by notes before its header
    (``# unit: deg``, with the argument names below) or by units in the header (``t [ms], th1 [deg]``).

    Parameters
    ----------
    path : path-like
        The format follows from the suffix: ``.csv`` (also ``.txt``), ``.nc`` or ``.mat``.
    kind : {"angles", "markers"}, optional
        Needed only where a CSV file holds both, or with `columns`.
    time : str
        Name of the time column (CSV).
    time_unit : {"s", "ms", "us", "min", "frame"}
        Unit of the times; ``"frame"`` counts frames and needs `frame_rate`.
    unit : str
        ``rad``, ``mrad``, ``deg`` or ``turn`` for angles (rates are per second); ``m``, ``cm``, ``mm`` or ``px`` for
        markers; ``px`` needs `scale`.
    frame_rate : float, frames/s
        For times that count frames.
    y_axis : {"up", "down"}
        Where the markers' y axis points (pixels mostly count downwards).
    scale : float, m
        Length of a pixel.
    zero : {"hanging", "up"}
        Where angles are 0; "hanging" when nothing is declared (the package's convention), "up" for ``.mat``.
    sense : {"+x", "-x"}
        Side to which angles grow; "+x" when nothing is declared.
    angles : {"absolute", "relative"}
        Whether each link's angle is against the vertical or the link before; "absolute" when nothing is declared.
    wrapped : bool
        True for angles that jump by whole turns; they are unwrapped, the smaller turn from sample to sample.
    columns : sequence of str, optional
        Names of the data columns in order (CSV), for other names than ``th1, ..`` or ``x0, y0, ..``; needs `kind`.
    noise : float or array_like (C,) or (T, C), optional
        Standard deviation in the unit of the data. CSV columns ``std_th1, ..`` or a note say
        the same.
    max_rate : float, rad/s
        Angles that change faster are refused as wrong units.
    name : str, optional
        Short name for reports; the file's name when left out.

    Returns
    -------
    Recording
        In SI units and radians; angles absolute, 0 hanging, positive towards +x; markers with y up.

    Raises
    ------
    FileProblem
        When the file is missing, empty, damaged or cut off.
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
    file = as_path(path, "recording")
    suffix = file.suffix.lower()
    if suffix in (".csv", ".txt"):
        raw = _csv.read(path, time, kind, columns)
    elif suffix in (".nc", ".mat"):
        if columns is not None or time != "t":
            raise InvalidInput(f"time and columns are for CSV files, {path} names its own")
        raw = _netcdf.read(path) if suffix == ".nc" else _matfile.read(path)
        if kind not in (None, raw.kind):
            raise InvalidInput(f"{path} holds {raw.kind}", got=kind, fix="Leave kind out")
    else:
        raise InvalidInput(f"{path} has no known suffix", got=suffix, allowed=".csv, .txt, .nc, .mat")
    given: dict[str, object] = {
        "time_unit": time_unit,
        "unit": unit,
        "frame_rate": frame_rate,
        "y_axis": y_axis,
        "scale": scale,
    }
    given |= {"zero": zero, "sense": sense, "angles": angles, "wrapped": wrapped, "noise": noise}
    return to_recording(replace(raw, name=name or raw.name or file.stem), given, max_rate)
