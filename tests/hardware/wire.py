"""A device on a pseudo-terminal, in a thread of the test."""

import os
import select
import termios
import threading
import time
import tty


class Wire:
    """Runs a device in real time behind a serial port of this machine: `with Wire(device) as wire: wire.port`."""

    def __init__(self, device, baud: int = 0) -> None:
        self.device, self.baud = device, baud  # a rate of 0 takes all
        self.spoil = lambda reply: [reply]  # bytes or pauses, s, that a reply becomes
        self.mute = False
        self._end = threading.Event()

    def __enter__(self):
        self._host, end = os.openpty()
        tty.setraw(end)
        self.port, self._device_end = os.ttyname(end), end
        self.device.plant.warm()  # kernels are loaded before the host waits for a reply
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()
        os.close(self._host)
        os.close(self._device_end)

    def _run(self) -> None:
        began = time.monotonic()
        while not self._end.is_set():
            ready = select.select([self._host], [], [], 1e-3)[0]
            reply = self.device.tick(time.monotonic() - began)
            if ready:
                data = os.read(self._host, 4096)
                if not self.baud or termios.tcgetattr(self._host)[4] == getattr(termios, f"B{self.baud}"):
                    reply += self.device.handle(data)
            if reply and not self.mute:
                for part in self.spoil(reply):
                    time.sleep(part) if isinstance(part, float) else os.write(self._host, part)
