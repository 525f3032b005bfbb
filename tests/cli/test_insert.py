"""``hyperflex insert``: what it plans, what it writes, and what it says when it cannot."""

import dataclasses

import pytest

import hyperflex as hf
from hyperflex import files, planning
from tests.planning.known_insert import ROPE, SLOT, far_insert, planned_insert

NAMES = {"report.html", "entry.png", "gap.png", "course.png", "motion.csv", "insert.toml", "insert.nc"}


@pytest.fixture
def setup_file(tmp_path):
    """A set-up whose table says all of the slot."""
    setup = tmp_path / "setup.toml"
    hf.Setup(ROPE, arm=hf.Arm(length=0.15)).to_toml(setup)
    setup.write_text(setup.read_text() + files.dumps_toml({"slot": dataclasses.asdict(SLOT)}))
    return setup


@pytest.fixture
def ready(monkeypatch):
    """Let the command find a plan done; returns what it was asked with."""
    asked = {}

    def plan(found):
        def give(rope, arm, slot, limits=None, *, conditions, time_budget, options):
            asked.update(rope=rope, arm=arm, slot=slot, limits=limits, obstacles=conditions.obstacles)
            asked.update(time_budget=time_budget, seed=options.seed)
            return found

        monkeypatch.setattr(planning, "plan_insert", give)
        return asked

    return plan


def test_file_and_options_say_the_same(hyperflex_json, ready, setup_file, tmp_path):
    asked = ready(planned_insert())
    code, told = hyperflex_json("insert", setup_file, "-o", tmp_path / "out", "--time-budget", "7", "--seed", "3")
    assert code == 0
    assert (asked["rope"], asked["arm"], asked["slot"]) == (ROPE, hf.Arm(length=0.15), SLOT)
    assert (asked["time_budget"], asked["seed"]) == (7.0, 3)
    assert (told["success"], told["outcome"]["depth"]) == (True, planned_insert().outcome.depth)
    chance = told["success_probability"]
    assert (chance["successes"], chance["samples"]) == (45, 50)
    assert chance["interval"] == pytest.approx([0.786, 0.957], abs=1e-3)  # Wilson's, by hand
    assert {path.name for path in (tmp_path / "out").iterdir()} == NAMES
    options = [word for name in ("direction", "width", "depth", "wall") for word in (f"--{name}", getattr(SLOT, name))]
    place = ("--slot", SLOT.x, SLOT.y)
    ROPE.to_toml(tmp_path / "rope.toml")
    asked.clear()
    words = map(str, ("insert", "--rope", tmp_path / "rope.toml", *place, *options, "-o", tmp_path / "out"))
    assert hyperflex_json(*words)[0] == 0
    assert asked["slot"] == SLOT
    assert hf.simulate(hf.Setup.from_toml(setup_file), duration=0.01).success  # a run leaves the slot alone


def test_a_tube_its_speed_and_touches_are_asked_by_file_and_options(hyperflex_json, ready, setup_file, tmp_path):
    asked = ready(planned_insert())
    more = ("--tube", "0.06", "--max-speed", "0.8", "--touching")
    assert hyperflex_json("insert", setup_file, "-o", tmp_path / "out", *more)[0] == 0
    assert asked["slot"] == dataclasses.replace(SLOT, tube=0.06, max_speed=0.8, touching=True)
    setup_file.write_text(setup_file.read_text().replace("tube = 0.0", "tube = 0.06").replace("false", "true"))
    assert hyperflex_json("insert", setup_file, "-o", tmp_path / "out")[0] == 0
    assert asked["slot"] == dataclasses.replace(SLOT, tube=0.06, touching=True)


def test_the_file_of_a_plan_serves_again(hyperflex_json, ready, tmp_path):
    asked = ready(planned_insert())
    planned_insert().to_toml(tmp_path / "insert.toml")
    assert hyperflex_json("insert", tmp_path / "insert.toml", "-o", tmp_path / "out")[0] == 0
    assert (asked["rope"], asked["slot"]) == (ROPE, SLOT)


@pytest.mark.parametrize(
    ("made", "words"),
    [(lambda: planned_insert(enters=False), "touches a wall at"), (far_insert, "the rope ends 0.15 m short")],
)
def test_a_plan_that_fails_has_a_code_of_its_own(hyperflex, ready, setup_file, tmp_path, made, words):
    ready(made())
    code, out, _ = hyperflex("insert", setup_file, "-o", tmp_path / "out")
    assert code == 4
    assert words in " ".join(out.split())
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--width", "0.004"), "slot width is too narrow"),
        (("--depth", "0"), "slot depth has the wrong sign"),
        (("--direction", "90"), "more than a turn"),
    ],
)
def test_slots_that_are_refused(hyperflex, setup_file, tmp_path, more, words):
    code, _, err = hyperflex("insert", setup_file, "-o", tmp_path / "out", *more)
    assert code == 2
    assert words in " ".join(err.split())


def test_what_is_missing_is_named(hyperflex, tmp_path):
    ROPE.to_toml(tmp_path / "rope.toml")
    asked = ("insert", "--rope", tmp_path / "rope.toml", "-o", tmp_path / "out")
    for more, words in (
        ((), "--slot and --direction are missing"),
        (("--slot", "0.2", "-0.9"), "--direction is missing"),
    ):
        code, _, err = hyperflex(*asked, *more)
        assert code == 2
        assert words in err
