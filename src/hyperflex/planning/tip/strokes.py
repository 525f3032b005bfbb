"""Strokes of the arm from angle to angle, and the derivatives of their motion."""

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.motion import BANG_BANG, motion_derivatives
from hyperflex.planning.options import MotorLimits
from hyperflex.planning.throw import Moves

MIN_STROKE = 0.05  # rad
MIN_REST = 1e-3  # s; there is always one, so that it can vary
SHORT_STROKE = 0.07  # rad, of strokes that are added: they hardly change a swing; longer than MIN_STROKE, so they vary


@dataclass(frozen=True, eq=False)
class Strokes(Moves):
    """Strokes at the motor's full speed, each after a rest, from an arm that points to one side.

    Attributes
    ----------
    side : {-1, 1}
        Whether the arm starts on the left or on the right.
    ends : (k,) float64
        Arm angle after each stroke, rad; clipped to the motor's range.
    rests : (k,) float64
        Rest before each stroke, s; at least MIN_REST.
    """

    side: int
    ends: Array
    rests: Array

    @property
    def parameters(self) -> Array:
        """Parameters (2 k,): the ends, rad, then the rests, s."""
        return np.concatenate([self.ends, self.rests])

    def angles(self, limits: MotorLimits) -> Array:
        """Arm angles at the start and after each stroke (k + 1,), rad."""
        least, greatest = limits.angles
        angles = [limits.start_angle(self.side)]
        for end in np.clip(self.ends, least, greatest):
            way = end - angles[-1]
            if abs(way) < MIN_STROKE:
                up = way >= 0.0 if least < angles[-1] + np.copysign(MIN_STROKE, way) < greatest else way < 0.0
                end = angles[-1] + (MIN_STROKE if up else -MIN_STROKE)
            angles.append(float(end))
        return np.array(angles)

    def timing(self, limits: MotorLimits) -> tuple[Array, Array, Array]:
        """Rest, s, duration, s, and ramp of each stroke, (k,) each."""
        return np.maximum(self.rests, MIN_REST), *limits.fastest_moves(np.diff(self.angles(limits)))

    def cut(self, t: float, limits: MotorLimits) -> "Strokes":
        """Return the strokes that start before time t, s, at least one."""
        count = max(1, int((self.starts(limits) < t).sum()))
        return Strokes(self.side, self.ends[:count], self.rests[:count])

    def with_more(self, count: int, t: float, limits: MotorLimits) -> "Strokes":
        """Return `count` strokes or fewer: short ones are added in the middle of the longest rests until time t, s.

        Each goes the other way than the stroke before it, the first the other way than that after it, unless that after
        it got too short. None is added in a rest that is not twice as long as it.
        """
        strokes, (duration,) = self, limits.fastest_moves([SHORT_STROKE])[0].tolist()
        while strokes.ends.size < count:
            angles, (rests, _, _) = strokes.angles(limits), strokes.timing(limits)
            rests = np.append(rests, t - strokes.stops(limits))
            k = int(rests.argmax())
            if rests[k] < 2.0 * duration:
                break
            before = max(k, 1)
            way = -SHORT_STROKE * np.sign(angles[before] - angles[before - 1])
            if np.abs(angles[k + 1 : k + 2] - angles[k] - way).min(initial=np.inf) < MIN_STROKE:
                way = -way
            rests = np.insert(rests, k, 0.5 * (rests[k] - duration))
            rests[k + 1] = rests[k]
            strokes = Strokes(self.side, np.insert(strokes.ends, k, angles[k] + way), rests[:-1])
        return strokes

    def varied(self, change: Array) -> "Strokes":
        """Return strokes whose `parameters` differ by `change` (2 k,)."""
        ends, rests = np.split(self.parameters + change, 2)
        return Strokes(self.side, ends, rests)

    def variations(self, limits: MotorLimits) -> list[dict[str, Array]]:
        """Return the derivatives of the motion's breaks and coefficients by each of `parameters`: a list of 2 k.

        Those by an end outside the motor's range, or by a rest of MIN_REST, are 0.
        """
        motion, angles = self.motion(limits), self.angles(limits)
        ways, (_, durations, ramps) = np.diff(angles), self.timing(limits)
        full = ramps <= BANG_BANG
        by_way = np.where(full, 1.0 / limits.speed, 0.5 * durations / np.abs(ways)) * np.sign(ways)
        shorter = np.where(full, -ramps / durations * by_way, 0.0)

        def by(name: str, k: int) -> Array:
            """Derivatives of breaks and coefficients in one array, by number k of a list of the motion."""
            return np.concatenate([part.ravel() for part in motion_derivatives(motion, f"{name}[{k}]")])

        # by each stroke's size alone: its duration, and the fraction of that which speeds up
        timing = [by_way[k] * by("durations", k) for k in range(ways.size)]
        timing = [part + shorter[k] * by("ramps", k) if full[k] else part for k, part in enumerate(timing)]
        free = np.append(np.abs(self.ends - angles[1:]) < 1e-12, self.rests > MIN_REST)
        found = [by("angles", k + 1) + timing[k] for k in range(ways.size)]
        found = [part - after for part, after in zip(found, [*timing[1:], 0.0], strict=True)]
        found += [by("rests", k) for k in range(ways.size)]
        return [
            {"breaks": part[: motion.breaks.size], "coef": part[motion.breaks.size :].reshape(motion.coef.shape)}
            for part in (float(each) * part for each, part in zip(free, found, strict=True))
        ]
