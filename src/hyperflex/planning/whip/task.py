"""The whip as a task of the tip: the peak of its speed on the target, fast and in the asked direction."""

from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import divided
from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.obstacle_gaps import margins
from hyperflex.planning.tip.outcome import excess_torque
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.task import NEVER, TipCandidate, TipTask, Verified
from hyperflex.planning.whip.aim import AimedPeak, aim_residuals, find_peak
from hyperflex.planning.whip.outcome import TipStrike, verify_whip
from hyperflex.planning.whip.search import WhipMap, pivot_distance, simulate_peaks
from hyperflex.planning.whip.tip_target import TipTarget, cheapest_peaks, peak_costs
from hyperflex.simulation import Deadline

MAX_MISS = 1e-3  # m
# m. A rope with finer links is another model of the same rope, and no plan can meet both within MAX_MISS. Its miss
# counts if it is more than a few times that, and more than the standard deviation of the place.
MAX_FINER_MISS = 3.0 * MAX_MISS
FINER = 2  # pieces of each link in the second verification


class WhipTask(TipTask[AimedPeak]):
    """Whip a target, from the swings of a map."""

    close, direct, ready, rounds = 2e-4, 8, 0.06, 1

    def __init__(self, whip_map: WhipMap, target: TipTarget) -> None:
        self.whip_map, self.target, self.problem = whip_map, target, whip_map.problem
        self.finer = replace(self.problem, rope=divided(self.problem.rope, FINER))
        self.beside = margins(self.problem, target.point[None])

    def candidates(self) -> list[TipCandidate]:
        """Return the cheapest peak of each swing of the map, the cheapest first."""
        return self.whip_map.candidates(self.target)

    def score(self, strokes: list[Strokes], threads: int | None, until: float) -> tuple[Array, Array]:
        """Return cost, m, and time, s, of the cheapest peak of each swing."""
        sooner = replace(self.problem, time=min(self.problem.time, until))
        peaks = simulate_peaks(sooner, strokes, threads)
        each = np.append(peak_costs(self.target, peaks), NEVER)
        best = cheapest_peaks(each[:-1], peaks.row, len(strokes))
        return each[best], np.append(peaks.t, np.nan)[best]

    def find(self, strokes: Strokes, near: float) -> AimedPeak | None:
        """Return the peak of the tip's speed next to time `near`, s."""
        return find_peak(self.problem, strokes, near, self.beside)

    def residuals(self, aim: AimedPeak) -> tuple[Array, Array]:
        """Return the peak's way to the target, and direction, speed and gaps from obstacles if they fail."""
        return aim_residuals(self.target, aim, pivot_distance(self.problem, self.target))

    def shortfall(self, aim: AimedPeak) -> float:
        """Return by how much place, direction, speed and gaps from obstacles fail, 0 if they do not."""
        miss = float(np.hypot(*(aim.place - self.target.point)))
        beyond = max(0.0, abs(float(self.target.angle_error(aim.velocity))) - self.target.angle_tolerance)
        slow = max(0.0, 1.0 - aim.speed / self.target.least_speed)
        touching = max(0.0, -float(aim.gaps.spare.min(initial=np.inf)))
        return max(0.0, miss - MAX_MISS) + beyond + slow + touching

    def verify(self, aim: AimedPeak, end: Deadline | None) -> Verified:
        """Simulate a whip with the links as planned and half as long."""
        both, motion = (self.problem, self.finer), aim.strokes.motion(self.problem.limits)
        outcome, again = (verify_whip(each, self.target, motion, aim.t, time_budget=end) for each in both)
        return Verified(aim, outcome, again, failure(self.problem, outcome, again, aim.position_std))


def failure(problem: Problem, outcome: TipStrike | None, finer: TipStrike | None, position_std: float) -> str:
    """Return why a whip fails, empty if it succeeds; `position_std` is the standard deviation of its place, m."""
    if outcome is None:
        return "in the verified run the tip's speed has no peak there"
    if outcome.message:
        return outcome.message
    if outcome.miss > MAX_MISS:
        return f"the tip misses the target by {1e3 * outcome.miss:.1f} mm"
    if asked := excess_torque(problem, outcome.torque):
        return asked
    if finer is None:
        return "with links of half the length the tip's speed has no peak there"
    if refused := finer.refused or excess_torque(problem, finer.torque):
        return f"with links of half the length {refused}"
    allowed = max(MAX_FINER_MISS, position_std)
    if finer.miss > allowed:
        return f"with links of half the length it misses by {1e3 * finer.miss:.1f} mm, {1e3 * allowed:.1f} allowed"
    return ""
