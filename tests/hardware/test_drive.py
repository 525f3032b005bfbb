"""The guards of a drive, one by one, on a motor in memory under a clock of the test's own."""

import atexit
import dataclasses
import math
import signal
import threading

import numpy as np
import pytest

from hyperflex.errors import DriveError
from hyperflex.hardware import Drive, Goal
from hyperflex.model import MotorLimits
from hyperflex.motion import arm_moves, hold_arm, move_arm, moving_pivot, sampled_motion, torque_profile
from tests.hardware.fake import REQUEST, FakeLink, silent
from tests.refusals import fails, refuses

LIMITS = MotorLimits(speed=10.0, acceleration=40.0, torque=1.0, angles=(-3.0, 3.0))


def ready(link, **options):
    """A drive with its torque on."""
    drive = Drive(link, LIMITS, **options)
    drive.connect()
    drive.enable()
    return drive


def stream(drive, goals):
    """Send goals, 5 ms apart."""
    for goal in goals:
        drive.link.now += 0.005 - REQUEST
        drive.command(goal)


def run(link):
    with Drive(link, LIMITS) as drive:
        drive.enable()
        drive.command(Goal(0.0))
        drive.read()


@pytest.fixture
def link():
    return FakeLink()


@pytest.fixture
def drive(link):
    with ready(link) as made:
        yield made


# ---------------------------------------------------------------------- connection


def test_torque_that_was_left_on_is_switched_off(link):
    link.state["enabled"] = True
    with Drive(link, LIMITS) as drive:
        assert not link.state["enabled"]
        assert not drive.read().enabled


def test_a_device_that_does_not_answer_is_refused_within_a_moment(link):
    link.fails = [None, *silent(1000)]
    fails(DriveError, "does not answer", Drive(link, LIMITS).connect)
    assert link.now < 0.3
    assert not link.opened


@pytest.mark.parametrize("error", [DriveError, OSError, RuntimeError])
def test_a_port_that_does_not_open_leaves_nothing_behind(link, error):
    before = signal.getsignal(signal.SIGTERM)
    link.fails = [error("no such port")]
    fails(DriveError, "no such port", Drive(link, LIMITS).connect)
    assert signal.getsignal(signal.SIGTERM) is before


# ---------------------------------------------------------------------- limits


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Goal(3.2), "outside the motor's angles"),
        (Goal(0.0, 10.5), "too fast"),
        (Goal(0.1), "far from the shaft"),
        (Goal(0.0, 5.0), "changes its rate too fast"),
        (Goal(math.nan), "goal angle"),
        (Goal(0.0, math.inf), "goal rate"),
        (Goal(0.0, 0.0, math.nan), "goal torque"),
    ],
)
def test_a_goal_beyond_a_limit_is_not_sent(drive, link, goal, words):
    refuses(words, drive.command, goal)
    assert link.goals() == []


def test_a_torque_beyond_its_limit_is_clipped(link):
    with ready(link, direction=-1) as drive:
        drive.command(Goal(0.0, 0.0, 1.5))
        drive.command(Goal(0.0, 0.0, -1.5))
    assert [torque for *_, torque in link.goals()] == [-1.0, 1.0]


def test_a_goal_is_checked_by_its_own_time(link):
    """A full stroke at the limits; the host pauses for 6 ms between one goal's evaluation and its sending."""
    motion = move_arm(0.0, 2.0, duration=2.0 * math.sqrt(2.0 / LIMITS.acceleration), profile="bang-bang")
    with ready(link) as drive:
        start = link.now
        for k in range(91):
            link.now = at = max(start + 0.005 * k, link.now)
            link.now += 0.006 if k == 10 else 0.0
            drive.command(Goal(float(motion.angle(at - start)), float(motion.rate(at - start))), at)
    assert link.goals()[-1][0] == pytest.approx(2.0)


@pytest.mark.parametrize("ago", [0.051, -0.002, math.nan])
def test_a_goal_of_another_time_is_not_sent(drive, link, ago):
    refuses("goal's time is not now|at ", drive.command, Goal(0.0), link.now - ago)
    drive.command(Goal(0.0), link.now - 0.049)
    assert len(link.goals()) == 1


def test_a_goal_that_cannot_be_braked_before_the_limit_is_not_sent(link):
    link.state["angle"] = 2.9  # 0.15 rad with the step that is allowed: braked from sqrt(2 40 0.15) = 3.5 rad/s
    with ready(link) as drive:
        drive.command(Goal(2.9))
        for rate in (0.1, 0.2, 0.3):
            drive.command(Goal(2.9, rate))
        drive._rate_pace.left = 10.0
        refuses("no room to brake", drive.command, Goal(2.9, 3.6))


def test_a_first_goal_needs_a_reading_of_just_now(drive, link):
    link.now += 0.06
    refuses("fresh reading", drive.command, Goal(0.0))
    drive.read()
    drive.command(Goal(0.04))
    assert link.goals() == [[0.04, 0.0, 0.0]]


def test_goals_keep_to_the_speed_on_average_and_may_be_early(drive, link):
    drive.command(Goal(0.0))
    late = 0.004
    link.now += 0.005 - 0.001 + late
    drive.command(Goal(0.05))
    link.now += 0.005 - 0.001 - late  # 1 ms after: the host has caught up
    drive.command(Goal(0.1))
    # a fifth faster than is allowed, each within the step
    refuses("goal jumps from a goal .* before", stream, drive, [Goal(0.1 + 0.06 * k) for k in range(1, 20)])
    assert link.goals()[-1][0] <= 0.1 + 1.02 * 10.0 * (link.now + 0.001 - 0.0) + 0.05


def test_a_pause_does_not_save_up_for_a_leap(drive, link):
    drive.command(Goal(0.0))
    link.now += 5.0
    refuses("goal jumps", drive.command, Goal(1.0))
    assert len(link.goals()) == 1


def test_a_goal_without_torque_is_refused(link):
    with Drive(link, LIMITS) as drive:
        fails(DriveError, "torque is off", drive.command, Goal(0.0))
        drive.enable()
        drive.off()
        fails(DriveError, "torque is off", drive.command, Goal(0.0))
    assert link.goals() == []


def test_angles_and_signs_are_those_of_the_arm(link):
    link.state["angle"] = 7.0
    with ready(link, zero=8.0, direction=-1) as drive:
        drive.command(Goal(0.99, -0.1, 0.2))
        (sent,) = link.goals()
        assert sent == pytest.approx([7.01, 0.1, -0.2])
        state = drive.read()
        assert (state.angle, state.rate, state.torque) == pytest.approx((0.99, -0.1, 0.2))


# ---------------------------------------------------------------------- homing


def test_the_zero_is_set_at_the_declared_angle_of_the_arm(link):
    link.state["angle"] = 40.0
    with Drive(link, LIMITS, direction=-1) as drive:
        assert drive.set_zero(0.5) == pytest.approx(40.5)
        assert drive.read().angle == pytest.approx(0.5)
        for switch_on in (drive.enable, lambda: link.state.update(enabled=True)):  # or it came on by itself
            switch_on()
            fails(DriveError, "torque off", drive.set_zero, 0.0)
            drive.off()


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({"angle": 0.3 + math.tau}, "1 turn away.*zero again"),
        ({"angle": 0.3 - 2.0 * math.tau}, "2 turns away.*zero again"),
        ({"angle": math.nan}, "nan"),
        ({"fault": "encoder (35)"}, "encoder"),
    ],
)
def test_a_shaft_whose_counter_wrapped_or_that_has_no_angle_or_a_fault_is_not_enabled(link, state, words):
    with Drive(link, LIMITS) as drive:
        link.state |= state
        fails(DriveError, words, drive.enable)
    assert ("enable",) not in link.log


def test_the_zero_of_an_arm_that_swings_is_its_mean_or_refused(link):
    with Drive(link, LIMITS) as drive:
        for size in (0.009, 0.02):
            link.during = lambda _, size=size: link.state.update(angle=size * math.cos(math.tau * link.now / 0.25))
            if size < 0.01:
                assert drive.set_zero(0.0) == pytest.approx(0.0, abs=1e-4)
            else:
                refuses("still swings", drive.set_zero, 0.0)


# ---------------------------------------------------------------------- faults


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({"fault": "under voltage (40)"}, "under voltage"),
        ({"angle": 3.1}, "outside"),
        ({"angle": math.nan}, "nan"),
        ({"angle": 0.4}, "jumped"),
        ({"enabled": False}, "switched its torque off"),
    ],
)
def test_what_a_reply_shows_is_latched_until_it_is_acknowledged(drive, link, state, words):
    drive.command(Goal(0.0))
    link.stuck = True
    link.state |= state
    fails(DriveError, words, drive.command, Goal(0.001))
    assert not link.state["enabled"]
    assert not drive.enabled
    assert words.split()[0] in drive.fault
    link.state |= {"fault": "", "temperature": 30.0, "torque": 0.0, "angle": 0.0}
    for refused in (drive.enable, lambda: drive.command(Goal(0.0))):
        fails(DriveError, words.split()[0], refused)
    drive.acknowledge()
    drive.enable()
    drive.command(Goal(0.0))


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({"temperature": 71.0}, "temperature 71 C"),
        ({"torque": -1.3}, "torque -1.3 N m"),
        ({"angle": 0.51}, "does not follow"),
    ],
)
@pytest.mark.parametrize(("pause", "readings"), [(0.0, 3), (0.02, 2)])
def test_what_a_disturbance_may_show_once_is_latched_when_it_lasts(link, state, words, pause, readings):
    with ready(link) as drive:
        drive.command(Goal(0.0))
        link.stuck, usual = True, {"temperature": 30.0, "torque": 0.0, "angle": 0.0}
        drive._jumped = lambda state, before: False
        for shown in (*(readings - 1) * [state], usual, *(readings - 1) * [state]):
            link.state |= usual | shown
            link.now += pause
            drive.command(Goal(0.0))
        link.now += pause
        fails(DriveError, words, drive.command, Goal(0.0))
        assert not link.state["enabled"]


def test_a_fault_that_lasts_cannot_be_acknowledged(drive, link):
    link.clear = lambda: None
    link.state["fault"] = "over voltage (34)"
    for call in (drive.read, drive.acknowledge):
        fails(DriveError, "over voltage", call)
    assert drive.fault


def test_an_arm_that_hit_a_stop_is_switched_off(drive, link):
    link.stuck = True
    with pytest.raises(DriveError, match="does not follow"):
        stream(drive, [Goal(0.005 * k, 1.0 if k > 10 else 0.1 * k) for k in range(200)])
    assert not link.state["enabled"]
    assert link.goals()[-1][0] <= 0.5 + 3 * 0.005  # the third reading beyond the allowed deviation


# ---------------------------------------------------------------------- lost replies


def test_a_late_state_reports_its_time(drive, link):
    drive.command(Goal(0.0))
    link.fails = silent(2)
    link.state["angle"] = 0.01
    for lost in (1, 2):
        state = drive.command(Goal(0.002))
        assert (state.stale, state.lost, state.angle) == (True, lost, 0.0)
        assert state.received < link.now - 0.5 * REQUEST
    state = drive.command(Goal(0.003))
    assert (state.stale, state.lost) == (False, 0)


def test_a_lost_link_switches_off(drive, link):
    drive.command(Goal(0.0))
    link.fails = silent(60)
    fails(DriveError, "no valid reply for", stream, drive, 60 * [Goal(0.0)])
    assert not link.state["enabled"]


def test_with_a_long_watchdog_the_link_may_be_silent_for_longer(link):
    link.watchdog = 0.4
    with Drive(link, LIMITS) as drive:
        drive.enable()
        drive.command(Goal(0.0))
        link.fails = silent(150)
        stream(drive, 30 * [Goal(0.0)])  # 5 ms each
        assert link.state["enabled"]
        fails(DriveError, "no valid reply for 20", stream, drive, 30 * [Goal(0.0)])


def test_one_lost_reply_after_a_pause_is_no_lost_link(link):
    with Drive(link, LIMITS) as drive:
        link.now += 10.0
        link.fails = silent(1)
        assert drive.read().stale
        assert not drive.read().stale


def test_lost_replies_now_and_then_are_no_lost_link(drive, link):
    link.fails = 50 * [*silent(9), None]
    drive.command(Goal(0.0))
    states = [drive.read() for _ in range(450)]
    assert max(state.lost for state in states) == 9


def test_what_a_link_refuses_is_named_once(link):
    with Drive(link, LIMITS) as drive:
        link.fails = [None, DriveError("fake 1: its watchdog is not armed.")]
        with pytest.raises(DriveError, match=r"^fake 1: its watchdog is not armed\. Torque is off") as error:
            drive.enable()
        assert str(error.value).count("fake 1") == 1
        assert not link.state["enabled"]


@pytest.mark.parametrize("error", [OSError("unplugged"), RuntimeError("a bug"), IndexError()])
def test_a_link_that_breaks_is_a_fault(drive, link, error):
    link.fails = [error]
    fails(DriveError, "link broke", drive.command, Goal(0.0))
    assert not link.state["enabled"]


def test_torque_off_is_repeated_until_it_is_confirmed(drive, link):
    link.fails = [*silent(5), OSError("hiccup"), IndexError("bug"), *silent(3)]
    drive.off()
    assert not link.state["enabled"]
    assert not drive.enabled


def test_torque_that_does_not_go_off_is_reported(drive, link):
    link.obstinate = True
    fails(DriveError, r"did not confirm.*0.1 s.*Cut its power", drive.off)
    assert drive.enabled
    link.obstinate = False


def test_an_error_of_the_drive_is_not_hidden_by_that_of_its_end(link):

    def lose():
        with ready(link) as drive:
            link.fails = silent(10_000)
            stream(drive, 100 * [Goal(0.0)])

    fails(DriveError, r"no valid reply.*did not confirm", lose)
    assert not link.opened


# ---------------------------------------------------------------------- exits


@pytest.mark.parametrize("request_", ["enable", "send", "disable", "read"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_in_the_middle_of_a_request_waits_for_its_end(link, request_, number):
    """Each request is struck by a signal once; it still arrives, and the torque is off at the end."""
    struck = []

    def during(name):
        if name == request_ and link.state["enabled"] | (name == "enable") and not struck:
            struck.append(len(link.log))
            signal.raise_signal(number)

    link.during = during
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt if number == signal.SIGINT else SystemExit):
        run(link)
    assert link.log[struck[0]][0] == request_  # it was not torn
    assert not link.state["enabled"]
    assert not link.opened
    assert signal.getsignal(number) is before


def test_a_second_signal_does_not_stop_the_switching_off(link):

    def run_and_interrupt():
        with ready(link) as drive:
            drive.command(Goal(0.0))
            link.during = lambda name: signal.raise_signal(signal.SIGINT)
            link.fails = silent(5)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_and_interrupt()
    assert not link.state["enabled"]
    assert not link.opened


def test_an_error_in_the_middle_of_enable_switches_off(link):
    read, reads = link.read, []

    def torn():
        reads.append(1)
        if link.state["enabled"] and len(reads) < 5:
            raise BaseExceptionGroup("torn", [KeyboardInterrupt()])
        return read()

    link.read = torn
    with Drive(link, LIMITS) as drive:
        with pytest.raises(BaseExceptionGroup):
            drive.enable()
        assert not link.state["enabled"]


def test_a_drive_without_a_context_is_switched_off_at_exit(link, monkeypatch):
    """To call all that is registered would close libraries that later tests need: HDF5's among them."""
    registered = []
    monkeypatch.setattr(atexit, "register", registered.append)
    drive = ready(link)
    (leave,) = registered
    leave()
    assert not link.state["enabled"]
    assert not link.opened
    drive.close()


def test_another_thread_stops_it_and_signals_stay_with_the_main_thread(drive, link):
    drive.command(Goal(0.0))
    thread = threading.Thread(target=drive.off)
    thread.start()
    thread.join()
    assert not link.state["enabled"]
    fails(DriveError, "torque is off", drive.command, Goal(0.0))


def test_a_drive_may_be_closed_by_another_thread_and_connected_again(link):
    before = signal.getsignal(signal.SIGTERM)
    drive = ready(link)
    for _ in range(2):
        thread = threading.Thread(target=drive.close)
        thread.start()
        thread.join()
        assert not link.state["enabled"]
        drive.connect()
        with pytest.raises(SystemExit):
            signal.raise_signal(signal.SIGTERM)
    drive.close()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        assert signal.getsignal(number) in (before, signal.default_int_handler)


def test_drives_may_be_closed_in_any_order():
    before = signal.getsignal(signal.SIGTERM)
    links = FakeLink(), FakeLink()
    first, second = (ready(each) for each in links)
    first.close()
    with pytest.raises(SystemExit):
        signal.raise_signal(signal.SIGTERM)
    second.close()
    first.connect()
    first.close()
    assert not any(each.state["enabled"] for each in links)
    signal.signal(signal.SIGTERM, before)


# ---------------------------------------------------------------------- whole motions

# 2 rad in 0.6 s, bang-bang: it reaches 2 2/0.6 = 6.67 rad/s and 4 2/0.36 = 22.2 rad/s^2
SWING = move_arm(-1.0, 1.0, duration=0.6)


def limited(**limits):
    return Drive(FakeLink(), MotorLimits(**{"speed": 100.0, "acceleration": 1000.0} | limits))


def test_a_motion_within_all_limits_is_accepted():
    assert limited(speed=6.67, acceleration=22.3, angles=(-1.0, 1.0)).check_motion(SWING) is None
    assert limited().check_motion(hold_arm(1.0)) is None


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"angles": (-1.0, 0.99)}, r"angle at t = 0.600 s .* got 1.0"),
        ({"angles": (-0.99, 1.0)}, r"angle at t = 0.000 s .* got -1.0"),
        ({"speed": 6.5}, r"rate at t = 0.300 s .* got 6.6667"),
        ({"acceleration": 21.0}, r"acceleration at t = .* got -?22.2222"),
    ],
)
def test_a_motion_beyond_a_limit_is_refused_with_time_and_value(limits, words):
    refuses(words, limited(**limits).check_motion, SWING)


def test_extrema_between_samples_are_found():
    """A spline through sparse samples overshoots them: its extreme angle is none of the samples."""
    motion = sampled_motion([0.0, 0.1, 0.2, 0.3, 0.4], [0.0, 0.0, 1.0, 1.0, 1.0])
    dense = motion.angle(np.linspace(0.0, 0.4, 100_001))
    most = float(dense.max())
    assert most > 1.01
    limited(angles=(-3.0, most + 1e-6)).check_motion(motion)
    refuses("angle at t = 0.2", limited(angles=(-3.0, most - 1e-6)).check_motion, motion)


def test_a_motion_that_jumps_is_refused():
    limited().check_motion(SWING.then(SWING, at=0.3))
    refuses("rate jumps at t = 0.300", limited().check_motion, SWING.then(hold_arm(0.0), at=0.3))
    refuses("angle jumps", limited().check_motion, dataclasses.replace(SWING, coef=SWING.coef + JUMP))


JUMP = np.zeros_like(SWING.coef)
JUMP[1, 0, 0] = 0.1


def test_a_motion_that_repeats_must_meet_its_beginning():
    back = move_arm(1.0, -1.0, duration=0.6).shifted(0.6)
    there = SWING.then(back, at=0.6)
    limited().check_motion(dataclasses.replace(there, loop=0))
    refuses("angle jumps at t = 0.600", limited().check_motion, dataclasses.replace(SWING, loop=0))


@pytest.mark.parametrize("seed", range(4))
def test_a_motion_that_was_accepted_is_not_refused_on_the_way(seed):
    """Moves that use the limits to the last; each goal is that of the time at which it is sent, up to 3 ms off."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-3.0, 3.0, 6) if seed else np.array([-6.0, 6.0])
    count = angles.size - 1
    durations, ramps = rng.uniform(0.5, 1.0, count), rng.uniform(0.1, 0.5, count) if seed else np.array([0.5])
    motion = arm_moves(angles, rests=rng.uniform(0.0, 0.2, count), durations=durations, ramps=ramps)
    speed, acceleration = (np.abs(motion.extrema(derivative)[1]).max() / 1.02 for derivative in (1, 2))
    limits = MotorLimits(speed=speed, acceleration=acceleration, angles=(angles.min(), angles.max()))
    link = FakeLink(angle=angles[0])
    with Drive(link, limits) as drive:
        drive.check_motion(motion)
        drive.enable()
        begin = link.now
        for due in begin + np.arange(0.005, motion.breaks[-1] + 0.1, 0.005):
            link.now = max(link.now, due + rng.uniform(-0.003, 0.003))
            t = link.now - begin
            state = drive.command(Goal(float(motion.angle(t)), float(motion.rate(t))))
    assert state.angle == pytest.approx(angles[-1])


def test_what_no_drive_of_a_shaft_can_carry_out_is_refused():
    t = [0.0, 0.5, 1.0]
    for motion in (moving_pivot(t, [0.0, 0.1, 0.0], [0.0, 0.0, 0.0]), torque_profile(t, [0.0, 0.1, 0.0])):
        refuses("cannot carry out", limited().check_motion, motion)
    refuses("no Motion", limited().check_motion, [0.0, 1.0])
