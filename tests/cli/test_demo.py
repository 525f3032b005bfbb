"""``hyperflex demo``: says that it is simulated, shows intervals and names what to look at."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from hyperflex import demo
from hyperflex.errors import Interrupted


@pytest.fixture
def ready(demo_report, monkeypatch):
    """Let the command find the demo done; it is run once for the whole suite."""
    monkeypatch.setattr(demo, "write_demo", lambda *_: demo_report)
    return demo_report


def test_demo_prints_intervals_and_what_to_look_at(hyperflex, ready, tmp_path):
    code, out, _ = hyperflex("demo", "-o", tmp_path)
    assert code == 0
    assert "simulated" in out
    assert "without noise" in out
    assert "report.html" in out
    assert "prediction error" in out
    assert "degrees of it, and holds, in simulation" in " ".join(out.split())


def test_demo_as_json(hyperflex_json, ready, tmp_path):
    code, result = hyperflex_json("demo", "-o", tmp_path)
    assert code == 0
    assert result["source"] == "simulated"
    assert all(Path(path).exists() for path in result["files"].values())
    assert result["plan"]["success"]
    assert result["hold_force_N"] == ready.demo.held.force
    for name, parameter in result["parameters"].items():
        low, high = parameter["interval_95"]
        assert parameter["covered"] == (low <= parameter["without_noise"] <= high), name


def test_ctrl_c_in_the_demo(hyperflex, hyperflex_json, monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(demo, "write_demo", interrupted)
    code, out, err = hyperflex("demo", "-o", tmp_path)
    assert (code, out) == (130, "")
    assert err.startswith("hyperflex: Interrupted")
    code, result = hyperflex_json("demo", "-o", tmp_path)
    assert code == 130
    assert result["error"] == "interrupted"


def test_a_bug_is_one_json_object_and_a_traceback_on_standard_error(hyperflex, monkeypatch, tmp_path):
    def broken(*_):
        raise ZeroDivisionError("by nought")

    monkeypatch.setattr(demo, "write_demo", broken)
    code, out, err = hyperflex("demo", "-o", tmp_path, "--json")
    result = json.loads(out)
    assert code == 1
    assert set(result) == {"error", "type"}
    assert result["type"] == "ZeroDivisionError"
    assert "by nought" in result["error"]
    assert "Traceback" in err
    assert hyperflex("demo", "-o", tmp_path)[:2] == (1, "")


@pytest.mark.nightly
def test_a_fit_that_was_interrupted_is_no_demo(hyperflex, monkeypatch, tmp_path):
    def half(*_, **__):
        raise Interrupted(SimpleNamespace(message="interrupted"))

    monkeypatch.setattr("hyperflex.demo.twin.identify", half)
    assert hyperflex("demo", "-o", tmp_path)[:2] == (130, "")
    assert list(tmp_path.iterdir()) == []
