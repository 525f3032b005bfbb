"""An emulated drive as a process, and the faults of its wire."""

import os
import signal
import time
from functools import partial
from multiprocessing.connection import wait

import numpy as np
import pytest
import serial

import hyperflex as hf
from hyperflex.execution import MotionStream
from hyperflex.hardware import Drive, open_link
from hyperflex.hardware.emulate import Emulator, MotorModel, WireFaults
from hyperflex.hardware.emulate.faults import FaultyWire
from hyperflex.hardware.links import MAKES, emulated_device
from tests.hardware.echo import Echo
from tests.refusals import refuses

ROPE = hf.Rope.uniform(length=0.6, mass=0.03, n_links=10, radius=0.0025, friction=5e-3)
ARM = hf.Arm(length=0.105, mass=0.05, com=0.05, inertia=1e-4)


def exchange(port: serial.Serial) -> bytes:
    port.write(b"0.5\n")
    return port.readline()


def test_an_emulator_moves_logs_and_takes_faults() -> None:
    with Emulator(Echo, MotorModel(), ROPE, ARM) as emulator, serial.Serial(emulator.port, timeout=2.0) as port:
        sent = time.monotonic()
        assert abs(float(exchange(port))) < 1e-3  # it answers before it has moved
        time.sleep(1.0)
        assert float(exchange(port)) == pytest.approx(0.5, abs=0.05)
        log = emulator.log()
        assert log.goals[:, 1].tolist() == [0.5, 0.5]
        assert sent <= log.goals[0, 0] <= sent + 0.5  # both on the monotonic clock of this machine
        assert log.column("enabled").tolist() == sorted(log.column("enabled").tolist())
        assert log.rope[0].shape == (len(log.states), 10)
        t, angle, q, _ = emulator.rope_state()
        assert t >= log.column("t")[-1]
        assert angle == pytest.approx(0.5, abs=0.05)
        assert np.abs(q).max() < 1.0
        emulator.inject(WireFaults(lost=1.0), voltage=7.0)
        port.timeout = 0.1
        assert exchange(port) == b""
        log = emulator.log()
        assert log.replies["lost"] == 1
        assert log.column("voltage")[-1] == 7.0
        os.kill(emulator.pid, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(emulator.pid, signal.SIGCONT)
        until = time.monotonic() + 10.0
        while emulator.behind < 0.25 and time.monotonic() < until:
            time.sleep(0.01)
        assert emulator.behind > 0.25
        assert "ms behind the clock: no fair trial" in emulator.unfair
        emulator.inject(disconnect=True)
        with pytest.raises(OSError, match=r"write failed|disconnected|Input/output"):
            exchange(port)


LIMITS = hf.MotorLimits(speed=8.0, acceleration=40.0, torque=2.0, angles=(-1.2, 1.2))


def drive(address: str) -> Drive:
    return Drive(open_link(address), LIMITS)


@pytest.mark.nightly
@pytest.mark.parametrize("make", MAKES)
def test_a_motion_streamed_to_an_emulated_drive_with_a_bad_wire(make: str) -> None:
    """In real time, by three processes: it follows, within the limits, and the torque is off at the end."""
    _, device = emulated_device(f"emulator:{make}")
    swings = hf.arm_moves([0.0, 1.0, -1.0, 0.0], [0.5, 0.0, 0.0], [1.0, 1.0, 1.0])
    with Emulator(device, MotorModel(kp=40.0, extrapolates=make == "moteus"), ROPE, ARM) as emulator:
        with MotionStream(partial(drive, f"{make}:{emulator.port}")) as motor:
            motor.enable()
            emulator.inject(WireFaults(lost=0.01, late=0.01, garbled=0.01, truncated=0.01, delay=0.012))
            motor.start_clock()
            motor.set_motion(swings, motor.now)
            time.sleep(4.0)
            log = motor.log()
        seen = emulator.log()
    assert np.ptp(seen.column("arm_angle")) == pytest.approx(2.0, abs=0.1)
    assert np.nanmax(np.abs(log.tracking_error)) < 0.15  # 10 ms of lag, and as much of a busy host, at 4 rad/s
    assert np.abs(seen.goals[:, 1]).max() < 1.2
    assert sum(seen.replies[kind] for kind in ("lost", "late", "garbled", "truncated")) > 10
    assert seen.column("enabled")[-1] == 0.0


def test_an_emulator_ends_if_nobody_listens() -> None:
    """That children of a killed program get to know it: tests/execution/test_stream."""
    with Emulator(Echo, MotorModel()) as emulator:
        emulator._child.link.close()  # as the system does when the parent is killed
        assert wait([emulator._child._process.sentinel], 20.0), "it outlives its parent"


def test_a_device_that_cannot_be_made_is_reported_to_the_parent() -> None:
    with pytest.raises(hf.InvalidInput, match="position loop is unstable"), Emulator(Echo, MotorModel(kd=9.0)):
        pass


def test_each_fault_of_the_wire_occurs_as_often_as_requested_and_the_seed_repeats_it() -> None:
    def run(seed: int) -> tuple[dict[str, int], list[bytes]]:
        wire = FaultyWire(WireFaults(lost=0.1, late=0.2, garbled=0.15, truncated=0.05, delay=0.5, seed=seed))
        come = []
        for k in range(4000):
            wire.send(b"%06d" % k, float(k))
            come.append(wire.receive(float(k)))
            come.append(wire.receive(k + 0.5))
        return wire.counts, come

    counts, come = run(seed=3)
    # five standard deviations of a binomial count
    for kind, part in {"lost": 0.1, "late": 0.2, "garbled": 0.15, "truncated": 0.05, "good": 0.5}.items():
        assert abs(counts[kind] - 4000 * part) < 5.0 * (4000 * part * (1.0 - part)) ** 0.5, kind
    now, later = come[::2], come[1::2]
    whole = [b"%06d" % k for k in range(4000)]
    assert sum(a == b for a, b in zip(now, whole, strict=True)) == counts["good"]
    assert sum(a == b for a, b in zip(later, whole, strict=True)) == counts["late"]
    changed = [(a, b) for a, b in zip(now, whole, strict=True) if len(a) == 6 and a != b]
    assert len(changed) == counts["garbled"]
    assert all(sum(x != y for x, y in zip(a, b, strict=True)) == 1 for a, b in changed)
    assert run(seed=3)[1] == come != run(seed=4)[1]


def test_probabilities_above_one_are_refused() -> None:
    refuses("more than 1", WireFaults, lost=0.6, late=0.6)
