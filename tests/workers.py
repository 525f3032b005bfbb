"""What workers of an executor do in tests. Loads nothing but Python's own, so that new processes start quickly."""

import os
import signal
import time
from pathlib import Path


def squares(numbers: list[int]) -> list[int]:
    return [number**2 for number in numbers]


def fails(numbers: list[int]) -> list[int]:
    raise ZeroDivisionError(f"of {numbers}")


class DiesOnce:
    """Kills its process at a number, the first time that it is run, and squares all others."""

    def __init__(self, folder: Path, number: int, times: int = 1) -> None:
        self.folder, self.number, self.times = folder, number, times

    def __call__(self, numbers: list[int]) -> list[int]:
        deaths = len(list(self.folder.glob("death*")))
        if self.number in numbers and deaths < self.times:
            (self.folder / f"death-{deaths}").touch()
            time.sleep(0.05)  # others are under way
            os.kill(os.getpid(), signal.SIGKILL)
        return squares(numbers)
