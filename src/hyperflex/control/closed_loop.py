"""Closed loop of half turns: at each rest of the arm the rule gets the rope's state and returns the next start."""

import math
from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control.swing_model import SwingModel
from hyperflex.control.timing import Rule
from hyperflex.interfaces import StateSource
from hyperflex.interruption import interruptible
from hyperflex.motion import Motion


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """Half turns of a closed loop: the `starts` (k,), s, the motion of the arm, and the number of calls of the rule."""

    starts: Array
    motion: Motion
    decisions: int


@interruptible()
def run_closed_loop(
    source: StateSource, rule: Rule, model: SwingModel, *, duration: float, recheck_time: float = math.inf
) -> ClosedLoopRun:
    """Swing a rope that hangs at rest; the rule determines the start of each half turn.

    Parameters
    ----------
    source : StateSource
    rule : Rule
    model : SwingModel
        Its half turns are made. The first one starts at t = 0.
    duration : float
        No half turn starts at or after this, s.
    recheck_time : float
        A start that is later than this, s, is decided again after this time, from a new state. By default the first
        decision at each rest is final.

    Raises
    ------
    InvalidInput
        A duration or time that is not positive.
    SimulationError
        A prediction failed.

    Examples
    --------
    >>> import hyperflex as hf
    >>> from hyperflex.control import CrossingRule, SwingModel, TrueState, run_closed_loop
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> model = SwingModel(cable, hf.Arm())
    >>> swung = run_closed_loop(TrueState(cable, hf.Arm()), CrossingRule(model, 0.0), model, duration=3.0)
    >>> [round(float(start), 2) for start in swung.starts]
    [0.0, 1.03, 1.78, 2.99]
    """
    end = checks.number("duration", duration, sign="positive", unit="s")
    pause = checks.number("recheck_time", recheck_time, sign="positive", unit="s", infinite=True)
    starts = [0.0]
    decisions = 0
    while True:
        motion = model.motion(starts)
        now = starts[-1] + model.t_move
        start = now
        while now < end:
            start = rule.next_start(source.state(now, motion), len(starts))
            decisions += 1
            if start - now <= pause:
                break
            now += pause
        if now >= end or start >= end:
            return ClosedLoopRun(np.array(starts), motion, decisions)
        starts.append(start)
