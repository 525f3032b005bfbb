"""C3D files of motion capture (c3d.org): markers in space with rate, unit and axes of the screen.

They are read by the package c3d, in Python: ezc3d, in C++, does not come back from some damaged files.
"""

import warnings
from typing import Any

import numpy as np

from hyperflex import extras
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, most_bytes, not_damaged, regular_file
from hyperflex.recording.content import Content, content_of_markers, unused
from hyperflex.recording.declare import frames


def read(path: PathLike) -> Content:
    """Return the markers of a C3D file; those that were not seen, with a negative residual, are gaps."""
    c3d = extras.load("c3d", "c3d", "C3D files")
    file = regular_file(path, "C3D file", most_bytes(path))
    with not_damaged("C3D file", path), file.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files without analogue channels
        reader = c3d.Reader(stream)
        rows = [(number, points[:, :4]) for number, points, _ in reader.read_frames(copy=True)]
        about = {name: _text(reader, f"POINT:{name}") for name in ("UNITS", "Y_SCREEN")}
        labels, rate = [str(each).strip() for each in reader.point_labels], float(reader.point_rate)
        if len(rows) != reader.frame_count:
            raise ValueError("it ends within its frames")
        places = np.array([points for _, points in rows], dtype=np.float64).reshape(len(rows), -1, 4)
    if not places.size:
        raise InvalidInput(f"{path} is a C3D file without markers", got=places.shape, fix="Export the trajectories")
    places[places[:, :, 3] < 0.0] = np.nan
    markers: dict[str, Any] = {}
    for k in range(places.shape[1]):
        name = labels[k] if k < len(labels) and labels[k] else f"marker{k}"
        markers[unused(name, markers)] = places[:, k, :3]
    up = about["Y_SCREEN"].lower().removeprefix("+")  # "-z" is up along no axis: then the caller says it
    t = np.array([number for number, _ in rows], dtype=np.float64)
    return content_of_markers(
        t,
        markers,
        declared=frames(rate, about["UNITS"]),
        usual={"up": up} if up in ("x", "y", "z") else {},
    )


def _text(reader: Any, name: str) -> str:
    """Return the text of a parameter; an empty one if there is none."""
    parameter = reader.get(name)
    return "" if parameter is None else str(parameter.string_value).strip()
