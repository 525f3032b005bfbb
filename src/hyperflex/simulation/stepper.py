"""Stepper: a run taken one interval at a time, with a command for each."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import ANGLE, TORQUE, Drive, segment
from hyperflex.core.chain.lanes import COLUMNS, set_slip
from hyperflex.core.contact.run import clearance
from hyperflex.core.integrate.observation import senses
from hyperflex.core.integrate.rollout import MARK
from hyperflex.core.tangent.forward_sensitivity import Directions, acceleration_derivatives, new_tangent_workspace
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, Rope, Setup, SetupFields
from hyperflex.motion import torque_profile
from hyperflex.simulation.contact import ContactRollout
from hyperflex.simulation.rollouts import Interval, Rollout, check_state, link_accelerations
from hyperflex.simulation.runs import setup_of
from hyperflex.simulation.sensitivity import ParameterDirections, check_smooth, forward_derivatives
from hyperflex.trajectory import State

NO_TIMES = np.empty(0)  # a step shows its end, and no outputs
COMMANDS = {"acceleration": ANGLE, "angle": ANGLE, "torque": TORQUE}  # and the channel of the motion that each sets


def setup_for(command: str, setup: Setup) -> Setup:
    """Return a set-up with an arm that a stepper can command, without a motion or a torque of its own."""
    if setup.arm is None:
        fix = "Give Arm(length=0.0) for a rope that hangs from the motor's shaft itself"
        fix = "" if command == "torque" else fix
        raise InvalidInput("a stepper needs an arm to command", allowed="arm=Arm(...)", fix=fix)
    torque = torque_profile([0.0, 1.0], [0.0, 0.0]) if command == "torque" else None
    angle, rate = setup.arm_angle0, setup.arm_rate0
    if setup.motion is not None:
        angle, rate = float(setup.motion.angle(0.0)), float(setup.motion.rate(0.0))
    return replace(setup, motion=None, torque=torque, arm_angle0=angle, arm_rate0=rate, control=None, control_rate=None)


@lru_cache(maxsize=64)
def arm_polynomials(command: str, dt: float) -> tuple[Array, Array]:
    """Return what the arm does in an interval, in proportion to its angle and rate at the beginning and the command.

    Returns
    -------
    powers : (3, 6) float64
        Coefficients of the arm's angle, or of the motor's torque, in powers of the time since the interval began.
    ends : (3, 2) float64
        Angle and rate of a prescribed arm at its end.
    """
    powers, ends = np.zeros((3, 6)), np.zeros((3, 2))
    if command == "torque":
        powers[2, 0] = 1.0
    else:
        powers[0, 0] = powers[1, 1] = 1.0
    if command == "acceleration":
        powers[2, 2] = 0.5
        ends[:] = [[1.0, 0.0], [dt, 1.0], [0.5 * dt * dt, dt]]
    elif command == "angle":
        powers[:, 2] = -2.0 / dt**2, -2.0 / dt, 2.0 / dt**2
        powers[:, 3] = 1.0 / dt**3, 1.0 / dt**2, -1.0 / dt**3
        ends[:] = [[0.0, -1.0 / dt], [0.0, 0.0], [1.0, 1.0 / dt]]
    return powers, ends


def command_directions(command: str, chain: Chain, drive: Drive) -> tuple[ParameterDirections, Directions]:
    """Return the directions of x = (arm angle, q, arm rate, qd) and of the command, with seeds for the kernels.

    The seeds are those of no interval until :func:`set_commands`.
    """
    n, by = chain.length.size, {"coef": np.ones((1, 4, 6))}
    q, qd = ([{name: row} for row in np.eye(n)] for name in ("q0", "qd0"))
    parts = [*q, *qd, by] if command == "torque" else [by, *q, by, *qd, by]
    varied = ParameterDirections(tuple(map(str, range(len(parts)))), tuple(parts))
    return varied, varied.directions(chain, drive._replace(coef=by["coef"]))  # all that may ever move


def set_commands(command: str, seeds: Directions, powers: Array) -> None:
    """Set directions to those of an interval, whose `powers` are as :func:`arm_polynomials` gives them."""
    rows = powers[2:] if command == "torque" else powers
    seeds.coef[:] = 0.0
    seeds.coef[: len(rows), 0, COMMANDS[command]] = rows


def commanded_accelerations(command: str, setup: Setup, q: Array, qd: Array, u: float) -> tuple[Array, Array]:
    """Return the accelerations (n + 1,) of arm and links under a command u, rad/s^2, and their derivatives.

    Parameters
    ----------
    command : {"acceleration", "torque"}
    setup : Setup
        From :func:`setup_for`.
    q, qd : (n + 1,) float64
        Angles, rad, and rates, rad/s, of the arm and the links; joints that stick there are locked.
    u : float
        rad/s^2 or N m.

    Returns
    -------
    accelerations : (n + 1,) float64
    slopes : (n + 1, 2 n + 3) float64
        By q, qd and u.
    """
    chain, interval, powers = setup.chain(), Interval(setup.drive()), arm_polynomials(command, 1.0)[0]
    interval.set(0.0, 1.0, COMMANDS[command], np.array([q[0], qd[0], u]) @ powers)
    drive, n, size = interval.drive, chain.length.size, 2 * q.size + 1
    y, part = np.concatenate([q[-n:], qd[-n:]]), segment(drive, 0.0)
    varied, seeds = command_directions(command, chain, drive)
    set_commands(command, seeds, powers)
    workspace = new_tangent_workspace(chain, drive, seeds.parameters.size)
    set_slip(COLUMNS, workspace.lanes, senses(chain, drive, np.zeros(1), y[None])[0])
    workspace.ys[:, : 2 * n], workspace.nodes[:] = y, varied.start(n)
    acceleration_derivatives(chain, drive, part, 0.0, 0.0, seeds, workspace)
    accelerations, slopes = np.full(q.size, u), np.eye(1, size, size - 1).repeat(q.size, axis=0)  # those of the arm
    accelerations[-n:] = link_accelerations(chain, drive, 0.0, y[:n], y[n:])
    slopes[-n:] = workspace.bends[0][:, :size]
    return accelerations, slopes


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
        refine: bool | None = None,
        **setup: Unpack[SetupFields],
    ) -> None:
        self.command = checks.choice("command", command, tuple(COMMANDS))
        full, _ = setup_of(rope, {"duration": 1.0, **setup} if isinstance(rope, Rope) else setup, refine=refine)
        self.setup = setup_for(command, full)
        self._interval, kind = Interval(self.setup.drive()), ContactRollout if self.setup.touches else Rollout
        self._run = kind(self.setup, NO_TIMES, drive=self._interval.drive)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy or pickle the set-up alone: the drive of a run is a view of its interval, which a copy would lose."""
        return partial(type(self), command=self.command), (self.setup,)

    @cached_property
    def _linear(self) -> tuple[Rollout, ParameterDirections, Directions]:
        """A logged run, and the directions of state and command with their seeds."""
        run = Rollout(self.setup, NO_TIMES, drive=self._interval.drive, logged=True)
        return run, *command_directions(self.command, run.chain, run.drive)

    def start(
        self,
        q0: ArrayLike | None = None,
        qd0: ArrayLike | None = None,
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
        arm = self._begin(self._run, state, command, dt)
        self._run.complete()
        return self._run.state(arm=arm)

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
        run, varied, seeds = self._linear
        powers, ends = arm_polynomials(self.command, dt)
        set_commands(self.command, seeds, powers)
        arm, n = self._begin(run, state, command, dt), run.chain.length.size
        start = run.progress.y[:n].copy(), run.progress.y[n : 2 * n].copy()
        run.complete()
        moved = forward_derivatives(run, varied, start, np.array([run.drive.breaks[0], run.time]), seeds)[1][1]
        if self.command != "torque":  # the arm is no link of the chain: what it does follows from the command alone
            rows = np.zeros((2, moved.shape[1]))
            rows[:, [0, n + 1, 2 * n + 2]] = ends.T
            moved = np.concatenate([rows[:1], moved[:n], rows[1:], moved[n:]])
        size = len(moved)
        return Linearization(run.state(arm=arm), moved[:, :size].copy(), moved[:, size : size + 1].copy())

    def tip(self, state: State) -> tuple[Array, Array]:
        """Return place (2,), m, and velocity (2,), m/s, of the tip in a `state`."""
        check_state(state, self.setup.rope.n_links)
        arm = self.setup.arm or Arm()  # a stepper has an arm
        return arm.rope_tip(self.setup.rope.length, *self._arm_of(state), state.q, state.qd)

    def gap(self, state: State) -> float:
        """Return the smallest gap between rope and obstacles in a `state`, m.

        Raises
        ------
        InvalidInput
            Of a stepper without obstacles.
        """
        run = self._run
        if not isinstance(run, ContactRollout) or not self.setup.pegs:
            raise InvalidInput("there is nothing to touch", fix="Make the stepper with pegs=[...]")
        self._enter(run, state, 0.0, 1.0)
        return float(clearance(run.chain, run.drive, run.contacts, run.time, run.progress.y, np.inf)[0])

    def _arm_of(self, state: State) -> tuple[float, float]:
        """Return angle and rate of the arm in a state."""
        angle = self.setup.arm_angle0 if state.arm_angle is None else state.arm_angle
        rate = self.setup.arm_rate0 if state.arm_rate is None else state.arm_rate
        return checks.number("state arm_angle", angle, unit="rad"), checks.number("state arm_rate", rate, unit="rad/s")

    def _begin(self, run: Rollout, state: State, command: float, dt: float) -> tuple[float, float]:
        """Set a run to a state and a command; returns angle and rate of a prescribed arm at the end."""
        u, span = checks.number("command", command), checks.number("dt", dt, sign="positive", unit="s")
        as_saved, known = self._enter(run, state, u, span)
        run.limits = run.limits._replace(stop=run.time + span)
        if isinstance(run, ContactRollout) and not as_saved:
            run.check_start()
        angle, rate = (known @ arm_polynomials(self.command, span)[1]).tolist()
        return angle, rate

    def _enter(self, run: Rollout, state: State, command: float, span: float) -> tuple[bool, Array]:
        """Set a run to a state and the arm's motion; returns whether it is as saved, and (angle, rate, command)."""
        as_saved = run.resume(state)
        run.progress.clock[MARK:] = 0.0
        known = np.array([*self._arm_of(state), command])
        powers, _ = arm_polynomials(self.command, span)
        self._interval.set(run.time, run.time + span, COMMANDS[self.command], known @ powers)
        return as_saved, known
