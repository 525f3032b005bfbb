"""A model of a drive as its user sees it: goals go in, the angle that the drive reports comes out."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import MotorLimits
from hyperflex.motion import Motion, arm_moves


@dataclass(frozen=True)
class DriveModel:
    """Delay, second-order loop with limits, friction and backlash; torques are over the inertia that the motor turns.

    Parameters
    ----------
    delay : float
        From a goal to its effect, s.
    frequency : float
        Natural frequency w of the position loop, rad/s.
    damping : float
        Damping ratio z of the loop, viscous friction included.
    feedforward : float
        Part f of the damping that acts on the rate of the goal instead of rest: 0 if the rate is not used.
    dry : float
        Coulomb friction, rad/s^2.
    weight : float
        Torque of the weight at a quarter turn from hanging, rad/s^2.
    backlash : float
        Play between the motor, where the loop measures, and the encoder that is read, rad; other play is not seen.
    rate_limit : float
        Greatest speed that the drive keeps up without a weight, rad/s.
    slope : float
        Acceleration per speed that is missing to the rate limit, 1/s: of a torque that falls linearly with the speed.
    acceleration_limit : float
        Greatest acceleration by the motor, rad/s^2.
    hold : float
        Time from one goal to the next, s, if each is held until then; 0 if the drive advances it with its rate.
    current_lag : float
        Time constant with which the torque, as its current, follows its command, s.

    Notes
    -----
    With goal u after the delay and angle y of the motor, the command is a = w^2 (u - y) + 2 z w (f u' - y'), limited to
    ``acceleration_limit`` and to slope (rate_limit - y') + dry, and the same the other way. The effort e follows it by
    e' = (a - e) / current_lag, and y'' = e - dry sign(y') - weight sin(y). The lag at constant speed is
    delay + hold / 2 + 2 z (1 - f) / w. Integrated by the implicit midpoint rule with the mean of the goal in each step.
    """

    delay: float
    frequency: float
    damping: float
    feedforward: float = 0.0
    dry: float = 0.0
    weight: float = 0.0
    backlash: float = 0.0
    rate_limit: float = math.inf
    slope: float = 50.0
    acceleration_limit: float = math.inf
    hold: float = 0.0
    current_lag: float = 0.0

    @property
    def lag(self) -> float:
        """Time, s, by which the shaft is behind its goals at constant speed, without dry friction: all in all."""
        return self.delay + 0.5 * self.hold + 2.0 * self.damping * (1.0 - self.feedforward) / self.frequency

    def respond(self, t: Array, angles: Array, rates: Array, step: float = 3.7e-4) -> tuple[Array, Array, Array, Array]:
        """Return times, angle, rate of the motor and its effort, rad/s^2 (K,), from goals given at times t (N,).

        The effort is the mean of the step that ends then. Goals are `angles` and `rates` (N,). It starts at rest at the
        first one. The `step`, s, is no part of usual periods, so that the result depends smoothly on the delay.
        """
        grid = t[0] + step * np.arange(math.floor((t[-1] - t[0]) / step) + 1)
        edges = np.maximum(grid - self.delay, t[0])
        goal, rate = _means(edges, t, angles, rates, 0.0 if self.hold > 0.0 else 1.0)
        w, d = self.frequency, 2.0 * self.damping * self.frequency
        limits = self.rate_limit, self.slope, self.acceleration_limit
        kept = math.exp(-step / self.current_lag) if self.current_lag > 0.0 else 0.0
        torque = self.current_lag / step * (1.0 - kept), kept
        loop = w * w, d, self.feedforward * d, self.dry, self.weight, 0.5 * self.backlash
        return grid, *_compiled()(step, float(angles[0]), goal, rate, *loop, *limits, *torque)


def _means(edges: Array, t: Array, angles: Array, rates: Array, advance: float) -> tuple[Array, Array]:
    """Return mean goal and rate (K,) between edges (K + 1,) of goals at t (N,) that are held, or `advance` (1.0)."""
    spans, k = np.diff(t), np.searchsorted(t, edges, side="right") - 1
    since, widths = edges - t[k], np.diff(edges)
    empty = widths <= 0.0  # before the first goal is there
    found = []
    for values, slopes in ((angles, advance * rates), (rates, 0.0 * rates)):
        before = np.append(0.0, np.cumsum(values[:-1] * spans + 0.5 * slopes[:-1] * spans**2))
        area = before[k] + (values[k] + 0.5 * slopes[k] * since) * since
        found.append(np.where(empty, values[0], np.diff(area) / np.where(empty, 1.0, widths)))
    return found[0], found[1]


def _respond(
    h: float,
    start: float,
    goals: Array,
    rates: Array,
    w2: float,
    d: float,
    p: float,
    dry: float,
    weight: float,
    gap: float,
    fastest: float,
    slope: float,
    most: float,
    part: float,
    kept: float,
) -> tuple[Array, Array, Array]:
    """Return encoder angle, rate and effort of the motor (K + 1,) under mean goals and rates (K,) in each step.

    Of the difference between effort and command the mean in a step is a `part`, and so much is `kept` at its end.
    """
    y, v, seen, before = start, 0.0, start, 0.0
    angle, speed, effort = np.empty(goals.size + 1), np.empty(goals.size + 1), np.zeros(goals.size + 1)
    angle[0], speed[0] = y, v
    for k in range(goals.size):
        pull = weight * math.sin(y)
        aim = w2 * (goals[k] - y) + p * rates[k]
        drag = pull + (dry * np.sign(v) if v != 0.0 else 0.0)
        mean = (v + 0.5 * h * (aim - drag)) / (1.0 + 0.5 * h * (0.5 * h * w2 + d))
        wanted = aim - (0.5 * h * w2 + d) * mean
        wanted = max(-most, min(most, wanted))
        if fastest < math.inf:
            up = (v + 0.5 * h * (slope * fastest - pull)) / (1.0 + 0.5 * h * slope)
            down = (v - 0.5 * h * (slope * fastest + pull)) / (1.0 + 0.5 * h * slope)
            wanted = max(-slope * (fastest + down) - dry, min(slope * (fastest - up) + dry, wanted))
        behind = before - wanted
        push = wanted + part * behind
        before = wanted + kept * behind
        free = v + h * (push - pull)
        after = np.sign(free) * max(0.0, abs(free) - h * dry)
        y += 0.5 * h * (v + after)
        v = after
        seen = min(y + gap, max(y - gap, seen))
        angle[k + 1], speed[k + 1], effort[k + 1] = seen, v, push
    return angle, speed, effort


@functools.cache
def _compiled() -> Callable[..., Any]:
    import numba

    return numba.njit(_respond)  # type: ignore[no-any-return]


def plan_test_motion(limits: MotorLimits, angle: float, *, size: float = 0.3, stroke: float | None = None) -> Motion:
    """Return a motion that shows what a drive does: slow ramps, faster and faster moves, and one fast stroke.

    It begins and ends at the arm's present angle, and keeps to 95 % of the limits.

    Parameters
    ----------
    limits : MotorLimits
    angle : float
        Present angle of the arm, rad.
    size : float
        Size of the small moves, rad.
    stroke : float, optional
        Size of the fast stroke, rad; by default what it takes to hold the greatest speed for 0.15 s, as far as the
        angles allow.

    Raises
    ------
    InvalidInput
        If the arm is outside its angles, or has not room for the small moves.

    Examples
    --------
    >>> motion = plan_test_motion(MotorLimits(speed=6.0, acceleration=60.0), 0.0)
    >>> bool(motion.breaks[-1] < 20.0)
    True
    """
    least, greatest = limits.angles
    if not least <= angle <= greatest:
        raise InvalidInput("arm is outside its angles", got=angle, allowed=f"{least:.4g} to {greatest:.4g} rad")
    side = 1.0 if greatest - angle >= angle - least else -1.0
    room = max(greatest - angle, angle - least) - 0.02
    if room < size:
        raise InvalidInput("arm has no room for the test motion", got=room, allowed=f"{size:g} rad on one side")
    used = MotorLimits(speed=0.95 * limits.speed, acceleration=0.95 * limits.acceleration)
    full = used.speed**2 / used.acceleration + 0.15 * used.speed
    far = min(room, full if stroke is None else stroke)
    quickest = max(2.0 * size / used.speed, 2.0 * math.sqrt(size / used.acceleration))  # s, bang-bang
    moves = []  # way, duration, ramp, rest before
    for slow in (0.2, 0.6, 2.0):  # speed, rad/s
        duration = max(size / slow, 3.0 * quickest)
        moves += [(size, duration, 0.05, 0.3), (-size, duration, 0.05, 0.0)]
    for slower in (8.0, 5.0, 3.0, 2.0, 1.4, 1.0):
        duration = slower * quickest
        moves += [(size, duration, 0.5, 0.1 if slower == 8.0 else 0.0), (-size, duration, 0.5, 0.0)]
    for part in (1.0, 0.5):
        quick, ramp = used.fastest_moves([part * far])
        moves += [(way, float(quick[0]), float(ramp[0]), 0.3) for way in (part * far, -part * far)]
    ways, durations, shapes, rests = map(np.array, zip(*moves, strict=True))
    rests[0] = 0.3
    return arm_moves(angle + side * np.append(0.0, np.cumsum(ways)), rests, durations, shapes)
