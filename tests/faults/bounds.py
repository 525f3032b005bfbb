"""What every fault must end in: an error of ours with all its parts, or a result, within 5 s and 1 GB."""

import os
import re
import resource
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, settings

from hyperflex.errors import FileProblem, HyperflexError, InvalidInput

SECONDS, BYTES = 5.0, 1 << 30
MANY = os.environ.get("HYPERFLEX_FAULTS")  # examples of each property test, many thousands at night
# Texts of Python and its libraries, which must not appear for a wrong value or file.
LEAKED = re.compile(
    r"unexpected keyword|positional argument|NoneType|object is not|object has no|has no attribute|unsupported operand"
    r"|not subscriptable|not iterable|could not broadcast|setting an array element|index out of|unhashable|\bErrno\b"
    r"|argument must be|cannot convert|invalid literal|recursion depth"
)


def examples(count: int) -> settings:
    """Settings of a property test: `count` examples, the same in each run, or HYPERFLEX_FAULTS new ones."""
    return settings(
        max_examples=int(MANY or count),
        derandomize=MANY is None,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


class OutOfTime(BaseException):
    """The call has taken more processor time than it may."""


@contextmanager
def bounded(seconds: float = SECONDS) -> Iterator[None]:
    """Stop the block after so much processor time, and let it have no more than 1 GB of memory more than now."""

    def stop(*_: object) -> None:
        raise OutOfTime(f"{seconds} s of processor time")

    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGPROF, stop) if main else None
    resource.setrlimit(resource.RLIMIT_AS, (used + BYTES, before[1]))
    if main:
        signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        if main:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.signal(signal.SIGPROF, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


def refused_or_done(call: Callable[[], Any], seconds: float = SECONDS) -> Any:
    """Return the result of a call; None if it raises one of our errors, whose text must be complete."""
    with bounded(seconds):
        try:
            return call()
        except HyperflexError as error:
            readable(error)
    return None


def apart(call: Callable[[], Any]) -> None:
    """Make a call in a separate process, and assert that it ends well.

    For damaged HDF5 files: the library may write over its own memory where it reads one, and what fails then, much
    later, is a test that has done nothing wrong.
    """
    with warnings.catch_warnings(action="ignore"):  # of threads, from Python 3.12 on: the child needs none of them
        child = os.fork()
    if child == 0:
        try:
            call()
        except:
            traceback.print_exc()
            raise
        finally:  # in any case: a forked process must not continue as a second run of the tests
            os._exit(sys.exc_info()[0] is not None)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def readable(error: HyperflexError) -> None:
    """Assert that a message is one line of whole sentences that say what was wrong and what to do."""
    text = str(error)
    assert len(text) < 2000, text[:400]
    assert text.endswith("."), text
    assert "\n" not in text, text
    assert not LEAKED.search(text), text
    if isinstance(error, InvalidInput):
        assert error.what, text
        assert error.allowed or error.fix, text
    elif isinstance(error, FileProblem):
        assert text.count(". ") >= 1 or " is a folder" in text, text
