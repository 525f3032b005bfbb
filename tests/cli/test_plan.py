"""``hyperflex cast``, ``whip``, ``insert``, ``reach-map``: what they read, plan and write, and what they refuse."""

import contextlib
import dataclasses
import html
import io
import json
import math
import signal
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files, planning
from hyperflex.errors import Interrupted
from hyperflex.identification import Grade
from hyperflex.interruption import _USUAL
from hyperflex.planning import NOT_PLANNED, FallbackTarget, SuccessProbability, Uncertainty
from hyperflex.planning.tasks.whip import verify_whip
from hyperflex.report import CastReport, PlanReport, WhipReport
from tests.planning import known_insert, known_whip
from tests.planning.known import CABLE, PEG, held, planned

PLACE = {"cast": ("--target", -0.83, -1.07), "whip": ("--target", 0.3, -0.9), "insert": ("--slot", 0.2, -0.9)}
MORE = {"cast": ("--radius", 0.04), "whip": (), "insert": ("--direction", -1)}
ROPES = {"cast": CABLE, "whip": known_whip.ROPE, "insert": known_insert.ROPE}
MADE = {"cast": planned, "whip": known_whip.planned_whip, "insert": known_insert.planned_insert}
FILES = {"report.html", "motion.csv"}
NAMES = {
    "cast": FILES | {"strike.png", "sideways.png", "cast.toml", "cast.nc"},
    "whip": FILES | {"peak.png", "passing.png", "whip.toml", "whip.nc"},
    "insert": FILES | {"entry.png", "gap.png", "insert.toml", "insert.nc"},
}
EACH = pytest.mark.parametrize("command", MADE)


@pytest.fixture
def given(tmp_path):
    """Return the words of a command: a rope's file, a target and a folder for the results."""

    def words(command, *more, place=None, rope=None):
        (rope or ROPES[command]).to_toml(tmp_path / "rope.toml")
        where = PLACE[command] if place is None else (PLACE[command][0], *place)
        return (command, "--rope", tmp_path / "rope.toml", *where, *MORE[command], "-o", tmp_path / "out", *more)

    return words


@pytest.fixture
def ready(monkeypatch):
    """Let a command get a finished plan; return the arguments of its planner."""
    asked = {}

    def plan(command, found=None, **changes):
        def give(rope, arm, target, limits, *, conditions, options, criteria=None, **others):
            asked.update(rope=rope, arm=arm, target=target, limits=limits, **others)
            for part in (conditions, options, criteria):
                asked.update(vars(part) if part else {})
            return replace(found or MADE[command](), **changes)

        monkeypatch.setattr(planning, f"plan_{command}", give)
        pull = held() if command == "cast" else None
        monkeypatch.setattr(planning.CastPlan, "measure_holding_force", lambda plan: pull if plan.success else None)
        return asked

    return plan


@pytest.fixture(autouse=True)
def unseen(monkeypatch):
    """Figures are made, but not turned into pixels, nor the run into a film: tests of reports and the demo do that."""
    monkeypatch.setattr("hyperflex.report.plan.png", lambda _: b"\x89PNG")
    monkeypatch.setattr("hyperflex.report.plan.player_html", lambda *_, **__: "<p>film</p>")


@pytest.fixture
def undrawn(monkeypatch):
    """Pages are without film and figures: what takes long, and is seen in other tests."""
    monkeypatch.setattr(PlanReport, "pictures", lambda _: {})


def written(folder):
    return {path.name for path in folder.iterdir()}


def plain(text):
    return " ".join(text.split())


# ---- options and set-up files


def test_options_of_a_cast_reach_the_planner(hyperflex_json, given, ready, tmp_path):
    asked = ready("cast")
    options = "--mu 0.4 --arm-length 0.2 --speed 5 --torque 2 --time-budget 7 --seed 3 --contact 6.28 --clearance 0.01 "
    options += "--turns 2 --settle 1.5 --time-limit 9.5 --skip-feasibility"
    code, told = hyperflex_json(*given("cast", *options.split()))
    want = {"rope": CABLE, "target": hf.Peg(-0.83, -1.07, 0.04, 0.4), "arm": hf.Arm(length=0.2), "uncertainty": None}
    want |= {"limits": hf.MotorLimits(speed=5.0, torque=2.0), "time_budget": 7.0, "seed": 3, "contact": 6.28}
    want |= {"clearance": 0.01, "turns": 2.0, "settle": 1.5, "time_limit": 9.5, "skip_feasibility": True}
    assert (code, {name: asked[name] for name in want}) == (0, want)
    plan = planned()
    assert (told["success"], told["source"], told["message"]) == (True, "simulated", "")
    assert (told["clearance"], len(told["moves"]["ends"])) == (plan.clearance, 7)
    assert told["outcome"]["contact_angle"] == plan.outcome.contact_angle
    assert told["holding_force"]["force"] > told["holding_force"]["capstan_force"]
    assert written(tmp_path / "out") == NAMES["cast"]
    with contextlib.redirect_stderr(io.StringIO()) as said:
        asked["on_plan"](plan)
    assert said.getvalue().startswith("hyperflex: a cast succeeds after ")
    assert hf.read_motion(told["files"]["motion"]).breaks[-1] == pytest.approx(told["stop"], abs=5e-3)


def test_a_whip_without_a_direction(hyperflex_json, given, ready, tmp_path):
    asked = ready("whip", known_whip.planned_whip(any_direction=True))
    code, told = hyperflex_json(*given("whip"))
    assert (code, asked["target"].any_direction, told["target"]["angle_tolerance"]) == (0, True, math.pi)
    plan = known_whip.planned_whip(any_direction=True)
    assert (told["outcome"]["miss"], told["impact"]["impulse"]) == (plan.outcome.miss, plan.impact().impulse)
    assert written(tmp_path / "out") == NAMES["whip"]
    assert "in any direction" in (tmp_path / "out" / "report.html").read_text()


def test_an_insertion_is_summed_up(hyperflex_json, given, ready, tmp_path):
    ready("insert")
    code, told = hyperflex_json(*given("insert"))
    chance = told["success_probability"]
    assert (code, told["success"]) == (0, True)
    assert told["outcome"]["depth"] == known_insert.planned_insert().outcome.depth
    assert (chance["successes"], chance["samples"]) == (45, 50)
    assert chance["interval"] == pytest.approx([0.786, 0.957], abs=1e-3)  # Wilson's, by hand
    assert written(tmp_path / "out") == NAMES["insert"]


TABLES = {  # of a set-up file: the table, other values for it, and options that say the same
    "cast": ("pegs", hf.Peg(-0.83, -1.07, 0.04, 0.25), {"x": 0.0, "y": 1.0, "mu": 0.5}),
    "whip": (
        "target",
        hf.TipTarget(0.3, -0.9, 0.5, 3.0, 0.2),
        {"x": 0.1, "y": -0.8, "direction": 0.4, "least_speed": 2.0, "angle_tolerance": 0.25},
    ),
    "insert": ("slot", known_insert.SLOT, {"tube": 0.06, "max_speed": 0.8, "touching": True}),
}


@EACH
@pytest.mark.usefixtures("undrawn")
def test_a_set_up_file_and_options_say_the_same(hyperflex, given, ready, tmp_path, command):
    name, target, other = TABLES[command]
    asked, path, out = ready(command), tmp_path / "setup.toml", tmp_path / "out"
    setup = files.loads_toml(hf.Setup(ROPES[command], arm=hf.Arm(length=0.15)).dumps())
    setup |= {"limits": {"speed": 4.0, "torque": 3.0}, name: dataclasses.asdict(target)}
    if command == "cast":  # a table of all pegs; what a peg does not have is no number of TOML
        setup[name] = {key: value for key, value in setup[name].items() if value is not None}
    files.write_toml(path, setup)
    assert hyperflex(command, path, "-o", out)[0] == 0
    assert (asked["rope"], asked["arm"], asked["target"]) == (ROPES[command], hf.Arm(length=0.15), target)
    assert asked["limits"] == hf.MotorLimits(speed=4.0, torque=3.0)
    words = [PLACE[command][0], other["x"], other["y"]] if "x" in other else []
    for key, value in other.items():
        if key not in "xy":
            words += [f"--{key.replace('_', '-')}", *([] if value is True else [value])]
    assert hyperflex(command, path, "-o", out, "--speed", 5, "--arm-length", 0.2, *words)[0] == 0
    assert (asked["target"], asked["arm"]) == (replace(target, **other), hf.Arm(length=0.2))
    assert asked["limits"] == hf.MotorLimits(speed=5.0, torque=3.0)
    files.write_toml(path, setup | {name: setup[name] | {"pace": 3.0}})
    code, _, err = hyperflex(command, path, "-o", out)
    assert (code, f"[{name}] does not know this key" in err) == (2, True)
    if command != "cast":  # a run leaves the target of a tip alone
        assert hf.simulate(hf.Setup.loads(files.dumps_toml(setup)), duration=0.01).success


@pytest.mark.usefixtures("undrawn")
def test_pegs_but_the_target_of_a_cast_are_obstacles(hyperflex, ready, tmp_path):
    floor, other = hf.Ground(0.0, -3.0), hf.Peg(1.5, 1.0, 0.1)
    hf.Setup(CABLE, arm=hf.Arm(length=0.105), pegs=(PEG, other, floor)).to_toml(tmp_path / "setup.toml")
    asked, words = ready("cast"), (tmp_path / "setup.toml", "-o", tmp_path / "out")
    assert hyperflex("cast", *words)[0] == 0
    assert (asked["target"], asked["obstacles"]) == (PEG, (other, floor))
    code, _, err = hyperflex("cast", *words, "--target", "0", "1", "--radius", "0.05")
    assert (asked["target"].x, asked["target"].radius, asked["obstacles"], code) == (0.0, 0.05, (other, floor), 0)
    assert f"--target moves the first of [[pegs]] from ({PEG.x:g}, {PEG.y:g}) m" in plain(err)
    asked = ready("whip")
    assert hyperflex("whip", *words, "--target", 0.3, -0.9)[0] == 0
    assert asked["obstacles"] == (PEG, other, floor)


@EACH
@pytest.mark.usefixtures("undrawn")
def test_the_file_of_a_plan_is_a_set_up_to_plan_again(hyperflex, given, ready, tmp_path, command):
    """It also contains the verified run, whose rope is divided for a peg; planning uses the original rope."""
    plan, asked = MADE[command](), ready(command)
    plan.to_toml(tmp_path / "plan.toml")
    assert hyperflex(command, tmp_path / "plan.toml", "-o", tmp_path / "out")[0] == 0
    assert (asked["target"], asked["rope"], asked["limits"]) == (plan.target, ROPES[command], plan.problem.limits)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("criteria", "clearance", "words"),
    [
        ({"contact": 6.0}, 0.02, "--contact 6 --clearance 0.02"),
        ({"turns": 2.0, "settle": 0.0}, planned().problem.clearance, "--turns 2 --settle 0"),
    ],
)
def test_criteria_of_an_earlier_plan_hold_unless_others_are_given(
    hyperflex, ready, tmp_path, criteria, clearance, words
):
    asked, path, out = ready("cast"), tmp_path / "cast.toml", tmp_path / "out"
    known = replace(planned().problem, clearance=clearance, criteria=hf.WindCriteria(**criteria))
    replace(planned(), problem=known).to_toml(path)
    code, _, err = hyperflex("cast", path, "-o", out)
    assert (code, asked["clearance"], {name: asked[name] for name in criteria}) == (0, clearance, criteria)
    assert f"was planned with {words}, which is required again" in plain(err)
    usual = {name: getattr(hf.WindCriteria(), name) for name in criteria} | {"clearance": 0.0}
    code, _, err = hyperflex("cast", path, "-o", out, *(w for key in usual for w in (f"--{key}", usual[key])))
    assert (code, {name: asked[name] for name in usual}, "required again" in err) == (0, usual, False)


@pytest.mark.usefixtures("undrawn")
def test_plans_that_do_not_fit_their_files_are_refused(hyperflex, ready, tmp_path):
    """A swinging start needs another throw; the inputs of the planner are listed below the obstacles."""
    ready("cast")
    hf.Setup(CABLE, arm=hf.Arm(length=0.105), pegs=(PEG,), q0=[0.1] * CABLE.n_links).to_toml(tmp_path / "setup.toml")
    code, _, err = hyperflex("cast", tmp_path / "setup.toml", "-o", tmp_path / "out")
    assert (code, "begin with a rope that hangs at rest" in plain(err)) == (0, True)
    swings = {"q0": (0.1,) * CABLE.n_links, "qd0": (0.0,) * CABLE.n_links, "side": -1}
    plan = replace(planned(), problem=replace(planned().problem, **swings))
    plan.to_toml(tmp_path / "cast.toml")
    code, _, err = hyperflex("cast", tmp_path / "cast.toml", "-o", tmp_path / "out")
    assert (code, "was planned for a rope that swings at first" in plain(err)) == (2, True)
    assert "The rope swings, in the state that the plan's file holds" in plain(" ".join(CastReport(plan, None).story))
    wall, plan, path = hf.Wall(0.5, -1.5, 0.5, -1.25), known_whip.planned_whip(), tmp_path / "whip.toml"
    asked, known = ready("whip"), replace(plan.problem, obstacles=(wall,))
    replace(plan, problem=known, outcome=verify_whip(known, plan.target, plan.motion, plan.outcome.t)).to_toml(path)
    assert hyperflex("whip", path, "-o", tmp_path / "out")[0] == 0
    assert asked["obstacles"] == (wall,)
    path.write_text(path.read_text().replace("-1.25", "-1.0", 1))
    code, _, err = hyperflex("whip", path, "-o", tmp_path / "out")
    assert (code, "is of a plan for other obstacles than it names" in plain(err)) == (2, True)


# ---- plans that fail, and what is written


@pytest.mark.parametrize(
    ("command", "made", "words", "lacks"),
    [
        ("cast", lambda: planned(winds=False), "does not touch the peg", {"sideways.png"}),
        ("whip", lambda: known_whip.planned_whip(meets=False), "misses the target by 30.0 mm", set()),
        ("whip", known_whip.far_whip, "out of reach: the rope ends 1.40 m short", NAMES["whip"] - {"report.html"}),
        ("insert", lambda: known_insert.planned_insert(enters=False), "touches a wall at", set()),
        ("insert", known_insert.far_insert, "the rope ends 0.15 m short", NAMES["insert"] - {"report.html"}),
    ],
)
def test_a_plan_that_fails_has_a_code_of_its_own(hyperflex, given, ready, tmp_path, command, made, words, lacks):
    ready(command, made())
    code, out, _ = hyperflex(*given(command))
    assert (code, words in plain(out)) == (4, True)
    assert written(tmp_path / "out") == NAMES[command] - lacks


@pytest.mark.parametrize(
    ("place", "words"), [((2.5, 0), "out of reach"), ((0, 1), "rule of thumb"), ((0.05, 0), "arm"), ((0, 0), "arm")]
)
def test_a_target_that_cannot_be_wound_is_reported_at_once(hyperflex, given, tmp_path, place, words):
    code, out, err = hyperflex(*given("cast", place=place))
    assert (code, words in out) == (4, True)
    assert "no arm is given, so the paper's is used, 0.105 m long" in plain(err)
    assert ("--skip-feasibility" in out) == (words == "rule of thumb")  # for the others no search helps
    assert written(tmp_path / "out") == {"report.html"}


@pytest.mark.usefixtures("undrawn")
def test_a_target_out_of_reach_comes_with_the_nearest_one_and_with_remedies(hyperflex, hyperflex_json, given, tmp_path):
    code, told = hyperflex_json(*given("cast", place=(2.5, 0)))
    near, x, y = told["fallback"], told["fallback"]["target"]["x"], told["fallback"]["target"]["y"]
    assert (code, near.get("plan"), near["failed_plans"]) == (4, None, 0)
    assert near["distance"] == pytest.approx(((x - 2.5) ** 2 + y**2) ** 0.5)
    assert [text[:9] for text in told["remedies"]] == ["a rope of"]
    _, out, _ = hyperflex(*given("cast", place=(2.5, 0)))
    page = (tmp_path / "out" / "report.html").read_text()
    for words in (f"x = {x:.4g} m", "no cast was planned for it", f"in reach with {told['remedies'][0]}"):
        assert words in plain(out)
        assert words in page


@EACH
@pytest.mark.usefixtures("undrawn")
@pytest.mark.filterwarnings("default:.*graded 'do not use'")
def test_a_rope_that_must_not_be_used_is_planned_with_a_warning(hyperflex, given, ready, tmp_path, command):
    ready(command)
    words = given(command, "--json")
    table = {"grade": Grade.DO_NOT_USE.value, "message": "The clock is wrong."}
    files.write_toml(tmp_path / "rope.toml", files.read_toml(tmp_path / "rope.toml") | {"identification": table})
    code, out, err = hyperflex(*words)
    told = "the identification of this rope is graded 'do not use'. The clock is wrong."
    assert code == 0
    assert told in err
    assert told in json.loads(out)["warnings"][0]
    assert told in html.unescape((tmp_path / "out" / "report.html").read_text("utf-8"))


def test_a_plan_for_the_nearest_target_is_written(hyperflex, given, ready, tmp_path):
    near = FallbackTarget(planned().target, 0.0712, planned(), 1)
    asked, out = ready("cast", planned(winds=False), fallback=near), tmp_path / "out"
    code, said, _ = hyperflex(*given("cast", "--fallback"))
    assert (code, asked["fallback"]) == (4, True)
    assert "Nearest target that works: x = -0.8338 m, y = -1.074 m, 7.12 cm away" in plain(said)
    assert written(out) == NAMES["cast"] - {"sideways.png"} | {"nearest.toml"}
    assert planning.read_plan(out / "nearest.toml").target == planned().target
    back = planning.read_plan(out / "cast.toml")
    assert (back.fallback.plan.success, back.fallback.failed_plans) == (True, 1)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("identified", [False, True])
def test_a_robust_plan_reports_how_often_it_succeeds(hyperflex, hyperflex_json, given, ready, tmp_path, identified):
    """With the covariance that identify left in the rope's file, or a typical one."""
    chance, out, words = SuccessProbability(30, 40), tmp_path / "out", given("cast", "--robust")
    asked = ready("cast", planned(winds=False), success_probability=chance)
    if identified:
        fit = {"parameters": ["friction:shared"], "covariance": [[1e-9]], "values": {}}
        files.write_toml(tmp_path / "rope.toml", {"rope": CABLE.table(), "identification": fit})
        told = hyperflex_json(*words)[1]["uncertainty"]
        assert told.startswith("friction by the covariance in the rope's file; typical")
        assert (asked["uncertainty"].posterior.covariance.tolist(), asked["uncertainty"].friction) == ([[1e-9]], 0.0)
        return
    said = plain(hyperflex(*words)[1])
    assert isinstance(asked["uncertainty"], Uncertainty)
    assert (str(chance) in said, "typical of an identification: length 1 %" in said) == (True, True)
    assert str(chance) in (out / "report.html").read_text()
    assert files.read_toml(out / "cast.toml")["plan"]["success_probability"]["successes"] == 30


# ---- Ctrl-C


@pytest.mark.parametrize(
    ("command", "changes", "lacks"),
    [
        ("cast", {}, {"strike.png", "course.png", "sideways.png", "tug.png"}),
        ("cast", {"moves": None, "outcome": None}, NAMES["cast"] - {"report.html"}),
        ("whip", {"outcome": None, "finer_outcome": None}, {"peak.png", "passing.png", "course.png", "whip.nc"}),
    ],
)
def test_ctrl_c_leaves_the_best_so_far(hyperflex_json, given, ready, tmp_path, command, changes, lacks):
    found = planned(winds=False) if command == "cast" else known_whip.planned_whip(meets=False)
    ready(command, found, interrupted=True, message="interrupted early", **changes)
    code, told = hyperflex_json(*given(command))
    assert (code, told["error"], told["interrupted"]) == (130, "interrupted", True)
    kept = "the page" if "moves" in changes else "the best plan so far"
    assert (kept in told["message"], "interrupted early" in told["message"]) == (True, True)
    assert written(tmp_path / "out") == NAMES[command] - lacks


@pytest.mark.parametrize("swallowed", [False, True])
@pytest.mark.parametrize(
    ("command", "place"),
    [
        ("cast", (planning.CastPlan, "measure_holding_force")),
        ("cast", (CastReport, "film")),
        ("whip", (planning.WhipPlan, "impact")),
        ("whip", (WhipReport, "figures")),
    ],
)
def test_ctrl_c_while_drawing_leaves_the_plan(
    hyperflex, hyperflex_json, given, ready, tmp_path, monkeypatch, command, place, swallowed
):
    def stop(*_):
        if not swallowed:
            raise KeyboardInterrupt
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise ValueError("a library made this of it")

    ready(command)
    monkeypatch.setattr(*place, stop)
    monkeypatch.setitem(_USUAL, signal.SIGINT, signal.getsignal(signal.SIGINT))  # whatever runs the tests has set
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("an earlier plan's")
    code, told = hyperflex_json(*given(command))
    assert (code, told["error"], told["success"]) == (130, "interrupted", True)
    assert written(tmp_path / "out") == {"motion.csv", f"{command}.toml", f"{command}.nc"}
    assert (sorted(told["files"]), told["missing"]) == (["motion", "plan", "run"], "the page and its figures")
    code, out, err = hyperflex(*given(command))
    assert (code, out, f"Written: {tmp_path / 'out' / 'motion.csv'}" in err) == (130, "", True)


# ---- what is refused


@pytest.mark.parametrize(
    ("command", "more", "words"),
    [
        ("cast", ("--target", "-0.8"), "Option '--target' requires 2 arguments. See hyperflex cast --help."),
        ("cast", ("--target", "-0.8,1", "2"), "got '-0.8,1 2'. Separate numbers by spaces. See hyperflex cast --help."),
        ("cast", ("--radius", 0), "peg radius"),
        ("cast", ("--time-limit", 0), "--time-limit"),
        ("whip", ("--direction", 30), "If these are degrees, give 0.5236"),
        ("whip", ("--angle-tolerance", 0, "--direction", 0), "--angle-tolerance"),
        ("whip", ("--angle-tolerance", 4, "--direction", 0), "--angle-tolerance is too large"),
        ("whip", ("--angle-tolerance", 15, "--direction", 0), "If these are degrees, give 0.2618"),
        ("whip", ("--angle-tolerance", "0.3"), "--angle-tolerance has no direction: got 0.3"),
        ("insert", ("--direction", 90), "more than a turn"),
        *((command, (option, 0), option) for command in MADE for option in ("--arm-length", "--time-budget", "--rate")),
    ],
)
def test_bad_options_are_refused(hyperflex, given, tmp_path, command, more, words):
    code, out, err = hyperflex(*given(command, *more))
    assert (code, out, words in plain(err)) == (2, "", True), err
    assert written(tmp_path) == {"rope.toml"}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "no rope is given, and --target and --radius are missing"),
        ("[pegs]\nx = 0.5\ny = -1.0\nradius = 0.04\n", "no rope is given. Give"),
        ("ROPE", "--target and --radius are missing"),
        ("ROPE\n[limits]\npace = 3.0\n", "[limits] does not know this key: got 'pace'"),
        ("ROPE\n[wall]\nx = 1.0\n", "does not know this key: got 'wall'"),
        ("nonsense = 3\nROPE\n", "does not know this key: got 'nonsense'"),
    ],
)
def test_a_set_up_file_without_a_rope_a_target_or_with_more_is_refused(hyperflex, tmp_path, content, words):
    text = hf.Setup(CABLE).dumps()
    (tmp_path / "setup.toml").write_text("tol = 1e-5\n" + content.replace("ROPE", text[text.index("[rope]") :]))
    code, out, err = hyperflex("cast", tmp_path / "setup.toml", "-o", tmp_path / "out")
    assert (code, out, words in err) == (2, "", True)
    known_insert.ROPE.to_toml(tmp_path / "rope.toml")
    given = ("insert", "--rope", tmp_path / "rope.toml", "-o", tmp_path / "out")
    assert "--slot and --direction are missing" in hyperflex(*given)[2]
    assert "--direction is missing" in hyperflex(*given, "--slot", "0.2", "-0.9")[2]


# ---- reach-map

POST, OTHER, FLOOR = hf.Peg(0.8, -1.1, 0.3, 0.4), hf.Peg(1.5, 1.0, 0.1), hf.Ground(0.0, -3.0)


@pytest.fixture
def posts(tmp_path):
    hf.Setup(CABLE, arm=hf.Arm(length=0.105), pegs=(POST, OTHER, FLOOR)).to_toml(tmp_path / "setup.toml")
    return ("reach-map", tmp_path / "setup.toml", "-o", tmp_path / "out")


def test_targets_of_a_map_are_like_the_first_peg_and_the_rest_are_obstacles(hyperflex_json, posts, tmp_path):
    code, told = hyperflex_json(*posts, "--cells", 1)
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
    assert written(tmp_path / "out") == {"reach-map.nc", "reach-map.png"}
    options = ("--cells", 1, "--radius", 0.4, "--mu", 0.1, "--contact", 6.28, "--turns", 0.75, "--settle", 2.5)
    found = hf.read_reach_map(hyperflex_json(*posts, *options)[1]["files"]["map"])
    criteria = found.problem.criteria
    assert (found.radius, found.mu, criteria.contact, criteria.turns, criteria.settle) == (0.4, 0.1, 6.28, 0.75, 2.5)


def test_an_interrupt_leaves_the_map_so_far_and_reports_it(hyperflex_json, posts, monkeypatch):
    whole = hf.build_reach_map(CABLE, hf.Arm(length=0.105), grid=planning.TargetGrid(x=[2.2, 2.4], y=[0.0]))

    def stopped(*_, **__):
        raise Interrupted(replace(whole, status=np.array([[1, NOT_PLANNED]])))

    monkeypatch.setattr(planning, "build_reach_map", stopped)
    code, told = hyperflex_json(*posts)
    assert (code, told["complete"], told["error"]) == (130, False, "interrupted")
    kept = hf.read_reach_map(told["files"]["map"])
    assert kept.status.tolist() == [[1, NOT_PLANNED]]
    assert "1 not planned: interrupted" in kept.plot().axes[0].get_title("left")
