"""A program that holds a motor and ends in a given way: `python -m tests.hardware.host ADDRESS WAY`."""

import sys
import threading

from hyperflex.hardware import Drive, Goal, open_link
from hyperflex.model import MotorLimits


def say(word):
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


def main(address, way):
    drive = Drive(open_link(address, patience=1.0), MotorLimits())
    if way == "atexit":
        drive.connect()
        drive.enable()
        say("on")
        sys.stdin.readline()
        return
    with drive:
        angle = drive.enable().angle
        say("on")
        ended = threading.Event()
        threading.Thread(target=lambda: ended.set() if sys.stdin.readline() else None, daemon=True).start()
        while not ended.is_set():
            drive.command(Goal(angle))
        if way == "exception":
            raise ValueError("on purpose")


if __name__ == "__main__":
    main(*sys.argv[1:])
