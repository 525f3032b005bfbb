"""Bad arguments to rope, arm, motion, set-up and simulate: the right class, the argument's name, and the value got."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import FileProblem, HyperflexError, InvalidInput
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


def run(**changes: Any) -> hf.Trajectory:
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
    case("text-duration", lambda: run(duration="10 s"), "duration", "'10 s'"),
    case("endless-outputs", lambda: run(duration=1e6), "1e+08", "t_eval"),
    case("times-after-the-end", lambda: run(t_eval=[0.0, 0.2]), "t_eval", "0.2"),
    case("unsorted-times", lambda: run(t_eval=[0.0, 0.05, 0.02]), "t_eval goes back", "[0.05, 0.02]"),
    case("negative-step", lambda: run(step=-1e-4), "step", "-0.0001"),
    case("not-a-state", lambda: run(state=0.0), "state", "0.0"),
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
