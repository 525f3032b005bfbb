"""What would bring a target in reach where it is: a faster motor, a longer arm or rope, more time, a thinner peg."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Peg, Rope
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.motor_limits import MotorLimits
from hyperflex.planning.wind.reachability import reach

MOST, FASTEST = 3.0, 10.0  # greatest factor that is told, and that of the motor's speed
CLOSE = 0.01  # to which a factor is found


def remedies(thrower: Thrower, peg: Peg, *, hold: float = 0.0) -> tuple[str, ...]:
    """Return in words what would bring a target in reach by the criterion, each for itself; none if it is in reach.

    Parameters
    ----------
    thrower : Thrower
    peg : Peg
    hold : float
        Pull that the wound rope should bear, N.

    Notes
    -----
    A factor on each is looked for from 1 up, in steps of 5 % or less, and then closer.
    """
    rope, arm, limits = thrower.rope, thrower.arm, thrower.limits

    def least(changed: Callable[[float], tuple[Thrower, Peg]], most: float = MOST) -> float:
        return _least(lambda factor: reach(*changed(factor), hold=hold).within, most)

    factors = {
        "speed": least(lambda f: (replace(thrower, limits=_faster(limits, f, 1.0)), peg), FASTEST),
        "acceleration": least(lambda f: (replace(thrower, limits=_faster(limits, 1.0, f)), peg), FASTEST),
        "motor": least(lambda f: (replace(thrower, limits=_faster(limits, f, f**2)), peg), FASTEST),
        "arm": least(lambda f: (replace(thrower, arm=replace(arm, length=f * arm.length)), peg)),
        "rope": least(lambda f: (replace(thrower, rope=_longer(rope, f)), peg)),
        "time": least(lambda f: (replace(thrower, time=f * thrower.time), peg)),
        "peg": least(lambda f: (thrower, replace(peg, radius=peg.radius / f))),
    }
    if min(factors["speed"], factors["acceleration"]) < np.inf:
        factors["motor"] = np.inf  # the other is enough as it is
    faster, acceleration = factors["motor"] * limits.speed, factors["motor"] ** 2 * limits.acceleration
    words = {
        "speed": f"a motor of {_up(factors['speed'] * limits.speed)} rad/s",
        "acceleration": f"a motor of {_up(factors['acceleration'] * limits.acceleration)} rad/s^2",
        "motor": f"a motor of {_up(faster)} rad/s and {_up(acceleration)} rad/s^2",
        "arm": f"an arm of {_up(1e3 * factors['arm'] * arm.length)} mm",
        "rope": f"a rope of {_up(factors['rope'] * rope.total_length)} m",
        "time": f"{_up(factors['time'] * thrower.time)} s to strike",
        "peg": f"a peg of {_up(1e3 * peg.radius / factors['peg'], -1)} mm radius",
    }
    return tuple(words[name] for name, factor in factors.items() if 1.0 < factor < np.inf)


def _up(value: float, sense: int = 1) -> str:
    """Write a value with three digits, rounded up (-1: down), so that what is told is enough."""
    if not 0.0 < value < np.inf:
        return str(value)
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{sense * math.ceil(sense * value / unit - 1e-9) * unit:.3g}"


def _faster(limits: MotorLimits, speed: float, acceleration: float) -> MotorLimits:
    """Limits of a motor with so many times the speed and acceleration."""
    return replace(limits, speed=speed * limits.speed, acceleration=acceleration * limits.acceleration)


def _longer(rope: Rope, factor: float) -> Rope:
    """Return a rope of the same kind with longer links."""
    changes = {"length": rope.length, "mass": rope.mass, "com": rope.com, "inertia": factor**2 * rope.inertia}
    return rope.replace(**{name: factor * value for name, value in changes.items()})


def _least(good: Callable[[float], bool], most: float) -> float:
    """Return the least factor from 1 on that is good, rounded up to CLOSE; inf if there is none."""
    tried: Array = np.geomspace(1.0, most, math.ceil(math.log(most) / math.log(1.05)) + 1)
    first = next((k for k, factor in enumerate(tried) if good(float(factor))), None)
    if first is None:
        return float("inf")
    low, high = float(tried[max(first - 1, 0)]), float(tried[first])
    while high - low > CLOSE * low:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if good(middle) else (middle, high)
    return high
