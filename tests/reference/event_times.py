"""Whether the time of an event is as accurate as the run that it ends: against the event of a tighter run.

An error e in a reading that changes at the rate s moves its event by e / s. The bounds of position and rate errors are
known (``judging``), so each kind of event has a bound, plus the accuracy LOCATED of its location.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

import hyperflex as hf
from hyperflex.model import Setup
from hyperflex.trajectory import Trajectory

Real = npt.NDArray[np.float64]

LOCATED = 1e-9  # s
SHARE = 0.02  # s, as in hyperflex.core.integrate.rollout
BLUNT = 5e-3  # s; an event that the promise leaves open by more than this is grazing, or beside the point
SOON = 0.3  # s; an event is chosen about here, where the promise is still sharp
PERIOD = 0.3  # s, time constant of the phases
NEAR = 1e-5  # s, for a slope by differences
KINDS = ("tip crosses", "phase reached", "angle reached")


class Timing(NamedTuple):
    """How an event came out."""

    event: str  # its name, "" without an event
    error: float  # s
    promise: float  # the same in units of what is promised


NONE = Timing("", math.nan, math.nan)


def timing(setup: Setup, tight: Setup, truth: Trajectory, promised: Real, horizon: float, number: int) -> Timing:
    """Let the run and the tighter one end at an event of kind `number`, chosen early in it.

    Parameters
    ----------
    setup, tight : Setup
        Of the run and of the tighter one, which may be shorter.
    truth : Trajectory
        The tighter one without event.
    promised : (T,) m, what the run may err in the place of any joint, at its samples up to the horizon
    horizon : s
    number : int
    """
    at = int(np.searchsorted(truth.t, min(SOON, 0.6 * horizon)))
    after = 0.5 * float(truth.t[at])
    name, link = KINDS[number % len(KINDS)], number % setup.rope.n_links
    velocity, place = truth.tip_velocity[at], truth.tip[at]
    if at == 0 or np.linalg.norm(velocity) == 0.0 or truth.qd[at, link] == 0.0:
        return NONE
    phase = math.atan2(place[0], PERIOD * velocity[0])
    until = {
        "tip crosses": hf.tip_crosses(place, velocity, after=after),
        "phase reached": hf.phase_reached(phase, PERIOD, after=after),
        "angle reached": hf.angle_reached(truth.q[at, link], link, sense=int(np.sign(truth.qd[at, link])), after=after),
    }[name]
    found, true = (hf.simulate(one, t_eval=[one.duration], until=until) for one in (setup, tight))
    if true.event is None or true.event[1] > horizon:
        return NONE
    across = velocity / np.linalg.norm(velocity)
    spread = {
        "tip crosses": lambda: 1.0 / abs(true.tip_velocity[-1] @ across),
        "phase reached": lambda: phase_spread(tight, true.event[1], phase),
        "angle reached": lambda: 2.0 / (setup.rope.length[link] * abs(true.qd[-1, link])),  # of two joints
    }[name]()
    allowed = LOCATED + float(np.interp(true.event[1], truth.t[: promised.size], promised) * spread)
    if allowed > BLUNT:
        return NONE
    error = abs(found.event[1] - true.event[1]) if found.event else math.inf
    return Timing(name, error, error / allowed)


def phase_spread(tight: Setup, at: float, phase: float) -> float:
    """Time, s, by which an error of a metre in the tip's place, and of that in SHARE in its rate, moves a phase."""
    speeds = hf.simulate(tight, duration=at, t_eval=[at - NEAR, at]).tip_velocity[:, 0]
    sin, cos = math.sin(phase), math.cos(phase)
    slope = speeds[1] * cos - PERIOD * (speeds[1] - speeds[0]) / NEAR * sin
    return float((abs(cos) + PERIOD * abs(sin) / SHARE) / abs(slope))
