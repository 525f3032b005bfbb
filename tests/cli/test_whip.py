"""``hyperflex whip``: what it plans, what it writes, and what it says when it cannot."""

import dataclasses
import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import planning
from hyperflex.planning.tasks.whip import verify_whip
from hyperflex.report import WhipReport
from tests.planning.known_whip import ROPE, far_whip, planned_whip

NAMES = {"report.html", "peak.png", "passing.png", "course.png", "motion.csv", "whip.toml", "whip.nc"}


@pytest.fixture
def rope_file(tmp_path):
    ROPE.to_toml(tmp_path / "rope.toml")
    return tmp_path / "rope.toml"


@pytest.fixture
def ready(monkeypatch):
    """Let the command find a plan done; returns what it was asked with."""
    asked = {}

    def plan(found, **changes):
        def give(rope, arm, target, limits=None, *, conditions, time_budget, options):
            way = None if target.any_direction else (math.cos(target.direction), math.sin(target.direction))
            asked.update(rope=rope, arm=arm, point=(target.x, target.y), direction=way, limits=limits)
            asked.update(least_speed=target.least_speed, angle_tolerance=target.angle_tolerance)
            asked.update(obstacles=conditions.obstacles, time_budget=time_budget, **dataclasses.asdict(options))
            return dataclasses.replace(found, **changes)

        monkeypatch.setattr(planning, "plan_whip", give)
        return asked

    return plan


def arguments(rope, out, *more, target=("0.3", "-0.9")):
    return ("whip", "--rope", rope, "--target", *target, "-o", out, *more)


def test_a_plan_that_stands(hyperflex_json, rope_file, ready, tmp_path):
    asked = ready(planned_whip())
    options = "--direction 0.5235987755982988 --angle-tolerance 0.2617993877991494 --least-speed 2 --arm-length 0.2"
    options = (*options.split(), "--speed", "5")
    code, told = hyperflex_json(*arguments(rope_file, tmp_path / "out", *options, "--time-budget", "7", "--seed", "3"))
    assert code == 0
    assert (asked["rope"], asked["arm"], asked["point"]) == (ROPE, hf.Arm(length=0.2), (0.3, -0.9))
    np.testing.assert_allclose(asked["direction"], [math.cos(math.pi / 6), 0.5], rtol=1e-12)
    assert asked["limits"] == hf.MotorLimits(speed=5.0)
    assert asked["angle_tolerance"] == pytest.approx(math.pi / 12)
    assert (asked["least_speed"], asked["time_budget"]) == (2.0, 7.0)
    assert (asked["seed"], asked["skip_feasibility"]) == (3, False)
    assert told["success"]
    assert (told["source"], told["message"], len(told["starts"])) == ("simulated", "", 3)
    assert told["outcome"]["miss"] == planned_whip().outcome.miss
    assert told["target"]["direction"] == planned_whip().target.direction
    assert told["impact"]["impulse"] == planned_whip().impact().impulse
    assert {path.name for path in (tmp_path / "out").iterdir()} == NAMES
    stop = planned_whip().motion.breaks[-1]
    assert hf.read_motion(told["files"]["motion"]).breaks[-1] == pytest.approx(stop, abs=5e-3)


def test_a_set_up_file_gives_rope_arm_and_target(hyperflex, ready, tmp_path):
    setup = tmp_path / "setup.toml"
    hf.Setup(ROPE, arm=hf.Arm(length=0.15)).to_toml(setup)
    target = "[target]\nx = 0.3\ny = -0.9\ndirection = 0.5\nangle_tolerance = 0.2\nleast_speed = 3.0\n"
    setup.write_text(setup.read_text() + target)
    asked = ready(planned_whip())
    assert hyperflex("whip", setup, "-o", tmp_path / "out")[0] == 0
    assert (asked["rope"], asked["arm"], asked["point"]) == (ROPE, hf.Arm(length=0.15), (0.3, -0.9))
    np.testing.assert_allclose(asked["direction"], [math.cos(0.5), math.sin(0.5)], rtol=1e-12)
    assert (asked["angle_tolerance"], asked["least_speed"]) == (0.2, 3.0)
    assert hyperflex("whip", setup, "--target", "0.1", "-0.8", "--least-speed", "2", "-o", tmp_path / "out")[0] == 0
    assert (asked["point"], asked["least_speed"], asked["angle_tolerance"]) == ((0.1, -0.8), 2.0, 0.2)
    setup.write_text(setup.read_text() + "pace = 3.0\n")
    code, _, err = hyperflex("whip", setup, "-o", tmp_path / "out")
    assert code == 2
    assert "[target] does not know this key" in err


def test_file_and_options_have_the_same_names_and_units(hyperflex, ready, tmp_path):
    setup = tmp_path / "setup.toml"
    hf.Setup(ROPE).to_toml(setup)
    plain, asked = setup.read_text(), ready(planned_whip())
    seen = []
    for more, options in (
        ("direction = 0.7\nangle_tolerance = 0.3\nleast_speed = 4.0\n", ()),
        ("", ("--direction", "0.7", "--angle-tolerance", "0.3", "--least-speed", "4.0")),
    ):
        setup.write_text(f"{plain}[target]\nx = 0.3\ny = -0.9\n{more}")
        assert hyperflex("whip", setup, *options, "-o", tmp_path / "out")[0] == 0
        seen.append([asked[name] for name in ("direction", "angle_tolerance", "least_speed")])
    assert seen[0] == seen[1] == [(math.cos(0.7), math.sin(0.7)), 0.3, 4.0]
    setup.write_text(f"{plain}[target]\nx = 0.3\ny = -0.9\ndirection = 40.0\n")
    code, _, err = hyperflex("whip", setup, "-o", tmp_path / "out")
    assert code == 2
    assert "target direction is more than a turn" in err


def test_obstacles_of_a_set_up_file_count_and_a_missing_target_is_refused(hyperflex, rope_file, ready, tmp_path):
    peg = hf.Peg(0.0, 1.0, 0.1)
    hf.Setup(ROPE, pegs=(peg,)).to_toml(tmp_path / "setup.toml")
    asked = ready(planned_whip())
    assert hyperflex("whip", tmp_path / "setup.toml", "--target", "0.3", "-0.9", "-o", tmp_path / "out")[0] == 0
    assert asked["obstacles"] == (peg,)
    code, _, err = hyperflex("whip", "--rope", rope_file, "-o", tmp_path / "out")
    assert code == 2
    assert "--target is missing" in err


def test_a_plan_whose_obstacles_were_moved_in_its_file_is_refused(hyperflex, ready, tmp_path):
    """What is planned with stands further down in the file, so the change would not count."""
    wall, plan = hf.Wall(0.5, -1.5, 0.5, -1.25), planned_whip()
    asked = ready(plan)
    known = dataclasses.replace(plan.problem, obstacles=(wall,))
    seen = verify_whip(known, plan.target, plan.motion, plan.outcome.t)
    dataclasses.replace(plan, problem=known, outcome=seen).to_toml(tmp_path / "whip.toml")
    assert hyperflex("whip", tmp_path / "whip.toml", "-o", tmp_path / "out")[0] == 0
    assert asked["obstacles"] == (wall,)
    text = (tmp_path / "whip.toml").read_text()
    assert text.count("-1.25") == 2
    (tmp_path / "whip.toml").write_text(text.replace("-1.25", "-1.0", 1))
    code, _, err = hyperflex("whip", tmp_path / "whip.toml", "-o", tmp_path / "out")
    assert code == 2
    assert "is of a plan for other obstacles than it names" in " ".join(err.split())


def test_without_a_direction_any_will_do(hyperflex_json, rope_file, ready, tmp_path):
    asked = ready(planned_whip(any_direction=True))
    code, told = hyperflex_json(*arguments(rope_file, tmp_path / "out"))
    assert code == 0
    assert asked["direction"] is None
    assert told["target"]["angle_tolerance"] == math.pi
    assert "in any direction" in (tmp_path / "out" / "report.html").read_text()


def test_a_plan_that_fails_has_a_code_of_its_own(hyperflex, rope_file, ready, tmp_path):
    ready(planned_whip(meets=False))
    code, out, _ = hyperflex(*arguments(rope_file, tmp_path / "out"))
    assert code == 4
    assert "misses the target by 30.0 mm" in " ".join(out.split())
    assert {path.name for path in (tmp_path / "out").iterdir()} == NAMES


def test_ctrl_c_leaves_the_best_so_far(hyperflex_json, rope_file, ready, tmp_path):
    ready(planned_whip(meets=False), interrupted=True, outcome=None, finer_outcome=None, message="interrupted early")
    code, told = hyperflex_json(*arguments(rope_file, tmp_path / "out"))
    assert (code, told["error"], told["interrupted"]) == (130, "interrupted", True)
    assert "the best plan so far" in told["message"]
    assert "interrupted early" in told["message"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"report.html", "motion.csv", "whip.toml"}


@pytest.mark.parametrize("when", ["impact", "figures"])
def test_ctrl_c_while_drawing_leaves_the_plan(hyperflex_json, rope_file, ready, tmp_path, monkeypatch, when):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(*((planning.WhipPlan, "impact") if when == "impact" else (WhipReport, "figures")), stop)
    ready(planned_whip())
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("an earlier whip's")
    code, told = hyperflex_json(*arguments(rope_file, tmp_path / "out"))
    assert (code, told["error"], told["success"]) == (130, "interrupted", True)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"motion.csv", "whip.toml", "whip.nc"}
    assert sorted(told["files"]) == ["motion", "plan", "run"]
    assert "figures" in told["missing"]
    assert "motion.csv" in told["message"]


def test_a_target_out_of_reach_is_a_page_with_the_reason(hyperflex, rope_file, ready, tmp_path):
    ready(far_whip())
    code, out, _ = hyperflex(*arguments(rope_file, tmp_path / "out"))
    assert code == 4
    assert "out of reach: the rope ends 1.40 m short" in " ".join(out.split())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--direction", "nan"), "target direction is not finite"),
        (("--angle-tolerance", "0"), "--angle-tolerance"),
        (("--angle-tolerance", "4"), "--angle-tolerance is too large"),
        (("--direction", "30"), "If these are degrees, give 0.5236"),
        (("--angle-tolerance", "15"), "If these are degrees, give 0.2618"),
        (("--least-speed", "0"), "--least-speed"),
        (("--arm-length", "0"), "--arm-length"),
        (("--speed", "0"), "motor speed"),
        (("--acceleration", "0"), "motor acceleration"),
        (("--time-budget", "0"), "--time-budget"),
        (("--rate", "0"), "--rate"),
        (("--seed", "-1"), "seed"),
    ],
)
def test_bad_input_is_refused(hyperflex, rope_file, tmp_path, more, words):
    direction = () if more[0] == "--direction" else ("--direction", "0")
    code, out, err = hyperflex(*arguments(rope_file, tmp_path / "out", *direction, *more))
    assert (code, out) == (2, "")
    assert words in err
    assert [path.name for path in tmp_path.iterdir()] == ["rope.toml"]


def test_a_point_that_is_none_is_refused(hyperflex, rope_file, tmp_path):
    code, _, err = hyperflex(*arguments(rope_file, tmp_path / "out", target=("nan", "0")))
    assert code == 2
    assert "target x is not finite" in err


def test_a_file_in_the_way_is_told_before_the_search(hyperflex, rope_file, tmp_path):
    (tmp_path / "out").write_text("mine")
    code, _, err = hyperflex(*arguments(rope_file, tmp_path / "out"))
    assert code == 2
    assert "not a folder" in err
    assert (tmp_path / "out").read_text() == "mine"
