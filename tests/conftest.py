"""What every test shares: the real recordings, the hypothesis profiles, a Matplotlib without a screen."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from tests.browser import Browser

WANT = "real recordings not found"

os.environ["MPLBACKEND"] = "Agg"
for library in (
    "OPENBLAS",
    "MKL",
    "OMP",
):  # tests run side by side: threads that wait for each other take most of the time
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# as a shell, or nohup, starts what it leaves in the background
for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)

# The first example compiles kernels, so a deadline would time the compiler; "ci" draws the same examples in each run.
settings.register_profile("dev", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", parent=settings.get_profile("dev"), derandomize=True, database=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--require-data",
        action="store_true",
        help="fail, rather than skip, where a test needs real recordings that are not there",
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "data_dir" in getattr(item, "fixturenames", ()):
            item.add_marker("data")
    # before tests/claims, so that one process makes the paper's runs for both
    items.sort(key=lambda item: "paper" not in item.path.parts)


def recordings_folder(root: Path) -> Path:
    """Return $HYPERFLEX_DATA if it is set, else shared/data next to the project."""
    named = os.environ.get("HYPERFLEX_DATA")
    return Path(named).expanduser() if named else root.parent / "shared" / "data"


@pytest.fixture(scope="session")
def data_dir(pytestconfig: pytest.Config) -> Path:
    """Folder of the real recordings; without it the test skips, or fails under --require-data."""
    folder = recordings_folder(pytestconfig.rootpath)
    if folder.is_dir():
        return folder
    reason = f"{WANT}: no folder {folder} (set HYPERFLEX_DATA to where they are)"
    if pytestconfig.getoption("--require-data") or os.environ.get("HYPERFLEX_DATA"):
        pytest.fail(reason, pytrace=False)
    pytest.skip(reason)


LOADED = (  # what children of the tests begin with
    *("pytest", "hyperflex.execution.stream", "hyperflex.hardware.emulate.process", "hyperflex.play.planning_process"),
    *("hyperflex.estimate.live.state_source", "tests.execution.ideal_link", "benchmarks.hard_videos"),
)


@pytest.fixture(scope="session", autouse=True)
def quick_children(pytestconfig: pytest.Config) -> Iterator[None]:
    """Fork children in the gate from a process that has imported what they need: starting each anew takes a second.

    Without ``-m "not nightly"`` they start as those of a user do, and as those of the programs that tests start do.
    """
    if pytestconfig.getoption("markexpr") != "not nightly" or sys.platform != "linux":
        yield
        return
    from hyperflex import child

    forks = multiprocessing.get_context("forkserver")
    forks.set_forkserver_preload(list(LOADED))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(child, "multiprocessing", SimpleNamespace(get_context=lambda _: forks))
        yield


@pytest.fixture(scope="session")
def browser(pytestconfig: pytest.Config) -> "Iterator[Browser]":
    """A browser without a window; without one the test skips, or fails under --require-data and in CI."""
    from tests.browser import NAMES, Browser, found  # the suite's options are tried without the other files

    program = found()
    if program is None:
        reason = f"no browser found ({', '.join(NAMES)}): on Debian, apt-get install chromium"
        if pytestconfig.getoption("--require-data") or os.environ.get("CI"):
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)
    page = Browser(program)
    yield page
    page.close()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    skipped = terminalreporter.stats.get("skipped", [])
    count = sum(WANT in str(report.longrepr) for report in skipped)
    terminalreporter.write_line(f"skipped for want of data: {count}")
