"""Independent work in chunks on any executor with Python's interface; chunks of dead workers are run again.

Executors are those of ``concurrent.futures`` and others with the same interface: Dask, loky, mpi4py.
"""

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor
from typing import Any, TypeVar

from hyperflex import checks
from hyperflex.errors import InvalidInput, WorkerLost

_T = TypeVar("_T")
_R = TypeVar("_R")
Chunks = dict[int, list[_T]]
DEATHS = ("KilledWorker", "CommClosedError", "FutureCancelledError")  # Dask's errors for a lost worker


def checked_chunks(executor: object, chunk_size: object, default: int) -> tuple[Executor | None, int]:
    """Return an executor, or None for this process, and the size of its chunks; refuse other objects.

    `default` is the size if none is given.
    """
    size = default if chunk_size is None else checks.count("chunk_size", chunk_size)
    return None if executor is None else checks.instance("executor", executor, Executor, "concurrent.futures"), size


def run_chunks(
    work: Callable[[list[_T]], _R],
    items: Sequence[_T],
    executor: Executor | None,
    size: int,
    done: Callable[[int, _R], None],
) -> list[range]:
    """Run `work` for chunks of `size` items, in this process or on an executor.

    A chunk whose worker died is run once more on new processes, because a ProcessPoolExecutor loses all running chunks
    with a worker. A chunk that is lost again is run alone, which identifies a chunk that kills its worker.

    Parameters
    ----------
    work : callable
        Function of a list of items; both can be pickled.
    items : sequence
    executor : Executor, optional
        By default this process runs all chunks, one after the other.
    size : int
    done : callable
        Called in this process with the number of a chunk's first item and the result of `work`.

    Returns
    -------
    list of range
        The numbers of the items of each chunk that killed its worker all three times.

    Raises
    ------
    InvalidInput
        If `work` or an item cannot be pickled and the executor requires it.
    """
    chunks: Chunks[_T] = {low: list(items[low : low + size]) for low in range(0, len(items), size)}
    if executor is None:
        for low, chunk in chunks.items():
            done(low, work(chunk))
        return []
    lost, dead = _round(work, chunks, executor, done), []
    if lost:
        with _processes(executor, getattr(executor, "_max_workers", None)) as fresh:
            lost = _round(work, lost, fresh, done)
    for low, chunk in sorted(lost.items()):
        with _processes(executor, 1) as alone:
            if _round(work, {low: chunk}, alone, done):
                dead.append(range(low, low + len(chunk)))
    return dead


def refuse_lost(dead: list[range], what: str) -> None:
    """Raise WorkerLost if there are items that killed their workers; `what` names them, in the plural."""
    if dead:
        spans = ", ".join(f"{each.start} to {each.stop - 1}" for each in dead)
        raise WorkerLost(
            f"Workers died at {what} {spans}, each time that they were run. They may need more memory than a worker "
            "has: give a smaller chunk_size or fewer workers; or run them alone, without an executor, to see."
        )


def _round(
    work: Callable[[list[_T]], _R], chunks: Chunks[_T], executor: Executor, done: Callable[[int, _R], None]
) -> Chunks[_T]:
    """Run chunks concurrently; return those that were lost with their workers."""
    futures: dict[int, Any] = {}
    lost: Chunks[_T] = {}
    try:
        for low, chunk in chunks.items():
            try:
                futures[low] = executor.submit(work, chunk)
            except BrokenExecutor:
                lost[low] = chunk
        for low, future in futures.items():
            try:
                result = future.result()
            except (BrokenExecutor, CancelledError):
                lost[low] = chunks[low]
            except Exception as error:
                if _not_sent(work, chunks[low], error):
                    raise InvalidInput(
                        "the executor's processes cannot be given the work",
                        got=str(error),
                        allowed="arguments that can be pickled",
                        fix="Give functions that are defined at the top of a module, no lambdas or local ones",
                    ) from error
                if type(error).__name__ not in DEATHS:
                    raise
                lost[low] = chunks[low]
            else:
                done(low, result)
    except BaseException:
        for future in futures.values():
            future.cancel()
        raise
    return lost


def _not_sent(work: object, chunk: object, error: Exception) -> bool:
    """Return whether an error is the one that pickling work and chunk raises."""
    try:
        pickle.dumps((work, chunk))
    except Exception as own:  # noqa: BLE001 any exception of an argument
        return (type(own), str(own)) == (type(error), str(error))
    return False


def _processes(like: Executor, workers: int | None) -> ProcessPoolExecutor:
    """Return new processes, started like those of an executor."""
    return ProcessPoolExecutor(workers, mp_context=getattr(like, "_mp_context", None))
