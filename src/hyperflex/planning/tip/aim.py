"""Levenberg-Marquardt on strokes and rests, with exact derivatives, until the tip does what a task asks."""

import math

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.model import DAMPING
from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.swings import SPREAD_ENDS, SPREAD_RESTS
from hyperflex.planning.tip.task import AimedT, Left, TipCandidate, TipTask
from hyperflex.simulation import Sensitivities, sensitivities

AIM_TOL = 1e-6  # m
WINDOW, GRID = 0.12, 2e-3  # s: how far an instant may move from its last time; step of samples about it
SAMPLE_TIME, CLOSELY = 0.01, 0.4  # s: between samples of a whole swing but for the last; those lie GRID apart
ROUNDS = 24
DAMPING_START, MIN_DAMPING, MAX_DAMPING = 2e-3, 1e-4, 3.0  # of Levenberg and Marquardt, of the greatest singular value
LESS, MORE = 4.0, 5.0  # factors of the damping after a step that is taken, and one that is not
IDLE, MAX_IDLE = 0.8, 3  # a round that leaves more than this fraction of the residual is idle; so many idle ones end it
MAX_STEP = 0.6  # in standard deviations of random swings
FRICTION_STD, LENGTH_STD, TIMING_STD = 0.05, 0.002, 2e-3  # relative, relative, s of each rest


def swing_times(near: float) -> Array:
    """Return times (T,), s, at which a whole swing is looked at whose tip does something about time `near`, s."""
    closely = max(GRID, near - CLOSELY)
    return np.append(np.arange(SAMPLE_TIME, closely - GRID, SAMPLE_TIME), np.arange(closely, near + WINDOW, GRID))


def swing_derivatives(problem: Problem, strokes: Strokes, t: Array) -> Sensitivities | None:
    """Simulate strokes with derivatives at times t (T,), s, by their parameters, the rope's length and its friction.

    The last two are by factors of length and friction. None if the run fails.
    """
    rope, arm = problem.rope, problem.arm
    scaled = {"length": rope.length, "com": rope.com, "inertia": 2.0 * rope.inertia}
    wrt = [{f"x{k}": part} for k, part in enumerate(strokes.variations(problem.limits))]
    wrt += [{"rope's length": scaled}, {"rope's friction": {name: getattr(rope, name) for name in DAMPING}}]
    motion = strokes.motion(problem.limits)
    try:
        return sensitivities(rope, motion, arm=arm, duration=float(t[-1]), t_eval=t, tol=AIM_TOL, wrt=wrt)
    except SimulationError:
        return None


def position_std(change: Array) -> float:
    """Return the standard deviation of a place by the delta method, m, from FRICTION_STD, LENGTH_STD and TIMING_STD.

    `change` (..., P + 2) are the derivatives of its coordinates, in the order of :func:`swing_derivatives`.
    """
    k = (change.shape[-1] - 2) // 2
    std = np.concatenate([np.zeros(k), np.full(k, TIMING_STD), [LENGTH_STD, FRICTION_STD]])
    return float(np.sqrt(((change * std) ** 2).sum()))


def aim_strokes(task: TipTask[AimedT], found: TipCandidate, left: Left = lambda: math.inf) -> AimedT | None:
    """Move what the tip does after a swing to what a task asks, by small changes of strokes and rests.

    `left` returns the time that is left, s; without any the best until then is returned. None if the tip does nothing
    of the kind at the start.
    """
    limits, period = task.problem.limits, task.problem.period
    best = task.find(found.strokes.cut(found.t + WINDOW, limits), found.t)
    task.runs += 1
    if best is None:
        return None
    scale = np.repeat([np.pi * SPREAD_ENDS, period * SPREAD_RESTS], best.strokes.ends.size)
    residuals, jacobian = task.residuals(best)
    damping, idle = DAMPING_START, 0
    for _ in range(ROUNDS):
        if idle == MAX_IDLE or np.linalg.norm(residuals) < task.close or damping > MAX_DAMPING or left() < 0.0:
            break
        step = scale * _damped_step(jacobian * scale, residuals, damping)
        step = step / max(1.0, float(np.abs(step / scale).max()) / MAX_STEP)
        at = best.t + float(best.dt @ step)  # far off where the tip's instant depends on nearly nothing
        tried = task.find(best.strokes.varied(step), at) if 0.0 <= at <= task.problem.time + WINDOW else None
        task.runs += 1
        new, new_jacobian = (residuals, jacobian) if tried is None else task.residuals(tried)
        if tried is None or np.linalg.norm(new) >= np.linalg.norm(residuals):
            damping *= MORE
            continue
        idle += np.linalg.norm(new) > IDLE * np.linalg.norm(residuals)
        best, residuals, jacobian, damping = tried, new, new_jacobian, max(damping / LESS, MIN_DAMPING)
    return best


def _damped_step(jacobian: Array, residuals: Array, damping: float) -> Array:
    """Return the step of Levenberg and Marquardt (P,); `damping` is relative to the greatest singular value."""
    left, size, right = np.linalg.svd(jacobian, full_matrices=False)
    kept = np.maximum(size**2 + (damping * size[0]) ** 2, 1e-300)
    return np.asarray(-right.T @ (size / kept * (left.T @ residuals)))
