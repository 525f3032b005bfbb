"""``hyperflex export``: set-ups to MJCF and back, runs and recordings to MCAP; and a bag that identify reads."""

import numpy as np
import pytest

import hyperflex as hf
from tests.exchange import bags

ROPE = hf.Rope.uniform(length=1.0, mass=0.05, n_links=3, radius=0.003, friction=1e-3)


def test_a_set_up_goes_to_mjcf_and_back(hyperflex, hyperflex_json, tmp_path):
    setup = hf.Setup(ROPE.replace(dry_friction=1e-4), hf.arm_swings(), hf.Arm(length=0.1))
    setup.to_toml(tmp_path / "cast.toml")
    code, said, _ = hyperflex("export", tmp_path / "cast.toml", "-o", tmp_path / "cast.xml")
    assert code == 0
    assert "frictionloss" in said
    code, told = hyperflex_json("export", tmp_path / "cast.xml", "-o", tmp_path / "back.toml")
    assert (code, told["warnings"]) == (0, [])
    assert hf.Setup.from_toml(tmp_path / "back.toml").dumps() == setup.dumps()


def test_runs_and_recordings_go_to_mcap(hyperflex_json, tmp_path):
    run = hf.simulate(ROPE, hf.arm_swings(), arm=hf.Arm(length=0.1), duration=0.2)
    run.to_netcdf(tmp_path / "run.nc")
    given = hf.Recording(run.t, run.q)
    given.to_netcdf(tmp_path / "seen.nc")
    for name in ("run", "seen"):
        assert hyperflex_json("export", tmp_path / f"{name}.nc", "-o", tmp_path / f"{name}.mcap")[0] == 0
        np.testing.assert_array_equal(hf.read_recording(tmp_path / f"{name}.mcap").data, run.q)


def test_what_a_recording_does_not_declare_is_given_by_options(hyperflex, tmp_path):
    (tmp_path / "swing.csv").write_text("t,th1\n0,0\n1,2\n")
    declared = ("--time-unit", "ms", "--unit", "deg")
    assert hyperflex("export", tmp_path / "swing.csv", "-o", tmp_path / "swing.mcap", *declared)[0] == 0
    found = hf.read_recording(tmp_path / "swing.mcap")
    np.testing.assert_allclose(found.data[:, 0], np.radians([0.0, 2.0]))
    np.testing.assert_allclose(found.t, [0.0, 1e-3])


@pytest.mark.parametrize(
    ("source", "out", "named"),
    [
        ("airy.toml", "airy.xml", "air drag"),  # which MuJoCo cannot express
        ("run.nc", "run.xml", ".mcap"),
        ("swing.csv", "swing.mcap", "Pass --time-unit"),
        ("nothing.toml", "a.xml", "no TOML file"),
    ],
)
def test_what_does_not_go_is_refused(refused, tmp_path, source, out, named):
    hf.Setup(ROPE.replace(drag=1e-3)).to_toml(tmp_path / "airy.toml")
    (tmp_path / "swing.csv").write_text("t,th1\n0,0\n1,0\n")
    assert named in refused("export", tmp_path / source, "-o", tmp_path / out)


def test_identify_reads_a_bag(hyperflex, tmp_path):
    """As far as the choice of a topic."""
    rows = [(k, bags.joint_state(10**7 * k, ["a"], [0.1])) for k in range(3)]
    bag = bags.write(tmp_path / "bag", {"/left": (bags.JOINT_STATE, rows), "/right": (bags.JOINT_STATE, rows)})
    ROPE.to_toml(tmp_path / "guess.toml")
    call = ("identify", bag, "--rope", tmp_path / "guess.toml", "-o", tmp_path / "out")
    assert "--topic" in hyperflex(*call)[2]
    assert "[1, 3]" in hyperflex(*call, "--topic", "/left")[2]
