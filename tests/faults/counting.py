"""How many faults the tests try: one a test, or as many as a test counts itself."""

from collections import Counter
from typing import ClassVar

import pytest

_tried = 0


def count() -> None:
    """Count one fault of the test that runs."""
    global _tried  # noqa: PLW0603 tests run one after the other
    _tried += 1


class Tally:
    """A plugin of pytest: for each kind, the faults that were tried and those that did not end as they should.

    A test stops at the first fault that does not end as it should, so of a test that fails one is counted.
    """

    kinds: ClassVar[dict[str, str]] = {  # by a word in the name of a test; the first that fits
        "several_processes": "several processes at once on one output or one cache",
        "two_processes": "several processes at once on one output or one cache",
        "test_interruption": "signals at chosen moments",
        "test_outputs": "writing that fails at one of its calls to the system",
        "test_cache": "kernel cache damaged, incomplete, full, read-only",
        "test_budgets": "too little time, memory or disk",
        "test_readers": "files damaged at random",
        "test_trackers": "tables and set-up files that are odd or wrong",
        "test_arguments": "odd arguments of public calls",
        "test_bad_input": "odd arguments of public calls",
        "test_options": "odd options of commands",
        "test_bad_files": "odd options of commands",
        "test_rows": "each fault that was found once",
    }

    def __init__(self) -> None:
        self.tried: Counter[str] = Counter()
        self.wrong: Counter[str] = Counter()

    def add(self, kind: str, tried: int, wrong: int) -> None:
        """Add faults of a kind."""
        self.tried[kind] += tried
        self.wrong[kind] += wrong

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self) -> None:
        """Begin to count."""
        global _tried  # noqa: PLW0603
        _tried = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add what a test has tried."""
        if report.when == "call" and not report.skipped:
            kind = next(kind for word, kind in self.kinds.items() if word in report.nodeid)
            self.add(kind, _tried or 1, report.failed)
        elif report.failed:
            self.add("tests that could not be set up or cleaned up", 1, 1)

    def table(self) -> str:
        """Return a table in Markdown."""
        lines = ["| kind | tried | passed | failed |", "|---|---:|---:|---:|"]
        for kind, tried in self.tried.items():
            lines.append(f"| {kind} | {tried} | {tried - self.wrong[kind]} | {self.wrong[kind]} |")
        tried, wrong = self.tried.total(), self.wrong.total()
        return "\n".join([*lines, f"| **together** | {tried} | {tried - wrong} | {wrong} |"])
