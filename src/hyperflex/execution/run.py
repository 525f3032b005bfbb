"""A planned cast carried out on a drive: to the start, wait, count down, stream, end with the torque off."""

import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hyperflex.budget import one_thread
from hyperflex.checks import Array
from hyperflex.errors import DriveError, EstimatorLost, HyperflexError, InvalidInput
from hyperflex.execution.cast_run import CastRun, Prediction
from hyperflex.execution.page import RunPage
from hyperflex.execution.rope_watch import ClockedSource, RopeWatch
from hyperflex.execution.stream import POLL, MotionStream, StreamLog
from hyperflex.hardware import STEP, Drive, DriveZero, open_link
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import MotorLimits, Rope, swing_rate
from hyperflex.motion import Motion, hold_arm, move_arm
from hyperflex.options import check, option
from hyperflex.planning import CastPlan, FollowOptions, FollowResult, Problem, follow_plan

LEAD = 0.5  # s between the last preparation and t = 0, so that the motion has arrived at the drive's process
HANGS = 0.2  # rad from the vertical at which a link hangs: a rope that is still wound does not


@dataclass(frozen=True)
class RunOptions:
    """Options of :func:`run_plan`.

    Parameters
    ----------
    rate : float
        Goals a second, Hz.
    approach : float
        Fraction of the motor's speed with which the arm moves to its start.
    calm : float
        Least time of that move in periods of a pendulum as long as the rope: after a minimum-jerk move of three the
        rope hardly swings.
    still : float
        Greatest change of a link's angle within a second, rad, of a rope that counts as hanging still. Rates do not
        show this: they are zero at a turning point, and estimates never are if the camera's pose is slightly wrong.
    wait : float
        Time to wait for the rope to hang still, s: a maximum if its state is observed, else the exact time.
    countdown : float
        Time between the last warning and the motion, s.
    feed_forward : bool
        Send the torque of the plan's simulation with each goal, to a drive that accepts it.
    clear_fault : bool
        Clear a fault of the device at the start.
    sampling : float
        Rate at which the rope's state is recorded, Hz.
    lag : float
        Identified lag of the drive, s: the delay of the arm behind its goals that is assumed when the rope is
        estimated from pictures and when a plan is followed.
    """

    rate: float = option(200.0, "goals a second", "Hz", sign="positive")
    approach: float = option(
        0.1, "fraction of the motor's speed with which the arm moves to its start", sign="positive"
    )
    calm: float = option(3.0, "least time of that move, in periods of the rope", sign="nonnegative")
    still: float = option(0.05, "greatest change of a link in a second that counts as still", "rad", sign="positive")
    wait: float = option(20.0, "time to wait for the rope to hang still", "s", sign="nonnegative")
    countdown: float = option(3.0, "time between the last warning and the motion", "s", sign="nonnegative")
    feed_forward: bool = option(True, "send the torque of the simulation with each goal")
    clear_fault: bool = option(False, "clear a fault of the device at the start")
    sampling: float = option(60.0, "rate at which the rope's state is recorded", "Hz", sign="positive")
    lag: float = option(0.0, "identified lag of the drive", "s", sign="nonnegative")

    def __post_init__(self) -> None:
        check(self, "")
        if self.approach > 1.0:
            raise InvalidInput("approach is faster than the motor", got=self.approach, allowed="up to 1")


def open_drive(address: str, limits: MotorLimits, zero: DriveZero | None = None, max_deviation: float = 0.3) -> Drive:
    """Return the drive at an address, not yet connected.

    Parameters
    ----------
    address : str
        As of :func:`hyperflex.hardware.open_link`.
    limits : MotorLimits
    zero : DriveZero, optional
        By default the device's own zero.
    max_deviation : float
        Angle between arm and goal, rad, at which the torque is switched off.
    """
    known = zero or DriveZero(0.0)
    return Drive(open_link(address), limits, zero=known.raw, direction=known.direction, max_deviation=max_deviation)


@interruptible(CastRun)
def run_plan(
    plan: CastPlan,
    connect: Callable[[], Drive],
    *,
    source: ClockedSource | None = None,
    follow: FollowOptions | None = None,
    options: RunOptions | None = None,
    say: Callable[[str], None] = lambda _: None,
    ready: Callable[[], object] = lambda: None,
    doubt: Callable[[str], object] | None = None,
    page: RunPage | None = None,
    motor: str = "",
) -> CastRun:
    """Carry out a planned cast on a drive.

    Parameters
    ----------
    plan : CastPlan
        With a motion.
    connect : callable
        Returns the drive, as :class:`MotionStream` takes it; its limits are the drive's own.
    source : ClockedSource, optional
        The rope's state: for waiting until it hangs still, for the closed loop, and to see whether it wound.
    follow : FollowOptions, optional
        Follow the plan in closed loop (:func:`hyperflex.follow_plan`), with these options; needs a source.
    options : RunOptions, optional
    say : callable
        Is told each phase in a line.
    ready : callable
        Is called when the drive has been read, before its torque is switched on: to ask a person, say.
    doubt : callable, optional
        Is told in a line that the zero, the rope or the arm may be wrong, by default as `say` is. Where nobody can
        judge that, let it raise: it ends the run.
    page : RunPage, optional
        Shows the run in a browser.
    motor : str
        The drive in words, for log and figure: say of an emulated one that it is.

    Returns
    -------
    CastRun
        Also of a run that was stopped: by the drive's guards, a source that lost the rope, or Ctrl-C.

    Raises
    ------
    InvalidInput
        If the plan has no motion, or the motion exceeds the drive's limits; nothing has moved. Later, if the rope does
        not hang still.
    DriveError
        If the drive cannot be reached, or the arm does not come to its start.
    Interrupted
        With the run until then.
    """
    chosen, made = options or RunOptions(), plan.required(plan.motion, "motion")
    if follow is not None and source is None:
        raise InvalidInput("following a plan requires an observed rope", fix="Give a source, or a camera")
    connect().check_motion(made)
    say("simulating the plan")
    prediction, stop, found, known = Prediction.of(plan), "", None, None
    watch = RopeWatch(None, 0.0, made, plan, math.inf, lag=chosen.lag, rate=chosen.sampling)
    duration = 120.0 + 2.0 * made.end
    drive = MotionStream(connect, rate=chosen.rate, duration=duration, clear_fault=chosen.clear_fault)
    begun = False

    def result() -> CastRun:
        watch.stop()
        log, recording, turns = drive.log(), watch.recording(), None
        if recording is not None and source is not None:
            side = 1 if prediction is None else prediction.side
            turns = source.turns(log.angle, plan.target, side, known or plan.problem.rope)
        commanded = made if drive.motion is None or not begun else drive.motion
        return CastRun(
            plan,
            commanded,
            log,
            prediction,
            recording,
            turns,
            found,
            stop,
            stopped.received,
            drive.late,
            known,
            chosen.lag,
            source is None or source.contact,
            motor,
        )

    with stoppable() as stopped, one_thread():  # matrices are small: more threads wait for each other
        try:
            with drive:
                if page is not None:
                    page.attach(drive, lambda: watch.newest, source)
                _prepare(drive, float(made.angle(0.0)), source, plan.problem, chosen, say, ready, doubt or say)
                known = None if source is None else source.rope
                begin = time.monotonic() + LEAD
                touch = prediction.touch if prediction else math.inf
                watch = RopeWatch(source, begin, made, plan, touch, lag=chosen.lag, rate=chosen.sampling)
                begun = True
                try:
                    drive.start_clock(begin)
                    fed = _FedDrive(drive, made, prediction.free_torque if prediction and chosen.feed_forward else None)
                    fed.set_motion(made, 0.0)
                    say("the cast runs")
                    watch.start()
                    if follow is not None:
                        now = replace(follow, real_time=True)
                        following = partial(follow_plan, plan, watch, motor=fed, rope=known, options=now)
                        found = _supervise(following, drive, watch)
                    criteria = plan.problem.criteria
                    end = (drive.motion or made).end
                    _sleep_until(begin + min(end, touch), drive, watch)  # what is seen after it changes nothing
                    _sleep_until(begin + end + criteria.settle + criteria.watch, drive)
                    drive.off()
                except HyperflexError as error:
                    stop = str(error)
            say("the torque is off")
        except DriveError as error:  # at its end: the torque may be on
            if not begun:
                raise
            stop = f"{stop} {error}".lstrip()
        run = result()  # here, where an interrupt is noticed
    return stopped.deliver(result() if stopped.received else run)


class _FedDrive:
    """A drive that gets the torque of a motion with all motions (a :class:`hyperflex.interfaces.Motor`).

    It is sent while a motion is within 0.2 rad of the one whose `torque` it is: times (K,), s, and N m (K,).
    """

    def __init__(self, drive: MotionStream, planned: Motion, torque: tuple[Array, Array] | None) -> None:
        self.drive, self.planned, self.torque = drive, planned, torque

    def set_motion(self, motion: Motion, at: float) -> bool:
        """Stream a motion from a time `at`, s, on; return whether it was taken."""
        torque = self.torque
        if torque is not None:
            far = np.abs(motion.angle(torque[0]) - self.planned.angle(torque[0])) > 0.2  # rad
            torque = torque[0], np.where(far, 0.0, torque[1])
        return self.drive.set_motion(motion, at, torque)

    def angle(self, t: float) -> float:
        """Return the encoder's angle at a time `t`, s, rad."""
        return self.drive.angle(t)


def _prepare(
    drive: MotionStream,
    start: float,
    source: ClockedSource | None,
    problem: Problem,
    options: RunOptions,
    say: Callable[[str], None],
    ready: Callable[[], object],
    doubt: Callable[[str], object],
) -> None:
    """Bring the arm to the start, rad, wait until the rope hangs still, and count down."""
    free = drive.state().angle
    if abs(free - problem.rope.hanging_angle) > HANGS:
        doubt(f"without torque the arm is at {free:.2f} rad: if it hangs freely there, its zero is wrong")
    ready()
    if source is not None:  # a rope that is still wound would be pulled
        _wait_until_still(drive, hold_arm(drive.state().angle), source, problem.rope, options, say, still=math.inf)
    _approach(drive, start, problem, options, say)
    _wait_until_still(drive, hold_arm(start), source, problem.rope, options, say)
    _compare_weight(drive.log(), problem, doubt)
    for k in range(math.ceil(options.countdown), 0, -1):
        say(f"the cast begins in {k} s")
        _sleep_until(time.monotonic() + min(1.0, options.countdown), drive)


def _approach(
    drive: MotionStream, start: float, problem: Problem, options: RunOptions, say: Callable[[str], None]
) -> None:
    """Switch the torque on, and bring the arm to the start, rad, so slowly that the rope hardly swings."""
    limits, rope = problem.limits, problem.rope
    now = drive.enable().angle
    way = abs(start - now)
    if way > math.pi:
        raise InvalidInput(
            "the way to the start is more than half a turn",
            got=[now, start],
            allowed="half",
            fix="Let the arm hang and set the zero again, or turn the arm nearer by hand",
        )
    if way > 1e-4:
        # peak speed 1.875 way / T and acceleration 5.774 way / T^2 of minimum jerk
        slow = options.approach * limits.speed, options.approach * limits.acceleration
        calm = options.calm * math.tau / swing_rate(rope)
        duration = max(1.875 * way / slow[0], math.sqrt(5.774 * way / slow[1]), calm)
        say(f"the arm moves slowly from {now:.2f} to {start:.2f} rad, in {duration:.1f} s")
        begin = time.monotonic() + LEAD
        drive.start_clock(begin)
        drive.set_motion(move_arm(now, start, duration, "minimum-jerk"), 0.0)
        _sleep_until(begin + duration + LEAD, drive)
        there = drive.state().angle
        if abs(there - start) > STEP:
            what = f"The arm is at {there:.3f} rad, not at its start at {start:.3f} rad"
            raise DriveError(f"{what}. Allowed: {STEP:g} rad. Check its load, its gains and its zero.")


def _wait_until_still(
    drive: MotionStream,
    held: Motion,
    source: ClockedSource | None,
    rope: Rope,
    options: RunOptions,
    say: Callable[[str], None],
    still: float | None = None,
) -> None:
    still = options.still if still is None else still
    if source is None:
        if options.wait:
            say(f"nothing shows whether the rope hangs still: waiting {options.wait:g} s")
        _sleep_until(time.monotonic() + options.wait, drive)
        return
    say("waiting until the rope hangs" + " still" * math.isfinite(still))
    begin = time.monotonic()
    source.start_clock()
    seen: list[tuple[float, Array]] = []
    while True:
        _sleep_until(time.monotonic() + 10.0 * POLL, drive)
        t = time.monotonic() - begin
        try:
            state = source.state(t, held)
        except EstimatorLost:  # not found yet
            if t > options.wait:
                raise
            continue
        seen = [*(each for each in seen if each[0] > t - 1.0), (t, state.q)]
        moved = float(np.ptp([q for _, q in seen], axis=0).max())
        watched = still == math.inf or seen[0][0] <= t - 0.9 * min(1.0, options.wait)
        turned = (state.q - rope.hanging_angle + math.pi) % math.tau - math.pi  # a picture shows no whole turns
        away = float(np.abs(turned).max())
        if moved <= still and away <= HANGS:
            if watched:
                return
        elif t > options.wait:
            fix = "Hold it still, allow a longer wait, or more change"
            if away > HANGS and moved <= still:
                raise InvalidInput("the rope does not hang down", got=away, allowed=f"{HANGS:g} rad", fix="Unwind it")
            raise InvalidInput("the rope still swings", got=moved, allowed=f"up to {still:g} rad in a second", fix=fix)


def _compare_weight(log: StreamLog, problem: Problem, doubt: Callable[[str], object]) -> None:
    """Say so if the last half second's torque is far from what holds arm and rope; one of the wrong sign is refused.

    It does not show a wrong direction, with which angle and torque both have the other sign.
    """
    angle, torque = (log.column(name)[-math.ceil(0.5 * log.rate) :] for name in ("angle", "torque"))
    if not np.isfinite(torque).any():
        return
    where, held = float(angle.mean()), float(np.nanmean(torque))
    angles = where, problem.rope.hanging_angle + 0.5 * math.pi
    expected, most = problem.arm.weight_torque(problem.rope, angles).tolist()
    if held * expected < 0.0 and min(abs(held), abs(expected)) > 0.5 * most:
        raise InvalidInput(
            "the motor holds arm and rope with a torque of the wrong sign",
            got=held,
            allowed=f"about {expected:.3f} N m",
            fix="Check the zero",
        )
    if abs(held - expected) > 0.5 * most:
        causes = "Check zero, rope and arm; friction of a gear may hide the weight"
        doubt(f"at {where:.2f} rad the motor holds arm and rope with {held:.3f} N m, not {expected:.3f}. {causes}")


def _supervise(follow: Callable[[], FollowResult], drive: MotionStream, watch: RopeWatch) -> FollowResult:
    """Return the result of a function that runs in a thread; raise what ends the drive meanwhile, or a lost rope.

    The thread is then left alone, for a source may hang in it. It moves nothing any more: the drive ends with the run.
    """
    result: Future[FollowResult] = Future()

    def work() -> None:
        try:
            result.set_result(follow())
        except BaseException as error:  # noqa: BLE001 whatever it is, it is raised by `result`
            result.set_exception(error)

    threading.Thread(target=work, name="follower", daemon=True).start()
    while not result.done():
        _sleep_until(time.monotonic() + POLL, drive, watch)
        if drive.motion is not None and drive.now > drive.motion.breaks[-1]:
            raise EstimatorLost("The closed loop has not decided by the end of the motion: its source may hang.")
    return result.result()


def _sleep_until(end: float, drive: MotionStream, watch: RopeWatch | None = None) -> None:
    """Wait until a moment of the monotonic clock, s; raise what ended the drive's process, or why the rope is lost."""
    while (rest := end - time.monotonic()) > 0.0:
        time.sleep(min(POLL, rest))
        drive.raise_if_ended()
        if watch is not None:
            watch.raise_if_lost()
