"""Exact derivatives of rollouts by the start, the rope, the arm and the motion."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import numpy.typing as npt

from hyperflex import extras, memory
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import Chain, can_stick
from hyperflex.core.chain.drive import Drive, base_state, segment
from hyperflex.core.chain.lanes import COLUMNS, set_slip
from hyperflex.core.integrate.rollout import JOINT, MODES, REJECTED, STEP, TAKEN, Limits
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.core.stiction import find_modes, new_stiction_workspace
from hyperflex.core.tangent import forward_sensitivity as core
from hyperflex.core.tangent.extrapolation import Directions, new_tangent_workspace, place_changes
from hyperflex.core.tangent.forward_sensitivity import acceleration_derivatives
from hyperflex.interruption import OutOfTime, interruptible
from hyperflex.model import Rope, Setup, SetupFields
from hyperflex.motion import Motion
from hyperflex.simulation.arguments import output_times, setup_of
from hyperflex.simulation.outcome import refuse_failure, refuse_unbalanced
from hyperflex.simulation.rollouts import TABLES, Rollout, finish_rollout, prepare_rollout, rollout_limits
from hyperflex.simulation.sensitivity.directions import ParameterDirections, Wrt, check_smooth, parameter_directions
from hyperflex.simulation.sensitivity.stiction import stiction_projection
from hyperflex.simulation.time_budget import Watch, out_of_time

if TYPE_CHECKING:
    import xarray as xr

_NAMED = 4  # parameters that are printed
LARGE = 1_000_000  # steps x links x directions, some tenths of a second's work, from which Ctrl-C is heard meanwhile
ON = np.zeros(1, dtype=np.int64)  # nothing halts what is short
STEPS = 10_000  # noted in one go; a run with more of them is done again with room for all


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivities:
    """A rollout and its derivatives (made by :func:`hyperflex.sensitivities`).

    Attributes
    ----------
    t : (T,) float64
        Output times, s.
    q, qd : (T, n) float64
        Angles, rad, and rates, rad/s.
    tip : (T, 2) float64
        Position of the tip, m.
    names : tuple of str
        Names of the parameters of the derivatives, (P,).
    dq, dqd : (T, n, P) float64
        Derivatives of angles and rates at fixed times, in rad and rad/s per SI unit of the parameter.
    dtip : (T, 2, P) float64
        Derivatives of the tip's position, m per SI unit.
    arm_angle, arm_rate : (T,) float64, or None
        Of a torque-driven arm, rad and rad/s.
    darm_angle, darm_rate : (T, P) float64, or None
        Their derivatives.
    """

    t: Array
    q: Array
    qd: Array
    tip: Array
    names: tuple[str, ...]
    dq: Array
    dqd: Array
    dtip: Array
    arm_angle: Array | None = None
    arm_rate: Array | None = None
    darm_angle: Array | None = None
    darm_rate: Array | None = None

    def __repr__(self) -> str:
        more = len(self.names) - _NAMED
        names = ", ".join(self.names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
        return f"Sensitivities({self.q.shape[1]} links, {self.t.size} samples, by {names})"

    @property
    def dataset(self) -> "xr.Dataset":
        """The same as an ``xarray.Dataset`` with the dimensions time, link, axis and parameter."""
        extras.require(("xarray",), "xarray", "Datasets")
        import xarray as xr

        shapes = {"q": ("link",), "qd": ("link",), "tip": ("axis",), "arm_angle": (), "arm_rate": ()}
        variables: dict[str, Any] = {}
        for name, shape in shapes.items():
            unit = {"qd": "rad/s", "arm_rate": "rad/s", "tip": "m"}.get(name, "rad")
            if getattr(self, name) is not None:
                about = {"long_name": f"derivative of {name}", "units": f"{unit} per unit"}
                variables[name] = (("time", *shape), getattr(self, name), {"units": unit})
                variables[f"d{name}"] = (("time", *shape, "parameter"), getattr(self, f"d{name}"), about)
        coords = {
            "time": ("time", self.t, {"units": "s"}),
            "axis": ("axis", np.array(["x", "y"])),
            "parameter": ("parameter", np.array(self.names)),
        }
        return xr.Dataset(variables, coords, attrs={"source": "simulated"})


@interruptible()
def sensitivities(
    rope: Rope | Setup,
    motion: Motion | None = None,
    *,
    wrt: Wrt,
    t_eval: npt.ArrayLike | None = None,
    time_budget: float | Budget | None = None,
    **setup: Unpack[SetupFields],
) -> Sensitivities:
    """Simulate a rope, and differentiate angles, rates and the tip's position.

    The computed run itself is differentiated, step by step, so the derivatives are exact to rounding. They differ from
    those of the true motion by about as much as the run itself.

    Parameters
    ----------
    rope, motion, t_eval, time_budget, **setup
        As in :func:`hyperflex.simulate`.
    wrt : str, mapping, or sequence of them
        Parameters of the derivatives; at least one.

        ``"q0"``, ``"qd0"``: the start of every link; ``"q0[3]"`` of one.
        ``"friction"``, and likewise dry_friction, length, mass, com, inertia, stiffness, rest_angle, drag: one number
        added to that of every link; ``"friction[3]"`` of one link; ``"friction[:]"`` of each. The others stay as they
        are: more ``"mass"`` does not change the inertia.
        ``"tip_mass"``, ``"gravity[0]"``, ``"gravity[1]"``, ``"arm.length"``. Without `q0` the rope hangs along gravity
        at the start, and turns with it.
        ``"motion.t_rest"`` and whatever else the motion was made from; ``"motion.delay"`` of any motion.
        ``{"radius": {"inertia": 0.5 * mass * radius}}``: a parameter of your own, by how much each property changes
        with it: (n,) arrays or numbers for q0, qd0 and the properties of links, and tip_mass, gravity (2,), arm_length,
        and ``breaks`` (k + 1,) and ``coef`` (k, 4, 6) of the motion.

        With a torque-driven arm also ``"arm_angle0"``, ``"arm_rate0"``, ``"arm.inertia"``, and likewise mass, com,
        friction and dry_friction, and ``"torque.torque[3]"``, ``"torque.delay"`` of its torque.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.
    SimulationError
        If the run fails, or would take more than half an hour.

    Notes
    -----
    Derivatives hold at fixed times, also where a switch of the motion moves with its parameter. At the very instant of
    such a switch they are those from before it. Equations (M.19)-(M.25) of docs/models.md; cost about as much as the
    run for two parameters, and a third of it for each further initial angle or rate.

    With dry friction they go through each instant at which a joint sticks or comes loose, which moves with the
    parameter, too. Where two sides differ they are one-sided, for the modes that the run has: for a joint at rest
    exactly at its limit, or at rest at the start and slipping from there; for joints that change at the same instant;
    for ``"dry_friction"`` of a joint that has none, towards more. A joint that sticks at the start stops a change of
    its rate at once, so behind the start ``"qd0"`` moves both of its links alike.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> cast = hf.sensitivities(cable, hf.arm_swings(), arm=hf.Arm(), duration=2.0, wrt=["friction", "motion.t_rest"])
    >>> cast.dtip.shape
    (201, 2, 2)
    """
    full, _ = setup_of(rope, {**setup, "motion": motion})
    check_smooth(full)
    directions = parameter_directions(full, wrt)
    t = output_times(t_eval, 0.0, full.duration)
    chain, drive = directions.with_faint_terms(full.chain()), full.drive()
    links, count = chain.length.size, len(directions.names)
    memory.check(
        8.0 * 5 * (links + 1) * (count + 1) * t.size,
        f"derivatives of {links} links by {count} parameters at {t.size} outputs",
        "Ask for fewer outputs (t_eval=[...]) or parameters (wrt=[...])",
    )
    watch = Watch(time_budget, (0.0, full.duration))
    run = record_steps(chain, drive, full.start(), rollout_limits(full, chain, full.duration), t=t, watch=watch)
    refuse_unbalanced(run, full)
    _, dy = forward_derivatives(run, directions, full.start(), t)
    return _labelled(chain, drive, directions, t, run.y[-t.size :], dy, own=1 if full.torque_driven else 0)


class AngleJacobian:
    """Rollouts with derivatives for callers that need thousands: everything is checked once, here.

    Rope, start and duration of the set-up may be replaced in each call; `wrt` is as in :func:`sensitivities`.
    """

    def __init__(self, setup: Setup, wrt: Wrt) -> None:
        check_smooth(setup)
        self.setup, self.drive = setup, setup.drive()
        self.wrt = parameter_directions(setup, wrt)
        self.names = self.wrt.names
        self._begin(setup.rope)

    def _begin(self, rope: Rope) -> None:
        """Make what follows from the rope alone."""
        arm = self.setup.arm
        self.rope = rope
        self.chain = self.wrt.with_faint_terms(arm.chain(rope) if arm and self.setup.torque_driven else rope.chain())
        self.seeds = self.wrt.directions(self.chain, self.drive)

    def __call__(self, t: Array, q0: Array, qd0: Array, rope: Rope | None = None) -> tuple[Array, Array, Array, Array]:
        """Return angles and rates (T, n) and their derivatives (T, n, P) at times t (T,).

        Parameters
        ----------
        t : (T,) array
            Increasing times, s; the run starts at t[0].
        q0, qd0 : (n,) array
            Angles, rad, and rates, rad/s, at t[0]; a torque-driven arm is the first of n links, here and in the answer.
        rope : Rope, optional
            Another rope with as many links.
        """
        if (rope or self.setup.rope) is not self.rope:
            self._begin(rope or self.setup.rope)
        chain, bounds = self.chain, rollout_limits(self.setup, self.chain, float(t[-1]))
        run = record_steps(chain, self.drive, (q0, qd0), bounds, float(t[0]), t=t)
        _, dy = forward_derivatives(run, self.wrt, (q0, qd0), t, self.seeds)
        y = run.y[-t.size :]
        n, p = chain.length.size, len(self.names)
        return y[:, :n], y[:, n : 2 * n], dy[:, :n, :p], dy[:, n:, :p]


def record_steps(
    chain: Chain,
    drive: Drive,
    start: tuple[Array, Array],
    bounds: Limits,
    begin: float = 0.0,
    first_step: float = FIRST_STEP,
    t: Array | None = None,
    watch: Watch | None = None,
) -> Rollout:
    """Run to the end and record every step; outputs are at `begin`, s, and at t (T,), s.

    `first_step`, s, is tried first; `watch` may end the run.
    """
    count, width = STEPS, MODES + chain.length.size if can_stick(chain) else JOINT
    times = np.array([begin]) if t is None else t if t[0] == begin else np.append(begin, t)
    while True:
        memory.check(8.0 * count * width, f"a run of {count} steps", "Make it shorter, or loosen tol")
        run = prepare_rollout(chain, drive, start, times, bounds, log=np.empty((count, width)))
        run.progress.clock[STEP] = first_step
        try:
            code = finish_rollout(run, watch or Watch(None, (begin, bounds.stop)))
        except OutOfTime as cause:
            raise out_of_time(run.time, cause) from None
        refuse_failure(code, run)
        steps = int(run.progress.clock[TAKEN] - run.progress.clock[REJECTED])
        if steps <= count:
            run.progress = run.progress._replace(log=run.progress.log[:steps])
            return run
        count = steps


def forward_derivatives(
    run: Rollout,
    directions: ParameterDirections,
    start: tuple[Array, Array],
    t: Array,
    seeds: Directions | None = None,
) -> tuple[Array, Array]:
    """Go through a recorded run again: states (T, 2 n + 2) and their derivatives (T, 2 n, p) at times t (T,).

    Within steps they are read off a polynomial; the run's own outputs differ from them by less than steps may err.
    `seeds` are the directions as the kernels take them, where they are at hand.
    """
    n, begin = run.chain.length.size, float(run.t[0])
    times = np.append([] if t[0] == begin else begin, t)
    y, dy = np.zeros((times.size, 2 * n + 2)), np.zeros((times.size, 2 * n, directions.width))
    y[0, :n], y[0, n : 2 * n] = start
    dy[:] = directions.start(n)
    steps = run.progress.log
    if steps.size:
        seeds = seeds or directions.directions(run.chain, run.drive)
        begins = stiction_projection(run.chain, run.drive, begin, y[0, :n], steps[0, MODES:], seeds, dy[0])
        given = (run.chain, run.drive, TABLES, steps, begin, begins, seeds, times, y, dy)
        _stoppable(lambda halt: core.forward_sensitivities(*given, halt), steps.shape[0] * n * directions.width)
    first = times.size - t.size
    return y[first:], dy[first:]


def _stoppable(kernel: Callable[[npt.NDArray[np.int64]], None], size: int) -> None:
    """Call a kernel that can be halted; one of a large `size` on a thread, so that Ctrl-C is heard meanwhile."""
    if size < LARGE:
        kernel(ON)
        return
    halt = np.zeros(1, dtype=np.int64)
    with ThreadPoolExecutor(1) as pool:
        work = pool.submit(kernel, halt)
        try:
            work.result()
        except KeyboardInterrupt:
            halt[0] = 1
            raise


def acceleration_jacobian(
    chain: Chain, drive: Drive, start: tuple[Array, Array], seeds: Directions, values: Array
) -> Array:
    """Return the derivatives (n, p) of the links' accelerations at t = 0 in a state, along directions.

    Parameters
    ----------
    chain, drive, seeds : Chain, Drive, Directions
    start : (n,), (n,) float64
        Angles, rad, and rates, rad/s; joints that stick there are locked.
    values : (2 n, p) float64
        Derivatives of angles and rates.
    """
    n, base, slip = chain.length.size, np.empty(9), np.ones(chain.length.size)
    part = segment(drive, 0.0)
    torque = base_state(drive, part, 0.0, base)
    q, qd = (np.array(value) for value in start)
    if can_stick(chain):
        find_modes(chain, q, qd, base, torque, 1.0, slip, new_stiction_workspace(n))
    workspace = new_tangent_workspace(chain, seeds.parameters.size)
    set_slip(COLUMNS, workspace.lanes, slip)
    workspace.ys[:, :n], workspace.ys[:, n : 2 * n], workspace.nodes[:] = q, qd, values
    acceleration_derivatives(chain, drive, part, 0.0, 0.0, seeds, workspace)
    return np.asarray(workspace.bends[0])


def _labelled(
    chain: Chain, drive: Drive, directions: ParameterDirections, t: Array, y: Array, dy: Array, own: int
) -> Sensitivities:
    """Add the tip to a run's states and derivatives, and name an arm that is a link of its `own` (1, else 0)."""
    n, p = chain.length.size, len(directions.names)
    q, dq = y[:, :n], dy[:, :n, :p]
    sin, cos = np.sin(q), np.cos(q)
    motion = Motion(drive.breaks, drive.coef, drive.switch, drive.loop)
    angle = motion.angle(t)
    reach = np.stack([(chain.length * sin).sum(axis=1), -(chain.length * cos).sum(axis=1)], axis=1)
    tip = motion.point(t) + drive.arm_length * np.stack([np.sin(angle), -np.cos(angle)], axis=1) + reach
    dtip = np.zeros((t.size, 2, directions.width))
    place_changes(drive, directions.directions(chain, drive), np.array(t), dtip)  # compiled for arrays of one kind
    dtip = dtip[:, :, :p] + np.matmul(chain.length * np.stack([cos, sin], axis=1), dq)
    dtip += np.matmul(np.stack([sin, -cos], axis=1), directions.lengths(n))
    qd, dqd, names = y[:, n : 2 * n], dy[:, n:, :p], directions.names
    arm = (q[:, 0], qd[:, 0], dq[:, 0], dqd[:, 0]) if own else ()
    return Sensitivities(t, q[:, own:], qd[:, own:], tip, names, dq[:, own:], dqd[:, own:], dtip, *arm)
