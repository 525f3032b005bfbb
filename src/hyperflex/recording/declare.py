"""Convert raw columns to a Recording in SI units and the package's axes, by what is declared about them.

Nothing is guessed: what neither the file nor the caller declares is refused, and what both declare must agree.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypedDict

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, located
from hyperflex.options import option, options_of
from hyperflex.recording.recording import CONVENTION, Kind, Recording, per_sample, unwrap

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
RADIANS = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "turn": 2.0 * math.pi}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
FASTEST = 300.0  # rad/s, 48 turns a second: faster than any pendulum or rope link seen in recordings so far
LONG = 3.5  # usual steps; up to two missing rows leave the slope of a well sampled swing readable
HUGE = 1e60  # no measurement; larger ones overflow where products of angles, rates and times are squared

OPTIONS: dict[str, tuple[str, ...]] = {
    "time_unit": (*SECONDS, "frame"),
    "y_axis": ("up", "down"),
    "zero": ("hanging", "up"),
    "sense": ("+x", "-x"),
    "angles": ("absolute", "relative"),
}
DEFAULTS = {"zero": "hanging", "sense": "+x", "angles": "absolute"}


class DeclarationFields(TypedDict, total=False):
    """Fields of :class:`Declarations` as arguments of a function."""

    time_unit: str | None
    unit: str | None
    frame_rate: float | None
    y_axis: str | None
    scale: float | None
    zero: str | None
    sense: str | None
    angles: str | None
    wrapped: bool | None


@dataclass(frozen=True)
class Declarations:
    """What the numbers of a file mean; None where the file declares it. See :func:`hyperflex.read_recording`."""

    time_unit: str | None = option(None, f"unit of the times: {', '.join(OPTIONS['time_unit'])}")
    unit: str | None = option(None, f"unit of the data: {', '.join((*RADIANS, *METRES))}, px")
    frame_rate: float | None = option(None, "frames in a second, for times that count frames")
    y_axis: str | None = option(None, "direction of the markers' y axis: up or down")
    scale: float | None = option(None, "length of a pixel, m")
    zero: str | None = option(None, "where angles are 0: hanging or up")
    sense: str | None = option(None, "side to which angles grow: +x or -x")
    angles: str | None = option(None, "absolute, or relative to the link before")
    wrapped: bool | None = option(None, "whether angles jump by whole turns")


@dataclass(frozen=True)
class Raw:
    """Columns as a file holds them, and what the file declares about them.

    ``declared`` binds the caller too; ``usual`` is what the format means unless the caller says otherwise.
    """

    t: Array
    data: Array
    kind: Kind
    noise: Array | None = None
    rates: Array | None = None
    declared: Mapping[str, object] = field(default_factory=dict)
    usual: Mapping[str, object] = field(default_factory=dict)
    convention: str = ""
    name: str = ""
    source: str = ""
    lines: Sequence[int] = ()  # of the file, one a sample, where it has lines


def to_recording(raw: Raw, given: Declarations, noise: object, max_rate: float) -> Recording:
    """Return `raw` as a Recording by what the file and the caller (`given`, and `noise` or None) declare."""
    declared = _declarations(raw, given)
    _require_all(raw, declared)
    _check_size(raw)
    t = _seconds(raw, declared)
    convert = _angles if raw.kind == "angles" else _markers
    data, std, rates, convention = convert(raw, declared, _noise(raw, noise))
    with located(raw.source):
        recording = Recording(t, data, raw.kind, std, rates, raw.convention or convention, raw.name, raw.source)
    if recording.kind == "angles":
        _check_speed(recording, checks.number("max_rate", max_rate, sign="positive", unit="rad/s"))
    return recording


def _check_size(raw: Raw) -> None:
    """Refuse infinite and absurdly large numbers before anything is computed with them."""
    for name, values in (("t", raw.t), ("data", raw.data), ("rates", raw.rates), ("noise", raw.noise)):
        bad = np.argwhere(np.abs(values) > HUGE) if values is not None else np.empty((0, 0))
        if values is not None and bad.size:
            place = tuple(int(k) for k in bad[0])
            line = f", line {raw.lines[place[0]]}" if raw.lines else ""
            raise InvalidInput(
                f"{raw.source}{line}: {name}{list(place)} cannot be used",
                got=float(values[place]),
                allowed=f"finite numbers up to {HUGE:g} in size (NaN marks a gap)",
            )


def _noise(raw: Raw, given: object) -> Array | None:
    """Return the noise of each sample: the caller's, which must not contradict a note, or the file's."""
    note = raw.declared.get("noise")
    own = raw.noise if note is None else note
    if given is None:
        return None if own is None else per_sample(own, raw.data)
    noise = per_sample(given, raw.data)
    if note is not None and not np.array_equal(noise, per_sample(note, raw.data)):
        raise InvalidInput(
            f"{raw.source} declares noise = {note!r}, the argument something else",
            got=given,
            fix="Leave noise out, or mend the file",
        )
    return noise


def _declarations(raw: Raw, given: Declarations) -> dict[str, object]:
    """Return what is declared: caller and file must agree; else the format's convention or the default."""
    result: dict[str, object] = {**DEFAULTS, **raw.usual}
    for key in (each.name for each in options_of(Declarations)):
        argument, file = getattr(given, key), raw.declared.get(key)
        if argument is not None and file is not None and argument != file:
            raise InvalidInput(
                f"{raw.source} declares {key} = {file!r}, the argument something else",
                got=argument,
                fix=f"Leave {key} out, or mend the file",
            )
        value = file if argument is None else argument
        if value is not None:
            result[key] = value
    return result


def _require_all(raw: Raw, declared: Mapping[str, object]) -> None:
    """Refuse with the names of all arguments that are still missing."""
    required = {"time_unit": OPTIONS["time_unit"], "unit": tuple(RADIANS)}
    if raw.kind == "markers":
        required = {"time_unit": OPTIONS["time_unit"], "unit": (*METRES, "px"), "y_axis": OPTIONS["y_axis"]}
    missing = [key for key in required if key not in declared]
    if declared.get("time_unit") == "frame" and "frame_rate" not in declared:
        missing.append("frame_rate")
    if declared.get("unit") == "px" and "scale" not in declared:
        missing.append("scale")
    if missing:
        words = {key: f"{key}=... ({' | '.join(options)})" for key, options in required.items()}
        words |= {"frame_rate": "frame_rate=... (frames/s)", "scale": "scale=... (m per pixel)"}
        raise InvalidInput(
            f"{raw.source} holds {raw.kind}, but not all that is needed to read them is declared",
            fix=f"Pass {', '.join(words[key] for key in missing)}; nothing is guessed",
        )


def _seconds(raw: Raw, declared: Mapping[str, object]) -> Array:
    unit = checks.choice("time_unit", declared.get("time_unit"), OPTIONS["time_unit"])
    if unit == "frame":
        return raw.t / checks.number("frame_rate", declared.get("frame_rate"), sign="positive", unit="frames/s")
    if declared.get("frame_rate") is not None:
        raise InvalidInput(
            "frame_rate is given, but the times are in " + unit,
            got=declared.get("frame_rate"),
            fix="Leave frame_rate out, or pass time_unit='frame' if the time column counts frames",
        )
    return raw.t * SECONDS[unit]


Converted = tuple[Array, Array | None, Array | None, str]


def _angles(raw: Raw, declared: Mapping[str, object], noise: Array | None) -> Converted:
    """Return absolute angles in rad from hanging, their noise, rates, and what was done."""
    unit = checks.choice("unit", declared.get("unit"), tuple(RADIANS))
    zero, sense, kind = (checks.choice(key, declared.get(key), OPTIONS[key]) for key in ("zero", "sense", "angles"))
    for key in ("y_axis", "scale"):
        if declared.get(key) is not None:
            fix = f"Leave {key} out"
            raise InvalidInput(f"{key} is for markers, but {raw.source} holds angles", got=declared[key], fix=fix)
    factor = RADIANS[unit] * (1.0 if sense == "+x" else -1.0)
    data = raw.data * factor
    rates = None if raw.rates is None else raw.rates * factor
    noise = None if noise is None else noise * abs(factor)
    if declared.get("wrapped"):
        data = unwrap(data)
    if kind == "relative":
        data = np.cumsum(data, axis=1)
        rates = None if rates is None else np.cumsum(rates, axis=1)
        noise = None if noise is None else np.sqrt(np.cumsum(noise**2, axis=1))
    if zero == "up":
        data = data - math.pi
    text = f"absolute link angles in rad, 0 hanging, positive towards +x; read as {kind} angles in {unit}, "
    return data, noise, rates, text + f"zero {zero}, positive towards {sense}"


def _markers(raw: Raw, declared: Mapping[str, object], noise: Array | None) -> Converted:
    """Return marker positions in m with y up, their noise, and what was done."""
    unit = checks.choice("unit", declared.get("unit"), (*METRES, "px"))
    y_axis = checks.choice("y_axis", declared.get("y_axis"), OPTIONS["y_axis"])
    if unit == "px":
        factor = checks.number("scale", declared.get("scale"), sign="positive", unit="m per pixel")
    elif declared.get("scale") is not None:
        fix = "Leave scale out, or declare unit='px'"
        raise InvalidInput(f"scale is for pixels, but the positions are in {unit}", got=declared["scale"], fix=fix)
    else:
        factor = METRES[unit]
    flip = np.where(np.arange(raw.data.shape[1]) % 2 == 1, -1.0 if y_axis == "down" else 1.0, 1.0)
    noise = None if noise is None else noise * factor
    text = f"{CONVENTION['markers']}; read in {unit}, y {y_axis}"
    if unit == "px":
        text += f", {factor:g} m per pixel"
    return raw.data * factor * flip, noise, None, text


def _check_speed(recording: Recording, fastest: float) -> None:
    """Notice wrong units of angles: links that turn impossibly fast, or rates that are not the angles' slope."""
    for k, column in enumerate(recording.data.T):
        known = ~np.isnan(column)
        turn, step = np.diff(column[known]), np.diff(recording.t[known])
        too_fast = np.abs(turn) > fastest * step
        if too_fast.any():
            worst = int(np.argmax(np.abs(turn) / step))
            raise InvalidInput(
                f"{recording.source}: link {k} turns by {turn[worst]:.4g} rad within {step[worst]:.4g} s at t = "
                f"{recording.t[known][worst]:.6g} s",
                allowed=f"at most max_rate = {fastest:g} rad/s",
                fix="Are the angles in degrees (unit='deg'), wrapped at a whole turn (wrapped=True), or the times in "
                "another unit (time_unit='ms')? If the link is truly that fast, pass a larger max_rate",
            )
    if recording.rates is not None:
        _check_rates(recording, recording.rates)


def _check_rates(recording: Recording, rates: Array) -> None:
    """Refuse rates that are off from the slope of the angles by more than a factor of two, or by sign.

    Steps much longer than the usual one, where rows are missing, tell nothing: the rate changes meanwhile.
    """
    turn, step = np.diff(recording.data, axis=0), np.diff(recording.t)[:, None]
    expected = 0.5 * (rates[1:] + rates[:-1]) * step
    both = ~(np.isnan(turn) | np.isnan(expected)) & (step < LONG * np.median(step))
    for k in range(recording.data.shape[1]):
        seen, told = turn[both[:, k], k], expected[both[:, k], k]
        if seen.size < 10 or not told @ told > 0.0:
            continue
        slope = float(seen @ told / (told @ told))
        if not 0.5 < slope < 2.0:
            raise InvalidInput(
                f"{recording.source}: the rates of link {k} are not the slope of its angles, which change {slope:.4g} "
                "times as fast",
                allowed="a factor near 1",
                fix="About 57 or 0.017 tells of degrees in one and radians in the other, a power of 1000 of times in "
                "another unit, a negative one of another sense. Declare the right unit, or leave the rates out",
            )
