"""Reading trajectories from NetCDF-4 files: the run in the root group, the state to go on from in ``state``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hyperflex import checks, files
from hyperflex.errors import InvalidInput
from hyperflex.files import Variable
from hyperflex.model import Setup
from hyperflex.status import Status
from hyperflex.trajectory.run import CHECKPOINT, FORMAT, OPTIONAL, OWN_ATTRIBUTES, STATE, VARIABLES, State, Trajectory

_NEEDED = ("t", "q", "qd", "step", "work", "dissipated")  # of a state


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
        There is no such file, or it is cut off or damaged.
    InvalidInput
        It is no NetCDF-4 file, or not a hyperflex trajectory.
    """
    content = files.read_netcdf(path)
    attributes, main, state = content.attributes, content.variables, content.groups.get("state", {})
    if attributes.get("format") != FORMAT:
        raise InvalidInput(
            f"{path} is not a hyperflex trajectory",
            got=attributes.get("format", "no attribute 'format'"),
            allowed=f"a file written by Trajectory.to_netcdf (format {FORMAT!r})",
            fix="Measured data are read by hyperflex.read_recording",
        )
    missing = [name for name in ("time", *VARIABLES) if name not in main]
    missing += [f"state/{name}" for name in _NEEDED if name not in state]
    missing += [f"attribute {name!r}" for name in ("setup", "status") if name not in attributes]
    if missing:
        raise InvalidInput(f"{path} lacks parts of a trajectory", got=missing, fix="Simulate it again")
    return Trajectory(
        t=main["time"].numbers("time"),
        setup=Setup.loads(str(attributes["setup"]), f"the set-up in {path}"),
        state=_state(state),
        status=Status(checks.choice(f"status in {path}", str(attributes["status"]), list(Status))),
        message=str(attributes.get("message", "")),
        event=(str(attributes["event"]), float(attributes["event_time"])) if "event" in attributes else None,
        attrs={key: value for key, value in attributes.items() if key not in OWN_ATTRIBUTES},
        **{name: main[name].numbers(name) for name in (*VARIABLES, *OPTIONAL) if name in main},
    )


def _state(variables: Mapping[str, Variable]) -> State:
    checkpoint: dict[str, Any] = {
        name.removeprefix(CHECKPOINT): _number_or_array(each.values)
        for name, each in variables.items()
        if name.startswith(CHECKPOINT)
    }
    given = {name: _number_or_array(variables[name].numbers(name)) for name in STATE if name in variables}
    return State(**given, checkpoint=checkpoint)


def _number_or_array(values: Any) -> Any:
    return values.item() if np.ndim(values) == 0 else values
