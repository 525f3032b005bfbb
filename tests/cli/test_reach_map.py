"""``hyperflex reach-map``: what it reads of a set-up file, what it writes, and what Ctrl-C leaves."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import planning
from hyperflex.errors import Interrupted
from hyperflex.planning import NOT_PLANNED
from tests.planning.known import CABLE

POST, OTHER, FLOOR = hf.Peg(0.8, -1.1, 0.3, 0.4), hf.Peg(1.5, 1.0, 0.1), hf.Ground(0.0, -3.0)


@pytest.fixture
def setup(tmp_path):
    hf.Setup(CABLE, arm=hf.Arm(length=0.105), pegs=(POST, OTHER, FLOOR)).to_toml(tmp_path / "setup.toml")
    return tmp_path / "setup.toml"


def test_targets_are_like_the_first_peg_and_the_rest_are_obstacles(hyperflex_json, setup, tmp_path):
    code, told = hyperflex_json("reach-map", setup, "--cells", 1, "-o", tmp_path / "out")
    assert (code, told["targets"], told["feasible"], told["complete"]) == (0, 2, 0, True)
    found = hf.read_reach_map(told["files"]["map"])
    assert (found.problem.obstacles, found.problem.criteria.contact) == ((OTHER, FLOOR), 0.0)
    assert (found.radius, found.mu) == (POST.radius, POST.mu)
    words = [text.get_text() for text in found.plot().legends[0].get_texts()]
    assert not [word for word in words if "obstacle" in word]  # they lie beyond the picture
    low, far = float(found.y[0]), hf.Wall(9.0, 0.0, 9.0, 1.0)
    seen = replace(found, problem=replace(found.problem, obstacles=(hf.Ground(0.0, low), far, hf.Peg(1.0, low, 0.1))))
    words = [text.get_text() for text in seen.plot().legends[0].get_texts()]
    assert [word for word in words if "obstacle" in word] == ["ground, an obstacle", "peg, an obstacle"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"reach-map.nc", "reach-map.png"}
    code, told = hyperflex_json(
        "reach-map", setup, "--cells", 1, "--radius", 0.4, "--mu", 0.1, "-o", tmp_path / "out", "--contact", 6.28
    )
    found = hf.read_reach_map(told["files"]["map"])
    assert (found.radius, found.mu, found.problem.criteria.contact) == (0.4, 0.1, 6.28)
    assert (found.problem.criteria.turns, found.problem.criteria.settle) == (1.25, 1.0)
    asked = ("--turns", 0.75, "--settle", 2.5)
    code, told = hyperflex_json("reach-map", setup, "--cells", 1, "-o", tmp_path / "out", *asked)
    found = hf.read_reach_map(told["files"]["map"])
    assert (code, found.problem.criteria.turns, found.problem.criteria.settle) == (0, 0.75, 2.5)


def test_an_interrupt_leaves_the_map_so_far_and_says_so(hyperflex_json, setup, tmp_path, monkeypatch):
    whole = hf.build_reach_map(CABLE, hf.Arm(length=0.105), grid=planning.TargetGrid(x=[2.2, 2.4], y=[0.0]))
    part = replace(whole, status=np.array([[1, NOT_PLANNED]]))

    def stopped(*_, **__):
        raise Interrupted(part)

    monkeypatch.setattr(planning, "build_reach_map", stopped)
    code, told = hyperflex_json("reach-map", setup, "-o", tmp_path / "out")
    assert (code, told["complete"], told["error"]) == (130, False, "interrupted")
    assert hf.read_reach_map(told["files"]["map"]).status.tolist() == [[1, NOT_PLANNED]]
