"""The loop: look at the rope whenever the arm rests, ask a rule, move."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control.caster import Caster
from hyperflex.control.timing import Rule
from hyperflex.interfaces import StateSource
from hyperflex.motion import Motion


@dataclass(frozen=True, eq=False)
class Swung:
    """What a closed loop made the arm do.

    Attributes
    ----------
    starts : (k,) float64
        When each half turn started, s.
    motion : Motion
        The arm's motion.
    asked : int
        How often the rule was asked.
    """

    starts: Array
    motion: Motion
    asked: int


def swing(source: StateSource, rule: Rule, caster: Caster, *, duration: float, look_again: float = math.inf) -> Swung:
    """Swing a rope that hangs at rest, each half turn when the rule says.

    Parameters
    ----------
    source : StateSource
        Tells the rope's state.
    rule : Rule
        Decides.
    caster : Caster
        Arm and half turns. The first one starts at t = 0.
    duration : float
        No half turn starts at or after this, s.
    look_again : float
        A start that is farther off than this, s, is decided anew after this time, from a fresh state. By default what
        was decided when the arm came to rest stands.

    Returns
    -------
    Swung

    Raises
    ------
    InvalidInput
        A duration or time that is not positive.
    SimulationError
        A prediction failed.

    Examples
    --------
    >>> import hyperflex as hf
    >>> from hyperflex.control import Caster, CrossingRule, TrueState, swing
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> caster = Caster(cable, hf.Arm())
    >>> swung = swing(TrueState(cable, hf.Arm()), CrossingRule(caster, 0.0), caster, duration=3.0)
    >>> [round(float(start), 2) for start in swung.starts]
    [0.0, 1.03, 1.78, 2.99]
    """
    end = checks.number("duration", duration, sign="positive", unit="s")
    pause = checks.number("look_again", look_again, sign="positive", unit="s", infinite=True)
    starts = [0.0]
    asked = 0
    while True:
        motion = caster.motion(starts)
        now = starts[-1] + caster.t_move
        start = now
        while now < end:
            start = rule.next_start(source.state(now, motion), len(starts))
            asked += 1
            if start - now <= pause:
                break
            now += pause
        if now >= end or start >= end:
            return Swung(np.array(starts), motion, asked)
        starts.append(start)
