"""A whip made exact: where its peak is, how that moves with strokes and rests, and Gauss-Newton onto the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import swing_period
from hyperflex.errors import SimulationError
from hyperflex.model.properties import DAMPING
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.whip.search import SPREAD_ENDS, SPREAD_RESTS, Found
from hyperflex.planning.whip.strokes import Strokes
from hyperflex.planning.whip.tip_target import Mark
from hyperflex.simulation import sensitivities

AIM_TOL = 1e-6  # m
SIDE, GRID = 0.12, 2e-3  # s: where a peak is looked for, before and after where it was last, and how densely
ROUNDS, HALVINGS = 12, 4
IDLE, IDLES = 0.8, 3  # a round that leaves more than this part of what is wrong is idle; so many idle ones end it
CLOSE = 2e-4  # m, a miss that need not fall
LONGEST = 0.6  # longest step, in spreads of the map's swings
KEEP_ANGLE, KEEP_SPEED = 0.85, 1.01  # parts of what is allowed and asked that are kept to
FRICTION, LENGTH, TIMING = 0.05, 0.002, 2e-3  # standard deviations: relative, relative, s of each rest


@dataclass(frozen=True, eq=False)
class Aim:
    """A swing's peak near a given time, and its derivatives.

    Attributes
    ----------
    strokes : Strokes
    t : float
        s.
    place, velocity : (2,) float64
        Of the tip, m, m/s.
    by_t : (P,) float64
        Derivatives of the time by the strokes' numbers, s per rad and s.
    by_place, by_velocity : (2, P) float64
        Those of place and velocity, which move with the peak.
    doubt : float
        Standard deviation of the place, m, if friction is uncertain by FRICTION, length by LENGTH, each rest by TIMING.
    """

    strokes: Strokes
    t: float
    place: Array
    velocity: Array
    by_t: Array
    by_place: Array
    by_velocity: Array
    doubt: float

    @property
    def speed(self) -> float:
        """Speed of the tip, m/s."""
        return float(np.hypot(*self.velocity))


def look(thrower: Thrower, strokes: Strokes, near: float) -> Aim | None:
    """Find the peak of the tip's speed next to time `near`, s, and its derivatives; None where there is none."""
    rope, arm = thrower.rope, thrower.arm
    motion = strokes.motion(thrower.limits)
    t = np.arange(max(GRID, near - SIDE), near + SIDE, GRID)
    scaled = {"length": rope.length, "com": rope.com, "inertia": 2.0 * rope.inertia}
    ways = [{f"x{k}": part} for k, part in enumerate(strokes.variations(thrower.limits))]
    doubts = [{"rope's length": scaled}, {"rope's friction": {name: getattr(rope, name) for name in DAMPING}}]
    try:
        run = sensitivities(rope, motion, arm=arm, duration=float(t[-1]), t_eval=t, tol=AIM_TOL, wrt=[*ways, *doubts])
    except SimulationError:
        return None
    angle, rate = motion.angle(t), arm.length * motion.rate(t)
    spin = rope.length * run.qd
    v = np.stack(
        [
            (spin * np.cos(run.q)).sum(axis=1) + rate * np.cos(angle),
            (spin * np.sin(run.q)).sum(axis=1) + rate * np.sin(angle),
        ],
        axis=1,
    )
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
    by_place = run.dtip[i] + late * dv[i] + peak[:, None] * later
    by_velocity = dv[i] + slope[:, None] * later
    p = len(ways)
    sds = np.concatenate([np.zeros(p // 2), np.full(p // 2, TIMING), [LENGTH, FRICTION]])
    return Aim(
        strokes,
        float(t[i]) + late,
        run.tip[i] + late * (v[i] + 0.5 * late * slope),
        peak,
        later[:p],
        by_place[:, :p],
        by_velocity[:, :p],
        float(np.sqrt(((by_place * sds) ** 2).sum())),
    )


def asked(mark: Mark, aim: Aim) -> tuple[Array, Array]:
    """What is still wrong (m,), in m, and its derivatives (m, P): the place, and direction and speed where needed."""
    speed, length = aim.speed, float(np.hypot(*mark.point))
    wrong, by = [*(aim.place - mark.point)], [*aim.by_place]
    off = float(mark.off(aim.velocity))
    beyond = off - float(np.clip(off, -mark.allowed(KEEP_ANGLE), mark.allowed(KEEP_ANGLE)))
    vx, vy = aim.velocity
    if beyond != 0.0:
        wrong.append(length * beyond)
        by.append(length * (vx * aim.by_velocity[1] - vy * aim.by_velocity[0]) / speed**2)
    if speed < KEEP_SPEED * mark.speed:
        part = length / mark.speed
        wrong.append(part * (speed - KEEP_SPEED * mark.speed))
        by.append(part * (aim.velocity @ aim.by_velocity) / speed)
    return np.array(wrong), np.array(by)


def aimed(thrower: Thrower, mark: Mark, found: Found) -> Aim | None:
    """Move a swing's peak onto a target by the smallest changes of strokes and rests (Gauss-Newton).

    Parameters
    ----------
    thrower : Thrower
    mark : Mark
    found : Found
        Where to start.

    Returns
    -------
    Aim or None
        The best; None where there is no peak at the start.
    """
    limits = thrower.limits
    best = look(thrower, found.strokes.cut(found.t + SIDE, limits), found.t)
    if best is None:
        return None
    scale = np.repeat([np.pi * SPREAD_ENDS, swing_period(thrower.rope) * SPREAD_RESTS], best.strokes.ends.size)
    wrong, by = asked(mark, best)
    idle = 0
    for _ in range(ROUNDS):
        if idle == IDLES or (np.hypot(*wrong[:2]) < CLOSE and wrong.size == 2):
            break
        step = -scale * np.linalg.lstsq(by * scale, wrong, rcond=1e-3)[0]
        step = step / max(1.0, float(np.abs(step / scale).max()) / LONGEST)
        for _ in range(HALVINGS):
            tried = look(thrower, best.strokes.varied(step), best.t + float(best.by_t @ step))
            if tried is not None:
                new, new_by = asked(mark, tried)
                if np.linalg.norm(new) < np.linalg.norm(wrong):
                    break
            step = 0.4 * step
        else:
            break
        idle += np.linalg.norm(new) > IDLE * np.linalg.norm(wrong)
        best, wrong, by = tried, new, new_by
    return best
