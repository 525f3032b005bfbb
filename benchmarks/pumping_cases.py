"""Pumping the paper's cable to 1.8 m: its rest, the best constant rest, free rests, and the closed loop."""

from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperflex.control import PumpingPlan, PumpingRule, SwingModel, arrival_time, run_closed_loop
from hyperflex.interfaces import StateSource
from hyperflex.model import Rope
from hyperflex.motion import Motion
from hyperflex.paper import T_MOVE, cable, casting_arm
from hyperflex.simulation import simulate, simulate_batch

WANTED = 1.8  # m, |x| of the tip
LONGEST = 14.0  # s
SAMPLE_TIME = 0.02  # s
Path = Literal["under", "over"]
# Rests after the first, second, ... half turn, s, found by a search over free rests: evolution strategies from several
# starts maximised the reach before a deadline; over the top, a coordinate search adjusted them.
BEST: dict[Path, tuple[float, ...]] = {
    "under": (0.294, 0.489, 0.581, 0.422, 0.587, 0.314),
    "over": (0.0, 0.380, 0.414, 0.334, 0.529, 1.060),
}


def caster(path: Path) -> SwingModel:
    """Return the paper's cable (physical friction), arm and half turn."""
    return SwingModel(cable(), casting_arm(), T_MOVE, path=path)


def motion_of(path: Path, rests: npt.ArrayLike) -> Motion:
    """Return half turns with given rests (k,) between them, s, from t = 0 on."""
    return caster(path).motion(np.cumsum(np.append(0.0, np.asarray(rests, dtype=np.float64) + T_MOVE)))


def arrival(motion: Motion, *, rope: Rope | None = None, duration: float = LONGEST, tol: float = 1e-6) -> float:
    """Return the time at which the tip first reaches ``|x|`` = 1.8 m, s, for the paper's cable or another rope; else
    inf."""
    t = np.arange(0.0, duration, 0.5 * SAMPLE_TIME)
    run = simulate(rope or cable(), motion, arm=casting_arm(), duration=duration, t_eval=t, tol=tol)
    return float(arrival_time(run.t, np.abs(run.tip[:, :1]).T, WANTED)[0])


def constant_arrivals(path: Path, rests: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the times (m,) at which constant rests (m,), s, bring the tip to 1.8 m, s."""
    count = int(LONGEST / T_MOVE)
    t = SAMPLE_TIME * np.arange(1.0, round(LONGEST / SAMPLE_TIME) + 1.0)
    motions = [motion_of(path, np.full(count, rest)) for rest in rests]
    batch = simulate_batch(cable(), motions, arm=casting_arm(), duration=float(t[-1]), t_eval=t, tol=1e-6)
    return arrival_time(t, np.abs(batch.tip[:, :, 0]), WANTED)


def closed_loop(path: Path, source: StateSource, plan: PumpingPlan | None = None) -> Motion:
    """Run the closed loop with a plan, by default the best known one, on a source of states."""
    model = caster(path)
    rests = np.array(BEST[path]) if plan is None else plan.rests
    reached = arrival(motion_of(path, rests)) if plan is None else plan.arrival_time
    rule = PumpingRule(model, WANTED, rests=rests, arrival_time=reached)
    return run_closed_loop(source, rule, model, duration=reached + 0.5 * model.period).motion
