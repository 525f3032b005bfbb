"""``hyperflex simulate``: set-up in, NetCDF out, and what it says when that cannot be."""

import dataclasses

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import simulation
from hyperflex.cli.simulate import _winding


@pytest.fixture
def setup_file(tmp_path):
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, friction=1e-3)
    path = tmp_path / "cast.toml"
    hf.Setup(rope, hf.arm_swings(), hf.Arm(length=0.1), duration=1.0).to_toml(path)
    return path


def test_simulate_writes_the_run_and_sums_it_up(hyperflex, setup_file, tmp_path):
    code, out, err = hyperflex("simulate", setup_file, "-o", tmp_path / "cast.nc")
    assert code == 0
    assert "greatest |x| of the tip" in out
    assert "error" not in err.lower()
    run = hf.read_trajectory(tmp_path / "cast.nc")
    direct = hf.simulate(hf.Setup.from_toml(setup_file))
    np.testing.assert_array_equal(run.q, direct.q)


def test_simulate_as_json(hyperflex_json, setup_file, tmp_path):
    code, result = hyperflex_json("simulate", setup_file, "-o", tmp_path / "cast.nc", "--duration", "0.5")
    run = hf.read_trajectory(tmp_path / "cast.nc")
    assert code == 0
    assert result["end_s"] == 0.5
    assert result["links"] == 5
    assert result["tip_m"] == run.tip[-1].tolist()
    assert result["output"] == str(tmp_path / "cast.nc")


def test_simulate_tells_how_long_it_can_be_trusted(hyperflex, hyperflex_json, setup_file, tmp_path):
    found = hf.predictability(hf.Setup.from_toml(setup_file))
    for allowed, to_the_end in ((1e-5, False), (1.0, True)):  # an error of tol, 1e-5 m, grows by more than nothing
        run = ("simulate", setup_file, "-o", tmp_path / "cast.nc", "--horizon", str(allowed))
        _, result = hyperflex_json(*run)
        assert result["trusted_to_the_end"] == to_the_end
        assert result["horizon_s"] == min(1.0, found.horizon(allowed))
        assert result["lyapunov_exponent_per_s"] == found.exponent()
        assert ("to the end" in hyperflex(*run)[1]) == to_the_end


def test_a_horizon_that_is_no_length_is_refused_before_the_run(hyperflex, setup_file, tmp_path):
    code, _, err = hyperflex("simulate", setup_file, "-o", tmp_path / "cast.nc", "--horizon", "0")
    assert code == 2
    assert "--horizon" in err
    assert not (tmp_path / "cast.nc").exists()


@pytest.mark.parametrize("arguments", [("simulate", "nowhere.toml", "-o", "x.nc"), ("simulate", "nowhere.toml")])
def test_errors_are_one_json_object_and_exit_code_2(hyperflex_json, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    code, result = hyperflex_json(*arguments)
    assert code == 2
    assert set(result) == {"error", "type"}
    assert list(tmp_path.iterdir()) == []


def test_errors_without_json_go_to_standard_error(hyperflex, setup_file, tmp_path):
    code, out, err = hyperflex("simulate", setup_file, "-o", tmp_path / "no" / "cast.nc")
    assert (code, out) == (2, "")
    assert err.startswith("hyperflex: The folder")
    assert err.count("\n") == 1


def test_a_bad_setup_is_explained(hyperflex, tmp_path):
    (tmp_path / "bad.toml").write_text('duration = -1.0\n[rope]\nlength = [0.5, 0.5]\nmass = "heavy"\n')
    code, _, err = hyperflex("simulate", tmp_path / "bad.toml", "-o", tmp_path / "bad.nc")
    assert code == 2
    assert "mass" in err
    assert not (tmp_path / "bad.nc").exists()


def test_ctrl_c_exits_with_130_and_leaves_nothing(hyperflex, setup_file, tmp_path, monkeypatch):
    def interrupted(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "simulate", interrupted)
    code, out, err = hyperflex("simulate", setup_file, "-o", tmp_path / "cast.nc")
    assert (code, out) == (130, "")
    assert err.startswith("hyperflex: Interrupted")
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["cast.toml"]


@pytest.mark.parametrize("samples", [0, 20])
def test_ctrl_c_keeps_what_was_simulated_under_a_name_that_says_so(
    hyperflex_json, setup_file, tmp_path, monkeypatch, samples
):
    def interrupted(setup, **_):
        whole = simulation_of(setup)
        rows = {field.name: getattr(whole, field.name) for field in dataclasses.fields(whole)}
        part = {name: rows[name][:samples] for name in rows if isinstance(rows[name], np.ndarray)}
        raise hf.Interrupted(dataclasses.replace(whole, **part, status="interrupted"))

    simulation_of = simulation.simulate
    monkeypatch.setattr(simulation, "simulate", interrupted)
    code, result = hyperflex_json("simulate", setup_file, "-o", tmp_path / "cast.nc")
    assert (code, result["error"]) == (130, "interrupted")
    assert {path.name for path in tmp_path.iterdir()} == {"cast.toml"} | ({"cast-interrupted.nc"} if samples else set())
    if samples:
        kept = hf.read_trajectory(result["output"])
        assert (kept.status, kept.t.size) == ("interrupted", samples)


def test_ctrl_c_after_the_run_says_that_it_is_written(hyperflex_json, setup_file, tmp_path, monkeypatch):
    def interrupted(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "predictability", interrupted)
    code, result = hyperflex_json("simulate", setup_file, "-o", tmp_path / "cast.nc", "--horizon", "0.01")
    assert (code, result["error"], result["status"]) == (130, "interrupted", "success")
    assert (tmp_path / "cast.nc").exists()
    assert "cast.nc" in result["message"]


@pytest.mark.parametrize("name", ["cast.toml", "link.nc", "hard.nc"])
def test_the_setup_is_never_overwritten(hyperflex, setup_file, tmp_path, name):
    (tmp_path / "link.nc").symlink_to(setup_file)
    (tmp_path / "hard.nc").hardlink_to(setup_file)
    before = setup_file.read_bytes()
    code, out, err = hyperflex("simulate", setup_file, "-o", tmp_path / name)
    assert (code, out) == (2, "")
    assert "is one of the inputs" in err
    assert setup_file.read_bytes() == before


def test_a_wrong_suffix_is_refused(hyperflex, setup_file, tmp_path):
    code, _, err = hyperflex("simulate", setup_file, "-o", tmp_path / "cast.csv")
    assert code == 2
    assert ".nc" in err
    assert not (tmp_path / "cast.csv").exists()


def test_simulate_tells_how_the_rope_lies_on_the_pegs(hyperflex, hyperflex_json, tmp_path):
    """One peg that the rope hangs over, with what it holds on demand, and one that it never meets."""
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=8, radius=0.003, friction=1e-4)
    pegs = [hf.Peg(0.0, 0.0, 0.1, mu=0.5), hf.Peg(2.0, 0.0, 0.1)]
    setup = hf.Setup(rope, arm=hf.Arm(length=0.1, pivot=(-0.3, 0.25)), pegs=pegs, duration=1.0, q0=np.full(8, 1.6))
    setup.to_toml(tmp_path / "over.toml")
    call = ("simulate", tmp_path / "over.toml", "-o", tmp_path / "over.nc", "--tug")
    code, result = hyperflex_json(*call)
    assert code == 0
    run = hf.read_trajectory(tmp_path / "over.nc")
    over, never = result["pegs"]
    measured = hf.measure_winding(run, pegs[0])
    assert (over["turns"], over["covered_rad"]) == (measured.turns[-1], measured.contact[-1])
    assert over["covered_rad"] > 0.5
    assert over["slip_m"] == hf.rope_slip(run, pegs[0])[-1] or over["slip_m"] is None
    assert over["hold_N"] == hf.tug_test(run, pegs[0]).hold
    assert (never["slip_m"], never["tension_N"], "hold_N" in never) == (None, None, False)
    said = hyperflex(*call)[1]
    assert f"{over['turns']:.2f} turns, {np.degrees(over['covered_rad']):.0f} degrees covered" in said
    assert "peg at (2, 0) m" in said
    assert "does not touch it at the end" in said


def test_how_far_a_rope_slipped_has_no_sign():
    words = _winding({"turns": 2.3, "tension_N": 0.2, "covered_rad": 11.0, "slip_m": -2e-6})
    assert "slipped 0.0 mm" in words


def test_a_set_up_in_which_nothing_moves_says_so(hyperflex, setup_file, tmp_path):
    alone = tmp_path / "rope.toml"
    hf.Setup.from_toml(setup_file).rope.to_toml(alone)
    assert "the rope hangs from a point at rest" in hyperflex("simulate", alone, "-o", tmp_path / "still.nc")[1]
    assert "at rest" not in hyperflex("simulate", setup_file, "-o", tmp_path / "cast.nc")[1]
