"""A rig in real time, whose replies a function of the test spoils."""

from tests.hardware.rig import Rig


class Wire(Rig):
    """`with Wire(device) as wire: wire.port`; `wire.spoil` makes of each reply a list of those that arrive."""

    def __init__(self, device, **options):
        super().__init__(device, pace=1.0, **options)
        self.spoil = lambda reply: [reply]
        self.mute = False
        self.replies, self._waiting = self, []

    def send(self, reply, now):
        if not self.mute:
            self._waiting += self.spoil(reply)

    def receive(self, now):
        come, self._waiting = b"".join(self._waiting), []
        return come
