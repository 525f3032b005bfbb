"""A device on a pseudo-terminal, run by a thread of the test: its clock may go slowly, its wire may be spoiled."""

import os
import select
import termios
import threading
import time
import tty

from hyperflex.hardware.emulate.faults import FaultyWire


class Rig:
    """Runs a device behind a serial port of this machine: `with Rig(device) as rig: rig.port`.

    `pace` are the device's seconds in one of ours: with 0.1 a watchdog of 100 ms waits for a second, which a busy
    machine keeps. With a `baud` other than 0 the device is deaf at other rates.
    """

    def __init__(self, device, *, baud=0, pace=0.1):
        self.device, self.baud, self.pace = device, baud, pace
        self.requests, self.replies = FaultyWire(), FaultyWire()
        self.before = lambda: None  # called before each request is handled
        self._cut, self._end = False, threading.Event()

    def spoil(self, faults):
        """Spoil requests and replies from now on, each with these probabilities."""
        self.requests.set(faults)
        self.replies.set(faults)

    def cut(self):
        """Remove the port; the device continues."""
        self._cut = True

    def __enter__(self):
        self._host, end = os.openpty()
        tty.setraw(end)
        self.port, self._ends = os.ttyname(end), [self._host, end]
        self.device.plant.warm()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()
        self._close()

    def _close(self):
        while self._ends:
            os.close(self._ends.pop())

    def _run(self):
        began = time.monotonic()
        while not self._end.is_set():
            if self._cut:
                self._close()
            ready = select.select(self._ends[:1], [], [], 1e-3)[0]
            now = time.monotonic()
            sent = self.device.tick(self.pace * (now - began))
            if ready:
                data = os.read(self._host, 4096)
                if not self.baud or termios.tcgetattr(self._host)[4] == getattr(termios, f"B{self.baud}"):
                    self.requests.send(data, now)
            if data := self.requests.receive(now):
                self.before()
                sent += self.device.handle(data)
            if sent:
                self.replies.send(sent, now)
            if (data := self.replies.receive(now)) and self._ends:
                os.write(self._host, data)
