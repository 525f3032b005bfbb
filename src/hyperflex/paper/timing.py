"""Timing control by the tip's phase (paper section IV.B, Fig. 13): runs, numbers and claim C5."""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import CrossingRule, Spiral, SwingModel, TrueState, run_closed_loop, spiral
from hyperflex.paper.casting import READINGS, T_MOVE, TABLE_RATE, TIME_CONSTANT, Reading, cable, casting_arm
from hyperflex.paper.results import Claim, Table
from hyperflex.simulation import simulate

LEADS = (0.0, 0.10, 0.20, 0.30)  # s, t_b: how long before the tip crosses x = 0 the arm starts
DURATION = 20.0  # s
WINDOW = 2.5  # s, over which the median of r is taken
RATE = 200  # samples per second
TOL = 1e-6  # m


@dataclass(frozen=True, eq=False)
class TimedCast:
    """The tip in one run of the paper's timing control."""

    reading: Reading
    lead: float  # t_b, s
    starts: Array  # (k,) of each half turn of the arm, s
    spiral: Spiral  # coordinates of the tip with c = 0.40 s

    @property
    def intervals(self) -> Array:
        """Start and end of each half turn (k, 2), s."""
        return np.stack([self.starts, self.starts + T_MOVE], axis=1)

    @property
    def levels(self) -> Array:
        """Median of r in each 2.5 s, m: whip spikes of some milliseconds do not count."""
        edges = np.arange(0.0, DURATION + 0.5 * WINDOW, WINDOW)
        t, r = self.spiral.t, self.spiral.r
        return np.array([np.median(r[(t >= a) & (t < b)]) for a, b in pairwise(edges)])


@cache
def timed(reading: Reading, lead: float) -> TimedCast:
    """Return a run of the paper's timing control; the same one is simulated only once in a process.

    The crossing, `lead` (t_b, s) before which the arm starts, is predicted exactly, by the model that is simulated.
    """
    rope, arm = cable(reading.friction), casting_arm()
    caster = SwingModel(rope, arm, T_MOVE, path=reading.path)
    swung = run_closed_loop(TrueState(rope, arm, tol=TOL), CrossingRule(caster, lead), caster, duration=DURATION)
    t = np.linspace(0.0, DURATION, round(DURATION * RATE) + 1)
    run = simulate(rope, swung.motion, arm=arm, duration=DURATION, t_eval=t, tol=TOL)
    return TimedCast(
        reading, lead, swung.starts, spiral(t, run.tip[:, 0], run.tip_velocity[:, 0], TIME_CONSTANT["success"])
    )


def fig13() -> Table:
    """Phase portrait of the tip under the timing control (Fig. 13); ``moving`` is 1 while the arm moves."""
    columns = {}
    step = RATE // TABLE_RATE
    for reading in READINGS:
        for lead in LEADS:
            subject = timed(reading, lead)
            name, t = f"{reading.key}_{100 * lead:.0f}", subject.spiral.t[::step]
            columns[f"x_{name}"] = subject.spiral.x[::step]
            columns[f"cxd_{name}"] = subject.spiral.scaled_velocity[::step]
            columns[f"r_{name}"] = subject.spiral.r[::step]
            begins = subject.starts[np.maximum(np.searchsorted(subject.starts, t, side="right") - 1, 0)]
            columns[f"moving_{name}"] = (t - begins < T_MOVE).astype(np.float64)
    notes = {
        "title": "tip under the timing control",
        "source": "simulated",
        "units": "t in s; x, cxd (c times the velocity) and r in m; the last number of a name is t_b in 0.01 s",
        "parameters": f"t_a = {T_MOVE} s, c = {TIME_CONSTANT['success']} s",
    }
    return Table("fig13", "tip under the timing control", {"t": t, **columns}, notes)


def largest_in_the_end(reading: Reading) -> Claim:
    """C5: of the paper's four t_b, 0 ends with the largest r.

    Measured: the median of r in the last 2.5 s for t_b = 0 over the greatest of the other three. Notes the order of
    the four in the first window, halfway and in the end, and how often 0.20 s leads on the way, as in the paper.
    """
    levels = {lead: timed(reading, lead).levels for lead in LEADS}
    ratio = levels[0.0][-1] / max(levels[lead][-1] for lead in LEADS[1:])
    half = len(levels[0.0]) // 2 - 1
    first, middle, last = (_order(levels, k) for k in (0, half, -1))
    leading = [max(LEADS, key=lambda lead, k=k: levels[lead][k]) for k in range(len(levels[0.0]))]  # type: ignore[misc]
    ahead = sum(lead == 0.2 for lead in leading[:-1])
    note = (
        f"r by t_b, first window: {first}; {WINDOW * half:g}-{WINDOW * (half + 1):g} s: {middle}; end: {last}; "
        f"0.20 s leads in {ahead} of {len(leading) - 1} windows on the way"
    )
    return Claim("C5", "t_b = 0 ends with the largest r: over the next largest", reading, ratio, 1.0, note)


def _order(levels: dict[float, Array], k: int) -> str:
    ordered = sorted(LEADS, key=lambda lead: -levels[lead][k])
    return ", ".join(f"{lead:.1f} ({levels[lead][k]:.2f} m)" for lead in ordered)


def timing_claims() -> list[Claim]:
    """Measure C5 in the four readings."""
    return [largest_in_the_end(reading) for reading in READINGS]
