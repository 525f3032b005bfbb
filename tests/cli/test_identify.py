"""``hyperflex identify``: a recording and a guess in, a rope out; what is not declared is refused."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import signal

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files, identification


@pytest.fixture
def swing(tmp_path):
    """A swing of one link, in degrees and milliseconds, and a guess with twice its friction."""
    true = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)
    t = np.linspace(0.0, 4.0, 201)
    run = hf.simulate(true, duration=4.0, t_eval=t, q0=[0.8])
    files.write_table(tmp_path / "swing.csv", ["t", "th1"], np.column_stack([1e3 * t, np.degrees(run.q)]))
    true.replace(friction=4e-4).to_toml(tmp_path / "guess.toml")
    return tmp_path


DECLARED = ("--time-unit", "ms", "--unit", "deg")


def test_identify_writes_the_rope_and_its_figures(hyperflex, swing):
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml")
    code, out, _ = hyperflex("identify", swing / "swing.csv", *arguments, *DECLARED)
    assert code == 0
    assert "friction" in out
    assert "prediction error" not in out  # 0.8 s are too short for a prediction of 1 s after 0.5 s
    # Noise-free data of the same model: only the rollout's tolerance of 1e-5 m is left.
    assert hf.Rope.from_toml(swing / "rope.toml").friction[0] == pytest.approx(2e-4, rel=1e-2)
    assert files.read_toml(swing / "rope.toml")["identification"]["status"] == "converged"


def test_identify_as_json_with_a_held_out_part(hyperflex_json, swing):
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "--free", "inertia", "--train", "2")
    code, result = hyperflex_json("identify", swing / "swing.csv", *arguments, "-o", swing / "rope.toml", *DECLARED)
    assert code == 0
    assert result["values"]["friction"][0] == pytest.approx(2e-4, rel=1e-2)
    assert result["held_out"]["ahead"] == 1.0
    assert result["output"] == str(swing / "rope.toml")


def test_what_is_not_declared_is_refused(hyperflex_json, swing):
    code, result = hyperflex_json(
        "identify", swing / "swing.csv", "--rope", swing / "guess.toml", "-o", swing / "rope.toml", "--time-unit", "ms"
    )
    assert code == 2
    assert "unit" in result["error"]
    assert not (swing / "rope.toml").exists()


def test_columns_can_be_named(hyperflex_json, swing):
    names, values = files.read_table(swing / "swing.csv")
    files.write_table(swing / "other.csv", ["clock", "hinge", "note"], np.column_stack([values, values[:, 0]]))
    assert names == ["t", "th1"]
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml", *DECLARED)
    named = ("--kind", "angles", "--time", "clock", "--columns", "hinge")
    code, result = hyperflex_json("identify", swing / "other.csv", *arguments, *named)
    assert code == 0
    assert result["values"]["friction"][0] == pytest.approx(2e-4, rel=1e-2)


def test_ctrl_c_keeps_the_best_so_far_and_exits_with_130(hyperflex_json, swing, monkeypatch):
    whole = identification.identify

    def interrupted(*arguments, **options):
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        return dataclasses.replace(whole(*arguments, **options), status="interrupted")

    monkeypatch.setattr(identification, "identify", interrupted)
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml", *DECLARED)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the tests' own parent has set
    try:
        code, result = hyperflex_json("identify", swing / "swing.csv", *arguments)
    finally:
        signal.signal(signal.SIGINT, before)
    assert code == 130
    assert result["error"] == result["status"] == "interrupted"
    assert files.read_toml(swing / "rope.toml")["identification"]["status"] == "interrupted"


def test_a_fit_that_did_not_converge_is_written_marked_and_exits_with_3(hyperflex, swing, monkeypatch):
    whole = identification.identify

    def unsettled(*arguments, **options):
        return dataclasses.replace(whole(*arguments, **options), status="not converged")

    monkeypatch.setattr(identification, "identify", unsettled)
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml", *DECLARED)
    code, out, _ = hyperflex("identify", swing / "swing.csv", *arguments)
    assert code == 3
    assert "not converged" in "".join(out.splitlines()[:2])
    assert files.read_toml(swing / "rope.toml")["identification"]["status"] == "not converged"
    code, out, _ = hyperflex("identify", swing / "swing.csv", *arguments, "--json")
    assert code == 3
    assert next(iter(json.loads(out).items())) == ("status", "not converged")


@pytest.mark.parametrize("taken", ["swing.csv", "guess.toml"])
def test_no_input_is_overwritten(hyperflex, swing, taken):
    before = (swing / taken).read_bytes()
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / taken, *DECLARED)
    code, out, err = hyperflex("identify", swing / "swing.csv", *arguments)
    assert (code, out) == (2, "")
    assert "is one of the inputs" in err
    assert (swing / taken).read_bytes() == before


def test_a_wrong_suffix_is_refused(hyperflex, swing):
    arguments = ("--rope", swing / "guess.toml", "-o", swing / "rope.nc", *DECLARED)
    code, _, err = hyperflex("identify", swing / "swing.csv", *arguments)
    assert code == 2
    assert ".toml" in err
    assert not (swing / "rope.nc").exists()
