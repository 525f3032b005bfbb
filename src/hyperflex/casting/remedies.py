"""What would bring a target in reach where it is: a faster motor, a longer arm or rope, more time, a thinner peg."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hyperflex.casting.limits import MotorLimits
from hyperflex.casting.targets import reach
from hyperflex.casting.thrower import Thrower
from hyperflex.checks import Array
from hyperflex.model import Peg, Rope

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
        "motor": least(lambda f: (replace(thrower, limits=_faster(limits, f)), peg), FASTEST),
        "arm": least(lambda f: (replace(thrower, arm=replace(arm, length=f * arm.length)), peg)),
        "rope": least(lambda f: (replace(thrower, rope=_longer(rope, f)), peg)),
        "time": least(lambda f: (replace(thrower, time=f * thrower.time), peg)),
        "peg": least(lambda f: (thrower, replace(peg, radius=peg.radius / f))),
    }
    fast = _faster(limits, factors["motor"])
    words = {
        "motor": f"a motor of {fast.speed:.3g} rad/s and {fast.acceleration:.3g} rad/s^2",
        "arm": f"an arm of {1e3 * factors['arm'] * arm.length:.3g} mm",
        "rope": f"a rope of {factors['rope'] * rope.total_length:.3g} m",
        "time": f"{factors['time'] * thrower.time:.3g} s to strike",
        "peg": f"a peg of {1e3 * peg.radius / factors['peg']:.3g} mm radius",
    }
    return tuple(words[name] for name, factor in factors.items() if 1.0 < factor < np.inf)


def _faster(limits: MotorLimits, factor: float) -> MotorLimits:
    """Limits of a motor that makes each move in 1 / `factor` of the time."""
    if not np.isfinite(factor):
        return limits
    return replace(limits, speed=factor * limits.speed, acceleration=factor**2 * limits.acceleration)


def _longer(rope: Rope, factor: float) -> Rope:
    """Return a rope of the same kind with longer links."""
    changes = {"length": rope.length, "mass": rope.mass, "com": rope.com, "inertia": factor**2 * rope.inertia}
    return rope.replace(**{name: factor * value for name, value in changes.items()})


def _least(good: Callable[[float], bool], most: float) -> float:
    """Return the least factor from 1 on that is good, rounded up to CLOSE; inf if there is none."""
    tried: Array = np.geomspace(1.0, most, round(np.log(most) / 0.05))
    first = next((k for k, factor in enumerate(tried) if good(float(factor))), None)
    if first is None:
        return float("inf")
    low, high = float(tried[max(first - 1, 0)]), float(tried[first])
    while high - low > CLOSE * low:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if good(middle) else (middle, high)
    return high
