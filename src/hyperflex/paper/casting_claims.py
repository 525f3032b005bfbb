"""The paper's claims on casting (section IV), each measured against a threshold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from hyperflex.checks import Array
from hyperflex.paper import linearization
from hyperflex.paper.casting import READINGS, T_MOVE, Cast, Reading, cast

WINDOW = 2.0  # s
LINEAR_ERROR = 1e-9
REACH_RATIO = 1.6
STRAIGHTNESS = 0.995
SETTLED = 2.0  # s, from when on theta(t) is fitted
CONCENTRATION = 0.9
NEARLY_FULL = 0.9  # share of the greatest r up to which the rope counts as being pumped up


class Titled(Protocol):
    """What a claim may be measured in: a reading of the cast, a swing of the identification twin."""

    @property
    def title(self) -> str:
        """It in words."""


@dataclass(frozen=True)
class Claim:
    """What a claim demands and what was measured.

    Attributes
    ----------
    name : str
        "C1" to "C7".
    statement : str
        The claim in words.
    reading : Reading or Swing
        What it was measured in.
    measured : float
        The measured value.
    threshold : float
        The value at which the claim just holds.
    note : str
        What else the measurement shows.
    relation : {">=", "<="}
        On which side of the threshold it holds.
    """

    name: str
    statement: str
    reading: Titled
    measured: float
    threshold: float
    note: str = ""
    relation: Literal[">=", "<="] = ">="

    @property
    def holds(self) -> bool:
        """Whether the measured value lies on the right side of the threshold."""
        return self.measured >= self.threshold if self.relation == ">=" else self.measured <= self.threshold


def reach_table(subject: Cast) -> Array:
    """Return the greatest ``|x|`` of the tip in each 2 s from the start on, m."""
    starts = np.arange(0.0, subject.t[-1] - 0.5 * WINDOW, WINDOW)
    return np.array([subject.reach(start, start + WINDOW) for start in starts])


def linearized(reading: Reading) -> Claim:
    """C1: with u from (3) the arm's acceleration equals u, and the torque recovered from u reproduces the motion."""
    error, distance = linearization.replay(reading)
    note = f"the recovered torque, replayed open loop for one swing, leads the tip back within {1e3 * distance:.2g} mm"
    statement = "u of (3) is the arm's acceleration: relative error"
    return Claim("C1", statement, reading, error, LINEAR_ERROR, note, "<=")


def success_over_failure(reading: Reading) -> Claim:
    """C2: a rest of 0.53 s pumps the rope up, 0.34 s does not.

    Measured: the greatest ``|x|`` of the tip in 10-14 s, success over failure. Notes how far the failure's reach has
    fallen from its peak ("steps decreasing" in Fig. 11).
    """
    success, failure = cast(reading, "success"), cast(reading, "failure")
    ratio = success.reach(10.0, 14.0) / failure.reach(10.0, 14.0)
    peaks = reach_table(failure)
    note = (
        f"{success.reach(10.0, 14.0):.2f} m against {failure.reach(10.0, 14.0):.2f} m; "
        f"the failure peaks at {peaks.max():.2f} m and ends at {peaks[-1]:.2f} m"
    )
    return Claim(
        "C2", "rest 0.53 s succeeds, 0.34 s fails: ratio of reach in 10-14 s", reading, ratio, REACH_RATIO, note
    )


def straight_phase(reading: Reading) -> Claim:
    """C3: theta(t) of (11) is a straight line for the success; R^2 of the linear fit from 2 s on.

    Notes the failure's R^2 too and whether it would pass: then straightness does not tell a success from a failure.
    """
    straightness, slope, off = straight_fit(cast(reading, "success"))
    failure = straight_fit(cast(reading, "failure"))[0]
    rate = 1.0 / cast(reading, "success").spiral.c
    tells = "below the threshold" if failure < STRAIGHTNESS else "would pass too: this does not tell the two apart"
    note = (
        f"the failure's R^2, for information: {failure:.4f}, {tells}; "
        f"slope {slope:.3f} rad/s, 1/c = {rate:.3f} rad/s; rms off the line {off:.2f} rad"
    )
    return Claim("C3", "theta(t) is straight from 2 s on: R^2", reading, straightness, STRAIGHTNESS, note)


def straight_fit(subject: Cast) -> tuple[float, float, float]:
    """Return R^2, slope (rad/s) and rms residual (rad) of the straight line fitted to theta from 2 s on."""
    late = subject.t >= SETTLED
    t, theta = subject.t[late], subject.spiral.theta[late]
    slope, offset = np.polyfit(t, theta, 1)
    residual = theta - (slope * t + offset)
    return float(1.0 - residual.var() / theta.var()), float(slope), float(residual.std())


def steady_step_phase(reading: Reading) -> Claim:
    """C4: r rises step-wise, at the same phase of the arm's half cycle each time.

    Measured: the concentration (mean resultant length) of the phases at which dr/dt is greatest, one for each half
    cycle that begins before r has reached 90 % of its greatest value. Where the tip cracks like a whip r shows a spike
    of some milliseconds; that value is therefore taken from the running median of r over one half cycle, while the
    rise itself is taken from r as it is.
    """
    subject = cast(reading, "success")
    rises = rise_phases(subject)
    centre = float(np.angle(np.exp(2j * np.pi * rises).mean()) / (2.0 * np.pi) % 1.0)
    doing = "rests" if centre * subject.period > T_MOVE else "moves"
    listed = ", ".join(f"{phase:.2f}" for phase in rises)
    note = f"mean phase {centre:.2f}, when the arm {doing}; by half cycle: {listed}"
    statement = "r rises fastest at one phase of the arm's half cycle: concentration"
    return Claim("C4", statement, reading, concentration(rises), CONCENTRATION, note)


def concentration(phases: Array) -> float:
    """Return the mean resultant length of phases (k,) in [0, 1): 1 if all are the same, near 0 if they are spread."""
    return float(np.abs(np.exp(2j * np.pi * phases).mean()))


def rise_phases(subject: Cast) -> Array:
    """Return the phase in [0, 1) at which r rises fastest in each half cycle until the rope is nearly pumped up."""
    rise = np.gradient(subject.spiral.r, subject.t)
    phases = []
    for start in np.arange(0.0, _pumped_up(subject), subject.period):
        within = np.flatnonzero((subject.t >= start) & (subject.t < start + subject.period))
        phases.append((subject.t[within[np.argmax(rise[within])]] - start) / subject.period)
    return np.array(phases)


def _pumped_up(subject: Cast) -> float:
    """Time at which the running median of r, over one half cycle, reaches 90 % of its greatest value, s."""
    from scipy.ndimage import median_filter

    t = subject.t
    size = 2 * round(0.5 * subject.period / (t[1] - t[0])) + 1
    level = median_filter(subject.spiral.r, size=size, mode="nearest")
    return float(t[np.argmax(level >= NEARLY_FULL * level.max())])


def claims() -> list[Claim]:
    """Measure C1 to C4 in the four readings."""
    return [
        measure(reading)
        for measure in (linearized, success_over_failure, straight_phase, steady_step_phase)
        for reading in READINGS
    ]
