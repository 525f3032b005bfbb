"""Progress of long work on standard error: a bar in a terminal or notebook, else a line every ten seconds."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

EVERY = 10.0  # s between two lines without a terminal


@contextmanager
def progress_bar(
    begin: float, end: float, enabled: bool, what: str = "simulating", unit: str = "s"
) -> Iterator[Callable[..., None] | None]:
    """Show on standard error the progress of work from `begin` to `end`, in `unit`, if `enabled`.

    Yields the function that sets it, and optionally another text than `what`. A terminal gets a bar, other outputs a
    line every EVERY s.
    """
    if not enabled:
        yield None
        return
    if (console := terminal()) is None:
        places = 2 - math.floor(math.log10(end - begin)) if end > begin else 0
        with lines() as say:
            yield lambda t, words=what: say(f"{words}: {round(t - begin, places):g} of {end - begin:.4g} {unit}")
        return
    from rich.progress import Progress as Bar

    with Bar(console=console, transient=True) as bar:
        task = bar.add_task(what, total=end - begin)
        yield lambda t, words=what: bar.update(task, completed=t - begin, description=words)


def terminal() -> Any:
    """Return a rich console on standard error if it is a terminal or a notebook; else None."""
    if not sys.stderr.isatty() and "ipykernel" not in sys.modules:
        return None
    from rich.console import Console

    return Console(stderr=True)


@contextmanager
def lines() -> Iterator[Callable[[str], None]]:
    """Write the last text and the elapsed time of the work to standard error every EVERY s.

    Yields the function that sets the text. Nothing is written for shorter work.
    """
    newest, over, began = [""], threading.Event(), time.monotonic()

    def write() -> None:
        while not over.wait(EVERY):
            with suppress(OSError, ValueError):  # the reader has closed it
                if newest[0]:
                    sys.stderr.write(f"hyperflex: {newest[0]}; begun {time.monotonic() - began:.0f} s ago\n")
                    sys.stderr.flush()

    def say(words: str) -> None:
        newest[0] = words

    writer = threading.Thread(target=write, name="hyperflex progress", daemon=True)
    writer.start()
    try:
        yield say
    finally:
        over.set()
        writer.join()
