"""A drive in memory, with a clock that only requests and tests advance."""

from hyperflex.hardware import Goal, Reading
from hyperflex.hardware.drive import NoReply

REQUEST = 0.001  # s that each request takes


class FakeLink:
    """A link to a motor that goes at once where it is sent.

    `fails` are exceptions that the next requests raise, one each; `log` are the requests that arrived.
    """

    name, watchdog, takes = "fake 1", 0.1, frozenset({"rate", "torque"})

    def __init__(self, angle=0.0, **state):
        self.now, self.log, self.fails = 0.0, [], []
        self.state = {"angle": angle, "rate": 0.0, "torque": 0.0, "voltage": 24.0, "temperature": 30.0}
        self.state |= {"enabled": False, "fault": ""} | state
        self.opened = self.obstinate = self.stuck = False  # the torque does not go off; the shaft does not move
        self.during = lambda request: None  # called in the middle of each request

    def clock(self):
        return self.now

    def _request(self, name, *given):
        self.now += REQUEST
        self.during(name)
        if self.fails:
            error = self.fails.pop(0)
            if error is not None:
                raise error
        self.log.append((name, *given))

    def goals(self):
        return [goal for name, *goal in self.log if name == "send"]

    def open(self):
        self._request("open")
        self.opened = True

    def close(self):
        self.opened = False

    def read(self):
        sent = self.now
        self._request("read")
        return Reading(**self.state, sent=sent, received=self.now)

    def enable(self, limits):
        self._request("enable")
        self.state["enabled"] = True

    def send(self, goal: Goal):
        sent = self.now
        self._request("send", goal.angle, goal.rate, goal.torque)
        if self.state["enabled"] and not self.stuck:
            self.state |= {"angle": goal.angle, "rate": goal.rate, "torque": goal.torque}
        return Reading(**self.state, sent=sent, received=self.now)

    def disable(self):
        self._request("disable")
        self.state["enabled"] = self.obstinate and self.state["enabled"]

    def clear(self):
        self._request("clear")
        self.state["fault"] = ""


def silent(count):
    """`count` requests that get no answer."""
    return [NoReply("nothing") for _ in range(count)]
