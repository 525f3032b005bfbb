"""MATLAB 5 files: arrays of numbers, cells and structs of them, by name.

The reader is our own, of these alone: that of scipy.io ends Python (segmentation fault) on some damaged
files, whose numbers are of an unknown kind.
"""

import math
import zlib
from typing import Literal, cast

import numpy as np

from hyperflex.checks import Array
from hyperflex.files import LARGEST, PathLike, not_damaged, read_bytes
from hyperflex.recording.arrays import content_of_arrays
from hyperflex.recording.content import Content, Selection

# Elements of a MATLAB 5 file ("MAT-File Format", MathWorks): kinds of numbers by their code, matrices, packed ones
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _PACKED = 14, 15
_CELL, _STRUCT, _ARRAYS, _COMPLEX = 1, 2, range(6, 16), 0x0800  # classes of matrices, and a flag beside them

_Order = Literal["<", ">"]


def read(path: PathLike, selection: Selection) -> Content:
    """Return the arrays of a MATLAB 5 file; those of the MultiArm pendulum joined."""
    raw = read_bytes(path, "MATLAB file")
    with not_damaged("MATLAB file", path, "Get it again"):
        variables = _variables(raw)
    return content_of_arrays(path, variables, selection)


def _variables(raw: bytes) -> dict[str, Array]:
    """Return the variables by their names: arrays of numbers, cells of them; None stands for what is neither.

    The fields of a struct are variables such as run/t. ValueError or zlib.error where the file is damaged.
    """
    order: _Order = "<" if raw[126:128] == b"IM" else ">"
    found, at = dict[str, Array](), 128
    while at < len(raw):
        kind, body, at = _element(raw, at, order)
        if kind == _PACKED:
            stream = zlib.decompressobj()
            kind, body, _ = _element(stream.decompress(body, LARGEST), 0, order)
            if not stream.eof:
                raise ValueError("a packed element does not end")
        if kind == _MATRIX:
            name, value = _matrix(body, order, nested=True)
            found |= (
                {f"{name}/{key}": each for key, each in value.items()} if isinstance(value, dict) else {name: value}
            )
    return found


def _element(data: bytes, at: int, order: _Order) -> tuple[int, bytes, int]:
    """Return kind and content of the element that begins at a byte, and where the next one begins."""
    kind, size = (int(each) for each in np.frombuffer(data, f"{order}u4", 2, at))
    first, after = at + 8, at + 8 + size + (0 if kind == _PACKED else -size % 8)
    if kind >> 16:  # up to four bytes that stand in the head itself
        kind, size, first, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
    body = data[first : first + size]
    if len(body) != size or first + size > after:
        raise ValueError("an element is longer than what holds it")
    return kind, body, after


def _matrix(data: bytes, order: _Order, *, nested: bool) -> tuple[str, Array | dict[str, Array]]:
    """Return name and value of a matrix: numbers; with `nested` a cell or a struct of them; else an array of None."""
    if not data:
        return "", np.empty((0, 0))
    _, head, at = _element(data, 0, order)
    flags = int(np.frombuffer(head, f"{order}u4", 1)[0])
    _, sizes, at = _element(data, at, order)
    _, word, at = _element(data, at, order)
    name, kind = word.decode("ascii", "replace"), flags & 0xFF
    if not (kind in _ARRAYS and not flags & _COMPLEX) and not (kind in (_CELL, _STRUCT) and nested):
        return name, np.array(None)
    shape = np.frombuffer(sizes, f"{order}i4").tolist()
    if min(shape, default=-1) < 0 or math.prod(shape) > len(data):
        raise ValueError("a matrix is larger than what holds it")
    if kind in _ARRAYS:
        code, body, _ = _element(data, at, order)
        if code not in _NUMBERS:
            raise ValueError("numbers of no known kind")
        return name, np.frombuffer(body, order + _NUMBERS[code]).astype(np.float64).reshape(shape, order="F")
    if kind == _STRUCT:
        _, width, at = _element(data, at, order)
        _, text, at = _element(data, at, order)
        size = int(np.frombuffer(width, f"{order}i4")[0])
        fields = [text[k : k + size].partition(b"\0")[0].decode("ascii", "replace") for k in range(0, len(text), size)]
        held = _held(data, at, order, len(fields)) if math.prod(shape) == 1 else []
        return name, dict(zip(fields, held, strict=False))
    value = np.empty(math.prod(shape), dtype=object)
    for k, each in enumerate(_held(data, at, order, value.size)):
        value[k] = each
    return name, value.reshape(shape, order="F")


def _held(data: bytes, at: int, order: _Order, count: int) -> list[Array]:
    """Return the matrices that a cell or a struct holds from a byte on."""
    found = []
    for _ in range(count):
        code, body, at = _element(data, at, order)
        if code != _MATRIX:
            raise ValueError("a cell or a struct holds no matrix")
        found.append(cast(Array, _matrix(body, order, nested=False)[1]))
    return found
