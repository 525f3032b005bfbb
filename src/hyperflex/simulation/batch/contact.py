"""Contact batch: members with pegs or joint limits, one by one on threads."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np
import numpy.typing as npt

from hyperflex import interruption
from hyperflex.checks import Array
from hyperflex.interruption import CaughtInterrupt, catch_interrupt
from hyperflex.model import Setup
from hyperflex.progress import progress_bar
from hyperflex.simulation.contact.start import check_start
from hyperflex.simulation.runs import simulate
from hyperflex.simulation.time_budget import INTERRUPTED, OUT_OF_TIME, Deadline
from hyperflex.trajectory import Trajectory, swept

TURNS = "turns"


def run_members(
    setups: Sequence[Setup],
    t: Array,
    keep: dict[str, tuple[str, ...]],
    time_budget: float | Deadline | None,
    threads: int,
    progress: bool,
) -> tuple[dict[str, Array], list[str], Array, CaughtInterrupt]:
    """Run all members with outputs at t (T,), s; Ctrl-C keeps those that are finished.

    `keep` names what to keep, with the dimensions of one sample: "link", "axis" or "peg".

    Returns
    -------
    values : dict of str to (M, T, ...) float64
        What was kept; NaN from where a member failed, and beyond the links that a rope has.
    names : (M,) list of str
        "ok", the name of the failure, INTERRUPTED or OUT_OF_TIME.
    reached : (M,) float64
        Time that each member reached, s.
    interrupt : CaughtInterrupt
    """
    for m, setup in enumerate(setups):
        check_start(setup, who=f"the rope of member {m}")
    sizes = {"link": max(s.rope.n_links for s in setups), "axis": 2, "peg": len(setups[0].round_pegs)}
    values = {k: np.full((len(setups), t.size, *(sizes[d] for d in dims)), np.nan) for k, dims in keep.items()}
    names, reached = [INTERRUPTED] * len(setups), np.zeros(len(setups))

    def one(m: int, _: int) -> None:
        run = simulate(setups[m], t_eval=t, throw=False, time_budget=time_budget)
        for name, target in values.items():
            found = _kept(run, name)
            whole: tuple[slice, ...] = tuple(slice(0, size) for size in found.shape)
            target[m][whole] = found
        reached[m], names[m] = run.state.t, run.status

    interrupt = run_blocks(one, 1, len(setups), threads, progress, time_budget)
    return values, [unfinished(interrupt) if name == INTERRUPTED else name for name in names], reached, interrupt


def run_blocks(
    block: Callable[[int, int], None],
    size: int,
    count: int,
    threads: int,
    progress: bool,
    time_budget: float | Deadline | None,
    stop: npt.NDArray[np.int64] | None = None,
) -> CaughtInterrupt:
    """Run a function for the members low..high - 1 of each block of `size`, until all `count` are done.

    After Ctrl-C, and once a Deadline is over, blocks that have not begun are left out, and `stop` (1,), if given, is
    set to 1 for those at work. Returns whether Ctrl-C did so.
    """
    left = time_budget.left if isinstance(time_budget, Deadline) else None
    with (
        catch_interrupt() as interrupt,
        ThreadPoolExecutor(threads) as pool,
        progress_bar(0, count, progress, unit="members") as report,
    ):
        begins = range(0, count if left is None or left() >= 0.0 else 0, size)
        spans = [(low, min(low + size, count)) for low in begins]
        futures: list[Future[None]] = []

        def end() -> None:
            if stop is not None:
                stop[0] = 1
            for future in futures:
                future.cancel()

        try:
            futures += (pool.submit(block, *span) for span in spans)
            for (_, high), future in zip(spans, futures, strict=True):
                if not _in_time(future, left):
                    end()
                    left = None
                if future.cancelled():
                    continue
                future.result()
                if report is not None:
                    report(high)
        except KeyboardInterrupt:
            end()
            raise
    return interrupt


def unfinished(interrupt: CaughtInterrupt) -> str:
    """Return the status of members that were left out or ended before they were done."""
    return INTERRUPTED if interrupt.received else OUT_OF_TIME


def _in_time(future: Future[None], left: Callable[[], float] | None) -> bool:
    """Wait for a block until no time is left, s; return whether it is done. Signals are seen in any thread."""
    while not future.done() and (seconds := 1.0 if left is None else left()) >= 0.0:
        interruption.look()
        wait([future], timeout=min(max(seconds, 1e-3), 1.0))
    return future.done()


def _kept(run: Trajectory, name: str) -> Array:
    """Return one of the quantities that a batch keeps (T, ...)."""
    if name != TURNS:
        value = getattr(run, name)
        return np.zeros((run.t.size, len(run.setup.round_pegs))) if value is None else np.asarray(value)
    centres = np.array([[peg.x, peg.y] for peg in run.setup.round_pegs])
    return np.stack([swept(run.joints - centre).sum(axis=1) for centre in centres], axis=1) / (2.0 * np.pi)
