"""HDF5 files: SLEAP analysis, DeepLabCut, MATLAB 7.3, any other by the paths of its datasets, and our own NetCDF."""

import pickletools
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, check_size, joined_names, most_bytes, open_hdf5, read_netcdf
from hyperflex.recording.arrays import content_of_arrays
from hyperflex.recording.content import (
    Content,
    Selection,
    content_of_channels,
    content_of_markers,
    likelihood_of,
    points_of,
)
from hyperflex.recording.recording import FACTS, VARIABLE, Kind

_AXES = ("zero", "sense", "angles", "y_axis")  # declarations that our NetCDF files have as attributes
_WORDS = "node_names", "track_names"
_BLOCK = "values_block_0"  # of a table that pandas wrote


def read_netcdf_recording(path: PathLike) -> Content:
    """Return the content of a file of :meth:`Recording.to_netcdf`, with what its attributes declare."""
    file = read_netcdf(path)
    attributes, found = file.attributes, file.variables
    kind: Kind = "angles" if "angle" in found else "markers"
    name = VARIABLE[kind]
    if "time" not in found or name not in found:
        raise InvalidInput(
            f"{path} contains no recording",
            got=sorted(found),
            allowed="variables time and angle (time, link) or position (time, marker, axis)",
            fix="A trajectory is opened by read_trajectory",
        )
    t, declared = found["time"].numbers("time"), {key: attributes[key] for key in _AXES if key in attributes}
    channels: dict[str, Array] = {}
    beside: dict[str, dict[str, str]] = {}
    units: dict[str, str] = {}
    names: list[str] = []
    for key in (name, "noise", "rate"):
        if key not in found:
            continue
        values = found[key].numbers(key)
        if t.ndim != 1 or values.ndim != (2 if kind == "angles" else 3) or values.shape[0] != t.size:
            what = f"{path}: variable {key!r} has the wrong shape"
            raise InvalidInput(what, got=values.shape, fix="Write it again")
        columns = values.reshape(t.size, -1)
        own = [f"{key}{k}" for k in range(columns.shape[1])]
        channels |= zip(own, columns.T, strict=True)
        names = names or own
        beside[key] = dict(zip(names, own, strict=False))
        if "units" in found[key].attributes and key != "noise":
            units |= dict.fromkeys(own, found[key].attributes["units"])
    if "units" in found["time"].attributes:
        declared["time_unit"] = found["time"].attributes["units"]
    facts = {key: float(attributes[key]) for key in FACTS if key in attributes}
    return content_of_channels(
        t,
        channels,
        points={str(k // 2): tuple(names[k : k + 2]) for k in range(0, len(names), 2)} if kind == "markers" else {},
        ordered=True,
        angles=names if kind == "angles" else [],
        rates=beside.get("rate", {}),
        noise=beside.get("noise", {}),
        units=units,
        declared=declared,
        facts=facts,
        convention=str(attributes.get("convention", "")),
        name=str(attributes.get("name", "")),
    )


def read_sleap(path: PathLike) -> Content:
    """Return the nodes of a SLEAP analysis file, px with y down; of several tracks as track_node."""
    with open_hdf5(path) as file:
        tracks = _numbers(path, file["tracks"])
        scores = _numbers(path, file["point_scores"]) if "point_scores" in file else None
        words = (np.ravel(file[key].asstr(errors="replace")[()]).tolist() if key in file else [] for key in _WORDS)
        nodes, animals = words
        count, axes, parts, frames = tracks.shape
        if axes not in (2, 3) or len(nodes) != parts or (scores is not None and scores.shape != (count, parts, frames)):
            raise ValueError("tracks do not fit their names")
    animals = animals if len(animals) == count else [f"track{k}" for k in range(count)]
    markers, likelihood = {}, {}
    for k, animal in enumerate(animals):
        for j, node in enumerate(nodes):
            name = f"{animal}_{node}" if count > 1 else node
            markers[name] = tracks[k, :, j].T
            if scores is not None:
                likelihood[name] = scores[k, j]
    t = np.arange(float(frames))
    usual = {"unit": "px", "y_axis": "down"} if axes == 2 else {}
    declared = {"time_unit": "frame"}
    return content_of_markers(t, markers, likelihoods=likelihood, declared=declared, usual=usual)


def read_deeplabcut(path: PathLike) -> Content:
    """Return the body parts of an H5 file of DeepLabCut, px with y down; of several individuals as individual_part."""
    with open_hdf5(path) as file:
        table = next(group["table"] for group in file.values() if "table" in group)
        check_size(path, table.size * table.dtype.itemsize)
        rows, labels = table[()], _texts_of_pickle(bytes(table.attrs[f"{_BLOCK}_kind"]))
        t, values = np.asarray(rows["index"], dtype=np.float64), np.asarray(rows[_BLOCK], dtype=np.float64)
        if values.ndim != 2 or len(labels) != values.shape[1] or len({len(each) for each in labels}) != 1:
            raise ValueError("columns do not fit their names")
        *groups, axes = (["", *level] for level in zip(*labels, strict=True))
        names = joined_names([["scorer", *groups[0][1:]], *groups[1:]], axes)[1:]
    points = points_of(names)
    return content_of_channels(
        t,
        dict(zip(names, values.T, strict=True)),
        points=points,
        likelihood=likelihood_of(points, names),
        declared={"time_unit": "frame"},
    )


def read_datasets(path: PathLike, selection: Selection) -> Content:
    """Return the datasets of an HDF5 or MATLAB 7.3 file as channels with their paths as names."""
    arrays: dict[str, Any] = {}
    with open_hdf5(path) as file:
        most = most_bytes(path)

        def add(name: str, item: Any) -> None:
            if not hasattr(item, "dtype") or name.startswith("#refs#"):
                return
            if item.dtype.kind == "O" and item.size <= most // 8:  # a cell of MATLAB holds references
                arrays[name] = _cell(path, file, item)
            elif item.dtype.kind in "iuf" and item.ndim <= 3:
                arrays[name] = item

        file.visititems(add)
        kept = {name: item if isinstance(item, np.ndarray) else _numbers(path, item) for name, item in arrays.items()}
        matlab = any("MATLAB_class" in item.attrs for item in file.values())
    return content_of_arrays(
        path, {name: _transposed(each) if matlab else each for name, each in kept.items()}, selection
    )


def _transposed(value: Any) -> Any:
    """Return an array, or those of a cell, with the order of axes that MATLAB shows."""
    if value.dtype != object:
        return value.T
    cell = np.empty(value.shape, dtype=object)
    for k, each in enumerate(value):
        cell[k] = each.T
    return cell


def _cell(path: PathLike, file: Any, item: Any) -> Any:
    """Return the arrays to which a dataset of references refers (K,)."""
    references = np.ravel(item[()])
    found = np.empty(len(references), dtype=object)
    for k, reference in enumerate(references):
        if not isinstance(reference, bytes | str) and reference:
            target = file[reference]
            found[k] = _numbers(path, target) if target.dtype.kind in "iuf" else np.array(None)
    return found


def _numbers(path: PathLike, item: Any) -> Array:
    """Return a dataset as numbers; ValueError where it says that it is larger than its file can hold."""
    check_size(path, item.size * max(item.dtype.itemsize, 8))
    return np.asarray(item[()], dtype=np.float64)


def _texts_of_pickle(content: bytes) -> list[tuple[str, ...]]:
    """Return a list of tuples of texts from its pickle, of which nothing is loaded or called: its codes are read.

    PyTables stores the names of columns in this way (protocol 0). ValueError for anything else in it.
    """
    stack: list[Any] = []
    memo: dict[Any, Any] = {}
    marks: list[int] = []
    for code, argument, _ in pickletools.genops(content):
        match code.name:
            case "MARK":
                marks.append(len(stack))
            case "LIST" | "TUPLE" as kind:
                at = marks.pop()
                stack[at:] = [stack[at:] if kind == "LIST" else tuple(stack[at:])]
            case "UNICODE":
                stack.append(argument)
            case "PUT":
                memo[argument] = stack[-1]
            case "GET":
                stack.append(memo[argument])
            case "APPEND":
                each = stack.pop()
                stack[-1].append(each)
            case "STOP":
                break
            case other:
                raise ValueError(f"names of columns are not texts ({other})")
    (labels,) = stack
    if not all(isinstance(part, str) for label in labels for part in label):
        raise ValueError("names of columns are not texts")
    return list(labels)
