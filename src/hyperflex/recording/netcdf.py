"""Recordings as NetCDF-4, with units and conventions in the attributes."""

from __future__ import annotations

from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.files import PathLike, atomic_path, read_bytes
from hyperflex.recording.declare import Raw
from hyperflex.recording.recording import Kind, Recording

FORMAT = "hyperflex recording 1"
_NAME: dict[Kind, str] = {"angles": "angle", "markers": "position"}


def write(recording: Recording, path: PathLike) -> None:
    """Write `recording` wholly or not at all."""
    import h5netcdf

    kind, samples = recording.kind, recording.t.size
    shape = (samples, recording.n_links) if kind == "angles" else (samples, recording.n_links + 1, 2)
    dims = ("time", "link") if kind == "angles" else ("time", "marker", "axis")
    unit = "rad" if kind == "angles" else "m"
    with atomic_path(path) as part, h5netcdf.File(part, "w") as file:
        file.dimensions = dict(zip(dims, shape, strict=True))
        _put(file, "time", ("time",), recording.t, "s", "sample time")
        _put(file, _NAME[kind], dims, recording.data.reshape(shape), unit, f"measured {kind}, NaN in gaps")
        if recording.noise is not None:
            _put(file, "noise", dims, recording.noise.reshape(shape), unit, "standard deviation of each sample")
        if recording.rates is not None:
            _put(file, "rate", dims, recording.rates, "rad/s", "angular rates that came with the angles")
        file.attrs["format"] = FORMAT
        file.attrs["kind"] = kind
        if kind == "angles":
            file.attrs.update({"zero": "hanging", "sense": "+x", "angles": "absolute"})
        else:
            file.attrs["y_axis"] = "up"
        for key in ("convention", "name", "source"):
            file.attrs[key] = getattr(recording, key)


def read(path: PathLike) -> Raw:
    """Return the columns of a file that :func:`write` made, with what its attributes declare."""
    import h5netcdf

    head = read_bytes(path, "NetCDF file")[:8]
    if head[:3] == b"CDF":
        raise InvalidInput(f"{path} is a NetCDF-3 file", allowed="NetCDF-4", fix="Convert it with nccopy -k nc4")
    if head != b"\x89HDF\r\n\x1a\n":
        raise InvalidInput(f"{path} is no NetCDF-4 file", got=head, fix="Check that the right file was given")
    try:
        with h5netcdf.File(path, "r") as file:
            attrs = {key: _text(value) for key, value in file.attrs.items()}
            held = {
                key: (np.array(v[...], dtype=np.float64), dict(v.attrs))
                for key, v in file.variables.items()
                if key in ("time", "angle", "position", "noise", "rate")
            }
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise FileProblem(f"The NetCDF file {path} is damaged or cut off ({error}). Get it again.") from error
    return _raw(path, attrs, held)


Held = dict[str, tuple[Array, dict[str, Any]]]


def _raw(path: PathLike, attrs: dict[str, Any], held: Held) -> Raw:
    """Return what was read as columns with declarations."""
    kind: Kind = "angles" if "angle" in held else "markers"
    name = _NAME[kind]
    if "time" not in held or name not in held:
        raise InvalidInput(
            f"{path} holds no recording",
            got=sorted(held),
            allowed="variables time and angle (time, link) or position (time, marker, axis)",
            fix="A trajectory is opened by read_trajectory",
        )
    samples = held["time"][0].shape[0] if held["time"][0].ndim == 1 else -1
    rank = {"time": 1, "rate": 2, name: 2 if kind == "angles" else 3}
    for key, (values, _) in held.items():
        if values.ndim != rank.get(key, rank[name]) or values.shape[0] != samples:
            raise InvalidInput(f"{path}: variable {key!r} has the wrong shape", got=values.shape)
    declared: dict[str, object] = {key: attrs[key] for key in ("zero", "sense", "angles", "y_axis") if key in attrs}
    for key, variable in (("time_unit", "time"), ("unit", name)):
        if "units" in held[variable][1]:
            declared[key] = _text(held[variable][1]["units"])
    wanted = f"{declared.get('unit')}/s"
    if "rate" in held and "unit" in declared and _text(held["rate"][1].get("units")) != wanted:
        raise InvalidInput(f"{path}: units of rate", got=held["rate"][1].get("units"), allowed=repr(wanted))
    columns = {key: values.reshape(samples, -1) for key, (values, _) in held.items() if key != "time"}
    return Raw(
        t=held["time"][0],
        data=columns[name],
        kind=kind,
        noise=columns.get("noise"),
        rates=columns.get("rate"),
        declared=declared,
        convention=str(attrs.get("convention", "")),
        name=str(attrs.get("name", "")),
        source=str(path),
    )


def _put(file: Any, name: str, dims: tuple[str, ...], values: Array, unit: str, long_name: str) -> None:
    variable = file.create_variable(name, dims, np.float64, data=values)
    variable.attrs["units"] = unit
    variable.attrs["long_name"] = long_name


def _text(value: Any) -> Any:
    return value.decode() if isinstance(value, bytes) else value
