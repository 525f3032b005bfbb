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


@pytest.mark.parametrize(
    ("options", "data", "code", "said"),
    [
        ((), None, 0, "skipped for want of data: 1"),
        pytest.param(("-n", "2"), None, 0, "skipped for want of data: 1", marks=pytest.mark.nightly),
        (("--require-data",), None, 1, "real recordings not found"),
        pytest.param((), "nowhere", 1, "skipped for want of data: 0", marks=pytest.mark.nightly),
        (("--require-data",), "shared/data", 0, "1 passed, 1 skipped"),
        (("-m", "data"), None, 0, "1 skipped, 1 deselected"),
    ],
)
def test_missing_recordings_are_counted_or_fail_on_demand(tmp_path, options, data, code, said):
    """In a small suite with this suite's conftest, in a folder beside which there are recordings or none."""
    folder = tmp_path / "suite"
    folder.mkdir()
    if data == "shared/data":
        (tmp_path / data).mkdir(parents=True)
    shutil.copy(Path(__file__).parent / "conftest.py", folder)
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = data\n")
    (folder / "test_inner.py").write_text(INNER)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("HYPERFLEX_DATA", "PYTEST_"))}
    environment |= {"HYPERFLEX_DATA": str(tmp_path / data)} if data == "nowhere" else {}
    command = [sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider", *options]
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert (run.returncode, said in run.stdout) == (code, True), run.stdout
