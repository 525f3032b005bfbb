"""A child process: its answers, its errors and its end, as the parent sees them; records that both share."""

import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection

import numpy as np
import pytest

from hyperflex.child import Child, Records, run_in_real_time, serve
from hyperflex.errors import DriveError, InvalidInput
from tests.refusals import fails, refuses


def work(link: Connection, records: Records) -> None:
    """Answer requests until the end; "fail" ends it with an error, "hang" takes longer than anyone waits."""
    run_in_real_time()
    link.send((0, "ready"))

    def fail() -> None:
        raise InvalidInput("the load is too large", got=3)

    answers = {"double": lambda x: 2 * x, "write": records.write, "fail": fail, "hang": lambda: time.sleep(60.0)}
    while serve(link, answers):
        time.sleep(1e-3)


def die(link: Connection) -> None:
    """End before anything is sent."""
    raise SystemExit(5)


@pytest.fixture
def records() -> Records:
    return Records(3, 2)


@pytest.fixture
def child(records: Records) -> Iterator[Child]:
    child = Child("The worker", DriveError, work, records)
    assert child.start() == "ready"
    yield child
    child.end()


def test_a_child_answers_writes_and_ends_by_itself(child: Child, records: Records) -> None:
    assert child.ask("double", 21) == 42
    child.link.send((-1, "double", 1))
    assert child.ask("double", 2) == 4  # a late answer is dropped
    for k in range(4):
        child.ask("write", (k, 0.5))
    np.testing.assert_array_equal(records.read(), [[2.0, 0.5], [3.0, 0.5]])  # the oldest may be written meanwhile
    np.testing.assert_array_equal(records.read(1), [[3.0, 0.5]])
    assert records.written == 4
    child.link.send((0, "end"))
    assert child.end(20.0) is None
    assert child.code == child.stop() == 0
    refuses("the worker does not run", child.ask, "double", 1)
    assert child.start() == "ready"  # once more
    assert child.ask("double", 1) == 2


def test_an_error_of_a_child_is_raised_in_the_parent(child: Child) -> None:
    """In each thread that polls: a follower that received it does not stop the run."""
    with ThreadPoolExecutor(1) as pool, pytest.raises(InvalidInput, match="the load is too large: got 3"):
        pool.submit(child.ask, "fail").result(20.0)
    for ask in (lambda: child.ask("double", 1), child.raise_if_ended):
        refuses("the load is too large: got 3", ask)


def test_the_error_that_a_child_has_left_is_returned_at_its_end(child: Child) -> None:
    child.link.send((0, "fail"))
    assert "too large" in str(child.end(20.0))


def test_a_child_that_hangs_or_is_killed_is_noticed_and_ended(child: Child) -> None:
    fails(DriveError, "The worker has not answered", child.ask, "hang", patience=0.1)
    assert child.stop() == -signal.SIGTERM
    fails(DriveError, "The worker ended by signal 15", child.raise_if_ended)
    child.end()
    child.start()
    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(child.ask, "hang", patience=60.0)
        time.sleep(0.1)
        child.raise_if_ended()  # does not wait for the other thread
        os.kill(child.pid, signal.SIGKILL)
        fails(DriveError, "The worker ended by signal 9", asking.result, 20.0)


def test_a_child_that_ends_before_it_is_ready_is_one_line() -> None:
    fails(DriveError, r"^The worker ended with code 5\.$", Child("The worker", DriveError, die).start)
