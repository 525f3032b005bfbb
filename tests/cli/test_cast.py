"""``hyperflex cast``: what it plans, what it writes, and what it says when it cannot."""

import contextlib
import dataclasses
import io
import signal

import pytest

import hyperflex as hf
from hyperflex import files, planning
from hyperflex.interruption import _USUAL
from hyperflex.planning import FallbackTarget, SuccessProbability
from hyperflex.planning.outcome import TOO_LONG
from hyperflex.planning.uncertainty import Uncertainty
from hyperflex.report import CastReport
from tests.planning.known import CABLE, PEG, late, planned, stopped

NAMES = {"report.html", "strike.png", "course.png", "tug.png", "motion.csv", "cast.toml", "cast.nc"}


@pytest.fixture
def rope_file(tmp_path):
    CABLE.to_toml(tmp_path / "rope.toml")
    return tmp_path / "rope.toml"


@pytest.fixture
def ready(monkeypatch):
    """Let the command find a plan done; returns what it was asked with."""
    asked = {}

    def plan(name, **changes):
        def give(rope, arm, target, limits, **options):
            asked.update(rope=rope, arm=arm, target=target, limits=limits, **options)
            for part in ("criteria", "conditions", "options"):
                asked.update(vars(options[part]))
            known = {"winds": planned, "late": late, "stopped": stopped}.get(name, lambda: planned(winds=False))
            return dataclasses.replace(known(), **changes)

        monkeypatch.setattr(planning, "plan_cast", give)
        return asked

    return plan


def arguments(rope, out, *more, target=("-0.83", "-1.07"), radius="0.04"):
    return ("cast", "--rope", rope, "--target", *target, "--radius", radius, "-o", out, *more)


def test_a_plan_that_stands(hyperflex_json, rope_file, ready, tmp_path):
    asked = ready("winds")
    options = "--mu 0.4 --arm-length 0.2 --speed 5 --torque 2 --time-budget 7 --seed 3 --contact 6.28 --clearance 0.01"
    options = (*options.split(), *["--turns", "2", "--settle", "1.5"])
    code, told = hyperflex_json(*arguments(rope_file, tmp_path / "out", *options))
    assert code == 0
    assert (asked["contact"], asked["clearance"]) == (6.28, 0.01)
    assert (asked["turns"], asked["settle"]) == (2.0, 1.5)
    assert told["clearance"] == planned().clearance
    assert told["outcome"]["contact_angle"] == planned().outcome.contact_angle
    assert asked["rope"] == CABLE
    assert (asked["target"], asked["arm"]) == (hf.Peg(-0.83, -1.07, 0.04, 0.4), hf.Arm(length=0.2))
    assert asked["limits"] == hf.MotorLimits(speed=5.0, torque=2.0)
    assert (asked["time_budget"], asked["seed"], asked["uncertainty"]) == (7.0, 3, None)
    assert (asked["time_limit"], asked["skip_feasibility"]) == (None, False)
    assert told["success"]
    assert (told["source"], told["message"]) == ("simulated", "")
    assert len(told["moves"]["ends"]) == 7
    assert told["outcome"]["turns"] == planned().outcome.turns
    assert told["holding_force"]["force"] > told["holding_force"]["capstan_force"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == NAMES
    with contextlib.redirect_stderr(io.StringIO()) as said:
        asked["on_plan"](planned())
    assert said.getvalue().startswith("hyperflex: a cast succeeds after ")
    assert said.getvalue().endswith(" degrees of the target\n")
    assert hf.read_motion(told["files"]["motion"]).breaks[-1] == pytest.approx(told["stop"], abs=5e-3)


def test_a_set_up_file_gives_rope_arm_limits_and_target(hyperflex, ready, tmp_path):
    peg, setup = hf.Peg(-0.83, -1.07, 0.04, 0.25), tmp_path / "setup.toml"
    hf.Setup(CABLE, hf.arm_swings(), hf.Arm(length=0.15), pegs=(peg,)).to_toml(setup)
    setup.write_text(setup.read_text() + "\n[limits]\nspeed = 4.0\ntorque = 3.0\n")
    asked = ready("winds")
    assert hyperflex("cast", setup, "-o", tmp_path / "out")[0] == 0
    assert (asked["rope"], asked["arm"], asked["target"]) == (CABLE, hf.Arm(length=0.15), peg)
    assert asked["limits"] == hf.MotorLimits(speed=4.0, torque=3.0)
    options = ("--speed", "5", "--mu", "0.5", "--arm-length", "0.2", "--target", "0", "1")
    assert hyperflex("cast", setup, *options, "-o", tmp_path / "out")[0] == 0
    assert (asked["target"], asked["arm"]) == (hf.Peg(0.0, 1.0, 0.04, 0.5), hf.Arm(length=0.2))
    assert asked["limits"] == hf.MotorLimits(speed=5.0, torque=3.0)


@pytest.mark.nightly
def test_what_an_earlier_plan_asked_for_is_asked_again_and_told(hyperflex, ready, tmp_path):
    asked = ready("winds")
    known = dataclasses.replace(planned().problem, clearance=0.02, criteria=hf.WindCriteria(contact=6.0))
    dataclasses.replace(planned(), problem=known).to_toml(tmp_path / "cast.toml")
    code, _, err = hyperflex("cast", tmp_path / "cast.toml", "-o", tmp_path / "out")
    assert (code, asked["clearance"], asked["contact"]) == (0, 0.02, 6.0)
    assert "was planned with --contact 6 --clearance 0.02, which is required again" in " ".join(err.split())
    options = ("--clearance", "0", "--contact", "0")
    code, _, err = hyperflex("cast", tmp_path / "cast.toml", *options, "-o", tmp_path / "out")
    assert (code, asked["clearance"], asked["contact"]) == (0, 0.0, 0.0)
    assert "required again" not in err
    assert (asked["turns"], asked["settle"]) == (1.25, 1.0)
    known = dataclasses.replace(planned().problem, criteria=hf.WindCriteria(turns=2.0, settle=0.0))
    dataclasses.replace(planned(), problem=known).to_toml(tmp_path / "cast.toml")
    code, _, err = hyperflex("cast", tmp_path / "cast.toml", "-o", tmp_path / "out")
    assert (code, asked["turns"], asked["settle"], asked["contact"]) == (0, 2.0, 0.0, 0.0)
    assert "was planned with --turns 2 --settle 0, which is required again" in " ".join(err.split())
    options = ("--turns", "1.25", "--settle", "1")
    code, _, err = hyperflex("cast", tmp_path / "cast.toml", *options, "-o", tmp_path / "out")
    assert (code, asked["turns"], asked["settle"]) == (0, 1.25, 1.0)
    assert "required again" not in err


@pytest.mark.nightly
def test_what_a_set_up_file_holds_beside_its_first_peg_are_obstacles(hyperflex, ready, tmp_path):
    floor, other = hf.Ground(0.0, -3.0), hf.Peg(1.5, 1.0, 0.1)
    hf.Setup(CABLE, arm=hf.Arm(length=0.105), pegs=(PEG, other, floor)).to_toml(tmp_path / "setup.toml")
    asked = ready("winds")
    assert hyperflex("cast", tmp_path / "setup.toml", "-o", tmp_path / "out")[0] == 0
    assert (asked["target"], asked["obstacles"]) == (PEG, (other, floor))
    options = ("--target", "0", "1", "--radius", "0.05")
    code, _, err = hyperflex("cast", tmp_path / "setup.toml", *options, "-o", tmp_path / "out")
    assert (asked["target"].x, asked["target"].radius, asked["obstacles"], code) == (0.0, 0.05, (other, floor), 0)
    assert f"--target moves the first of [pegs] from ({PEG.x:g}, {PEG.y:g}) m, where no obstacle is left" in " ".join(
        err.split()
    )


def test_a_torque_limit_of_the_arm_is_one_of_the_motor():
    weak = hf.Arm(length=0.105, torque_limit=0.5)
    assert hf.Problem(CABLE, weak, hf.MotorLimits()).limits == hf.MotorLimits(torque=0.5)
    assert hf.Problem(CABLE, weak, hf.MotorLimits(torque=0.2)).limits == hf.MotorLimits(torque=0.2)


def test_a_start_that_swings_is_told_not_to_be_used(hyperflex, ready, tmp_path):
    """In a set-up file; that of a plan for such a start is refused, since another start makes another throw."""
    ready("winds")
    hf.Setup(CABLE, arm=hf.Arm(length=0.105), pegs=(PEG,), q0=[0.1] * CABLE.n_links).to_toml(tmp_path / "setup.toml")
    code, _, err = hyperflex("cast", tmp_path / "setup.toml", "-o", tmp_path / "out")
    assert code == 0
    assert "q0 of" in err
    assert "begin with a rope that hangs at rest" in " ".join(err.split())
    swings = {"q0": (0.1,) * CABLE.n_links, "qd0": (0.0,) * CABLE.n_links, "side": -1}
    plan = dataclasses.replace(planned(), problem=dataclasses.replace(planned().problem, **swings))
    plan.to_toml(tmp_path / "cast.toml")
    code, _, err = hyperflex("cast", tmp_path / "cast.toml", "-o", tmp_path / "out")
    assert code == 2
    assert "was planned for a rope that swings at first" in " ".join(err.split())
    assert plan.notes()["start"] == "the rope swings, by q0 and qd0 of the plan"
    assert planned().notes()["start"] == "the rope hangs at rest"
    assert "The rope swings, in the state that the plan's file holds" in " ".join(CastReport(plan, None).story)


@pytest.mark.nightly
def test_the_file_of_a_plan_is_a_set_up_to_plan_again(hyperflex, rope_file, ready, tmp_path):
    asked = ready("winds")
    assert hyperflex(*arguments(rope_file, tmp_path / "out"))[0] == 0
    assert hyperflex("cast", tmp_path / "out" / "cast.toml", "-o", tmp_path / "again")[0] == 0
    assert asked["target"] == planned().target
    # The file also holds the verified run, whose rope is cut for the target; what is planned with is what was before.
    assert asked["rope"].n_links == planned().problem.rope.n_links
    assert asked["limits"] == planned().problem.limits


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "no rope is given"),
        ("ROPE", "--target and --radius are missing"),
        ("ROPE\n[limits]\npace = 3.0\n", "[limits] does not know this key: got 'pace'"),
        ("ROPE\n[wall]\nx = 1.0\n", "does not know this key: got 'wall'"),
        ("nonsense = 3\nROPE\n", "does not know this key: got 'nonsense'"),
    ],
)
def test_a_set_up_file_that_does_not_do_is_refused(hyperflex, tmp_path, content, words):
    hf.Setup(CABLE).to_toml(tmp_path / "plain.toml")
    plain = (tmp_path / "plain.toml").read_text()
    (tmp_path / "setup.toml").write_text("tol = 1e-5\n" + content.replace("ROPE", plain[plain.index("[rope]") :]))
    code, out, err = hyperflex("cast", tmp_path / "setup.toml", "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert words in err


def test_a_robust_plan_says_how_often_it_wins(hyperflex, rope_file, ready, tmp_path):
    asked = ready("misses", success_probability=SuccessProbability(30, 40))
    _, out, _ = hyperflex(*arguments(rope_file, tmp_path / "out", "--robust"))
    assert isinstance(asked["uncertainty"], Uncertainty)
    assert str(SuccessProbability(30, 40)) in " ".join(out.split())
    assert "typical of an identification: length 1 %" in " ".join(out.split())
    assert str(SuccessProbability(30, 40)) in (tmp_path / "out" / "report.html").read_text()
    assert files.read_toml(tmp_path / "out" / "cast.toml")["plan"]["success_probability"]["successes"] == 30


def test_what_identify_left_in_the_ropes_file_counts(hyperflex_json, ready, tmp_path):
    fit = {"parameters": ["friction:shared"], "covariance": [[1e-9]], "values": {}}
    files.write_toml(tmp_path / "fit.toml", {"rope": CABLE.table(), "identification": fit})
    asked = ready("misses", success_probability=SuccessProbability(30, 40))
    _, told = hyperflex_json(*arguments(tmp_path / "fit.toml", tmp_path / "out", "--robust"))
    assert asked["uncertainty"].posterior.covariance.tolist() == [[1e-9]]
    assert told["uncertainty"].startswith("friction by the covariance in the rope's file; typical")
    assert asked["uncertainty"].friction == 0.0


def test_a_plan_that_fails_has_a_code_of_its_own(hyperflex, rope_file, ready, tmp_path):
    ready("misses")
    code, out, _ = hyperflex(*arguments(rope_file, tmp_path / "out"))
    assert code == 4
    assert "does not touch the peg" in " ".join(out.split())
    assert {path.name for path in (tmp_path / "out").iterdir()} == NAMES - {"tug.png"}


def test_a_target_out_of_reach_comes_with_the_nearest_one_and_with_remedies(
    hyperflex, hyperflex_json, rope_file, tmp_path
):
    code, told = hyperflex_json(*arguments(rope_file, tmp_path / "out", target=("2.5", "0")))
    near = told["fallback"]
    assert (code, near.get("plan"), near["failed_plans"]) == (4, None, 0)
    x, y = near["target"]["x"], near["target"]["y"]
    assert near["distance"] == pytest.approx(((x - 2.5) ** 2 + y**2) ** 0.5)
    assert [text[:9] for text in told["remedies"]] == ["a rope of"]
    _, out, _ = hyperflex(*arguments(rope_file, tmp_path / "out", target=("2.5", "0")))
    page = (tmp_path / "out" / "report.html").read_text()
    for words in (f"x = {x:.4g} m", "no throw was planned for it", f"in reach with {told['remedies'][0]}"):
        assert words in " ".join(out.split())
        assert words in page


def test_a_target_out_of_reach_is_searched_for_if_one_insists(hyperflex_json, rope_file, ready, tmp_path):
    asked = ready("misses")
    hyperflex_json(*arguments(rope_file, tmp_path / "out", "--skip-feasibility", "--time-limit", "9.5"))
    assert (asked["skip_feasibility"], asked["time_limit"]) == (True, 9.5)


def test_a_plan_for_the_nearest_target_is_written(hyperflex, rope_file, ready, tmp_path):
    near = FallbackTarget(planned().target, 0.0712, planned(), 1)
    asked = ready("misses", fallback=near)
    code, out, _ = hyperflex(*arguments(rope_file, tmp_path / "out", "--fallback"))
    assert (code, asked["fallback"]) == (4, True)
    assert "Nearest target that works: x = -0.8338 m, y = -1.074 m, 7.12 cm away" in " ".join(out.split())
    assert {path.name for path in (tmp_path / "out").iterdir()} == NAMES - {"tug.png"} | {"nearest.toml"}
    assert planning.read_plan(tmp_path / "out" / "nearest.toml").target == planned().target
    back = planning.read_plan(tmp_path / "out" / "cast.toml")
    assert (back.fallback.plan.success, back.fallback.failed_plans) == (True, 1)


def test_ctrl_c_leaves_the_best_so_far(hyperflex, hyperflex_json, rope_file, ready, tmp_path):
    ready("misses", interrupted=True, moves=None, outcome=None, message="interrupted before any throw was verified")
    code, _, err = hyperflex(*arguments(rope_file, tmp_path / "out"))
    assert code == 130
    assert "interrupted before any throw" in err
    ready("misses", interrupted=True)
    code, told = hyperflex_json(*arguments(rope_file, tmp_path / "out"))
    assert (code, told["error"], told["interrupted"]) == (130, "interrupted", True)
    assert "the best plan so far" in told["message"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"report.html", "motion.csv", "cast.toml", "cast.nc"}


@pytest.mark.parametrize("when", ["tug", "figures"])
def test_ctrl_c_while_drawing_leaves_the_plan(hyperflex, hyperflex_json, rope_file, ready, tmp_path, monkeypatch, when):
    def stop(*_):
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise ValueError("a library made this of it")

    monkeypatch.setattr(
        *((planning.CastPlan, "measure_holding_force") if when == "tug" else (CastReport, "film")), stop
    )
    monkeypatch.setitem(_USUAL, signal.SIGINT, signal.getsignal(signal.SIGINT))  # whatever runs the tests has set
    ready("winds")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "tug.png").write_text("an earlier cast's")
    code, told = hyperflex_json(*arguments(rope_file, tmp_path / "out"))
    assert (code, told["error"], told["success"]) == (130, "interrupted", True)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"motion.csv", "cast.toml", "cast.nc"}
    assert sorted(told["files"]) == ["motion", "plan", "run"]
    code, out, err = hyperflex(*arguments(rope_file, tmp_path / "out"))
    assert (code, out) == (130, "")
    assert f"Written: {tmp_path / 'out' / 'motion.csv'}" in err
    assert "Missing: the page and its figures" in err


def test_a_folder_where_a_picture_shall_go_is_told_before_anything_is_written(hyperflex, rope_file, ready, tmp_path):
    ready("winds")
    (tmp_path / "out" / "course.png").mkdir(parents=True)
    code, _, err = hyperflex(*arguments(rope_file, tmp_path / "out"))
    assert code == 2
    assert "course.png is a folder" in err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["course.png"]


def test_a_throw_that_was_not_verified_has_no_numbers(hyperflex, hyperflex_json, rope_file, ready, tmp_path):
    for name, code in (("late", 4), ("stopped", 130)):
        plan = {"late": late, "stopped": stopped}[name]()
        ready(name)
        ended, told = hyperflex_json(*arguments(rope_file, tmp_path / name))
        assert ended == code
        assert told.get("outcome", {"n_links": 0})["n_links"] == 0
        assert "fallback" not in told
        assert files.read_table(tmp_path / name / "motion.csv").notes["not verified"] == plan.message
        assert hf.read_motion(tmp_path / name / "motion.csv").breaks[-1] == pytest.approx(told["stop"], abs=5e-3)
        _, out, err = hyperflex(*arguments(rope_file, tmp_path / name))
        words = " ".join(out.split())
        assert "not known" in words
        assert "strikes" not in words
        assert "the target itself is in reach" in words
        assert (TOO_LONG in words) == (name == "late")
        assert ("best plan so far" in err) == (name == "stopped")


def test_a_target_needs_two_numbers(hyperflex, rope_file, tmp_path):
    code, _, err = hyperflex("cast", "--rope", rope_file, "-o", tmp_path / "out", "--target", "-0.8")
    assert code == 2
    assert "Option '--target' requires 2 arguments. See hyperflex cast --help." in err


@pytest.mark.parametrize(
    ("target", "words"),
    [(("2.5", "0"), "out of reach"), (("0", "1"), "rule of thumb"), (("0.05", "0"), "arm"), (("0", "0"), "arm")],
)
def test_a_target_that_cannot_be_wound_is_told_at_once(hyperflex, rope_file, tmp_path, target, words):
    code, out, _ = hyperflex(*arguments(rope_file, tmp_path / "out", target=target))
    assert code == 4
    assert words in out
    assert ("--skip-feasibility" in out) == (words == "rule of thumb")  # for the others no search helps
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["report.html"]
    assert words in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("changes", "more", "words"),
    [
        ({"target": ("nan", "0")}, (), "peg x is not finite"),
        ({"target": ("0", "inf")}, (), "peg y is not finite"),
        ({"radius": "0"}, (), "peg radius"),
        ({}, ("--mu", "-1"), "peg mu"),
        ({}, ("--speed", "0"), "motor speed"),
        ({}, ("--acceleration", "0"), "motor acceleration"),
        ({}, ("--torque", "0"), "motor torque"),
        ({}, ("--arm-length", "0"), "--arm-length"),
        ({}, ("--time-budget", "0"), "--time-budget"),
        ({}, ("--time-limit", "0"), "--time-limit"),
        ({}, ("--rate", "0"), "--rate"),
        ({}, ("--holding-force", "-1"), "hold"),
        ({}, ("--turns", "0.5"), "turns are not those of a wound rope"),
        ({}, ("--settle", "11"), "settle is longer"),
        ({}, ("--settle", "nan"), "settle is not finite"),
        ({}, ("--seed", "-1"), "seed"),
        ({"target": ("0.5",)}, (), "--target"),
    ],
)
def test_bad_input_is_refused(hyperflex, rope_file, tmp_path, changes, more, words):
    code, out, err = hyperflex(*arguments(rope_file, tmp_path / "out", *more, **changes))
    assert (code, out) == (2, "")
    assert words in err
    assert [path.name for path in tmp_path.iterdir()] == ["rope.toml"]


def test_a_rope_of_one_link_is_refused(hyperflex, tmp_path):
    hf.Rope.uniform(length=2.0, mass=0.1, n_links=1, radius=0.002).to_toml(tmp_path / "one.toml")
    code, _, err = hyperflex(*arguments(tmp_path / "one.toml", tmp_path / "out"))
    assert code == 2
    assert "too few links" in err


def test_a_rope_with_the_printed_friction_is_refused(hyperflex, tmp_path):
    CABLE.replace(friction_model="printed").to_toml(tmp_path / "printed.toml")
    code, _, err = hyperflex(*arguments(tmp_path / "printed.toml", tmp_path / "out", "--time-budget", "5"))
    assert code == 2
    assert "need joint friction that acts on both links" in err


def test_a_file_in_the_way_is_told_before_the_search(hyperflex, rope_file, tmp_path):
    (tmp_path / "out").write_text("mine")
    code, _, err = hyperflex(*arguments(rope_file, tmp_path / "out"))
    assert code == 2
    assert "not a folder" in err
    assert (tmp_path / "out").read_text() == "mine"
