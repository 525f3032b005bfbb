"""Contact batch: members with pegs or joint limits, one by one on threads."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np
import numpy.typing as npt

from hyperflex.budget import Budget, OutOfTime
from hyperflex.checks import Array
from hyperflex.interruption import Stop, stoppable
from hyperflex.model import Setup
from hyperflex.progress import progress_bar
from hyperflex.simulation.contact.start import check_start
from hyperflex.simulation.runs import simulate
from hyperflex.simulation.time_budget import INTERRUPTED, Deadline, budget_of
from hyperflex.trajectory import Trajectory, swept

TURNS = "turns"


def run_members(
    setups: Sequence[Setup],
    t: Array,
    keep: dict[str, tuple[str, ...]],
    time_budget: Budget | Deadline | None,
    threads: int,
    progress: bool,
) -> tuple[dict[str, Array], list[str], Array, Stop]:
    """Run all members with outputs at t (T,), s; those that are finished when it is stopped are kept.

    `keep` names what to keep, with the dimensions of one sample: "link", "axis" or "peg".

    Returns
    -------
    values : dict of str to (M, T, ...) float64
        What was kept; NaN from where a member failed, and beyond the links that a rope has.
    names : (M,) list of str
        "ok", the name of the failure, INTERRUPTED or OUT_OF_TIME.
    reached : (M,) float64
        Time that each member reached, s.
    stop : Stop
    """
    for m, setup in enumerate(setups):
        check_start(setup, who=f"the rope of member {m}")
    sizes = {"link": max(s.rope.n_links for s in setups), "axis": 2, "peg": len(setups[0].round_pegs)}
    values = {k: np.full((len(setups), t.size, *(sizes[d] for d in dims)), np.nan) for k, dims in keep.items()}
    names: list[str] = [INTERRUPTED] * len(setups)
    reached = np.zeros(len(setups))

    def one(m: int, _: int) -> None:
        run = simulate(setups[m], t_eval=t, throw=False, time_budget=time_budget)
        for name, target in values.items():
            found = _kept(run, name)
            whole: tuple[slice, ...] = tuple(slice(0, size) for size in found.shape)
            target[m][whole] = found
        reached[m], names[m] = run.state.t, run.status

    stop = run_blocks(one, 1, len(setups), threads, progress, budget_of(time_budget))
    return values, [unfinished(stop) if name == INTERRUPTED else name for name in names], reached, stop


def run_blocks(
    block: Callable[[int, int], None],
    size: int,
    count: int,
    threads: int,
    progress: bool,
    budget: Budget,
    halt: npt.NDArray[np.int64] | None = None,
) -> Stop:
    """Run a function for the members low..high - 1 of each block of `size`, until all `count` are done.

    After an interrupt, and once the budget is spent, blocks that have not begun are omitted, and `halt` (1,), if given,
    is set to 1 for those that are running. Returns whether and why that happened.
    """
    with (
        stoppable() as stop,
        ThreadPoolExecutor(threads) as pool,
        progress_bar(0, count, progress, unit="members") as report,
    ):
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


def unfinished(stop: Stop) -> str:
    """Return the status of members that were omitted or ended before they were done."""
    return stop.status or INTERRUPTED


def _kept(run: Trajectory, name: str) -> Array:
    """Return one of the quantities that a batch keeps (T, ...)."""
    if name != TURNS:
        value = getattr(run, name)
        return np.zeros((run.t.size, len(run.setup.round_pegs))) if value is None else np.asarray(value)
    centres = np.array([[peg.x, peg.y] for peg in run.setup.round_pegs])
    return np.stack([swept(run.joints - centre).sum(axis=1) for centre in centres], axis=1) / (2.0 * np.pi)
