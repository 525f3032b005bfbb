"""The MATLAB files of the MultiArm pendulum: free swings of 1, 2, 3, .. links, cut into pieces by their authors.

``Time_id`` and ``Time_vad`` are cells of times (s), ``Y_id`` and ``Y_vad`` cells of arrays (2n, N): n absolute angles
(rad, 0 upright) above n rates (rad/s); ``dt`` is the step (s). The pieces are joined again in order. This is what the
published preparation scripts write (github.com/dynamicslab/MultiArm-Pendulum, MIT licence).

The reader is our own, of numbers and cells alone: that of scipy.io ends Python (segmentation fault) on some damaged
files, whose numbers are of an unknown kind.
"""

import math
import zlib
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike, not_damaged, read_bytes
from hyperflex.recording.declare import Raw

_EXPORT = "Get the file again, or export the data as CSV"
_KEYS = ("Time_id", "Time_vad", "Y_id", "Y_vad", "dt")
# Elements of a MATLAB 5 file ("MAT-File Format", MathWorks): kinds of numbers by their code, matrices, packed ones
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _PACKED = 14, 15
_CELL, _ARRAYS, _COMPLEX = 1, range(6, 16), 0x0800  # classes of matrices, and a flag beside them
_LARGEST = 1 << 29  # bytes of an element that is unpacked

_Order = Literal["<", ">"]


def read(path: PathLike) -> Raw:
    """Return the joined pieces of one file."""
    content = _load(path)
    missing = [key for key in _KEYS if key not in content]
    if missing:
        raise InvalidInput(
            f"{path} is no MultiArm pendulum recording: it lacks {', '.join(missing)}",
            got=sorted(key for key in content if not key.startswith("__")),
            allowed=f"a MATLAB file with {', '.join(_KEYS)}, as the *DataForParameterEstimation.mat files have",
            fix="Parameter files and raw logs hold something else; export other data as CSV",
        )
    pieces = {key: _pieces(path, content, key) for key in _KEYS}
    times, states = (pieces[f"{name}_id"] + pieces[f"{name}_vad"] for name in ("Time", "Y"))
    rows = states[0].shape[0]
    sizes = [(each.size, *state.shape) for each, state in zip(times, states, strict=False)]
    if len(times) != len(states) or rows % 2 or rows == 0 or any(size[:2] != (size[2], rows) for size in sizes):
        raise InvalidInput(
            f"{path} has pieces that do not fit together",
            got=[each.shape for each in (*times, *states)],
            allowed="in each piece as many times as samples, and 2n rows: n angles, then n rates",
            fix=_EXPORT,
        )
    t, joined, n = np.concatenate([each.ravel() for each in times]), np.hstack(states).T, rows // 2
    step, dt = float(np.median(np.diff(t))) if t.size > 1 else 0.0, float(np.ravel(pieces["dt"][0])[0])
    if not 0.99 * dt < step < 1.01 * dt:  # another unit, or a damaged file
        raise InvalidInput(f"{path}: its times do not step by its dt", got=[step, dt], fix=_EXPORT)
    return Raw(
        t=t,
        data=joined[:, :n],
        kind="angles",
        rates=joined[:, n:],
        declared={"time_unit": "s", "unit": "rad"},
        usual={"zero": "up", "angles": "absolute", "sense": "+x"},
        source=str(path),
    )


def _load(path: PathLike) -> dict[str, Array]:
    """Return the variables of a MATLAB 5 file: arrays of numbers and cells of them; None stands for what is neither."""
    raw = read_bytes(path, "MATLAB file")
    if raw[:1] == b"\x89" or b"MATLAB 7.3" in raw[:128]:
        raise InvalidInput(f"{path} is a MATLAB 7.3 file", allowed="MATLAB 5 files", fix="Save it with -v7 in MATLAB")
    if not raw.startswith(b"MATLAB 5.0 MAT-file"):
        raise InvalidInput(f"{path} is no MATLAB 5 file", got=raw[:20], fix="Check that the right file was given")
    with not_damaged("MATLAB file", path, "Get it again"):
        return _variables(raw)


def _variables(raw: bytes) -> dict[str, Array]:
    """Return the variables by their names; ValueError or zlib.error where the file is damaged."""
    order: _Order = "<" if raw[126:128] == b"IM" else ">"
    found, at = {}, 128
    while at < len(raw):
        kind, body, at = _element(raw, at, order)
        if kind == _PACKED:
            stream = zlib.decompressobj()
            kind, body, _ = _element(stream.decompress(body, _LARGEST), 0, order)
            if not stream.eof:
                raise ValueError("a packed element does not end")
        if kind == _MATRIX:
            name, value = _matrix(body, order, cells=True)
            found[name] = value
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


def _matrix(data: bytes, order: _Order, *, cells: bool) -> tuple[str, Array]:
    """Return name and value of a matrix: numbers or, with `cells`, a cell of them; an array of None for all else."""
    if not data:
        return "", np.empty((0, 0))
    _, head, at = _element(data, 0, order)
    flags = int(np.frombuffer(head, f"{order}u4", 1)[0])
    _, sizes, at = _element(data, at, order)
    _, word, at = _element(data, at, order)
    name, kind = word.decode("ascii", "replace"), flags & 0xFF
    if not (kind in _ARRAYS and not flags & _COMPLEX) and not (kind == _CELL and cells):
        return name, np.array(None)
    shape = np.frombuffer(sizes, f"{order}i4").tolist()
    if min(shape, default=-1) < 0 or math.prod(shape) > len(data):
        raise ValueError("a matrix is larger than what holds it")
    if kind in _ARRAYS:
        code, body, _ = _element(data, at, order)
        if code not in _NUMBERS:
            raise ValueError("numbers of no known kind")
        return name, np.frombuffer(body, order + _NUMBERS[code]).astype(np.float64).reshape(shape, order="F")
    value = np.empty(math.prod(shape), dtype=object)
    for k in range(value.size):
        code, body, at = _element(data, at, order)
        if code != _MATRIX:
            raise ValueError("a cell holds no matrix")
        value[k] = _matrix(body, order, cells=False)[1]
    return name, value.reshape(shape, order="F")


def _pieces(path: PathLike, content: dict[str, Array], key: str) -> list[Array]:
    """Return the number arrays of one cell array."""
    cell: npt.NDArray[Any] = content[key]
    pieces = [np.asarray(each) for each in (cell.ravel() if cell.dtype == object else [cell])]
    if not pieces or any(each.ndim != 2 or not each.size or each.dtype.kind != "f" for each in pieces):
        raise InvalidInput(f"{path}: {key} is not a cell of number arrays", got=cell.dtype, fix=_EXPORT)
    return pieces
