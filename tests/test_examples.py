"""Every example runs to its end, where it checks itself."""

import ast
import json
import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
LONG = "05_environment", "06_insert", "07_switch"  # tests/envs and tests/planning have their parts in the gate


def test_there_are_examples():
    assert len(EXAMPLES) >= 5


@pytest.mark.parametrize(
    "path", [pytest.param(each, id=each.stem, marks=[pytest.mark.nightly] * (each.stem in LONG)) for each in EXAMPLES]
)
def test_example_runs_and_checks_itself(path, tmp_path, monkeypatch):
    assert any(isinstance(node, ast.Assert) for node in ast.parse(path.read_text()).body)
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")


@pytest.mark.nightly
def test_the_notebook_goes_from_file_to_cast(tmp_path, monkeypatch):
    """Its cells, one after the other; it is kept without outputs."""
    notebook = json.loads((EXAMPLES[0].parent / "file_to_cast.ipynb").read_text("utf-8"))
    cells = [each for each in notebook["cells"] if each["cell_type"] == "code"]
    assert all(each["outputs"] == [] and each["execution_count"] is None for each in cells)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for number, each in enumerate(cells):
        exec(compile("".join(each["source"]), f"cell {number}", "exec"), names)
    assert (tmp_path / "motion.csv").exists()
