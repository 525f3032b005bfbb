"""Swing: make the rope's tip swing as far to the sides as possible."""

from typing import Any

import numpy as np

from hyperflex.checks import Array, ByName, Flags, Indices
from hyperflex.envs.vector import RopeEnv, RopeVectorEnv
from hyperflex.envs.worlds import FreeWorld


class SwingVectorEnv(RopeVectorEnv):
    """:class:`SwingEnv` for many members at once, in SIMD lanes and on threads; the arguments are the same."""

    world_class = FreeWorld

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **arguments)
        self._amplitude = np.zeros(self.num_envs)

    def _start(self, which: Indices, places: Array) -> None:
        self._amplitude[which] = self._amplitudes(places)[which]

    def _amplitudes(self, places: Array) -> Array:
        """Return the tips' distance from the vertical through the shaft, as a part of the reach (M,)."""
        reach = self.arm.length + self.world.lengths.sum(axis=1)
        return np.asarray(np.abs(places[:, -1, 0] - self.arm.pivot[0]) / reach)

    def _score(self, places: Array) -> tuple[Array, Flags]:
        self._amplitude = self._amplitudes(places)
        return self._amplitude, np.zeros(self.num_envs, dtype=np.bool_)

    def _values(self) -> ByName:
        return {"amplitude": self._amplitude}


class SwingEnv(RopeEnv):
    """Swing-up of a rope by its arm.

    ## Description

    A rope of 2 m hangs from an arm of 105 mm that a motor turns: a chain of 20 links in the plane, as identified in
    experiments. The arm must pump the rope up until its tip swings far to the sides, which is how a cast begins.
    Registered as ``hyperflex/Swing-v0``, with episodes of 10 s (500 steps).

    ## Action Space

    With ``action="acceleration"`` (the default) ``Box(-1, 1, (1,), float32)``: the arm's acceleration for the interval
    as a part of the motor's greatest, 23.6 rad/s^2. It is reduced where the arm would pass the motor's speed or could
    no longer brake before the end of its range. With ``action="timing"`` ``Discrete(2)``: 1 starts a half turn of an
    arm that rests, 0 waits; while the arm moves both do nothing. This is how the paper's controller acts.

    ## Observation Space

    A ``Box`` of float64, clipped to [-100, 100]. With ``observation="state"`` (the default), (63,): sine of the 20 link
    angles, from the first link on, and their cosine; their rates; sine and cosine of the arm's angle; its rate. Angles
    are from the downward vertical, rates in units of 10 rad/s. With ``observation="markers"``, (23,): sine, cosine and
    rate of the arm; then x and y, m, of 5 markers along the rope, the last one on its tip, from the shaft; then the
    same an interval earlier.

    ## Rewards

    The tip's horizontal distance from the shaft, as a part of the reach (rope and arm): 0 to 1 a step.

    ## Starting State

    The arm points to the left, at rest. The rope hangs straight and at rest, up to 0.1 rad from the vertical (uniform).

    ## Episode End

    Truncated after 500 steps (``max_episode_steps``). Terminated, without a reward, only where the run cannot be
    simulated within `tol`, then ``info["failed"]`` is true. ``info["amplitude"]`` is the reward of the step.

    ## Arguments

    `rope`, `arm`, `limits`, `action`, `observation`, `markers`, `dt`, `tol`, `mismatch` and `randomization`, as of
    :class:`EnvOptions`: ``gymnasium.make("hyperflex/Swing-v0", action="timing", randomization={"friction": 0.2})``.

    ## Version history

    - v0: initial version.
    """

    vector_class = SwingVectorEnv
