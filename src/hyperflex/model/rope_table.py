"""The ``[rope]`` table of a TOML file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.model.properties import LINK_NAMES, PROPERTIES

MOST_LINKS = 100_000  # far beyond use; a slip of the pen must not fill the memory

DENSITIES = 0.01, 1e5  # kg/m^3: a hundredth of air's, and four times that of the densest metal

TOTALS = ("length", "mass")  # of the whole rope or of each link: a file says which


def to_table(n_links: int, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a rope with the given fields; arrays of equal entries become one number."""
    content: dict[str, Any] = {"n_links": n_links}
    for name, value in values.items():
        if name in LINK_NAMES and bool((value == value[0]).all()):
            content[f"link_{name}" if name in TOTALS else name] = float(value[0])
        else:
            content[name] = value.tolist() if isinstance(value, np.ndarray) else value
    return content


def keys_of(names: Sequence[str]) -> list[str]:
    """Return the keys of a table of a rope with fields of these names."""
    return [*names, "n_links", *(f"{k}_{t}" for k in ("total", "link") for t in TOTALS)]


def from_table(table: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return the fields (of those in `names`) that a table holds.

    Length and mass are arrays with one entry a link, or ``total_length`` and ``total_mass`` of the whole rope, or
    ``link_length`` and ``link_mass`` of each of ``n_links`` equal links.
    """
    content = dict(checks.mapping("the rope table", table))
    checks.keys("the rope table", content, keys_of(names))
    sizes = [np.size(content[name]) for name in LINK_NAMES if np.ndim(content.get(name, 0.0)) == 1]
    if "n_links" not in content and not sizes:
        raise InvalidInput("rope table lacks n_links", allowed="n_links = 50, or arrays with one entry a link")
    n = checks.count("rope n_links", content.pop("n_links", sizes[0] if sizes else None), most=MOST_LINKS)
    for name in TOTALS:
        given = [key for key in (name, f"total_{name}", f"link_{name}") if key in content]
        if len(given) != 1:
            allowed = f"one of {name} (array), total_{name}, link_{name}"
            raise InvalidInput(f"rope table tells the {name} {len(given)} times", got=given, allowed=allowed)
        value = content.pop(given[0])
        if given[0] == name and np.ndim(value) == 0 and n > 1:
            raise InvalidInput(
                f"rope {name} is one number for {n} links",
                got=value,
                allowed=f"total_{name} for the whole rope, link_{name} for each link, or an array",
            )
        if np.ndim(value) == 0:
            each = PROPERTIES[name]
            single = checks.number(f"rope {given[0]}", value, sign=each.sign, unit=each.unit)
            value = np.full(n, single / n if given[0].startswith("total") else single)
        content[name] = value
    if np.size(content["length"]) != n:
        raise InvalidInput(
            "rope n_links differs from its arrays", got=n, allowed=f"{np.size(content['length'])}, as length has"
        )
    check_density(content["length"], content["mass"], content.get("radius", 0.0))
    return content


def check_density(length: Any, mass: Any, radius: Any) -> None:
    """Refuse what no rope is made of: grams for kilograms, or millimetres for metres, most likely."""
    try:
        volume, total = np.pi * float(radius) ** 2 * float(np.sum(length)), float(np.sum(mass))
        thick = float(radius) > 0.5 * float(np.sum(length))
    except (TypeError, ValueError, OverflowError):
        return  # refused by its own check
    if not thick and volume > 0.0 and total > 0.0 and not DENSITIES[0] <= total / volume <= DENSITIES[1]:
        raise InvalidInput(
            "length, mass and radius of the rope make an impossible density",
            got=f"{total / volume:.3g} kg/m^3",
            allowed="0.01 to 100,000 kg/m^3; cords have some 1000, steel has 7900",
            fix="Give length and radius in m and mass in kg: 2.5 mm are 0.0025, 125 g are 0.125",
        )
