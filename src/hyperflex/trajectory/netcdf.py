"""Trajectories in NetCDF-4 files. The run is in the root group, the state to go on from in the group ``state``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.model import Setup
from hyperflex.trajectory.run import AXES, DERIVED, FORMAT, OPTIONAL, OWN_ATTRIBUTES, VARIABLES, State, Trajectory

_STATE = {"t": "s", "q": "rad", "qd": "rad/s", "step": "s", "work": "J", "dissipated": "J"}  # name -> units
_MORE = {"peg_angle": "rad", "peg_rate": "rad/s", "arm_angle": "rad", "arm_rate": "rad/s"}  # where there are any
_CHECKPOINT = "checkpoint_"


def write(run: Trajectory, path: str | Path) -> None:
    """Write a run and its final state to `path`, whole or not at all; see :meth:`Trajectory.to_netcdf`."""
    import h5netcdf

    samples, links = run.q.shape
    with files.atomic_path(path) as part, h5netcdf.File(part, "w") as file:
        file.dimensions = {"time": samples, "link": links, "joint": links + 1, "axis": 2}
        if run.peg_rate is not None:
            file.dimensions["peg"] = run.peg_rate.shape[1]
        _put(file, "time", ("time",), run.t, units="s", long_name="time")
        _put(file, "axis", ("axis",), np.array(["x", "y"], dtype=object), long_name=AXES)
        for name, (dims, units, long_name) in {**VARIABLES, **run.optional(), **DERIVED}.items():
            _put(file, name, ("time", *dims), getattr(run, name), units=units, long_name=long_name)
        for key, value in run.attributes().items():
            file.attrs[key] = value
        group = file.create_group("state")
        for name, units in _STATE.items():
            _put(group, name, ("link",) if name in ("q", "qd") else (), getattr(run.state, name), units=units)
        for name, units in _MORE.items():
            if (value := getattr(run.state, name)) is not None:
                _put(group, name, ("peg",) if np.ndim(value) else (), value, units=units)
        for name, value in run.state.checkpoint.items():
            dims = tuple(f"{name}_{axis}" for axis in range(np.ndim(value)))
            _put(group, _CHECKPOINT + name, dims, value)


def read_trajectory(path: str | Path) -> Trajectory:
    """Read a run that :meth:`Trajectory.to_netcdf` wrote.

    Parameters
    ----------
    path : str or Path
        The NetCDF file.

    Returns
    -------
    Trajectory

    Raises
    ------
    FileProblem
        There is no such file, or it is truncated or no NetCDF-4 file at all.
    InvalidInput
        It is a NetCDF file, but not a hyperflex trajectory.
    """
    attributes, main, state = _load(path)
    if attributes.get("format") != FORMAT:
        raise InvalidInput(
            f"{path} is not a hyperflex trajectory",
            got=attributes.get("format", "no attribute 'format'"),
            allowed=f"a file written by Trajectory.to_netcdf (format {FORMAT!r})",
            fix="Measured data are read by hyperflex.read_recording",
        )
    missing = [name for name in ("time", *VARIABLES) if name not in main]
    missing += [f"state/{name}" for name in _STATE if name not in state]
    missing += [f"attribute {name!r}" for name in ("setup", "status") if name not in attributes]
    if missing:
        raise InvalidInput(f"{path} lacks parts of a trajectory", got=missing, fix="Simulate it again")
    return Trajectory(
        t=_floats(main["time"]),
        setup=Setup.loads(str(attributes["setup"]), f"the set-up in {path}"),
        state=_state(state),
        status=str(attributes["status"]),
        message=str(attributes.get("message", "")),
        event=(str(attributes["event"]), float(attributes["event_time"])) if "event" in attributes else None,
        attrs={key: value for key, value in attributes.items() if key not in OWN_ATTRIBUTES},
        **{name: _floats(main[name]) for name in (*VARIABLES, *OPTIONAL) if name in main},
    )


def _load(path: str | Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the attributes, the variables and the variables of the group ``state``."""
    import h5netcdf

    files.read_bytes(path, "NetCDF file")
    try:
        with h5netcdf.File(path, "r") as file:
            attributes = {key: _plain(value) for key, value in file.attrs.items()}
            main = {name: variable[...] for name, variable in file.variables.items()}
            group = file.groups.get("state")
            state = {} if group is None else {name: variable[...] for name, variable in group.variables.items()}
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise FileProblem(
            f"{path} cannot be read as NetCDF: it is truncated, damaged or of another kind ({error}). "
            "Write it again with Trajectory.to_netcdf."
        ) from error
    return attributes, main, state


def _put(group: Any, name: str, dims: tuple[str, ...], values: Any, **attributes: str) -> None:
    import h5py

    data = np.asarray(values)
    text = data.dtype == object
    variable = group.create_variable(name, dims, h5py.string_dtype() if text else data.dtype, data=data)
    for key, value in attributes.items():
        variable.attrs[key] = value


def _state(variables: Mapping[str, Any]) -> State:
    checkpoint: dict[str, Any] = {}
    for name, value in variables.items():
        if name.startswith(_CHECKPOINT):
            checkpoint[name.removeprefix(_CHECKPOINT)] = value.item() if np.ndim(value) == 0 else value
    scalars: dict[str, Any] = {name: float(variables[name]) for name in ("t", "step", "work", "dissipated")}
    given = {name: variables[name] for name in _MORE if name in variables}
    more: dict[str, Any] = {name: _floats(value) if np.ndim(value) else float(value) for name, value in given.items()}
    return State(q=_floats(variables["q"]), qd=_floats(variables["qd"]), checkpoint=checkpoint, **scalars, **more)


def _floats(values: Any) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)


def _plain(value: Any) -> Any:
    """Turn what HDF5 gives for an attribute into text and Python numbers."""
    if isinstance(value, bytes):
        return value.decode()
    return value.item() if isinstance(value, np.generic) else value
