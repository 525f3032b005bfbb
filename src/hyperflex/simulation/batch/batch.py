"""Batch rollouts: members in SIMD lanes, or one by one with contact, on threads or on an executor."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import numpy.typing as npt

from hyperflex import checks, extras, memory
from hyperflex.budget import Budget, OutOfTime
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.batch import rollouts as core
from hyperflex.core.batch.rollouts import LENGTH, observe_block
from hyperflex.core.chain.lanes import MEMBERS
from hyperflex.errors import InvalidInput
from hyperflex.executor import checked_chunks, run_chunks
from hyperflex.interruption import Stop, interruptible, stoppable
from hyperflex.model import Rope, Setup
from hyperflex.motion import Motion
from hyperflex.progress import progress_bar
from hyperflex.simulation.arguments import output_times
from hyperflex.simulation.batch.members import BatchFields, members_of, setups_of, starts_of, terms_of
from hyperflex.simulation.contact.start import check_start
from hyperflex.simulation.outcome import status_of
from hyperflex.simulation.rollouts import balanced, least_scale, stored
from hyperflex.simulation.runs import simulate
from hyperflex.status import Status
from hyperflex.trajectory import Trajectory, swept

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
# name: (dimensions after member and time, units, long name)
KEPT: dict[str, tuple[tuple[str, ...], str, str]] = {
    "tip": (("axis",), "m", "position of the tip"),
    "q": (("link",), "rad", "absolute link angle"),
    "qd": (("link",), "rad/s", "link rate"),
    "motor_work": ((), "J", "work done by the motor and the moving base since the start"),
    "dissipated_energy": ((), "J", "energy lost to friction and air since the start"),
    "turns": (("peg",), "1", "signed turns about a peg from the first joint to the tip"),
    "peg_angle": (("peg",), "rad", "angle by which a round peg has turned"),
    "peg_rate": (("peg",), "rad/s", "rate of a round peg"),
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
        extras.require(("xarray",), "xarray", "Datasets")
        import xarray as xr

        variables: dict[str, Any] = {
            name: (("member", "time", *KEPT[name][0]), value, {"units": KEPT[name][1], "long_name": KEPT[name][2]})
            for name, value in self.values.items()
        }
        variables["status"] = ("member", np.array(self.status, dtype=str))
        variables["reached"] = ("member", self.reached, {"units": "s", "long_name": "time reached"})
        coords = {"time": ("time", self.t, {"units": "s"}), "axis": ("axis", np.array(["x", "y"]))}
        return xr.Dataset(variables, coords, attrs={"source": "simulated"})


@interruptible(Batch)
def simulate_batch(
    ropes: Rope | Sequence[Rope],
    motions: Motion | Sequence[Motion] | None = None,
    *,
    t_eval: npt.ArrayLike | None = None,
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
        Times of the output, s, from 0 on; by default only the end. A step ends at each of them.
    keep : sequence of {"tip", "q", "qd", "motor_work", "dissipated_energy", "turns", "peg_angle", "peg_rate"}
        What to keep; memory is (M, T) times this, in addition to the blocks in work. Turns are those about each round
        peg.
    time_budget : float or Budget, optional
        Time by the clock for all members, s; those that are not finished then have the status "out of time". A member
        with pegs or with joint limits may take half of the time left while others wait. By default there is no limit
        but that of :func:`simulate` for each such member.
    threads : int, optional
        By default one a processor, or one in each worker of an executor. Results do not depend on it.
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
    setups = setups_of(ropes, motions, **setup)
    if not setups[0].pegs and any("peg" in KEPT[name][0] for name in keep):
        raise InvalidInput("turns are about pegs, and there are none", got=keep, fix="Give pegs=[Peg(...)]")
    t = output_times([setups[0].duration] if t_eval is None else t_eval, 0.0, setups[0].duration)
    if t[-1] == 0.0:
        raise InvalidInput("t_eval is the start alone", got=t.tolist(), allowed="also a time after it, in s")
    touches = any(each.touches for each in setups)
    if touches and step is not None:
        raise InvalidInput("step is not available with pegs or joint limits", got=step, fix="Give contact_step or tol")
    executor, size = checked_chunks(executor, chunk_size, CONTACT_CHUNK if touches else CHUNK)
    results = _Results(setups, t, keep)
    limit = None if time_budget is None else Budget.of(time_budget)
    run = _in_contact if touches else partial(_in_flight, step=step or 0.0)
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

    def put(
        self, low: int, values: Mapping[str, Array], status: Sequence[Status | None], reached: npt.ArrayLike
    ) -> None:
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
) -> Stop:
    """Run members in free flight in this process: blocks of them in SIMD lanes, on threads."""
    chains = [setup.chain() for setup in setups]
    members = members_of(chains, [setup.drive() for setup in setups], starts_of(setups))
    terms = terms_of(setups[0], chains[0], step)
    t, first = results.t, int(results.t[0] == 0.0)  # 1: the start is the first sample
    after, times = t[first:].copy(), t if first else np.append(terms.begin, t)
    n = chains[0].length.size
    width = 2 * n + 2
    columns: dict[str, Any] = {"q": slice(0, n), "qd": slice(n, 2 * n), "motor_work": 2 * n, "dissipated_energy": -1}
    halt = np.zeros(1, dtype=np.int64)  # 1: running blocks end where they are

    def block(low: int, high: int) -> None:
        rows, count = slice(low, high), high - low
        y = np.full((count, after.size, width), np.nan)
        codes, reached = np.full(count, -1), np.zeros(count)
        core.run_block(members, terms, low, high, after, y, codes, reached, halt)
        states = np.concatenate([members.start[rows, None], y], axis=1)
        kinetic, potential, joint = *np.empty((2, count, times.size)), np.empty((count, times.size, 2))
        observe_block(members, terms, low, high, times, states, kinetic, potential, joint)
        floor = np.array([least_scale(setup.rope) for setup in setups[rows]])[:, None]
        done = np.flatnonzero(codes == status.OK)
        energies = kinetic, potential, np.zeros(kinetic.shape), states[:, :, 2 * n], states[:, :, 2 * n + 1]
        good = balanced(floor[done], *(each[done] for each in energies))
        for m in done[good < times.size]:  # the energy stored in the rope may explain the error
            energies[2][m] = stored(chains[low + m], states[m, :, :n])
            valid = int(balanced(floor[m], *(each[m] for each in energies)))
            if valid < times.size:
                codes[m], reached[m] = status.ENERGY, times[valid]
                states[m, valid:] = np.nan
        shown = states[:, 1 - first :]
        length, q = members.links[rows, LENGTH][:, None, :], shown[:, :, :n]
        reach = np.stack([(length * np.sin(q)).sum(axis=2), -(length * np.cos(q)).sum(axis=2)], axis=2)
        values = {name: shown[:, :, columns[name]] for name in results.values if name != "tip"}
        if "tip" in results.values:
            values["tip"] = joint[:, 1 - first :] + reach
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
    halt: npt.NDArray[np.int64] | None = None,
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
        away = [run.joints - np.array([peg.x, peg.y]) for peg in pegs]
        return np.stack([swept(each).sum(axis=1) for each in away], axis=1) / (2.0 * np.pi)
    value = getattr(run, name)
    return np.zeros((run.t.size, len(pegs))) if value is None else np.asarray(value)
