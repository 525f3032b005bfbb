"""Memory, time and places of results are looked at before the work; what cannot be written is kept elsewhere."""

import errno
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files, memory, progress
from hyperflex.budget import Budget
from hyperflex.cli.app import run
from hyperflex.errors import FileProblem, IdentificationError, InvalidInput, SimulationError
from hyperflex.files import writing
from hyperflex.identification import Kind
from hyperflex.simulation import rollouts
from tests.refusals import fails, refuses

ROPE = hf.Rope.uniform(length=0.4, mass=0.02, n_links=4, radius=0.002, friction=1e-4)
LONG = hf.Rope.uniform(length=2.0, mass=0.125, n_links=5000, radius=0.0025, friction=5e-4)


# ---- memory


@pytest.fixture
def one_gibibyte(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: 2.0**30)


@pytest.mark.usefixtures("one_gibibyte")
def test_what_would_fill_the_memory_is_refused_before_it_is_begun(monkeypatch):
    refuses(r"5000 links with 1000001 outputs would fill.*GiB.*1 GiB here.*t_eval", hf.simulate, LONG, duration=1e4)
    with pytest.raises(InvalidInput, match=r"1000 members with 20000 outputs of q, qd.*take fewer members"):
        hf.simulate_batch([ROPE] * 1000, duration=1.0, t_eval=np.linspace(0.0, 1.0, 20_000), keep=["q", "qd"])
    with pytest.raises(InvalidInput, match=r"derivatives of 4 links by 5 parameters at 1000001 outputs"):
        hf.sensitivities(ROPE, duration=1e4, wrt=["friction[:]", "tip_mass"])
    monkeypatch.setattr(memory, "available", lambda: 2.0**27)
    t = np.arange(40_000) / 100.0
    many = hf.Recording(t, np.random.default_rng(1).normal(0.0, 0.1, (t.size, 10)))
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=10, friction=0.0)
    words = r"fit of 20 parameters of 10 links to 320000 values would fill.*Free fewer"
    refuses(words, hf.identify, many, rope, ["friction", "inertia"])
    assert hf.simulate(ROPE, duration=0.1).success


def test_the_least_of_machine_container_and_process_counts(tmp_path, monkeypatch):
    info, groups = tmp_path / "meminfo", tmp_path / "cgroup"
    monkeypatch.setattr(memory, "_INFO", info)
    monkeypatch.setattr(memory, "_CGROUPS", groups)
    info.write_text("MemTotal:       9000 kB\nMemAvailable:   8000 kB\n")
    assert memory.available() == 8000 * 1024
    (groups / "memory").mkdir(parents=True)
    (groups / "memory" / "memory.limit_in_bytes").write_text("5000000\n")
    (groups / "memory" / "memory.usage_in_bytes").write_text("1000000\n")
    assert memory.available() == 4e6
    (groups / "memory.max").write_text("max\n")
    assert memory.available() == 4e6
    (groups / "memory.max").write_text("4000000\n")
    (groups / "memory.current").write_text("3000000\n")
    (groups / "memory.stat").write_text("anon 5\ninactive_file 500000\n")
    assert memory.available() == 1.5e6
    info.unlink()
    shutil.rmtree(groups)
    assert memory.available() > 2.0**28  # another system: all that the machine has


def test_memory_that_a_process_may_not_have_is_not_there():
    script = """
import resource
import hyperflex as hf
rope = hf.Rope.uniform(length=0.4, mass=0.02, n_links=40, friction=0.0)
hf.simulate(rope, duration=0.1)
resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
try:
    hf.simulate(rope, duration=9e4)
except hf.InvalidInput as error:
    print(error)
"""
    child = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "a run of 40 links with 9000001 outputs would fill the memory" in child.stdout


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError("74 GiB"), "memory is full"),
        (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), "memory is full"),  # as PyAV says it
        (RuntimeError("can't start new thread"), "memory is full"),
        (RecursionError(), "nested"),
        (OverflowError(34, "too large"), "out of range"),
    ],
)
def test_what_fails_all_the_same_is_a_message(tmp_path, monkeypatch, capsys, error, words):
    def fail(*_, **__):
        raise error

    hf.Setup(ROPE, duration=0.1).to_toml(tmp_path / "setup.toml")
    monkeypatch.setattr("hyperflex.simulation.simulate", fail)
    assert run(["simulate", str(tmp_path / "setup.toml"), "-o", str(tmp_path / "run.nc"), "--json"]) == 2
    out, err = capsys.readouterr()
    told = words in err, "bug" in err, "Traceback" in err, words in json.loads(out)["error"]
    assert told == (True, False, False, True)


# ---- time


def test_a_run_that_came_to_its_end_is_kept_however_long_it_took():
    ticks = iter([0.0, 0.5, *[2.0] * 100])
    short = hf.simulate(
        hf.Rope.uniform(1.0, 0.1, 3, friction=0.0), duration=0.01, time_budget=Budget(1.0, clock=lambda: next(ticks))
    )
    assert (short.status, short.t[-1]) == ("success", 0.01)


def test_a_run_without_end_ends_early_unless_it_may_continue(monkeypatch):
    monkeypatch.setattr(rollouts, "PREDICTED", 0.0)
    monkeypatch.setattr(rollouts, "DEFAULT_TIME", 0.0)
    times = np.linspace(0.0, 1e4, 10_001)
    with pytest.raises(SimulationError, match=r"minutes in all\. Check units and gravity.*time_budget=inf"):
        hf.simulate(ROPE, duration=1e4, t_eval=times, q0=[1.0] * 4)
    part = hf.simulate(ROPE, duration=1e4, t_eval=times, q0=[1.0] * 4, throw=False)
    assert part.status == "out of time"
    assert 0.0 < part.t[-1] < 1e4
    assert hf.simulate(ROPE, duration=2.0, q0=[1.0] * 4, time_budget=math.inf).success
    with pytest.raises(SimulationError, match=r"loosen tol, or make it shorter\.$"):
        hf.sensitivities(ROPE, duration=1e4, t_eval=times, q0=[1.0] * 4, wrt="friction")


@pytest.mark.parametrize("throw", [True, False])
def test_a_torque_callback_heeds_time_budget_and_progress(monkeypatch, capsys, throw):
    monkeypatch.setattr(progress, "EVERY", 0.05)
    how = {"arm": hf.Arm(0.1, mass=0.1, inertia=1e-3), "duration": 100.0, "control_rate": 50.0, "progress": True}

    def torque(*_):
        end = time.thread_time() + 0.02
        while time.thread_time() < end:
            pass
        return 1e-3

    hf.simulate(ROPE, torque=lambda *_: 1e-3, **{**how, "duration": 0.1})  # loads the kernels
    capsys.readouterr()
    if throw:
        fails(SimulationError, "its time budget is over", hf.simulate, ROPE, torque=torque, time_budget=0.3, **how)
    else:
        part = hf.simulate(ROPE, torque=torque, time_budget=0.3, throw=False, **how)
        assert (part.status, part.setup.torque.torque(0.0)) == ("out of time", 1e-3)
        assert 0.05 < part.t[-1] < 1.0
    assert re.search("simulating: [01] of 100 s; begun", capsys.readouterr().err)


def test_a_fit_ends_when_its_time_budget_is_over():
    t = np.arange(2000) / 100.0
    noise = hf.Recording(t, np.random.default_rng(1).normal(0.0, 1.0, (t.size, 1)))
    rod, heard = hf.Rope([0.3], [0.1], friction=2e-4), []
    with pytest.raises(IdentificationError, match=r"over before anything was fitted to 1600 samples\. Allow more"):
        hf.identify(noise, rod, ["friction"], time_budget=1e-6)

    def work(entry):
        heard.append(entry)
        end = time.thread_time() + 0.15
        while time.thread_time() < end:
            pass

    found = hf.identify(noise, rod, ["friction"], time_budget=0.5, progress=work)
    assert (found.success, found.status) == (False, "out of time")
    assert found.has(Kind.NOT_CONVERGED)
    assert len(heard) < 6
    assert found.held_out is None


def test_what_nobody_waits_for_is_refused():
    """Runge-Kutta with thousands of links, and a cast that may swing for ever."""
    words = r"fixed step.*got 5000. Allowed: up to 1000. Leave it out"
    refuses(words, hf.simulate, LONG, duration=1.0, step=1e-3)
    words, ever = r"time is longer than anybody swings.*got 10000000000\.0.*100 periods", hf.Conditions(time_limit=1e10)
    refuses(words, hf.plan_cast, ROPE, hf.Arm(length=0.1), hf.Peg(0.3, -0.2, 0.03), conditions=ever)


def test_a_peg_that_no_links_can_follow_is_refused(tmp_path, capsys):
    thin, peg = ROPE.replace(radius=0.0), hf.Peg(0.3, -0.2, 1e-9)
    for call in (
        lambda: hf.refine_rope(thin, [peg]),
        lambda: hf.simulate(thin, duration=0.1, pegs=[peg]),
        lambda: hf.plan_cast(thin, hf.Arm(length=0.1), peg),
    ):
        refuses(r"too many links.*got '.*e\+\d+ links'.*up to 10000.*radii", call)
    thin.to_toml(tmp_path / "rope.toml")
    place = ["--target", "0.3", "-0.2", "--radius", "1e-9", "-o", str(tmp_path / "planned")]
    assert run(["cast", "--rope", str(tmp_path / "rope.toml"), *place]) == 2
    assert "too many links" in capsys.readouterr().err


# ---- progress where nobody watches


def test_a_line_now_and_then_where_nobody_watches(monkeypatch, capsys):
    monkeypatch.setattr(progress, "EVERY", 0.01)
    before, said = threading.active_count(), ""
    with progress.progress_bar(1.0, 5.0, True, "fitting", "models") as report:
        assert report is not None
        while "fitting: 2 of 4 models; begun" not in said:
            report(3.0)
            time.sleep(0.01)
            said += capsys.readouterr().err
    assert threading.active_count() == before
    with progress.progress_bar(0.0, 1.0, False) as report:
        assert report is None


def test_the_commands_tell_how_far_they_are(tmp_path, monkeypatch):
    heard: list[str] = []

    @contextmanager
    def lines():
        yield heard.append

    monkeypatch.setattr(progress, "lines", lines)
    true = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)
    hf.Setup(true, duration=3.0, q0=[0.5]).to_toml(tmp_path / "setup.toml")
    assert run(["simulate", str(tmp_path / "setup.toml"), "-o", str(tmp_path / "run.nc"), "--json"]) == 0
    assert "simulating: 3 of 3 s" in heard
    swing = hf.simulate(true, duration=3.0, q0=[0.5])
    hf.Recording(swing.t, swing.q).to_netcdf(tmp_path / "swing.nc")
    true.replace(friction=4e-4).to_toml(tmp_path / "guess.toml")
    given = ["--rope", str(tmp_path / "guess.toml"), "--free", "friction", "-o", str(tmp_path / "rope.toml")]
    assert run(["identify", str(tmp_path / "swing.nc"), *given]) == 0
    assert any(words.startswith("stage 1 of ") for words in heard)


# ---- where results go


@pytest.fixture
def full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that takes the check, and is full when a file is moved into place; the fallback folders are others."""
    folder, replace = tmp_path / "full", writing._replace
    folder.mkdir()

    def fail(part: Path, target: Path) -> None:
        if folder in target.parents:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(part, target)

    monkeypatch.setattr(writing, "_replace", fail)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    return folder


KEPT = {  # what a command writes, and a file of it
    "run.nc": ("run.nc", ["simulate", "setup.toml"]),
    "found": ("rope.toml", ["identify", "swing.nc", "--rope", "rope.toml", "--free", "friction:shared"]),
    "paper": ("fig10.png", ["reproduce", "fig10"]),
}


@pytest.mark.parametrize(("out", "name", "words"), [(out, *rest) for out, rest in KEPT.items()])
def test_a_result_that_cannot_be_written_is_kept_elsewhere(tmp_path, full_disk, capsys, monkeypatch, out, name, words):
    hf.Setup(ROPE, duration=0.1).to_toml(tmp_path / "setup.toml")
    ROPE.to_toml(tmp_path / "rope.toml")
    swing = hf.simulate(ROPE.replace(friction=2e-4), duration=3.0, q0=[0.5] * 4)
    hf.Recording(swing.t, swing.q).to_netcdf(tmp_path / "swing.nc")
    monkeypatch.chdir(tmp_path)
    assert run([*words, "-o", str(full_disk / out), "--json"]) == 2
    [kept] = (tmp_path / "state" / "hyperflex").rglob(name)
    said = json.loads(capsys.readouterr().out)["error"]
    assert "could not be written: no space left" in said
    assert said.endswith(f"The result is in {kept if out == name else kept.parent} instead.")
    assert list(full_disk.iterdir()) == []
    if name == "run.nc":
        assert hf.read_trajectory(kept).success
    elif name == "rope.toml":
        assert hf.Rope.from_toml(kept).friction[0] == pytest.approx(2e-4, rel=0.1)
    else:
        assert kept.with_suffix(".csv").exists()


def test_where_the_users_state_takes_nothing_temporary_files_do(tmp_path, full_disk):
    (tmp_path / "state").write_text("a file, not a folder")
    with pytest.raises(FileProblem, match="The result is in") as caught:
        files.rescued(lambda path: files.write_text(path, "text"), full_disk / "out.txt")
    [kept] = (tmp_path / "temporary").rglob("out.txt")
    assert str(kept) in str(caught.value)


def test_without_any_writable_folder_the_first_reason_is_reported_and_nothing_is_left(tmp_path, full_disk):
    def fail(path):
        raise FileProblem(f"{path} could not be written.")

    fails(FileProblem, r"out\.txt could not be written\.$", files.rescued, fail, full_disk / "out.txt")
    assert [path for path in tmp_path.rglob("*") if path.name.startswith("hyperflex-")] == []


@pytest.mark.parametrize(
    ("command", "work", "words"),
    [
        (["cast", "--rate", "1e6"], "hyperflex.planning.plan_cast", "--rate suits no motor"),
        (["whip", "--rate", "1"], "hyperflex.planning.plan_whip", "--rate suits no motor"),
        (["cast"], "hyperflex.planning.plan_cast", "are free there"),
        (["simulate"], "hyperflex.simulation.simulate", "are free there"),
    ],
)
def test_rates_and_space_are_checked_before_the_work(tmp_path, monkeypatch, capsys, command, work, words):
    def begun(*_, **__):
        pytest.fail("the work was begun")

    monkeypatch.setattr(work, begun)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=2**12))
    hf.Setup(ROPE, duration=1.0).to_toml(tmp_path / "setup.toml")
    if command[0] == "simulate":
        command = [*command, str(tmp_path / "setup.toml"), "-o", str(tmp_path / "run.nc")]
    else:
        place = ["--target", "0.3", "-0.2", "-o", str(tmp_path / "planned")]
        command = [*command, "--rope", str(tmp_path / "setup.toml"), *place]
    if command[0] == "cast":
        command = [*command, "--radius", "0.03"]
    assert run(command) == 2
    assert words in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["setup.toml"]
