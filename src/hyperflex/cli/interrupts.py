"""Ctrl-C, noticed even where a library turns it into an error of its own."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import typer


@contextmanager
def noticed() -> Iterator[None]:
    """Raise KeyboardInterrupt for whatever error comes out of the block after Ctrl-C.

    Compiled libraries that call back into Python may meet the interrupt there and report it as a failed conversion.
    """
    if threading.current_thread() is not threading.main_thread():  # signals are the main thread's alone
        yield
        return
    met = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal met
        met = True
        signal.default_int_handler(number, frame)

    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler:  # ignored, or somebody else's
        yield
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield
    except typer.Exit:  # the command has met the interrupt itself and said so
        raise
    except Exception as error:
        if met:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
