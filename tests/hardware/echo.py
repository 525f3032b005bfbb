"""A device for tests of the emulator itself: each line is a goal, rad, and is answered by the shaft's angle."""

from hyperflex.hardware import Goal
from hyperflex.hardware.emulate import Plant


class Echo:
    options = ""

    def __init__(self, plant: Plant) -> None:
        self.plant, self._rest = plant, b""

    def tick(self, t: float) -> bytes:
        self.plant.advance(t)
        return b""

    def handle(self, data: bytes) -> bytes:
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self.plant.set_enabled(True)
            self.plant.set_goal(Goal(float(line)))
        return b"".join(b"%.6f\n" % self.plant.angle for _ in lines)
