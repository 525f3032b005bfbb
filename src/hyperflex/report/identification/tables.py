"""Tables of an identification in units for people: parameters, ratios, the rope, the recording and the fit."""

import platform
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from hyperflex.identification import BAND, Identification
from hyperflex.model import LINK_PROPERTIES, PROPERTIES, RATIOS, Label, Rope, parse_label
from hyperflex.recording import Recording
from hyperflex.report.page import TextTable, environment
from hyperflex.report.units import amount, readable_unit, rounded, short

LAWS = {
    "": "",
    "shared": ", of each link alike",
    "inner": ", of each link but the first alike",
    "factor": ", factor on the guess of all links",
    "taper": ", at the tip over that at the first joint (relative to the guess)",
}


@dataclass(frozen=True)
class Number:
    """One free number: its label as in the assessment, the property's name, which link or marker, and its law.

    value, std, low and high (95 %), and start (the first guess) are in SI units. Where the data set no limits, std is
    inf, and low and high are NaN.
    """

    label: str
    name: str
    place: int | None
    law: str
    value: float
    std: float
    low: float
    high: float
    start: float


def predicted(found: Identification) -> tuple[str, str]:
    """Return how much predictions err as far as they are foreseeable, and a note on all, if these are more."""
    held = found.held_out
    if held is None or not np.isfinite(held.error):
        return ("none" if held is None else "failed"), ""
    part = f"in the foreseeable {100.0 * held.foreseen:.0f} %, {amount(held.error_of_all, found.unit)} in all"
    return amount(held.error, found.unit), part if held.foreseen < 1.0 else ""


def described(label: str, words: str = "") -> str:
    """Return what a label such as ``friction[2]`` stands for, with `words` for its property."""
    name, place, law = parse_label(label) or Label(label, None, "")
    words = words or name.replace("_", " ")
    return words + (LAWS[law] if place is None else f", {PROPERTIES[name].owner} {place}")


def numbers(found: Identification) -> tuple[Number, ...]:
    """Return all free numbers with the intervals of the identification, or value plus and minus 1.96 std."""
    return tuple(_number(found, *each) for each in zip(found.parameters, found.starts.tolist(), strict=True))


def _number(found: Identification, label: str, start: float) -> Number:
    name, place, law = parse_label(label) or Label(label, None, "")
    key = label if law in ("factor", "taper") else name
    which = -1 if law == "inner" else place or 0
    value, std = (float(np.atleast_1d(each[key])[which]) for each in (found.values, found.std))
    linear = law == "taper" or (PROPERTIES[name].form == "linear" and law != "factor")
    every = np.array([value, std, *_interval(found, label, value, std, signed=linear), start])
    if law == "taper":  # the fit knows its logarithm
        every = np.exp(every)
        every[1] = every[0] * std
    return Number(label, name, place, law, *every.tolist())


def _interval(found: Identification, label: str, value: float, std: float, *, signed: bool) -> tuple[float, float]:
    """Return the 95 % interval of the identification, or value plus and minus 1.96 std without one."""
    if not np.isfinite(std):
        return np.nan, np.nan
    if label in found.intervals:
        return float(found.intervals[label].low), float(found.intervals[label].high)
    return max(value - BAND * std, -np.inf if signed else 0.0), value + BAND * std


def parameters_table(found: Identification, guess: Rope | None) -> TextTable:
    """Return all free numbers with standard deviations and intervals, and the first guess if it is given."""
    every, rows = numbers(found), []
    for each in every:
        same = [other for other in every if (other.name, other.law) == (each.name, each.law)]
        alike = [max(abs(other.value), other.std if np.isfinite(other.std) else 0.0) for other in same]
        unit = readable_unit("" if each.law in ("factor", "taper") else each.name, alike)
        value, std, low, high = (number / unit.size for number in (each.value, each.std, each.low, each.high))
        words = described(each.label, PROPERTIES[each.name].words)
        rows.append([each.label, words, rounded(value, std) + unit.after, *_spread(std, low, high)])
        if guess is not None:
            rows[-1].append(f"{each.start / unit.size:.4g}")
    header = ("name", "what it is", "value", "std", "95 % interval", *["first guess"] * (guess is not None))
    return TextTable(header, tuple(map(tuple, rows)))


def ties(found: Identification, least: float = 0.95, most: int = 5) -> tuple[str, ...]:
    """Return correlated pairs of numbers as text: correlation at least `least`, the closest first."""
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.sqrt(np.diag(found.covariance))
        correlation = np.nan_to_num(found.covariance / np.outer(std, std))
    known = np.isfinite([each.std for each in numbers(found)])
    upper = np.triu(np.abs(correlation) * np.outer(known, known), 1)
    pairs = [np.unravel_index(k, upper.shape) for k in np.argsort(-upper, axis=None)[:most]]
    return tuple(
        f"{found.parameters[i]} and {found.parameters[j]} ({correlation[i, j]:+.3f})"
        for i, j in pairs
        if upper[i, j] >= least
    )


def ratios_table(found: Identification) -> TextTable | None:
    """Return the ratios that a motion without known forces determines, or None if none of them was free."""
    rows = []
    for name, values in found.ratios.items():
        unit, spreads = readable_unit(name, values), found.ratio_std[name]
        alike = values.size > 1 and np.ptp(values) <= 1e-12 * np.abs(values).max() and len({*spreads.round(15)}) == 1
        for link, (value, std) in enumerate(zip(values[: 1 if alike else None], spreads, strict=False)):
            if std > 0.0:
                ends = _interval(found, f"{name}[{link}]", value, std, signed=name == "p/p1")
                shown = rounded(value, std) + unit.after
                rows.append((name, "each" if alike else str(link), shown, *_spread(std, *ends), RATIOS[name].words))
    return TextTable(("ratio", "link", "value", "std", "95 % interval", "what it is"), tuple(rows)) if rows else None


def _spread(std: float, low: float, high: float) -> tuple[str, str]:
    """Return a standard deviation and an interval as text; the interval is one-sided if an end is not finite."""
    ends = [rounded(end, std) if np.isfinite(end) else "" for end in (low, high)]
    if not np.isfinite(std) or ends == ["", ""]:
        return "", "cannot be known"
    return short(std), " to ".join(ends) if all(ends) else f"{ends[0]} or more" if ends[0] else f"{ends[1]} or less"


def present(rope: Rope) -> dict[str, bool]:
    """Return for each property of the links whether the rope has non-default values."""
    return {each.name: bool((getattr(rope, each.name) != each.default).any()) for each in LINK_PROPERTIES}


def rope_table(rope: Rope, found: Identification) -> TextTable:
    """Return the identified rope link by link; free values are marked with a star."""
    free = {each.name for each in numbers(found)}
    shown = [name for name, there in present(rope).items() if there]
    units = [readable_unit(name, getattr(rope, name)) for name in shown]
    names = [f"{name.replace('_', ' ')}{'*' if name in free else ''}" for name in shown]
    header = [f"{name}, {unit.name}" for name, unit in zip(names, units, strict=True)]
    columns = [getattr(rope, name) / unit.size for name, unit in zip(shown, units, strict=True)]
    rows = [(str(k), *(f"{column[k]:.4g}" for column in columns)) for k in range(rope.n_links)]
    return TextTable(("link", *header), tuple(rows))


def recording_table(recording: Recording, found: Identification) -> TextTable:
    """Return the table of the recording."""
    steps = np.diff(recording.t)
    usual, unit = float(np.median(steps)), "rad" if recording.kind == "angles" else "m"
    uneven = not np.allclose(steps, usual, rtol=0.01)
    content = {"recording": recording, "contents": _contents(recording), "settings": found.settings}
    return _filled("recording.txt", usual=usual, steps=steps, uneven=uneven, unit=unit, amount=amount, **content)


def _contents(recording: Recording) -> str:
    if recording.kind == "markers":
        return f"{recording.data.shape[1] // 2} markers"
    return f"angles of {recording.n_links} link{'s' if recording.n_links > 1 else ''}"


def fit_table(found: Identification) -> TextTable:
    """Return the table of the fit's settings."""
    free, owned = {each.name for each in numbers(found)}, present(found.rope)
    fixed, zero = (
        [name.replace("_", " ") for name, own in owned.items() if name not in free and own is whether]
        for whether in (True, False)
    )
    content = {"found": found, "done": found.settings, "free": _free(found), "fixed": fixed, "zero": zero}
    return _filled("fit.txt", version_of=version, platform=platform, **content)


def _filled(template: str, **content: Any) -> TextTable:
    """Return a table of what and value from a template with a row in each line."""
    lines = environment(__package__).get_template(template).render(content).splitlines()
    return TextTable(("what", "value"), tuple(line.partition(" | ")[::2] for line in lines))


def _free(found: Identification) -> str:
    return "; ".join(described(word) for word in found.settings["free"])


def lead(recording: Recording, found: Identification) -> str:
    """Return a sentence on the recording and the free parameters."""
    links = "one link" if found.rope.n_links == 1 else f"{found.rope.n_links} links"
    return (
        f"Identified from {recording.duration:.4g} s of {_contents(recording)} ({recording.t.size} samples), for a "
        f"rope of {links}: {_free(found)}. All other values are those of the first guess."
    )
