"""Moves of the arm from angle to angle with rests in between: what a cast is made of."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.core.drive import ANGLE
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import CHANNELS, POWERS, Motion
from hyperflex.motion.profiles import move_pieces

_SLIGHT = 1e-6  # a way at full speed that takes less of a move's time is none


def moves(angles: npt.ArrayLike, rests: npt.ArrayLike, durations: npt.ArrayLike, ramps: npt.ArrayLike = 0.5) -> Motion:
    """Return moves of the arm through given angles, each after a rest and in a time of its own.

    Parameters
    ----------
    angles : (k + 1,) array_like
        Arm angle at the start and after each move, rad.
    rests : (k,) array_like
        Rest before each move, s, >= 0.
    durations : (k,) array_like
        Time of each move, s, > 0.
    ramps : float or (k,) array_like
        Part of its time in which a move speeds up, and in which it slows down, above 0 and at most 0.5; at 0.5 it
        speeds up, then slows down ("bang-bang").

    Returns
    -------
    Motion
        It ends with the last move; the arm stays there.

    Raises
    ------
    InvalidInput
        If the numbers do not fit each other or their ranges.

    Examples
    --------
    >>> motion = moves([-1.5, 1.5, 0.0], rests=[0.0, 0.4], durations=[0.7, 0.5])
    >>> [round(float(angle), 3) for angle in motion.angle([0.35, 1.0, 2.0])]
    [0.0, 1.5, 0.0]
    """
    way = checks.array("angles", angles, (-1,), unit="rad")
    count = way.size - 1
    if count < 1:
        raise InvalidInput("there is no move", got=way.tolist(), allowed="at least two angles")
    rest = checks.array("rests", rests, (count,), sign="nonnegative", unit="s")
    time = checks.array("durations", durations, (count,), sign="positive", unit="s")
    ramp = checks.array("ramps", np.broadcast_to(np.asarray(ramps, dtype=np.float64), (count,)), (count,))
    if (ramp <= 0.0).any() or (ramp > 0.5).any():
        raise InvalidInput("ramps leave their range", got=ramp.tolist(), allowed="above 0 and at most 0.5")
    breaks, rows = [0.0], []
    for k in range(count):
        if rest[k] > 0.0:
            rows.append([way[k]])
            breaks.append(breaks[-1] + rest[k])
        profile = "bang-bang" if ramp[k] > 0.5 - _SLIGHT else "ramp"
        parts, pieces = move_pieces(way[k], way[k + 1], time[k], profile, ramp[k])
        rows += pieces
        breaks += (breaks[-1] + np.cumsum(parts)).tolist()
    coef = np.zeros((len(rows), CHANNELS, POWERS))
    for piece, row in zip(coef, rows, strict=True):
        piece[ANGLE, : len(row)] = row
    spec = {"kind": "moves", "angles": way.tolist(), "rests": rest.tolist(), "durations": time.tolist()}
    spec["ramps"] = ramp.tolist()
    return Motion(np.array(breaks), coef, np.ones(len(breaks), dtype=np.bool_), -1, spec)
