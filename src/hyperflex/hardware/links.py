"""Drives by their addresses: "moteus:/dev/ttyACM0?id=2", "emulator:moteus"."""

import importlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any
from urllib.parse import parse_qsl

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.hardware.drive import Link

EMULATOR = "emulator"


SERIAL = {"id": "number", "baud": "baud", "watchdog": "watchdog"}


@dataclass(frozen=True)
class Make:
    """Names of the classes of a make, an example of a port, and the link's arguments by their names in an address.

    Those in `shared` are arguments of the emulated device as well.
    """

    link: str
    device: str
    port: str
    options: dict[str, str] = field(default_factory=lambda: SERIAL)
    shared: tuple[str, ...] = ("number",)


MAKES = {
    "moteus": Make("MoteusLink", "MoteusDevice", "/dev/ttyACM0", SERIAL | {"timeout_mode": "timeout_mode"}),
    "dynamixel": Make("DynamixelLink", "DynamixelDevice", "/dev/ttyUSB0"),
    "odrive": Make(
        "ODriveLink",
        "ODriveDevice",
        "can0",
        {"id": "number"} | {name: name for name in ("bitrate", "trial", "torque_constant", "watchdog")},
        ("number", "watchdog"),
    ),
}


def open_link(address: str, **options: Any) -> Link:
    """Return the link to a drive; its port is opened when a :class:`Drive` connects.

    Parameters
    ----------
    address : str
        Make and port, then options with numbers: "moteus:/dev/ttyACM0?id=2", "odrive:can0?torque_constant=0.083".
    **options
        Further arguments of the link, such as `patience`, s.

    Raises
    ------
    InvalidInput
        If the make or an option is not known, or the port is missing.

    Examples
    --------
    >>> open_link("moteus:/dev/ttyACM0?id=2").name
    'moteus 2 on /dev/ttyACM0'
    """
    name, place = _make(address)
    if name == EMULATOR:
        raise InvalidInput(
            "an emulated motor has a port only while it runs",
            got=address,
            allowed=f"such as {place}:/dev/pts/1",
            fix="Start a hyperflex.hardware.emulate.Emulator and give its port",
        )
    port, _, query = place.partition("?")
    link = getattr(importlib.import_module("hyperflex.hardware"), MAKES[name].link)
    made: Link = link(port, **_arguments(name, query, address), **options)
    return made


def emulated_device(address: str) -> tuple[str, Callable[..., Any]] | None:
    """Return make and class of the device that "emulator:MAKE" means, for an Emulator; None for any other address.

    Options, as in "emulator:moteus?watchdog=0.5", go to the device as far as it has them, and on with its port.
    """
    name, place = _make(address)
    if name != EMULATOR:
        return None
    make, _, query = place.partition("?")
    device: Callable[..., Any] = getattr(importlib.import_module("hyperflex.hardware.emulate"), MAKES[make].device)
    if not query:
        return make, device
    given = _arguments(make, query, address)
    return make, partial(_made, device, query, {key: given[key] for key in MAKES[make].shared if key in given})


def _made(device: Callable[..., Any], query: str, given: dict[str, float], plant: Any) -> Any:
    """Return a device whose address has further options."""
    made = device(plant, **given)
    made.options = f"{made.options}&{query}".lstrip("&")
    return made


def _arguments(make: str, query: str, address: str) -> dict[str, float]:
    """Return the link's arguments that the options of an address give."""
    known, given = MAKES[make].options, dict(parse_qsl(query, keep_blank_values=True))
    checks.keys(f"an address of {make}", given, known)
    for key, value in given.items():
        if not re.fullmatch(r"\d+(\.\d+)?", value):
            raise InvalidInput(
                f"{key} in the motor's address is not a number",
                got=address,
                allowed="digits, with a decimal point where it makes sense",
            )
    return {known[key]: int(value) if value.isdecimal() else float(value) for key, value in given.items()}


def _make(address: str) -> tuple[str, str]:
    """Return what stands before and after the colon of an address."""
    name, _, place = checks.text("motor", address).partition(":")
    if name == EMULATOR and place.partition("?")[0] in MAKES:
        return name, place
    examples = [f"{make}:{each.port}" for make, each in MAKES.items()] + [f"{EMULATOR}:{make}" for make in MAKES]
    if name not in MAKES or not place.partition("?")[0]:
        what = "the motor's address has no port" if name in MAKES else "the motor's address is not known"
        raise InvalidInput(what, got=address, allowed=f"make:port, such as {', '.join(examples)}")
    return name, place
