"""Writing that fails at any of its calls: FileProblem, nothing half written, an earlier file is unchanged."""

import errno
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import FileProblem
from hyperflex.report import CastReport, animate, whole_folder
from hyperflex.report.page import Section, write_page
from hyperflex.report.style import save_png
from hyperflex.vision import VideoWriter
from tests.faults.writing import CODES, Faults, injected

# Kinds of fault that are tried at each call: 1 usually, 12 (all codes, once and from then on) by night
KINDS = [(code, on) for on in (False, True) for code in CODES]
TRIED = min(int(os.environ.get("HYPERFLEX_FAULTS", "1")), len(KINDS))
EARLIER = b"earlier"

ROPE = hf.Rope.uniform(length=0.4, mass=0.02, n_links=2, friction=1e-4)


@pytest.fixture(scope="module")
def run() -> hf.Trajectory:
    return hf.simulate(ROPE, duration=0.2, q0=[0.3, 0.3])


def png(path: Path, _: hf.Trajectory) -> None:
    from matplotlib.figure import Figure

    save_png(Figure(figsize=(0.3, 0.3)), path)


def mp4(path: Path, _: hf.Trajectory) -> None:
    with VideoWriter(path, (64, 48)) as video:
        video.write(np.zeros((48, 64, 3), dtype=np.uint8), 0.0)


WRITERS: dict[str, Callable[[Path, hf.Trajectory], object]] = {
    "table.csv": lambda path, run: files.write_table(path, ["t", "x"], np.column_stack([run.t, run.tip[:, 0]])),
    "rope.toml": lambda path, _: ROPE.to_toml(path),
    "setup.toml": lambda path, run: run.setup.to_toml(path),
    "figures.json": lambda path, run: files.write_json(path, {"t": run.t}),
    "run.nc": lambda path, run: run.to_netcdf(path),
    "angles.nc": lambda path, run: hf.Recording(run.t, run.q).to_netcdf(path),
    "run.mcap": lambda path, run: hf.write_mcap(run, path),
    "rope.xml": lambda path, run: hf.write_mjcf(run.setup, path),
    "figure.png": png,
    "film.gif": lambda path, run: animate(run, path, end=0.05, width=64),
    "film.mp4": mp4,
    "report.html": lambda path, _: write_page(path, "Title", "Lead.", "simulated", [Section("One", text=("Two.",))]),
}


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def kinds(call: int) -> list[tuple[int, bool]]:
    """Return the faults that are tried at a call: others at each, so that a few calls see them all."""
    return list(itertools.islice(itertools.cycle(KINDS), call, call + TRIED))


def problem_of(write: Callable[[], object]) -> str:
    """Return what FileProblem a writer ends with; empty if it ends well."""
    try:
        write()
    except FileProblem as problem:
        return str(problem)
    return ""


def fail_everywhere(write: Callable[[], object], folder: Path) -> int:
    """Let each call of a writer fail, and check the remaining files; return the number of calls."""
    before = content(folder)
    for call in itertools.count(1):
        for code, on in kinds(call):
            faults = Faults(call, code, on=on)
            with injected(faults):
                said = problem_of(write)
            if not said:
                assert faults.calls < call, f"call {call} failed, and nobody was told"
                return call - 1
            assert str(folder) in said
            assert ".part" not in said
            assert content(folder) == before, f"after call {call} failed"
    raise AssertionError


@pytest.mark.parametrize("earlier", [False, True])
@pytest.mark.parametrize("name", WRITERS)
def test_a_file_is_written_whole_or_not_at_all(tmp_path, run, name, earlier):
    path = tmp_path / name
    WRITERS[name](path, run)  # what is imported then writes, too
    path.unlink()
    if earlier:
        path.write_bytes(EARLIER)
    assert fail_everywhere(lambda: WRITERS[name](path, run), tmp_path) >= 3  # at least opened, forced and moved
    assert path.stat().st_size > len(EARLIER)
    assert set(content(tmp_path)) == {name}


def folder_of_two(path: Path) -> None:
    with whole_folder(path, ["old.txt"]) as stage:
        files.write_text(stage / "a.txt", "new")
        files.write_text(stage / "b.txt", "new")


@pytest.mark.parametrize("earlier", [False, True])
def test_a_folder_is_filled_whole_or_not_at_all(tmp_path, monkeypatch, earlier):
    monkeypatch.setattr("tests.faults.test_outputs.KINDS", KINDS[: len(CODES)])  # what is lost for good: see below
    folder = tmp_path / "report"
    if earlier:
        folder.mkdir()
        for name in ("a.txt", "b.txt", "old.txt", "mine.txt"):
            (folder / name).write_bytes(EARLIER)
    fail_everywhere(lambda: folder_of_two(folder), tmp_path)
    kept = {"mine.txt": EARLIER} if earlier else {}
    assert content(folder) == {"a.txt": b"new", "b.txt": b"new", **kept}


def test_earlier_files_that_cannot_be_put_back_are_kept_and_named(tmp_path):
    """A disk that fails for good while a folder is filled takes nothing away."""
    for call in range(1, 60):
        folder = tmp_path / str(call)
        folder.mkdir()
        for name in ("a.txt", "b.txt", "old.txt"):
            (folder / name).write_bytes(EARLIER)
        faults = Faults(call, CODES[call % len(CODES)], on=True)
        with injected(faults):
            said = problem_of(lambda: folder_of_two(folder))  # noqa: B023 called here
        if not said:
            assert faults.calls < call
            return
        left = content(folder)
        earlier = sorted(Path(name).name for name, each in left.items() if each == EARLIER)
        assert earlier == ["a.txt", "b.txt", "old.txt"]
        assert all("earlier" in said for name in left if "/" in name)
    raise AssertionError


def test_a_plan_is_written_whole_or_not_at_all(tmp_path):
    """A cast that cannot be: its page and its map."""
    rope = hf.Rope.uniform(length=0.4, mass=0.02, n_links=4, radius=0.002, friction=1e-4)
    report = CastReport(hf.plan_cast(rope, hf.Arm(length=0.1), hf.Peg(2.0, 0.0, 0.03)), None)
    report.write(tmp_path / "warm")  # what is imported then writes, too
    shutil.rmtree(tmp_path / "warm")
    assert fail_everywhere(lambda: report.add_page(tmp_path / "planned"), tmp_path) >= 4
    assert set(content(tmp_path)) == {"planned/report.html"}


LIMITED = """
import resource, sys
import numpy as np
import hyperflex as hf
from hyperflex.errors import FileProblem
from hyperflex.vision import VideoWriter

run = hf.simulate(hf.Rope(length=[0.3], mass=[0.1]), duration=2.0, q0=[0.5])
sys.dont_write_bytecode = True  # Python would keep the half of a module that it could write
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
def film():
    with VideoWriter("film.mp4", (320, 240)) as video:
        for k in range(10):
            video.write(np.random.default_rng(k).integers(0, 255, (240, 320, 3), dtype=np.uint8), k / 30)
for write in (lambda: run.to_netcdf("run.nc"), film):
    try:
        write()
    except FileProblem as error:
        print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs a file size limit")
def test_native_writers_end_with_a_message_where_the_disk_is_full(tmp_path):
    """HDF5 and FFmpeg, in a process of their own: the one crashed when the process ended."""
    (tmp_path / "run.nc").write_bytes(EARLIER)
    child = subprocess.run([sys.executable, "-c", LIMITED], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert child.returncode == 0, child.stderr
    assert child.stderr == ""
    first, second = child.stdout.splitlines()
    assert "run.nc could not be written: no space left. The earlier file is unchanged" in first
    assert "film.mp4 could not be written: no space left. Nothing was written" in second
    assert content(tmp_path) == {"run.nc": EARLIER}


SAME = """
import sys
import numpy as np
import hyperflex as hf
from hyperflex import files
from hyperflex.report import whole_folder
number, kind = float(sys.argv[1]), sys.argv[2]
for _ in range(10):
    if kind == "shared.csv":
        files.write_table("shared.csv", ["t", "x"], np.full((400, 2), number))
    elif kind == "shared.nc":
        t = np.linspace(0.0, 1.0, 200)
        hf.Recording(t, np.full((200, 1), number)).to_netcdf("shared.nc")
    else:
        with whole_folder("shared") as stage:
            for name in ("a.toml", "b.toml"):
                files.write_toml(stage / name, {"x": number})
"""


@pytest.mark.parametrize("kind", ["shared.csv", "shared.nc", "shared"])
def test_several_processes_at_once_leave_a_whole_file_or_folder(tmp_path, kind):
    words = [[sys.executable, "-c", SAME, str(k), kind] for k in (1, 2, 3)]
    rivals = [subprocess.Popen(each, cwd=tmp_path, stderr=subprocess.PIPE, text=True) for each in words]
    while kind == "shared.csv" and any(rival.poll() is None for rival in rivals):
        if (tmp_path / kind).exists():
            assert len(set(files.read_table(tmp_path / kind).values.ravel())) == 1
    told = [rival.communicate()[1] for rival in rivals]
    assert [rival.returncode for rival in rivals] == [0, 0, 0], told
    assert [path.name for path in tmp_path.iterdir()] == [kind]
    if kind == "shared.nc":
        assert len(set(hf.read_recording(tmp_path / kind).data.ravel())) == 1
    elif kind == "shared":
        assert {path.name for path in (tmp_path / kind).iterdir()} == {"a.toml", "b.toml"}
        assert all(files.read_toml(path)["x"] in {1.0, 2.0, 3.0} for path in (tmp_path / kind).iterdir())


def test_a_read_only_disk_is_reported(tmp_path, monkeypatch):
    """Such a disk also refuses to remove missing files."""

    def refused(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    for name in ("open", "unlink"):
        monkeypatch.setattr(os, name, refused)
    with pytest.raises(FileProblem, match=r"out\.txt could not be written: Read-only file system\. Nothing was"):
        files.write_text(tmp_path / "out.txt", "text")
