"""``hyperflex play``: it says where it is, begins with a set-up, and refuses what it cannot do."""

import pytest

import hyperflex as hf
from hyperflex.play import PlayServer


@pytest.fixture
def seen(monkeypatch):
    """Servers that were waited for; nobody has to press Ctrl-C."""
    waited = []
    monkeypatch.setattr(PlayServer, "wait", lambda server: waited.append(server))
    return waited


def test_it_opens_the_page_with_a_set_up(hyperflex_json, seen, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, friction=1e-3)
    hf.Setup(rope, hf.arm_swings(), hf.Arm(length=0.1)).to_toml(tmp_path / "setup.toml")
    code, told = hyperflex_json("play", tmp_path / "setup.toml", "--folder", tmp_path)
    (server,) = seen
    assert code == 0
    assert opened == [told["address"]] == [server.address]
    assert server.runner.session.rope == rope
    assert server.folder.path == tmp_path.resolve()
    assert hyperflex_json("play", "--no-open", "--folder", tmp_path)[0] == 0
    assert len(opened) == 1


def test_it_says_which_rope_it_shows(hyperflex, seen, tmp_path):
    _, _, err = hyperflex("play", "--no-open", "--folder", tmp_path)
    assert "It shows the paper's cable (rope, 2 m, 125 g, 50 links); hyperflex play SETUP.toml shows another" in err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--folder", "missing"), "There is no folder"),
        (("missing.toml",), "missing.toml"),
        (("run.nc",), "hyperflex view run.nc"),
        (
            ("--host", "203.0.113.1"),
            "no page can be shown there: cannot assign requested address: got '203.0.113.1, port 0'. Allowed: an",
        ),
        (("--port", "99999"), "there is no such port: got '127.0.0.1, port 99999'"),
        (("--port", "-1"), "there is no such port"),
        (("--allow", "http://robot.lan:8080/"), "--allow is no host: got 'http://robot.lan:8080/'. Allowed: host:port"),
    ],
)
def test_it_refuses(hyperflex, seen, words, told):
    code, _, err = hyperflex("play", "--no-open", *words)
    assert (code, seen) == (2, [])
    assert told in err
