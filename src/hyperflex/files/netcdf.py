"""NetCDF-4 files: variables with units and long names, attributes, and groups of variables."""

import io
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex.errors import InvalidInput
from hyperflex.files.hdf5 import check_size, open_hdf5
from hyperflex.files.writing import PathLike, write_bytes


class Variable(NamedTuple):
    """A variable of a NetCDF file: names of its dimensions, its values, and its attributes (texts)."""

    dims: tuple[str, ...]
    values: ArrayLike
    attributes: Mapping[str, str] = {}

    def numbers(self, name: str) -> npt.NDArray[np.float64]:
        """Return the values as float64; InvalidInput, with the variable's `name`, where they are no numbers."""
        try:
            return np.asarray(self.values, dtype=np.float64)
        except (ValueError, TypeError):
            raise InvalidInput(f"variable {name!r} contains no numbers", got=self.values, allowed="numbers") from None


class NetCDF(NamedTuple):
    """The content of a file: variables and attributes of the root group, and the variables of each sub-group.

    A dimension is as long as the first variable that names it.
    """

    variables: dict[str, Variable]
    attributes: dict[str, Any]
    groups: Mapping[str, dict[str, Variable]] = {}


def write_netcdf(path: PathLike, content: NetCDF) -> None:
    """Write a NetCDF-4 file, wholly or not at all. Raises FileProblem as :func:`hyperflex.files.atomic_path` does.

    It is made in memory: where a disk is full, HDF5 cannot close a file, and crashes when the process ends.
    """
    import h5netcdf

    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        for dims, values, _ in content.variables.values():
            sizes = dict(zip(dims, np.shape(values), strict=True))
            file.dimensions.update({name: size for name, size in sizes.items() if name not in file.dimensions})
        _put(file, content.variables)
        file.attrs.update(content.attributes)
        for name, variables in content.groups.items():
            _put(file.create_group(name), variables)
    write_bytes(path, buffer.getbuffer())


def read_netcdf(path: PathLike) -> NetCDF:
    """Read a NetCDF-4 file.

    Raises
    ------
    FileProblem
        The file is missing, empty, cut off or damaged.
    InvalidInput
        It is of another format.
    """
    import h5netcdf

    class Content(h5netcdf.File):  # type: ignore[misc]
        _writable = False  # else h5netcdf prints a traceback when it closes a file that it could not open

    with open_hdf5(path, "NetCDF-4 file") as opened, Content(opened, "r") as content:
        groups = {name: _variables(path, group) for name, group in content.groups.items()}
        attributes = {key: _plain(value) for key, value in content.attrs.items()}
        return NetCDF(_variables(path, content), attributes, groups)


def _put(group: Any, variables: Mapping[str, Variable]) -> None:
    import h5py

    for name, (dims, values, attributes) in variables.items():
        data = np.asarray(values)
        kind = h5py.string_dtype() if data.dtype == object else data.dtype
        group.create_variable(name, dims, kind, data=data).attrs.update(attributes)


def _variables(path: PathLike, group: Any) -> dict[str, Variable]:
    """Return the variables of a group; ValueError where they say that they hold more than the file can."""
    check_size(path, sum(math.prod(each.shape) * each.dtype.itemsize for each in group.variables.values()))
    return {
        name: Variable(each.dimensions, each[...], {key: _plain(value) for key, value in each.attrs.items()})
        for name, each in group.variables.items()
    }


def _plain(value: Any) -> Any:
    """Return an attribute as text or a Python number."""
    if isinstance(value, bytes):
        return value.decode()
    return value.item() if isinstance(value, np.generic) else value
