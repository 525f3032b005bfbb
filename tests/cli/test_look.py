"""``hyperflex plot`` and ``view``: a saved run as a picture, a film, a page, a table; and what they refuse."""

import webbrowser

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files


@pytest.fixture(scope="module")
def run_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "cast.nc"
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, friction=1e-3)
    hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.1), duration=1.0).to_netcdf(path)
    return path


@pytest.mark.parametrize(
    ("name", "begins"),
    [
        ("a.png", b"\x89PNG"),
        ("a.gif", b"GIF8"),
        ("a.mp4", b"\0\0\0"),
        ("a.html", b"<!doctype html>"),
        ("a.csv", b"# source: simulated"),
        ("A.PNG", b"\x89PNG"),
    ],
)
def test_the_suffix_says_what_is_written(hyperflex_json, run_file, tmp_path, name, begins):
    short = ("--width", 100, "--speed", 4.0) if name.endswith(("gif", "mp4")) else ()
    code, told = hyperflex_json("plot", run_file, "-o", tmp_path / name, *short)
    assert code == 0
    assert (tmp_path / name).read_bytes().startswith(begins)
    assert told["bytes"] == (tmp_path / name).stat().st_size
    assert (told["start_s"], told["end_s"]) == (0.0, 1.0)


def test_the_course_is_another_picture(hyperflex, run_file, tmp_path):
    for kind in ("strobe", "course"):
        code, out, _ = hyperflex("plot", run_file, "--kind", kind, "-o", tmp_path / f"{kind}.png", "--end", "0.8")
        assert code == 0
        assert f"{kind}.png" in out
    assert (tmp_path / "strobe.png").read_bytes() != (tmp_path / "course.png").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("-o", "a.txt"), "Allowed: .png, .gif, .mp4, .html, .csv"),
        (("-o", "a.png", "--kind", "tip"), "'strobe', 'course'"),
        (("-o", "a.png", "--end", "9"), "--end 9 is no part of the run. Allowed: times from 0 to 1 s"),
        (("-o", "a.gif", "--width", "2"), "width"),
        (("-o", "a.csv", "--start", "0.5"), "--start and --end do not apply to a table"),
        (("--end", "1"), "See hyperflex plot --help."),
    ],
)
def test_plot_refuses(hyperflex, run_file, tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    code, _, err = hyperflex("plot", run_file, *arguments)
    assert code == 2
    assert told in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["plot", "view"])
@pytest.mark.parametrize(
    ("name", "told"), [("a.toml", "hyperflex simulate a.toml -o a.nc"), ("a.csv", "hyperflex identify a.csv")]
)
def test_a_set_up_or_recording_is_refused_with_its_command(hyperflex, tmp_path, monkeypatch, command, name, told):
    monkeypatch.chdir(tmp_path)
    code, _, err = hyperflex(command, name, "-o", "a.html")
    assert code == 2
    assert told in err


def test_a_run_is_not_overwritten_by_its_page(hyperflex, run_file, tmp_path):
    twin = tmp_path / "run.html"
    twin.write_bytes(run_file.read_bytes())
    code, _, err = hyperflex("view", twin, "-o", twin, "--no-open")
    assert code == 2
    assert "one of the inputs" in err
    assert twin.read_bytes() == run_file.read_bytes()


def test_view_writes_the_page_and_opens_it(hyperflex_json, run_file, tmp_path, monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or True)
    code, told = hyperflex_json("view", run_file, "-o", tmp_path / "a.html", "--title", "mine")
    assert (code, told["opened"], opened) == (0, True, [(tmp_path / "a.html").as_uri()])
    assert "<h1>mine</h1>" in (tmp_path / "a.html").read_text("utf-8")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    code, told = hyperflex_json("view", run_file, "--no-open")
    assert (code, told["opened"], len(opened)) == (0, False, 1)
    assert told["output"].startswith(str(tmp_path))
    assert told["output"].endswith("cast.html")


def test_view_without_a_browser_says_where_the_page_is(hyperflex, run_file, tmp_path, monkeypatch):
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    code, out, _ = hyperflex("view", run_file, "-o", tmp_path / "a.html")
    assert code == 0
    assert "no browser was found" in out
    assert str(tmp_path / "a.html") in out


def test_the_table_holds_the_run_bit_for_bit(hyperflex, run_file, tmp_path):
    hyperflex("plot", run_file, "-o", tmp_path / "a.csv")
    names, values, *_ = files.read_table(tmp_path / "a.csv")
    run, at = hf.read_trajectory(run_file), {name: k for k, name in enumerate(names)}
    for name, column in (("t", run.t), ("arm_angle", run.arm_angle), ("th5", run.q[:, 4]), ("w1", run.qd[:, 0])):
        np.testing.assert_array_equal(values[:, at[name]], column)
    np.testing.assert_array_equal(values[:, [at["x5"], at["y5"]]], run.tip)
    assert {"kinetic_energy", "potential_energy", "dissipated_energy", "motor_work", "motor_torque"} <= set(names)
    links = [f"th{k}" for k in range(1, 6)]
    recording = hf.read_recording(tmp_path / "a.csv", kind="angles", columns=links, time_unit="s", unit="rad")
    np.testing.assert_array_equal(recording.data, run.q)


@pytest.mark.parametrize("command", ["simulate", "plot", "view", "cast"])
def test_the_hint_names_the_help_of_the_command(hyperflex, command):
    _, _, err = hyperflex(command, "--no-such-option")
    assert f"See hyperflex {command} --help." in err


def test_the_hint_of_an_unknown_command_names_the_help_of_all(hyperflex):
    assert "See hyperflex --help." in hyperflex("plod")[2]
