"""Tables of identified parameters, ratios and the rope, in units for people."""

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import BAND, Identification
from hyperflex.model import LINK_PROPERTIES, PROPERTIES, RATIOS, Label, Rope, parse_label
from hyperflex.report.page import TextTable
from hyperflex.report.units import readable_unit, rounded, short


@dataclass(frozen=True)
class Number:
    """One free number: its label as in the assessment, the property's name, which link or marker, and its law.

    value, std, low and high (95 %) are in SI units; if it is not determined, std is inf, and low and high are NaN.
    """

    label: str
    name: str
    place: int | None
    law: str
    value: float
    std: float
    low: float
    high: float

    @property
    def words(self) -> str:
        """What it is."""
        whose = {
            "shared": ", of each link alike",
            "inner": ", of each link but the first alike",
            "factor": ", factor on the guess of all links",
        }
        words, owner = PROPERTIES[self.name].words, PROPERTIES[self.name].owner
        if self.law == "taper":
            return f"{words}, at the tip over that at the motor (as far as it departs from the guess)"
        if self.place is None:
            return words + whose.get(self.law, "")
        return f"{words}, {owner} {self.place}"


def numbers(found: Identification) -> tuple[Number, ...]:
    """Return all free numbers with the intervals of the identification, or value plus and minus 1.96 std."""
    return tuple(_number(found, label) for label in found.parameters)


def _number(found: Identification, label: str) -> Number:
    name, place, law = parse_label(label) or Label(label, None, "")
    key = label if law in ("factor", "taper") else name
    index = () if found.values[key].ndim == 0 else (-1 if law == "inner" else place or 0,)
    value, std = float(found.values[key][index]), float(found.std[key][index])
    low, high = _interval(found, label, value, std)
    if not np.isfinite(std):
        low = high = float("nan")
    if law == "taper":
        value, std, low, high = np.exp(value), np.exp(value) * std, np.exp(low), np.exp(high)
    elif (PROPERTIES[name].form != "linear" or law == "factor") and low < 0.0:
        low = 0.0
    return Number(label, name, place, law, float(value), float(std), float(low), float(high))


def _interval(found: Identification, label: str, value: float, std: float) -> tuple[float, float]:
    """Return the 95 % interval of the identification, or value plus and minus 1.96 std without one."""
    given = (getattr(found, "intervals", None) or {}).get(label)
    if given is None:
        return value - BAND * std, value + BAND * std
    return float(given.low), float(given.high)


def parameters_table(found: Identification, guess: Rope | None) -> TextTable:
    """Return all free numbers with standard deviations and intervals, and the first guess if it is given."""
    every = numbers(found)
    rows = []
    for each in every:
        plain = each.law in ("factor", "taper")
        alike = [other.value for other in every if other.name == each.name and other.law == each.law]
        unit = readable_unit("" if plain else each.name, alike)
        value, std = each.value / unit.size, each.std / unit.size
        cells = [each.label, each.words, rounded(value, std) + unit.after]
        if np.isfinite(std):
            cells += [short(std), _span(each.low / unit.size, each.high / unit.size, std)]
        else:
            cells += ["", "cannot be known"]
        if guess is not None:
            start = _start(each, found, guess)
            cells.append("" if start is None else f"{start / unit.size:.4g}")
        rows.append(tuple(cells))
    header = ("name", "what it is", "value", "std", "95 % interval")
    return TextTable(header if guess is None else (*header, "first guess"), tuple(rows))


def _start(each: Number, found: Identification, guess: Rope) -> float | None:
    """Return the starting value of a number, or None if it came from the recording."""
    if each.law in ("factor", "taper"):
        return 1.0
    owner = PROPERTIES[each.name].owner
    if owner in ("camera", "arm"):
        return None
    if owner == "marker":
        return float(found.settings["arc_lengths"][each.place or 0])
    if each.name == "gravity_scale":
        return 1.0
    if owner == "motion" or each.name == "gravity_angle":
        return float(found.settings.get(f"{each.name}_from", 0.0))
    own = np.atleast_1d(getattr(guess, each.name))
    alike = {"shared": own, "inner": own[1:]}.get(each.law)
    return float(own[each.place or 0] if alike is None else alike.mean())


def ties(found: Identification, least: float = 0.95, most: int = 5) -> tuple[str, ...]:
    """Return correlated pairs of numbers as text: correlation at least `least`, the closest first."""
    std = np.sqrt(np.diag(found.covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.nan_to_num(found.covariance / np.outer(std, std))
    known = np.array([np.isfinite(each.std) for each in numbers(found)])
    upper = np.triu(np.abs(correlation) * np.outer(known, known), 1)
    pairs = [divmod(int(k), std.size) for k in np.argsort(-upper, axis=None)[:most] if upper.ravel()[k] >= least]
    return tuple(f"{found.parameters[i]} and {found.parameters[j]} ({correlation[i, j]:+.3f})" for i, j in pairs)


def ratios_table(found: Identification) -> TextTable | None:
    """Return the ratios that a motion without known forces determines, or None if none of them was free."""
    rows = []
    for name, values in found.ratios.items():
        unit, spreads = readable_unit(name, values), found.ratio_std[name]
        pairs = list(zip(values, spreads, strict=True))
        alike = len(pairs) > 1 and np.ptp(values) <= 1e-12 * np.abs(values).max() and len({*spreads.round(15)}) == 1
        for link, (value, std) in enumerate(pairs[:1] if alike else pairs):
            if std > 0.0:
                whose = "each" if alike else str(link)
                spread = _spread(found, f"{name}[{link}]", value, std)
                rows.append((name, whose, rounded(value, std) + unit.after, *spread, RATIOS[name].words))
    return TextTable(("ratio", "link", "value", "std", "95 % interval", "what it is"), tuple(rows)) if rows else None


def _spread(found: Identification, label: str, value: float, std: float) -> tuple[str, str]:
    """Return standard deviation and interval of a ratio."""
    if not np.isfinite(std):
        return "", "cannot be known"
    low, high = _interval(found, label, value, std)
    if label not in found.intervals and not label.startswith("p/p1"):  # intervals know their bounds
        low = max(low, 0.0)
    return short(std), _span(low, high, std)


def _span(low: float, high: float, std: float) -> str:
    """Return an interval as text; it is one-sided if an end is not finite."""
    ends = [rounded(end, std) if np.isfinite(end) else "" for end in (low, high)]
    if ends[0] and ends[1]:
        return f"{ends[0]} to {ends[1]}"
    return f"{ends[0]} or more" if ends[0] else f"{ends[1]} or less" if ends[1] else "cannot be known"


def present(rope: Rope) -> dict[str, bool]:
    """Return for each property of the links whether the rope has non-default values."""
    return {each.name: bool((getattr(rope, each.name) != each.default).any()) for each in LINK_PROPERTIES}


def rope_table(rope: Rope, found: Identification) -> TextTable:
    """Return the identified rope link by link; free values are marked with a star."""
    free = {each.name for each in numbers(found)}
    shown = [name for name, there in present(rope).items() if there]
    units = [readable_unit(name, getattr(rope, name)) for name in shown]
    header = [
        f"{name.replace('_', ' ')}{'*' if name in free else ''}, {unit.name}"
        for name, unit in zip(shown, units, strict=True)
    ]
    columns: list[Array] = [getattr(rope, name) / unit.size for name, unit in zip(shown, units, strict=True)]
    rows = [(str(k), *(f"{column[k]:.4g}" for column in columns)) for k in range(rope.n_links)]
    return TextTable(("link", *header), tuple(rows))
