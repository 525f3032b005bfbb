"""An emulated drive as a process of its own, in real time, on a pseudo-terminal."""

import os
import select
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Protocol, Self

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array, ByName
from hyperflex.child import START, Child, Records, run_in_real_time, serve
from hyperflex.errors import DriveError
from hyperflex.hardware.emulate.faults import FaultyWire, WireFaults
from hyperflex.hardware.emulate.plant import MotorModel, Plant
from hyperflex.model import Arm, Rope

AHEAD = (
    5e-3  # s of the plant that are integrated between two looks at the wire; a slow machine falls behind, and answers
)
STATES = ("t", "arm_angle", "arm_rate", "angle", "rate", "torque", "voltage", "temperature", "enabled", "behind")
GOALS = ("t", "angle", "rate", "torque")


class Device(Protocol):
    """The device's side of a wire, on the clock that :meth:`tick` gives it; 0 is when it was made.

    `options` are those that its address needs, such as "torque_constant=0.1".
    """

    plant: Plant
    options: str

    def tick(self, t: float) -> bytes:
        """Advance plant and device to time t, s; return what it sends unasked."""

    def handle(self, data: bytes) -> bytes:
        """Take bytes from the host, which may end in the middle of a message; return the answers."""


@dataclass(frozen=True, eq=False)
class EmulatorLog:
    """What an emulated drive has received and done. Times are of :func:`time.monotonic`, s; angles are raw.

    Attributes
    ----------
    goals : (G, 4) float64
        Time, angle, rad, rate, rad/s, and torque, N m, of each goal that the motor was given.
    states : (T, 10 + 2 n) float64
        Columns as in STATES (true angle and rate of the arm, those of the encoder, torque, voltage, temperature,
        whether the torque is on, by how much motor and rope are behind the clock, s), then link angles q, rad, and
        rates qd, rad/s.
    replies : dict of str to int
        Number of replies that were good, lost, late, garbled and truncated.
    """

    goals: Array
    states: Array
    replies: dict[str, int]

    def column(self, name: str) -> Array:
        """Return a column (T,) of the states by its name, as in STATES."""
        return self.states[:, STATES.index(checks.choice("column", name, STATES))]

    @property
    def rope(self) -> tuple[Array, Array]:
        """Link angles q, rad, and rates qd, rad/s, each (T, n)."""
        q, qd = np.split(self.states[:, len(STATES) :], 2, axis=1)
        return q, qd


class Emulator:
    """An emulated drive in a process of its own. Use it as a context manager; a host opens its `port`.

    It ends with the block, and with this program, however that ends. It starts as a new interpreter, so a program needs
    ``if __name__ == "__main__":``.

    Parameters
    ----------
    device : callable
        Makes the device from its plant: a class, or a ``functools.partial`` of one.
    model, rope, arm, **plant
        As of :class:`Plant`; without an `arm`, that of the paper.
    baud : int
        Rate, bit/s, at which the device listens; 0 for any.
    sample : float
        Time, s, between states in the log.
    duration : float
        Time, s, for which the log is kept; of a longer run the newest part is. So are a thousand goals a second.

    Attributes
    ----------
    port : str
        Path of the serial port, then the options that an address of the device needs, or was given.
    states : Records
        Rows as of :attr:`EmulatorLog.states`, to be handed to a process that draws the rope.

    Notes
    -----
    Where motor and rope take longer to compute than they last, they fall behind the clock; the device answers on.
    A pseudo-terminal has neither a rate nor the latency of USB: times of replies are those of this machine alone.
    """

    def __init__(
        self,
        device: Callable[[Plant], Device],
        model: MotorModel,
        rope: Rope | None = None,
        arm: Arm | None = None,
        *,
        baud: int = 0,
        sample: float = 2e-3,
        duration: float = 60.0,
        **plant: Any,
    ) -> None:
        span, sample = (
            checks.positive(name, value, "s") for name, value in (("duration", duration), ("sample", sample))
        )
        links = 1 if rope is None else rope.n_links
        self.states = Records(round(span / sample), len(STATES) + 2 * links)
        self._goals = Records(round(1e3 * span), len(GOALS))
        given = device, {"model": model, "rope": rope, "arm": arm or Arm(), **plant}, baud, sample
        self._child = Child("The emulator", DriveError, emulate, *given, self.states, self._goals)
        self.port = ""

    def __enter__(self) -> Self:
        self.port = self._child.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._child.end()

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._child.pid

    def log(self) -> EmulatorLog:
        """Return what the device has received and done until now."""
        return EmulatorLog(self._goals.read(), self.states.read(), self._ask("replies"))

    @property
    def behind(self) -> float:
        """Greatest time by which motor and rope were behind the clock, s."""
        return float(self.states.read()[:, STATES.index("behind")].max())

    @property
    def unfair(self) -> str:
        """Why what motor and rope did is no fair trial; empty if they kept up with the clock, as a usual drive does."""
        late = f"the emulated motor and rope fell {1e3 * self.behind:.0f} ms behind the clock: no fair trial"
        return late if self.behind > 0.02 else ""

    def rope_state(self) -> tuple[float, float, Array, Array]:
        """Return the newest true state: time, s, arm angle, rad, q (n,), rad, and qd (n,), rad/s."""
        row = self.states.read(newest=1)[0]
        q, qd = np.split(row[len(STATES) :], 2)
        return float(row[0]), float(row[1]), q, qd

    def hang(self, angle: float) -> None:
        """Unwind the rope by hand, and hold arm and rope still at an angle, rad, until the torque is switched on."""
        self._ask("hang", angle)

    def inject(self, wire: WireFaults | None = None, *, disconnect: bool = False, **plant: Any) -> None:
        """Inject faults from now on.

        Parameters
        ----------
        wire : WireFaults, optional
            Of replies, in place of those before.
        disconnect : bool
            Whether the port vanishes.
        **plant
            As of :meth:`Plant.impose`: voltage, temperature, stops, encoder_turns.
        """
        if wire is not None:
            self._ask("wire", checks.instance("wire", wire, WireFaults))
        if plant:
            self._ask("impose", plant)
        if disconnect:
            self._ask("disconnect")

    def _ask(self, *request: Any) -> Any:
        return self._child.ask(*request, patience=START)  # what is behind the clock answers late


def emulate(
    link: Connection,
    make: Callable[[Plant], Device],
    plant: ByName,
    baud: int,
    sample: float,
    states: Records,
    goals: Records,
) -> None:
    """Run a device in real time until the parent ends."""
    motor = Plant(**plant)
    motor.warm()
    device = make(motor)
    motor.on_goal = lambda goal: goals.write((time.monotonic(), goal.angle, goal.rate, goal.torque))
    run_in_real_time()
    _serve(device, _Terminal(baud), link, states, sample)


def _serve(device: Device, terminal: "_Terminal", link: Connection, states: Records, sample: float) -> None:
    wire, plant, began = FaultyWire(), device.plant, time.monotonic()
    answers: dict[str, Callable[..., Any]] = {
        "replies": lambda: dict(wire.counts),
        "wire": wire.set,
        "impose": lambda imposed: plant.impose(**imposed),
        "hang": plant.hang,
        "disconnect": terminal.close,
    }
    _record(states, plant, 0.0)
    link.send((0, f"{terminal.port}?{device.options}".rstrip("?")))
    due = began  # of the next sample
    while serve(link, answers):
        listened: list[Any] = [*terminal.ends, link]
        ready = select.select(listened, [], [], plant.step)[0]
        now = time.monotonic()
        behind = now - began - plant.t
        sent = device.tick(min(now - began, plant.t + AHEAD))
        if terminal.host in ready:
            sent += device.handle(terminal.read())
        if sent:
            wire.send(sent, now)
        terminal.write(wire.receive(now))
        if now >= due:
            _record(states, plant, now - began - plant.t)
            due = max(due + sample, now)
        if behind > AHEAD:  # a system stops a process at real-time priority that never sleeps, for some 50 ms
            time.sleep(0.1 * AHEAD)


def _record(states: Records, plant: Plant, behind: float) -> None:
    read = plant.angle, plant.rate, plant.torque, plant.voltage, plant.temperature, float(plant.enabled), behind
    q, qd = plant.rope_state()
    states.write((time.monotonic(), plant.arm_angle, plant.arm_rate, *read, *q, *qd))


class _Terminal:
    """The device's end of a pseudo-terminal. What a host does not read is dropped, as on a serial line."""

    def __init__(self, baud: int) -> None:
        import tty  # which Windows lacks, as it does pseudo-terminals

        self.host, self._end = os.openpty()
        tty.setraw(self._end)
        os.set_blocking(self.host, False)
        self.port, self._baud = os.ttyname(self._end), baud
        self.ends = [self.host]

    def read(self) -> bytes:
        """Return what the host has sent; nothing if it sent at a rate at which the device does not listen."""
        import termios

        data = os.read(self.host, 4096)
        if self._baud and termios.tcgetattr(self.host)[4] != getattr(termios, f"B{self._baud}"):
            return b""
        return data

    def write(self, data: bytes) -> None:
        if data and self.ends:
            with suppress(BlockingIOError):
                os.write(self.host, data)

    def close(self) -> None:
        """Let the port vanish."""
        if self.ends:
            self.ends = []
            os.close(self.host)
            os.close(self._end)
