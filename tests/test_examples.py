"""Every example runs to its end, where it checks itself."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 5


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_checks_itself(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert any(isinstance(node, ast.Assert) for node in ast.parse(path.read_text()).body)
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
