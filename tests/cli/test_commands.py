"""What all commands share: help with an example, exit codes, clean standard output, light start."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.cli import output
from hyperflex.cli.app import COMMANDS


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_that_names_real_options(hyperflex, command):
    code, out, _ = hyperflex(*command.split(), "--help")
    assert code == 0
    example = re.search(rf"Example:\n\s+(hyperflex {command}.*)\n", out)
    assert example, out
    for option in re.findall(r"(?<= )--?[a-z][a-z-]*", example[1]):
        assert re.search(rf"^\s.*{re.escape(option)}\b", out.split("Options:")[1], re.M), option
    assert "--json" in out


def test_help_alone_and_version(hyperflex):
    code, out, _ = hyperflex()
    assert code == 0
    assert all(command in out for command in COMMANDS)
    assert hyperflex("--version") == (0, f"{hf.__version__}\n", "")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("simulat",), "See hyperflex --help."),
        (("simulate",), "See hyperflex simulate --help."),
        (("reproduce", "--nothing"), "See hyperflex reproduce --help."),
        (
            ("reach-map", "-o", "map", "--workers", 0),
            "'--workers': Input should be greater than or equal to 1: got '0'. See hyperfl",
        ),
        (("reach-map", "-o", "map", "--workers=-1"), "'--workers': Input should be greater than or equal to 1. See"),
    ],
)
def test_wrong_usage_exits_with_2_and_names_the_help(hyperflex, arguments, told):
    code, out, err = hyperflex(*arguments)
    assert (code, out, told in err) == (2, "", True), err


def test_the_installed_program_keeps_standard_output_clean(tmp_path):
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=2, friction=0.0)
    hf.Setup(rope, duration=0.1).to_toml(tmp_path / "swing.toml")
    program = [sys.executable, "-m", "hyperflex"]
    arguments = ["simulate", "swing.toml", "-o", "swing.nc", "--json"]
    done = subprocess.run([*program, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["samples"] == 11


def test_help_loads_nothing_heavy():
    heavy = {"numba", "scipy", "xarray", "matplotlib", "h5netcdf", "PIL", "jinja2"}
    code = (
        "from hyperflex.cli.app import run; run(['demo', '--help'])\n"
        f"import sys; print(*sorted({heavy!r} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.split() == []


def test_json_knows_arrays_paths_and_no_infinities(capsys):
    output.print_json({"a": np.array([1.0, np.nan]), "b": {"p": Path("x"), "c": (np.float64(2.0), np.inf)}, "d": True})
    text = capsys.readouterr().out
    assert json.loads(text) == {"a": [1.0, None], "b": {"p": "x", "c": [2.0, None]}, "d": True}
    assert "NaN" not in text
