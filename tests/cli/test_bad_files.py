"""Files and folders that cannot be used: each command says so by name, before any work, and writes nothing."""

import importlib
import os
import pkgutil

import pytest
from PIL import Image

import hyperflex as hf
from hyperflex.demo import twin

WORK = (
    "simulation.simulate",
    "identification.identify",
    "planning.plan_cast",
    "planning.plan_whip",
    "planning.plan_insert",
    "estimate.track_video",
    "vision.track_bars",
    "paper.reproduce",
    "demo.report.run_demo",
)
ARCS = ("--arc-lengths", ",".join(f"{arc:g}" for arc in twin.ARC_LENGTHS))
TRACK = ("track", "swing.mp4", "--rope", "rope.toml", "--camera", "camera.toml", *ARCS)
CALIBRATE = ("calibrate", "swing.mp4", "--squares", "8", "6", "--square", "0.03")
COMMANDS = {  # each with all its inputs, and the output last
    "simulate": ("simulate", "setup.toml", "-o", "out.nc"),
    "identify": ("identify", "swing.csv", "--rope", "rope.toml", "--setup", "setup.toml", "-o", "out"),
    "cast": ("cast", "setup.toml", "--rope", "rope.toml", "--target", "0.5", "-1", "--radius", "0.04", "-o", "out"),
    "whip": ("whip", "setup.toml", "--rope", "rope.toml", "--target", "0.5", "-1", "-o", "out"),
    "insert": ["insert", "setup.toml", "--rope", "rope.toml", "--slot", "0.5", "-1", "--direction", "-1", "-o", "out"],
    "track": (*TRACK, "-o", "out.nc"),
    "preview": (*TRACK, "-o", "out.nc", "--preview", "out.mp4"),
    "bars": ("track", "swing.mp4", "--bar", "9,9", "--pivot", "1", "1", "-o", "out.nc"),
    "watch": ("watch", "swing.mp4", "--rope", "rope.toml", "--camera", "camera.toml", *ARCS, "-o", "w.nc"),
    "calibrate": (*CALIBRATE, "--plane", "plane.png", "-o", "out.toml"),
    "reproduce": ("reproduce", "fig9", "-o", "out"),
    "demo": ("demo", "-o", "out"),
}
INPUTS = [
    (command, name)
    for command, words in COMMANDS.items()
    for name in words[:-1]
    if name.endswith((".toml", ".mp4", ".csv", ".png")) and command != "preview"
]


def write_inputs(folder):
    """Write usable inputs of commands, all but a video."""
    twin.guess().to_toml(folder / "rope.toml")
    hf.Setup(twin.guess()).to_toml(folder / "setup.toml")
    twin.camera().write(folder / "camera.toml")
    (folder / "swing.csv").write_text("# time_unit: s\n# unit: rad\nt,th1\n0,0.1\n0.1,0.2\n0.2,0.1\n")
    Image.new("RGB", (64, 48)).save(folder / "plane.png")


@pytest.fixture(scope="module")
def loaded():
    """All modules, so that none is loaded while its neighbours are replaced, and keeps what replaces them."""
    for module in pkgutil.walk_packages(hf.__path__, "hyperflex."):
        importlib.import_module(module.name)


@pytest.fixture
def folder(tmp_path, monkeypatch, loaded):
    """A folder with usable inputs, in which the commands run; to begin any work fails the test."""

    def work(*_, **__):
        raise AssertionError("work was begun")

    for name in WORK:
        monkeypatch.setattr(f"hyperflex.{name}", work)
    write_inputs(tmp_path)
    (tmp_path / "swing.mp4").write_bytes(twin.BUNDLED.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("bad", ["missing", "a folder", "a pipe", "empty", "other", "cut off"])
@pytest.mark.parametrize(("command", "name"), INPUTS)
def test_an_input_that_cannot_be_read_is_named(hyperflex, folder, command, name, bad):
    path = folder / name
    content = path.read_bytes()
    path.unlink()
    if bad == "a folder":
        path.mkdir()
    elif bad == "a pipe":
        os.mkfifo(path)
    elif bad != "missing":
        path.write_bytes({"empty": b"", "other": bytes(range(256)), "cut off": content[:40]}[bad])
    before = sorted(folder.iterdir())
    code, out, err = hyperflex(*COMMANDS[command])
    assert (code, out) == (2, "")
    assert name in err
    assert err.count("\n") == 1
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("where", ["rope.toml", "/proc", ""])
def test_an_output_that_cannot_be_written_is_named_before_any_work(hyperflex, folder, command, where):
    """Below a file, in a folder that takes no files, and without a name."""
    *words, last = COMMANDS[command]
    before = sorted(folder.iterdir())
    code, shown, err = hyperflex(*words, f"{where}/deep/{last}" if where else "")
    assert (code, shown, err.count("\n")) == (2, "", 1)
    assert (where or " has no value: got ''") in err
    assert sorted(folder.iterdir()) == before
