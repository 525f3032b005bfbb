"""Sequences of arm moves with rests in between, as a cast uses them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.core.chain.drive import ANGLE
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import CHANNELS, POWERS, Motion
from hyperflex.motion.profiles import move_pieces

BANG_BANG = 0.5 - 1e-6  # ramp beyond which no way at full speed is left


def arm_moves(
    angles: npt.ArrayLike, rests: npt.ArrayLike, durations: npt.ArrayLike, ramps: npt.ArrayLike = 0.5
) -> Motion:
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
    >>> motion = arm_moves([-1.5, 1.5, 0.0], rests=[0.0, 0.4], durations=[0.7, 0.5])
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
    parts, rows = move_rows(way.tolist(), rest.tolist(), time.tolist(), ramp.tolist())
    breaks = np.concatenate([[0.0], np.cumsum(parts)])
    coef = np.zeros((len(rows), CHANNELS, POWERS))
    for piece, row in zip(coef, rows, strict=True):
        piece[ANGLE, : len(row)] = row
    spec = {"kind": "moves", "angles": way.tolist(), "rests": rest.tolist(), "durations": time.tolist()}
    spec["ramps"] = ramp.tolist()
    return Motion(breaks, coef, np.ones(breaks.size, dtype=np.bool_), -1, spec)


def move_rows(
    angles: list[float], rests: list[float], durations: list[float], ramps: list[float]
) -> tuple[list[float], list[list[float]]]:
    """Durations and coefficients of the pieces of :func:`arm_moves`; takes complex numbers too."""
    parts: list[float] = []
    rows: list[list[float]] = []
    for start, end, rest, time, ramp in zip(angles[:-1], angles[1:], rests, durations, ramps, strict=True):
        if rest != 0.0:
            parts.append(rest)
            rows.append([start])
        profile = "bang-bang" if np.real(ramp) > BANG_BANG else "ramp"
        pieces = move_pieces(start, end, time, profile, ramp)
        parts += pieces[0]
        rows += pieces[1]
    return parts, rows
