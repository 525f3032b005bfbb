"""The paper's timing control: each half turn starts a given time before the tip crosses x = 0."""

from __future__ import annotations

import math
from typing import Protocol

from hyperflex import checks
from hyperflex.control.caster import Caster
from hyperflex.control.state_source import RopeState


class Rule(Protocol):
    """Decides when the arm moves next."""

    def next_start(self, now: RopeState, made: int) -> float:
        """Return when the next half turn shall start, s, not before now; inf: not at all.

        Parameters
        ----------
        now : RopeState
            Where the rope is; the arm rests.
        made : int
            Half turns made so far.
        """


class CrossingRule:
    """The paper's timing rule: start `lead` before the tip crosses x = 0, the crossing predicted with the arm at rest.

    Parameters
    ----------
    caster : Caster
        The model that predicts.
    lead : float
        t_b of the paper, s; negative: that long after the crossing (one that happens while the arm still moves is not
        seen then).

    Notes
    -----
    Paper section IV.B and Fig. 13. What the paper leaves open is read like this: the crossing is the next one, in
    either sense, after the arm has come to rest, and where it is nearer than `lead` the arm starts at once.
    """

    def __init__(self, caster: Caster, lead: float = 0.0) -> None:
        self.caster = caster
        self.lead = checks.number("lead", lead, unit="s")

    def next_start(self, now: RopeState, made: int) -> float:
        """Return when the next half turn shall start, s; now, if the tip does not cross within a period."""
        crossing = self.caster.next_crossing(now, made)
        return now.t if math.isinf(crossing) else max(now.t, crossing - self.lead)
