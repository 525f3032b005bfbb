import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hyperflex.cli.app import run
from hyperflex.demo import Demo, report, write_demo
from hyperflex.execution import CastRun, StreamLog
from hyperflex.execution.stream import FIELDS
from hyperflex.planning import CastPlan

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


def carried_out(plan: CastPlan, *_: object) -> tuple[CastRun, str]:
    """Return a run that an ideal drive would have made of a plan in real time, and that is fair."""
    motion = plan.required(plan.motion, "motion")
    t = np.arange(-0.5, motion.end + 4.0, 0.01)
    rows = np.zeros((t.size, len(FIELDS)))
    for name, column in {"sent": t, "received": t, "goal_angle": motion.angle(t), "angle": motion.angle(t)}.items():
        rows[:, FIELDS.index(name)] = column
    return CastRun(plan, motion, StreamLog(rows, 100.0), observed=(t, np.full((t.size, 2), 1.6))), ""


@pytest.fixture(scope="session")
def demo_report(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """The demo, run once; its drive, which takes half a minute, is emulated in the nightly tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "_carried_out", carried_out)
        return write_demo(tmp_path_factory.mktemp("demo") / "folder")
