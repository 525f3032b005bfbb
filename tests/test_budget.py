"""Budgets: elapsed time, shares, cancelling, and time that does not count."""

import math

import pytest

import hyperflex.budget
from hyperflex.budget import Budget, OutOfTime
from tests.refusals import refuses


class Clock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.t = 100.0

    def __call__(self) -> float:
        return self.t


def test_time_passes_by_the_clock():
    clock = Clock()
    budget = Budget(10.0, clock=clock)
    clock.t += 4.0
    assert (budget.elapsed, budget.remaining, budget.expired) == (4.0, 6.0, False)
    budget.check()
    clock.t += 6.0
    assert budget.expired
    with pytest.raises(OutOfTime):
        budget.check()


def test_a_part_never_outlives_the_whole():
    clock = Clock()
    whole = Budget(10.0, clock=clock)
    clock.t += 2.0
    part, long = whole.share(0.5), whole.limit(60.0)
    assert (part.remaining, long.remaining) == (4.0, 8.0)
    clock.t += 5.0
    assert (part.expired, whole.expired, long.remaining) == (True, False, 3.0)


def test_cancelling_ends_a_part_and_its_parts_alone():
    whole = Budget()
    part = whole.limit(5.0)
    inner = part.share(0.5)
    part.cancel()
    assert (whole.expired, part.expired, inner.expired) == (False, True, True)
    with pytest.raises(OutOfTime):
        inner.check()


def test_compiling_does_not_count(monkeypatch):
    clock = Clock()
    budget = Budget(10.0, clock=clock)
    clock.t += 60.0
    monkeypatch.setattr(hyperflex.budget, "compiling", lambda: budget._compiled + 58.0)
    assert budget.elapsed == pytest.approx(2.0)


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, "soon"])
def test_seconds_are_checked(wrong):
    refuses("time_budget", Budget.of, wrong)


def test_what_remains_of_a_budget_that_is_given_has_threads_of_its_own():
    clock = Clock()
    whole = Budget(10.0, threads=3, clock=clock)
    clock.t += 4.0
    part = Budget.of(whole, threads=2)
    assert (part.elapsed, part.remaining, part.threads, whole.threads) == (0.0, 6.0, 2, 3)
    assert Budget.of(whole) is whole
    assert Budget.of(None).remaining == math.inf


def test_progress_is_reported_to_the_bar_of_the_block(capsys):
    seen: list[float] = []
    budget = Budget(10.0)
    with budget.progress(False, "planning"):
        budget.share(0.5).report(1.0)  # nobody watches
    early = budget.share(0.5)  # made before the bar
    budget._report = seen.append
    early.report(3.0)
    budget.share(0.5).report(4.0)
    assert seen == [3.0, 4.0]
    assert capsys.readouterr().err == ""
