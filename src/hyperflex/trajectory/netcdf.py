"""Trajectories in NetCDF files: the run in the root group, the state to go on from in the group ``state``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.model import Setup
from hyperflex.trajectory.run import FORMAT, OWN_ATTRIBUTES, VARIABLES, State, Trajectory

if TYPE_CHECKING:
    import xarray as xr

_STATE_GROUP = "state"
_CHECKPOINT = "checkpoint_"


def write(path: str | Path, run: xr.Dataset, state: State) -> None:
    """Write a run (the dataset of a trajectory) and its final state to `path`, whole or not at all."""
    with files.atomic_path(path) as temporary:
        _save(run, temporary, group=None)
        _save(_state_dataset(state), temporary, group=_STATE_GROUP)


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
    main = _load(Path(path), group=None)
    if main.attrs.get("format") != FORMAT:
        raise InvalidInput(
            f"{path} is not a hyperflex trajectory",
            got=main.attrs.get("format", "no attribute 'format'"),
            allowed=f"a file written by Trajectory.to_netcdf (format {FORMAT!r})",
            fix="Measured data are read by hyperflex.read_recording",
        )
    state = _load(Path(path), group=_STATE_GROUP)
    missing = [name for name in ("time", *VARIABLES) if name not in main.variables]
    missing += [name for name in ("t", "q", "qd", "step", "work", "dissipated") if name not in state.variables]
    if missing or "setup" not in main.attrs:
        raise InvalidInput(
            f"{path} lacks parts of a trajectory", got=missing or ["attribute 'setup'"], fix="Simulate it again"
        )
    return Trajectory(
        t=_column(main, "time"),
        setup=Setup.loads(str(main.attrs["setup"])),
        state=_state_from(state),
        status=str(main.attrs.get("status", "ok")),
        message=str(main.attrs.get("message", "")),
        attrs={str(key): value for key, value in main.attrs.items() if key not in OWN_ATTRIBUTES},
        **{name: _column(main, name) for name in VARIABLES},
    )


def _save(dataset: xr.Dataset, path: Path, *, group: str | None) -> None:
    plain = {name: {"_FillValue": None} for name, value in dataset.variables.items() if value.dtype.kind == "f"}
    dataset.to_netcdf(path, mode="w" if group is None else "a", group=group, engine="h5netcdf", encoding=plain)


def _load(path: Path, *, group: str | None) -> xr.Dataset:
    import xarray as xr

    if not path.is_file():
        raise FileProblem(f"There is no file {path}. Give the path of a NetCDF file written by Trajectory.to_netcdf.")
    try:
        with xr.open_dataset(path, engine="h5netcdf", group=group, decode_cf=False) as dataset:
            return dataset.load()
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise FileProblem(
            f"{path} cannot be read as NetCDF: it is truncated, damaged or of another kind ({error}). "
            "Write it again with Trajectory.to_netcdf."
        ) from error


def _state_dataset(state: State) -> xr.Dataset:
    import xarray as xr

    variables: dict[str, Any] = {
        "t": ((), state.t, {"units": "s"}),
        "q": (("link",), state.q, {"units": "rad"}),
        "qd": (("link",), state.qd, {"units": "rad/s"}),
        "step": ((), state.step, {"units": "s", "long_name": "size of the next integration step"}),
        "work": ((), state.work, {"units": "J"}),
        "dissipated": ((), state.dissipated, {"units": "J"}),
    }
    for name, value in state.checkpoint.items():
        dims = tuple(f"{name}_{axis}" for axis in range(np.ndim(value)))
        variables[_CHECKPOINT + name] = (dims, np.asarray(value))
    return xr.Dataset(variables)


def _state_from(dataset: xr.Dataset) -> State:
    checkpoint: dict[str, Any] = {}
    for name in dataset.variables:
        if str(name).startswith(_CHECKPOINT):
            data = dataset[name].to_numpy()
            checkpoint[str(name).removeprefix(_CHECKPOINT)] = data.item() if data.ndim == 0 else data
    scalars = {name: float(dataset[name]) for name in ("t", "step", "work", "dissipated")}
    return State(q=_column(dataset, "q"), qd=_column(dataset, "qd"), checkpoint=checkpoint, **scalars)


def _column(dataset: xr.Dataset, name: str) -> Array:
    return np.ascontiguousarray(dataset[name].to_numpy(), dtype=np.float64)
