"""Named arrays, as MATLAB and HDF5 files have them: any by name, or those of the MultiArm pendulum.

The files of the MultiArm pendulum are free swings of 1, 2, 3, .. links, cut into pieces by their authors: ``Time_id``
and ``Time_vad`` are cells of times (s), ``Y_id`` and ``Y_vad`` cells of arrays (2n, N): n absolute angles (rad, 0
upright) above n rates (rad/s); ``dt`` is the step (s). The pieces are joined again in order. This is what the published
preparation scripts write (github.com/dynamicslab/MultiArm-Pendulum, MIT licence).
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.recording.content import Content, Selection, content_of_channels

_EXPORT = "Get the file again, or export the data as CSV"
_KEYS = ("Time_id", "Time_vad", "Y_id", "Y_vad", "dt")
_TIME = re.compile(r"(?i)(.*/)?(t|time|times|timestamps?)")
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
    return content_of_channels(t, channels, str(path), advice=f"Name them: {_EXAMPLE}", assumed=assumed)


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
        str(path),
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
