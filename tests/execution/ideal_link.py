"""A link to an ideal motor without lag, for tests of the layers above a drive."""

import math
import time
from pathlib import Path
from typing import Any

from hyperflex.hardware import Drive, Goal, Reading
from hyperflex.hardware.drive import NoReply
from hyperflex.model import MotorLimits


class IdealLink:
    """Reaches each goal at once, and notes each switch of its torque in a file.

    It falls silent after `silent_after` replies; the torque of one that is `stuck` stays on; of one that `loses`, each
    so many-th reply is lost while its torque is on. It `holds` the arm with a torque, N m. It is at an `angle` first,
    rad, and stops `short` of its goals. One that `pauses` answers this request late, by 0.2 s.
    """

    name, watchdog, takes = "ideal motor", 0.1, frozenset({"rate", "torque"})
    clock = staticmethod(time.monotonic)

    def __init__(
        self,
        notes: Path,
        silent_after: int = 10**9,
        fault_after: int = 10**9,
        *,
        stuck: bool = False,
        loses: int = 0,
        holds: float = 0.0,
        pauses: int = 0,
        angle: float = 0.3,
        short: float = 0.0,
    ) -> None:
        self.notes, self.left, self.sound, self.stuck = notes, silent_after, fault_after, stuck
        self.angle, self.short, self.on, self.loses = angle, short, False, loses
        self.holds, self.pauses = holds, pauses

    def open(self) -> None:
        self.note("open")

    def note(self, text: str) -> None:
        with self.notes.open("a") as file:
            file.write(f"{text}\n")

    def read(self) -> Reading:
        self.left -= 1
        self.sound -= 1
        self.pauses -= 1
        if self.pauses == 0:
            time.sleep(0.2)
        if self.left < 0:
            raise NoReply("silent")
        if self.loses and self.on and self.left % self.loses == 0:
            raise NoReply("lost")
        now = time.monotonic()
        fault = "" if self.sound >= 0 else "over-temperature (33)"
        return Reading(self.angle, 0.0, self.holds, 24.0, 30.0, self.on, fault, now, now)

    def enable(self, limits: MotorLimits) -> None:
        self.on = True
        self.note("on")

    def send(self, goal: Goal) -> Reading:
        self.angle = goal.angle - self.short
        return self.read()

    def disable(self) -> None:
        if self.stuck:
            return
        if self.on:
            self.note("off")
        self.on = False

    def clear(self) -> None:
        self.sound = 10**9

    def close(self) -> None:
        self.note("closed")


def ideal_drive(notes: Path, limits: MotorLimits | None = None, **link: Any) -> Drive:
    """Return a drive over an ideal link."""
    return Drive(IdealLink(notes, **link), limits or MotorLimits())


def open_ideal(notes: Path, _: str, limits: MotorLimits, *more: object, **link: Any) -> Drive:
    """Return a drive over an ideal link for any address, with a hanging arm; it does not report its torque."""
    return ideal_drive(notes, limits=limits, **{"angle": 0.0, "holds": math.nan, **link})
