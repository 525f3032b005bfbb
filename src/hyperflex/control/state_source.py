"""Sources of the rope's state for a controller: the true simulated state, or an estimate with noise and delay."""

import math
from dataclasses import replace

import numpy as np

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState, StateSource
from hyperflex.model import DEFAULT_TOL, Arm, Rope
from hyperflex.motion import Motion
from hyperflex.simulation import simulate
from hyperflex.trajectory import State


def hanging_state(rope: Rope) -> RopeState:
    """Return the state of a rope that hangs at rest at t = 0."""
    return RopeState(0.0, np.full(rope.n_links, rope.hanging_angle), np.zeros(rope.n_links))


def advanced(rope: Rope, arm: Arm, state: RopeState, t: float, motion: Motion, tol: float = DEFAULT_TOL) -> RopeState:
    """Simulate a rope from a state to a time `t`, s; `tol` as in :func:`hyperflex.simulate`, m."""
    ahead = t - state.t
    start, end = State(state.t, state.q, state.qd), state.t + ahead  # `t` but for rounding: where the run ends
    run = simulate(rope, motion, arm=arm, duration=ahead, state=start, t_eval=[end], tol=tol)
    return RopeState(t, run.q[-1], run.qd[-1])


class TrueState:
    """The true state of a simulated rope that hangs at rest at t = 0; `tol` as in :func:`hyperflex.simulate`, m."""

    def __init__(self, rope: Rope, arm: Arm, *, tol: float = DEFAULT_TOL) -> None:
        self.rope, self.arm, self.tol = rope, arm, tol
        self._last = hanging_state(rope)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the simulated state at `t`, s, under `motion`.

        Raises InvalidInput for a time before that of the last call, SimulationError if the simulation failed.
        """
        time = checks.number("t", t, sign="nonnegative", unit="s")
        if time < self._last.t:
            raise InvalidInput("time goes back", got=time, allowed=f"at least {self._last.t:g} s")
        if time > self._last.t:
            # From angles and rates alone: the same state whether or not the motion has been changed since.
            self._last = advanced(self.rope, self.arm, self._last, time, motion, self.tol)
        return self._last


class SimulatedCamera:
    """Simulated camera with an estimator: frames at a rate, delay and noise; a model predicts over the delay.

    Parameters
    ----------
    truth : StateSource
        The observed rope, with as many links as `rope`.
    rope, arm : Rope, Arm
        The model that predicts from the last frame to the present; it may differ from the truth.
    rate : float
        Frames per second.
    delay : float
        From a frame to its estimate, s.
    angle_std, rate_std : float
        Standard deviations of the errors in each link's angle, rad, and rate, rad/s, at a frame; independent from link
        to link and frame to frame.
    seed : int
        Of the noise; the same frame has the same noise in each run.

    Notes
    -----
    Simulated, and not validated against a camera: a real estimator's errors are correlated along the rope and in time.
    """

    def __init__(
        self,
        truth: StateSource,
        rope: Rope,
        arm: Arm,
        *,
        rate: float = 30.0,
        delay: float = 0.1,
        angle_std: float = 0.01,
        rate_std: float = 0.1,
        seed: int = 0,
    ) -> None:
        self.truth, self.rope, self.arm = truth, rope, arm
        self.rate = checks.positive("rate", rate, "Hz")
        self.delay = checks.number("delay", delay, sign="nonnegative", unit="s")
        self.angle_std = checks.number("angle_std", angle_std, sign="nonnegative", unit="rad")
        self.rate_std = checks.number("rate_std", rate_std, sign="nonnegative", unit="rad/s")
        self.seed = checks.count("seed", seed, least=0)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the state at `t`, s, predicted from the newest frame; before the first one, the rope hangs at rest.

        Raises InvalidInput if the truth has another number of links than the model, SimulationError if the model cannot
        be simulated from what was seen.
        """
        number = math.floor((t - self.delay) * self.rate + 1e-9)
        seen = hanging_state(self.rope) if number < 0 else self._frame(number, motion)
        return replace(seen, t=t) if t <= seen.t else advanced(self.rope, self.arm, seen, t, motion)

    def _frame(self, number: int, motion: Motion) -> RopeState:
        true = self.truth.state(number / self.rate, motion)
        n = self.rope.n_links
        if true.q.size != n:
            raise InvalidInput("camera and model differ in links", got=n, allowed=f"{true.q.size}, as in the truth")
        noise = np.random.default_rng([self.seed, number]).standard_normal((2, n))
        return RopeState(true.t, true.q + self.angle_std * noise[0], true.qd + self.rate_std * noise[1])
