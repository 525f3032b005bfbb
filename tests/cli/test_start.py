"""``hyperflex init`` and ``doctor``, and the completion of commands and options in a shell."""

import json
import os
import shutil
import subprocess
import sys

import pytest
import typer

import hyperflex as hf
from hyperflex.cli import doctor, init


@pytest.mark.filterwarnings("ignore:.*near the peg")
def test_init_writes_a_set_up_that_runs(hyperflex, tmp_path):
    out = tmp_path / "cast.toml"
    given = ("--length", 1.5, "--mass", 0.08, "--links", 5, "--peg", 0.8, -0.6, 0.03, "--motion", "move")
    code, said, _ = hyperflex("init", out, *given, "--duration", 0.3)
    assert code == 0
    assert f"hyperflex simulate {out}" in said
    setup = hf.Setup.from_toml(out)
    assert (setup.rope.n_links, setup.rope.total_length, setup.duration) == (5, pytest.approx(1.5), 0.3)
    assert setup.round_pegs == (hf.Peg(0.8, -0.6, 0.03),)
    assert hyperflex("simulate", out, "-o", tmp_path / "cast.nc")[0] == 0
    lines = out.read_text("utf-8").splitlines()
    commented = [line for line in lines if " = " in line and not line.startswith("#")]
    assert all("# " in line or line.startswith("kind") for line in commented)


@pytest.mark.filterwarnings("ignore:.*near the peg")
@pytest.mark.parametrize("motion", init.MOTIONS)
def test_what_stands_in_comments_can_be_used_as_it_is(hyperflex, motion, tmp_path):
    out = tmp_path / "setup.toml"
    assert hyperflex("init", out, "--motion", motion)[0] == 0
    head, *rest = out.read_text("utf-8").split("\n\n")
    opened = [part.replace("\n# ", "\n").removeprefix("# ") for part in rest if "No [motion]" not in part]
    out.write_text("\n\n".join([head, *opened]), "utf-8")
    setup = hf.Setup.from_toml(out)
    assert setup.rope.tip_mass == 0.01
    assert len(setup.pegs) == 1
    assert (setup.motion is None) == (motion == "hold")
    moved = hf.simulate(setup.replace(pegs=(), rope=setup.rope.replace(drag=0.0)), duration=1.0)
    assert abs(moved.tip - moved.tip[0]).max() > 0.01


@pytest.mark.filterwarnings("default:.* the peg at")
def test_pegs_that_do_not_suit_links_and_arm_are_reported(hyperflex, tmp_path):
    setup = tmp_path / "setup.toml"
    assert hyperflex("init", setup, "--peg", 0, 0, 0.03)[0] == 0
    code, _, err = hyperflex("simulate", setup, "-o", tmp_path / "a.nc", "--duration", 0.01)
    assert code == 0
    assert "links of 100 mm near the peg at (0, 0) m (radius 30 mm) hold less" in err
    assert "the arm can turn through the peg at (0, 0) m" in err


def test_init_leaves_a_file_alone(refused, tmp_path):
    (tmp_path / "setup.toml").write_text("mine")
    assert "exists already" in refused("init", tmp_path / "setup.toml")
    assert (tmp_path / "setup.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("option", "named"),
    [
        (("--length", -1.0), "--length has the wrong sign: got -1.0. Allowed: a number, finite and > 0, in m."),
        (("--mass", -1.0), "in kg."),
        (("--motion", "dance"), "--motion"),
        (("--peg", 0.8, -0.6, float("nan")), "hyperflex: peg radius is not finite: got nan."),
        (("--peg", 0.8, float("inf"), 0.03), "hyperflex: peg y is not finite: got inf."),
        (("--peg", 0.8, -0.6, -0.03), "hyperflex: peg radius has the wrong sign: got -0.03."),
        (("--peg", -0.1, -1.0, 0.05), "link 9 is 47.5 mm deep in it: got Peg(x=-0.1, y=-1.0, radius=0.05,"),
        (("--radius", 3.0), "thicker than it is long"),
    ],
)
def test_init_refuses_what_no_rope_has(refused, option, named, tmp_path):
    assert named in refused("init", tmp_path / "setup.toml", *option)
    assert list(tmp_path.iterdir()) == []


def test_init_asks_on_a_terminal_for_what_is_not_given(hyperflex, hyperflex_json, monkeypatch, tmp_path):
    asked = []

    def prompt(words, default, type):  # noqa: A002
        asked.append(words)
        return 1.25 if "Length of the rope" in words else default

    monkeypatch.setattr(typer, "prompt", prompt)
    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, "isatty", lambda: True)
    code, _, _ = hyperflex("init", tmp_path / "b.toml", "--mass", 0.5)
    rope = hf.Setup.from_toml(tmp_path / "b.toml").rope
    assert (code, rope.total_length, rope.total_mass) == (0, pytest.approx(1.25), pytest.approx(0.5))
    assert asked == ["Length of the rope, m", *asked[1:]]
    assert not any("Mass" in each for each in asked)
    assert hyperflex_json("init", tmp_path / "a.toml")[1]["length"] == 2.0  # JSON output asks no questions


def test_doctor_tells_what_is_there(hyperflex_json):
    code, told = hyperflex_json("doctor")
    assert code == 0
    assert told["wrong"] == []
    found = {each["name"]: each for each in told["findings"]}
    assert {"hyperflex", "packages", "kernels", "this folder", "speed"} <= found.keys()
    assert not any(name.startswith("camera") for name in found)
    assert "numpy" in found["packages"]["found"]
    assert told["processor_seconds_per_simulated_second"] > 0.0


def test_doctor_names_what_is_wrong(hyperflex, monkeypatch, tmp_path):
    """A package that lacks, an extra that lacks, a cache that cannot be written to, and a camera that is not there."""
    lacking = {"scipy": "", "mcap": ""}
    known = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: lacking.get(name, known(name)))
    monkeypatch.setattr(
        doctor.importlib.metadata, "requires", lambda _: ["scipy>=1.14", "numpy", 'mcap; extra == "mcap"']
    )
    monkeypatch.setattr(
        doctor, "unwritable", lambda folder: "cannot be written to" if "kernels" in str(folder) else None
    )
    monkeypatch.setenv("HYPERFLEX_CACHE_DIR", str(tmp_path / "kernels"))
    code, said, _ = hyperflex("doctor", "--no-speed", "--source", 97)
    assert code == 2
    said = " ".join(said.split())
    assert "3 wrong: packages, kernels, camera 97" in said
    assert "without scipy. pip install --force-reinstall hyperflex brings them." in said
    assert "missing extra mcap without mcap. pip install 'hyperflex[mcap]' brings them." in said


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("line", "completed"),
    [pytest.param("hyperflex sim", ["simulate"], marks=pytest.mark.nightly), ("hyperflex cast --ta", ["--target"])],
)
def test_bash_completes_commands_and_options(line, completed, tmp_path):
    program = tmp_path / "hyperflex"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m hyperflex "$@"\n')
    program.chmod(0o755)
    words = line.split()
    script = (
        "told=$(_HYPERFLEX_COMPLETE=source_bash hyperflex); [[ $told == *complete_bash* ]] || exit 9\n"
        'eval "$told"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))\n'
        "_hyperflex_completion hyperflex; printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    call = ["bash", "-c", script, "bash", *words]
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == completed, json.dumps([done.stdout, done.stderr])
