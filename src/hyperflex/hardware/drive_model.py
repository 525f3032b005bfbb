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
    viscous : float
        Viscous friction, 1/s: a part of the damping for which the motor's torque pays.
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
    With goal u after the delay and angle y of the motor, the command is a = w^2 (u - y) + 2 z w (f u' - y') + c y' with
    the viscous friction c, limited to ``acceleration_limit`` and to slope (rate_limit - y') + dry + c rate_limit, and
    the same the other way. The effort e follows it by e' = (a - e) / current_lag, and
    y'' = e - c y' - dry sign(y') - weight sin(y). The lag at constant speed is delay + hold / 2 + 2 z (1 - f) / w.
    Integrated by the implicit midpoint rule.
    """

    delay: float
    frequency: float
    damping: float
    feedforward: float = 0.0
    dry: float = 0.0
    viscous: float = 0.0
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

    def respond(self, t: Array, angles: Array, rates: Array, step: float = 2.5e-4) -> tuple[Array, Array, Array, Array]:
        """Return times, angle, rate of the motor and its effort, rad/s^2 (K,), from goals given at times t (N,).

        The effort is the mean of the step that ends then. Goals are `angles` and `rates` (N,). It starts at rest at the
        first one. Steps are of about `step`, s; each goal arrives at the beginning of one.
        """
        counts = np.maximum(np.rint(np.diff(t) / step), 1.0)
        steps = np.repeat(np.diff(t) / counts, counts.astype(np.intp))
        grid = t[0] + self.delay + np.append(0.0, np.cumsum(steps))
        loop = self.frequency, self.damping, self.feedforward, self.dry, self.viscous, self.weight, 0.5 * self.backlash
        limits = self.rate_limit, self.slope, self.acceleration_limit
        goals = t, counts, angles, rates, 0.0 if self.hold > 0.0 else 1.0
        return grid, *_compiled()(grid.size, *goals, *loop, *limits, self.current_lag)


def _respond(
    size: int,
    times: Array,
    counts: Array,
    angles: Array,
    rates: Array,
    advance: float,
    w: float,
    z: float,
    f: float,
    dry: float,
    viscous: float,
    weight: float,
    gap: float,
    fastest: float,
    slope: float,
    most: float,
    current_lag: float,
) -> tuple[Array, Array, Array]:
    """Return encoder angle, rate and effort of the motor (size,) under goals (N,) of so many steps each (N - 1,).

    Goals are held, or advanced with their rates (1.0).
    """
    y, v, seen, before = angles[0], 0.0, angles[0], 0.0
    angle, speed, effort = np.empty(size), np.empty(size), np.zeros(size)
    angle[0], speed[0] = y, v
    w2, d = w * w, 2.0 * z * w
    steep, still = slope + viscous, dry + viscous * fastest
    k = 0
    for i in range(counts.size):
        h = (times[i + 1] - times[i]) / counts[i]
        kept = math.exp(-h / current_lag) if current_lag > 0.0 else 0.0  # of effort less command, at the end of a step
        part = current_lag / h * (1.0 - kept)  # of it, in the mean of a step
        for j in range(int(counts[i])):
            pull = weight * math.sin(y)
            aim = w2 * (angles[i] + advance * rates[i] * (j + 0.5) * h - y) + f * d * rates[i]
            drag = pull + (dry * np.sign(v) if v != 0.0 else 0.0)
            mean = (v + 0.5 * h * (aim - drag)) / (1.0 + 0.5 * h * (0.5 * h * w2 + d))
            wanted = aim - (0.5 * h * w2 + d - viscous) * mean
            wanted = max(-most, min(most, wanted))
            if fastest < math.inf:
                up = (v + 0.5 * h * (steep * fastest - pull)) / (1.0 + 0.5 * h * steep)
                down = (v - 0.5 * h * (steep * fastest + pull)) / (1.0 + 0.5 * h * steep)
                wanted = max(-slope * (fastest + down) - still, min(slope * (fastest - up) + still, wanted))
            behind = before - wanted
            push = wanted + part * behind
            before = wanted + kept * behind
            free = v * (1.0 - 0.5 * h * viscous) + h * (push - pull)
            after = np.sign(free) * max(0.0, abs(free) - h * dry) / (1.0 + 0.5 * h * viscous)
            y += 0.5 * h * (v + after)
            v = after
            seen = min(y + gap, max(y - gap, seen))
            k += 1
            angle[k], speed[k], effort[k] = seen, v, push
    return angle, speed, effort


@functools.cache
def _compiled() -> Callable[..., Any]:
    import numba

    return numba.njit(_respond)  # type: ignore[no-any-return]


def plan_test_motion(limits: MotorLimits, angle: float, *, size: float = 0.3, stroke: float | None = None) -> Motion:
    """Return a motion that shows what a drive does: slow ramps, faster and shorter moves, fast strokes.

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
    for slower in np.geomspace(8.0, 0.25, 11):  # shorter ones are smaller, and as steep: they tell delay from bandwidth
        way, duration, twice = size * min(1.0, slower**2), slower * quickest, 2 if slower < 1.0 else 1
        moves += [(way, duration, 0.5, 0.0), (-way, duration, 0.5, 0.0)] * twice
    for part in (1.0, 0.5):
        quick, ramp = used.fastest_moves([part * far])
        moves += [(way, float(quick[0]), float(ramp[0]), 0.3) for way in (part * far, -part * far)]
    ways, durations, shapes, rests = map(np.array, zip(*moves, strict=True))
    rests[0] = 0.3
    return arm_moves(angle + side * np.append(0.0, np.cumsum(ways)), rests, durations, shapes)
