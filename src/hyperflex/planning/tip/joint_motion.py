"""Places of all joints in a run, and their derivatives by the parameters of the strokes."""

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Rope
from hyperflex.simulation import Sensitivities


class JointMotion:
    """Places (T, n + 1, 2), m, of a rope's joints and tip in a run with derivatives by P parameters.

    The second last parameter is a factor of the rope's length, as of :func:`swing_derivatives`.
    """

    def __init__(self, rope: Rope, run: Sensitivities) -> None:
        self.run = run
        self.ways = rope.length[:, None] * np.stack([np.sin(run.q), -np.cos(run.q)], axis=-1)
        back = np.cumsum(self.ways[:, ::-1], axis=1)[:, ::-1]
        self.places = np.concatenate([run.tip[:, None] - back, run.tip[:, None]], axis=1)

    def changes(self, row: int) -> Array:
        """Return the derivatives (n + 1, 2, P) of the places at a row."""
        way, dq = self.ways[row], self.run.dq[row]
        moved = np.stack([-way[:, 1], way[:, 0]], axis=-1)[:, :, None] * dq[:, None]
        moved[..., -2] += way  # by a factor of the length
        after = np.cumsum(moved[::-1], axis=0)[::-1]
        dtip = self.run.dtip[row]
        return np.concatenate([dtip - after, dtip[None]])

    def between(self, row: int, part: float, later: Array, step: float) -> tuple[Array, Array]:
        """Return places (n + 1, 2) and derivatives (n + 1, 2, P) at an instant `part` of a `step`, s, after a row.

        `later` (P,) are the derivatives of the instant. The rows beside are a step apart.
        """
        speed = (self.places[row + 1] - self.places[row - 1]) / (2.0 * step)
        slope = 0.5 * (self.changes(row + 1) - self.changes(row - 1))
        change = self.changes(row) + part * slope + speed[..., None] * later
        return self.places[row] + part * step * speed, change
