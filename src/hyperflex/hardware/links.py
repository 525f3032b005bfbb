"""Links by their addresses: "moteus:/dev/ttyACM0?id=2"."""

from typing import Any
from urllib.parse import parse_qsl

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.hardware.drive import Link
from hyperflex.hardware.moteus import MoteusLink

MAKES: dict[str, tuple[Any, str, dict[str, str]]] = {  # class, example of a port, arguments by option
    "moteus": (MoteusLink, "/dev/ttyACM0", {"id": "number", "baud": "baud"}),
}


def open_link(address: str, **options: Any) -> Link:
    """Return the link to a drive; its port is opened when a :class:`Drive` connects.

    Parameters
    ----------
    address : str
        Make and port, then options with whole numbers: "moteus:/dev/ttyACM0?id=2".
    **options
        Further arguments of the link, such as `watchdog`, s.

    Raises
    ------
    InvalidInput
        If the make or an option is not known, or the port is missing.

    Examples
    --------
    >>> open_link("moteus:/dev/ttyACM0?id=2").name
    'moteus 2 on /dev/ttyACM0'
    """
    make, _, place = checks.text("motor", address).partition(":")
    port, _, query = place.partition("?")
    if make not in MAKES or not port:
        examples = ", ".join(f"{name}:{example}" for name, (_, example, _) in MAKES.items())
        what = "the motor's address has no port" if make in MAKES else "the make of the motor is not known"
        raise InvalidInput(what, got=address, allowed=f"make:port, such as {examples}")
    link, _, names = MAKES[make]
    given = dict(parse_qsl(query, keep_blank_values=True))
    checks.keys(f"{make}:", given, names)
    for name, value in given.items():
        if not value.isdecimal():
            raise InvalidInput(f"{name} in the motor's address is not a whole number", got=address, allowed="digits")
        options[names[name]] = int(value)
    return link(port, **options)
