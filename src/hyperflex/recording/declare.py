"""Convert raw columns to a Recording in SI units and the package's axes, by what is declared about them.

Nothing is guessed: what neither the file nor the caller declares is refused, and what both declare must agree.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, TypedDict

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, located
from hyperflex.options import option
from hyperflex.recording.recording import CONVENTION, Kind, Recording, per_sample, unwrap

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
RADIANS = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "turn": 2.0 * math.pi}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
UNITS: dict[Kind, tuple[str, ...]] = {"angles": tuple(RADIANS), "markers": (*METRES, "px")}
FASTEST = 300.0  # rad/s, 48 turns a second: faster than any pendulum or rope link seen in recordings so far
LONG = 3.5  # usual steps; up to two missing rows leave the slope of a well sampled swing readable

OPTIONS: dict[str, tuple[str, ...]] = {
    "time_unit": (*SECONDS, "frame"),
    "y_axis": ("up", "down"),
    "zero": ("hanging", "up"),
    "sense": ("+x", "-x"),
    "angles": ("absolute", "relative"),
}
POSITIVE = {"frame_rate": "frames/s", "scale": "m per pixel"}
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
    declared: Mapping[str, Any] = field(default_factory=dict)
    usual: Mapping[str, Any] = field(default_factory=dict)
    convention: str = ""
    name: str = ""
    source: str = ""


def to_recording(raw: Raw, given: Declarations, noise: object, max_rate: float) -> Recording:
    """Return `raw` as a Recording by what the file and the caller (`given`, and `noise` or None) declare."""
    declared = {**DEFAULTS, **raw.usual, **_agreed(raw, asdict(given))}
    with located(raw.source):
        _check(raw, declared)
    std = _agreed(raw, {"noise": noise}).get("noise", raw.noise)
    std = None if std is None else per_sample(std, raw.data)
    time = SECONDS[declared["time_unit"]] if "frame_rate" not in declared else 1.0 / declared["frame_rate"]
    unit, data, rates = declared["unit"], raw.data, raw.rates
    size = declared["scale"] if unit == "px" else {**RADIANS, **METRES}[unit]
    if raw.kind == "angles":
        factor = size if declared["sense"] == "+x" else -size
        words = (
            f"as {declared['angles']} angles in {unit}, zero {declared['zero']}, positive towards {declared['sense']}"
        )
    else:
        factor = np.where(np.arange(data.shape[1]) % 2 == 1, -size if declared["y_axis"] == "down" else size, size)
        words = f"in {unit}, y {declared['y_axis']}" + (f", {size:g} m per pixel" if unit == "px" else "")
    with located(raw.source), np.errstate(over="ignore", invalid="ignore"):  # Recording names what is not finite
        data, rates = data * factor, None if rates is None else rates * factor
        std = None if std is None else std * size
        if raw.kind == "angles":
            data = unwrap(data) if declared.get("wrapped") else data
            if declared["angles"] == "relative":
                data, rates = np.cumsum(data, axis=1), None if rates is None else np.cumsum(rates, axis=1)
                std = None if std is None else np.sqrt(np.cumsum(std**2, axis=1))
            data = data - math.pi if declared["zero"] == "up" else data
        read = f"{CONVENTION[raw.kind]}; read {words}"
        recording = Recording(raw.t * time, data, raw.kind, std, rates, raw.convention or read, raw.name, raw.source)
    if recording.kind == "angles":
        _check_speed(recording, checks.number("max_rate", max_rate, sign="positive", unit="rad/s"))
    return recording


def _agreed(raw: Raw, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what caller or file declare; they must agree."""
    result = {}
    for key, argument in given.items():
        file = raw.declared.get(key)
        if argument is not None and file is not None and not np.array_equal(argument, file):
            raise InvalidInput(
                f"{raw.source} declares {key} = {file!r}, the argument something else",
                got=argument,
                fix=f"Omit {key}, or mend the file",
            )
        if argument is not None or file is not None:
            result[key] = file if argument is None else argument
    return result


def _check(raw: Raw, declared: Mapping[str, Any]) -> None:
    """Refuse what is not known or does not apply, and name all that is still missing."""
    options = {**OPTIONS, "unit": UNITS[raw.kind]}
    applies = {
        "frame_rate": ("times that count frames", declared.get("time_unit") == "frame"),
        "y_axis": ("markers", raw.kind == "markers"),
        "scale": ("markers in pixels", raw.kind == "markers" and declared.get("unit") == "px"),
    }
    for key, value in declared.items():
        if key in options:
            checks.choice(key, value, options[key])
        elif key in POSITIVE:
            checks.number(key, value, sign="positive", unit=POSITIVE[key])
        if key in applies and not applies[key][1]:
            fix = f"Omit {key}, or declare what {raw.source} holds"
            raise InvalidInput(f"{key} is for {applies[key][0]}", got=value, fix=fix)
    needed = ["time_unit", "unit", *(key for key, (_, needed) in applies.items() if needed)]
    if missing := [key for key in needed if key not in declared]:
        allowed = {key: " | ".join(each) for key, each in options.items()} | POSITIVE
        raise InvalidInput(
            f"{raw.source} holds {raw.kind}, but not all that is needed to read them is declared",
            fix=f"Pass {', '.join(f'{key}=... ({allowed[key]})' for key in missing)}; nothing is guessed",
        )


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
