"""``hyperflex look``: the contents of a file, its picture, and the commands that read it."""

import shlex
from pathlib import Path

import numpy as np
from scipy.io import savemat

import hyperflex as hf


def test_look_shows_a_recording_and_how_to_read_it(hyperflex, hyperflex_json, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("swing.csv").write_text("t [s],tip_x,tip_y,base_x,base_y\n0,1,2,0,3\n0.1,1.1,2.1,0,3\n0.2,1.2,2.2,,\n")
    code, out, _ = hyperflex("look", "swing.csv", "-o", "swing.png")
    assert code == 0
    for words in (
        "markers                 2: tip, base",
        "samples                 3, 0 to 0.2 s, 10 a second",
        "missing                 17 %",
        "assumed, to be checked  markers = tip, base, unit = m, y_axis = up",
        "hf.read_recording('swing.csv', markers=['tip', 'base'], unit='m', y_axis='up')",
        "hyperflex identify swing.csv --rope rope.toml --markers tip,base --unit m --y-axis up -o identified",
    ):
        assert words in out, out
    assert Path("swing.png").read_bytes().startswith(b"\x89PNG")
    code, found = hyperflex_json("look", "swing.csv")
    assert code == 0
    assert (found["format"], found["assumed"]) == ("table", ["markers", "unit", "y_axis"])
    Path("log.csv").write_text("t [s],speed,load\n0,1,2\n1,1,2\n")
    code, out, _ = hyperflex("look", "log.csv")
    assert (code, "does not say which columns to take" in out, "To read it" in out) == (0, True, False)
    Path("book.xlsx").write_bytes(b"PK\x03\x04")
    assert "Save it as CSV" in refused("look", "book.xlsx")


def test_the_line_that_look_proposes_identifies(hyperflex, hyperflex_json, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    t = np.arange(200) / 50.0
    angle = np.degrees(0.3 * np.cos(5.0 * t))
    Path("swing.csv").write_text(
        "Time (s),Angle (deg),torque\n" + "".join(f"{a:.3f},{b:.5f},0.1\n" for a, b in zip(t, angle, strict=True))
    )
    hf.Rope(length=[0.4], mass=[0.1], friction=1e-4).to_toml("rope.toml")
    assert "torque (a motor's torque: --torque NAME)" in hyperflex("look", "swing.csv")[1]
    command = hyperflex_json("look", "swing.csv")[1]["command"]
    assert command == "hyperflex identify swing.csv --rope rope.toml --columns Angle -o identified"
    code, _, _ = hyperflex(*shlex.split(command)[1:], "--free", "inertia")
    assert code in (0, 5)  # read and fitted


def test_look_draws_each_column_of_an_array(hyperflex, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    t = np.arange(40) / 20.0
    savemat("swing.mat", {"t": t, "theta": 0.1 * np.cos(np.outer(t, [3.0, 4.0]))})
    code, out, _ = hyperflex("look", "swing.mat", "-o", "swing.png")
    assert (code, "angles                  2: theta (2 columns)" in out) == (0, True), out
    assert Path("swing.png").exists()
