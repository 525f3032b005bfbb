"""Faults that once ended badly, each as a user meets it, where no other test has it."""

import _thread
import contextlib
import json
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import progress
from hyperflex.cli.app import run
from hyperflex.interruption import _USUAL
from hyperflex.paper import casting
from hyperflex.paper.part import Item
from tests.faults.bounds import LEAKED, bounded

ROD = hf.Rope([0.3], [0.1], friction=2e-4)
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=12, radius=0.0025, friction=5e-4)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with usable inputs, in which commands run; Ctrl-C is handled by whatever runs the tests, as usual."""
    hf.Setup(ROD, duration=0.1).to_toml(tmp_path / "setup.toml")
    CABLE.to_toml(tmp_path / "rope.toml")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(_USUAL, signal.SIGINT, signal.getsignal(signal.SIGINT))
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Run a command that must be refused in one line and leave nothing; return the line."""
    before = sorted(Path.cwd().rglob("*"))
    with bounded(10.0):
        code = run(list(words))
    out, err = capsys.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert not LEAKED.search(err), err
    assert sorted(Path.cwd().rglob("*")) == before
    return err


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_that_a_library_swallows_in_reproduce_is_no_result(monkeypatch, capsys, times):
    def fails_to_hear(*_):
        for _ in range(times):
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

    known = casting.PART.items["fig10"]
    monkeypatch.setitem(casting.PART.items, "fig10", Item(known.table, lambda: (fails_to_hear(), known.draw())[1]))
    assert run(["reproduce", "fig10", "-o", "paper", "--json"]) == 130
    assert json.loads(capsys.readouterr().out)["error"] == "interrupted"
    assert not {"claims.md", "report.html"} & {path.name for path in Path("paper").glob("*")}


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.nightly
def test_a_signal_while_a_run_is_written_leaves_no_part(folder, sent):
    code = "import os, signal; from hyperflex.cli import main\nforced = os.fsync\n"
    code += "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code += f"def fsync(it):\n    os.kill(os.getpid(), {int(sent)})\n    forced(it)\nos.fsync = fsync\nmain()"
    words = [sys.executable, "-c", code, "simulate", "setup.toml", "-o", "run.nc", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, json.loads(done.stdout)["error"]) == (128 + sent, "interrupted"), done.stderr
    assert {path.name for path in folder.iterdir()} <= {"setup.toml", "rope.toml", "run.nc"}
    assert not (folder / "run.nc").exists() or hf.read_trajectory("run.nc").success


def test_that_an_arm_is_missing_is_said_in_the_words_of_the_file(capsys):
    Path("swings.toml").write_text(
        "[rope]\nn_links = 3\nlink_length = 0.1\nlink_mass = 0.1\n[motion]\nkind = 'swings'\n"
    )
    said = refused(capsys, "simulate", "swings.toml", "-o", "x.nc")
    assert "swings.toml: motion turns an arm, but there is none. Give a table [arm] with length." in said
    assert "Arm(" not in said


@pytest.mark.parametrize(("more", "said"), [((), True), (("--arm-length", "0.105"), False)])
def test_a_cast_says_that_it_takes_the_arm_of_the_paper(capsys, more, said):
    out_of_reach = ("cast", "--rope", "rope.toml", "--target", "9", "-1", "--radius", "0.04", "-o", "out")
    assert run([*out_of_reach, *more]) == 4
    assert ("no arm is given, so the paper's is used, 0.105 m long" in capsys.readouterr().err) == said


def test_random_samples_are_fitted_with_a_word_until_they_are_interrupted(monkeypatch, capsys):
    heard: list[str] = []

    def hear(words):
        if not heard:
            threading.Timer(0.5, _thread.interrupt_main).start()
        heard.append(words)

    @contextlib.contextmanager
    def lines():
        yield hear

    t = np.arange(300_000) / 100.0
    hf.Recording(t, np.random.default_rng(1).normal(0.0, 1.0, (t.size, 1))).to_netcdf("noise.nc")
    ROD.to_toml("rod.toml")
    monkeypatch.setattr(progress, "lines", lines)
    with bounded():
        given = ["noise.nc", "--rope", "rod.toml", "--free", "friction", "--max-rate", "1e4"]
        code = run(["identify", *given, "-o", "found.toml", "--json"])
    assert (code, json.loads(capsys.readouterr().out)["error"]) == (130, "interrupted")
    assert heard
