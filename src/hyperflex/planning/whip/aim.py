"""Gauss-Newton on strokes and rests, with exact derivatives, that moves the peak of the tip's speed onto the target."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import swing_period
from hyperflex.errors import SimulationError
from hyperflex.model import DAMPING
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.whip.search import SPREAD_ENDS, SPREAD_RESTS, WhipCandidate
from hyperflex.planning.whip.strokes import Strokes
from hyperflex.planning.whip.tip_target import TipTarget, tip_velocity
from hyperflex.simulation import sensitivities

AIM_TOL = 1e-6  # m
WINDOW, GRID = 0.12, 2e-3  # s: where a peak is looked for, before and after its last time; step
ROUNDS, HALVINGS = 12, 4
IDLE, MAX_IDLE = 0.8, 3  # a round that leaves more than this fraction of the residual is idle; so many idle ones end it
CLOSE = 2e-4  # m, a miss that is small enough
MAX_STEP = 0.6  # in standard deviations of the map's swings
ANGLE_MARGIN, SPEED_MARGIN = 0.85, 1.01  # of the allowed angle and the asked speed
FRICTION_STD, LENGTH_STD, TIMING_STD = 0.05, 0.002, 2e-3  # relative, relative, s of each rest


@dataclass(frozen=True, eq=False)
class AimedPeak:
    """A peak of the tip's speed, and its derivatives by the P parameters of the strokes.

    Time `t`, s, `place`, m, and `velocity`, m/s, (2,) of the tip; `dt` (P,), `dplace` and `dvelocity` (2, P) at the
    peak, which moves. `position_std` is the standard deviation of the place, m, by the delta method, from FRICTION_STD,
    LENGTH_STD and TIMING_STD.
    """

    strokes: Strokes
    t: float
    place: Array
    velocity: Array
    dt: Array
    dplace: Array
    dvelocity: Array
    position_std: float

    @property
    def speed(self) -> float:
        """Speed of the tip, m/s."""
        return float(np.hypot(*self.velocity))


def find_peak(cast_setup: CastSetup, strokes: Strokes, near: float) -> AimedPeak | None:
    """Find the peak of the tip's speed next to time `near`, s, and its derivatives; None if there is none."""
    rope, arm = cast_setup.rope, cast_setup.arm
    motion = strokes.motion(cast_setup.limits)
    t = np.arange(max(GRID, near - WINDOW), near + WINDOW, GRID)
    scaled = {"length": rope.length, "com": rope.com, "inertia": 2.0 * rope.inertia}
    wrt = [{f"x{k}": part} for k, part in enumerate(strokes.variations(cast_setup.limits))]
    p = len(wrt)
    wrt += [{"rope's length": scaled}, {"rope's friction": {name: getattr(rope, name) for name in DAMPING}}]
    try:
        run = sensitivities(rope, motion, arm=arm, duration=float(t[-1]), t_eval=t, tol=AIM_TOL, wrt=wrt)
    except SimulationError:
        return None
    v = tip_velocity(cast_setup, run.q, run.qd, motion.angle(t), motion.rate(t))
    square = (v**2).sum(axis=1)
    at = 1 + np.flatnonzero((square[1:-1] > square[:-2]) & (square[1:-1] >= square[2:]))
    if at.size == 0:
        return None
    i = int(at[np.abs(t[at] - near).argmin()])
    low, mid, high = square[i - 1 : i + 2]
    late = GRID * float(0.5 * (low - high) / (low - 2.0 * mid + high))
    slope, bend = (v[i + 1] - v[i - 1]) / (2.0 * GRID), (low - 2.0 * mid + high) / GRID**2
    dv = np.gradient(run.dtip, GRID, axis=0)
    rise = 2.0 * np.einsum("tx,txp->tp", v, dv)
    later = -(rise[i + 1] - rise[i - 1]) / (2.0 * GRID) / bend
    peak = v[i] + late * slope
    dplace = run.dtip[i] + late * dv[i] + peak[:, None] * later
    dvelocity = dv[i] + slope[:, None] * later
    std = np.concatenate([np.zeros(p // 2), np.full(p // 2, TIMING_STD), [LENGTH_STD, FRICTION_STD]])
    return AimedPeak(
        strokes,
        float(t[i]) + late,
        run.tip[i] + late * (v[i] + 0.5 * late * slope),
        peak,
        later[:p],
        dplace[:, :p],
        dvelocity[:, :p],
        float(np.sqrt(((dplace * std) ** 2).sum())),
    )


def aim_residuals(target: TipTarget, aim: AimedPeak) -> tuple[Array, Array]:
    """Return the residuals (m,), m, and their Jacobian (m, P): the place, and direction and speed if they fail."""
    speed, length = aim.speed, float(np.hypot(*target.point))
    residuals, jacobian = [*(aim.place - target.point)], [*aim.dplace]
    error, allowed = float(target.angle_error(aim.velocity)), target.allowed_angle(ANGLE_MARGIN)
    beyond = error - float(np.clip(error, -allowed, allowed))
    vx, vy = aim.velocity
    if beyond != 0.0:
        residuals.append(length * beyond)
        jacobian.append(length * (vx * aim.dvelocity[1] - vy * aim.dvelocity[0]) / speed**2)
    if speed < SPEED_MARGIN * target.least_speed:
        scale = length / target.least_speed
        residuals.append(scale * (speed - SPEED_MARGIN * target.least_speed))
        jacobian.append(scale * (aim.velocity @ aim.dvelocity) / speed)
    return np.array(residuals), np.array(jacobian)


def aim_peak(
    cast_setup: CastSetup, target: TipTarget, found: WhipCandidate, left: Callable[[], float] = lambda: math.inf
) -> AimedPeak | None:
    """Move a swing's peak onto a target by small changes of strokes and rests; None without a peak at the start.

    `left` returns the time that is left, s; without any the best until then is returned.
    """
    best = find_peak(cast_setup, found.strokes.cut(found.t + WINDOW, cast_setup.limits), found.t)
    if best is None:
        return None
    scale = np.repeat([np.pi * SPREAD_ENDS, swing_period(cast_setup.rope) * SPREAD_RESTS], best.strokes.ends.size)
    residuals, jacobian = aim_residuals(target, best)
    idle = 0
    for _ in range(ROUNDS):
        if idle == MAX_IDLE or (np.hypot(*residuals[:2]) < CLOSE and residuals.size == 2):
            break
        step = -scale * np.linalg.lstsq(jacobian * scale, residuals, rcond=1e-3)[0]
        step = step / max(1.0, float(np.abs(step / scale).max()) / MAX_STEP)
        for _ in range(HALVINGS if left() > 0.0 else 0):
            tried = find_peak(cast_setup, best.strokes.varied(step), best.t + float(best.dt @ step))
            if tried is not None:
                new, new_jacobian = aim_residuals(target, tried)
                if np.linalg.norm(new) < np.linalg.norm(residuals):
                    break
            step = 0.4 * step
        else:
            break
        idle += np.linalg.norm(new) > IDLE * np.linalg.norm(residuals)
        best, residuals, jacobian = tried, new, new_jacobian
    return best
