"""Turning pegs in the public functions: files, continued states, and refusals."""

import numpy as np
import pytest

import hyperflex as hf
from tests.refusals import refuses

CABLE = hf.Rope.uniform(length=0.7, mass=0.044, n_links=18, radius=0.0025, friction=2e-3, tip_mass=0.02)
PULLEY = hf.Peg(0.0, -0.35, 0.03, 0.5, inertia=1e-5, bearing=1e-6)
POST = hf.Peg(0.6, -0.5, 0.03)
HOW = {"tol": 1e-3, "contact_step": 1e-3}


def fallen(**how: object) -> hf.Trajectory:
    """A cable that falls on a wall's end, a post or a pulley, and turns that."""
    pegs = [hf.Wall(-0.6, -1.5, 0.6, -1.5), POST, PULLEY]
    return hf.simulate(CABLE, **{"duration": 0.6, "q0": np.full(18, 1.2), "pegs": pegs, **HOW, **how})


def test_a_run_shows_the_round_pegs_and_survives_its_file(tmp_path):
    run = fallen()
    assert run.peg_angle.shape == run.peg_rate.shape == (run.t.size, 2)
    assert np.abs(run.peg_rate[:, 1]).max() > 1.0
    np.testing.assert_array_equal(run.peg_rate[:, 0], 0.0)
    run.to_netcdf(tmp_path / "run.nc")
    again = hf.read_trajectory(tmp_path / "run.nc")
    for name in ("contact_force", "contact_loss", "peg_angle", "peg_rate"):
        np.testing.assert_array_equal(getattr(again, name), getattr(run, name))
    for name in ("peg_angle", "peg_rate"):
        np.testing.assert_array_equal(getattr(again.state, name), getattr(run.state, name))
        assert again.dataset[name].dims == ("time", "peg")
    assert "contact_force" in again.dataset
    assert set(again.setup.pegs) == set(run.setup.pegs)
    # From the file, too, the run continues to the last bit.
    onwards = [fallen(duration=0.1, state=one.state, q0=None) for one in (run, again)]
    np.testing.assert_array_equal(onwards[0].peg_rate, onwards[1].peg_rate)
    np.testing.assert_array_equal(onwards[0].q, onwards[1].q)
    np.testing.assert_array_equal(onwards[0].peg_angle[0], run.peg_angle[-1])


def test_pegs_survive_their_file():
    setup = hf.Setup(CABLE, pegs=(POST, PULLEY), contact_step=1e-4, tip_force=(0.1, -0.2))
    again = hf.Setup.loads(setup.dumps())
    assert (again.pegs, again.contact_step, again.tip_force) == (setup.pegs, 1e-4, (0.1, -0.2))
    text = hf.Setup(CABLE, pegs=[PULLEY]).dumps()
    refuses("peg inertia is not finite: got nan", hf.Setup.loads, text.replace("inertia = 1e-05", "inertia = nan"))
    refuses("peg inertia is not a number: got", hf.Setup.loads, text.replace("inertia = 1e-05", 'inertia = "heavy"'))
    refuses("pegs is not a table", hf.Setup.loads, "pegs = 3\n" + hf.Setup(CABLE).dumps())


@pytest.mark.parametrize(
    ("axle", "words"),
    [
        ({"inertia": 0.0}, "peg inertia has the wrong sign"),
        ({"inertia": -1e-5}, "peg inertia has the wrong sign"),
        ({"inertia": float("nan")}, "peg inertia is not finite"),
        ({"inertia": float("inf")}, "peg inertia is not finite"),
        ({"inertia": 1e-5, "bearing": -1.0}, "peg bearing has the wrong sign"),
        ({"bearing": 1e-6}, "a fixed peg has no bearing"),
    ],
)
def test_a_bad_axle_is_refused(axle, words):
    refuses(words, hf.Peg, 0.0, -0.35, 0.03, **axle)


@pytest.mark.parametrize(
    ("spin", "words"),
    [
        ({"peg_rate": [1.0]}, "state peg_rate has the wrong shape"),
        ({"peg_rate": [1.0, 0.0]}, "state peg_rate turns a fixed peg"),
        ({"peg_angle": [0.0, float("nan")]}, "cannot be used"),
    ],
)
def test_a_state_that_does_not_fit_is_refused(spin, words):
    state = hf.State(0.0, np.full(18, 1.2), np.zeros(18), **spin)
    refuses(words, fallen, state=state, q0=None)
