"""Motions in files: CSV samples, and tables of a TOML file."""

import inspect
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hyperflex import checks, files
from hyperflex.errors import InvalidInput, located
from hyperflex.motion import profiles
from hyperflex.motion.piecewise import CHANNELS, MEET, POWERS, Motion

MOVES = "moves"  # key of the note with the arguments of ``arm_moves`` as JSON


def read_motion(path: str | Path) -> Motion:
    """Read a sampled arm motion from a CSV file with the columns ``t`` (s) and ``angle`` (rad).

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Motion
        A spline through the samples (:func:`sampled_motion`). For a file written by a plan, the exact moves from the
        note MOVES in its header, if they agree with the samples within MEET: a spline needs up to 1.4 times the
        acceleration next to each of its jumps.

    Raises
    ------
    InvalidInput
        If the columns are others, or a value is missing or not a number.
    """
    table = files.read_table(path)
    if table.names != ["t", "angle"]:
        raise InvalidInput(f"columns of {path} are not those of a motion", got=table.names, allowed="t,angle (s, rad)")
    with located(str(path)):
        sampled = profiles.sampled_motion(t := table.times("t"), angle := table.values[:, 1])
    try:
        exact = profiles.arm_moves(**json.loads(table.notes[MOVES]))
    except (InvalidInput, KeyError, TypeError, ValueError):  # not what a plan wrote
        return sampled
    return exact if np.abs(exact.angle(t) - angle).max() <= MEET else sampled


def from_spec(spec: Mapping[str, Any], folder: Path | None = None) -> Motion:
    """Build the motion that a ``[motion]`` table describes; a file that it names lies in `folder` (or where one is)."""
    kind = checks.choice("motion kind", spec.get("kind"), tuple(MAKERS))
    maker = MAKERS[kind]
    arguments = inspect.signature(maker).parameters.values()
    needed = [each.name for each in arguments if each.default is each.empty]
    checks.keys(f"the motion table of kind {kind!r}", spec, motion_keys(kind), needed=needed)
    rest = {key: value for key, value in spec.items() if key not in ("kind", "delay")}
    if folder is not None and spec.get("kind") == "file" and isinstance(rest.get("path"), str):
        rest["path"] = folder / rest["path"]
    motion = maker(**rest)
    return motion.shifted(spec["delay"]) if "delay" in spec else motion


def motion_keys(kind: object) -> list[str]:
    """Return the keys of a motion table of this kind, or of all kinds where it is none."""
    makers = [MAKERS[kind]] if isinstance(kind, str) and kind in MAKERS else MAKERS.values()
    return ["kind", "delay", *(key for maker in makers for key in inspect.signature(maker).parameters)]


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
    "strokes": profiles.arm_strokes,
    "moves": profiles.arm_moves,
    "sampled": profiles.sampled_motion,
    "moving point": profiles.moving_pivot,
    "torque": profiles.torque_profile,
    "pieces": _from_pieces,
    "file": read_motion,
}
