"""The controller's model of rope, arm and half turns, and its predictions."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import mass_matrix
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, Profile, arm_strokes
from hyperflex.simulation import first_moment, simulate, simulate_batch, tip_crosses
from hyperflex.trajectory import State

SAMPLE_TIME = 0.02  # s, of predictions
SOON = 1e-6  # s after now within which a crossing is not looked for: it may be the last one


@dataclass(frozen=True)
class SwingModel:
    """A controller's model of a rope on an arm that makes half turns; the true rope may differ.

    A half turn takes `t_move`, s; `profile` and `path` are as of :func:`hyperflex.arm_swings`.
    """

    rope: Rope
    arm: Arm
    t_move: float = 0.73
    profile: Profile = "bang-bang"
    path: Literal["under", "over"] = "under"

    def motion(self, starts: ArrayLike, made: int = 0) -> Motion:
        """Return half turns that start at `starts` (k,), s, after `made` earlier ones."""
        return arm_strokes(starts, self.t_move, self.profile, self.path, made=made)

    @property
    def period(self) -> float:
        """Period of a small swing of the rope, s; see :func:`swing_period`."""
        return swing_period(self.rope)

    @property
    def usual_rest(self) -> float:
        """Rest that keeps half turns in step with a swing of moderate amplitude, s."""
        return max(0.0, 0.54 * self.period - self.t_move)

    def crossing(self, now: RopeState, motion: Motion, *, after: float, until: float) -> float:
        """Return the time at which the tip first passes below or above the shaft in a span, s; inf if it does not.

        `motion` is the arm's, on the clock of `now`; the span from `after` to `until`, s, ends after `now`.
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

    def predict(self, now: RopeState, made: int, rests: ArrayLike, horizon: float) -> tuple[Array, Array]:
        """Predict the tip's distance from the shaft for several sequences of rests before the next half turns.

        Parameters
        ----------
        now : RopeState
            The arm rests.
        made : int
            Half turns made so far.
        rests : (m, k) array_like
            Rests, s, before each of the next k half turns. More half turns follow after usual rests, as far as they
            start before the horizon.
        horizon : float
            Time to look ahead, s.

        Returns
        -------
        t : (T,) float64
            Time from now on, s.
        amplitude : (m, T) float64
            ``|x|`` of the tip from the shaft, m; 0 if the simulation failed.
        """
        ahead = checks.array("rests", rests, (-1, -1), sign="nonnegative", unit="s")
        more = max(0, math.ceil(horizon / self.t_move) - ahead.shape[1])
        ahead = np.pad(ahead, ((0, 0), (0, more)), constant_values=self.usual_rest)
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
            tol=1e-4,  # m, enough to compare motions: docs/how-to/accuracy.md
        )
        return t, np.nan_to_num(np.abs(batch.tip[:, :, 0] - self.arm.pivot[0]))


def swing_period(rope: Rope) -> float:
    """Return the period of a small swing of a rope as a rigid rod, s; that of the rope itself is 2 % longer.

    Raises InvalidInput if the rope has no weight.
    """
    chain, inertia = rope.chain(), np.zeros((rope.n_links, rope.n_links))
    mass_matrix(chain, np.zeros(rope.n_links), inertia)
    weight = float(first_moment(chain).sum()) * rope.g
    if weight == 0.0:
        raise InvalidInput("rope has no weight, so it does not swing", got=rope.gravity, allowed="gravity")
    return 2.0 * math.pi * math.sqrt(float(inertia.sum()) / weight)


def arrival_time(t: Array, amplitude: Array, target: float) -> Array:
    """Return the time (m,), s, at which an amplitude `target`, m, is first reached in each of m runs; inf if never.

    `amplitude` (m, T) is ``|x|`` of the tip, m, at times `t` (T,), s; the time is linear between samples.

    Examples
    --------
    >>> arrival_time(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.5, 1.5], [0.0, 0.1, 0.2]]), 1.0)
    array([1.5, inf])
    """
    beyond = amplitude >= target
    k = beyond.argmax(axis=1)
    rows = np.arange(len(amplitude))
    before = np.maximum(k - 1, 0)
    rise = amplitude[rows, k] - amplitude[rows, before]
    part = np.where((k > 0) & (rise > 0.0), (target - amplitude[rows, before]) / np.where(rise > 0.0, rise, 1.0), 1.0)
    return np.where(beyond.any(axis=1), t[before] + part * (t[k] - t[before]), np.inf)
