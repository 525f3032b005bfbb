"""Propagation of a state and of given changes of it, for filters that do so frame by frame."""

from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.core.integrate.rollout import MODES
from hyperflex.core.tangent import forward_sensitivity as core
from hyperflex.core.tangent.extrapolation import Directions
from hyperflex.model import Rope, Setup
from hyperflex.motion import Motion
from hyperflex.simulation.rollouts import TABLES, link_accelerations, rollout_limits
from hyperflex.simulation.sensitivity.directions import (
    ParameterDirections,
    Wrt,
    check_smooth,
    parameter_directions,
)
from hyperflex.simulation.sensitivity.sensitivity import ON, record_steps
from hyperflex.simulation.sensitivity.stiction import stiction_projection


class Propagator:
    """Takes a state from one time to another, and with it any number of changes of that state.

    Parameters
    ----------
    setup : Setup
        Rope, arm, motion and tolerance; no torque-driven arm.
    wrt : sequence of str and mappings
        Directions of parameters of rope and motion, as ``sensitivities`` takes them; may be empty.
    most : int
        Number of changes that a call may have.

    Notes
    -----
    The derivative of the computed run along each change: what a matrix of all derivatives would make of it, without
    the matrix. The cost of a change is the same as that of a column, so a few of them are cheaper than all.
    """

    def __init__(self, setup: Setup, wrt: Wrt, most: int) -> None:
        check_smooth(setup)
        self.setup, self.rope, self._wrt, self._most = setup, setup.rope, wrt, most
        self._set_up()

    def set_motion(self, motion: Motion) -> None:
        """Let the arm move in another way from now on."""
        self.setup = replace(self.setup, motion=motion)
        self._set_up()

    def __call__(
        self, begin: float, end: float, q: Array, qd: Array, changes: Array, rope: Rope
    ) -> tuple[Array, Array, Array, Array]:
        """Go from time `begin` to `end`, s.

        Parameters
        ----------
        begin, end : float
        q, qd : (n,) float64
            Angles, rad, and rates, rad/s, at the beginning.
        changes : (r, 2 n) float64
            Changes of angles and rates at the beginning, r <= most.
        rope : Rope
            With as many links as that of the set-up.

        Returns
        -------
        q, qd : (n,) float64
        changes : (r, 2 n) float64
            What has become of them.
        by_parameters : (P, 2 n) float64
            Derivatives by the parameters.

        Raises
        ------
        SimulationError
            If the motion cannot be computed.
        """
        if rope is not self.rope:
            self._begin(rope)
        n, first = q.size, self._first
        width = first + len(changes) + len(changes) % 2
        bounds = self._limits._replace(stop=end)
        run = record_steps(self.chain, self.drive, (q, qd), bounds, begin, first_step=end - begin)
        y, dy = np.zeros((2, 2 * n + 2)), np.zeros((2, 2 * n, width))
        y[0, :n], y[0, n : 2 * n] = q, qd
        dy[0, :, first : first + len(changes)] = changes.T
        steps, seeds = run.progress.log, self._seeds(width // 2)
        begins = stiction_projection(self.chain, self.drive, begin, y[0, :n], steps[0, MODES:], seeds, dy[0])
        times = np.array([begin, end])
        core.forward_sensitivities(self.chain, self.drive, TABLES, steps, begin, begins, seeds, times, y, dy, ON)
        moved = dy[1].T
        return y[1, :n], y[1, n : 2 * n], moved[first : first + len(changes)], moved[: self.count]

    def accelerations(self, t: float, q: Array, qd: Array) -> Array:
        """Return the links' accelerations (n,), rad/s^2, at time t, s, of the rope used last."""
        return link_accelerations(self.chain, self.drive, t, q, qd)

    def _set_up(self) -> None:
        """Make what follows from the set-up."""
        self.drive = self.setup.drive()
        own = parameter_directions(self.setup, self._wrt).parts if self._wrt else ()
        self.count = len(own)
        self._first = self.count + self.count % 2  # of the directions of a state's changes
        parts = [*own, *[{}] * (self._first - self.count + self._most)]
        self._all = ParameterDirections(tuple(map(str, range(len(parts)))), tuple(parts))
        self._begin(self.rope)

    def _begin(self, rope: Rope) -> None:
        """Make what follows from the rope and the motion alone."""
        self.rope = rope
        self.chain = self._all.with_faint_terms(rope.chain())
        self._limits = rollout_limits(self.setup, self.chain, 0.0)
        self._directions = self._all.directions(self.chain, self.drive)

    def _seeds(self, pairs: int) -> Directions:
        """Return the first pairs of directions."""
        links, whole, parameters, driven, *rest = self._directions
        return Directions(links[:pairs], whole[: 2 * pairs], parameters[:pairs], driven[: 2 * pairs], *rest)
