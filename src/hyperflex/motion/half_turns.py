"""Half turns of the arm at chosen times: the paper's swings with free rests."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.core.chain.drive import ANGLE
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import CHANNELS, POWERS, Motion
from hyperflex.motion.profiles import PATHS, PROFILES, Profile, move_pieces

_MEET = 1e-9  # s: a stroke that starts this much before the last one ends follows it at once


def arm_strokes(
    starts: npt.ArrayLike,
    t_move: float = 0.73,
    profile: Profile = "bang-bang",
    path: Literal["under", "over"] = "under",
    *,
    ramp: float = 0.1,
    made: int = 0,
) -> Motion:
    """Return half turns of the arm, there and back in turn, that start at given instants; it rests in between.

    Parameters
    ----------
    starts : (k,) array_like
        When each half turn starts, s, from 0 on, at least `t_move` apart. None at all: the arm stays where it is.
    t_move : float
        Time of a half turn (t_a in the paper), s.
    profile, path, ramp
        As for :func:`hyperflex.arm_swings`, which this is with equal rests.
    made : int
        Half turns made before; after an even number the arm is at -pi/2, after an odd one at the other end.

    Returns
    -------
    Motion
        It ends with the last half turn; the arm stays there.

    Raises
    ------
    InvalidInput
        A half turn that starts before the last one ends, or before 0.

    Examples
    --------
    >>> motion = arm_strokes([0.0, 1.26, 2.4])
    >>> [round(float(angle), 3) for angle in motion.angle([0.0, 1.0, 2.2, 9.0])]
    [-1.571, 1.571, -1.571, 1.571]
    """
    begin = checks.array("starts", starts, (-1,), sign="nonnegative", unit="s")
    t_move = checks.number("t_move", t_move, sign="positive", unit="s")
    profile = checks.choice("profile", profile, PROFILES)  # type: ignore[assignment]
    path = checks.choice("path", path, PATHS)  # type: ignore[assignment]
    number = checks.count("made", made, least=0)
    _refuse_overlap(begin, t_move)
    ends = (-0.5 * math.pi, (0.5 if path == "under" else -1.5) * math.pi)
    breaks: list[float] = []
    rows: list[list[float]] = []
    now = 0.0
    for k, start in enumerate(begin.tolist(), start=number):
        here, there = ends[k % 2], ends[(k + 1) % 2]
        if start - now > _MEET:
            breaks.append(now)
            rows.append([here])
            now = start
        durations, pieces = move_pieces(here, there, t_move, profile, ramp)
        breaks += [now, *(now + np.cumsum(durations[:-1])).tolist()]
        rows += pieces
        now += t_move
    if not rows:
        breaks, rows, now = [0.0], [[ends[number % 2]]], 1.0
    coef = np.zeros((len(rows), CHANNELS, POWERS))
    for piece, row in zip(coef, rows, strict=True):
        piece[ANGLE, : len(row)] = row
    spec = {"kind": "strokes", "starts": begin.tolist(), "t_move": t_move, "profile": profile, "path": path}
    spec |= {"ramp": ramp, "made": number}
    return Motion(np.array([*breaks, now]), coef, np.ones(len(rows) + 1, dtype=np.bool_), -1, spec)


def _refuse_overlap(starts: checks.Array, t_move: float) -> None:
    early = np.flatnonzero(np.diff(starts) < t_move - _MEET)
    if early.size:
        k = int(early[0])
        raise InvalidInput(
            f"half turn {k + 1} starts before half turn {k} ends",
            got=starts[k : k + 2].tolist(),
            allowed=f"starts at least {t_move:g} s apart",
        )
