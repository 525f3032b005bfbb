"""The formats of recordings: each is recognised by how a file begins or what it holds, not by its suffix."""

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.files import PathLike, as_path, open_hdf5, regular_file
from hyperflex.recording import arrays, c3d, capture, hdf5, messages, tables, videos
from hyperflex.recording.content import Content, Selection

_BEGIN = 65_536  # bytes by which a file is recognised: room for the names of hundreds of markers
_HDF5 = rb"(.{512})?\x89HDF\r\n\x1a\n|MATLAB 7\.3"


class Head:
    """How a file begins: its first bytes, the same as text, and the names in its root if it is an HDF5 file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with path.open("rb") as file:
            self.raw = file.read(_BEGIN)

    @cached_property
    def text(self) -> str:
        """The first bytes as text; empty if they are binary."""
        wide = self.raw.startswith((b"\xff\xfe", b"\xfe\xff"))
        text = self.raw.decode("utf-16" if wide else "utf-8-sig", "replace")
        return "" if "\x00" in text else text.replace("\r\n", "\n")

    @cached_property
    def members(self) -> frozenset[str]:
        """Names in the root of an HDF5 file, and of its attributes after an @; none where it cannot be read."""
        try:
            with open_hdf5(self.path) as file:
                return frozenset([*file, *(f"@{name}" for name in file.attrs)])
        except HyperflexError:
            return frozenset()


@dataclass(frozen=True)
class Format:
    """A format of files.

    Attributes
    ----------
    name : str
        As its users call it.
    fits : callable
        Whether a file that begins in this way is of it.
    read : callable
        Returns the content of a file; with `options` for what the caller asks for.
    usual : mapping
        What its numbers mean unless the caller says otherwise.
    options : tuple of str
        Which of `time` and `topic` a caller may give.
    """

    name: str
    fits: Callable[[Head], object]
    read: Callable[..., Content]
    usual: Mapping[str, Any] = field(default_factory=dict)
    options: tuple[str, ...] = ()


def _begins(pattern: str) -> Callable[[Head], object]:
    """Return whether the text of a file begins with a pattern, in which a comma stands for what separates cells."""
    compiled = re.compile(pattern.replace(",", "[,;\t]"))
    return lambda head: compiled.match(head.text)


def _bytes(pattern: bytes) -> Callable[[Head], object]:
    return lambda head: re.match(pattern, head.raw, re.DOTALL)


def _holds(*names: str) -> Callable[[Head], object]:
    return lambda head: re.match(_HDF5, head.raw, re.DOTALL) and head.members.issuperset(names)


def _header(*words: str) -> Callable[[Head], object]:
    """Return whether the first line of a text has these words."""
    return lambda head: all(word in head.text.partition("\n")[0] for word in words)


_PIXELS = {"unit": "px", "y_axis": "down"}
_TIME, _MESSAGES = ("time",), ("time", "topic")
_BAG = Format("ROS 2 bag", _bytes(rb"SQLite format 3\0"), messages.read_bag, options=_MESSAGES)
FORMATS = (
    _BAG,
    Format("MCAP", _bytes(rb"\x89MCAP0\r\n"), messages.read_mcap, options=_MESSAGES),
    Format("C3D", _bytes(rb"[\x01-\x08\x0b\x0e-\x1f]\x50"), c3d.read),
    Format("MATLAB 5", _bytes(rb"MATLAB 5\.0 MAT-file"), arrays.read_matlab, options=_TIME),
    Format("NetCDF of hyperflex", _holds("@format"), hdf5.read_netcdf_recording),
    Format("NetCDF-3", _bytes(rb"CDF[\x01\x02\x05]"), hdf5.read_netcdf_recording),
    Format("SLEAP analysis", _holds("tracks", "node_names"), hdf5.read_sleap),
    Format("DeepLabCut H5", _holds("df_with_missing"), hdf5.read_deeplabcut, usual={**_PIXELS, "min_likelihood": 0.6}),
    Format("HDF5 or MATLAB 7.3", _bytes(_HDF5), hdf5.read_datasets, options=_TIME),
    Format("Kinovea annotations", lambda head: "<KinoveaVideoAnalysis" in head.text, videos.read_kva),
    Format("Tracker file", lambda head: "tracker.TrackerPanel" in head.text, videos.read_trk),
    Format("Kinovea trajectories", _begins("#Kinovea"), videos.read_kinovea),
    Format("OptiTrack Motive CSV", _begins("Format Version,"), capture.read_motive),
    Format("OptiTrack Motive CSV 1.1", _begins("(comment|info),"), capture.read_motive_frames),
    Format("Vicon Nexus CSV", _begins(r"[A-Z][\w ]*,*\n[\d.]+,*\n.*\n\"?Frame.Sub Frame"), capture.read_vicon),
    Format("Qualisys TSV", _begins("(FILE_VERSION|NO_OF_FRAMES),"), capture.read_qualisys),
    Format("OpenSim TRC", _begins("PathFileType,"), capture.read_trc),
    Format(
        "PlotJuggler CSV",
        _begins('"?__time"?,'),
        functools.partial(tables.read, sparse=True),
        options=_TIME,
        usual={"time_unit": "s"},
    ),
    Format("DeepLabCut CSV", _begins("scorer,"), tables.read, options=_TIME, usual={**_PIXELS, "min_likelihood": 0.6}),
    Format("Anipose CSV", _header("_ncams", "fnum"), tables.read, options=_TIME),
    Format("idtracker.ai CSV", _begins("seconds,x1,y1"), tables.read, options=_TIME, usual=_PIXELS),
    Format("AnimalTA CSV", _begins("Frame,Time,X_Arena"), tables.read, options=_TIME, usual={"time_unit": "s"}),
    Format("table", lambda head: bool(head.text.strip()), tables.read, options=_TIME),
)
OTHERS = {  # files that are often given instead, by how they begin: what they are, and what to do
    rb"PK\x03\x04": ("a zip archive, such as an Excel workbook or a .trz of Tracker", "Save it as CSV, or unpack it"),
    rb"\xd0\xcf\x11\xe0": ("an Excel workbook", "Save it as CSV"),
    rb".{4}ftyp|RIFF.{4}AVI|\x1aE\xdf\xa3": ("a video", "Track it: hyperflex track, or hyperflex.vision.track_video"),
    rb"\x89PNG|\xff\xd8\xff|GIF8": ("a picture", "Give the recording"),
    rb"%PDF": ("a PDF document", "Give the recording"),
    rb"\x80[\x02-\x05]": ("a pickle, which is never loaded", "Save it as CSV"),
}


def format_of(path: PathLike) -> Format:
    """Return the format of a file; InvalidInput if it has none that is known, FileProblem if it cannot be read."""
    file = as_path(path, "recording")
    if file.is_dir() and (file / "metadata.yaml").exists():
        return _BAG
    head = Head(regular_file(file, "recording", float("inf")))
    others = (other for pattern, other in OTHERS.items() if re.match(pattern, head.raw, re.DOTALL))
    other = next(others, None)
    if other is None and (found := next((each for each in FORMATS if each.fits(head)), None)):
        return found
    what, fix = other or ("a binary file of no known format", "Export the data as CSV")
    allowed = ", ".join(each.name for each in FORMATS)
    raise InvalidInput(f"{path} is {what}", got=head.raw[:16], allowed=allowed, fix=fix)


def content_of(path: PathLike, kind: Format, selection: Selection) -> Content:
    """Return what a file of a format holds."""
    for option, default in (("time", "t"), ("topic", None)):
        if option not in kind.options and (given := getattr(selection, option)) != default:
            others = ", ".join(each.name for each in FORMATS if option in each.options)
            what = f"{option} is not for files such as {path}: {kind.name}"
            raise InvalidInput(what, got=given, allowed=f"{option} of {others}", fix="Omit it")
    content = kind.read(path, selection) if kind.options else kind.read(path)
    return replace(content, usual={**kind.usual, **content.usual}, source=str(path))
