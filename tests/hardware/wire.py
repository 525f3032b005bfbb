"""A rig in real time, whose replies a function of the test spoils, and what tests of makes on it share."""

from contextlib import contextmanager

from hyperflex.hardware.emulate import MotorModel, Plant
from hyperflex.model import Arm
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


def light_arm(**motor):
    """A motor that turns an arm without a rope."""
    return Plant(MotorModel(**motor), None, Arm(length=0.2, inertia=1e-3))


@contextmanager
def opened(link):
    """The link, open in the block."""
    try:
        link.open()
        yield link
    finally:
        link.close()


def try_open(link):
    """Open the link and close it."""
    with opened(link):
        pass


def be_patient(monkeypatch, make, silence):
    """Wait longer than a busy machine may take: order and content are tested, not speed."""
    monkeypatch.setattr(make, "SILENCE", silence)
    monkeypatch.setattr(make, "CONFIRM", 5.0)
