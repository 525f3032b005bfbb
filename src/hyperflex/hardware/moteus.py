"""Controllers of the moteus family (mjbots) through the vendor's package. Tried with an emulator only.

Sources: the register reference of moteus, its pages on timeouts and on UART, and the package moteus 1.1.
"""

import asyncio
import math
import struct
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any

from hyperflex import checks, extras
from hyperflex.errors import DriveError
from hyperflex.hardware.drive import SILENCE, Goal, NoReply, Reading, hottest
from hyperflex.hardware.serial_port import open_problem
from hyperflex.model import MotorLimits

FAULTS = {  # of mode 1
    32: "calibration",
    33: "motor driver, mostly too weak a supply",
    34: "over voltage",
    35: "encoder",
    36: "motor not configured",
    37: "cycle overrun",
    38: "over temperature",
    39: "outside its own position limits",
    40: "under voltage",
    41: "configuration changed",
    42: "no commutation encoder",
    43: "no output encoder",
    44: "driver enable",
    45: "stop position with limits",
    46: "timing",
    47: "back-EMF feed-forward without an acceleration limit",
    48: "invalid position limits",
}
SOURCES = range(64, 127)  # addresses that requests come from by turns: a late reply goes to one that no longer listens


class MoteusLink:
    """A moteus controller on an fdcanusb adapter or a UART; see :class:`hyperflex.hardware.Link`.

    Parameters
    ----------
    port : str
        Serial port of the adapter, for example "/dev/ttyACM0".
    number : int
        Address of the controller, 1 to 126.
    baud : int
        Rate, bit/s, of a UART; a USB adapter ignores it.
    watchdog : float
        Time after a goal, s, at which the controller stops by itself. Until then it goes on at the goal's rate: at
        8.6 rad/s by 0.26 rad in 30 ms.
    patience : float
        Time that a request may take, s. A controller answers within 1 ms, so a cycle of 5 ms is kept.
    timeout_mode : int
        What servo.timeout_mode must be before the torque comes on: 0, 10, 12 or 15.
    clock : callable
        Monotonic time, s, of the stamps.

    Notes
    -----
    Between goals the controller extrapolates the angle at the goal's rate. It holds a limit of speed and one of
    acceleration of its own, both twice those of the motor, for it must catch up with what it extrapolated wrongly; the
    motor's limits are checked before a goal is sent. It also holds the limit of torque.

    After the watchdog it does what its setting servo.timeout_mode says: 12, the factory's, damps the motion **with
    torque**, up to servo.timeout_max_torque_Nm (5 N m from the factory), whatever the limit of torque here; 0 switches
    the torque off; 10 brakes and holds; 15 shorts the phases. The first :meth:`enable` asks for it, and refuses another
    mode than `timeout_mode`. The state is "enabled" in a timeout, with a fault, and goals are accepted again only after
    a stop.
    """

    takes = frozenset({"rate", "torque"})

    def __init__(
        self,
        port: str,
        number: int = 1,
        *,
        baud: int = 921_600,
        watchdog: float = 0.03,  # six goals at 200 Hz, three at 100 Hz
        patience: float = 4e-3,
        timeout_mode: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.port, self.number = checks.text("port", port), checks.count("moteus id", number, most=126)
        self.timeout_mode, self._trusted = checks.count("timeout_mode", timeout_mode, least=0), False
        self.baud = checks.count("baud", baud)
        self.watchdog = checks.positive("watchdog", watchdog, "s")
        self.patience = checks.positive("patience", patience, "s")
        self.clock, self.name = clock, f"moteus {number} on {port}"
        self._requests = 0
        self._limits: dict[str, float] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._broken: BaseException | None = None

    # ------------------------------------------------------------------ connection

    def open(self) -> None:
        """Open the port and read the state."""
        self._vendor = extras.load("moteus", "moteus", "moteus controllers")
        if asyncio._get_running_loop() is not None:
            raise DriveError(f"{self.name}: an event loop is running here, as in a notebook. Use a MotionStream.")
        self._broken, self._loop = None, asyncio.new_event_loop()
        self._loop.set_exception_handler(self._on_broken)
        patience, self.patience = self.patience, max(self.patience, SILENCE)
        try:
            self._run(self._open())
            for _ in range(3):
                with suppress(NoReply):
                    self.read()
                    return
            raise DriveError(f"{self.name} {self._why_silent()}")
        finally:
            self.patience = patience

    async def _open(self) -> None:
        vendor = self._vendor
        resolution = vendor.QueryResolution()
        resolution.voltage = resolution.temperature = resolution.motor_temperature = vendor.F32
        try:
            # its own patience is longer than ours, which counts
            self._device = _listener(vendor)(
                self.port, baudrate=self.baud, command_timeout=1.0, response_timeout=1.0, max_retries=0
            )
            self._device.guard()
        except (OSError, ValueError) as error:
            raise open_problem(self.port, error) from None
        self._transport = vendor.Transport([self._device])
        self._controller = vendor.Controller(self.number, resolution, transport=self._transport)

    def _why_silent(self) -> str:
        """Return what is wrong with a controller that does not answer."""
        heard = self._device.heard
        with suppress(Exception):  # whoever is there may send anything
            if others := self._run(self._transport.discover(timeout=SILENCE)):
                return f"does not answer. Controllers on this port: {', '.join(str(each.can_id) for each in others)}."
        if not heard:
            return f"does not answer. Check its power, its wiring, the port and the rate ({self.baud} baud on a UART)."
        if all(line.startswith(b"OK") for line in heard):
            return "does not answer, only its adapter does. Check the controller's power, its wiring and its id."
        return f"does not answer, but something else does ({heard[-1][:20]!r}). Another device, or another baud rate?"

    def close(self) -> None:
        """Close the port."""
        loop, self._loop = self._loop, None
        if loop is None:
            return
        with suppress(Exception):  # a broken port may fail at anything
            self._device.close()
        with suppress(Exception):
            loop.run_until_complete(asyncio.sleep(0))  # the vendor's reader ends
        loop.close()

    def _on_broken(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Take note of an error in a callback of the event loop; the request that runs fails, later ones are tried."""
        self._broken = context.get("exception") or OSError(context["message"])

    # ------------------------------------------------------------------ link

    def read(self) -> Reading:
        """Return the state."""
        return self._exchange(self._controller.make_query)

    def enable(self, limits: MotorLimits) -> None:
        """Switch the torque on where the shaft is; a watchdog that has fired is reset."""
        own = {"velocity_limit": limits.speed, "accel_limit": limits.acceleration}
        self._limits = {name: 2.0 * value / math.tau for name, value in own.items()}
        if math.isfinite(limits.torque):
            self._limits["maximum_torque"] = limits.torque
        self._check_timeout_mode()
        self.read()
        if self._mode == self._vendor.Mode.TIMEOUT:
            self.disable()
        self.send(Goal(math.nan))  # which means: where it is

    def send(self, goal: Goal) -> Reading:
        """Send a raw goal and return the state after it."""
        return self._exchange(
            self._controller.make_position,
            position=goal.angle / math.tau,
            velocity=goal.rate / math.tau,
            feedforward_torque=goal.torque,
            watchdog_timeout=self.watchdog,
            query=True,
            **self._limits,
        )

    def disable(self) -> None:
        """Switch the torque off."""
        self._exchange(self._controller.make_stop, query=True)

    def clear(self) -> None:
        """Clear a fault, which a stop does."""
        self.disable()

    def _check_timeout_mode(self) -> None:
        """Refuse a controller that does something else after its watchdog than it should."""
        if self._trusted:
            return
        stream = self._vendor.Stream(self._controller, use_flow_control=False)
        asked = stream.command(b"conf get servo.timeout_mode", allow_any_response=True)
        try:
            mode = int(self._run(asyncio.wait_for(asked, SILENCE + self.patience)))
        except (TimeoutError, RuntimeError, ValueError, IndexError):
            raise NoReply("it does not report its servo.timeout_mode") from None
        if mode != self.timeout_mode:
            fix = f"Set it with moteus_tool (conf set servo.timeout_mode {self.timeout_mode}, conf write)"
            what = f"its servo.timeout_mode, what it does after its watchdog, is {mode}, not {self.timeout_mode}"
            raise DriveError(f"{self.name}: {what}. {fix}, or give ?timeout_mode={mode}.")
        self._trusted = True

    # ------------------------------------------------------------------ one exchange

    def _exchange(self, make: Callable[..., Any], **content: Any) -> Reading:
        """Send a command that queries the state, and return the state that answers it."""
        sources = [source for source in SOURCES if source != self.number]
        self._requests += 1
        self._controller.source_can_id = sources[self._requests % len(sources)]
        command = make(**content)
        sent = self.clock()
        try:
            result = self._run(self._within_patience(self._controller.execute(command)))
        except TimeoutError:
            raise NoReply(f"no reply within {1e3 * self.patience:g} ms") from None
        except (RuntimeError, ValueError, IndexError, struct.error) as error:
            raise NoReply(f"no valid reply ({error})") from None
        return self._reading(result.values if result else {}, sent, self.clock())

    async def _within_patience(self, answer: Coroutine[Any, Any, Any]) -> Any:
        async with asyncio.timeout(self.patience):
            return await answer

    def _run(self, work: Coroutine[Any, Any, Any]) -> Any:
        if self._loop is None:
            work.close()
            raise OSError("the port is closed")
        self._broken = None
        try:
            result = self._loop.run_until_complete(work)
        finally:
            if self._broken is not None:
                raise OSError(f"the port failed: {self._broken}") from None
        return result

    def _reading(self, values: dict[int, Any], sent: float, received: float) -> Reading:
        register, mode = self._vendor.Register, self._vendor.Mode
        try:
            self._mode, code = values[register.MODE], values[register.FAULT]
            fault = f"{FAULTS.get(code, 'unknown')} (fault {code})" if self._mode == mode.FAULT else ""
            return Reading(
                angle=math.tau * values[register.POSITION],
                rate=math.tau * values[register.VELOCITY],
                torque=values[register.TORQUE],
                voltage=values[register.VOLTAGE],
                temperature=hottest((values[register.TEMPERATURE], values[register.MOTOR_TEMPERATURE])),
                enabled=self._mode not in (mode.STOPPED, mode.FAULT, mode.BRAKE),  # in a timeout it may damp or hold
                fault="watchdog expired (mode 11)" if self._mode == mode.TIMEOUT else fault,
                sent=sent,
                received=received,
            )
        except KeyError:
            raise NoReply("an incomplete reply") from None


def _listener(vendor: Any) -> Any:
    """Return the vendor's serial device with a reader that a damaged line does not end."""

    class Listener(vendor.FdcanusbDevice):  # type: ignore[misc]
        """`heard` are the last lines received."""

        def guard(self) -> None:
            """Keep other programs out, and let no write wait for a device that does not read."""
            self.heard: list[bytes] = []
            self._serial.serial.exclusive = True
            self._serial.serial.write_timeout = SILENCE

        async def _readline(self, stream: Any) -> bytes:
            line: bytes = await super()._readline(stream)
            self.heard = [*self.heard[-9:], line]
            return line

        async def _process_one_line(self) -> bool:
            try:
                return bool(await super()._process_one_line())
            except (RuntimeError, ValueError, IndexError):  # damaged, or of another protocol: no reply
                return False

    return Listener
