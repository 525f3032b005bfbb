"""A report's folder: all of its files or none, and earlier files are kept or restored."""

import errno
from pathlib import Path

import pytest

from hyperflex import files
from hyperflex.errors import FileProblem
from hyperflex.report.folder import whole_folder


def content(folder: Path) -> dict[str, str]:
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}


def fill(stage: Path) -> None:
    for name in ("a", "b", "c"):
        files.write_text(stage / name, "new")


def test_a_new_folder_appears_with_its_parents(tmp_path):
    with whole_folder(tmp_path / "x" / "y") as stage:
        fill(stage)
        assert not (tmp_path / "x").exists()
    assert content(tmp_path) == {"x/y/a": "new", "x/y/b": "new", "x/y/c": "new"}
    assert [path.name for path in tmp_path.iterdir()] == ["x"]


def test_files_of_an_earlier_report_go(tmp_path):
    for name in ("b", "old", "mine"):
        (tmp_path / name).write_text("earlier")
    with whole_folder(tmp_path, ("a", "b", "old", "never")) as stage:
        fill(stage)
        assert (tmp_path / "old").read_text() == "earlier"
    assert content(tmp_path) == {"a": "new", "b": "new", "c": "new", "mine": "earlier"}


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left on device")])
@pytest.mark.parametrize("last", range(1, 10))
def test_a_move_that_fails_halfway_is_undone(tmp_path, monkeypatch, failure, last):
    for name in ("b", "old", "older"):
        (tmp_path / name).write_text("earlier")
    rename, calls = Path.rename, []

    def failing(self, to):
        calls.append(self)
        if len(calls) == last:  # each name out of the way, and to its place
            raise failure
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises((KeyboardInterrupt, FileProblem)), whole_folder(tmp_path, ("old", "older")) as stage:
        fill(stage)
    assert len(calls) == last
    assert content(tmp_path) == {"b": "earlier", "old": "earlier", "older": "earlier"}
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]


@pytest.mark.parametrize("there", [True, False])
def test_an_interrupted_block_leaves_nothing(tmp_path, there):
    target = tmp_path if there else tmp_path / "x" / "y"

    def stop(stage):
        fill(stage)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), whole_folder(target) as stage:
        stop(stage)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_the_way_of_a_file_stays(tmp_path):
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine").write_text("earlier")
    with pytest.raises(FileProblem, match="where a file shall go"), whole_folder(tmp_path) as stage:
        fill(stage)
    assert content(tmp_path) == {"b/mine": "earlier"}


def test_a_folder_that_cannot_be_made_is_refused_before_any_work(tmp_path):
    with pytest.raises(FileProblem, match="cannot be made"), whole_folder(tmp_path / ("x" * 300)):
        pytest.fail("work began")
