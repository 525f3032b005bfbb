"""Derivatives of a motion by its parameters: of its breaks and coefficients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import Motion
from hyperflex.motion.profiles import move_pieces, moving_pivot, sampled_motion, swing_pieces, torque_profile
from hyperflex.motion.sequence import BANG_BANG, move_rows

Pieces = tuple[list[complex], list[list[complex]]]
_TINY = 1e-40  # of a complex step: no difference is formed, so nothing is lost


def _hold_pieces(angle: complex) -> Pieces:
    return [1.0], [[angle]]


# kind: (its pieces, the parameters that may vary)
_FORMULAS: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "hold": (_hold_pieces, ("angle",)),
    "move": (move_pieces, ("start", "end", "duration", "ramp")),
    "swings": (swing_pieces, ("t_move", "t_rest", "ramp")),
}
# kind: (its pieces from lists of numbers, the lists, each of whose numbers may vary)
_LISTS: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "moves": (move_rows, ("angles", "rests", "durations", "ramps"))
}
# motions that depend linearly on their samples
_SAMPLES: dict[str, tuple[Callable[..., Motion], tuple[str, ...]]] = {
    "sampled": (sampled_motion, ("angle",)),
    "moving point": (moving_pivot, ("x", "y")),
    "torque": (torque_profile, ("torque",)),
}


def parameters(motion: Motion) -> list[str]:
    """Return the names by which a motion can vary: its times and angles, each of its samples, and its delay."""
    kind = motion.spec.get("kind")
    names = ["delay"]
    if kind in _FORMULAS:
        names += _FORMULAS[kind][1]
    if kind in _LISTS:
        names += [f"{name}[{i}]" for name in _LISTS[kind][1] for i in range(len(motion.spec[name]))]
    if kind in _SAMPLES:
        names += [f"{name}[{i}]" for name in _SAMPLES[kind][1] for i in range(len(motion.spec["t"]))]
    return names


def variation(motion: Motion, name: str) -> tuple[Array, Array]:
    """Return the derivatives of a motion's breaks (k + 1,) and coefficients (k, 4, 6) with respect to a parameter.

    Parameters
    ----------
    motion : Motion
    name : str
        One of :func:`parameters`.

    Raises
    ------
    InvalidInput
        If the motion has no such parameter, or was not made from parameters (joined, read from pieces).
    """
    if name not in parameters(motion):
        raise InvalidInput(
            f"motion of kind {motion.spec.get('kind', 'pieces')!r} has no parameter of that name",
            got=name,
            allowed=", ".join(parameters(motion)),
            fix="For any other change give the derivatives of breaks and coef themselves",
        )
    if name == "delay":
        return np.ones_like(motion.breaks), np.zeros_like(motion.coef)
    kind = motion.spec["kind"]
    if kind in _SAMPLES:
        return _of_sample(motion, kind, name)
    formula, _ = _FORMULAS.get(kind) or _LISTS[kind]
    values = {key: value for key, value in motion.spec.items() if key not in ("kind", "delay")}
    if kind in _LISTS:
        values = _turned(values, name)
    else:
        if values[name] == 0.0 and name == "t_rest":
            raise InvalidInput("swings without a rest cannot vary it", got=0.0, allowed="t_rest > 0, in s")
        values[name] += 1j * _TINY
    durations, rows = formula(**values)
    breaks = np.concatenate([[0.0], np.cumsum(np.imag(durations))]) / _TINY
    coef = np.zeros_like(motion.coef)
    for piece, row in zip(coef, rows, strict=True):
        piece[ANGLE, : len(row)] = np.imag(row) / _TINY
    return breaks, coef


def _of_sample(motion: Motion, kind: str, name: str) -> tuple[Array, Array]:
    """A spline through samples depends linearly on them: its derivative is the spline through a unit sample."""
    maker, channels = _SAMPLES[kind]
    channel, _, index = name.rstrip("]").partition("[")
    t = motion.spec["t"]
    samples = {key: np.zeros(len(t)) for key in channels}
    samples[channel][int(index)] = 1.0
    return np.zeros_like(motion.breaks), np.array(maker(t, **samples).coef)


def _turned(values: dict[str, Any], name: str) -> dict[str, Any]:
    """Return lists of numbers, one of which, as ``rests[2]``, goes a tiny step along the imaginary axis."""
    key, _, index = name.rstrip("]").partition("[")
    changed = list(values[key])
    if (key == "rests" and changed[int(index)] == 0.0) or (key == "ramps" and changed[int(index)] > BANG_BANG):
        raise InvalidInput(
            f"{name} cannot vary where it is", got=changed[int(index)], allowed="a rest > 0, a ramp < 0.5"
        )
    changed[int(index)] += 1j * _TINY
    return {**values, key: changed}
