"""HDF5 files, opened with checks for damage in which HDF5 itself would not come to an end, or fill the memory."""

import math
import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hyperflex.errors import InvalidInput
from hyperflex.files.reading import LARGEST, not_damaged, regular_file
from hyperflex.files.writing import PathLike

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
