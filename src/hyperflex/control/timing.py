"""The paper's timing control: each half turn starts a given time before the tip crosses x = 0."""

import math
from typing import Protocol

from hyperflex import checks
from hyperflex.control.state_source import hanging_state
from hyperflex.control.swing_model import SOON, SwingModel
from hyperflex.interfaces import RopeState


class Rule(Protocol):
    """A rule for the start of the next half turn."""

    def next_start(self, now: RopeState, made: int) -> float:
        """Return the start of the next half turn, s, not before `now`, after `made` half turns; inf for none.

        The arm rests.
        """


class CrossingRule:
    """The paper's timing rule: start `lead` before the tip crosses x = 0, the crossing predicted with the arm at rest.

    Parameters
    ----------
    model : SwingModel
        For the prediction.
    lead : float
        t_b of the paper, s; negative: that long after the crossing.

    Notes
    -----
    Paper section IV.B and Fig. 13. What the paper leaves open is read like this: the crossing is the next one, in
    either sense, after the arm has come to rest, and where it is nearer than `lead` the arm starts at once. With a
    negative `lead`, which the paper does not try, a crossing no longer ago than that counts too: it happens while the
    arm still moves, and is predicted when that half turn is decided.
    """

    def __init__(self, model: SwingModel, lead: float = 0.0) -> None:
        self.model = model
        self.lead = checks.number("lead", lead, unit="s")
        self._passed = (0, math.inf)  # half turns made, and the crossing that the last of them brings, s

    def next_start(self, now: RopeState, made: int) -> float:
        """Return the start of the next half turn, s; now if the tip does not cross within a period."""
        crossing = self._while_moving(now, made) if self.lead < 0.0 else math.inf
        if math.isinf(crossing):
            crossing = self.model.crossing(
                now, self.model.motion([], made), after=now.t + SOON, until=now.t + self.model.period
            )
        start = now.t if math.isinf(crossing) else max(now.t, crossing - self.lead)
        if self.lead < 0.0:
            self._passed = made + 1, self._passing(now, made, start)
        return start

    def _while_moving(self, now: RopeState, made: int) -> float:
        """Return the crossing that the last half turn brought late enough to count, s; inf if there was none."""
        count, crossing = self._passed
        if made == 1:  # the first half turn was made at t = 0, from rest, without a decision
            count, crossing = 1, self._passing(hanging_state(self.model.rope), 0, 0.0)
        return crossing if count == made and crossing >= now.t + self.lead else math.inf

    def _passing(self, now: RopeState, made: int, start: float) -> float:
        """Return when the tip passes in the last -`lead` seconds of a half turn that starts at `start`, s, or inf."""
        end = start + self.model.t_move
        return self.model.crossing(now, self.model.motion([start], made), after=end + self.lead, until=end)
