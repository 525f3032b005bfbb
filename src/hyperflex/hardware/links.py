"""Drives by their addresses: "moteus:/dev/ttyACM0?id=2", "emulator:moteus"."""

import importlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qsl

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.hardware.drive import Link

EMULATOR = "emulator"


@dataclass(frozen=True)
class Make:
    """Names of the classes of a make, an example of a port, and the link's arguments by their names in an address."""

    link: str
    device: str
    port: str
    options: dict[str, str] = field(default_factory=lambda: {"id": "number", "baud": "baud", "watchdog": "watchdog"})


MAKES = {
    "moteus": Make("MoteusLink", "MoteusDevice", "/dev/ttyACM0"),
    "dynamixel": Make("DynamixelLink", "DynamixelDevice", "/dev/ttyUSB0"),
    "odrive": Make(
        "ODriveLink",
        "ODriveDevice",
        "can0",
        {"id": "number"} | {name: name for name in ("bitrate", "trial", "torque_constant", "watchdog")},
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
    make = MAKES[name]
    port, _, query = place.partition("?")
    given = dict(parse_qsl(query, keep_blank_values=True))
    checks.keys(f"an address of {name}", given, make.options)
    for key, value in given.items():
        if not re.fullmatch(r"\d+(\.\d+)?", value):
            allowed = "digits, with a decimal point where it makes sense"
            raise InvalidInput(f"{key} in the motor's address is not a number", got=address, allowed=allowed)
        options[make.options[key]] = int(value) if value.isdecimal() else float(value)
    link: Link = getattr(importlib.import_module("hyperflex.hardware"), make.link)(port, **options)
    return link


def emulated_device(address: str) -> tuple[str, Callable[..., Any]] | None:
    """Return make and class of the device that "emulator:MAKE" means, for an Emulator; None for any other address."""
    name, place = _make(address)
    if name != EMULATOR:
        return None
    device: Callable[..., Any] = getattr(importlib.import_module("hyperflex.hardware.emulate"), MAKES[place].device)
    return place, device


def _make(address: str) -> tuple[str, str]:
    """Return what stands before and after the colon of an address."""
    name, _, place = checks.text("motor", address).partition(":")
    if name == EMULATOR and place in MAKES:
        return name, place
    examples = [f"{make}:{each.port}" for make, each in MAKES.items()] + [f"{EMULATOR}:{make}" for make in MAKES]
    if name not in MAKES or not place.partition("?")[0]:
        what = "the motor's address has no port" if name in MAKES else "the motor's address is not known"
        raise InvalidInput(what, got=address, allowed=f"make:port, such as {', '.join(examples)}")
    return name, place
