"""The suite's own options: real recordings that are missing are skipped, counted, or on demand a failure."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

INNER = """
import pytest

def test_with_recordings(data_dir):
    assert data_dir.is_dir()

def test_skipped_for_another_reason():
    pytest.skip("another reason")
"""


def run_suite(folder: Path, *options: str, data: Path | None = None) -> tuple[int, str]:
    """Run a small suite with this suite's conftest in a folder beside which there are no recordings."""
    folder.mkdir()
    shutil.copy(Path(__file__).parent / "conftest.py", folder)
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = data\n")
    (folder / "test_inner.py").write_text(INNER)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("HYPERFLEX_DATA", "PYTEST_"))}
    environment |= {"HYPERFLEX_DATA": str(data)} if data else {}
    command = [sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider", *options]
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return run.returncode, run.stdout


@pytest.mark.parametrize("options", [(), ("-n", "2")], ids=["one process", "two processes"])
def test_missing_recordings_are_skipped_and_counted(tmp_path, options):
    code, said = run_suite(tmp_path / "suite", *options)
    assert code == 0
    assert "skipped for want of data: 1" in said
    assert "set HYPERFLEX_DATA" in said


def test_missing_recordings_fail_on_demand(tmp_path):
    code, said = run_suite(tmp_path / "suite", "--require-data")
    assert code == 1
    assert "real recordings not found" in said
    assert "skipped for want of data: 0" in said


def test_named_folder_that_is_not_there_fails(tmp_path):
    code, _ = run_suite(tmp_path / "suite", data=tmp_path / "nowhere")
    assert code == 1


def test_recordings_are_found(tmp_path):
    beside = tmp_path / "shared" / "data"
    beside.mkdir(parents=True)
    code, said = run_suite(tmp_path / "suite", "--require-data")
    assert code == 0
    assert "1 passed, 1 skipped" in said
    code, said = run_suite(tmp_path / "other", "--require-data", data=beside)
    assert "1 passed, 1 skipped" in said


def test_tests_that_ask_for_recordings_are_marked(tmp_path):
    _, said = run_suite(tmp_path / "suite", "-m", "data", "--collect-only", "-q")
    assert "test_with_recordings" in said
    assert "test_skipped_for_another_reason" not in said
