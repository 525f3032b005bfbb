"""Events that end a run where they happen, as in ``until=tip_crosses((0.0, 0.0), (1.0, 0.0))``."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.core.integrate.events import ANGLE, CROSSES, PEAK, PHASE, Until
from hyperflex.errors import InvalidInput
from hyperflex.model import Setup


@dataclass(frozen=True)
class Event:
    """Event that ends a run; made by :func:`tip_crosses`, :func:`tip_speed_peak` and similar functions.

    Parameters
    ----------
    name : str
        Name of the event in the trajectory.
    kind : int
        As in the kernels.
    numbers : (4,) tuple of float
        Point and direction, phase and time constant, or angle and link.
    sense : int
        1 or -1: direction of the crossing; 0: either.
    after : float
        Time before which the event is ignored, s.
    """

    name: str
    kind: int
    numbers: tuple[float, float, float, float]
    sense: int = 0
    after: float = -math.inf

    def packed(self, setup: Setup) -> Until:
        """Return the event as the kernels take it, for the chain of `setup`."""
        a, b, c, d = self.numbers
        if self.kind == ANGLE:
            n = setup.rope.n_links
            if b >= n or (b < 0 and setup.arm is None):
                raise InvalidInput(
                    "angle_reached names a link that is not there",
                    got=int(b) if b >= 0 else "arm",
                    allowed=f"0 to {n - 1}",
                )
            b += 1.0 if setup.torque_driven else 0.0  # the arm is link 0 of a chain that a torque drives
        return Until(self.kind, a, b, c, d, float(self.sense), self.after)


def tip_crosses(point: ArrayLike, direction: ArrayLike, *, sense: int = 1, after: float = -math.inf) -> Event:
    """End a run when the tip crosses a straight line.

    Parameters
    ----------
    point : (2,) array_like
        A point of the line, m.
    direction : (2,) array_like
        Perpendicular to the line; the length does not matter. ``(1, 0)`` crosses a vertical line towards +x.
    sense : {1, -1, 0}
        With the direction, against it, or either way.
    after : float
        Crossings before this time do not count, s.

    Examples
    --------
    >>> import hyperflex as hf
    >>> rod = hf.Rope(length=[1.0], mass=[0.1])
    >>> run = hf.simulate(rod, duration=5.0, q0=[-0.5], until=hf.tip_crosses((0.0, 0.0), (1.0, 0.0)))
    >>> run.event[0], bool(abs(run.tip[-1, 0]) < 1e-9)
    ('tip crosses', True)
    """
    x, y = checks.array("point", point, (2,), unit="m")
    dx, dy = checks.array("direction", direction, (2,))
    size = math.hypot(dx, dy)
    if size == 0.0:
        raise InvalidInput("direction has no length", got=[dx, dy], allowed="a vector at right angles to the line")
    return _event("tip crosses", CROSSES, (x, y, dx / size, dy / size), sense, after)


def tip_speed_peak(*, after: float = -math.inf) -> Event:
    """End a run at a peak of the tip's speed.

    Parameters
    ----------
    after : float
        Peaks before this time do not count, s.

    Notes
    -----
    A peak may be a corner: where the arm's acceleration jumps, or a joint sticks.
    """
    return _event("tip speed peak", PEAK, (), 1, after)


def phase_reached(phase: float, c: float, *, after: float = -math.inf) -> Event:
    """End a run when the swing of the tip reaches a phase.

    Parameters
    ----------
    phase : float
        rad, modulo a turn: the angle of the point (c dx/dt, x) with x the tip's horizontal position. At 0 the tip
        passes x = 0 towards +x, at pi/2 it is farthest out at +x, at pi it comes back through x = 0.
    c : float
        Time constant, s, > 0: one over the angular frequency of the swing, for a rope swung in step with the arm
        (t_move + t_rest) / pi (the paper's (10) and (11); :func:`hyperflex.control.spiral` has the whole course).
    after : float
        Phases reached before this time do not count, s.

    Notes
    -----
    The phase must be passed in the direction of increasing phase.
    """
    angle, scale = checks.number("phase", phase, unit="rad"), checks.number("c", c, sign="positive", unit="s")
    return _event("phase reached", PHASE, (angle, scale), 1, after)


def angle_reached(angle: float, link: int | None = None, *, sense: int = 0, after: float = -math.inf) -> Event:
    """End a run when a link, or the arm, reaches an absolute angle.

    Parameters
    ----------
    angle : float
        rad, not wrapped.
    link : int, optional
        Number of the link, 0 nearest the motor; None: the arm.
    sense : {0, 1, -1}
        Either way, turning towards larger angles, or towards smaller ones.
    after : float
        What happens before this time does not count, s.
    """
    number = -1 if link is None else checks.count("link", link, least=0, most=10**6)
    return _event("angle reached", ANGLE, (checks.number("angle", angle, unit="rad"), number), sense, after)


def _event(name: str, kind: int, numbers: tuple[float, ...], sense: int, after: float) -> Event:
    if not isinstance(sense, (int, float, np.number)) or sense not in (-1, 0, 1):
        allowed = "either sense: 0; only with the direction: 1; only against it: -1"
        raise InvalidInput("sense is not a sense", got=sense, allowed=allowed)
    ever = isinstance(after, float) and after == -math.inf
    start = -math.inf if ever else checks.number("after", after, unit="s")
    a, b, c, d = (float(each) for each in (*numbers, 0.0, 0.0, 0.0, 0.0)[:4])
    return Event(name, kind, (a, b, c, d), int(sense), start)
