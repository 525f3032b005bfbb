"""Batch rollouts: members in SIMD lanes, or one by one with contact, on threads or on an executor."""

import math
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, memory
from hyperflex.budget import Budget, OutOfTime
from hyperflex.checks import Array, Integers
from hyperflex.core import status
from hyperflex.core.batch import rollouts as core
from hyperflex.core.batch.rollouts import DRY, LENGTH, LEVER, Members, Terms, observe_block
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import Drive
from hyperflex.core.chain.lanes import MEMBERS
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.core.integrate.steps import scheme
from hyperflex.errors import InvalidInput
from hyperflex.executor import checked_chunks, run_chunks
from hyperflex.interruption import Stop, interruptible, stoppable
from hyperflex.model import DEFAULT_TOL, Arm, Obstacle, Rope, Setup, SetupFields, checked_obstacles, unit_along
from hyperflex.motion import Motion
from hyperflex.progress import progress_bar
from hyperflex.simulation.contact import check_start
from hyperflex.simulation.rollouts import Interval, balanced, dataset_of, lever, status_of, stored
from hyperflex.simulation.runs import motor_torque, output_times, setup_of, simulate
from hyperflex.simulation.stepper import COMMANDS, arm_polynomials, setup_for
from hyperflex.status import Status
from hyperflex.trajectory import DERIVED, OPTIONAL, VARIABLES, Trajectory, swept

MOST_MEMBERS = 1_000_000
# Order by tolerance, m: where lanes are full, an order costs p (p + 1) / 2 sweeps, so few cheap columns beat the high
# order that a lone rollout gets for nothing.
ORDERS = ((2e-6, 4), (1e-7, 5), (1e-8, 6), (0.0, 7))
INITIAL_CLOCK = (FIRST_STEP, np.inf, 0.0)  # clock of a member that begins, see Members


class BatchFields(SetupFields, total=False):
    """Fields of a set-up that :func:`simulate_batch` takes, and what it does with all members."""

    refine: bool
    stiction_tolerance: float


def setups_of(
    ropes: Rope | Sequence[Rope], motions: Motion | Sequence[Motion] | None = None, **fields: Unpack[BatchFields]
) -> list[Setup]:
    """Return the set-up of each member.

    Ropes, motions, pegs, and q0 and qd0 of the ropes before they are cut, are one for all members, or one each; other
    `fields` of a set-up are the same for all.
    """
    common: dict[str, Any] = dict(fields)
    refine = checks.flag("refine", common.pop("refine", True))
    pegs = checks.sequence("pegs", common.pop("pegs", ()), "Peg, Wall and Ground, or a list of these for each member")
    if any(isinstance(each, Obstacle) for each in pegs):
        pegs = [pegs]
    starts = [common.pop(name, None) for name in ("q0", "qd0")]
    rows = [[None] if each is None else _rows(checks.array("q0 or qd0", each, None)) for each in starts]
    obstacles = [checked_obstacles(each) for each in pegs] or [()]
    every: list[list[Any]] = [_each("ropes", ropes, Rope), _each("motions", motions, Motion), obstacles, *rows]
    counts = [len(each) for each in every]
    count = max(counts)
    if 0 in counts or set(counts) - {1, count}:
        what = "ropes, motions, pegs, q0 and qd0 do not fit together"
        raise InvalidInput(what, got=counts, allowed="one for all members, or as many of each")
    for rope in every[0]:
        checks.instance("rope of a member", rope, Rope)
    _alike("links or friction model", {(rope.n_links, rope.friction_model) for rope in every[0]})
    _alike("number of pegs", {len(each) for each in obstacles})

    def member(m: int) -> Setup:
        rope, motion, pegs, q0, qd0 = (each[m % len(each)] for each in every)
        parts = {"motion": motion, "pegs": pegs, "q0": q0, "qd0": qd0}
        return setup_of(rope, {**common, **parts}, refine=refine)[0]

    return [member(m) for m in range(count)]


def _rows(values: Array) -> list[Any]:
    """Return the values of each member; those of a number, or of one row, are the same for all."""
    return list(values) if values.ndim > 1 else [values]


def _each(name: str, given: object, kind: type) -> list[Any]:
    """Return what members have each; one entry if it is the same for all."""
    if given is None or isinstance(given, kind):
        return [given]
    return checks.sequence(name, given, f"a {kind.__name__}, or one for each member")


def _alike(what: str, found: set[Any]) -> None:
    if len(found) > 1:
        fix = "Run one batch for each kind"
        raise InvalidInput(
            f"members of a batch differ in {what}", got=sorted(found), allowed="the same for all", fix=fix
        )


def starts_of(setups: Sequence[Setup]) -> Array:
    """Return the start of each member (M, 2 n + 2): angles, rates, no work and nothing lost."""
    starts = np.array([np.concatenate(setup.start()) for setup in setups])
    return np.pad(starts, ((0, 0), (0, 2)))


def members_of(setups: Sequence[Setup], drives: list[Drive]) -> Members:
    """Return chains, drives and starts of the members as kernel arrays."""
    if any(setup.torque is not None and setup.torque.joints > 1 for setup in setups):
        raise InvalidInput(
            "a batch knows the motor of the first joint alone",
            got="torques of several joints",
            fix="Give a torque_profile with one column, or simulate the members one by one",
        )
    chains = [setup.chain() for setup in setups]
    rows = np.concatenate([each for chain in chains for each in chain[:LEVER]]).reshape(len(chains), LEVER, -1)
    together = Chain(*rows.swapaxes(0, 1), *chains[0][LEVER:])  # their links, as those of one chain
    links = np.concatenate([rows, lever(together)[:, None]], axis=1)
    whole = np.array(
        [[c.tip_mass, c.gx, c.gy, d.arm_length, d.torque_limit] for c, d in zip(chains, drives, strict=True)]
    )
    links.setflags(write=False)  # as those of a chain
    padding = np.zeros((1, *drives[0].coef.shape[1:]))
    return Members(
        links,
        whole,
        starts_of(setups),
        np.concatenate([d.breaks for d in drives]),
        np.concatenate([part for d in drives for part in (d.coef, padding)]),
        np.ones(sum(d.breaks.size for d in drives), dtype=np.bool_),
        np.array([d.loop for d in drives]),
        np.concatenate([[0], np.cumsum([d.breaks.size for d in drives])]),
        np.tile(INITIAL_CLOCK, (len(chains), 1)),
    )


def terms_of(setup: Setup, step: float = 0.0, stiction_tolerance: float = 0.0) -> Terms:
    """Return what all members have in common: the tolerance of one's set-up, or a chosen `step`, s; see Terms."""
    table = scheme(next(order for least, order in ORDERS if setup.tol >= least))
    weights = table.best, table.gaps[0], table.rounding
    return Terms(0.0, setup.tol, setup.chain().reaction, step, *weights, stiction_tolerance)


if TYPE_CHECKING:
    import xarray as xr

# Members of a block: at least BLOCKS blocks a thread, to balance the load and to be interrupted; not more than keep the
# states in work below some megabytes; not fewer than keep the lanes full, since the last ones of a block run alone.
BLOCKS = 2
LARGEST_BLOCK = 16 * len(MEMBERS)
STATES = 1e6  # numbers that a block may hold in work
CHUNK, CONTACT_CHUNK = 64, 4  # members of a chunk on an executor
# Part of the time left that a member with contact may take while others wait: one that never ends must not lose them.
PART_OF_A_MEMBER = 0.5
_SHARED = (
    "tip",
    "q",
    "qd",
    "motor_torque",
    "motor_work",
    "dissipated_energy",
    "peg_angle",
    "peg_rate",
)  # with a Trajectory
# name: (dimensions after member and time, units, long name)
KEPT: dict[str, tuple[tuple[str, ...], str, str]] = {
    **{name: {**DERIVED, **VARIABLES, **OPTIONAL}[name] for name in _SHARED},
    "turns": (("peg",), "1", "signed turns about a peg from the first joint to the tip"),
}


@dataclass(frozen=True, eq=False, repr=False)
class Batch:
    """Results of many rollouts; row m belongs to member m.

    Attributes
    ----------
    t : (T,) float64
        Output times, s.
    values : dict of str to array
        Kept quantities, each (M, T, ...); NaN after a member failed.
    status : tuple of Status
        How each member ended, (M,).
    reached : (M,) float64
        Time that each member reached, s.
    """

    t: Array
    values: dict[str, Array]
    status: tuple[Status, ...]
    reached: Array

    def __getattr__(self, name: str) -> Array:
        values = self.__dict__.get("values", {})  # empty while a copy is being made
        if name not in values:
            raise AttributeError(f"{name!r} was not kept; kept: {', '.join(values)}")
        return np.asarray(values[name])

    def __repr__(self) -> str:
        counts = ", ".join(f"{self.status.count(name)} {name}" for name in dict.fromkeys(self.status))
        times = f"{self.t.size} time{'s' * (self.t.size > 1)} to {self.t[-1]:g} s"
        return f"<Batch of {len(self.status)} members: {counts}; {times}; kept: {', '.join(self.values)}>"

    @property
    def success(self) -> bool:
        """Whether all members finished."""
        return not self.failed

    @property
    def message(self) -> str:
        """How many members failed, and why the first did; empty if none did."""
        return f"{len(self.failed)} of {len(self.status)} failed; {self.why(self.failed[0])}" if self.failed else ""

    @property
    def failed(self) -> list[int]:
        """Numbers of the members that did not finish."""
        return [m for m, name in enumerate(self.status) if name is not Status.SUCCESS]

    def why(self, member: int) -> str:
        """Return the reason of a member's failure, and advice; empty without failure."""
        if not -len(self.status) <= member < len(self.status):
            raise InvalidInput("no such member", got=member, allowed=f"0 to {len(self.status) - 1}")
        name = self.status[member]
        if name is Status.SUCCESS:
            return ""
        advice = {text: status.ADVICE[code] for code, text in status.NAMES.items()}.get(name, "")
        return f"stopped at t = {self.reached[member]:.6g} s ({name})" + (advice and f": {advice}.")

    @property
    def dataset(self) -> "xr.Dataset":
        """The batch as an ``xarray.Dataset`` with the dimensions member, time, link and axis."""
        variables: dict[str, Any] = {
            name: (("member", "time", *KEPT[name][0]), value, {"units": KEPT[name][1], "long_name": KEPT[name][2]})
            for name, value in self.values.items()
        }
        variables["status"] = ("member", np.array(self.status, dtype=str))
        variables["reached"] = ("member", self.reached, {"units": "s", "long_name": "time reached"})
        return dataset_of(self.t, variables)


@interruptible(Batch)
def simulate_batch(
    ropes: Rope | Sequence[Rope],
    motions: Motion | Sequence[Motion] | None = None,
    *,
    t_eval: ArrayLike | None = None,
    keep: Sequence[str] = ("tip",),
    time_budget: float | Budget | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    chunk_size: int | None = None,
    progress: bool = False,
    **setup: Unpack[BatchFields],
) -> Batch:
    """Simulate many ropes, motions or initial states at once.

    Parameters
    ----------
    ropes : Rope or sequence of Rope
        One for all members, or one each. All must have the same number of links and friction model.
    motions : Motion or sequence of Motion, optional
        One for all members, or one each.
    t_eval : (T,) array_like, optional
        Times of the output, s, from 0 on; by default only the end: give ``np.linspace(0.0, duration, 101)`` for the
        course. A step ends at each of them.
    keep : sequence of {"tip", "q", "qd", "motor_torque", "motor_work", "dissipated_energy", "turns", ...}
        Quantities to keep; memory is (M, T) times this, in addition to the blocks being computed. Turns are those about
        each round peg; ``"peg_angle"`` and ``"peg_rate"`` are the others. For a whole trajectory of one member,
        simulate it: ``simulate(ropes[m], motions[m], t_eval=batch.t, ...)``.
    time_budget : float or Budget, optional
        Wall-clock time for all members, s; those that are not finished then have the status "out of time". A member
        with pegs or joint limits may use half of the remaining time while others wait. By default the only limit is
        that of :func:`simulate` for each such member.
    threads : int, optional
        By default one per processor, or one in each worker of an executor. Results do not depend on it.
    executor : concurrent.futures.Executor, optional
        Where chunks of members are run: processes, or other machines (``docs/how-to/many-machines.md``). Results do not
        depend on it. Members whose chunk kills each worker that runs it have the status "worker lost".
    chunk_size : int, optional
        Members of a chunk; by default CHUNK, with contact CONTACT_CHUNK.
    progress : bool
        Show a progress bar on standard error.
    **setup
        Fields of :class:`hyperflex.Setup`, the same for all members unless stated otherwise: ``duration`` (required),
        ``arm``, ``tol``, ``contact_step``; ``q0`` and ``qd0`` (n,), or (M, n) for each member; ``pegs``, or a sequence
        of pegs for each member, the same number for all. Members with pegs or with joint limits run one by one, as
        :func:`hyperflex.simulate` runs them. The energy account does not shorten the steps of other members; it is
        checked at the outputs. ``step``, s, is a fixed step without error control, not with pegs. ``refine`` is as in
        :func:`hyperflex.simulate`; if ropes are cut into different numbers of links, ``q`` and ``qd`` end in NaN.
        ``stiction_tolerance``, rad/s, regularizes dry friction, not with pegs or joint limits: a joint that would stick
        creeps at x / sqrt(1 - x^2) times this relative rate, where its friction is x times ``dry_friction``. Flights of
        ropes with many dry joints are several times as fast, since no joint that sticks or slips ends a step.

    Returns
    -------
    Batch
        A member that fails is reported in ``status``; the others are valid.

    Raises
    ------
    InvalidInput
        If an argument cannot be used, the members do not fit together, or the results do not fit into the memory.
    Interrupted
        By Ctrl-C. Its ``partial`` is the batch with the finished members; others have the status "interrupted".

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> rests = [0.3, 0.4, 0.5, 0.6]
    >>> batch = hf.simulate_batch(cable, [hf.arm_swings(t_rest=r) for r in rests], arm=hf.Arm(), duration=5.0)
    >>> batch.tip.shape
    (4, 1, 2)
    """
    names_kept = checks.sequence("keep", keep, f"names among {', '.join(KEPT)}")
    keep = tuple(checks.choice("keep", name, tuple(KEPT)) for name in names_kept)
    threads = None if threads is None else checks.count("threads", threads, most=checks.MOST_THREADS)
    step = None if setup.get("step") is None else checks.number("step", setup.pop("step"), sign="positive", unit="s")
    slow = setup.pop("stiction_tolerance", 0.0)
    slow = checks.number("stiction_tolerance", slow, sign="nonnegative", unit="rad/s")
    setups = setups_of(ropes, motions, **setup)
    if not setups[0].pegs and any("peg" in KEPT[name][0] for name in keep):
        raise InvalidInput("turns are about pegs, and there are none", got=keep, fix="Give pegs=[Peg(...)]")
    t = output_times([setups[0].duration] if t_eval is None else t_eval, 0.0, setups[0].duration)
    if t[-1] == 0.0:
        raise InvalidInput("t_eval is the start alone", got=t.tolist(), allowed="also a time after it, in s")
    touches = any(each.touches for each in setups)
    if touches and step is not None:
        raise InvalidInput("step is not available with pegs or joint limits", got=step, fix="Give contact_step or tol")
    if touches and slow > 0.0:
        raise InvalidInput("stiction_tolerance is not available with pegs or joint limits", got=slow, allowed="0.0")
    executor, size = checked_chunks(executor, chunk_size, CONTACT_CHUNK if touches else CHUNK)
    results = _Results(setups, t, keep)
    limit = None if time_budget is None else Budget.of(time_budget)
    run = _in_contact if touches else partial(_in_flight, step=step or 0.0, stiction_tolerance=slow)
    with progress_bar(0, len(setups), checks.flag("progress", progress), unit="members") as report:
        if executor is None:
            return results.batch(run(setups, results, limit, threads or Budget.of(limit).threads, report))
        end = None if limit is None else time.time() + limit.remaining

        def done(low: int, part: Batch) -> None:
            results.put(low, part.values, part.status, part.reached)
            if report is not None:
                report(low + len(part.status))

        with stoppable() as stop:
            for lost in run_chunks(partial(_chunk, run, t, keep, end, threads or 1), setups, executor, size, done):
                results.status[lost.start : lost.stop] = [Status.WORKER_LOST] * len(lost)
    return results.batch(stop)


class _Results:
    """Results of a batch, filled in as members finish; a batch that would not fit into the memory is refused."""

    def __init__(self, setups: Sequence[Setup], t: Array, keep: tuple[str, ...]) -> None:
        count = len(setups)
        sizes = {"link": max(each.rope.n_links for each in setups), "axis": 2, "peg": len(setups[0].round_pegs)}
        shapes = {name: (count, t.size, *(sizes[dim] for dim in KEPT[name][0])) for name in keep}
        memory.check(
            8.0 * sum(map(math.prod, shapes.values())),
            f"a batch of {count} members with {t.size} outputs of {', '.join(keep)}",
            "Ask for fewer outputs (t_eval=[...]), keep less of them (keep=[...]), or take fewer members at once",
        )
        self.t, self.values = t, {name: np.full(shape, np.nan) for name, shape in shapes.items()}
        self.status: list[Status | None] = [None] * count
        self.reached = np.zeros(count)

    def put(self, low: int, values: Mapping[str, Array], status: Sequence[Status | None], reached: ArrayLike) -> None:
        """Set the results of the members from `low` on; their values may have fewer times or links."""
        rows = slice(low, low + len(status))
        self.status[rows], self.reached[rows] = status, reached
        for name, value in values.items():
            self.values[name][(rows, *map(slice, value.shape[1:]))] = value

    def batch(self, stop: Stop) -> Batch:
        """Return the batch; raise Interrupted with it if the user interrupted the work."""
        early = stop.status or Status.INTERRUPTED
        return stop.deliver(Batch(self.t, self.values, tuple(each or early for each in self.status), self.reached))


Run = Callable[[Sequence[Setup], _Results, Budget | None, int, Callable[[float], None] | None], Stop]


def _chunk(run: Run, t: Array, keep: tuple[str, ...], end: float | None, threads: int, setups: list[Setup]) -> Batch:
    """Run members in a process of an executor until `end`, s, by the clock that machines share (``time.time``)."""
    results = _Results(setups, t, keep)
    limit = None if end is None else Budget(end - time.time())
    return results.batch(run(setups, results, limit, threads, None))


def _in_contact(
    setups: Sequence[Setup],
    results: _Results,
    limit: Budget | None,
    threads: int,
    report: Callable[[float], None] | None = None,
) -> Stop:
    """Run members with pegs or with joint limits in this process, one by one on threads."""
    for m, setup in enumerate(setups):
        check_start(setup, who=f"the rope of member {m}")

    def one(m: int, _: int) -> None:
        waiting = m + threads < len(setups)  # for one of these threads
        own = limit.share(PART_OF_A_MEMBER) if limit and waiting else limit
        run = simulate(setups[m], t_eval=results.t, throw=False, time_budget=own)
        results.put(m, {name: _kept(run, name)[None] for name in results.values}, [run.status], [run.state.t])

    return run_blocks(one, 1, len(setups), threads, Budget.of(limit), report)


def _in_flight(
    setups: Sequence[Setup],
    results: _Results,
    limit: Budget | None,
    threads: int,
    report: Callable[[float], None] | None = None,
    *,
    step: float,
    stiction_tolerance: float,
) -> Stop:
    """Run members in free flight in this process: blocks of them in SIMD lanes, on threads."""
    members = members_of(setups, [setup.drive() for setup in setups])
    terms = terms_of(setups[0], step, stiction_tolerance * members.links[:, DRY].any())
    t, first = results.t, int(results.t[0] == 0.0)  # 1: the start is the first sample
    after, times = t[first:].copy(), t if first else np.append(terms.begin, t)
    n, width = members.links.shape[2], members.start.shape[1]
    columns: dict[str, Any] = {"q": slice(0, n), "qd": slice(n, 2 * n), "motor_work": 2 * n, "dissipated_energy": -1}
    halt = np.zeros(1, dtype=np.int64)  # 1: running blocks end where they are

    def block(low: int, high: int) -> None:
        rows, count = slice(low, high), high - low
        y = np.full((count, after.size, width), np.nan)
        codes, reached = np.full(count, -1), np.zeros(count)
        core.run_block(members, terms, low, high, after, y, codes, reached, halt)
        states = np.concatenate([members.start[rows, None], y], axis=1)
        energies, joint = np.empty((4, count, times.size)), np.empty((count, times.size, 2))
        observe_block(members, terms, low, high, times, states, energies[0], energies[1], joint)
        energies[2], energies[3] = states[:, :, 2 * n], states[:, :, 2 * n + 1]
        good = balanced(setups[rows], energies, lambda m: stored(setups[low + m].chain(), states[m, :, :n]))
        for m in np.flatnonzero((codes == status.OK) & (good < times.size)):
            codes[m], reached[m] = status.ENERGY, times[good[m]]
            states[m, good[m] :] = np.nan
        shown = states[:, 1 - first :]
        values = {name: shown[:, :, columns[name]] for name in results.values if name in columns}
        if "motor_torque" in results.values:
            torques = [motor_torque(setups[low + m], t, np.ascontiguousarray(shown[m])) for m in range(count)]
            values["motor_torque"] = np.array(torques)
        if "tip" in results.values:
            reach = members.links[rows, LENGTH][:, None, None] * unit_along(shown[:, :, :n], 2)
            values["tip"] = joint[:, 1 - first :] + reach.sum(axis=3)
        # members that were halted have no code
        results.put(low, values, [status_of(code) if code >= 0 else None for code in codes.tolist()], reached)

    even = -(-len(setups) // (threads * BLOCKS * len(MEMBERS))) * len(MEMBERS)
    held = int(STATES / (t.size * width)) // len(MEMBERS) * len(MEMBERS)
    size = max(len(MEMBERS), min(even, LARGEST_BLOCK, held))
    return run_blocks(block, size, len(setups), threads, Budget.of(limit), report, halt)


def run_blocks(
    block: Callable[[int, int], None],
    size: int,
    count: int,
    threads: int,
    budget: Budget,
    report: Callable[[float], None] | None = None,
    halt: Integers | None = None,
) -> Stop:
    """Run a function for the members low..high - 1 of each block of `size`, until all `count` are done.

    After an interrupt, and once the budget is spent, blocks that have not begun are omitted, and `halt` (1,), if given,
    is set to 1 for those that are running. Returns whether and why that happened.
    """
    with stoppable() as stop, ThreadPoolExecutor(threads) as pool:
        futures: list[Future[None]] = []
        try:
            budget.check()
            spans = [(low, min(low + size, count)) for low in range(0, count, size)]
            futures += (pool.submit(block, *span) for span in spans)
            for (_, high), future in zip(spans, futures, strict=True):
                while not future.done():
                    wait([future], timeout=min(max(budget.remaining, 1e-3), 1.0))
                    if not future.done():
                        budget.check()
                future.result()
                if report is not None:
                    report(high)
        except (KeyboardInterrupt, OutOfTime):
            if halt is not None:
                halt[0] = 1
            for future in futures:
                future.cancel()
            raise
    return stop


def _kept(run: Trajectory, name: str) -> Array:
    """Return one of the quantities that a batch keeps (T, ...)."""
    pegs = run.setup.round_pegs
    if name == "turns":
        away = [run.joints - peg.point for peg in pegs]
        return np.stack([swept(each).sum(axis=1) for each in away], axis=1) / (2.0 * np.pi)
    value = getattr(run, name)
    return np.zeros((run.t.size, len(pegs))) if value is None else np.asarray(value)


ROWS = ("q", "qd", "arm_angle", "arm_rate", "work", "dissipated", "codes", "memory")  # of a state, a row each member


@dataclass(frozen=True, eq=False)
class BatchState:
    """State of the members of a batch; row m belongs to member m.

    Attributes
    ----------
    t : float
        Time, s.
    q, qd : (M, n) float64
        Absolute link angles, rad, and rates, rad/s; NaN of a member that has failed.
    arm_angle, arm_rate : (M,) float64
        Of the arms, rad and rad/s.
    work, dissipated : (M,) float64
        Motor work and friction loss since the start, J.
    codes : (M,) int64
        Status codes; :attr:`status` has their names.
    memory : (M, 3) float64
        Memory of the integrator.
    """

    t: float
    q: Array
    qd: Array
    arm_angle: Array
    arm_rate: Array
    work: Array
    dissipated: Array
    codes: Integers
    memory: Array

    def __post_init__(self) -> None:
        for name in ROWS:
            if isinstance(value := getattr(self, name), np.ndarray):
                value.setflags(write=False)

    @property
    def status(self) -> tuple[Status, ...]:
        """Status of each member (M,): SUCCESS, or how it failed."""
        return tuple(map(status_of, self.codes.tolist()))


class BatchStepper:
    """:class:`hyperflex.Stepper` for many members at once, without pegs and joint limits.

    Parameters
    ----------
    ropes : Rope or sequence of Rope
        One for all members, or one each, with the same number of links and friction model.
    members : int, optional
        Number of members, where there is one rope for all.
    arm : Arm
        The arm of each.
    command : {"acceleration", "angle", "torque"}
        As of :class:`hyperflex.Stepper`.
    tol : float
        As in :func:`hyperflex.simulate_batch`, m.
    threads : int, optional
        By default one per processor. Results do not depend on it.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.

    Notes
    -----
    Each of your threads needs its own stepper, because a stepper works in its own arrays.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=20, radius=0.0025, friction=2e-4)
    >>> stepper = hf.BatchStepper(cable, members=4, arm=hf.Arm())
    >>> state = stepper.step(stepper.start(), [0.0, 1.0, 2.0, 3.0], dt=0.02)
    >>> state.arm_rate.round(3).tolist()
    [0.0, 0.02, 0.04, 0.06]
    """

    def __init__(
        self,
        ropes: Rope | Sequence[Rope],
        *,
        members: int | None = None,
        arm: Arm | None = None,
        command: str = "acceleration",
        tol: float = DEFAULT_TOL,
        threads: int | None = None,
    ) -> None:
        self.command = checks.choice("command", command, tuple(COMMANDS))
        if isinstance(ropes, Rope) and members is not None:
            ropes = [ropes] * checks.count("members", members, most=MOST_MEMBERS)
        self._common: BatchFields = {"duration": 1.0, "arm": arm, "tol": tol}
        setups = self._setups(ropes)
        if members not in (None, len(setups)):
            raise InvalidInput("members and ropes do not fit together", got=members, allowed=f"{len(setups)}")
        self.setups = tuple(setups)
        self._own = int(command == "torque")
        self._members, self._terms = members_of(setups, _intervals(setups)), terms_of(setups[0])
        self._stop = np.zeros(1, dtype=np.int64)
        self._threads, workers = threads, Budget(threads=threads).threads
        size = -(-len(setups) // (workers * len(MEMBERS))) * len(MEMBERS)
        self._blocks = [(low, min(low + size, len(setups))) for low in range(0, len(setups), size)]
        self._pool = ThreadPoolExecutor(len(self._blocks)) if len(self._blocks) > 1 else None
        if self._pool is not None:
            weakref.finalize(self, self._pool.shutdown, wait=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy or pickle the arguments alone: threads cannot be, and kernels are compiled for read-only arrays."""
        first = self.setups[0]
        common: dict[str, Any] = {"arm": first.arm, "command": self.command, "tol": first.tol, "threads": self._threads}
        return partial(type(self), **common), ([setup.rope for setup in self.setups],)

    def start(
        self,
        q0: ArrayLike | None = None,
        qd0: ArrayLike | None = None,
        *,
        arm_angle: ArrayLike = 0.0,
        arm_rate: ArrayLike = 0.0,
        t: float = 0.0,
    ) -> BatchState:
        """Return a state to begin with, as :meth:`hyperflex.Stepper.start` does; by default the ropes hang at rest.

        q0 and qd0 are (n,) or (M, n), arm_angle and arm_rate numbers or (M,): for all members, or of each; t in s.
        """
        setups = self._setups([setup.rope for setup in self.setups], q0=q0, qd0=qd0)
        return self._begin(setups, arm_angle, arm_rate, t)

    def restart(
        self,
        state: BatchState,
        which: ArrayLike,
        ropes: Rope | Sequence[Rope] | None = None,
        q0: ArrayLike | None = None,
        qd0: ArrayLike | None = None,
        *,
        arm_angle: ArrayLike = 0.0,
        arm_rate: ArrayLike = 0.0,
    ) -> BatchState:
        """Return the state with some members restarted, also failed ones; time continues for all.

        Parameters
        ----------
        state : BatchState
        which : (K,) array_like of int, or (M,) of bool
            The members. With none, the state is returned as it is.
        ropes : Rope or sequence of Rope, optional
            New ropes for them, one or one each. The stepper keeps them: earlier states also continue with the new
            ropes.
        q0, qd0, arm_angle, arm_rate
            Of these members, as in :meth:`start`.

        Raises
        ------
        InvalidInput
            If an argument cannot be used; the stepper is then as before.
        """
        self._check(state)
        chosen = _members(which, len(self.setups))
        if not chosen.size:
            return state
        given = [self.setups[m].rope for m in chosen] if ropes is None else ropes
        given = [given] * chosen.size if isinstance(given, Rope) else list(given)
        kind = self.setups[0].rope.n_links, self.setups[0].rope.friction_model
        if len(given) != chosen.size or any((rope.n_links, rope.friction_model) != kind for rope in given):
            allowed = f"{chosen.size} ropes of {kind[0]} links and the batch's friction model"
            raise InvalidInput("ropes do not fit the members", got=[rope.n_links for rope in given], allowed=allowed)
        setups = self._setups(given, q0=q0, qd0=qd0)
        new = self._begin(setups, arm_angle, arm_rate, state.t)
        if ropes is not None:
            rows = members_of(setups, _intervals(setups))
            links = self._members.links.copy()
            links[chosen], self._members.whole[chosen] = rows.links, rows.whole
            links.setflags(write=False)
            self._members = self._members._replace(links=links)
            changed = dict(zip(chosen.tolist(), setups, strict=True))
            self.setups = tuple(changed.get(m, setup) for m, setup in enumerate(self.setups))
        values = {name: getattr(state, name).copy() for name in ROWS}
        for name, value in values.items():
            value[chosen] = getattr(new, name)
        return replace(state, **values)

    def _setups(self, ropes: Rope | Sequence[Rope], **start: Any) -> list[Setup]:
        """Return the set-ups of ropes that the stepper can take."""
        setups = [setup_for(self.command, setup) for setup in setups_of(ropes, **self._common, **start)]
        if any(setup.touches for setup in setups):
            raise InvalidInput("a batch is stepped in free flight", got="ropes with joint limits", fix="Use hf.Stepper")
        return setups

    def _begin(self, setups: list[Setup], arm_angle: ArrayLike, arm_rate: ArrayLike, t: float) -> BatchState:
        """Return a state in which members with these set-ups begin."""
        count, own, n = len(setups), self._own, self._members.links.shape[2]
        begin = starts_of(setups)
        angle = checks.array("arm_angle", arm_angle, (count,), scalar=True, unit="rad")
        rate = checks.array("arm_rate", arm_rate, (count,), scalar=True, unit="rad/s")
        codes, memory = np.full(count, status.OK), np.tile(INITIAL_CLOCK, (count, 1))
        none, time = np.zeros(count), checks.number("t", t, unit="s")
        return BatchState(
            time, begin[:, own:n], begin[:, n + own : 2 * n], angle, rate, none, none.copy(), codes, memory
        )

    def tips(self, state: BatchState) -> tuple[Array, Array]:
        """Return places (M, 2), m, and velocities (M, 2), m/s, of the tips in a `state`."""
        self._check(state)
        arm = self.setups[0].arm or Arm()  # a batch has one
        lengths = np.stack([setup.rope.length for setup in self.setups])
        return arm.rope_tip(lengths, state.arm_angle, state.arm_rate, state.q, state.qd)

    @interruptible()
    def step(self, state: BatchState, commands: ArrayLike, dt: float) -> BatchState:
        """Return the state an interval later, as :meth:`hyperflex.Stepper.step` does.

        Parameters
        ----------
        state : BatchState
            From :meth:`start`, :meth:`step` or :meth:`restart`, or one with some values replaced
            (``dataclasses.replace``).
        commands : (M,) array_like or float
            One a member, or one for all: rad/s^2, rad or N m.
        dt : float
            Length of the interval, s, > 0.

        Returns
        -------
        BatchState
            A member that cannot be simulated within `tol` fails: its ``status`` has the reason, its values are NaN from
            then on.
        """
        members, own, count = self._members, self._own, len(self.setups)
        n = members.links.shape[2]
        self._check(state)
        given = checks.array("commands", commands, (count,), scalar=True)
        span = checks.number("dt", dt, sign="positive", unit="s")
        powers, ends = arm_polynomials(self.command, span)
        known = np.stack([state.arm_angle, state.arm_rate, given], axis=1)
        members.start[:, own:n], members.start[:, n + own : 2 * n] = state.q, state.qd
        if own:
            members.start[:, 0], members.start[:, n] = state.arm_angle, state.arm_rate
        members.start[:, 2 * n], members.start[:, 2 * n + 1] = state.work, state.dissipated
        members.clock[:] = state.memory
        members.breaks[0::2], members.breaks[1::2] = state.t, state.t + 2.0 * span
        members.coef[0::2, COMMANDS[self.command]] = known @ powers
        y, codes, reached = np.full((count, 1, members.start.shape[1]), np.nan), np.full(count, -1), np.zeros(count)
        terms, end = self._terms._replace(begin=state.t), np.array([state.t + span])

        def block(low: int, high: int) -> None:
            rows = slice(low, high)
            core.run_block(members, terms, low, high, end, y[rows], codes[rows], reached[rows], self._stop)

        self._all(block)
        y = y[:, 0]
        angle, rate = (y[:, 0].copy(), y[:, n].copy()) if own else (known @ ends).T
        codes = np.where(state.codes == status.OK, codes, state.codes)
        q, qd, work, lost = y[:, own:n], y[:, n + own : 2 * n], y[:, 2 * n], y[:, 2 * n + 1]
        return BatchState(state.t + span, q, qd, angle, rate, work, lost, codes, members.clock.copy())

    def _check(self, state: BatchState) -> None:
        """Refuse what is no state of this batch, or holds what no member can begin with."""
        count, n = len(self.setups), self.setups[0].rope.n_links
        checks.number("state t", checks.instance("state", state, BatchState).t, unit="s")
        columns = {"q": (n,), "qd": (n,), "memory": (len(INITIAL_CLOCK),)}
        values = {name: np.asarray(getattr(state, name)) for name in ROWS}
        for name, value in values.items():
            shape = (count, *columns.get(name, ()))
            if value.shape != shape or value.dtype.kind not in "if":
                raise InvalidInput(f"state {name} is not of this batch", got=value, allowed=f"numbers of shape {shape}")
        for name, value in values.items():
            now = value[values["codes"] == status.OK]
            if not (np.isfinite(now) if name != "memory" else (now[:, :1] > 0.0) & ~np.isnan(now)).all():
                fix = "Take it from start() or step()"
                raise InvalidInput(f"state {name} is not finite", got=value, allowed="finite numbers", fix=fix)

    def _all(self, block: Callable[[int, int], None]) -> None:
        """Call a function for the members low..high - 1 of each block, on threads."""
        if self._pool is None:
            block(*self._blocks[0])
            return
        running = [self._pool.submit(block, *span) for span in self._blocks]
        try:
            for each in running:
                each.result()
        except KeyboardInterrupt:  # Ctrl-C
            self._stop[0] = 1
            wait(running)
            self._stop[0] = 0
            raise


def _members(which: ArrayLike, count: int) -> Integers:
    """Return the numbers of members that were chosen by their numbers or by a mask."""
    chosen = np.asarray(which)
    found = np.flatnonzero(chosen) if chosen.dtype == np.bool_ and chosen.shape == (count,) else chosen
    known = found.dtype != np.bool_ and np.isin(found, np.arange(count)).all()
    if not known or found.ndim != 1 or np.unique(found).size < found.size:
        allowed = f"each a number from 0 to {count - 1}, once, or a mask of {count}"
        raise InvalidInput("these are no members of the batch", got=which, allowed=allowed)
    return found.astype(np.intp)


def _intervals(setups: Sequence[Setup]) -> list[Drive]:
    """Return drives of one polynomial at a time."""
    return [Interval(setup.drive()).drive for setup in setups]
