"""Convert raw columns to a Recording in SI units and the package's axes, by what is declared about them.

Nothing is guessed: what neither the file nor the caller declares is refused, and what both declare must agree.
"""

import itertools
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, located
from hyperflex.options import option
from hyperflex.recording.recording import CONVENTION, Kind, Recording, per_sample, unwrap

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
RADIANS = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "turn": 2.0 * math.pi}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
UNITS: dict[Kind, tuple[str, ...]] = {"angles": tuple(RADIANS), "markers": (*METRES, "px")}
FASTEST = 300.0  # rad/s, 48 turns a second: faster than any pendulum or rope link seen in recordings so far
# s: times beyond 3 years are stamps since 1970, no clock of a lab counts that far from its own start; in the year 2286
# stamps pass the second, and only those in a smaller unit are beyond it now
EPOCHS = 1e8, 1e10
STEEPEST = math.radians(30.0)  # of a fitted plane against the vertical: beyond it the plane is not that of a swing
LONG = 3.5  # usual steps; up to two missing rows leave the slope of a well sampled swing readable

PLANES = {right + up: ("xyz".index(right), "xyz".index(up)) for right, up in itertools.permutations("xyz", 2)}
WORDS = {  # other names of units, in lower case
    **dict.fromkeys(("sec", "second", "seconds"), "s"),
    **dict.fromkeys(("millisecond", "milliseconds", "msec"), "ms"),
    **dict.fromkeys(("°", "º", "degree", "degrees"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("pixel", "pixels"), "px"),
}
OPTIONS: dict[str, tuple[str, ...]] = {
    "time_unit": (*SECONDS, "frame"),
    "y_axis": ("up", "down"),
    "zero": ("hanging", "up"),
    "sense": ("+x", "-x"),
    "angles": ("absolute", "relative"),
    "plane": (*PLANES, "fit"),
    "up": tuple("xyz"),
}
POSITIVE = {"frame_rate": "frames/s", "scale": "m per pixel"}
DEFAULTS = {"zero": "hanging", "sense": "+x", "angles": "absolute"}


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
    plane: str | None = option(None, "plane of the swing, for markers in space: xz (x right, z up), xy, yz, .. or fit")
    up: str | None = option(None, "axis in space that points up, for a fitted plane: x, y or z")
    min_likelihood: float | None = option(None, "likelihood below which a marker is a gap", shown="0.6 for DeepLabCut")


@dataclass(frozen=True, kw_only=True)
class FileNotes:
    """What a file of a recording says beside its numbers.

    ``declared`` binds the caller too; ``usual`` is what the format means unless the caller says otherwise. ``facts``
    are attributes of the recording, of those in FACTS; ``remarks`` what a user should know of how the data were read;
    ``convention``, ``name`` and ``source`` as of :class:`Recording`.
    """

    declared: Mapping[str, Any] = field(default_factory=dict)
    usual: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    convention: str = ""
    name: str = ""
    source: str = ""


@dataclass(frozen=True, kw_only=True)
class Raw(FileNotes):
    """Columns as a file holds them.

    ``data`` is (T, C): angles, x and y of each marker or, ``in_space``, x, y and z of each; ``columns`` are their names
    in the file. ``likelihood`` returns (T, C), 1 where nothing is known; it is read where it is used.
    """

    t: Array
    data: Array
    kind: Kind
    noise: Array | None = None
    rates: Array | None = None
    likelihood: Callable[[], Array] | None = None
    in_space: bool = False
    columns: tuple[str, ...] = ()


def to_recording(raw: Raw, given: Declarations, noise: object, max_rate: float) -> Recording:
    """Return `raw` as a Recording by what the file and the caller (`given`, and `noise` or None) declare."""
    declared = {**DEFAULTS, **raw.usual, **_agreed(raw, asdict(given))}
    with located(raw.source), np.errstate(over="ignore", invalid="ignore"):  # Recording names what is not finite
        _check(raw, declared)
        raw, words = _likely(raw, declared)
        if words and given.min_likelihood is None:
            warnings.warn(f"{raw.source}: {words[0]}. min_likelihood chooses the limit.", UserWarning, stacklevel=3)
        raw, swing = _in_plane(raw, declared)
    std = _agreed(raw, {"noise": noise}).get("noise", raw.noise)
    std = None if std is None else per_sample(std, raw.data)
    time = SECONDS[declared["time_unit"]] if "frame_rate" not in declared else 1.0 / declared["frame_rate"]
    unit, data, rates = declared["unit"], raw.data, raw.rates
    each = 1 if raw.kind == "angles" else 2 if swing is None else 3  # columns of a link or a marker
    size = declared["scale"] if unit == "px" else {**RADIANS, **METRES}[unit]
    if raw.kind == "angles":
        factor = size if declared["sense"] == "+x" else -size
        words.insert(
            0,
            f"as {declared['angles']} angles in {unit}, zero {declared['zero']}, positive towards {declared['sense']}",
        )
    else:
        factor = np.where(np.arange(data.shape[1]) % 2 == 1, -size if declared["y_axis"] == "down" else size, size)
        words.insert(0, f"in {unit}, y {declared['y_axis']}" + (f", {size:g} m per pixel" if unit == "px" else ""))
        words += [] if swing is None else [swing.text(size)]
    with located(raw.source), np.errstate(over="ignore", invalid="ignore"):
        data, rates = data * factor, None if rates is None else rates * factor
        std = None if std is None else std * size
        if raw.kind == "angles":
            data = unwrap(data) if declared.get("wrapped") else data
            if declared["angles"] == "relative":
                data, rates = np.cumsum(data, axis=1), None if rates is None else np.cumsum(rates, axis=1)
                std = None if std is None else np.sqrt(np.cumsum(std**2, axis=1))
            data = data - math.pi if declared["zero"] == "up" else data
            data = _within_a_turn(data) if declared.get("wrapped") else data
        facts, t = dict(raw.facts), raw.t
        if t.size and (epoch := float(t[0]) * time) > EPOCHS[0]:
            if epoch > EPOCHS[1]:  # beyond any date of a recording: in a smaller unit
                known = (f"time_unit={each!r}" for each in SECONDS if EPOCHS[0] < t[0] * SECONDS[each] < EPOCHS[1])
                raise InvalidInput(
                    f"the times begin {epoch / (365.25 * 86400.0):.3g} years after 1970",
                    got=f"time_unit = {declared['time_unit']!r}",
                    allowed="stamps since 1970 up to the year 2286",
                    fix=f"Pass {next(known, 'the right time_unit')}",
                )
            t, facts["epoch"] = t - t[0], epoch
        if swing is not None:
            facts |= {"out_of_plane": swing.rms * size, **({} if swing.tilt is None else {"tilt": swing.tilt})}
        recording = Recording(
            t=t * time,
            data=data,
            kind=raw.kind,
            noise=std,
            rates=rates,
            convention=raw.convention or f"{CONVENTION[raw.kind]}; read {'; '.join([*words, *raw.remarks])}",
            name=raw.name,
            source=raw.source,
            columns=tuple(", ".join(raw.columns[k : k + each]) for k in range(0, len(raw.columns), each)),
            **facts,
        )
    if recording.kind == "angles":
        _check_speed(recording, checks.number("max_rate", max_rate, sign="positive", unit="rad/s"))
    return recording


class _Swing(NamedTuple):
    """The plane of markers in space: root mean square distance from it (unit of the data), and its lean, rad.

    `tilt` is the amplitude of the angle out of it of the lines between markers, rad; None of a marker alone.
    """

    name: str
    rms: float
    lean: float
    tilt: float | None

    def text(self, size: float) -> str:
        """Describe the plane; `size` is the unit of the data, m."""
        off = f" ({math.degrees(self.lean):.1f} degrees from the vertical)" if self.name == "fit" else ""
        tilt = "" if self.tilt is None else f", {math.degrees(self.tilt):.2g} degrees"
        return f"plane {self.name}{off}, {1e3 * size * self.rms:.3g} mm rms of motion out of it{tilt}"


def _likely(raw: Raw, declared: Mapping[str, Any]) -> tuple[Raw, list[str]]:
    """Return the data with gaps where the likelihood is too low, and a text on that."""
    least = declared.get("min_likelihood")
    if raw.likelihood is None or least is None:
        return raw, []
    likelihood = raw.likelihood()
    low = (likelihood < least) & ~np.isnan(raw.data)
    if not low.any():
        return raw, []
    data = np.where(low, np.nan, raw.data)
    if (lost := np.isnan(data).all(axis=0)).any():
        column = int(np.argmax(lost))
        raise InvalidInput(
            f"all positions of marker {column // (3 if raw.in_space else 2)} ({raw.columns[column]}) have a likelihood "
            "below min_likelihood",
            got=least,
            allowed=f"at most {np.nanmax(likelihood[:, column]):.3g}, its largest",
            fix="Train the network further, choose other markers, or pass a smaller min_likelihood",
        )
    count = int(low.any(axis=1).sum())
    return replace(raw, data=data), [f"likelihood below {least:g} in {count} of {raw.t.size} frames: gaps"]


def _in_plane(raw: Raw, declared: Mapping[str, Any]) -> tuple[Raw, _Swing | None]:
    """Return markers in space as x and y in the plane of the swing, and that plane; other data as they are."""
    if not raw.in_space:
        return raw, None
    points = raw.data.reshape(raw.t.size, -1, 3)
    name, axes = declared["plane"], np.eye(3)
    if name == "fit":
        known = points[np.isfinite(points).all(axis=-1)]
        known = known - known.sum(axis=0) / max(len(known), 1)
        normal, vertical = np.linalg.svd(known.T @ known)[0][:, 2], axes["xyz".index(declared["up"])]
        lean = math.asin(min(1.0, abs(float(normal @ vertical))))
        if lean > STEEPEST:
            raise InvalidInput(
                f"the fitted plane of the motion is {math.degrees(lean):.0f} degrees from the vertical",
                got=f"up = {declared['up']!r}",
                allowed=f"at most {math.degrees(STEEPEST):.0f} degrees",
                fix="Pass another up, or the plane itself, such as plane='xz'",
            )
        up = vertical - (vertical @ normal) * normal
        up /= np.linalg.norm(up)
        right = np.cross(up, normal)
        right *= np.sign(right[np.argmax(np.abs(right))])
    else:
        right, up = (axes[k] for k in PLANES[name])
        normal, lean = np.cross(right, up), 0.0
    across = points @ normal
    there = ~np.isnan(across)
    moved = np.where(there, across, 0.0)
    moved -= moved.sum(axis=0) / np.maximum(there.sum(axis=0), 1)  # where a marker sits beside the plane is no motion
    rms = math.sqrt(float((moved[there] ** 2).sum()) / max(int(there.sum()), 1))
    data = np.stack([points @ right, points @ up], axis=-1).reshape(raw.t.size, -1)
    far = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    pairs = far > 0.0  # of markers that are seen
    slope = np.diff(moved, axis=1)[pairs] / far[pairs]
    tilt = math.sqrt(2.0 * float(np.mean(slope**2))) if slope.size else None
    return replace(raw, data=data, in_space=False), _Swing(name, rms, lean, tilt)


def _within_a_turn(angle: Array) -> Array:
    """Return angles (T, n) without the whole turns of each column's first known one."""
    known = ~np.isnan(angle)
    first = np.where(known.any(axis=0), np.take_along_axis(angle, known.argmax(axis=0)[None], axis=0)[0], 0.0)
    return angle - 2.0 * math.pi * np.round(first / (2.0 * math.pi))


def _agreed(raw: Raw, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what caller or file declare; they must agree."""
    result = {}
    for key, argument in given.items():
        file = raw.declared.get(key)
        if argument is not None and file is not None and not np.array_equal(argument, file):
            raise InvalidInput(
                f"{raw.source} declares {key} = {file!r}, the argument something else",
                got=argument,
                fix=f"Omit {key}, or correct the file",
            )
        if argument is not None or file is not None:
            result[key] = file if argument is None else argument
    return result


def unit_name(text: str) -> str:
    """Return the name that declarations have for a unit, such as deg for °; other texts as they are."""
    return WORDS.get(text.lower(), text)


def unit_of(text: str | None) -> dict[str, Any]:
    """Return the declaration of the unit that a text of a file names; none where it names none."""
    return {"unit": unit_name(text)} if text else {}


def frames(rate: float, unit: str | None = None) -> dict[str, Any]:
    """Return the declarations of times that count frames, at a rate, frames/s, and of a unit that a file names."""
    return {"time_unit": "frame", "frame_rate": rate} | unit_of(unit)


def missing_declarations(raw: Raw, declared: Mapping[str, Any]) -> dict[str, str]:
    """Return the declarations that are needed and not in `declared`, each with its allowed values."""
    needed = ["time_unit", "unit", *(key for key, (_, applies) in _applying(raw, declared).items() if applies)]
    allowed = {key: " | ".join(each) for key, each in _choices(raw).items()} | POSITIVE
    return {key: allowed[key] for key in needed if key not in declared and key != "min_likelihood"}


def _choices(raw: Raw) -> dict[str, tuple[str, ...]]:
    return {**OPTIONS, "unit": UNITS[raw.kind]}


def _applying(raw: Raw, declared: Mapping[str, Any]) -> dict[str, tuple[str, bool]]:
    """Return, by declaration, what it is for, and whether that is the case."""
    return {
        "frame_rate": ("times that count frames", declared.get("time_unit") == "frame"),
        "y_axis": ("markers", raw.kind == "markers"),
        "scale": ("markers in pixels", raw.kind == "markers" and declared.get("unit") == "px"),
        "plane": ("markers in space", raw.in_space),
        "up": ("a fitted plane", declared.get("plane") == "fit"),
        "min_likelihood": ("data with likelihoods", raw.likelihood is not None),
    }


def _check(raw: Raw, declared: Mapping[str, Any]) -> None:
    """Refuse what is not known or does not apply, and name all that is still missing."""
    options, applies = _choices(raw), _applying(raw, declared)
    for key, value in declared.items():
        if key in options:
            checks.choice(key, value, options[key])
        elif key in POSITIVE or key == "min_likelihood":
            checks.number(key, value, sign="positive", unit=POSITIVE.get(key, ""))
        if key in applies and not applies[key][1] and value != raw.usual.get(key):
            fix = f"Omit {key}, or declare what {raw.source} holds"
            raise InvalidInput(f"{key} is for {applies[key][0]}", got=value, fix=fix)
    if missing := missing_declarations(raw, declared):
        raise InvalidInput(
            f"{raw.source} holds {raw.kind}{' in space' if raw.in_space else ''}, but not all that is needed to read "
            "them is declared",
            fix=f"Pass {', '.join(f'{key}=... ({allowed})' for key, allowed in missing.items())}; nothing is guessed",
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
                f"{recording.source}: {recording.label(k)} turns by {turn[worst]:.4g} rad within {step[worst]:.4g} s "
                f"at t = {recording.t[known][worst]:.6g} s",
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
                f"{recording.source}: the rates of {recording.label(k)} are not the slope of its angles, which change "
                f"{slope:.4g} times as fast",
                allowed="a factor near 1",
                fix="About 57 or 0.017 tells of degrees in one and radians in the other, a power of 1000 of times in "
                "another unit, a negative one of another sense. Declare the right unit, or leave the rates out",
            )
