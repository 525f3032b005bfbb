"""Derivatives of a motion by its parameters: of its breaks and coefficients."""

from collections.abc import Callable
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import Motion
from hyperflex.motion.profiles import move_pieces, moving_pivot, sampled_motion, swing_pieces, torque_profile
from hyperflex.motion.sequence import BANG_BANG, move_rows

_TINY = 1e-40  # of a complex step: no difference is formed, so nothing is lost


# kind: (durations and coefficients of its pieces, the parameters that may vary; of a list each number)
_FORMULAS: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "hold": (lambda angle: ([1.0], [[angle]]), ("angle",)),
    "move": (move_pieces, ("start", "end", "duration", "ramp")),
    "swings": (swing_pieces, ("t_move", "t_rest", "ramp")),
    "moves": (move_rows, ("angles", "rests", "durations", "ramps")),
}
# motions that depend linearly on their samples
_SAMPLES: dict[str, tuple[Callable[..., Motion], tuple[str, ...]]] = {
    "sampled": (sampled_motion, ("angle",)),
    "moving point": (moving_pivot, ("x", "y")),
    "torque": (torque_profile, ("torque",)),
}


def motion_parameters(motion: Motion) -> list[str]:
    """Return the names by which a motion can vary: its times and angles, each of its samples, and its delay."""
    names = ["delay"]
    for name in {**_FORMULAS, **_SAMPLES}.get(motion.spec.get("kind", ""), (None, ()))[1]:
        value = motion.spec[name]
        names += [f"{name}[{i}]" for i in range(len(value))] if isinstance(value, list) else [name]
    return names


def motion_derivatives(motion: Motion, name: str) -> tuple[Array, Array]:
    """Return the derivatives of a motion's breaks (k + 1,) and coefficients (k, 4, 6) with respect to a parameter.

    Parameters
    ----------
    motion : Motion
    name : str
        One of :func:`motion_parameters`.

    Raises
    ------
    InvalidInput
        If the motion has no such parameter, or was not made from parameters (joined, read from pieces).
    """
    if name not in motion_parameters(motion):
        raise InvalidInput(
            f"motion of kind {motion.spec.get('kind', 'pieces')!r} has no parameter of that name",
            got=name,
            allowed=", ".join(motion_parameters(motion)),
            fix="For any other change give the derivatives of breaks and coef themselves",
        )
    if name == "delay":
        return np.ones_like(motion.breaks), np.zeros_like(motion.coef)
    kind = motion.spec["kind"]
    if kind in _SAMPLES:
        return _of_sample(motion, kind, name)
    durations, rows = _FORMULAS[kind][0](**_complex_step(motion, name))
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


def _complex_step(motion: Motion, name: str) -> dict[str, Any]:
    """Return the parameters of a motion, of which one, such as ``rests[2]``, has a tiny imaginary part."""
    key, _, index = name.rstrip("]").partition("[")
    values = {key: value for key, value in motion.spec.items() if key not in ("kind", "delay")}
    value = values[key][int(index)] if index else values[key]
    if (key in ("rests", "t_rest") and value == 0.0) or (key == "ramps" and value > BANG_BANG):
        raise InvalidInput(
            f"motion without a rest or a ramp cannot vary {name}", got=value, allowed="a rest > 0, in s, a ramp < 0.5"
        )
    value = value + 1j * _TINY
    if index:
        value = [*values[key][: int(index)], value, *values[key][int(index) + 1 :]]
    return values | {key: value}
