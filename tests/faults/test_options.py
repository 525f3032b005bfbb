"""Odd values for every option of every command: one line with the mistake and exit code 2, or a result."""

import contextlib
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st

from hyperflex.cli.app import app, run
from tests.cli.test_bad_files import ARCS, write_inputs
from tests.faults.bounds import LEAKED, bounded, examples

ODD = [
    *("", " ", "text", "nan", "inf", "-inf", "-1", "0", "2.5", "1e308", "-1e308", "1e999", "9" * 400, "1_000", "0x10"),
    *("1,2,3", ",,,", "a=b=c", "=", "--", "-", "None", "[]", "{}", "half\udcffbyte", "x" * 5000, "../..", "/dev/zero"),
    *("/dev/null", "folder", "rope.toml", "swing.csv", "nowhere/deep/file.nc", "o.nc", "o.toml", "π", "tip_mass=1"),
]
SOUND: dict[str, tuple[str, ...]] = {  # refused after all options have been read and before anything long begins
    "simulate": ("setup.toml", "-o", "out.nc", "--duration", "0.02"),
    "identify": ("swing.csv", "--rope", "rope.toml", "-o", "out"),
    "cast": ("--rope", "rope.toml", "--target", "9", "-1", "--radius", "0.04", "-o", "out", "--time-budget", "0.1"),
    "whip": ("--rope", "rope.toml", "--target", "9", "-1", "-o", "out", "--time-budget", "0.1"),
    "insert": ("--rope", "rope.toml", "--slot", "9", "-1", "--direction", "-1", "-o", "out", "--time-budget", "0.1"),
    "calibrate": ("plane.png", "--squares", "8", "6", "--square", "0.03", "-o", "out.toml"),
    "track": ("plane.png", "--rope", "rope.toml", "--camera", "camera.toml", *ARCS, "-o", "out.nc"),
    "watch": ("plane.png", "--rope", "rope.toml", "--camera", "camera.toml", *ARCS, "-o", "out.nc"),
    "reproduce": ("nothing", "-o", "out"),
}


def options() -> list[tuple[str, str]]:
    """Every option of these commands, and "" for another argument."""
    commands: Any = typer.main.get_command(app)
    return [
        (name, max(each.opts, key=len) if each.opts[0].startswith("-") else "")
        for name in SOUND
        for each in commands.get_command(None, name).params
        if each.name not in ("help",)
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with usable inputs, in which the commands run."""
    path = tmp_path_factory.mktemp("options")
    write_inputs(path)
    (path / "folder").mkdir()
    with contextlib.chdir(path):
        yield path


def called(command: str, words: list[str]) -> tuple[int, str]:
    """Run a command; returns its exit code and standard error."""
    err, out = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out), bounded(10.0):
        code = run([command, *words])
    return code, err.getvalue()


@pytest.mark.filterwarnings("default")
def test_odd_options_are_refused_in_one_line(folder):
    before = sorted(path.name for path in folder.iterdir())

    @examples(25)
    @given(st.sampled_from(options()), st.sampled_from(ODD))
    def odd(option, value):
        command, name = option
        words = list(SOUND[command])
        if name and name in words:
            words[words.index(name) + 1] = value
        else:
            words += [name, value] if name else [value]
        code, err = called(command, words)
        said = [line for line in err.splitlines() if line.strip()]
        assert code in (0, 2, 4), err
        assert "Traceback" not in err
        if code == 2:
            assert said[-1].startswith("hyperflex: ")
            assert len([line for line in said if "no arm is given" not in line]) == 1, err
            assert not LEAKED.search(err), err
        for path in set(folder.iterdir()) - {folder / name for name in before}:
            assert code != 2, f"{path.name} was left"
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    odd()
