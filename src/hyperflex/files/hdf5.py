"""HDF5 files, opened with checks for damage in which HDF5 itself would not come to an end; NetCDF-4 files.

NetCDF files have variables with units and long names, attributes, and groups of variables.
"""

import io
import math
import mmap
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex.errors import InvalidInput
from hyperflex.files.reading import LARGEST, not_damaged, regular_file
from hyperflex.files.writing import PathLike, write_bytes

_HEAP = b"GCOL\x01\0\0\0"  # how a heap of texts begins
_DEFLATED = 1100  # bytes that one byte of a compressed file may stand for: deflate makes at most 1032 of it
_SIGNATURE, _NETCDF3 = b"\x89HDF\r\n\x1a\n", b"CDF"  # how such files begin
_BEGINS = (0, 512)  # where: MATLAB puts a header of 512 bytes before it


@contextmanager
def open_hdf5(path: PathLike, what: str = "HDF5 file") -> Iterator[Any]:
    """Open an HDF5 file (an h5py.File) for reading; errors of the block, too, are those of a damaged file.

    Raises
    ------
    FileProblem
        The file is missing, empty, cut off or damaged.
    InvalidInput
        It is of another format.
    """
    import h5py

    file = regular_file(path, what, math.inf)
    with file.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as content:
        heads, endless = [content[at : at + 8] for at in _BEGINS], _has_endless_heap(content)
    if heads[0].startswith(_NETCDF3):
        raise InvalidInput(f"{path} is a NetCDF-3 file", allowed="NetCDF-4", fix="Convert it with nccopy -k nc4")
    if _SIGNATURE not in heads:
        raise InvalidInput(f"{path} is no {what}", got=heads[0], fix="Check that the right file was given")
    with not_damaged(what, path):
        if endless:
            raise ValueError("an object of a heap has no size")
        with h5py.File(path, "r") as opened:
            yield opened


def most_bytes(path: PathLike) -> int:
    """Return how many bytes the variables of a file can hold at most, from its size."""
    return min(LARGEST, _DEFLATED * regular_file(path, "HDF5 file", math.inf).stat().st_size)


def check_size(path: PathLike, size: int) -> None:
    """Raise ValueError if a file says that it holds more bytes than it can."""
    if size > most_bytes(path):
        raise ValueError("its header declares more data than it has")


def _has_endless_heap(content: mmap.mmap) -> bool:
    """Whether HDF5 would not come to an end in a heap of texts: an object without a size, or one that ends outside."""
    at = content.find(_HEAP)
    while at >= 0:
        begin, end = at + 16, at + int.from_bytes(content[at + 8 : at + 16], "little")
        while begin + 16 <= end:
            index, size = (int.from_bytes(content[begin + k : begin + k + 8], "little") for k in (0, 8))
            begin += 16 + (size + 7) // 8 * 8 if index & 0xFFFF else size or end
            if begin > end:
                return True
        at = content.find(_HEAP, at + 8)
    return False


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
