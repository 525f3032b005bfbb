"""The peak of the tip's speed after strokes, its exact derivatives by them, and what is left to the target."""

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.aim import GRID, WINDOW, position_std, swing_derivatives, swing_times
from hyperflex.planning.tip.joint_motion import JointMotion
from hyperflex.planning.tip.obstacle_gaps import BESIDE, SpareGaps, least_spare_gaps
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.task import Aimed
from hyperflex.planning.whip.tip_target import TipTarget, tip_velocity

ANGLE_MARGIN, SPEED_MARGIN = 0.85, 1.01  # of the allowed angle and the asked speed


@dataclass(frozen=True, eq=False)
class AimedPeak(Aimed):
    """A peak of the tip's speed, and its derivatives by the P parameters of the strokes.

    `place`, m, and `velocity`, m/s, (2,) of the tip; `dplace` and `dvelocity` (2, P) at the peak, which moves. `gaps`
    are those from obstacles until then.
    """

    place: Array
    velocity: Array
    dplace: Array
    dvelocity: Array
    gaps: SpareGaps

    @property
    def speed(self) -> float:
        """Speed of the tip, m/s."""
        return float(np.hypot(*self.velocity))


def find_peak(problem: Problem, strokes: Strokes, near: float, beside: Array | None = None) -> AimedPeak | None:
    """Find the peak of the tip's speed next to time `near`, s, and its derivatives; None if there is none.

    `beside` (w,), m, are the gaps asked from obstacles, as of :func:`margins`, by default BESIDE.
    """
    window = np.arange(max(GRID, near - WINDOW), near + WINDOW, GRID)
    t = swing_times(near) if problem.obstacles else window
    run, motion = swing_derivatives(problem, strokes, t), strokes.motion(problem.limits)
    if run is None:
        return None
    v = tip_velocity(problem, run.q, run.qd, motion.angle(t), motion.rate(t))
    square = (v**2).sum(axis=1)
    at = 1 + np.flatnonzero((square[1:-1] > square[:-2]) & (square[1:-1] >= square[2:]))
    at = at[np.abs(t[at] - near) < WINDOW]
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
    moved, count = JointMotion(problem.rope, run), len(problem.obstacles)
    last = moved.between(i, late / GRID, later, GRID) if count else None
    asked = np.full(count, BESIDE) if beside is None else beside
    gaps = least_spare_gaps(problem, moved, i + int(late >= 0.0), asked, last)
    return AimedPeak(
        strokes,
        float(t[i]) + late,
        later[:-2],
        position_std(dplace),
        place=run.tip[i] + late * (v[i] + 0.5 * late * slope),
        velocity=peak,
        dplace=dplace[:, :-2],
        dvelocity=dvelocity[:, :-2],
        gaps=gaps._replace(change=gaps.change[:, :-2]),
    )


def aim_residuals(target: TipTarget, aim: AimedPeak, length: float) -> tuple[Array, Array]:
    """Return the residuals (m,), m, and their Jacobian (m, P): the place, and what else fails.

    That is direction, speed, and gaps from obstacles. The target's distance from the shaft is the `length`, m, that an
    error of 1 rad or of the whole speed counts as.
    """
    speed = aim.speed
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
    failing = aim.gaps.spare < aim.gaps.beside
    residuals += (aim.gaps.spare - aim.gaps.beside)[failing].tolist()
    jacobian += [*aim.gaps.change[failing]]
    return np.array(residuals), np.array(jacobian)
