"""``hyperflex plot``, ``view`` and ``play``: a saved run as picture, film, page or table, a live page; refusals."""

import webbrowser
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.play import PlayServer
from hyperflex.status import Status


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
        ("A.PNG", b"\x89PNG"),
    ],
)
def test_the_suffix_reports_what_is_written(hyperflex_json, run_file, tmp_path, name, begins):
    short = ("--width", 100, "--speed", 4.0) if name.endswith(("gif", "mp4")) else ()
    code, told = hyperflex_json("plot", run_file, "-o", tmp_path / name, *short)
    assert (code, told["bytes"], told["start_s"], told["end_s"]) == (0, (tmp_path / name).stat().st_size, 0.0, 1.0)
    assert (tmp_path / name).read_bytes().startswith(begins)


@pytest.mark.parametrize("name", ["a.html", "a.png"])
def test_what_shows_an_interrupted_run_reports_it(hyperflex_json, run_file, tmp_path, monkeypatch, name):
    replace(hf.read_trajectory(run_file), status=Status.INTERRUPTED).to_netcdf(tmp_path / "part.nc")
    titles: list[str] = []
    to_html, plot = hf.Trajectory.to_html, hf.Trajectory.plot
    monkeypatch.setattr(hf.Trajectory, "plot", lambda run, **how: titles.append(how["title"]) or plot(run, **how))
    monkeypatch.setattr(
        hf.Trajectory, "to_html", lambda run, out, **how: titles.append(how["title"]) or to_html(run, out, **how)
    )
    code, told = hyperflex_json("plot", tmp_path / "part.nc", "-o", tmp_path / name, "--title", "A throw")
    assert (code, told["run_status"], titles) == (0, "interrupted", ["A throw (interrupted)"])


def test_the_course_is_another_picture(hyperflex, run_file, tmp_path):
    for kind in ("strobe", "course"):
        code, out, _ = hyperflex("plot", run_file, "--kind", kind, "-o", tmp_path / f"{kind}.png", "--end", "0.8")
        assert (code, f"{kind}.png" in out) == (0, True)
    assert (tmp_path / "strobe.png").read_bytes() != (tmp_path / "course.png").read_bytes()


def test_the_table_holds_the_run_bit_for_bit(hyperflex, run_file, tmp_path):
    assert hyperflex("plot", run_file, "-o", tmp_path / "a.csv")[0] == 0
    found = files.read_table(tmp_path / "a.csv")
    names, values = found.names, found.values
    run, at = hf.read_trajectory(run_file), {name: k for k, name in enumerate(names)}
    for name, column in (("t", run.t), ("arm_angle", run.arm_angle), ("th5", run.q[:, 4]), ("w1", run.qd[:, 0])):
        np.testing.assert_array_equal(values[:, at[name]], column)
    np.testing.assert_array_equal(values[:, [at["x5"], at["y5"]]], run.tip)
    assert {"kinetic_energy", "potential_energy", "dissipated_energy", "motor_work", "motor_torque"} <= set(names)
    links = [f"th{k}" for k in range(1, 6)]
    recording = hf.read_recording(tmp_path / "a.csv", kind="angles", columns=links, time_unit="s", unit="rad")
    np.testing.assert_array_equal(recording.data, run.q)


def test_view_writes_the_page_and_opens_it(hyperflex, hyperflex_json, run_file, tmp_path, monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or True)
    code, told = hyperflex_json("view", run_file, "-o", tmp_path / "a.html", "--title", "mine")
    assert (code, told["opened"], opened) == (0, True, [(tmp_path / "a.html").as_uri()])
    assert "<h1>mine</h1>" in (tmp_path / "a.html").read_text("utf-8")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    code, told = hyperflex_json("view", run_file, "--no-open")
    assert (code, told["opened"], len(opened)) == (0, False, 1)
    assert (told["output"].startswith(str(tmp_path)), told["output"].endswith("cast.html")) == (True, True)
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    code, out, _ = hyperflex("view", run_file, "-o", tmp_path / "a.html")
    assert (code, "no browser was found" in out, str(tmp_path / "a.html") in out) == (0, True, True)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("plot", "cast.nc", "-o", "a.txt"), "Allowed: .png, .gif, .mp4, .html, .csv"),
        (("plot", "cast.nc", "-o", "a.png", "--kind", "tip"), "'strobe', 'course'"),
        (
            ("plot", "cast.nc", "-o", "a.png", "--end", "9"),
            "--end 9 is no part of the run. Allowed: times from 0 to 1 s",
        ),
        (("plot", "cast.nc", "-o", "a.gif", "--width", "2"), "width"),
        (("plot", "cast.nc", "-o", "a.csv", "--start", "0.5"), "a .csv does not show the options: got '--start'"),
        (("plot", "cast.nc", "-o", "a.png", "--speed", 2, "--width", 9), "got '--speed --width'"),
        (("plot", "cast.nc", "-o", "a.html", "--kind", "course"), "got '--kind'"),
        (("plot", "cast.nc", "--end", "1"), "See hyperflex plot --help."),
        (("plot", "a.toml", "-o", "a.html"), "hyperflex simulate a.toml -o a.nc"),
        (("view", "a.toml"), "hyperflex simulate a.toml -o a.nc"),
        (("view", "a.csv"), "hyperflex look a.csv"),
        (("view", "cast.html", "-o", "cast.html", "--no-open"), "one of the inputs"),
        (("play", "--no-open", "--folder", "missing"), "There is no folder"),
        (("play", "--no-open", "missing.toml"), "missing.toml"),
        (("play", "--no-open", "run.nc"), "hyperflex view run.nc"),
        (("play", "--no-open", "--host", "203.0.113.1"), "no page can be shown there: cannot assign requested address"),
        (("play", "--no-open", "--port", "99999"), "there is no such port: got '127.0.0.1, port 99999'"),
        (("play", "--no-open", "--port", "-1"), "there is no such port"),
        (
            ("play", "--no-open", "--allow", "http://robot.lan/"),
            "--allow is no host: got 'http://robot.lan/'. Allowed:",
        ),
    ],
)
def test_what_cannot_be_shown_is_refused(hyperflex, run_file, tmp_path, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    for name in ("cast.nc", "cast.html"):
        (tmp_path / name).write_bytes(run_file.read_bytes())
    code, _, err = hyperflex(*words)
    assert (code, told in err) == (2, True), err
    assert {path.name for path in tmp_path.iterdir()} == {"cast.nc", "cast.html"}
    assert (tmp_path / "cast.html").read_bytes() == run_file.read_bytes()


def test_play_opens_the_page_with_a_set_up(hyperflex, hyperflex_json, tmp_path, monkeypatch):
    served, opened = [], []
    monkeypatch.setattr(PlayServer, "wait", lambda server: served.append(server))  # nobody has to press Ctrl-C
    monkeypatch.setattr("webbrowser.open", opened.append)
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, friction=1e-3)
    hf.Setup(rope, hf.arm_swings(), hf.Arm(length=0.1)).to_toml(tmp_path / "setup.toml")
    code, told = hyperflex_json("play", tmp_path / "setup.toml", "--folder", tmp_path)
    (server,) = served
    assert (code, opened) == (0, [told["address"]])
    assert (server.address, server.runner.session.rope) == (told["address"], rope)
    assert server.folder.path == tmp_path.resolve()

    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(PlayServer, "wait", interrupted)
    code, _, err = hyperflex("play", "--no-open", "--folder", tmp_path)
    assert (code, len(opened)) == (0, 1)  # Ctrl-C is the way to end it
    assert "It shows the paper's cable (rope, 2 m, 125 g, 50 links); hyperflex play SETUP.toml shows another" in err
