"""Observations of an environment: the whole state, or markers along the rope in two frames."""

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.envs.worlds import World

RATE = 10.0  # rad/s, the unit of rates in an observation: makes numbers of about 1
BOUND = 100.0  # to which observations are clipped, so that their space is bounded


class Sensing:
    """Observations of the members, one row each, float64 and finite.

    Parameters
    ----------
    observation : {"state", "markers"}
        ``"state"``: sine, cosine and rate of each link, then of the arm. ``"markers"``: sine, cosine and rate of the
        arm, then places x, y of the markers from the shaft, m, now, and an interval before. Rates are in units of
        10 rad/s.
    markers : int
        Number of markers, the last one on the tip and the others evenly before it, each on a joint.
    n_links : int
        Of the rope.
    extra : int
        Further numbers, which the environment adds.
    """

    def __init__(self, observation: str, markers: int, n_links: int, extra: int) -> None:
        self.kind = checks.choice("observation", observation, ("state", "markers"))
        count = checks.count("markers", markers, most=n_links)
        self._joints = np.round(np.linspace(0, n_links, count + 1)[1:]).astype(np.intp)
        size = 3 + (3 * n_links if self.kind == "state" else 4 * count)
        bound = np.full(size + extra, BOUND)
        self.space = spaces.Box(-bound, bound, dtype=np.float64)
        self._frames: tuple[Array, Array] | None = None  # of markers, now and an interval before

    def take_frame(self, world: World, places: Array) -> None:
        """Store a frame of all members, with `places` (M, n + 1, 2), m, one interval after the previous one."""
        if self._frames is not None:
            self._frames = self._frame(world, places), self._frames[0]

    def begin(self, world: World, places: Array, which: npt.NDArray[np.intp]) -> None:
        """Restart some members with `places` (M, n + 1, 2), m, as if they had been at rest before."""
        if self.kind == "markers":
            now = self._frame(world, places)
            if self._frames is None:
                self._frames = now, now.copy()
            for frame in self._frames:
                frame[which] = now[which]

    def observe(self, world: World, extra: Array | None) -> Array:
        """Return the observations (M, ...), with the numbers that the environment adds (M, extra)."""
        arm = [np.sin(world.arm_angle)[:, None], np.cos(world.arm_angle)[:, None], world.arm_rate[:, None] / RATE]
        if self._frames is None:
            parts = [np.sin(world.q), np.cos(world.q), world.qd / RATE, *arm]
        else:
            parts = [*arm, *self._frames]
        seen = np.concatenate(parts if extra is None else [*parts, extra], axis=1)
        return np.asarray(np.clip(np.nan_to_num(seen), -BOUND, BOUND))

    def _frame(self, world: World, places: Array) -> Array:
        return np.asarray((places[:, self._joints] - np.array(world.arm.pivot)).reshape(world.count, -1))
