"""Stepper: a run taken one interval at a time, with a command for each."""

from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import can_stick
from hyperflex.core.chain.drive import ANGLE, TORQUE
from hyperflex.core.contact.run import clearance
from hyperflex.core.integrate.rollout import JOINT, MARK, MODES, REJECTED, TAKEN
from hyperflex.core.tangent import forward_sensitivity
from hyperflex.core.tangent.extrapolation import Directions
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, Rope, Setup, SetupFields
from hyperflex.motion import hold_arm
from hyperflex.simulation.arguments import setup_of
from hyperflex.simulation.commands import COMMANDS, arm_polynomials, set_commands, setup_for, state_directions
from hyperflex.simulation.contact.runs import STEP as CONTACT_STEP
from hyperflex.simulation.contact.runs import ContactRun
from hyperflex.simulation.contact.start import check_start
from hyperflex.simulation.outcome import refuse_failure
from hyperflex.simulation.restart import check_state, resume, state_of
from hyperflex.simulation.rollouts import TABLES, Interval, finish_rollout, prepare_rollout, rollout_limits
from hyperflex.simulation.sensitivity.directions import check_smooth
from hyperflex.simulation.sensitivity.sensitivity import ON
from hyperflex.simulation.sensitivity.stiction import stiction_projection
from hyperflex.trajectory import State

STEPS = 64  # noted at first for a derivative; an interval with more of them is run again with room for all


@dataclass(frozen=True, eq=False)
class Linearization:
    """A step and its derivatives; the state is x = (arm angle, q, arm rate, qd), in rad and rad/s.

    Attributes
    ----------
    state : State
        After the step.
    A : (2 n + 2, 2 n + 2) float64
        Of x after the step with respect to x before it.
    B : (2 n + 2, 1) float64
        With respect to the command, per rad, rad/s^2 or N m.
    """

    state: State
    A: Array
    B: Array


class Stepper:
    """Simulates a rope on an arm interval by interval, with a constant command in each.

    The set-up is checked once, here. A stepper has no state: a step from the same state with the same command gives the
    same result, bit for bit, in any order of calls. Each thread needs its own stepper.

    Parameters
    ----------
    rope : Rope or Setup
        The rope; or a whole set-up, whose motion or torque the commands replace.
    command : {"acceleration", "angle", "torque"}
        Meaning of a command u, for the time s since the start of the interval, at which the arm has angle a and rate v:

        ``"acceleration"``: u, rad/s^2. The arm turns with it: a + v s + u s^2 / 2.
        ``"angle"``: u, rad. The arm follows the cubic that ends the interval, dt long, at the angle u with its mean
        rate (u - a) / dt. So angles on a straight line are a constant rate from the second step on.
        ``"torque"``: u, N m, constant. The arm moves as it must: its inertia, weight and friction count.
    refine, **setup
        As in :func:`hyperflex.simulate`. An ``arm`` is required: ``Arm(length=0.0)`` for a rope that hangs from the
        motor's shaft itself.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.

    Notes
    -----
    The method and its error control are those of :func:`hyperflex.simulate`; the end of each interval is a switch of
    the motion. The state contains the integrator's memory (step sizes, contact forces). The sticking joints are
    determined again from the state, as after any switch. The energy balance, which `simulate` checks at its outputs, is
    not checked; the state contains its terms.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> stepper = hf.Stepper(cable, arm=hf.Arm())
    >>> state = stepper.start()
    >>> for _ in range(30):
    ...     state = stepper.step(state, 2.0, dt=1 / 30)
    >>> round(state.t, 6), round(state.arm_angle, 6)
    (1.0, 1.0)
    """

    def __init__(
        self,
        rope: Rope | Setup,
        *,
        command: str = "acceleration",
        refine: bool = True,
        **setup: Unpack[SetupFields],
    ) -> None:
        self.command = checks.choice("command", command, COMMANDS)
        full, _ = setup_of(rope, {"duration": 1.0, **setup} if isinstance(rope, Rope) else setup, refine=refine)
        self.setup = setup_for(command, full)
        chain, self._interval = self.setup.chain(), Interval(self.setup.drive())
        run = prepare_rollout(
            chain, self._interval.drive, self.setup.start(), np.zeros(1), rollout_limits(self.setup, chain, 0.0)
        )
        run.t, run.y = run.t[1:], run.y[1:]  # no outputs: a step shows its end
        self._run, self._log = run, np.empty((STEPS, MODES + chain.length.size if can_stick(chain) else JOINT))
        self._contact_run = ContactRun(run, self.setup, None) if self.setup.touches else None
        self._channel = TORQUE if command == "torque" else ANGLE
        self._polynomials = (0.0, np.zeros((3, 6)), np.zeros((3, 2)))
        self._seeds: tuple[Array, Directions] | None = None

    def start(
        self,
        q0: npt.ArrayLike | None = None,
        qd0: npt.ArrayLike | None = None,
        *,
        arm_angle: float | None = None,
        arm_rate: float | None = None,
        t: float = 0.0,
    ) -> State:
        """Return a state to begin with at time t, s; by default that of the set-up, where a rope hangs at rest.

        q0 and qd0 (n,) are absolute link angles, rad, and rates, rad/s; arm_angle and arm_rate are in rad and rad/s.
        """
        setup, n = self.setup, self.setup.rope.n_links
        values: dict[str, Any] = {"q0": q0, "qd0": qd0, "arm_angle0": arm_angle, "arm_rate0": arm_rate}
        setup = replace(setup, **{name: value for name, value in values.items() if value is not None})
        q, qd = (value[-n:].copy() for value in setup.start())
        q.setflags(write=False)
        qd.setflags(write=False)
        time = checks.number("t", t, unit="s")
        return State(time, q, qd, arm_angle=setup.arm_angle0, arm_rate=setup.arm_rate0)

    @interruptible()
    def step(self, state: State, command: float, dt: float) -> State:
        """Return the state an interval later.

        Parameters
        ----------
        state : State
            From :meth:`start` or :meth:`step`; a run's ``trajectory.state``; or any of them with some values replaced
            (``dataclasses.replace(state, q=...)``).
        command : float
            rad/s^2, rad or N m.
        dt : float
            Length of the interval, s, > 0; it may differ from step to step.

        Raises
        ------
        InvalidInput
            If the state is not one of this rope, or a number cannot be used.
        SimulationError
            If the interval cannot be simulated within `tol`.
        """
        arm = self._begin(state, command, dt)
        self._finish()
        return self._state(arm)

    @interruptible()
    def linearize(self, state: State, command: float, dt: float) -> Linearization:
        """Return the state an interval later, and its derivatives.

        The arguments state, command and dt, and the errors, are as in :meth:`step`; InvalidInput also of a stepper with
        pegs or joint limits, or of a fixed step.

        Notes
        -----
        Exact for the computed step, not differences; one-sided where joints stick (see :func:`hyperflex.sensitivities`,
        (M.19)-(M.25)). Cost O(n^2), for n = 50 some twenty times that of the step.
        """
        check_smooth(self.setup)
        if self.setup.touches:
            got = "a stepper with pegs or joint limits"
            raise InvalidInput("derivatives are of free flight", got=got, fix="Make one without")
        arm, steps, begin = self._recorded(state, command, dt)
        run, n = self._run, self._run.chain.length.size
        if self._seeds is None:
            self._seeds = state_directions(self.command, run.chain, run.drive)
        start, seeds = self._seeds
        set_commands(self.command, seeds, self._polynomials[1])
        y, jacobian = np.zeros((2, 2 * n + 2)), np.zeros((2, *start.shape))
        y[0] = begin
        times = np.array([run.drive.breaks[0], run.time])
        begins = stiction_projection(run.chain, run.drive, times[0], begin[:n], steps[0, MODES:], seeds, start)
        forward_sensitivity.forward_sensitivities(
            run.chain, run.drive, TABLES, steps, times[0], begins, seeds, times, y, jacobian, ON
        )
        moved = jacobian[1]
        if self.command != "torque":  # the arm is no link of the chain: what it does follows from the command alone
            rows = np.zeros((2, moved.shape[1]))
            rows[:, [0, n + 1, 2 * n + 2]] = self._polynomials[2].T
            moved = np.concatenate([rows[:1], moved[:n], rows[1:], moved[n:]])
        size = len(moved)
        return Linearization(self._state(arm), moved[:, :size].copy(), moved[:, size : size + 1].copy())

    def tip(self, state: State) -> tuple[Array, Array]:
        """Return place (2,), m, and velocity (2,), m/s, of the tip in a `state`."""
        arm, rope = self.setup.arm or Arm(), self.setup.rope  # a stepper has an arm
        q = np.asarray(check_state(state, rope.n_links).q)
        angle, rate = self._arm_of(state)
        place = rope.joints(q, arm.tip(np.array([angle]))[0])[-1]
        turn = arm.length * rate * np.array([np.cos(angle), np.sin(angle)])
        return place, turn + np.array([np.cos(q), np.sin(q)]) @ (rope.length * state.qd)

    def gap(self, state: State) -> float:
        """Return the smallest gap between rope and obstacles in a `state`, m.

        Raises
        ------
        InvalidInput
            Of a stepper without obstacles.
        """
        if self._contact_run is None or not self.setup.pegs:
            raise InvalidInput("there is nothing to touch", fix="Make the stepper with pegs=[...]")
        self._enter(state, 0.0, 1.0, arm_polynomials(self.command, 1.0)[0])
        run = self._run
        return float(clearance(run.chain, run.drive, self._contact_run.contacts, run.time, run.progress.y, np.inf)[0])

    def _arm_of(self, state: State) -> tuple[float, float]:
        """Return angle and rate of the arm in a state."""
        angle = self.setup.arm_angle0 if state.arm_angle is None else state.arm_angle
        rate = self.setup.arm_rate0 if state.arm_rate is None else state.arm_rate
        return checks.number("state arm_angle", angle, unit="rad"), checks.number("state arm_rate", rate, unit="rad/s")

    def _state(self, arm: tuple[float, float]) -> State:
        run = self._run
        return state_of(run, self.setup, run.progress.y, run.progress.clock[:MARK], run.spin, arm, **run.kept)

    def _begin(self, state: State, command: float, dt: float) -> tuple[float, float]:
        """Set the run to a state and a command; returns angle and rate of a prescribed arm at the end."""
        u, span = checks.number("command", command), checks.number("dt", dt, sign="positive", unit="s")
        if span != self._polynomials[0]:
            self._polynomials = (span, *arm_polynomials(self.command, span))
        as_saved, known = self._enter(state, u, span, self._polynomials[1])
        run = self._run
        run.limits = run.limits._replace(stop=run.time + span)
        if self._contact_run is not None:
            if not as_saved or CONTACT_STEP not in state.checkpoint:
                still = self.setup if self.command == "torque" else replace(self.setup, motion=hold_arm(known[0]))
                check_start(still, run.time, run.progress.y[: run.chain.length.size])
            self._contact_run.enter(state)
        angle, rate = (known @ self._polynomials[2]).tolist()
        return angle, rate

    def _enter(self, state: State, command: float, span: float, powers: Array) -> tuple[bool, Array]:
        """Set the run to a state and the arm's motion; returns whether it is as saved, and (angle, rate, command)."""
        run = self._run
        as_saved = resume(run, state, self.setup)
        run.progress.clock[MARK:] = 0.0
        known = np.array([*self._arm_of(state), command])
        self._interval.set(run.time, run.time + span, self._channel, known @ powers)
        return as_saved, known

    def _finish(self) -> None:
        refuse_failure(
            finish_rollout(self._run) if self._contact_run is None else self._contact_run.finish(), self._run
        )

    def _recorded(self, state: State, command: float, dt: float) -> tuple[tuple[float, float], Array, Array]:
        """Take a step; returns what :meth:`_begin` does, the steps (m, ...) taken and the start (2 N + 2,)."""
        run, plain = self._run, self._run.progress
        try:
            while True:
                run.progress = plain._replace(log=self._log)
                arm = self._begin(state, command, dt)
                begin = plain.y.copy()
                self._finish()
                count = int(plain.clock[TAKEN] - plain.clock[REJECTED])
                if count <= len(self._log):
                    return arm, self._log[:count], begin
                self._log = np.empty((2 * count, self._log.shape[1]))
        finally:
            run.progress = plain
