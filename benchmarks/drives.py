"""Goals streamed at 200 Hz to emulated drives in other processes: times of sending and reply.

python benchmarks/drives.py                  ten minutes for each make; results in benchmarks/results/
python benchmarks/drives.py --together       all makes at the same time: ten minutes in all
python benchmarks/drives.py --seconds 60     a shorter run
"""

import argparse
import itertools
import json
import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import machine
import numpy as np
from cast import cable

import hyperflex as hf
from hyperflex.errors import DriveError
from hyperflex.execution import MotionStream
from hyperflex.hardware import Drive, Goal, open_link
from hyperflex.hardware.emulate import DynamixelDevice, Emulator, MoteusDevice, MotorModel, ODriveDevice, Plant

RESULTS = Path(__file__).parent / "results"
RATE, LINKS, SECONDS = 200.0, 50, 600.0  # Hz; of the rope; s of streaming
SPAN = 10.0  # s of physics alone
WATCHDOGS = {"moteus": 0.03, "dynamixel": 0.1, "odrive": 0.1}  # s; those that the drives' links set or require
KILLS = 3  # programs that are killed
DEVICES = {"moteus": MoteusDevice, "dynamixel": DynamixelDevice, "odrive": ODriveDevice}
# moteus controllers advance the goal with its rate between two goals; the others do not
MODELS = {name: MotorModel(extrapolates=name == "moteus") for name in DEVICES}
LIMITS = hf.MotorLimits(speed=8.0, acceleration=40.0, torque=2.0)
ARM = hf.Arm(length=0.105)
COLUMNS = ("p50", "p99", "most")


def drive(make: str, port: str) -> Drive:
    """Return a drive, for the process that streams."""
    return Drive(open_link(f"{make}:{port}"), LIMITS)


def swings(seconds: float) -> hf.Motion:
    """Return swings of the arm to 1 rad on both sides, one second each, after one second of rest."""
    count = int(seconds) - 2
    angles = np.append(0.0, np.where(np.arange(count) % 2, -1.0, 1.0))
    return hf.arm_moves(angles, np.eye(1, count)[0], np.ones(count))


def stream(make: str, seconds: float) -> dict[str, Any]:
    """Stream for some time to an emulated drive of a make."""
    rope = cable(LINKS, scaled=True)
    emulator = Emulator(DEVICES[make], MODELS[make], rope, ARM, sample=0.02, duration=seconds + 10.0)
    with emulator, MotionStream(partial(drive, make, emulator.port), rate=RATE, duration=seconds + 10.0) as motor:
        processes = emulator.pid, motor.pid
        before, begin = [processor(each) for each in processes], time.monotonic()
        motor.enable()
        motor.start_clock()
        motor.set_motion(swings(seconds), motor.now)
        while (rest := begin + seconds - time.monotonic()) > 0.0:
            time.sleep(min(rest, 1.0))
            motor.pid  # noqa: B018 -- raises what has ended the stream
        spent, span = [processor(each) for each in processes], time.monotonic() - begin
        log, seen, zero = motor.log(), emulator.log(), time.monotonic() - motor.now
    sent, received = log.column("sent"), log.column("received")
    answered = log.column("lost") == 0
    pauses = np.diff(seen.goals[seen.goals[:, 0] > zero, 0])
    return {
        "seconds": span,
        "sent": int(sent.size),
        "left out": log.missed,
        "lost": int((~answered).sum()),
        "jitter": quantiles(log.jitter),
        "period": quantiles(np.abs(np.diff(sent) - 1.0 / RATE)),
        "reply": quantiles((received - sent)[answered]),
        "pause": float(pauses.max()),
        "watchdogs": int((pauses > WATCHDOGS[make]).sum()),
        "tracking": float(np.nanmax(np.abs(log.tracking_error))),
        "passive": max(passive_after(make) for _ in range(KILLS)),
        "emulator": (spent[0] - before[0]) / span,
        "stream": (spent[1] - before[1]) / span,
    }


def passive_after(make: str) -> float:
    """Return the time from the death of the program that streams, by SIGKILL, until the device acts by itself, s.

    It then switches its torque off; a Dynamixel holds its position.
    """
    emulator = Emulator(DEVICES[make], MODELS[make], cable(LINKS, scaled=True), ARM, sample=1e-3)
    killed = suppress(DriveError)  # that no process confirms that the torque is off
    with emulator, killed, MotionStream(partial(drive, make, emulator.port), rate=RATE) as motor:
        motor.enable()
        motor.start_clock()
        motor.set_motion(swings(10.0), motor.now)
        time.sleep(1.5)
        begin = time.monotonic()
        os.kill(motor.pid, signal.SIGKILL)
        time.sleep(0.5)
        log = emulator.log()
    own = log.goals[log.goals[:, 0] > begin + 0.01, 0]  # s; by then all messages in transit have arrived
    off = log.column("t")[(log.column("t") > begin) & (log.column("enabled") == 0.0)]
    return float(np.concatenate([own, off, [np.inf]]).min() - begin)


def plant_costs() -> str:
    """Return the processor time of the emulated physics as a table of Markdown: of free swings, and past a peg."""
    rows = [["links", "swings", "processor s per s", "worst 50 ms", "longest step, ms"], ["---"] * 5]
    for links, pegs in itertools.product((20, 50, 100), ([], [hf.Peg(0.15, -0.9, 0.03)])):
        plant, motion = Plant(MotorModel(), cable(links, scaled=True), ARM, pegs), swings(SPAN)
        plant.warm()
        plant.set_enabled(True)
        t, spent = np.arange(plant.step, SPAN, plant.step), []
        for now, angle, rate in zip(t, motion.angle(t), motion.rate(t), strict=True):
            plant.set_goal(Goal(angle, rate))
            begin = time.process_time()
            plant.advance(now)
            spent.append(time.process_time() - begin)
        window = np.ones(round(0.05 / plant.step))
        worst = np.convolve(spent, window, "valid").max() / 0.05
        where = "striking a peg" if pegs else "free"
        rows.append([str(links), where, f"{sum(spent) / SPAN:.2f}", f"{worst:.2f}", f"{1e3 * max(spent):.1f}"])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def quantiles(times: np.ndarray) -> dict[str, float]:
    """Return median, 99th percentile and maximum, ms."""
    return {name: 1e3 * float(np.quantile(times, part)) for name, part in zip(COLUMNS, (0.5, 0.99, 1.0), strict=True)}


def processor(pid: int) -> float:
    """Processor time of a process, s (Linux; nan elsewhere)."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def table(found: dict[str, dict[str, Any]]) -> str:
    """Return the results as a table of Markdown."""
    head = ["emulated", "goals", "cycles omitted", "without reply", "watchdogs missed", "longest pause, ms"]
    head += ["sent late, ms: p50", "p99", "most", "reply after, ms: p50", "p99", "most"]
    head += [
        "passive after SIGKILL, ms",
        "greatest tracking error, rad",
        "processor of the emulator, %",
        "of the stream, %",
    ]
    rows = [head, ["---"] * len(head)]
    for make, each in found.items():
        counts = [each["sent"], each["left out"], each["lost"], each["watchdogs"], f"{1e3 * each['pause']:.1f}"]
        times = [f"{each[what][part]:.2f}" for what in ("jitter", "reply") for part in COLUMNS]
        passive, tracking = f"{1e3 * each['passive']:.0f}", f"{each['tracking']:.3f}"
        shares = [f"{100 * each[process]:.0f}" for process in ("emulator", "stream")]
        rows.append([make, *map(str, counts), *times, passive, tracking, *shares])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def page(found: dict[str, dict[str, Any]], failed: list[str], about: dict[str, str]) -> str:
    """Return the page of results."""
    seconds = min((each["seconds"] for each in found.values()), default=0.0)
    busy = float(about["load before"]) > 0.5
    note = "**The machine was busy with other work: repeat this on an idle one.**" if busy else "The machine was idle."
    how = (
        f"{seconds:.0f} s for each make, {about['together']}, with the torque on, in three processes: a program, the "
        f"stream (`MotionStream`), and the emulator, whose motor turns an arm with a rope of {LINKS} links. Sent late: "
        "time from when a goal was due to when it was sent. Reply after: time from the sending to the valid answer. "
        "Pauses are those between two goals that the device received: the watchdog expires after 30 ms (moteus) or "
        "100 ms. "
        "Stream and emulator run at real-time priority where the system allows it. "
        f"Passive: the latest of {KILLS} times after which the device acts by itself once its host is killed."
    )
    emulated = (
        "**Everything here is emulated.** A pseudo-terminal shows the jitter of the host and the logic of the "
        "protocols. It has neither the latency of USB nor a transmission time, and an emulator is no firmware."
    )
    costs = (
        "The physics alone, in steps of 1 ms: processor time per simulated second, on average and in the worst 50 ms, "
        "and the longest step."
    )
    command = "Reproduce: `python benchmarks/drives.py`"
    title = "# Goals streamed at 200 Hz to emulated drives"
    return "\n\n".join(
        [title, table(found), *failed, how, emulated, note, costs, plant_costs(), machine.sentence(about), command]
    )


def main() -> None:
    """Measure, and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of streaming, for each make")
    parser.add_argument("--together", action="store_true", help="stream to all makes at the same time")
    parser.add_argument("--makes", nargs="+", choices=DEVICES, default=list(DEVICES))
    chosen = parser.parse_args()
    about, found, failed = machine.describe(), {}, []
    with ProcessPoolExecutor(len(chosen.makes) if chosen.together else 1, get_context("spawn")) as pool:
        for make, run in [(make, pool.submit(stream, make, chosen.seconds)) for make in chosen.makes]:
            try:
                found[make] = run.result()
            except DriveError as error:
                failed.append(f"{make} ended early: {error}")
    about["together"] = "all makes at the same time" if chosen.together else "one make after another"
    about["load after"] = machine.load()
    text = page(found, failed, about)
    print(text)
    (RESULTS / "drives.md").write_text(text + "\n")
    (RESULTS / "drives.json").write_text(json.dumps({"machine": about, "makes": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
