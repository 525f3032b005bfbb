"""Remedies for an infeasible target: a faster motor, a longer arm or rope, more time, a thinner peg."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Peg, Rope
from hyperflex.planning.problem import MotorLimits, Problem
from hyperflex.planning.wind.feasibility import check_feasibility

MAX_FACTOR, MAX_SPEED_FACTOR = 3.0, 10.0  # greatest factor of a remedy; of the motor
TOLERANCE = 0.01  # relative, of a factor


def find_remedies(problem: Problem, peg: Peg, *, holding_force: float = 0.0) -> tuple[str, ...]:
    """Return in words the changes that would each make a target feasible; none if it is feasible.

    `holding_force` is the pull that the wound rope must withstand, N. The factor of each change is searched from 1 up
    in steps of 5 % or less, then by bisection.
    """
    rope, arm, limits = problem.rope, problem.arm, problem.limits

    def least(changed: Callable[[float], tuple[Problem, Peg]], most: float = MAX_FACTOR) -> float:
        def good(factor: float) -> bool:
            try:
                known = changed(factor)
            except InvalidInput:  # no set-up: a longer arm hits an obstacle, say
                return False
            return check_feasibility(*known, holding_force=holding_force).feasible

        return _least(good, most)

    factors = {
        "speed": least(lambda f: (replace(problem, limits=_faster(limits, f, 1.0)), peg), MAX_SPEED_FACTOR),
        "acceleration": least(lambda f: (replace(problem, limits=_faster(limits, 1.0, f)), peg), MAX_SPEED_FACTOR),
        "motor": least(lambda f: (replace(problem, limits=_faster(limits, f, f**2)), peg), MAX_SPEED_FACTOR),
        "arm": least(lambda f: (replace(problem, arm=replace(arm, length=f * arm.length)), peg)),
        "rope": least(lambda f: (replace(problem, rope=_longer(rope, f)), peg)),
        "time": least(lambda f: (replace(problem, time=f * problem.time), peg)),
        "peg": least(lambda f: (problem, replace(peg, radius=peg.radius / f))),
    }
    if min(factors["speed"], factors["acceleration"]) < np.inf:
        factors["motor"] = np.inf  # one limit alone is enough
    faster, acceleration = factors["motor"] * limits.speed, factors["motor"] ** 2 * limits.acceleration
    words = {
        "speed": f"a motor of {_up(factors['speed'] * limits.speed)} rad/s",
        "acceleration": f"a motor of {_up(factors['acceleration'] * limits.acceleration)} rad/s^2",
        "motor": f"a motor of {_up(faster)} rad/s and {_up(acceleration)} rad/s^2",
        "arm": f"an arm of {_up(1e3 * factors['arm'] * arm.length)} mm",
        "rope": f"a rope of {_up(factors['rope'] * rope.total_length)} m",
        "time": f"{_up(factors['time'] * problem.time)} s to strike",
        "peg": f"a peg of {_up(1e3 * peg.radius / factors['peg'], -1)} mm radius",
    }
    return tuple(words[name] for name, factor in factors.items() if 1.0 < factor < np.inf)


def _up(value: float, sense: int = 1) -> str:
    """Write a value with three digits, rounded up (-1: down), so that the written value is enough."""
    if not 0.0 < value < np.inf:
        return str(value)
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{sense * math.ceil(sense * value / unit - 1e-9) * unit:.3g}"


def _faster(limits: MotorLimits, speed: float, acceleration: float) -> MotorLimits:
    """Return limits with speed and acceleration multiplied by factors."""
    return replace(limits, speed=speed * limits.speed, acceleration=acceleration * limits.acceleration)


def _longer(rope: Rope, factor: float) -> Rope:
    """Return the same rope with links longer by a factor."""
    changes = {"length": rope.length, "mass": rope.mass, "com": rope.com, "inertia": factor**2 * rope.inertia}
    return rope.replace(**{name: factor * value for name, value in changes.items()})


def _least(good: Callable[[float], bool], most: float) -> float:
    """Return the least good factor from 1 up, found from above to TOLERANCE; inf if there is none."""
    tried: Array = np.geomspace(1.0, most, math.ceil(math.log(most) / math.log(1.05)) + 1)
    first = next((k for k, factor in enumerate(tried) if good(float(factor))), None)
    if first is None:
        return float("inf")
    low, high = float(tried[max(first - 1, 0)]), float(tried[first])
    while high - low > TOLERANCE * low:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if good(middle) else (middle, high)
    return high
