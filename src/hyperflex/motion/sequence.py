"""Sequences of arm moves with rests in between: moves through given angles, and half turns at given times."""

from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import MEET, Motion
from hyperflex.motion.profiles import (
    Profile,
    arm_motion,
    checked_half_turn,
    half_turn_ends,
    motion_of_pieces,
    move_pieces,
)

BANG_BANG = 0.5 - 1e-6  # ramp beyond which no way at full speed is left


def arm_moves(
    angles: npt.ArrayLike, rests: npt.ArrayLike, durations: npt.ArrayLike, ramps: npt.ArrayLike = 0.5
) -> Motion:
    """Return moves of the arm through given angles, each after a rest and in a time of its own.

    It ends with the last move; the arm stays there.

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
    checks.meant("angles", way, "rad")
    checks.meant("durations", time, "s")  # rests may be long, as of a live arm that waits
    ramp = checks.array("ramps", ramps, (count,), scalar=True)
    if (ramp <= 0.0).any() or (ramp > 0.5).any():
        raise InvalidInput("ramps leave their range", got=ramp.tolist(), allowed="above 0 and at most 0.5")
    given = {"angles": way.tolist(), "rests": rest.tolist(), "durations": time.tolist(), "ramps": ramp.tolist()}
    return motion_of_pieces(*move_rows(**given), {"kind": "moves", **given})


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

    It ends with the last half turn; the arm stays there.

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
    turn = checked_half_turn(t_move, profile, path, ramp)
    number, t_move = checks.count("made", made, least=0), turn["t_move"]
    _refuse_overlap(begin, t_move)
    ends = half_turn_ends(turn["path"])
    breaks: list[float] = []
    rows: list[list[float]] = []
    now = 0.0
    for k, start in enumerate(begin.tolist(), start=number):
        here, there = ends[k % 2], ends[(k + 1) % 2]
        if start - now > MEET:
            breaks.append(now)
            rows.append([here])
            now = start
        durations, pieces = move_pieces(here, there, t_move, turn["profile"], turn["ramp"])
        breaks += [now, *(now + np.cumsum(durations[:-1])).tolist()]
        rows += pieces
        now += t_move
    if not rows:
        breaks, rows, now = [0.0], [[ends[number % 2]]], 1.0
    spec = {"kind": "strokes", "starts": begin.tolist(), **turn, "made": number}
    return arm_motion(np.array([*breaks, now]), rows, spec)


def _refuse_overlap(starts: checks.Array, t_move: float) -> None:
    early = np.flatnonzero(np.diff(starts) < t_move - MEET)
    if early.size:
        k = int(early[0])
        raise InvalidInput(
            f"half turn {k + 1} starts before half turn {k} ends",
            got=starts[k : k + 2].tolist(),
            allowed=f"starts at least {t_move:g} s apart",
        )
