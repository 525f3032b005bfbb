"""Reading recordings from NetCDF-4 files, with units and conventions in the attributes."""

from __future__ import annotations

from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, read_netcdf
from hyperflex.recording.declare import Raw
from hyperflex.recording.recording import VARIABLE, Kind


def read(path: PathLike) -> Raw:
    """Return the columns of a file that :meth:`Recording.to_netcdf` made, with what its attributes declare."""
    content = read_netcdf(path)
    attrs = content.attributes
    held = {
        key: (each.numbers(key), each.attributes)
        for key, each in content.variables.items()
        if key in ("time", "angle", "position", "noise", "rate")
    }
    kind: Kind = "angles" if "angle" in held else "markers"
    name = VARIABLE[kind]
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
            declared[key] = held[variable][1]["units"]
    wanted = f"{declared.get('unit')}/s"
    if "rate" in held and "unit" in declared and held["rate"][1].get("units") != wanted:
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
