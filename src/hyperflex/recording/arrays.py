"""Named arrays, as MATLAB and HDF5 files have them: any by name, or those of the MultiArm pendulum. MATLAB 5 files.

The files of the MultiArm pendulum are free swings of 1, 2, 3, .. links, cut into pieces by their authors: ``Time_id``
and ``Time_vad`` are cells of times (s), ``Y_id`` and ``Y_vad`` cells of arrays (2n, N): n absolute angles (rad, 0
upright) above n rates (rad/s); ``dt`` is the step (s). The pieces are joined again in order. This is what the published
preparation scripts write (github.com/dynamicslab/MultiArm-Pendulum, MIT licence).

The reader of MATLAB 5 files (arrays of numbers, cells and structs of them) is our own, of these alone: that of scipy.io
ends Python (segmentation fault) on some damaged files, whose numbers are of an unknown kind.
"""

import math
import re
import zlib
from collections.abc import Mapping
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import LARGEST, PathLike, not_damaged, read_bytes
from hyperflex.recording.content import Content, Selection, content_of_channels

_EXPORT = "Get the file again, or export the data as CSV"
_KEYS = ("Time_id", "Time_vad", "Y_id", "Y_vad", "dt")
_TIME = re.compile(r"(?i)(.*/)?(t|time|times|timestamps?)")
# Elements of a MATLAB 5 file ("MAT-File Format", MathWorks): kinds of numbers by their code, matrices, packed ones
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _PACKED = 14, 15
_CELL, _STRUCT, _ARRAYS, _COMPLEX = 1, 2, range(6, 16), 0x0800  # classes of matrices, and a flag beside them
_Order = Literal["<", ">"]
_EXAMPLE = "columns=['NAME', ..] and kind='angles' or 'markers'"


def content_of_arrays(path: PathLike, arrays: Mapping[str, Any], selection: Selection) -> Content:
    """Return named arrays as channels: with an axis as long as the times, or (T, n, 2) of x and y of n markers."""
    if missing := [key for key in _KEYS if key not in arrays]:
        if len(missing) < len(_KEYS):
            what, fix = f"{path} is no MultiArm pendulum recording: it lacks {', '.join(missing)}", _EXPORT
            raise InvalidInput(what, got=list(arrays), allowed=", ".join(_KEYS), fix=fix)
    else:
        return _multiarm(path, arrays)
    numbers = {name: each for name, each in arrays.items() if each.dtype != object and each.size > 1}
    vectors = {name: np.ravel(each) for name, each in numbers.items() if each.size == max(each.shape)}
    named = [name for name in vectors if _TIME.fullmatch(name)] if selection.time == "t" else []
    times = [selection.time] if selection.time in vectors else [name for name in named if "/" not in name] or named
    assume = selection.assume and len(times) != 1
    if assume:
        times = (times or [name for name, each in vectors.items() if (np.diff(each) > 0.0).all()])[:1]
    if len(times) != 1:
        raise InvalidInput(
            f"{path} does not say which of its arrays are times and data",
            got=[f"{name} {each.shape}" for name, each in numbers.items()][:40],
            allowed=f"time='NAME' of times, {_EXAMPLE}; or the {', '.join(_KEYS)} of the MultiArm pendulum",
            fix="Name them by their path",
        )
    t = vectors[times[0]]
    channels = {}
    for name, each in numbers.items():
        if name != times[0] and (t.size in each.shape if each.ndim <= 2 else _places(each.shape, t.size)):
            channels[name] = each if each.shape[0] == t.size else each.T
    assumed = {"time": times[0]} if assume else {}
    return content_of_channels(t, channels, advice=f"Name them: {_EXAMPLE}", assumed=assumed)


def _places(shape: tuple[int, ...], samples: int) -> bool:
    """Whether an array is of x and y of markers, (T, n, 2); not of two, whose axes may be the other way round."""
    return len(shape) == 3 and shape[0] == samples and shape[2] == 2 != shape[1]


def _multiarm(path: PathLike, arrays: Mapping[str, Any]) -> Content:
    """Return the joined pieces of a file of the MultiArm pendulum."""
    pieces = {key: _pieces(path, arrays, key) for key in _KEYS}
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
    t, joined, n = np.concatenate([each.ravel() for each in times]), np.hstack(states), rows // 2
    step, dt = float(np.median(np.diff(t))) if t.size > 1 else 0.0, float(np.ravel(pieces["dt"][0])[0])
    if not 0.99 * dt < step < 1.01 * dt:  # another unit, or a damaged file
        raise InvalidInput(f"{path}: its times do not step by its dt", got=[step, dt], fix=_EXPORT)
    angles, rates = [f"th{k + 1}" for k in range(n)], [f"w{k + 1}" for k in range(n)]
    return content_of_channels(
        t,
        dict(zip(angles + rates, joined, strict=True)),
        angles=angles,
        rates=dict(zip(angles, rates, strict=True)),
        declared={"time_unit": "s", "unit": "rad"},
        usual={"zero": "up", "angles": "absolute", "sense": "+x"},
    )


def _pieces(path: PathLike, content: Mapping[str, Any], key: str) -> list[Array]:
    """Return the number arrays of one cell array."""
    cell: npt.NDArray[Any] = content[key]
    pieces = [np.asarray(each) for each in (cell.ravel() if cell.dtype == object else [cell])]
    if not pieces or any(each.ndim != 2 or not each.size or each.dtype.kind != "f" for each in pieces):
        raise InvalidInput(f"{path}: {key} is not a cell of number arrays", got=cell.dtype, fix=_EXPORT)
    return pieces


def read_matlab(path: PathLike, selection: Selection) -> Content:
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
