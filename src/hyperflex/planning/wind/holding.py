"""What a wound rope holds: measured by a tug, beside what Capstan's rule gives for its tail."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hyperflex import winding
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.model import Peg
from hyperflex.planning.wind.outcome import SLIP, Cast
from hyperflex.trajectory import Trajectory
from hyperflex.winding import Tug


@dataclass(frozen=True, eq=False)
class Holding:
    """A wound rope that is pulled at.

    Attributes
    ----------
    tug : Tug
        The simulated pull from where the run ended.
    tail : float
        Weight of what hangs beyond the peg, N.
    angle : float
        About the peg from the first to the last link that lies on it, rad, >= 0.
    mu : float
        Friction between rope and peg.
    """

    tug: Tug
    tail: float
    angle: float
    mu: float

    @property
    def force(self) -> float:
        """Pull that the rope bore before it had slipped, N; a lower bound where it did not slip."""
        return self.tug.hold

    @property
    def rule(self) -> float:
        """Capstan's rule for a rope without weight on the peg: the tail's weight times e^(mu angle), N."""
        return float(self.tail * np.exp(self.mu * self.angle))


def holding(run: Trajectory, peg: Peg) -> Holding | None:
    """Tug at the rope from where a run ended; None where it is not on the peg or the pull cannot be simulated.

    Parameters
    ----------
    run : Trajectory
        Simulated with this peg.
    peg : Peg
    """
    wound = winding.wound(run, peg)
    if not np.isfinite(wound.tail[-1]):
        return None
    try:
        pulled = winding.tug(run, peg)
    except (InvalidInput, SimulationError):
        return None
    return Holding(tug=pulled, tail=float(wound.tail[-1]), angle=abs(float(wound.arc[-1])), mu=peg.mu)


def bearing(cast: Cast, peg: Peg, asked: float) -> Cast:
    """Return a cast, which has failed where a tug tells that the wound rope bears less than is asked.

    Parameters
    ----------
    cast : Cast
    peg : Peg
    asked : float
        Pull, N; where it is 0 nothing is asked.
    """
    if asked <= 0.0 or not cast.success or cast.run is None:
        return cast
    held = holding(cast.run, peg)
    if held is None:
        return replace(cast, held=False, reason="what it bears could not be simulated")
    if held.tug.holds(asked):
        return cast
    bears = f"it bears {held.force:.3g} N" if held.tug.slipped else f"it was pulled with {held.force:.3g} N at most"
    return replace(cast, held=False, reason=f"{bears}, and {asked:.3g} N are asked")


def tug_wound(cast: Cast | None, peg: Peg) -> Holding | None:
    """Tug at the rope of a verified cast; None unless it is wound and does not slip off by itself.

    Parameters
    ----------
    cast : Cast or None
    peg : Peg
        The target.
    """
    if cast is None or cast.run is None or not cast.wound or not cast.slipped < SLIP:
        return None
    return holding(cast.run, peg)
