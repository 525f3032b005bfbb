"""Every example runs to its end, where it checks itself."""

import ast
import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


def test_there_are_examples():
    assert len(EXAMPLES) >= 5


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_checks_itself(path, tmp_path, monkeypatch):
    assert any(isinstance(node, ast.Assert) for node in ast.parse(path.read_text()).body)
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
