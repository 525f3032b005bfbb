"""C3D files of motion capture (c3d.org): markers in space with rate, unit and axes of the screen."""

from typing import Any

import numpy as np

from hyperflex import extras
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, not_damaged, regular_file
from hyperflex.recording.content import Content, Selection, content_of_markers
from hyperflex.recording.declare import unit_name


def read(path: PathLike, selection: Selection) -> Content:
    """Return the markers of a C3D file; those that were not seen, with a negative residual, are gaps."""
    ezc3d = extras.load("ezc3d", "c3d", "C3D files")
    file = regular_file(path, "C3D file")
    with not_damaged("C3D file", path):
        content = ezc3d.c3d(str(file))
        about = {key: _value(each) for key, each in content["parameters"]["POINT"].items() if not key.startswith("__")}
        places = np.asarray(content["data"]["points"], dtype=np.float64)[:3]
        missing = np.asarray(content["data"]["meta_points"]["residuals"], dtype=np.float64)[0] < 0.0
        places[:, missing] = np.nan
        first = int(content["header"]["points"]["first_frame"])
        rate = float(np.ravel(about["RATE"])[0])
    if not places.shape[1] or not places.shape[2]:
        raise InvalidInput(f"{path} is a C3D file without markers", got=places.shape, fix="Export the trajectories")
    labels = [str(each) for key in sorted(about, key=_number) if key.startswith("LABELS") for each in about[key]]
    labels += [f"marker{k}" for k in range(len(labels), places.shape[1])]
    declared: dict[str, Any] = {"time_unit": "frame", "frame_rate": rate}
    if units := _first(about, "UNITS"):
        declared["unit"] = unit_name(units)
    usual = {}
    if (up := _first(about, "Y_SCREEN")[-1:].lower()) and up in "xyz":
        usual["up"] = up
    markers: dict[str, Any] = {}
    for k in range(places.shape[1]):
        name = labels[k]
        while name in markers:
            name += "'"
        markers[name] = places[:, k].T
    t = np.arange(float(first), first + places.shape[2])
    return content_of_markers(t, markers, str(path), declared=declared, usual=usual)


def _value(parameter: Any) -> Any:
    return parameter["value"]


def _first(about: dict[str, Any], name: str) -> str:
    """Return the first text of a parameter, or an empty one."""
    return next((str(each).strip() for each in np.ravel(about.get(name, []))), "")


def _number(name: str) -> int:
    """Return the number of a parameter that continues another one: LABELS, LABELS2, LABELS3, .."""
    return int(name.removeprefix("LABELS") or 1) if name.removeprefix("LABELS").isdigit() else 0
