"""Hardware in the loop: casts on an emulated drive in real time, as planned, in closed loop, and after learning.

python -m benchmarks.hand planned/*.toml                      plans of hyperflex cast
python -m benchmarks.hand planned/*.toml --motor emulator:dynamixel
python -m benchmarks.hand --kept                              the page of all existing rows

A renderer, the tracker, the follower, the process that streams to the drive, and the emulated drive with its rope are
separate processes. The rope in the emulator is 1.5 % longer and heavier than the planner's and has 10 % more friction;
its links are divided as in a verified run. The motor acts 15 ms late, what it reads is noisy, and the target is 1 cm
aside. The tracker's camera is not the renderer's: its pose is off as after a calibration. Closed loop and learning use
the rope tracked in the rendered pictures and the lag of the drive, which is identified once, in a test motion. Each
target has a cast as planned, a cast in closed loop, and learning from at most three casts: the first of them is the
cast as planned, and a motion that winds the rope in the camera's view is kept. A cast succeeds if the emulated rope's
true state keeps the required turns for the required time.

A cast in which the emulator fell behind real time is not a fair trial: it is repeated, at most three times, and
recorded separately in the row. Any other cast that fails counts as a failure, with its reason. Rows are kept in
hand.jsonl: the same command continues an interrupted run.
"""

import argparse
import math
import resource
import time
import zlib
from collections import Counter
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benchmarks import log as lines
from benchmarks import machine

from hyperflex import files
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.execution import (
    CameraRope,
    CastLog,
    CastRun,
    EmulatedCamera,
    LearningOptions,
    RunOptions,
    emulator_of,
    learn_cast,
    observed_turns,
    open_drive,
    record_test_motion,
    run_plan,
)
from hyperflex.hardware import Emulator, MotorModel, emulated_device, identify_drive
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, MotorLimits, Peg, Rope
from hyperflex.planning import CastPlan, FollowOptions, read_plan, scaled_rope
from hyperflex.vision import Camera

RESULTS = Path(__file__).parent / "results"
LENGTH, MASS, FRICTION = 1.015, 1.015, 1.1  # of the planner's
LATE, ASIDE = 0.015, 0.01  # s, m
NOISE = {"angle_noise": 5e-4, "rate_noise": 0.05, "torque_noise": 0.02}  # rad, rad/s, N m; of the motor's measurements
TURNED, SHIFTED, SCALED = 0.2, 2e-3, 1e-3  # deviations of the pose: degrees, m, part of the distance
BEHIND = 0.02  # s behind real time: the response time of a usual drive
REPEATS = 3  # of a cast that was not a fair trial
CASTS = 3  # that are learned from
WAYS = ("nominal", "closed", "learned")
CODE = ("planning", "simulation", "estimate", "hardware", "execution")  # packages that make a row


class Rig:
    """An emulated drive with the other rope, a camera and a tracker; they keep running from cast to cast."""

    def __init__(self, path: Path, plan: CastPlan, motor: str, lag: float, stack: ExitStack) -> None:
        other = scaled_rope(plan.problem.rope, LENGTH, MASS, FRICTION)
        self.rope = replace(plan, problem=replace(plan.problem, rope=other)).setup().rope
        self.peg = replace(plan.target, x=plan.target.x + ASIDE)
        make, self.emulator = emulator_of(plan, motor, model(motor), rope=self.rope, obstacles=(self.peg,))
        stack.enter_context(self.emulator)
        camera = stack.enter_context(EmulatedCamera(plan, self.emulator, self.rope, self.peg))
        task = replace(camera.task, camera=calibrated(camera.task.camera, zlib.crc32(path.stem.encode())))
        self.source = stack.enter_context(CameraRope(camera.frames, task))
        address = f"{make}:{self.emulator.port}"
        self.connect = partial(open_drive, address, plan.problem.limits, None, 0.5)
        self.options = RunOptions(wait=5.0, countdown=0.0, lag=lag)

    def cast(self, plan: CastPlan, follow: bool = False) -> tuple[CastRun | None, dict[str, Any]]:
        """Carry out a plan, again if the emulator fell behind real time; return the run and its result."""
        unfair: list[dict[str, Any]] = []
        while True:
            run, found = self.once(plan, follow)
            if found["behind"] <= BEHIND or len(unfair) == REPEATS:
                return run, {**found, "unfair": unfair}
            unfair.append({name: found[name] for name in ("behind", "won", "stopped")})

    def once(self, plan: CastPlan, follow: bool) -> tuple[CastRun | None, dict[str, Any]]:
        """Unwind the rope and carry out a plan; return the run and its result."""
        closed = FollowOptions() if follow else None
        made = plan.required(plan.motion, "motion")
        begin = time.monotonic()
        self.emulator.hang(float(made.angle(0.0)))
        try:
            run = run_plan(plan, self.connect, source=self.source, follow=closed, options=self.options)
        except HyperflexError as error:  # before the cast
            return None, lost(str(error), self.behind(begin))
        turns = true_turns(self.emulator, plan, self.rope, self.peg)
        decided = [] if run.follow is None else run.follow.decisions
        return run, {
            "won": abs(turns) >= plan.problem.criteria.turns and not run.stopped,
            "turns": turns,
            "seen": run.turns,
            "wound": run.wound,
            "stopped": run.stopped,
            "cycles": len(run.log.rows),
            "missed": run.log.missed,
            "late": run.late,
            "frames": len(self.source.spots),
            "behind": self.behind(begin),
            "decisions": [[each.action, each.before, each.after, each.seconds] for each in decided],
        }

    def behind(self, begin: float) -> float:
        """Return the longest delay of motor and rope behind real time since a given time, s."""
        log = self.emulator.log()
        return float(log.column("behind")[log.column("t") >= begin].max())


def lost(why: str, behind: float = 0.0) -> dict[str, Any]:
    """Return the row entries of a cast that was not carried out."""
    none: dict[str, Any] = {"turns": None, "seen": None, "wound": None, "decisions": []}
    return {"won": False, "stopped": why, "behind": behind, "cycles": 0, "missed": 0, "late": 0, "frames": 0, **none}


def calibrated(camera: Camera, seed: int) -> Camera:
    """Return a camera with the errors of a calibration: the swing plane is slightly rotated and shifted."""
    random = np.random.default_rng(seed)
    turned = cv2.Rodrigues(np.radians(TURNED) * random.standard_normal(3))[0]
    rotation = cv2.Rodrigues(cv2.Rodrigues(camera.rotation)[0] @ turned)[0][:, 0]
    place = camera.translation * (1.0 + SCALED * random.standard_normal())
    return replace(camera, rotation=rotation, translation=place + SHIFTED * random.standard_normal(3) * [1.0, 1.0, 0.0])


def model(motor: str) -> MotorModel:
    """Return the emulated motor."""
    return MotorModel(latency=LATE, extrapolates=motor.startswith("emulator:moteus"), **NOISE)


def true_turns(emulator: Emulator, plan: CastPlan, rope: Rope, peg: Peg) -> float:
    """Return the least turns of the emulated rope about its peg during observation, until the torque was off."""
    log = emulator.log()
    t, on = log.column("t"), log.column("enabled") > 0.0
    watched = np.flatnonzero(on & (t >= t[on][-1] - plan.problem.criteria.watch))[::10]
    q, angles = log.rope[0], log.column("arm_angle")
    arm = plan.problem.arm
    found = [observed_turns(rope, arm, RopeState(t[k], q[k], q[k]), angles[k], peg) for k in watched]
    return float(min(found, key=abs))


def row(path: Path, motor: str, lag: float) -> dict[str, Any]:
    """Return the results of a plan with each method."""
    plan = read_plan(path)
    assert isinstance(plan, CastPlan)
    begin, used = time.monotonic(), usage()
    casts: list[dict[str, Any]] = []
    found: dict[str, dict[str, Any]] = {}
    learned_from: list[str] = []
    started, why = begin, ""
    try:
        with ExitStack() as stack:
            rig = Rig(path, plan, motor, lag, stack)
            started = time.monotonic()

            def cast(made: CastPlan, follow: bool = False) -> CastRun | None:
                run, became = rig.cast(made, follow)
                casts.append(became)
                return run

            nominal = cast(plan)
            found["nominal"] = casts[0]
            cast(plan, follow=True)
            found["closed"] = casts[1]
            first = [] if nominal is None or nominal.recording is None else [nominal.cast_log()]

            def once(made: CastPlan) -> CastLog:
                if first:
                    return first.pop()
                run = cast(made)
                if run is None:
                    raise InvalidInput(casts[-1]["stopped"])
                return run.cast_log()

            options = LearningOptions(wins=1)
            learned = learn_cast(plan, once, attempts=CASTS, options=options)
            learned_from = [str(each) for each in learned.attempts]
            if not learned.success:
                cast(replace(plan, problem=learned.problem, moves=learned.moves))
            found["learned"] = casts[0] if learned.success and len(learned.attempts) == 1 else casts[-1]
    except HyperflexError as error:
        why = str(error)
    return {
        "plan": path.stem,
        **{way: found.get(way, lost(why)) for way in WAYS},
        "casts": casts,
        "learned_from": learned_from,
        "seconds": time.monotonic() - begin,
        "starting": started - begin,
        "processor_time": usage() - used,
        "kernels": SOURCE_HASH,
        "code": lines.sources(*CODE),
    }


def usage() -> float:
    """Return the processor time of this process and of those that have ended, s."""
    each = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in each)


def identified_lag(motor: str) -> float:
    """Return the lag of the drive without a rope, identified in a test motion, s."""
    limits, device = MotorLimits(), emulated_device(motor)
    assert device is not None
    make, kind = device
    with Emulator(kind, model(motor), None, Arm(inertia=1e-3)) as emulator:
        connect = partial(open_drive, f"{make}:{emulator.port}", limits, None, 0.5 + 0.05 * limits.speed)
        return identify_drive(record_test_motion(connect)).lag


def page(rows: list[dict[str, Any]]) -> str:
    """Return the page of results."""
    casts = [each for row in rows for each in row["casts"]]
    missed, cycles = (sum(each[name] for each in casts) for name in ("missed", "cycles"))
    late = sum(each["late"] for each in casts) + sum(one[0] == "late" for each in casts for one in each["decisions"])
    decided = [one[3] for each in casts for one in each["decisions"]] or [math.nan]
    unfair = [one["behind"] for each in casts for one in each["unfair"]]
    still = sum(each["behind"] > BEHIND for each in casts)
    verdicts = Counter("not known" if each["wound"] is None else each["wound"] == each["won"] for each in casts)
    about = (
        f"{len(rows)} planned casts on an emulated drive ({rows[0]['motor']}), in real time. All emulated: motor, rope "
        "and pictures. Renderer, tracker, follower, stream and drive are separate processes. The emulated rope is 1.5 "
        "% longer and heavier than the planner's and has 10 % more friction; its links are divided as in a verified "
        f"run. The motor acts 15 ms late (identified: {1e3 * rows[0]['lag']:.1f} ms), the target is displaced by 1 cm. "
        f"The motor's measurements have noise: {1e3 * NOISE['angle_noise']:g} mrad, {NOISE['rate_noise']:g} rad/s, "
        f"{NOISE['torque_noise']:g} N m. The camera has 480x480 pixels and 30 frames a second, and ten markers are on "
        "the rope. The tracker's camera has the errors of a calibration, different for each plan: its pose is off by "
        f"{TURNED:g} degrees about each axis, {1e3 * SHIFTED:g} mm in the plane and {100 * SCALED:g} % of the distance "
        "(standard deviations). A cast succeeds if the true rope keeps the required turns for the required time. "
        "Learned: the first cast that the camera saw wound, among the cast as planned and up to two that learned from "
        "it, or else one more. This is the best of several casts; the other columns are single casts. The emulated "
        "drive allows pauses of 0.25 s, because it shares two cores with all other processes. "
        f"{'' if len(rows) >= 20 else 'Not measured on 20 targets yet.'}"
    )
    found = (
        f"Missed cycles of the drive: {missed} of {cycles} ({missed / max(cycles, 1):.2%}). Corrections that came too "
        f"late: {late} of {len(decided)}; a decision took {np.median(decided):.2f} s in the median and "
        f"{max(decided):.2f} s at most. The result reported by the camera, or else by the torque, was right in "
        f"{verdicts[True]} of {len(casts)} casts, wrong in {verdicts[False]}, and unknown in {verdicts['not known']}."
    )
    fair = (
        f"Casts in which the emulator fell more than {1e3 * BEHIND:.0f} ms behind real time and which were repeated: "
        f"{len(unfair)}{f', by up to {1e3 * max(unfair):.0f} ms' if unfair else ''}. Casts that count as they are "
        f"after {REPEATS} repeats: {still}."
    )
    won = " | ".join(str(sum(row[way]["won"] for row in rows)) for way in WAYS)
    text = [
        "# Hardware in the loop",
        "",
        about,
        "",
        "| as planned | closed loop | learned after at most three casts | of |",
    ]
    text += ["|---|---|---|---|", f"| {won} | {len(rows)} |", "", found, "", fair, "", "True turns (w: success):", ""]
    text += ["| plan | as planned | closed loop | decisions | learned | casts |", "|---|---|---|---|---|---|"]
    for row in rows:
        turns = [_turns(row[way]) for way in WAYS]
        actions = ", ".join(one[0] for one in row["closed"]["decisions"])
        text.append(f"| {row['plan']} | {turns[0]} | {turns[1]} | {actions} | {turns[2]} | {len(row['casts'])} |")
    reasons = [
        f"- {row['plan']}, {number}: {why}"
        for row in rows
        for number, why in [*((f"cast {k + 1}", each["stopped"]) for k, each in enumerate(row["casts"])), *_left(row)]
        if why
    ]
    text += ["", "Casts that were stopped or not carried out (counted as failures):", "", *reasons] if reasons else []
    return "\n".join([*text, "", "    python -m benchmarks.hand PLANS"]) + "\n"


def _turns(cast: dict[str, Any]) -> str:
    return "none" if cast["turns"] is None else f"{abs(cast['turns']):.2f}{' w' * cast['won']}"


def _left(row: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the methods without a cast, with the reason."""
    return [(way, row[way]["stopped"]) for way in WAYS if row[way] not in row["casts"]]


def main() -> None:
    """Carry out the plans; print and keep a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plans", type=Path, nargs="*")
    parser.add_argument("--motor", default="emulator:moteus?watchdog=0.5")
    parser.add_argument("--lag", type=float, help="of the drive, s; by default it is identified")
    parser.add_argument("--kept", action="store_true", help="make no casts: the page of all existing rows")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder")
    options = parser.parse_args()
    about, log = machine.describe(), options.out / "hand.jsonl"
    rows = lines.read(log)
    lag = options.lag
    for path in () if options.kept else options.plans:
        if any((each["plan"], each["motor"]) == (path.stem, options.motor) for each in rows):
            continue
        lag = identified_lag(options.motor) if lag is None else lag
        found = {**row(path, options.motor, lag), "motor": options.motor, "lag": lag}
        rows.append(found)
        lines.append(log, found)
        told = {way: _turns(found[way]) for way in WAYS}
        print(path.stem, told, f"{found['seconds']:.0f} s, {found['processor_time']:.0f} s of processors", flush=True)
    if not rows:
        raise SystemExit("no rows yet")
    text = f"{page(rows)}\n{machine.sentence(about)} {lines.made(rows)} {lines.made(rows, 'code')}\n"
    print(text)
    files.write_text(log.with_name("hand.md"), text)


if __name__ == "__main__":
    main()
