"""Batch rollouts: members in SIMD lanes, blocks of members on threads."""

import math
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks, extras, memory
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.batch import rollouts as core
from hyperflex.core.batch.members import LENGTH, Members, Terms, observe_block
from hyperflex.core.chain.lanes import MEMBERS
from hyperflex.errors import InvalidInput
from hyperflex.executor import checked_chunks
from hyperflex.interruption import interruptible
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL, Arm, Obstacle, Rope, Setup
from hyperflex.motion import Motion
from hyperflex.simulation.arguments import output_times
from hyperflex.simulation.batch.contact import TURNS, run_blocks, run_members, unfinished
from hyperflex.simulation.batch.members import columns, members_of, setups_of, starts_of, terms_of
from hyperflex.simulation.batch.pieces import run_pieces
from hyperflex.simulation.rollouts import balanced, least_scale, stored
from hyperflex.simulation.time_budget import Deadline, budget_of

if TYPE_CHECKING:
    import xarray as xr

# Members of a block: at least BLOCKS blocks a thread, to balance the load and to be interrupted; not more than keep the
# states in work below some megabytes; not fewer than keep the lanes full, since the last ones of a block run alone.
BLOCKS = 2
LARGEST_BLOCK = 16 * len(MEMBERS)
STATES = 1e6  # numbers that a block may hold in work
CHUNK, CONTACT_CHUNK = 64, 4  # members of a chunk on an executor
# name: (dimensions after member and time, units, long name)
KEPT: dict[str, tuple[tuple[str, ...], str, str]] = {
    "tip": (("axis",), "m", "position of the tip"),
    "q": (("link",), "rad", "absolute link angle"),
    "qd": (("link",), "rad/s", "link rate"),
    "motor_work": ((), "J", "work done by the motor and the moving base since the start"),
    "dissipated_energy": ((), "J", "energy lost to friction and air since the start"),
    TURNS: (("peg",), "1", "signed turns about a peg from the first joint to the tip"),
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
        What was kept, each (M, T, ...); NaN from where a member failed.
    status : tuple of str
        ``"ok"`` or the name of the failure, (M,).
    reached : (M,) float64
        Time that each member reached, s.
    """

    t: Array
    values: dict[str, Array]
    status: tuple[str, ...]
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
        return [m for m, name in enumerate(self.status) if name != "ok"]

    def why(self, member: int) -> str:
        """Return what went wrong with a member, and advice; empty if nothing did."""
        if not -len(self.status) <= member < len(self.status):
            raise InvalidInput("no such member", got=member, allowed=f"0 to {len(self.status) - 1}")
        name = self.status[member]
        advice = {status.NAMES[code]: text for code, text in status.ADVICE.items()}.get(name, "")
        where = f"stopped at t = {self.reached[member]:.6g} s ({name})"
        return "" if name == "ok" else where + (advice and f": {advice}.")

    @property
    def dataset(self) -> "xr.Dataset":
        """The batch as an ``xarray.Dataset`` with the dimensions member, time, link and axis."""
        extras.require(("xarray",), "xarray", "Datasets")
        import xarray as xr

        variables: dict[str, Any] = {
            name: (("member", "time", *KEPT[name][0]), value, {"units": KEPT[name][1], "long_name": KEPT[name][2]})
            for name, value in self.values.items()
        }
        variables["status"] = ("member", np.array(self.status))
        variables["reached"] = ("member", self.reached, {"units": "s", "long_name": "time reached"})
        coords = {"time": ("time", self.t, {"units": "s"}), "axis": ("axis", np.array(["x", "y"]))}
        return xr.Dataset(variables, coords, attrs={"source": "simulated"})


@interruptible(Batch)
def simulate_batch(
    ropes: Rope | Sequence[Rope],
    motions: Motion | Sequence[Motion] | None = None,
    *,
    arm: Arm | None = None,
    duration: float,
    q0: npt.ArrayLike | None = None,
    qd0: npt.ArrayLike | None = None,
    t_eval: npt.ArrayLike | None = None,
    tol: float = DEFAULT_TOL,
    step: float | None = None,
    keep: Sequence[str] = ("tip",),
    pegs: Sequence[Obstacle] | Sequence[Sequence[Obstacle]] = (),
    contact_step: float = DEFAULT_CONTACT_STEP,
    refine: bool = True,
    time_budget: float | Budget | Deadline | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    chunk_size: int | None = None,
    progress: bool = False,
) -> Batch:
    """Simulate many ropes, motions or initial states at once.

    Parameters
    ----------
    ropes : Rope or sequence of Rope
        One for all members, or one each. All must have the same number of links and friction model.
    motions : Motion or sequence of Motion, optional
        One for all members, or one each.
    arm, duration, tol
        As in :func:`hyperflex.simulate`; the same for all members. The energy account does not shorten the steps here;
        it is checked at the outputs.
    q0, qd0 : (n,) or (M, n) array_like, optional
        Angles, rad, and rates, rad/s, at the start; one row for all members, or one each.
    t_eval : (T,) array_like, optional
        Times of the output, s, from 0 on; by default the end alone. A step ends at each, so ask for what you need.
    step : float, optional
        A step chosen beforehand, s, without error control; not with pegs.
    keep : sequence of {"tip", "q", "qd", "motor_work", "dissipated_energy", "turns", "peg_angle", "peg_rate"}
        What to keep; memory is (M, T) times this, beside the blocks in work. Turns are those about each round peg.
    pegs : sequence of Peg, Wall or Ground, or of such sequences, optional
        Pegs of all members, or of each, the same number for all. Members run one by one then, as with joint limits,
        each as :func:`hyperflex.simulate` runs it and with the same result.
    contact_step, refine
        As in :func:`hyperflex.simulate`. Where ropes are cut into different numbers of links, `q` and `qd` end in NaN.
    time_budget : float or Budget, optional
        Time by the clock for all members, s; those that are not finished then have the status "out of time". By default
        there is no limit but that of :func:`simulate` for each member with pegs or with joint limits.
    threads : int, optional
        By default one a processor, or one in each worker of an executor. Results do not depend on it.
    executor : concurrent.futures.Executor, optional
        Where chunks of members are run: processes, or other machines (``docs/how-to/many-machines.md``). Results do not
        depend on it. Members whose chunk kills each worker that runs it have the status "worker lost".
    chunk_size : int, optional
        Members of a chunk; by default CHUNK, with contact CONTACT_CHUNK.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    Batch
        A member that fails is reported in ``status``; the others stand.

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
    refine, progress = checks.flag("refine", refine), checks.flag("progress", progress)
    usual = 1 if executor is not None else os.cpu_count() or 1
    workers = checks.count("threads", threads, most=checks.MOST_THREADS) if threads is not None else usual
    others = {"duration": duration, "tol": tol, "contact_step": contact_step}
    setups = setups_of(ropes, motions, pegs, (q0, qd0), arm=arm, refine=refine, **others)
    if not pegs and any("peg" in KEPT[name][0] for name in keep):
        raise InvalidInput("turns are about pegs, and there are none", got=keep, fix="Give pegs=[Peg(...)]")
    t = _outputs(t_eval, setups[0].duration)
    _check_memory(setups, t.size, keep)
    touches = any(setup.touches for setup in setups)
    if touches and step is not None:
        raise InvalidInput("step is not there with pegs or with joint limits", got=step, fix="Give contact_step or tol")
    chosen = 0.0 if step is None else checks.number("step", step, sign="positive", unit="s")
    executor, size = checked_chunks(executor, chunk_size, CONTACT_CHUNK if touches else CHUNK)
    run = _in_contact if touches else partial(_in_flight, step=chosen)
    budget = time_budget if time_budget is None or isinstance(time_budget, Deadline) else Budget.of(time_budget)
    run = partial(run, t=t, keep=keep, workers=workers)
    if executor is None:
        return run(setups, progress=progress, time_budget=budget)
    run = partial(_until, None if budget is None else time.time() + budget_of(budget).remaining, run)
    values, names, reached, stop = run_pieces(run, setups, executor, size, progress)
    return stop.deliver(Batch(t, values, tuple(names), reached))


def _until(end: float | None, run: Callable[..., Batch], setups: list[Setup]) -> Batch:
    """Run members in a process of an executor until `end`, s, by the clock of all machines (``time.time``)."""
    return run(setups, time_budget=None if end is None else Budget(end - time.time()))


def _in_contact(
    setups: list[Setup],
    t: Array,
    keep: tuple[str, ...],
    workers: int,
    time_budget: Budget | Deadline | None,
    progress: bool = False,
) -> Batch:
    """Run members with pegs or with joint limits in this process, on threads."""
    shapes = {name: KEPT[name][0] for name in keep}
    values, names, reached, stop = run_members(setups, t, shapes, time_budget, workers, progress)
    return stop.deliver(Batch(t, values, tuple(names), reached))


def _in_flight(
    setups: list[Setup],
    t: Array,
    keep: tuple[str, ...],
    workers: int,
    step: float,
    time_budget: Budget | Deadline | None,
    progress: bool = False,
) -> Batch:
    """Run members in free flight in this process, on threads."""
    chains = [setup.chain() for setup in setups]
    members = members_of(chains, [setup.drive() for setup in setups], starts_of(setups))
    return _Work(members, terms_of(setups[0], chains[0], step), t, keep, setups).run(
        workers, progress, budget_of(time_budget)
    )


class _Work:
    """The blocks of a batch and where their results go."""

    def __init__(self, members: Members, terms: Terms, t: Array, keep: tuple[str, ...], setups: list[Setup]) -> None:
        self.members, self.terms, self.t = members, terms, t
        self.first = 1 if t[0] > 0.0 else 0  # row of start and outputs to show first: the start, where it is asked for
        self.halt = np.zeros(1, dtype=np.int64)  # 1: blocks at work end where they are
        self.ropes = [setup.rope for setup in setups]
        self.floor = np.array([least_scale(rope) for rope in self.ropes])
        count, _, n = members.links.shape
        sizes = {"link": n, "axis": 2}
        self.values = {name: np.full((count, t.size, *(sizes[dim] for dim in KEPT[name][0])), np.nan) for name in keep}
        self.codes = np.full(count, -1)
        self.reached = np.zeros(count)

    def block(self, low: int, high: int) -> None:
        """Run members low..high - 1 and keep what is asked of them."""
        n = self.members.links.shape[2]
        after = self.t[1 - self.first :].copy()  # times after the start
        y = np.full((high - low, after.size, 2 * n + 2), np.nan)
        codes, reached = np.full(high - low, -1), np.zeros(high - low)
        core.run_block(self.members, self.terms, low, high, after, y, codes, reached, self.halt)
        rows = slice(low, high)
        states = np.concatenate([self.members.start[rows, None], y], axis=1)
        times = np.append(self.terms.begin, after)
        joint = self.check_energy(low, high, times, states, codes, reached)[:, self.first :]
        y = states[:, self.first :]
        for name, target in self.values.items():
            if name == "tip":
                length = self.members.links[rows, LENGTH][:, None, :]
                q = y[:, :, :n]
                reach = np.stack([(length * np.sin(q)).sum(axis=2), -(length * np.cos(q)).sum(axis=2)], axis=2)
                target[rows] = joint + reach
            else:
                target[rows] = y[:, :, columns(name, n)]
        self.reached[rows] = reached
        self.codes[rows] = codes

    def check_energy(
        self, low: int, high: int, times: Array, states: Array, codes: npt.NDArray[np.int64], reached: Array
    ) -> Array:
        """Mark members whose energy balance fails, and forget their `states` (high - low, T, 2 n + 2) from there on.

        Returns the position of the first joint at `times` (high - low, T, 2), m; the first time is that of the start.
        """
        kinetic, potential = np.empty((high - low, times.size)), np.empty((high - low, times.size))
        joint, n = np.empty((high - low, times.size, 2)), self.members.links.shape[2]
        seen = kinetic, potential, joint, np.empty(2 * n)
        observe_block(self.members, self.terms, low, high, times, states, *seen)
        floor, work, lost = self.floor[low:high, None], states[:, :, 2 * n], states[:, :, 2 * n + 1]
        done = np.flatnonzero(codes == status.OK)
        rows = balanced(floor[done], kinetic[done], potential[done], 0.0, work[done], lost[done])
        for m in done[rows < times.size]:  # what is held may explain it, see there
            held = stored(self.ropes[low + m].chain(), states[m, :, :n])
            good = int(balanced(floor[m], kinetic[m], potential[m], held, work[m], lost[m]))
            if good < times.size:
                codes[m], reached[m] = status.ENERGY, times[good]
                states[m, good:] = np.nan
        return joint

    def run(self, workers: int, progress: bool, budget: Budget) -> Batch:
        """Run all blocks on threads; what is finished when it is stopped is kept."""
        count = self.codes.size
        even = -(-count // (workers * BLOCKS * len(MEMBERS))) * len(MEMBERS)
        states = self.t.size * (2 * self.members.links.shape[2] + 2)
        held = int(STATES / states) // len(MEMBERS) * len(MEMBERS)
        size = max(len(MEMBERS), min(even, LARGEST_BLOCK, held))
        stop = run_blocks(self.block, size, count, workers, progress, budget, self.halt)
        names = tuple(status.NAMES[int(code)] if code >= 0 else unfinished(stop) for code in self.codes)
        return stop.deliver(Batch(self.t, self.values, names, self.reached))


def _outputs(t_eval: npt.ArrayLike | None, duration: float) -> Array:
    """Check the output times (T,), s; by default the end alone."""
    t = output_times([duration] if t_eval is None else t_eval, 0.0, duration)
    if t[-1] == 0.0:
        raise InvalidInput("t_eval is the start alone", got=t.tolist(), allowed="also a time after it, in s")
    return t


def _check_memory(setups: list[Setup], samples: int, keep: tuple[str, ...]) -> None:
    """Refuse a batch whose results would not fit into the memory."""
    sizes = {"link": max(setup.rope.n_links for setup in setups), "axis": 2, "peg": len(setups[0].round_pegs)}
    numbers = sum(math.prod(sizes[dim] for dim in KEPT[name][0]) for name in keep)
    memory.check(
        8.0 * numbers * len(setups) * samples,
        f"a batch of {len(setups)} members with {samples} outputs of {', '.join(keep)}",
        "Ask for fewer outputs (t_eval=[...]), keep less of them (keep=[...]), or take fewer members at once",
    )
