"""The demo's computations: a video, an identified rope, and a plan that winds it round a target."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hyperflex.checks import Array
from hyperflex.demo import twin
from hyperflex.identification import Identification
from hyperflex.model import PROPERTIES, Peg
from hyperflex.paper import casting_arm
from hyperflex.planning import CastOutcome, CastPlan, HoldingForce, Problem, plan_cast, verify_cast
from hyperflex.recording import Recording
from hyperflex.report import Progress, silent

TARGET = Peg(x=0.62, y=-1.14, radius=0.05, mu=0.3)  # well within reach


@dataclass(frozen=True)
class Parameter:
    """One identified number and its reference values, in SI units."""

    name: str
    unit: str
    guess: float
    value: float
    std: float  # of the value
    mapped: float  # what the same fit finds without noise: the truth as far as the coarse chain can represent it
    cut: float  # of the rope simply cut into as many links

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval."""
        return self.value - 1.96 * self.std, self.value + 1.96 * self.std

    @property
    def covered(self) -> bool:
        """Whether the interval contains the value that the fit finds without noise."""
        low, high = self.interval
        return low <= self.mapped <= high


@dataclass(frozen=True, eq=False)
class Demo:
    """The results of the demo."""

    recording: Recording  # markers tracked in the bundled video, simulated
    seen: float  # fraction of all markers in all frames that was seen
    identification: Identification  # of the 10-link chain
    parameters: tuple[Parameter, ...]
    angle_noise: Array  # (n,) standard deviation of the measured link angles, rad
    plan: CastPlan  # how the identified rope is wound round a target
    held: HoldingForce | None  # result of a tug at the wound rope
    proof: CastOutcome | None  # the same throw by the rope that made the recording

    @property
    def held_out_rms(self) -> float:
        """Rms prediction error of all links on the held-out part of the recording, rad; NaN without one."""
        held = self.identification.held_out
        return float("nan") if held is None else float(np.sqrt(np.mean(held.rms**2)))


def run_demo(progress: Progress = silent, preview: Path | None = None) -> Demo:
    """Track the bundled video's rope, identify it, and plan how to wind it round a target.

    `preview` is a video file that shows the tracked markers.
    """
    track = twin.track(preview=preview, progress=lambda count: progress(f"tracking the rope, frame {count}"))
    recording = twin.recording(track)

    def report(entry: dict[str, float]) -> None:
        progress(f"identifying, windows of {entry['window']:.2g} s, round {entry['round'] + 1:.0f}")

    found = twin.fit(recording, report)
    noise = recording.angles().noise
    scale = np.full(recording.n_links, np.nan) if noise is None else np.median(noise, axis=0)
    progress("planning how to wind the rope round a target")
    plan = plan_cast(found.rope, casting_arm(), TARGET, time_budget=180.0)  # it usually ends after some seconds
    progress("pulling at the wound rope")
    held, proof = plan.measure_holding_force(), None
    if plan.motion is not None:
        progress("throwing the rope that made the recording")
        proof = verify_cast(Problem(twin.fine_rope(), casting_arm(), plan.problem.limits), TARGET, plan.motion)
    return Demo(recording, track.seen, found, _parameters(found), scale, plan, held, proof)


def _parameters(found: Identification) -> tuple[Parameter, ...]:
    guess, mapped, cut = twin.guess(), twin.mapped_truth(), twin.coarse_rope()
    return tuple(
        Parameter(
            name,
            PROPERTIES[name].unit,
            guess=float(getattr(guess, name)[0]),
            value=float(found.values[name][0]),
            std=float(found.std[name][0]),
            mapped=mapped[name],
            cut=float(getattr(cut, name)[0]),
        )
        for name in found.values
    )
