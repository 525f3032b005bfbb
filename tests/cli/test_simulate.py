"""``hyperflex simulate``: set-up in, NetCDF out, and its error messages."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import simulation


@pytest.fixture
def setup(tmp_path, monkeypatch):
    """A set-up, whose file is cast.toml in the working directory."""
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, friction=1e-3)
    made = hf.Setup(rope, hf.arm_swings(), hf.Arm(length=0.1), duration=1.0)
    made.to_toml(tmp_path / "cast.toml")
    monkeypatch.chdir(tmp_path)
    return made


def files(folder):
    return {path.name for path in folder.iterdir()}


CALL = ("simulate", "cast.toml", "-o", "cast.nc")


def test_simulate_writes_the_run_and_sums_it_up(hyperflex, hyperflex_json, setup):
    code, out, err = hyperflex(*CALL)
    assert (code, "greatest torque" in out, "error" in err.lower()) == (0, True, False)
    assert ("at rest" in out, "no duration" in err) == (False, False)
    np.testing.assert_array_equal(hf.read_trajectory("cast.nc").q, hf.simulate(setup).q)
    code, result = hyperflex_json(*CALL, "--duration", "0.5")
    want = {"end_s": 0.5, "links": 5, "output": "cast.nc", "tip_m": hf.read_trajectory("cast.nc").tip[-1].tolist()}
    assert (code, {name: result[name] for name in want}) == (0, want)


def test_simulate_reports_how_far_to_the_side_a_tilted_rope_is(hyperflex, hyperflex_json, setup):
    _, result = hyperflex_json(*CALL, "--tilt", "0.02")
    found = hf.sideways(hf.simulate(setup), tilt=0.02)
    want = {
        "most_m": np.abs(found.joints).max(),
        "last_m": abs(found.tip[-1]),
        "tilt_rad": 0.02,
        "error_m": found.error,
        "warning": found.warning() or None,
    }
    assert result["sideways"] == pytest.approx({**want, "touch_s": None})
    assert "sideways most" in hyperflex(*CALL, "--tilt", "0.02")[1]
    assert "--tilt" in hyperflex("simulate", "cast.toml", "-o", "bad.nc", "--tilt", "nan")[2]
    assert "bad.nc" not in files(Path())


def test_simulate_estimates_the_limit_of_many_links(hyperflex_json, setup):
    _, result = hyperflex_json(*CALL, "--extrapolate")
    found = hf.simulate(setup, extrapolate=True)
    assert result["limit_tip_m"] == found.limit[-1, -1].tolist()
    assert result["limit_error_m"] == found.limit_error.max()
    np.testing.assert_array_equal(hf.read_trajectory("cast.nc").limit, found.limit)
    setup.replace(pegs=(hf.Peg(0.0, -3.0, 0.05),)).to_toml("cast.toml")
    assert "free run" in hyperflex_json(*CALL, "--extrapolate")[1]["error"]


@pytest.mark.filterwarnings("default:not predictable")
def test_simulate_says_from_when_on_a_run_cannot_be_trusted(hyperflex, hyperflex_json, setup):
    """With the friction of the set-up to the end, without any not: a tangle; a stricter distance ends it sooner."""
    names = ("trusted_to_the_end", "horizon_s", "warnings")
    _, tame = hyperflex_json(*CALL)
    assert [tame[name] for name in names] == [True, 1.0, []]
    found = hf.simulate(setup.replace(rope=setup.rope.replace(friction=0.0), duration=10.0))
    found.setup.to_toml("cast.toml")
    code, wild = hyperflex_json(*CALL)
    assert (code, wild["status"]) == (0, "success")
    assert [wild[name] for name in names] == [False, found.predictable_until, [found.warning()]]
    said = hyperflex(*CALL)[2]
    assert f"not predictable after {found.predictable_until:.4g} s" in " ".join(said.split())
    _, strict = hyperflex_json(*CALL, "--horizon", "0.0001")
    assert strict["horizon_s"] == found.agrees_until(1e-4) < found.predictable_until


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((*CALL, "--horizon", "0"), "--horizon"),
        (("simulate", "cast.toml"), "--output"),
        (("simulate", "cast.toml", "-o", "no/cast.nc"), "hyperflex: The folder"),
        (("simulate", "cast.toml", "-o", "cast.csv"), ".nc"),
        (("simulate", "cast.toml", "-o", "cast.toml"), "is one of the inputs"),
        (("simulate", "cast.toml", "-o", "link.nc"), "is one of the inputs"),
        (("simulate", "cast.toml", "-o", "hard.nc"), "is one of the inputs"),
    ],
)
def test_errors_are_one_line_or_one_json_object_and_leave_nothing(
    hyperflex, hyperflex_json, setup, tmp_path, words, message
):
    (tmp_path / "link.nc").symlink_to("cast.toml")
    (tmp_path / "hard.nc").hardlink_to("cast.toml")
    before, left = (tmp_path / "cast.toml").read_bytes(), files(tmp_path)
    code, out, err = hyperflex(*words)
    assert (code, out, message in err, err.count("\n")) == (2, "", True, 1)
    code, result = hyperflex_json(*words)
    assert (code, message.removeprefix("hyperflex: ") in result["error"]) == (2, True)
    assert {name: result[name] for name in ("success", "status")} == {"success": False, "status": "failed"}
    assert ((tmp_path / "cast.toml").read_bytes(), files(tmp_path)) == (before, left)


@pytest.mark.parametrize("samples", [None, 0, 20])
def test_ctrl_c_keeps_what_was_simulated_under_a_name_that_reports_it(
    hyperflex_json, setup, tmp_path, monkeypatch, samples
):
    whole = hf.simulate(setup)

    def interrupted(*_, **__):
        if samples is None:
            raise KeyboardInterrupt
        rows = {field.name: getattr(whole, field.name) for field in dataclasses.fields(whole)}
        part = {name: rows[name][:samples] for name in rows if isinstance(rows[name], np.ndarray)}
        raise hf.Interrupted(dataclasses.replace(whole, **part, status="interrupted"))

    monkeypatch.setattr(simulation, "simulate", interrupted)
    code, result = hyperflex_json(*CALL)
    assert (code, result["error"]) == (130, "interrupted")
    assert files(tmp_path) == {"cast.toml"} | ({"cast-interrupted.nc"} if samples else set())
    if samples:
        kept = hf.read_trajectory(result["output"])
        assert (kept.status, kept.t.size) == ("interrupted", samples)


def test_the_end_of_the_time_keeps_what_was_simulated(hyperflex_json, setup, tmp_path):
    code, result = hyperflex_json(*CALL, "--duration", 3e4, "--time-budget", 0.3)
    assert (code, result["success"], result["status"]) == (3, False, "out of time")
    kept = hf.read_trajectory(tmp_path / "cast-interrupted.nc")
    assert (kept.status, kept.t[-1] > 0.0, (tmp_path / "cast.nc").exists()) == ("out of time", True, False)


def test_ctrl_c_after_the_run_reports_that_it_is_written(hyperflex_json, setup, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "tighter_run", interrupted)
    code, result = hyperflex_json(*CALL)
    assert (code, result["error"], result["status"]) == (130, "interrupted", "success")
    assert ((tmp_path / "cast.nc").exists(), "cast.nc" in result["message"]) == (True, True)


@pytest.mark.filterwarnings("ignore:.*near the peg")
def test_simulate_tells_how_the_rope_lies_on_the_pegs(hyperflex, hyperflex_json, setup):
    """One peg over which the rope hangs, with optional properties, and one that it never touches."""
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=8, radius=0.003, friction=1e-4)
    pegs = [hf.Peg(0.0, 0.0, 0.1, mu=0.5), hf.Peg(2.0, 0.0, 0.1)]
    over = hf.Setup(rope, arm=hf.Arm(length=0.1, pivot=(-0.3, 0.25)), pegs=pegs, duration=1.0, q0=np.full(8, 1.6))
    over.to_toml("cast.toml")
    code, result = hyperflex_json(*CALL, "--tug")
    run, (over, never) = hf.read_trajectory("cast.nc"), result["pegs"]
    measured = hf.measure_winding(run, pegs[0])
    assert (code, over["turns"], over["covered_rad"]) == (0, measured.turns[-1], measured.contact[-1])
    assert over["covered_rad"] > 0.5
    assert over["slip_m"] == hf.rope_slip(run, pegs[0])[-1] or over["slip_m"] is None
    assert over["hold_N"] == hf.tug_test(run, pegs[0]).hold
    assert (never["slip_m"], never["tension_N"], "hold_N" in never) == (None, None, False)
    said = hyperflex(*CALL, "--tug")[1]
    assert f"{over['turns']:.2f} turns, {np.degrees(over['covered_rad']):.0f} degrees covered" in said
    assert "slipped -" not in said
    assert "peg at (2, 0) m" in said
    assert "does not touch it at the end" in said


def test_a_rope_alone_hangs_at_rest_for_the_default_duration(hyperflex, setup):
    setup.rope.to_toml("rope.toml")
    _, out, err = hyperflex("simulate", "rope.toml", "-o", "still.nc")
    assert "no duration is given, so 10 s are simulated" in err
    assert "the rope hangs from a point at rest" in out
