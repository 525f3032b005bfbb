"""No test of this suite is one that never runs; and the guard that says so sees each way of not running."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests import guard

HERE = Path(__file__).parent

GOOD = "def helper(x):\n    assert x > 0\n\ndef test_a():\n    helper(1)\n"
BAD = {
    "wrong file": ("helpers.py", "def test_a():\n    assert len('a')\n"),
    "nested": ("test_x.py", "def test_a():\n    def test_b():\n        assert len('a')\n    assert len('b')\n"),
    "class without the prefix": ("test_x.py", "class Chain:\n    def test_a(self):\n        assert len('a')\n"),
    "class with __init__": (
        "test_x.py",
        "class TestA:\n    def __init__(self):\n        self.a = 1\n    def test_a(self):\n        assert self.a\n",
    ),
    "empty class": ("test_x.py", "class TestA:\n    size = 3\n"),
    "shadowed": ("test_x.py", "def test_a():\n    assert len('a')\n\ndef test_a():\n    assert len('b')\n"),
    "misspelt": ("test_x.py", "def tets_a():\n    assert len('a')\n"),
    "unused fixture": ("test_x.py", "import pytest\n@pytest.fixture\ndef rope():\n    return 1\n"),
    "checks nothing": ("test_x.py", "def test_a():\n    print(len('a'))\n"),
    "constant assert": ("test_x.py", "def test_a():\n    assert True\n"),
    "assert on a tuple": ("test_x.py", "def test_a():\n    assert (len('a') == 2, 'message')\n"),
    "skipped": ("test_x.py", "import pytest\n@pytest.mark.skip\ndef test_a():\n    assert len('a')\n"),
    "expected to fail": (
        "test_x.py",
        "import pytest\n@pytest.mark.xfail(reason='x')\ndef test_a():\n    assert len('a')\n",
    ),
    "switched off": ("test_x.py", "def test_a():\n    assert len('a')\ntest_a.__test__ = False\n"),
}


def test_every_test_of_the_suite_can_run_and_can_fail():
    assert guard.faults(guard.modules(HERE)) == []


@pytest.mark.parametrize("case", BAD)
def test_guard_sees(case):
    name, source = BAD[case]
    assert len(guard.faults({Path(name): ast.parse(source)})) >= 1


def test_guard_is_content_with_a_test_that_asserts_through_a_helper():
    assert guard.faults({Path("test_x.py"): ast.parse(GOOD)}) == []


def collected(session: pytest.Session) -> list[str]:
    """Return the names of all tests: those of this run if it is of the whole suite, else those that a new one finds."""
    if session.config.args == session.config.getini("testpaths") and not session.config.option.markexpr:
        return [item.nodeid for item in session.items]
    arguments = ["--collect-only", "-q", "-o", "addopts=--import-mode=importlib", str(HERE)]
    command = [sys.executable, "-m", "pytest", *arguments]
    run = subprocess.run(command, cwd=HERE.parent, capture_output=True, text=True, check=False)
    return [line for line in run.stdout.splitlines() if "::" in line]


def test_pytest_collects_every_test_that_the_sources_hold(request):
    found = collected(request.session)
    seen = {tuple(name.partition("[")[0].split("::")) for name in found}
    names = {(parts[0], parts[-1]) for parts in seen}
    missing = [
        f"{path.relative_to(HERE.parent)}::{test.name}"
        for path, tree in guard.modules(HERE).items()
        if guard.collected_file(path)
        for test in guard.collected_tests(tree)
        if (path.relative_to(HERE.parent).as_posix(), test.name) not in names
    ]
    assert missing == [], found[-20:]
