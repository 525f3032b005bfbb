"""Rope, arm and half turns as a controller knows them, and what it can foresee with them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, Profile, strokes
from hyperflex.simulation import simulate, simulate_batch, tip_crosses
from hyperflex.trajectory import State

SAMPLE_TIME = 0.02  # s, between looks at the tip in a foreseen swing
PLANNING_TOL = 1e-4  # m; docs/how-to/accuracy.md
SOON = 1e-6  # s, within which a crossing that has just been is not found again


def swing_period(rope: Rope) -> float:
    """Return the period of a small swing of a whole rope as if it were a rigid rod, s; a rope's own is 2 % longer.

    Parameters
    ----------
    rope : Rope

    Raises
    ------
    InvalidInput
        If the rope has no weight.
    """
    base = np.concatenate([[0.0], np.cumsum(rope.length)[:-1]])
    centre = base + rope.com
    moment = float((rope.inertia + rope.mass * centre**2).sum() + rope.tip_mass * rope.total_length**2)
    first = float((rope.mass * centre).sum() + rope.tip_mass * rope.total_length)
    weight = first * math.hypot(*rope.gravity)
    if weight == 0.0:
        raise InvalidInput("rope has no weight, so it does not swing", got=rope.gravity, allowed="gravity")
    return 2.0 * math.pi * math.sqrt(moment / weight)


@dataclass(frozen=True)
class Caster:
    """A rope on an arm that makes half turns, as its controller knows it; the true one may differ.

    Parameters
    ----------
    rope, arm : Rope, Arm
        The model.
    t_move : float
        Time of a half turn, s.
    profile : {"bang-bang", "ramp", "minimum-jerk"}
        How the arm moves in it.
    path : {"under", "over"}
        Through the bottom or over the top.
    """

    rope: Rope
    arm: Arm
    t_move: float = 0.73
    profile: Profile = "bang-bang"
    path: Literal["under", "over"] = "under"

    def motion(self, starts: npt.ArrayLike, made: int = 0) -> Motion:
        """Return half turns that start at `starts` (k,), s, after `made` earlier ones."""
        return strokes(starts, self.t_move, self.profile, self.path, made=made)

    @property
    def period(self) -> float:
        """Period of a small swing of the rope, s; see :func:`swing_period`."""
        return swing_period(self.rope)

    @property
    def usual_rest(self) -> float:
        """Rest with which half turns keep step with a swing that has grown a little, s."""
        return max(0.0, 0.54 * self.period - self.t_move)

    def next_crossing(self, now: RopeState, made: int, *, within: float | None = None) -> float:
        """Return when the tip next passes below or above the shaft if the arm rests, s; inf if it does not.

        Parameters
        ----------
        now : RopeState
            Where the rope is; the arm rests.
        made : int
            Half turns made so far: they tell where.
        within : float, optional
            How far to look ahead, s; one period if not given.
        """
        ahead = self.period if within is None else within
        return self.crossing(now, self.motion([], made), after=now.t + SOON, until=now.t + ahead)

    def crossing(self, now: RopeState, motion: Motion, *, after: float, until: float) -> float:
        """Return when the tip first passes below or above the shaft in a span of time, s; inf if it does not.

        Parameters
        ----------
        now : RopeState
            Where the rope is.
        motion : Motion
            What the arm does from then on; times as those of `now`.
        after, until : float
            The span, s; it ends after `now`.
        """
        run = simulate(
            self.rope,
            motion,
            arm=self.arm,
            duration=until - now.t,
            state=State(now.t, now.q, now.qd),
            t_eval=[now.t],
            until=tip_crosses((self.arm.pivot[0], 0.0), (1.0, 0.0), sense=0, after=max(after, now.t + SOON)),
        )
        return math.inf if run.event is None else run.event[1]

    def foresee(self, now: RopeState, made: int, rests: npt.ArrayLike, horizon: float) -> tuple[Array, Array]:
        """Return how far out the tip will be, with each of several sequences of rests before the next half turns.

        Parameters
        ----------
        now : RopeState
            Where the rope is; the arm rests.
        made : int
            Half turns made so far.
        rests : (m, k) array_like
            Rests, s, before each of the next k half turns. More follow after usual rests; those that would start after
            the horizon do not count.
        horizon : float
            How far to look ahead, s.

        Returns
        -------
        t : (T,) float64
            Time from now on, s.
        reach : (m, T) float64
            ``|x|`` of the tip from the shaft, m; 0 where the prediction failed.
        """
        ahead = checks.array("rests", rests, (-1, -1), sign="nonnegative", unit="s")
        more = max(0, math.ceil(horizon / self.t_move) - ahead.shape[1])
        ahead = np.concatenate([ahead, np.full((len(ahead), more), self.usual_rest)], axis=1)
        first = np.cumsum(ahead + self.t_move, axis=1) - self.t_move
        motions = [self.motion(row[row < horizon], made) for row in first]
        t: Array = SAMPLE_TIME * np.arange(1.0, max(2, round(horizon / SAMPLE_TIME)) + 1.0)
        batch = simulate_batch(
            self.rope,
            motions,
            arm=self.arm,
            duration=float(t[-1]),
            q0=now.q,
            qd0=now.qd,
            t_eval=t,
            tol=PLANNING_TOL,
        )
        return t, np.nan_to_num(np.abs(batch.tip[:, :, 0] - self.arm.pivot[0]))
