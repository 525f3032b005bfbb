"""A finer drive than the one that is identified: current loop, encoder steps, jitter, torque and speed limits."""

import functools
import math
from dataclasses import dataclass

import numpy as np

from hyperflex.hardware import Drive, DriveRecord, Goal, Reading, plan_test_motion
from hyperflex.model import MotorLimits

STEP = 1e-5  # s
COGS, SLOW = 42, 0.3  # a turn, as of a motor with 14 poles and 12 slots whose cogs are partly balanced; rad/s


@dataclass(frozen=True)
class Truth:
    """A drive. Units as their names; `hold` is 1 / rate of the goals, s."""

    inertia: float = 1e-3
    friction: float = 2e-3
    dry_friction: float = 0.01
    weight: float = 0.02
    kp: float = 8.0
    kd: float = 0.15
    uses_rate: bool = False
    latency: float = 4e-3
    current_loop: float = 3e-4
    stall: float = 1.0
    free_speed: float = 9.0
    max_torque: float = 0.8
    backlash: float = 0.0
    counts: int = 4096
    jitter: float = 1e-3
    tells_torque: bool = True
    torque_noise: float = 0.01
    cogging: float = 0.0  # N m, COGS times a turn
    sticking: float = 0.0  # part by which dry friction is greater near rest, at less than SLOW
    seed: int = 0

    @property
    def lag(self) -> float:
        """Total lag at constant speed without dry friction, s, of goals held for 5 ms."""
        sent = 2e-4 + 0.5 * self.jitter
        return self.latency + sent + 2.5e-3 + (self.friction + (0.0 if self.uses_rate else self.kd)) / self.kp

    @property
    def rate_limit(self) -> float:
        """Speed at which the falling torque equals friction, rad/s."""
        return (self.stall - self.dry_friction) / (self.stall / self.free_speed + self.friction)


def _run(state, steps, aim, rate, c):
    """Advance (angle, speed, torque, load angle) by steps of the twin under a held goal."""
    y, v, tau, o = state
    inertia, friction, dry, weight, kp, kd, loop, stall, fastest, most, gap, cogging, sticking = c
    for _ in range(steps):
        wanted = kp * (aim - y) + kd * (rate - v)
        top, bottom = min(most, stall * (1.0 - v / fastest)), max(-most, stall * (-1.0 - v / fastest))
        tau += STEP / loop * (min(top, max(bottom, wanted)) - tau)
        push = tau - friction * v - weight * math.sin(y) - cogging * math.sin(COGS * y)
        free = v + STEP * push / inertia
        rough = dry * (1.0 + sticking * math.exp(-((v / SLOW) ** 2)))
        v = math.copysign(max(0.0, abs(free) - STEP * rough / inertia), free)
        y += STEP * v
        o = min(y + 0.5 * gap, max(y - 0.5 * gap, o))
    return y, v, tau, o


@functools.cache
def _compiled():
    import numba

    return numba.njit(_run)


class Twin:
    """The link of a drive with its own clock."""

    name, watchdog, takes = "twin", 0.1, frozenset({"rate"})

    def __init__(self, truth: Truth) -> None:
        self.truth, self.now, self._at = truth, 0.0, 0.0
        self._rng = np.random.default_rng(truth.seed)
        self._state = (0.0, 0.0, 0.0, 0.0)
        self._queue: list[tuple[float, float, float]] = []
        self._goal = (0.0, 0.0)
        self.enabled = False

    def clock(self) -> float:
        return self.now

    def _advance(self, until: float) -> None:
        t = self.truth
        loop = (t.kp, t.kd) if self.enabled else (0.0, 0.0)
        limits = t.stall, t.free_speed, t.max_torque
        beyond = t.backlash, t.cogging, t.sticking
        c = (t.inertia, t.friction, t.dry_friction, t.weight, *loop, t.current_loop, *limits, *beyond)
        while self._at < until:
            while self._queue and self._queue[0][0] <= self._at:
                self._goal = self._queue.pop(0)[1:]
            end = min([until, *(each[0] for each in self._queue[:1])])
            steps = max(1, round((end - self._at) / STEP))
            self._state = _compiled()(self._state, steps, *self._goal, c)
            self._at += steps * STEP

    def _reply(self, there: float) -> Reading:
        sent = self.now
        self._advance(sent + there)
        _, v, tau, o = self._state
        quantum = math.tau / self.truth.counts if self.truth.counts else 0.0
        angle = quantum * math.floor(o / quantum) if quantum else o
        self.now = sent + there + self._rng.uniform(0.0, self.truth.jitter) + 2e-4
        noisy = tau + self.truth.torque_noise * self._rng.standard_normal()
        return Reading(
            angle, v, noisy if self.truth.tells_torque else math.nan, 24.0, 30.0, self.enabled, "", sent, self.now
        )

    def open(self) -> None: ...

    def read(self) -> Reading:
        return self._reply(2e-4 + self._rng.uniform(0.0, self.truth.jitter))

    def enable(self, limits: MotorLimits) -> None:
        self.enabled, self._goal = True, (self._state[3], 0.0)

    def send(self, goal: Goal) -> Reading:
        there = 2e-4 + self._rng.uniform(0.0, self.truth.jitter)
        rate = goal.rate if self.truth.uses_rate else 0.0
        self._queue.append((self.now + there + self.truth.latency, goal.angle, rate))
        return self._reply(there)

    def disable(self) -> None:
        self.enabled = False

    def clear(self) -> None: ...

    def close(self) -> None: ...


LIMITS = MotorLimits(speed=12.0, acceleration=150.0, torque=5.0, angles=(-2.5, 2.5))


def record_of(truth: Truth, limits: MotorLimits = LIMITS, period: float = 5e-3) -> DriveRecord:
    """Return the record of the test motion on a twin."""
    twin, motion, rows = Twin(truth), plan_test_motion(limits, 0.0), []
    with Drive(twin, limits, max_deviation=5.0) as drive:  # it falls behind at its limit of speed
        drive.enable()
        start = twin.now
        while (t := twin.now - start) < motion.breaks[-1] + 0.3:
            goal = Goal(float(motion.angle(t)), float(motion.rate(t)))
            state = drive.command(goal)
            rows.append((state.sent - start, state.received - start, goal.angle, goal.rate, state.angle, state.torque))
            twin.now = max(twin.now, start + period * math.ceil((twin.now - start) / period + 1e-6))
    return DriveRecord(*np.array(rows).T)


def drawn(seed: int) -> Truth:
    """Return a drive with usual values, drawn at random."""
    rng = np.random.default_rng([55, seed])
    inertia = 10.0 ** rng.uniform(-3.3, -2.5)
    w, z = rng.uniform(40.0, 150.0), rng.uniform(0.7, 1.5)
    uses_rate = bool(rng.integers(2))
    stall = inertia * rng.uniform(300.0, 900.0)
    return Truth(
        inertia=inertia,
        friction=inertia * rng.uniform(0.5, 4.0),
        dry_friction=inertia * rng.uniform(1.0, 15.0),
        weight=inertia * rng.uniform(0.0, 30.0),
        kp=inertia * w * w,
        kd=inertia * 2.0 * z * w,
        uses_rate=uses_rate,
        latency=rng.uniform(1e-3, 15e-3),
        stall=stall,
        free_speed=rng.uniform(5.0, 10.0),
        max_torque=0.8 * stall,
        backlash=float(rng.choice([0.0, rng.uniform(5e-3, 15e-3)])),
        tells_torque=bool(rng.integers(2)),
        torque_noise=0.02 * stall,
        seed=seed,
    )
