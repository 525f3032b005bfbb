"""Bad arguments: the right class, the grammar of messages, the argument's name, the value got, and wrong units."""

import json
import pickle
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import checks, errors
from hyperflex.cli import output
from hyperflex.cli.app import run
from hyperflex.errors import FileProblem, HyperflexError, InvalidInput, located
from hyperflex.status import Status
from tests.refusals import fails, refuses

NAN, INF = float("nan"), float("inf")
Case = tuple[str, Callable[[], object], tuple[str, ...]]

THREE: dict[str, Any] = {"length": [0.1, 0.2, 0.3], "mass": [0.01, 0.02, 0.03]}
PUSH = hf.torque_profile([0.0, 1.0], [0.0, 1.0])
ROD = hf.Rope(length=[0.3, 0.3], mass=[0.1, 0.1], friction=1e-4)
CABLE: dict[str, Any] = {"length": 2.0, "mass": 0.125, "n_links": 5, "friction": 0.0}


def rope(**changes: Any) -> hf.Rope:
    return hf.Rope(**{**THREE, **changes})


def cable(**changes: Any) -> hf.Rope:
    return hf.Rope.uniform(**{**CABLE, **changes})


def simulated(**changes: Any) -> hf.Trajectory:
    return hf.simulate(changes.pop("rope", cable()), changes.pop("motion", None), **{"duration": 0.1, **changes})


def case(name: str, call: Callable[[], object], *words: str) -> Any:
    return pytest.param(call, words, id=name)


ROPES = [
    case("no-links", lambda: hf.Rope(length=[], mass=[]), "links", "'length': 0"),
    case("ragged-lengths", lambda: rope(length=[[0.1], [0.2, 0.3]]), "length"),
    case("none-for-mass", lambda: rope(mass=None), "rope mass"),
    case("boolean-tip-mass", lambda: rope(tip_mass=True), "tip_mass", "True"),
    case("three-gravity", lambda: rope(gravity=(0.0, 0.0, -9.81)), "gravity", "(3,)"),
    case(
        "unknown-friction-model", lambda: rope(friction_model="absolute"), "friction_model", "'absolute'", "'printed'"
    ),
    case("link-without-inertia", lambda: rope(mass=[0.1, 0.0, 0.1]), "link 1", "inertia"),
    case("uniform-zero-links", lambda: cable(n_links=0), "n_links", "0", "from 1 to 100000"),
    case("uniform-no-friction", lambda: cable(friction=None), "friction of the joints is missing", "0.0 for none"),
    case("uniform-unknown-name", lambda: cable(damping=1e-3), "damping", "friction"),
    case("replace-unknown-name", lambda: cable().replace(eta=1.0), "eta", "friction"),
]

ARMS = [
    case("negative-length", lambda: hf.Arm(length=-0.1), "arm length", "-0.1"),
    case("three-pivot", lambda: hf.Arm(length=0.1, pivot=(0.0, 0.0, 0.0)), "arm pivot", "(3,)"),
]

MOTIONS = [
    case("move-to-infinity", lambda: hf.move_arm(0.0, INF, 1.0), "end", "inf"),
    case("move-unknown-profile", lambda: hf.move_arm(0.0, 1.0, 1.0, "sine"), "profile", "'sine'", "'bang-bang'"),
    case("move-long-ramp", lambda: hf.move_arm(0.0, 1.0, 1.0, "ramp", ramp=0.7), "ramp", "0.7"),
    case("moves-many-rests", lambda: hf.arm_moves([0.0, 1.0], [0.1, 0.1, 0.1], [0.5]), "rests", "(3,)", "shape 2"),
    case("moves-no-rests", lambda: hf.arm_moves([0.0, 1.0], [], [0.5]), "rests", "(0,)", "shape 1"),
    case("swings-unknown-path", lambda: hf.arm_swings(path="through"), "path", "'through'", "'over'"),
    case("sampled-unsorted", lambda: hf.sampled_motion([0.0, 2.0, 1.0], [0.0, 1.0, 2.0]), "t goes back", "[2.0, 1.0]"),
    case("sampled-repeated", lambda: hf.sampled_motion([0.0, 1.0, 1.0], [0.0, 1.0, 2.0]), "t repeats", "[1.0, 1.0]"),
    case("sampled-other-size", lambda: hf.sampled_motion([0.0, 1.0, 2.0], [0.0, 1.0]), "angle", "(2,)", "shape 3"),
    case("sampled-one-sample", lambda: hf.sampled_motion([0.0], [0.0]), "t has too few samples", "1", "at least 2"),
    case("point-other-size", lambda: hf.moving_pivot([0.0, 1.0], [0.0, 1.0], [0.0]), "y", "(1,)"),
    case("shift-NaN", lambda: hf.arm_swings().shifted(NAN), "delay", "nan"),
    case(
        "then-jumps", lambda: hf.hold_arm(0.0).then(hf.hold_arm(1.0), at=0.5), "arm angle jumps", "0.5 s", "[0.0, 1.0]"
    ),
]

SETUPS = [
    case("q0-of-another-rope", lambda: hf.Setup(rope=cable(), q0=np.zeros(4)), "q0", "(4,)", "shape 5"),
    case("arm-motion-without-arm", lambda: hf.Setup(rope=cable(), motion=hf.arm_swings()), "motion", "arm"),
    case("not-a-motion", lambda: hf.Setup(rope=cable(), motion=[0.0, 1.0]), "motion", "[0.0, 1.0]"),
    case("motion-and-torque", lambda: hf.Setup(rope=cable(), arm=hf.Arm(), motion=hf.hold_arm(), torque=PUSH), "both"),
    case(
        "control-without-arm",
        lambda: hf.Setup(rope=cable(), torque=lambda *now: 0.0, control_rate=50.0),
        "torque",
        "arm",
    ),
]

RUNS = [
    case("text-duration", lambda: simulated(duration="10 s"), "duration", "'10 s'"),
    case("endless-outputs", lambda: simulated(duration=1e6), "1e+08", "t_eval"),
    case("times-after-the-end", lambda: simulated(t_eval=[0.0, 0.2]), "t_eval", "0.2"),
    case("unsorted-times", lambda: simulated(t_eval=[0.0, 0.05, 0.02]), "t_eval goes back", "[0.05, 0.02]"),
    case("negative-step", lambda: simulated(step=-1e-4), "step", "-0.0001"),
    case("not-a-state", lambda: simulated(state=0.0), "state", "0.0"),
]


@pytest.mark.parametrize(("call", "words"), [*ROPES, *ARMS, *MOTIONS, *SETUPS, *RUNS])
def test_a_bad_argument_is_named_with_its_value(call, words):
    with pytest.raises(InvalidInput) as caught:
        call()
    assert isinstance(caught.value, HyperflexError)
    assert isinstance(caught.value, ValueError)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("time,angle\n0,0\n1,1\n", "t,angle"),
        ("t,angle,x\n0,0,0\n1,1,0\n", "t,angle"),
        ("t,angle\n0,0\n1,\n2,1\n", "angle"),
    ],
)
def test_motion_file_is_refused(tmp_path, text, word):
    """For other columns, too many, and a gap; other faults of tables are those of all readers."""
    (tmp_path / "arm.csv").write_text(text)
    refuses(word, hf.read_motion, tmp_path / "arm.csv")


@pytest.mark.parametrize("read", [hf.read_motion, hf.Setup.from_toml, hf.Rope.from_toml])
def test_missing_file_is_named(tmp_path, read):
    path = tmp_path / "nowhere.x"
    fails(FileProblem, r"nowhere\.x", read, path)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: hf.simulate(ROD, arm=hf.Arm(), duration=0.1, arm_angle0=1.0), "no torque drives the arm"),
        (
            lambda: hf.simulate(ROD, duration=0.1, q0=[0.1, 0.1], state=hf.simulate(ROD, duration=0.1).state),
            "the start is given twice",
        ),
        (lambda: hf.simulate(ROD, duration=0.1, pegs=hf.Peg(1.0, 1.0, 0.1)), "a sequence of Peg"),
        (lambda: hf.Setup(ROD, pegs=(None,)), "a sequence of Peg"),
        (lambda: hf.Stepper(ROD, arm=hf.Arm(), pegs=hf.Peg(1.0, 1.0, 0.1)), "a sequence of Peg"),
        (lambda: hf.sensitivities(ROD, duration=0.1, wrt=None), "neither a name nor a mapping"),
    ],
)
def test_what_would_be_ignored_is_refused(call, words):
    refuses(words, call)


def test_a_stepper_begins_where_the_motion_of_its_setup_does():
    motion = hf.arm_swings(t_move=0.7, t_rest=0.5)
    start = hf.Stepper(hf.Setup(ROD, motion, hf.Arm())).start()
    assert start.arm_angle == motion.angle(0.0) != 0.0
    assert start.arm_rate == motion.rate(0.0)


def test_results_say_whether_they_succeeded():
    assert hf.simulate(ROD, duration=0.1).success
    batch = hf.simulate_batch([ROD, ROD], duration=0.1)
    assert batch.success
    assert batch.message == ""
    late = hf.simulate(ROD.replace(friction=0.0), duration=1e5, t_eval=[1e5], throw=False, time_budget=0.2)
    assert not late.success


CORD = hf.Rope.uniform(length=1.0, mass=0.06, n_links=2, radius=0.002, friction=1e-3)


def test_a_message_is_joined_of_its_parts():
    error = InvalidInput("mass is negative", got=-1.0, allowed="numbers >= 0", fix="Weigh it again")
    assert str(error) == "mass is negative: got -1.0. Allowed: numbers >= 0. Weigh it again."
    assert str(InvalidInput("mass is negative")) == "mass is negative."
    assert str(InvalidInput("nothing moves", got=0.0, fix="Is it on?")) == "nothing moves: got 0.0. Is it on?"
    assert str(InvalidInput("two", allowed="x.", fix="Do so.")) == "two. Allowed: x. Do so."  # no double full stop
    with pytest.raises(InvalidInput, match=r"^rope\.toml: two: got 1\. Allowed: one\.$"), located("rope.toml"):
        raise InvalidInput("two", got=1, allowed="one")
    assert str(InvalidInput("two", allowed="x0, y0, ..")) == "two. Allowed: x0, y0, .."
    refuses("Perhaps 'tol' is meant", checks.keys, "a set-up", ["tolerance"], ["tol", "torque"])
    long = str(InvalidInput("name " * 9000, got="a" * 9000, allowed="b" * 9000, fix="c" * 9000 + " and look"))
    assert len(long) < 2000
    assert long.endswith("c and look.")


@pytest.mark.parametrize(
    ("call", "advice"),
    [
        (
            lambda: hf.simulate(CORD, hf.arm_swings(), arm=0.2, duration=0.1),
            r"arm is no Arm: got 0\.2.*hyperflex\.Arm\(0\.2\)",
        ),
        (
            lambda: hf.simulate(CORD, np.zeros(9), arm=hf.Arm(), duration=0.1),
            r"motion is no Motion.*sampled_motion\(t, angle\)",
        ),
        (lambda: hf.Rope(1.0, 0.06), r"how many links.*Rope\.uniform"),
        (lambda: hf.Rope.uniform(1.0, 0.06, 30.5, friction=0.0), r"n_links is not a usable count: got 30\.5"),
        (lambda: hf.identify(CORD, hf.Recording(np.arange(9.0), np.zeros((9, 2)))), "A Rope is given: check the order"),
        (lambda: hf.Peg(0.5, -0.5, 0.04, friction=0.3), r"Peg\(\) does not know.*'friction'.*It belongs in mu="),
        (lambda: hf.Ground(0.0, -1.0, friction=0.3), "It belongs in mu="),
    ],
)
def test_the_error_for_a_wrong_type_states_how_to_make_the_right_one(call, advice):
    refuses(advice, call)


def test_what_is_plainly_meant_is_taken():
    """One angle for all links, of a run, a batch and a rope that is cut near a peg; 30.0 links."""
    assert hf.Rope.uniform(1.0, 0.06, 30.0, friction=0.0) == hf.Rope.uniform(1.0, 0.06, 30, friction=0.0)
    every, peg = np.full(2, 0.5), [hf.Peg(0.0, -0.8, 0.02)]
    for obstacles in ([], peg):
        one, other = (hf.simulate(CORD, duration=0.1, q0=q0, pegs=obstacles) for q0 in (0.5, every))
        np.testing.assert_array_equal(one.q, other.q)
        assert one.q.shape[1] > 2 or not obstacles
    batch = hf.simulate_batch([CORD] * 2, duration=0.1, q0=0.5)
    np.testing.assert_array_equal(batch.tip, hf.simulate_batch([CORD] * 2, duration=0.1, q0=every).tip)


@pytest.mark.parametrize(
    "error",
    [
        errors.SimulationError("too small", status=Status.STEP_TOO_SMALL, time=0.3),
        InvalidInput("mass is negative", got=-1.0, allowed="numbers >= 0", fix="Weigh it again"),
        *(
            kind("what was wrong")
            for kind in errors.HyperflexError.__subclasses__()
            if kind.__init__ is Exception.__init__
        ),
        errors.FileProblem("no space"),
        errors.MissingPackage("no package"),
    ],
    ids=lambda each: type(each).__name__,
)
def test_errors_come_back_from_another_process_as_they_were(error):
    """An error that cannot be unpickled breaks the pool of processes in which it is raised."""
    back = pickle.loads(pickle.dumps(error))
    assert (type(back), str(back), vars(back)) == (type(error), str(error), vars(error))
    assert pickle.loads(pickle.dumps(errors.Interrupted(lambda: 3))).partial == 3


ROPE = hf.Rope.uniform(length=0.9, mass=0.05, n_links=10, friction=0.0)
SLIPS: list[tuple[Callable[[], object], str]] = [
    (
        lambda: hf.Rope.uniform(length=900, mass=0.05, n_links=10, friction=0.0),
        "rope length is 900 m: is it meant in mm.*are 0.9",
    ),
    (
        lambda: hf.Rope.uniform(length=0.9, mass=50, n_links=10, friction=0.0),
        "mass over length is 55.5.*kg/m: is it meant in g/m",
    ),
    (lambda: hf.Arm(length=150), "arm length is 150 m: is it meant in mm.*are 0.15"),
    (lambda: hf.Peg(x=-800, y=-0.6, radius=0.03), "peg x is -800 m: is it meant in mm.*are -0.8"),
    (lambda: hf.TipTarget(x=0.3, y=-2050, direction=0.2), "target y is -2050 m: is it meant in mm"),
    (lambda: hf.arm_swings(t_move=730), "t_move is 730 s: is it meant in ms.*are 0.73"),
    (lambda: hf.move_arm(0.0, 90.0, 1.0), "arm angle is 90 rad: is it meant in degrees"),
    (lambda: hf.hold_arm(-90), "angle is -90 rad"),
    (lambda: hf.arm_moves([0.0, 90.0], [0.0], [1.0]), "angles is 90 rad"),
    (lambda: hf.MotorLimits(angles=(-180, 180)), "motor angles is -180 rad"),
    (lambda: hf.Setup(ROPE, q0=np.full(10, 90.0)), "q0 is 90 rad"),
]


@pytest.mark.parametrize(("call", "words"), SLIPS, ids=[words.split(":")[0] for _, words in SLIPS])
def test_a_value_off_by_a_unit_is_named_with_it(call, words):
    with pytest.warns(UserWarning, match=words) as told:
        call()
    assert told[0].filename == __file__


def test_real_large_ropes_and_arms_pass():
    """Warnings are errors in these tests."""
    assert hf.Rope.uniform(length=30.0, mass=60.0, n_links=30, radius=0.02, friction=0.0).total_length == pytest.approx(
        30.0
    )
    assert hf.Rope(length=[0.3], mass=[60.0]).mass[0] == 60.0  # masses in proportion, from angles alone
    assert hf.Arm(length=3.0).length == 3.0
    assert hf.move_arm(-4.0 * np.pi, 4.0 * np.pi, 60.0).breaks[-1] == 60.0


def test_limits_of_the_motor_belong_to_its_limits():
    for plan, name in ((hf.plan_cast, "torque"), (hf.plan_whip, "speed"), (hf.plan_insert, "acceleration")):
        refuses(rf"{name}.* belongs to limits=MotorLimits\(\.\.\.\)", plan, ROPE, hf.Arm(), None, **{name: 2.0})


def test_a_run_continues_from_many_turns():
    """As after a long rotation; a start at rest gives a question about its unit."""
    setup = hf.Setup(ROPE, arm=hf.Arm(), q0=np.full(10, 90.3), qd0=np.full(10, 12.0))
    assert setup.replace(duration=0.1).q0 is not None


def test_the_command_line_says_it_in_a_line(tmp_path, capsys):
    path = tmp_path / "long.toml"
    hf.Setup(ROPE, duration=0.1).to_toml(path)
    path.write_text(path.read_text().replace("link_length = 0.09", "link_length = 90.0"))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert run(["simulate", str(path), "--json", "-o", str(tmp_path / "long.nc")]) == 0
    told = capsys.readouterr()
    assert "hyperflex: rope length is 900 m: is it meant in mm? Give it in m; 900 mm are 0.9.\n" in told.err
    assert json.loads(told.out)


def test_the_command_line_says_it_once(capsys):
    show = output.warner()
    for text in ("a", "b", "a"):
        show(UserWarning(text), UserWarning, __file__, 1)
    assert capsys.readouterr().err == "hyperflex: a\nhyperflex: b\n"
