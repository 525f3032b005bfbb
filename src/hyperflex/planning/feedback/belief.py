"""Which of the worlds that were drawn agree with what has been seen of the rope."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyperflex.interfaces import RopeState
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.feedback.matching import features
from hyperflex.planning.robust import scenarios as flights
from hyperflex.planning.robust.uncertainty import Draw
from hyperflex.planning.search import strikes
from hyperflex.planning.search.batch_rollout import Flights


class Belief:
    """Drawn worlds, each with how far it was off from what has been seen.

    Parameters
    ----------
    thrower : Thrower
        Hangs at rest at t = 0.
    draws : sequence of Draw

    Notes
    -----
    Each world predicts every state that is seen from the one seen before; mean squares of its errors (of the joints'
    places and velocities, :func:`hyperflex.planning.feedback.matching.features`) add up. Thus the rope's length and
    friction and the motor's lag show, as far as they matter. Of when a move began, all know only what was asked for.
    """

    def __init__(self, thrower: Thrower, draws: Sequence[Draw]) -> None:
        self.thrower, self.draws = thrower, list(draws)
        self.off = np.zeros(len(self.draws))
        n = thrower.rope.n_links
        self._last = RopeState(0.0, np.full(n, thrower.rope.hanging_angle), np.zeros(n))

    def see(self, state: RopeState, motion: Motion, *, threads: int | None = None) -> None:
        """Let each world predict a state that is seen, under a motion of moves that was asked for until then."""
        last, count = self._last, len(self.draws)
        if state.t <= last.t:
            return
        motions = [draw.punctual().executed(motion) for draw in self.draws]
        q, qd = (np.broadcast_to(part, (count, part.size)) for part in (last.q, last.qd))
        batch = Flights([draw.rope for draw in self.draws], [], [m.shifted(-last.t) for m in motions], q, qd, last.t)
        _, q, qd = flights.fly(batch, self.thrower.arm, state.t - last.t, at_end=True, threads=threads)
        t = np.array([state.t])
        for m, (draw, done) in enumerate(zip(self.draws, motions, strict=True)):
            base = strikes.arm_tip(self.thrower.arm, done, t), strikes.arm_tip_velocity(self.thrower.arm, done, t)
            seen = features(draw.rope, state.q[None], state.qd[None], *base)
            found = features(draw.rope, q[m, -1:], qd[m, -1:], *base)
            self.off[m] += float(np.nan_to_num(((found - seen) ** 2).sum(), nan=np.inf))
        self._last = state

    def worlds(self, count: int) -> list[Draw]:
        """Return the worlds that were least off, the best first."""
        return [self.draws[m] for m in np.argsort(self.off, kind="stable")[:count]]
