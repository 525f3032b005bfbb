"""Strikes of swings that were simulated with shorter links, from which throws in contact go on.

Coarse links alone strike otherwise where a weight hangs from the rope: of throws of such a rope that wound from coarse
strikes half did so with shorter links, of those that wind from these nine of ten.
"""

from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Peg, Rope, Setup
from hyperflex.planning.problem import Problem
from hyperflex.planning.search.strikes import Strikes
from hyperflex.planning.throw import LAST, Throw
from hyperflex.simulation import check_limits, check_outside

SHORT = 0.2  # of a link's length; a place that is nearer to its first joint tells it no direction


class KnownStrikes:
    """Strikes of a rope with shorter links, of those of `finer`, by the side and the strokes of their throws."""

    def __init__(self, finer: Problem, peg: Peg) -> None:
        self.finer, self.peg = finer, peg
        self._struck: dict[tuple[int, bytes], Strikes] = {}

    def add(self, side: int, x: Array, struck: Strikes) -> None:
        """Keep the strike of a throw's point x (2 k + 4,), whatever its last move."""
        self._struck[strokes_of(side, x)] = struck

    def find(self, side: int, x: Array, t: float) -> Strikes | None:
        """Return the strike of a throw with shorter links, if it is at time t, s."""
        known = self._struck.get(strokes_of(side, x))
        return known if known is not None and known.t[0] == t else None

    def on_links(self, problem: Problem, side: int, x: Array, throw: Throw) -> Strikes | None:
        """Return the strike of a throw on other links, those of `problem`; None if it is not known.

        Nor is one given in which these reach into the target or an obstacle, or joints are past their limits.
        """
        known = self._struck.get(strokes_of(side, x))
        if known is None:
            return None
        moved = moved_to(known, self.finer.rope, problem.rope)
        motion = throw.cut(problem.time, problem.limits).motion(problem.limits)
        setup = Setup(problem.rope, motion, problem.arm, pegs=problem.beside(self.peg))
        try:
            for check in (check_outside, check_limits):
                check(setup, float(moved.t[0]), moved.q[0])
        except InvalidInput:
            return None
        return moved


def strokes_of(side: int, x: Array) -> tuple[int, bytes]:
    """What tells a throw's swing from others: its point x (2 k + 4,) without the last move, and its side."""
    return side, x[:-LAST].tobytes()


def moved_to(strikes: Strikes, rope: Rope, other: Rope) -> Strikes:
    """Return strikes of a rope as those of the same rope with `other` links.

    Each link points from its own first joint to the place on the rope where it is to end, so that it stays beside it.
    Where that is too near to tell a direction, as where the rope is folded, it has that of the rope's link there.
    """
    if other.n_links == rope.n_links:
        return strikes
    ends, joints = (np.append(0.0, np.cumsum(each.length)) for each in (rope, other))
    middle = np.minimum(np.searchsorted(ends, 0.5 * (joints[1:] + joints[:-1]), side="right") - 1, rope.n_links - 1)
    along = np.stack([np.sin(strikes.q), -np.cos(strikes.q)])
    across = np.stack([np.cos(strikes.q), np.sin(strikes.q)]) * strikes.qd
    q, qd = np.empty((2, len(strikes.t), other.n_links))
    places, speeds = (
        np.apply_along_axis(lambda row: np.interp(joints, ends, np.append(0.0, row)), -1, part.cumsum(axis=-1))
        for part in (rope.length * along, rope.length * across)
    )
    place, speed = np.zeros((2, 2, len(strikes.t)))
    for i, length in enumerate(other.length):
        near, rate = strikes.q[:, middle[i]], strikes.qd[:, middle[i]]
        (x, y), (vx, vy) = places[..., i + 1] - place, speeds[..., i + 1] - speed
        square = x**2 + y**2
        straight = square > (SHORT * length) ** 2
        off = (np.arctan2(x, -y) - near + np.pi) % (2.0 * np.pi) - np.pi
        q[:, i] = near + np.where(straight, off, 0.0)
        qd[:, i] = np.where(straight, (x * vy - y * vx) / np.maximum(square, 1e-300), rate)
        sin, cos = np.sin(q[:, i]), np.cos(q[:, i])
        place = place + length * np.stack([sin, -cos])
        speed = speed + length * qd[:, i] * np.stack([cos, sin])
    return replace(strikes, q=q, qd=qd)
