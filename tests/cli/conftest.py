import json
from collections.abc import Callable
from typing import Any

import pytest

from hyperflex.cli.app import run
from hyperflex.demo import Demo, write_demo

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def hyperflex(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in this process; returns exit code, standard output and standard error."""

    def call(*arguments: object) -> tuple[int, str, str]:
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def hyperflex_json(hyperflex: Run) -> Callable[..., tuple[int, dict[str, Any]]]:
    """Run a command with --json; its standard output must be exactly one JSON object."""

    def call(*arguments: object) -> tuple[int, dict[str, Any]]:
        code, out, _ = hyperflex(*arguments, "--json")
        result = json.loads(out)
        assert isinstance(result, dict)
        return code, result

    return call


@pytest.fixture
def refused(hyperflex: Run) -> Callable[..., str]:
    """Run a command that must be refused, with one line on standard error; returns the line."""

    def call(*arguments: object) -> str:
        code, out, err = hyperflex(*arguments)
        assert (code, out, err.count("\n")) == (2, "", 1), err
        return err

    return call


@pytest.fixture(scope="session")
def demo_report(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """The demo, run once."""
    return write_demo(tmp_path_factory.mktemp("demo") / "folder")
