"""A recording with its rope: rings are measurements, the rope is predicted, draws show its uncertainty."""

import base64
import json
import re

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.play.comparison import DRAWN, comparison_page
from tests.refusals import refuses

NOISE = 1e-3  # m


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("recorded")
    truth = hf.Rope.uniform(length=0.6, mass=0.06, n_links=3, radius=0.004, friction=3e-5)
    t = np.arange(201) / 100.0
    run = hf.simulate(truth, duration=2.0, q0=[1.0, 0.6, 0.2], t_eval=t)
    noise = np.random.default_rng(1).normal(0.0, NOISE, run.joints.shape)
    noise[50:60, 3] = np.nan
    places = (run.joints + noise + np.array([0.3, 0.2])).reshape(t.size, -1)
    hf.Recording(t + 7.0, places, kind="markers").to_netcdf(path / "markers.nc")
    hf.Recording(t, run.q).to_netcdf(path / "angles.nc")
    covariance = {"parameters": ["friction[0]"], "covariance": [[1e-10]], "values": {"friction": [3e-5] * 3}}
    files.write_toml(path / "known.toml", {"rope": truth.table(), "identification": covariance})
    files.write_toml(path / "rope.toml", {"rope": truth.table()})
    files.write_toml(
        path / "longer.toml", {"rope": hf.Rope.uniform(length=0.6, mass=0.06, n_links=4, friction=0.0).table()}
    )
    return path, run


def shown(page):
    """Return the contents of a page: its data, the rope's tip, the rings and the drawn ropes, m."""
    data = json.loads(re.search(r'<script type="application/json" id="run">(.*?)</script>', page, re.S)[1])

    def numbers(text, kind):
        return np.frombuffer(base64.b64decode(text), kind)

    steps = numbers(data["places"], "<i4" if data["wide"] else "<i2").reshape(-1, data["points"], 2)
    rope = np.array(data["centre"]) + data["step"] * steps
    rings = numbers(data["dots"]["places"], "<f4").reshape(len(rope), -1, 2)
    return data, rope, rings, np.array([numbers(each, "<f4").reshape(rope.shape) for each in data["ropes"]])


@pytest.mark.parametrize("rope", ["known.toml", "rope.toml"])
def test_markers_lie_on_the_rope_that_is_simulated_from_the_first_half_second(folder, rope):
    path, run = folder
    data, simulated, rings, draws = shown(comparison_page(path / "markers.nc", path / rope))
    np.testing.assert_allclose(simulated, run.joints, atol=8.0 * NOISE)
    assert np.sqrt(np.nanmean((rings[:, 1:] - run.joints[:, 1:]) ** 2)) < 1.3 * NOISE
    assert np.isnan(rings[50:60, 3]).all()
    assert len(draws) == DRAWN
    spread = np.hypot(*(draws - simulated).transpose(3, 0, 1, 2)).mean(axis=(0, 1))
    assert 0.0 < spread[-1] < 0.05
    assert data["series"][-1]["title"] == "simulated less measured"
    assert ("state and parameters" if rope == "known.toml" else "state alone") in data["notes"][0][1]


def test_angles_are_shown_as_joints(folder):
    path, run = folder
    _, simulated, rings, _ = shown(comparison_page(path / "angles.nc", path / "rope.toml"))
    np.testing.assert_allclose(rings, run.joints, atol=1e-6)
    np.testing.assert_allclose(simulated, run.joints, atol=5e-3)


def test_a_rope_of_other_links_is_refused(folder):
    refuses("different numbers of links", comparison_page, folder[0] / "markers.nc", folder[0] / "longer.toml")


def test_the_browser_draws_rings_and_ropes(browser, folder, tmp_path):
    (tmp_path / "page.html").write_text(comparison_page(folder[0] / "markers.nc", folder[0] / "known.toml"), "utf-8")
    browser.open(f"{(tmp_path / 'page.html').as_uri()}#t=0.55")
    browser.screenshot(tmp_path / "seen.png")
    assert browser.evaluate("[ropes.length, dots.t.length]") == [DRAWN, 201]
    assert browser.complaints == []
