"""The demo's computations: a video, an identified rope, its cast, a plan that winds it round a target."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hyperflex.checks import Array
from hyperflex.demo import twin
from hyperflex.identification import FitOptions, Identification, identify
from hyperflex.model import Peg, Rope
from hyperflex.motion import arm_swings
from hyperflex.paper import DURATION, T_MOVE, T_REST, casting_arm
from hyperflex.planning import CastOutcome, CastPlan, HoldingForce, Problem, plan_cast, verify_cast
from hyperflex.recording import Recording
from hyperflex.report import Progress, silent
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

INTERVAL = 1.96  # standard deviations to each side of a 95 % interval
SAMPLES_PER_SECOND = 200
TARGET = Peg(x=0.62, y=-1.14, radius=0.05, mu=0.3)  # well within reach
TIME_BUDGET = 180.0  # s; a plan with a margin, most often found after some seconds, ends the search
_UNITS = {"friction": "N m s/rad", "inertia": "kg m^2"}


@dataclass(frozen=True)
class Parameter:
    """One identified number, in SI units, beside what is known about it."""

    name: str
    unit: str
    guess: float
    value: float
    std: float  # of the value
    mapped: float  # what the same fit finds without noise: the truth as far as the coarse chain can hold it
    cut: float  # that of the rope simply cut into as many links

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval."""
        return self.value - INTERVAL * self.std, self.value + INTERVAL * self.std

    @property
    def covered(self) -> bool:
        """Whether the interval holds the value that the fit finds without noise."""
        low, high = self.interval
        return low <= self.mapped <= high


@dataclass(frozen=True, eq=False)
class Demo:
    """The results of the demo."""

    recording: Recording  # markers tracked in the bundled video, simulated
    seen: float  # which part of all markers in all frames was seen
    identification: Identification  # of the 10-link chain
    parameters: tuple[Parameter, ...]
    angle_noise: Array  # (n,) standard deviation of the measured link angles, rad: the least error that can be measured
    cast: Trajectory  # the identified rope, cast by the paper's motion
    reference: Trajectory  # the rope that made the recording, cast likewise
    plan: CastPlan  # how the identified rope is wound round a target
    held: HoldingForce | None  # result of a tug at the wound rope
    proof: CastOutcome | None  # the same throw by the rope that made the recording


def run_demo(progress: Progress = silent, preview: Path | None = None) -> Demo:
    """Track the bundled video's rope, identify it, cast it, and plan how to wind it round a target.

    `preview` is a file for a video of what was seen.
    """
    track = twin.track(preview=preview, progress=lambda count: progress(f"tracking the rope, frame {count}"))
    recording, guess = twin.recording(track), twin.guess()

    def report(entry: dict[str, float]) -> None:
        progress(f"identifying, windows of {entry['window']:.2g} s, round {entry['round'] + 1:.0f}")

    found = identify(
        recording, guess, twin.FREE, options=FitOptions(train=twin.TRAIN, window=twin.WINDOW), progress=report
    )
    mapped, cut = twin.mapped_truth(), twin.coarse_rope()
    parameters = tuple(
        Parameter(
            name,
            _UNITS[name],
            float(getattr(guess, name)[0]),
            float(found.values[name][0]),
            float(found.std[name][0]),
            mapped[name],
            float(getattr(cut, name)[0]),
        )
        for name in found.values
    )
    progress("casting the identified rope")
    noise = recording.angles().noise
    scale = np.full(recording.n_links, np.nan) if noise is None else np.median(noise, axis=0)
    cast, reference = _cast(found.rope), _cast(twin.fine_rope())
    plan, held, proof = _wind(found.rope, progress)
    return Demo(recording, track.seen, found, parameters, scale, cast, reference, plan, held, proof)


def _cast(rope: Rope) -> Trajectory:
    """Cast a rope by the paper's successful motion through the bottom."""
    motion = arm_swings(T_MOVE, T_REST["success"])
    t = np.linspace(0.0, DURATION, round(DURATION * SAMPLES_PER_SECOND) + 1)
    return simulate(rope, motion, arm=casting_arm(), duration=DURATION, t_eval=t)


def _wind(rope: Rope, progress: Progress) -> tuple[CastPlan, HoldingForce | None, CastOutcome | None]:
    """Plan with the identified rope, tug at it, and throw the one that made the recording likewise."""
    progress("planning how to wind it round a target")
    plan = plan_cast(rope, casting_arm(), TARGET, time_budget=TIME_BUDGET)
    progress("tugging at the rope")
    held = plan.measure_holding_force()
    if plan.motion is None:
        return plan, held, None
    progress("throwing the rope that made the recording")
    proof = verify_cast(Problem(twin.fine_rope(), casting_arm(), plan.problem.limits), TARGET, plan.motion)
    return plan, held, proof
