"""Ropes drawn from what an identification says: each law along the rope, and files that say it."""

from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import InvalidInput
from hyperflex.model import divided
from hyperflex.planning.uncertainty import RopePosterior

ROPE = hf.Rope.uniform(length=1.0, mass=0.1, n_links=4, radius=0.003, friction=1e-3, stiffness=2e-3, tip_mass=0.02)
COUNT = 1500  # draws: a deviation is determined within 1.8 %, a covariance within some 4 % of the product of deviations


def fitted(covariance: list[list[float]], *labels: str, **factors: float) -> RopePosterior:
    return RopePosterior(
        ROPE, labels, np.array(covariance), {f"{name}:factor": value for name, value in factors.items()}
    )


def ropes(one: RopePosterior, count: int = COUNT) -> list[hf.Rope]:
    return [one.sample(np.random.default_rng([1, m])) for m in range(count)]


def test_what_hangs_together_is_drawn_together():
    covariance = np.array([[4e-8, 3e-8], [3e-8, 4e-8]])
    drawn = ropes(fitted(covariance.tolist(), "friction[1]", "stiffness:shared"))
    x = np.array([[rope.friction[1], rope.stiffness[3]] for rope in drawn])
    np.testing.assert_allclose(np.cov(x.T), covariance, rtol=0.15)
    np.testing.assert_allclose(x.mean(axis=0), [1e-3, 2e-3], rtol=0.02)
    assert all(rope.friction[0] == 1e-3 for rope in drawn[:9])  # link 0 was not fitted
    assert all(np.ptp(rope.stiffness[1:]) == 0.0 for rope in drawn[:9])


def test_factors_and_tapers_act_on_all_links():
    """A factor fitted as 2 +- 0.2 leaves a rope whose friction is known within 10 %."""
    drawn = ropes(fitted([[0.04]], "friction:factor", friction=2.0))
    assert np.std(np.log([rope.friction[2] / 1e-3 for rope in drawn])) == pytest.approx(0.1, rel=0.06)
    drawn = ropes(fitted([[0.09]], "friction:taper"))
    growth = [np.log(rope.friction[3] / rope.friction[1]) for rope in drawn]  # half the rope apart
    assert np.std(growth) == pytest.approx(0.15, rel=0.06)


def test_masses_stay_above_0_and_friction_does_not_fall_below():
    drawn = ropes(fitted([[1e-3, 0, 0], [0, 1e-5, 0], [0, 0, 1e-3]], "mass[0]", "friction:shared", "tip_mass"))
    assert min(rope.mass[0] for rope in drawn) > 0.0
    assert min(rope.friction[0] for rope in drawn) == 0.0
    assert min(rope.tip_mass for rope in drawn) == 0.0


def test_what_is_known_of_several_stays_known_where_one_meets_its_bound():
    """A link's own inertia poorly determined, its inertia about the joint well determined: half of the draws are
    clipped."""
    rod = hf.Rope(length=[0.3], mass=[0.1], com=[0.15], inertia=[1e-5])
    root = np.array([[4e-5, 0.0], [-4e-5 / 0.03, 1e-6 / 0.03]])  # J = I + m a^2, dJ = dI + 0.03 kg m da
    one = RopePosterior(rod, ("inertia[0]", "com[0]"), root @ root.T, {})
    drawn = ropes(one, 400)
    assert 0.3 < np.mean([rope.inertia[0] < 1e-15 for rope in drawn]) < 0.5  # below -0.25 standard deviations: 40 %
    moments = np.array([rope.inertia[0] + rope.mass[0] * rope.com[0] ** 2 for rope in drawn]) - 2.26e-3
    # second order adds m da^2, 2e-7 on average; each drawn number cut for itself leaves 2e-5
    assert np.std(moments) == pytest.approx(1e-6, rel=0.15)
    assert abs(np.mean(moments)) < 4e-7


def test_a_drawn_length_leaves_a_rope_that_can_be_cut():
    (one,) = ropes(fitted([[1e-4]], "length:factor", length=1.0), 1)
    assert divided(one, 2).n_links == 8
    np.testing.assert_allclose(one.inertia, 0.025 * (3.0 * 0.003**2 + one.length**2) / 12.0, rtol=1e-12)
    assert one.total_length != ROPE.total_length
    (one,) = ropes(fitted([[1e-4, 0], [0, 1e-9]], "length:factor", "com[1]", length=1.0), 1)
    np.testing.assert_allclose(np.delete(one.com / one.length, 1), 0.5, rtol=1e-12)  # as in the fit, link by link
    assert abs(one.com[1] - 0.125) < 5 * 3.2e-5


@pytest.mark.parametrize(
    ("std", "row", "unknown"),
    [
        ({"friction": np.array([0.0, 1e-4, np.inf, 0.0])}, 1e-8, ("friction[2]",)),
        ({"friction": [0.0, "unknown", 1e-4, 0.0]}, 1e-8, ("friction[1]",)),
        ({"friction": [0.0, 1e-4, 1e-4, 0.0]}, 0.0, ("friction[2]",)),
        ({}, 1e-8, ()),
    ],
)
def test_what_a_fit_could_not_tell_is_known(std, row, unknown):
    """An infinite deviation, its text in a file, or a row of 0: the possible descriptions of an omitted direction."""
    names = ("friction[1]", "friction[2]")
    fit = SimpleNamespace(
        rope=ROPE, parameters=names, covariance=np.diag([1e-8, row]), values={}, std=std, length_covariance=np.zeros(3)
    )
    found = RopePosterior.from_identification(fit)
    assert found.undetermined == unknown
    assert found.undetermined_properties == (("friction",) if unknown else ())


def test_what_is_none_of_the_rope_s_is_left():
    one = fitted([[1e-4, 0], [0, 1.0]], "gravity_angle", "delay")
    assert ropes(one, 2) == [ROPE, ROPE]
    assert one.fitted_properties == ()


def test_a_file_contains_the_findings_of_the_fit(tmp_path):
    told = {"parameters": ["friction:factor", "mass[2]"], "covariance": [[0.04, 1e-5], [1e-5, 1e-6]]}
    told |= {"length_covariance": [1e-3, 1e-6, 1e-4], "values": {"friction:factor": 2.0, "mass": ROPE.mass.tolist()}}
    arrays = {name: np.array(told[name]) for name in ("covariance", "length_covariance")}
    values = {name: np.array(value) for name, value in told["values"].items()}
    std = {"friction:factor": np.array(0.2), "mass": np.array([0.0, 0.0, 1e-3, 0.0])}
    fit = SimpleNamespace(rope=ROPE, parameters=tuple(told["parameters"]), values=values, std=std, **arrays)
    path = tmp_path / "rope.toml"
    files.write_toml(path, {"rope": ROPE.table(), "identification": told})
    read = RopePosterior.from_toml(path)
    assert ropes(read, 5) == ropes(RopePosterior.from_identification(fit), 5)
    assert read.fitted_properties == ("friction", "mass", "length")
    lengths = np.log([rope.total_length for rope in ropes(read, 400)])
    assert np.std(lengths) == pytest.approx(0.01, rel=0.15)  # 400 draws tell it to 3.5 %
    ROPE.to_toml(path)
    assert RopePosterior.from_toml(path) is None
    for wrong in ({"values": {}}, {"covariance": [[1.0]]}, {"covariance": [["a", 1.0], [1.0, 1.0]]}):
        files.write_toml(path, {"rope": ROPE.table(), "identification": told | wrong})
        with pytest.raises(InvalidInput):
            RopePosterior.from_toml(path)
