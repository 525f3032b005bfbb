"""Faults of the wire between an emulated device and its host."""

import random
from dataclasses import dataclass, fields

from hyperflex import options
from hyperflex.errors import InvalidInput
from hyperflex.options import option


@dataclass(frozen=True)
class WireFaults:
    """Probabilities with which a reply of a device is spoiled, each in one way at most; by default none is."""

    lost: float = option(0.0, "probability that a reply is lost", sign="nonnegative")
    late: float = option(0.0, "probability that a reply comes late", sign="nonnegative")
    garbled: float = option(0.0, "probability that a byte of a reply is changed", sign="nonnegative")
    truncated: float = option(0.0, "probability that a reply ends early", sign="nonnegative")
    delay: float = option(0.03, "how late a late reply comes", "s", sign="positive")
    seed: int = option(0, "seed of the random numbers")

    def __post_init__(self) -> None:
        options.check(self, "wire")
        if (total := sum(getattr(self, kind) for kind in KINDS)) > 1.0:
            raise InvalidInput("probabilities of wire faults add up to more than 1", got=total, allowed="up to 1")


KINDS = tuple(each.name for each in fields(WireFaults))[:4]


class FaultyWire:
    """Carries replies from a device to its host, and spoils them.

    Attributes
    ----------
    counts : dict of str to int
        Replies carried whole ("good"), lost, late, garbled and truncated.
    """

    def __init__(self, faults: WireFaults = WireFaults()) -> None:
        self.counts = dict.fromkeys(("good", *KINDS), 0)
        self._waiting: list[tuple[float, bytes]] = []
        self.set(faults)

    def set(self, faults: WireFaults) -> None:
        """Take other faults from now on, and begin with their seed."""
        self._faults, self._random = faults, random.Random(faults.seed)

    def send(self, reply: bytes, now: float) -> None:
        """Take a reply from the device at a time, s."""
        rates = [getattr(self._faults, kind) for kind in KINDS]
        (kind,) = self._random.choices((*KINDS, "good"), (*rates, 1.0 - sum(rates)))
        self.counts[kind] += 1
        if kind == "garbled":
            k = self._random.randrange(len(reply))
            reply = reply[:k] + bytes([reply[k] ^ self._random.randrange(1, 256)]) + reply[k + 1 :]
        elif kind == "truncated":
            reply = reply[: self._random.randrange(len(reply))]
        if kind != "lost":
            self._waiting.append((now + self._faults.delay if kind == "late" else now, reply))

    def receive(self, now: float) -> bytes:
        """Return what has come to the host by a time, s."""
        come = b"".join(reply for due, reply in self._waiting if due <= now)
        self._waiting = [each for each in self._waiting if each[0] > now]
        return come
