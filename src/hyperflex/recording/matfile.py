"""The MATLAB files of the MultiArm pendulum: free swings of 1, 2, 3, .. links, cut into pieces by their authors.

``Time_id`` and ``Time_vad`` are cells of times (s), ``Y_id`` and ``Y_vad`` cells of arrays (2n, N): n absolute angles
(rad, 0 upright) above n rates (rad/s); ``dt`` is the step (s). The pieces are joined again in order. This is what the
published preparation scripts write (github.com/dynamicslab/MultiArm-Pendulum, MIT licence).
"""

import io
import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.files import PathLike, read_bytes
from hyperflex.recording.declare import Raw

_EXPORT = "Get the file again, or export the data as CSV"
_KEYS = ("Time_id", "Time_vad", "Y_id", "Y_vad", "dt")
# What scipy's reader raises on damaged files, found by cutting and altering real ones.
_DAMAGE = (ValueError, TypeError, KeyError, IndexError, OSError, EOFError, MemoryError, OverflowError, AttributeError)


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
    times = [*_pieces(path, content, "Time_id"), *_pieces(path, content, "Time_vad")]
    states = [*_pieces(path, content, "Y_id"), *_pieces(path, content, "Y_vad")]
    rows = states[0].shape[0]
    if len(times) != len(states) or rows % 2 or rows == 0 or any(y.shape[0] != rows for y in states):
        raise InvalidInput(
            f"{path} has pieces that do not fit together",
            got=[y.shape for y in states][:4],
            allowed="as many times as states, 2n rows in each: n angles, then n rates",
        )
    for k, (t, y) in enumerate(zip(times, states, strict=True)):
        if t.size != y.shape[1]:
            raise InvalidInput(f"{path}: piece {k} has {t.size} times for {y.shape[1]} samples", fix=_EXPORT)
    t = np.concatenate([piece.ravel() for piece in times])
    joined = np.hstack(states).T
    _check_step(path, t, content["dt"])
    n = rows // 2
    return Raw(
        t=t,
        data=joined[:, :n],
        kind="angles",
        rates=joined[:, n:],
        declared={"time_unit": "s", "unit": "rad"},
        usual={"zero": "up", "angles": "absolute", "sense": "+x"},
        source=str(path),
    )


def _load(path: PathLike) -> dict[str, Any]:
    """Return the variables of a MATLAB 5 file."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    raw = read_bytes(path, "MATLAB file")
    if raw[:1] == b"\x89" or b"MATLAB 7.3" in raw[:128]:
        raise InvalidInput(f"{path} is a MATLAB 7.3 file", allowed="MATLAB 5 files", fix="Save it with -v7 in MATLAB")
    if not raw.startswith(b"MATLAB 5.0 MAT-file"):
        raise InvalidInput(f"{path} is no MATLAB 5 file", got=raw[:20], fix="Check that the right file was given")
    try:
        content: dict[str, Any] = loadmat(io.BytesIO(raw))
    except (*_DAMAGE, MatReadError, NotImplementedError, zlib.error, struct.error) as error:
        raise FileProblem(f"The MATLAB file {path} cannot be read: it is damaged or cut off. Get it again.") from error
    return content


def _pieces(path: PathLike, content: dict[str, Any], key: str) -> list[Array]:
    """Return the number arrays of one cell array."""
    cell: npt.NDArray[Any] = content[key]
    pieces = list(cell.ravel()) if cell.dtype == object else [cell]
    if not pieces or any(np.asarray(p).ndim != 2 or np.asarray(p).dtype.kind not in "fiu" for p in pieces):
        raise InvalidInput(f"{path}: {key} is not a cell of number arrays", got=cell.dtype, fix=_EXPORT)
    return [np.asarray(p, dtype=np.float64) for p in pieces]


def _check_step(path: PathLike, t: Array, dt: npt.NDArray[Any]) -> None:
    """Refuse times whose usual step is not the file's own dt (another unit, or a damaged file)."""
    step = float(np.median(np.diff(t))) if t.size > 1 else 0.0
    if dt.size != 1 or not 0.99 * float(dt.ravel()[0]) < step < 1.01 * float(dt.ravel()[0]):
        raise InvalidInput(f"{path}: its times do not step by its dt", got=[step, dt.ravel()[:3].tolist()], fix=_EXPORT)
