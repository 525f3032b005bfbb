"""Motions in files: CSV samples, and tables of a TOML file."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hyperflex import checks, files
from hyperflex.errors import InvalidInput
from hyperflex.motion import profiles
from hyperflex.motion.piecewise import CHANNELS, POWERS, Motion
from hyperflex.motion.sequence import arm_moves, arm_strokes

MOVES = "moves"  # key of the note with the arguments of ``arm_moves`` as JSON
AGREE = 1e-9  # rad


def read_motion(path: str | Path) -> Motion:
    """Read a sampled arm motion from a CSV file with the columns ``t`` (s) and ``angle`` (rad).

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Motion
        A spline through the samples (:func:`sampled_motion`). Where a plan wrote the file, its own moves, from the note
        MOVES in its head, if they agree with the samples within AGREE: a spline asks up to 1.4 times the acceleration
        beside each of its jumps.

    Raises
    ------
    InvalidInput
        If the columns are others, or a value is missing or not a number.
    """
    names, table = files.read_table(path)
    if list(names) != ["t", "angle"]:
        raise InvalidInput(f"columns of {path} are not those of a motion", got=list(names), allowed="t,angle (s, rad)")
    sampled = profiles.sampled_motion(table[:, 0], table[:, 1])
    try:
        exact = arm_moves(**json.loads(files.read_notes(path)[MOVES]))
    except (InvalidInput, KeyError, TypeError, ValueError):  # not what a plan wrote
        return sampled
    return exact if np.abs(exact.angle(table[:, 0]) - table[:, 1]).max() <= AGREE else sampled


def from_spec(spec: Mapping[str, Any], folder: Path | None = None) -> Motion:
    """Build the motion that a ``[motion]`` table describes; a file that it names lies in `folder` (or where one is)."""
    rest = {key: value for key, value in spec.items() if key not in ("kind", "delay")}
    if folder is not None and spec.get("kind") == "file" and isinstance(rest.get("path"), str):
        rest["path"] = folder / rest["path"]
    maker = MAKERS[checks.choice("motion kind", spec.get("kind"), tuple(MAKERS))]
    try:
        motion = maker(**rest)
    except TypeError as error:
        raise InvalidInput(f"motion table of kind {spec['kind']!r} does not fit ({error})", got=dict(rest)) from None
    return motion.shifted(spec["delay"]) if "delay" in spec else motion


def to_spec(motion: Motion) -> dict[str, Any]:
    """Return a table for a TOML file from which :func:`from_spec` builds the same motion again."""
    if motion.spec:
        return dict(motion.spec)
    return {
        "kind": "pieces",
        "breaks": motion.breaks.tolist(),
        "coef": motion.coef.ravel().tolist(),
        "switch": motion.switch.tolist(),
        "loop": motion.loop,
    }


def _from_pieces(breaks: list[float], coef: list[float], switch: list[bool], loop: int) -> Motion:
    flat = checks.array("coef", coef, (-1,))
    if flat.size != (np.size(breaks) - 1) * CHANNELS * POWERS:
        raise InvalidInput("coef has the wrong size", got=flat.size, allowed=f"{CHANNELS * POWERS} numbers a piece")
    return Motion(np.array(breaks), flat.reshape(-1, CHANNELS, POWERS), np.array(switch), loop)


MAKERS: dict[str, Callable[..., Motion]] = {  # of motions, by the kind of their table
    "hold": profiles.hold_arm,
    "move": profiles.move_arm,
    "swings": profiles.arm_swings,
    "strokes": arm_strokes,
    "moves": arm_moves,
    "sampled": profiles.sampled_motion,
    "moving point": profiles.moving_pivot,
    "torque": profiles.torque_profile,
    "pieces": _from_pieces,
    "file": read_motion,
}
