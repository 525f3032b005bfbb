"""Exact derivatives of rollouts by the start, the rope, the arm and the motion; and how small errors grow."""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, memory
from hyperflex.budget import Budget
from hyperflex.checks import Array, Integers
from hyperflex.core.chain.articulated_body import Chain, can_stick, mass_matrix
from hyperflex.core.chain.drive import TORQUE, Drive, segment
from hyperflex.core.integrate.rollout import JOINT, MODES, STEP
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.core.read_only import read_only
from hyperflex.core.tangent import forward_sensitivity as core
from hyperflex.core.tangent import step as tg
from hyperflex.core.tangent.forward_sensitivity import CHANGES, RATE, Directions, base_change, place_changes
from hyperflex.errors import InvalidInput, listed
from hyperflex.interruption import interruptible
from hyperflex.model import LINK_PROPERTIES, Arm, Rope, Setup, SetupFields, swing_rate, unit_across, unit_along
from hyperflex.motion import Motion, motion_derivatives, motion_parameters
from hyperflex.simulation.rollouts import TABLES, Rollout, Watch, dataset_of, rollout_limits
from hyperflex.simulation.runs import observed, output_times, setup_of
from hyperflex.trajectory import DERIVED, VARIABLES

DIFFERENTIABLE = tuple(each.name for each in LINK_PROPERTIES if each.form)
STATE_NAMES = ("q0", "qd0")
# parts of a direction that a user gives
PARTS = (*STATE_NAMES, *DIFFERENTIABLE, "tip_mass", "gravity", "arm_length", "breaks", "coef")
# of a torque-driven arm, the chain's first link: its own names, and those of the links
ARM_NAMES = {
    **{f"arm.{each.name}": each.name for each in fields(Arm) if each.name in DIFFERENTIABLE},
    "arm_angle0": "q0",
    "arm_rate0": "qd0",
}
ParameterChange = dict[str, Array]
Wrt = Iterable[str | Mapping[str, Mapping[str, ArrayLike]]] | str
_MOMENTS = ("mass", "com", "inertia")  # they come in as moments about the joint
_SEED_OF = {
    each.name: getattr(tg, each.field.upper()) for each in LINK_PROPERTIES if each.form and each.name not in _MOMENTS
}
FAINT = 1e-300  # N m, kg/m^2: dry friction and drag that change no run, and are felt by its derivatives alone


@dataclass(frozen=True)
class ParameterDirections:
    """Directions of a derivative by name; each is a dict of changes per unit of its parameter, see PARTS."""

    names: tuple[str, ...]
    parts: tuple[ParameterChange, ...]

    def start(self, n: int) -> Array:
        """Derivatives of the start, angles above rates: (2 n, p), p even."""
        result = np.zeros((2 * n, self.width))
        for p, part in enumerate(self.parts):
            for row, name in enumerate(STATE_NAMES):
                if name in part:
                    result[row * n : (row + 1) * n, p] = part[name]
        return result

    @property
    def width(self) -> int:
        """Number of directions, padded to an even number."""
        return len(self.parts) + len(self.parts) % 2

    def lengths(self, n: int) -> Array:
        """Derivatives of the links' lengths (n, P), m."""
        return np.stack([part.get("length", np.zeros(n)) for part in self.parts], axis=1)

    def with_faint_terms(self, chain: Chain) -> Chain:
        """The chain, with FAINT dry friction or drag where a direction changes one that is zero."""
        for each in (each for each in LINK_PROPERTIES if each.least):
            now, faint = getattr(chain, each.field), np.zeros(chain.length.size)
            for part in self.parts:
                faint[part.get(each.name, faint) != 0.0] = FAINT
            if (faint > now).any():
                chain = chain._replace(**{each.field: np.maximum(now, faint)})
        return read_only(chain)

    def directions(self, chain: Chain, drive: Drive) -> Directions:
        """The same for the kernels, at the parameters of `chain` and for a drive."""
        n, pairs, pieces = chain.length.size, self.width // 2, len(drive.coef)
        links, whole = np.zeros((self.width, n, tg.SEEDS)), np.zeros((self.width, 3))
        driven = np.full(self.width, -1, dtype=np.int64)
        rows: list[ParameterChange] = []
        for p, part in enumerate(self.parts):
            _link_seeds(part, chain, links[p])
            whole[p, core.TIP_MASS] = part.get("tip_mass", np.zeros(1))[0]
            whole[p, core.GRAVITY_X : core.GRAVITY_Y + 1] = part.get("gravity", np.zeros(2))
            if part.keys() & {"breaks", "coef", "arm_length"}:
                driven[p] = len(rows)
                rows.append(part)
        # where joints may stick, events move in every direction, and then the base with them
        if can_stick(chain) and drive.coef[..., 1:].any():
            driven[driven < 0] = len(rows)
            rows.append({})
        breaks, coef, arm = (
            np.zeros((len(rows), pieces + 1)),
            np.zeros((len(rows), *drive.coef.shape)),
            np.zeros(len(rows)),
        )
        for m, part in enumerate(rows):
            breaks[m], coef[m] = part.get("breaks", 0.0), part.get("coef", 0.0)
            arm[m] = part.get("arm_length", np.zeros(1))[0]
        own = links.any(axis=(1, 2)) | ((driven >= 0) & drive.coef[:, TORQUE:].any())
        return Directions(
            links.reshape(pairs, 2, n, tg.SEEDS),
            whole,
            np.asarray(own.reshape(pairs, 2).any(axis=1)),
            driven,
            breaks,
            coef,
            arm,
        )


def _link_seeds(part: ParameterChange, chain: Chain, out: Array) -> None:
    """Write a direction's changes of a chain's links, in the kernels' own parameters, to out (n, SEEDS)."""
    for name, slot in _SEED_OF.items():
        if name in part:
            out[:, slot] = part[name]
    mass, com, inertia = (part.get(name, 0.0) for name in _MOMENTS)
    out[:, tg.MASS] = mass
    out[:, tg.MA] = chain.com * mass + chain.mass * com
    out[:, tg.INERTIA] = inertia + chain.com**2 * mass + 2.0 * chain.mass * chain.com * com


def parameter_directions(setup: Setup, wrt: Wrt) -> ParameterDirections:
    """Check what a user wants derivatives with respect to; see :func:`hyperflex.sensitivities`."""
    entries = list(wrt) if isinstance(wrt, Iterable) and not isinstance(wrt, (str, Mapping)) else [wrt]
    names: list[str] = []
    parts: list[ParameterChange] = []
    for entry in entries:
        if isinstance(entry, str):
            found = _by_name(setup, entry)
        elif isinstance(entry, Mapping):
            found = {name: _own(setup, name, part) for name, part in entry.items()}
        else:
            raise InvalidInput("wrt contains neither a name nor a mapping", got=entry, allowed=_allowed(setup))
        names += found
        parts += found.values()
    if not names:
        fix = "Say what to differentiate by, as wrt='friction' or wrt=['q0', 'tip_mass']"
        raise InvalidInput("wrt is empty", allowed=_allowed(setup), fix=fix)
    if len(set(names)) != len(names):
        raise InvalidInput("wrt names something twice", got=names, allowed="each name once")
    if setup.torque_driven:
        parts = [_with_arm(part, setup.rope.n_links) for part in parts]
    return ParameterDirections(tuple(names), tuple(parts))


def _with_arm(part: ParameterChange, n: int) -> ParameterChange:
    """A direction of the rope's n links, and of the arm, as one of a chain that begins with the arm."""
    joined: ParameterChange = {}
    for name, value in part.items():
        at, change = "arm.length" if name == "arm_length" else name, value
        if at in ARM_NAMES:
            at, change = ARM_NAMES[at], np.append(value, np.zeros(n))
        elif at in (*STATE_NAMES, *DIFFERENTIABLE):
            change = np.append(0.0, value)
        joined[at] = change + joined.get(at, 0.0)
    return joined


def _singles(setup: Setup) -> dict[str, str]:
    """Return the names of single numbers that derivatives can be with respect to, and what a direction calls them."""
    arm = {} if setup.arm is None else {"arm.length": "arm_length"}
    return {"tip_mass": "tip_mass", **arm, **({name: name for name in ARM_NAMES} if setup.torque_driven else {})}


def _drives(setup: Setup) -> dict[str, Motion]:
    """Return what drives the arm or the pivot, by the prefix of the names of its parameters."""
    return {name: each for name, each in (("motion", setup.motion), ("torque", setup.torque)) if each is not None}


def _allowed(setup: Setup) -> str:
    names = [*_singles(setup), "gravity[0]", "gravity[1]"]
    names += [f"{prefix}.{name}" for prefix, each in _drives(setup).items() for name in motion_parameters(each)[:8]]
    return (
        f"{', '.join((*STATE_NAMES, *DIFFERENTIABLE))} (of all links as one, name[3] of one, name[:] of each; q0 and "
        f"qd0 are always of each), {', '.join(names)}, or a mapping {{name: {{property: change}}}}"
    )


def _by_name(setup: Setup, name: str) -> dict[str, ParameterChange]:
    n, singles, drives = setup.rope.n_links, _singles(setup), _drives(setup)
    match = re.fullmatch(r"([a-z_0-9]+)(?:\[(\d+|:)\])?", name)
    base, index = match.groups() if match else (name, None)
    prefix, _, parameter = name.partition(".")
    if name in singles:
        return {name: {singles[name]: np.ones(1)}}
    if base == "gravity" and index in ("0", "1"):
        return {name: _gravity(setup, np.eye(2)[int(index)])}
    if prefix in drives and parameter:
        breaks, coef = motion_derivatives(drives[prefix], parameter)
        return {name: {"breaks": breaks, "coef": coef}}
    if base in DIFFERENTIABLE and index is None:
        return {name: {base: np.ones(n)}}
    if base in (*STATE_NAMES, *DIFFERENTIABLE):
        if index is None or index == ":":
            return {f"{base}[{i}]": {base: row} for i, row in enumerate(np.eye(n))}
        if int(index) < n:
            return {name: {base: np.eye(n)[int(index)]}}
    raise InvalidInput("wrt has an unknown name", got=name, allowed=_allowed(setup))


def _gravity(setup: Setup, change: Array) -> ParameterChange:
    """Direction of a change of gravity; it also changes the start where that is the rope at rest."""
    part = {"gravity": change}
    gx, gy = setup.rope.gravity
    if setup.q0 is None and (gx or gy):
        part["q0"] = np.full(setup.rope.n_links, (gx * change[1] - gy * change[0]) / (gx * gx + gy * gy))
    return part


def _own(setup: Setup, name: str, given: Mapping[str, ArrayLike]) -> ParameterChange:
    """Direction that the user gives as a mapping, checked."""
    n = setup.rope.n_links
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys((*STATE_NAMES, *DIFFERENTIABLE), (n,))
    shapes |= {"tip_mass": (1,), "gravity": (2,), "arm_length": (1,)}
    if setup.torque_driven:
        shapes |= dict.fromkeys(ARM_NAMES, (1,))
    for source in _drives(setup).values():
        shapes |= {"breaks": source.breaks.shape, "coef": source.coef.shape}
    if not isinstance(given, Mapping) or not given or set(given) - set(shapes):
        got = sorted(given) if isinstance(given, Mapping) else given
        raise InvalidInput(f"direction {name!r} cannot be used", got=got, allowed=", ".join(shapes))
    return {key: checks.array(f"{name}: {key}", value, shapes[key], scalar=True) for key, value in given.items()}


def check_smooth(setup: Setup) -> None:
    """Refuse set-ups whose runs have no derivative that the kernels know."""
    if setup.step is not None:
        raise InvalidInput("sensitivities follow the extrapolation", got=setup.step, fix="Leave the step out")
    if setup.pegs:
        raise InvalidInput("derivatives are of free flight", got="a set-up with obstacles", fix="Make one without")


if TYPE_CHECKING:
    import xarray as xr

LARGE = 1_000_000  # steps x links x directions, some tenths of a second's work, from which Ctrl-C is heard meanwhile
ON = np.zeros(1, dtype=np.int64)  # nothing halts what is short


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
        return f"Sensitivities({self.q.shape[1]} links, {self.t.size} samples, by {listed(self.names)})"

    @property
    def dataset(self) -> "xr.Dataset":
        """The same as an ``xarray.Dataset`` with the dimensions time, link, axis and parameter."""
        variables: dict[str, Any] = {"parameter": ("parameter", np.array(self.names))}
        for name, (dims, unit, _) in {**DERIVED, **VARIABLES}.items():
            if (value := getattr(self, name, None)) is not None:
                about = {"long_name": f"derivative of {name}", "units": f"{unit} per unit"}
                variables[name] = (("time", *dims), value, {"units": unit})
                variables[f"d{name}"] = (("time", *dims, "parameter"), getattr(self, f"d{name}"), about)
        return dataset_of(self.t, variables)


@interruptible()
def sensitivities(
    rope: Rope | Setup,
    motion: Motion | None = None,
    *,
    wrt: Wrt,
    t_eval: ArrayLike | None = None,
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
    Derivatives are those at fixed times, also if a switch of the motion moves with its parameter. At the instant of
    such a switch they are those before it. Equations (M.19)-(M.25) of docs/models.md; cost about as much as the run for
    two parameters, and a third of it for each further initial angle or rate.

    With dry friction they include each instant at which a joint sticks or slips, which also depends on the parameter.
    If the derivatives on two sides differ, those of the run's own modes are returned: for a joint at rest exactly at
    its limit, or at rest at the start and slipping from there; for joints that change at the same instant; for
    ``"dry_friction"`` of a joint that has none, towards more. A joint that sticks at the start stops a change of its
    rate at once, so after the start ``"qd0"`` moves both of its links equally.

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
    chain = directions.with_faint_terms(full.chain())
    links, count = chain.length.size, len(directions.names)
    memory.check(
        8.0 * 5 * (links + 1) * (count + 1) * t.size,
        f"derivatives of {links} links by {count} parameters at {t.size} outputs",
        "Ask for fewer outputs (t_eval=[...]) or parameters (wrt=[...])",
    )
    watch = Watch(time_budget, (0.0, full.duration))
    times = np.append([] if t[0] == 0.0 else 0.0, t)
    run = Rollout(full, times, chain=chain, limits=rollout_limits(full, chain, full.duration), logged=True)
    run.complete(watch)
    if (unbalanced := observed(run)[2]) is not None:
        raise unbalanced
    _, dy = forward_derivatives(run, directions, full.start(), times)
    return _labelled(full, chain, directions, t, run.y[-t.size :], dy[-t.size :])


class AngleJacobian:
    """Rollouts with derivatives for callers that need thousands: everything is checked once, here.

    Parameters
    ----------
    setup : Setup
        Rope, start and duration may be replaced in each call.
    wrt : str, mapping, or sequence of them
        As in :func:`sensitivities`; may be empty.
    most : int
        Number of changes of the start that a call may have.

    Notes
    -----
    The derivative of the computed run along each change of the start: what a matrix of all derivatives would make of
    it, without the matrix. A change costs as much as a column of that matrix, so a few of them are cheaper than all.
    """

    def __init__(self, setup: Setup, wrt: Wrt = (), most: int = 0) -> None:
        check_smooth(setup)
        self.setup, self.drive = setup, setup.drive()
        wanted = parameter_directions(setup, wrt) if wrt else ParameterDirections((), ())
        self.names = wanted.names
        self.wrt = ParameterDirections((*self.names, *most * ("change",)), (*wanted.parts, *most * ({},)))
        self._begin(setup.rope)

    def _begin(self, rope: Rope) -> None:
        """Make what follows from the rope alone."""
        arm = self.setup.arm
        self.rope = rope
        self.chain = self.wrt.with_faint_terms(arm.chain(rope) if arm and self.setup.torque_driven else rope.chain())
        self._limits = rollout_limits(self.setup, self.chain, 0.0)
        self._seeds, self._start = self.wrt.directions(self.chain, self.drive), self.wrt.start(self.chain.length.size)

    def __call__(
        self,
        t: Array,
        q0: Array,
        qd0: Array,
        rope: Rope | None = None,
        changes: Array | None = None,
        first_step: float = FIRST_STEP,
    ) -> tuple[Array, Array, Array, Array]:
        """Return angles and rates (T, n) and their derivatives (T, n, P + r) at times t (T,).

        Parameters
        ----------
        t : (T,) array
            Increasing times, s; the run starts at t[0].
        q0, qd0 : (n,) array
            Angles, rad, and rates, rad/s, at t[0]; a torque-driven arm is the first of n links, here and in the answer.
        rope : Rope, optional
            Another rope with as many links.
        changes : (r, 2 n) array, optional
            Changes of angles and rates at t[0], r <= most; the answer has what becomes of them after the derivatives.
        first_step : float
            Tried first, s.
        """
        if (rope or self.setup.rope) is not self.rope:
            self._begin(rope or self.setup.rope)
        n, used, pairs = self.chain.length.size, len(self.names), self.wrt.width // 2
        begin, seeds = self._start, self._seeds
        if changes is not None:
            first, used = used, used + len(changes)
            pairs = -(-used // 2)
            begin = begin[:, : 2 * pairs].copy()
            begin[:, first:used] = changes.T
            links, whole, parameters, driven, *rest = seeds
            seeds = Directions(links[:pairs], whole[: 2 * pairs], parameters[:pairs], driven[: 2 * pairs], *rest)
        limits = self._limits._replace(stop=float(t[-1]))
        run = Rollout(self.setup, t, (q0, qd0), chain=self.chain, drive=self.drive, limits=limits, logged=True)
        run.progress.clock[STEP] = first_step
        run.complete()
        _, dy = forward_derivatives(run, self.wrt, (q0, qd0), t, seeds, begin)
        y = run.y
        return y[:, :n], y[:, n : 2 * n], dy[:, :n, :used], dy[:, n:, :used]


def forward_derivatives(
    run: Rollout,
    directions: ParameterDirections,
    start: tuple[Array, Array],
    t: Array,
    seeds: Directions | None = None,
    changes: Array | None = None,
) -> tuple[Array, Array]:
    """Go through a logged run again: states (T, 2 n + 2) and their derivatives (T, 2 n, p) at times t (T,).

    The run began at t[0]. Within steps they are read off a polynomial; the run's own outputs differ from them by less
    than steps may err. `seeds` are the directions as the kernels take them, `changes` (2 n, p) those of the start,
    where they are at hand.
    """
    n, steps, times = run.chain.length.size, run.log, np.array(t)
    given = directions.start(n) if changes is None else changes
    seeds, used = seeds or directions.directions(run.chain, run.drive), given.shape[1]
    if steps.shape[1] > JOINT:
        seeds, given = core.with_step_length(seeds), np.pad(given, ((0, 0), (0, 2)))
    y, dy = np.zeros((times.size, 2 * n + 2)), np.zeros((times.size, *given.shape))
    y[0, :n], y[0, n : 2 * n] = start
    dy[:] = given
    if steps.size:
        begins = stiction_projection(run.chain, run.drive, times[0], y[0, :n], steps[0, MODES:], seeds, given)
        arguments = run.chain, run.drive, TABLES, steps, times[0], begins, seeds, times, y, dy
        _stoppable(lambda halt: core.forward_sensitivities(*arguments, halt), steps.shape[0] * given.size)
    return y, dy[:, :, :used]


def _stoppable(kernel: Callable[[Integers], None], size: int) -> None:
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


def _labelled(
    setup: Setup, chain: Chain, directions: ParameterDirections, t: Array, y: Array, dy: Array
) -> Sensitivities:
    """Add the tip to a run's states and derivatives, and name a torque-driven arm, the chain's first link."""
    n, p, own, drive = chain.length.size, len(directions.names), int(setup.torque_driven), setup.drive()
    q, qd, dq, dqd = y[:, :n], y[:, n : 2 * n], dy[:, :n, :p], dy[:, n:, :p]
    along, across = unit_along(q, 1), unit_across(q, 1)
    dtip = np.zeros((t.size, 2, directions.width))
    place_changes(drive, directions.directions(chain, drive), np.array(t), dtip)  # compiled for arrays of one kind
    dtip = dtip[:, :, :p] + chain.length * across @ dq + along @ directions.lengths(n)
    arm = (q[:, 0], qd[:, 0], dq[:, 0], dqd[:, 0]) if own else ()
    tip = setup.first_joint(t) + along @ chain.length
    return Sensitivities(t, q[:, own:], qd[:, own:], tip, directions.names, dq[:, own:], dqd[:, own:], dtip, *arm)


def stiction_projection(
    chain: Chain, drive: Drive, t: float, q: Array, modes: Array, directions: Directions, start: Array
) -> Array:
    """Derivatives of the state just after the start, where stuck joints turn with their parents.

    A joint within its limit that is given a little rate stops after a time in proportion to it. To first order that is
    an impulse on both links, whichever the sense: momenta are kept but for it.

    Parameters
    ----------
    t, q : float, (n,) float64
        Time, s, and angles, rad, at the start.
    modes : (n,) or (0,) float64
        Of the joints in the first step, 0.0 where one sticks; (0,): none may stick.
    start : (2 n, p) float64
        Derivatives of angles and rates as they are given.
    """
    n = q.size
    stuck = np.flatnonzero(modes == 0.0)
    if not stuck.size:
        return start
    turn = np.eye(n) - np.eye(n, k=-1)  # of each joint, by the rates of the links
    slip = turn[stuck] @ start[n:]
    if stuck[0] == 0:
        part, moved = segment(drive, t), np.zeros(CHANGES)
        for x, m in enumerate(directions.driven):
            if m >= 0:
                base_change(drive, part, t, 0.0, directions, m, moved)
                slip[0, x] -= moved[RATE]
    if not slip.any():
        return start
    mass = np.zeros((n, n))
    mass_matrix(chain, q, mass)
    reaction_factor = len(chain.reaction) - 1.0
    impulse = np.linalg.solve(mass, (np.eye(n) - reaction_factor * np.eye(n, k=-1))[stuck].T)
    result = start.copy()
    result[n:] -= impulse @ np.linalg.solve(turn[stuck] @ impulse, slip)
    return result


MOST_NUDGES = 1000
FINE = 1e-9  # of the rope's length: the tolerance of the run
LEAST = 1e-30  # factor by which a nudge shrinks at most between two times: of less nothing would be left


@dataclass(frozen=True, eq=False, repr=False)
class Predictability:
    """Growth of small errors along a run; made by :func:`predictability`.

    The size of an error is the largest displacement of a joint or, if larger, the largest change of a joint's velocity
    times the swing time sqrt(length / g), at most 1 s. An error that only oscillates therefore keeps its size.

    Attributes
    ----------
    t : (T,) float64
        Times, s.
    size : (m, T) float64
        Size of each perturbation relative to its initial size; 1 at t[0].
    displacement : (m, T) float64
        Largest displacement of a joint, in the same unit: at most `size`.
    tol : float
        Tolerance of the set-up, m.
    """

    t: Array
    size: Array
    displacement: Array
    tol: float

    def __repr__(self) -> str:
        worst = f"an error grows up to {float(self.growth.max()):.3g}-fold"
        return f"<Predictability over {self.t[0]:g} to {self.t[-1]:g} s, {len(self.size)} nudges: {worst}>"

    @property
    def growth(self) -> Array:
        """Largest displacement (T,) of any joint by any perturbation, in units of the initial perturbation."""
        return np.asarray(self.displacement.max(axis=0), dtype=np.float64)

    @property
    def amplification(self) -> Array:
        """Growth factor (T,) of the worst earlier error, at least 1."""
        since = self.displacement / np.minimum.accumulate(self.size, axis=1)
        return np.asarray(np.maximum(1.0, since.max(axis=0)), dtype=np.float64)

    def exponent(self, begin: float | None = None, end: float | None = None) -> float:
        """Return the largest finite-time Lyapunov exponent between two times, 1/s; by default of the whole run.

        If it is positive, errors grow by e in each 1/exponent seconds. Over a short time it includes the transient in
        which the perturbations turn into the direction of fastest growth: exclude the beginning if that matters.
        `begin` and `end`, s, are rounded to the nearest of `t`; InvalidInput if there is no time between them.
        """
        first, last = (
            int(np.argmin(np.abs(self.t - (default if at is None else checks.number(name, at, unit="s")))))
            for name, at, default in (("begin", begin, self.t[0]), ("end", end, self.t[-1]))
        )
        if first >= last:
            raise InvalidInput("no time lies between begin and end", got=[begin, end], allowed="begin < end, in s")
        ratios = self.size[:, last] / self.size[:, first]
        return float(np.log(ratios.max()) / (self.t[last] - self.t[first]))

    def horizon(self, allowed: float) -> float:
        """Return the time, s, up to which an error of `tol`, made anywhere on the way, stays below `allowed`, m.

        `allowed` is the largest acceptable displacement of a joint. Infinite if the error stays below it for the whole
        run; 0.0 if it is less than `tol`; InvalidInput if it is not a number > 0.
        """
        limit = checks.number("allowed", allowed, sign="positive", unit="m") / self.tol
        if limit < 1.0:
            return 0.0
        grown = self.amplification
        if not (grown > limit).any():
            return math.inf
        late = int(np.argmax(grown > limit))
        before, after = np.log(grown[late - 1 : late + 1])  # between two times errors grow by powers
        part = (math.log(limit) - before) / (after - before)
        return float(self.t[late - 1] + part * (self.t[late] - self.t[late - 1]))


@interruptible()
def predictability(
    rope: Rope | Setup,
    motion: Motion | None = None,
    *,
    nudges: int = 3,
    seed: int = 0,
    sample_time: float = 0.05,
    **setup: Unpack[SetupFields],
) -> Predictability:
    """Measure the growth of small errors along a run, and thereby the time for which it is predictable.

    Parameters
    ----------
    rope, motion, **setup
        As in :func:`hyperflex.simulate`. `tol` is the initial error, m, of :meth:`Predictability.horizon`.
    nudges : int
        Number of perturbations, random changes of all angles and rates.
    seed : int
        For the nudges.
    sample_time : float
        Time between two renormalisations, s, and between the times of the result.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.
    SimulationError
        If the run fails.

    Notes
    -----
    The tolerance of the run is 1e-9 of the rope's length. The perturbations are infinitesimal: exact derivatives of the
    computed run, as of :func:`hyperflex.sensitivities`. Every `sample_time` each is rescaled to its initial size in its
    current direction (Benettin et al. 1980, doi:10.1007/BF02128236). This is an estimate: a few perturbations may miss
    a short growth. The run is in free flight: obstacles are refused.

    Examples
    --------
    >>> import hyperflex as hf
    >>> rods = hf.Rope(length=[0.5, 0.5], mass=[0.1, 0.1])
    >>> growth = hf.predictability(rods, duration=4.0, q0=[3.0, 2.5], tol=1e-6)
    >>> bool(growth.exponent() > 1.0), bool(growth.horizon(1e-3) < 4.0)
    (True, True)
    """
    full, _ = setup_of(rope, {**setup, "motion": motion})
    count = checks.count("nudges", nudges, most=MOST_NUDGES)
    rng = np.random.default_rng(checks.count("seed", seed, least=0))
    spacing = checks.number("sample_time", sample_time, sign="positive", unit="s")
    fine = replace(full, tol=FINE * full.rope.total_length, step=None)
    run = AngleJacobian(fine, most=count)
    t = np.linspace(0.0, full.duration, max(2, math.ceil(full.duration / spacing - 1e-9) + 1))
    (q, qd), changes = full.start(), _first_nudges(full, count, rng)
    size, displacement = np.ones((count, t.size)), np.ones((count, t.size))
    for k in range(1, t.size):
        (*_, q), (*_, qd), dq, dqd = run(t[k - 1 : k + 1], q, qd, changes=changes.reshape(count, 2 * q.size))
        changes = np.stack([dq[-1].T, dqd[-1].T], axis=1)
        moved, hastened = _displaced(full, q, changes).T
        grown = np.maximum(np.maximum(moved, hastened), LEAST)
        displacement[:, k], size[:, k] = size[:, k - 1] * moved, size[:, k - 1] * grown
        changes /= grown[:, None, None]
    return Predictability(t, size, displacement, full.tol)


def _displaced(setup: Setup, q: Array, changes: Array) -> Array:
    """Displacement of the worst joint (..., 2), m, by small changes (..., 2, n) of angles, and of rates in a swing."""
    swing_time = 1.0 / max(1.0, swing_rate(setup.rope))
    across = setup.chain().length[:, None] * unit_across(q)
    places = np.cumsum(changes[..., None] * across, axis=-2)
    return np.asarray(np.linalg.norm(places, axis=-1).max(axis=-1) * [1.0, swing_time])


def _first_nudges(setup: Setup, count: int, rng: np.random.Generator) -> Array:
    """Random changes (count, 2, n) of all angles and rates, each of the size 1."""
    q = setup.start()[0]
    changes = rng.normal(0.0, 1.0, (count, 2, q.size))
    return changes / _displaced(setup, q, changes)[..., None]
