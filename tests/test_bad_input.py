"""Bad arguments to rope, arm, motion, set-up and simulate: the right class, the argument's name, and the value got."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import FileProblem, HyperflexError, InvalidInput

NAN, INF = float("nan"), float("inf")
Case = tuple[str, Callable[[], object], tuple[str, ...]]

THREE: dict[str, Any] = {"length": [0.1, 0.2, 0.3], "mass": [0.01, 0.02, 0.03]}
PUSH = hf.torque_profile([0.0, 1.0], [0.0, 1.0])
ROD = hf.Rope(length=[0.3, 0.3], mass=[0.1, 0.1], friction=1e-4)
CABLE: dict[str, Any] = {"length": 2.0, "mass": 0.125, "n_links": 5}


def rope(**changes: Any) -> hf.Rope:
    return hf.Rope(**{**THREE, **changes})


def cable(**changes: Any) -> hf.Rope:
    return hf.Rope.uniform(**{**CABLE, **changes})


def run(**changes: Any) -> hf.Trajectory:
    return hf.simulate(changes.pop("rope", cable()), changes.pop("motion", None), **{"duration": 0.1, **changes})


def case(name: str, call: Callable[[], object], *words: str) -> Any:
    return pytest.param(call, words, id=name)


ROPES = [
    case("NaN-length", lambda: rope(length=[0.1, NAN, 0.3]), "rope length[1]", "nan"),
    case("infinite-mass", lambda: rope(mass=[0.1, 0.1, INF]), "rope mass[2]", "inf"),
    case("negative-mass", lambda: rope(mass=[0.01, -0.02, 0.03]), "rope mass[1]", "-0.02", ">= 0"),
    case("zero-length", lambda: rope(length=[0.1, 0.0, 0.3]), "rope length[1]", "0.0", "> 0"),
    case("negative-inertia", lambda: rope(inertia=[1e-6, 1e-6, -1e-6]), "rope inertia[2]", "-1e-06"),
    case("negative-friction", lambda: rope(friction=-5e-4), "rope friction[0]", "-0.0005"),
    case("negative-dry-friction", lambda: rope(dry_friction=[0.0, -1.0, 0.0]), "rope dry_friction[1]", "-1.0"),
    case("negative-stiffness", lambda: rope(stiffness=-1.0), "rope stiffness[0]", "-1.0"),
    case("negative-drag", lambda: rope(drag=-1.0), "rope drag[0]", "-1.0"),
    case("no-bend", lambda: rope(max_bend=0.0), "rope max_bend[0]", "0.0"),
    case("NaN-rest-angle", lambda: rope(rest_angle=[0.0, 0.0, NAN]), "rope rest_angle[2]", "nan"),
    case("NaN-com", lambda: rope(com=[NAN, 0.1, 0.1]), "rope com[0]", "nan"),
    case("lengths-and-masses-differ", lambda: rope(mass=[0.1, 0.2]), "links", "'length': 3", "'mass': 2"),
    case("no-links", lambda: hf.Rope(length=[], mass=[]), "links", "'length': 0"),
    case("only-scalars", lambda: hf.Rope(length=0.1, mass=0.1), "links", "got {}"),
    case("matrix-of-lengths", lambda: rope(length=[[0.1, 0.2, 0.3]]), "rope length", "(1, 3)"),
    case("ragged-lengths", lambda: rope(length=[[0.1], [0.2, 0.3]]), "length"),
    case("text-for-lengths", lambda: rope(length="long"), "rope length", "'long'"),
    case("none-for-mass", lambda: rope(mass=None), "rope mass"),
    case("negative-tip-mass", lambda: rope(tip_mass=-0.5), "tip_mass", "-0.5"),
    case("NaN-tip-mass", lambda: rope(tip_mass=NAN), "tip_mass", "nan"),
    case("boolean-tip-mass", lambda: rope(tip_mass=True), "tip_mass", "True"),
    case("scalar-gravity", lambda: rope(gravity=-9.81), "gravity", "()"),
    case("three-gravity", lambda: rope(gravity=(0.0, 0.0, -9.81)), "gravity", "(3,)"),
    case("NaN-gravity", lambda: rope(gravity=(0.0, NAN)), "gravity[1]", "nan"),
    case(
        "unknown-friction-model", lambda: rope(friction_model="absolute"), "friction_model", "'absolute'", "'printed'"
    ),
    case("negative-radius", lambda: rope(radius=-1e-3), "radius", "-0.001"),
    case("link-without-inertia", lambda: rope(mass=[0.1, 0.0, 0.1]), "link 1", "inertia"),
    case("uniform-zero-links", lambda: cable(n_links=0), "n_links", "0", "from 1 to 100000"),
    case("uniform-slip-of-the-pen", lambda: cable(n_links=10**9), "n_links", "1000000000", "from 1 to 100000"),
    case("uniform-half-a-link", lambda: cable(n_links=2.5), "n_links", "2.5"),
    case("uniform-boolean-links", lambda: cable(n_links=True), "n_links", "True"),
    case("uniform-negative-length", lambda: cable(length=-2.0), "length", "-2.0"),
    case("uniform-text-mass", lambda: cable(mass="0.125 kg"), "mass", "'0.125 kg'"),
    case("uniform-negative-mass", lambda: cable(mass=-0.1), "mass", "-0.1"),
    case("uniform-infinite-friction", lambda: cable(friction=INF), "friction", "inf"),
    case("uniform-unknown-name", lambda: cable(damping=1e-3), "damping", "friction"),
    case("replace-negative-mass", lambda: cable().replace(mass=[-1.0] * 5), "rope mass[0]", "-1.0"),
    case("replace-unknown-name", lambda: cable().replace(eta=1.0), "eta", "friction"),
    case("replace-other-size", lambda: cable().replace(mass=[0.1, 0.1]), "links", "'mass': 2", "'length': 5"),
]

ARMS = [
    case("negative-length", lambda: hf.Arm(length=-0.1), "arm length", "-0.1"),
    case("NaN-length", lambda: hf.Arm(length=NAN), "arm length", "nan"),
    case("negative-inertia", lambda: hf.Arm(length=0.1, inertia=-1.0), "arm inertia", "-1.0"),
    case("infinite-mass", lambda: hf.Arm(length=0.1, mass=INF), "arm mass", "inf"),
    case("text-com", lambda: hf.Arm(length=0.1, com="middle"), "arm com", "'middle'"),
    case("negative-friction", lambda: hf.Arm(length=0.1, friction=-1e-3), "arm friction", "-0.001"),
    case("negative-dry-friction", lambda: hf.Arm(length=0.1, dry_friction=-1e-3), "arm dry_friction", "-0.001"),
    case("zero-torque-limit", lambda: hf.Arm(length=0.1, torque_limit=0.0), "arm torque_limit", "0.0"),
    case("NaN-torque-limit", lambda: hf.Arm(length=0.1, torque_limit=NAN), "arm torque_limit", "nan"),
    case("three-pivot", lambda: hf.Arm(length=0.1, pivot=(0.0, 0.0, 0.0)), "arm pivot", "(3,)"),
    case("NaN-pivot", lambda: hf.Arm(length=0.1, pivot=(0.0, NAN)), "arm pivot[1]", "nan"),
]

MOTIONS = [
    case("hold-NaN", lambda: hf.hold_arm(NAN), "angle", "nan"),
    case("hold-text", lambda: hf.hold_arm("up"), "angle", "'up'"),
    case("move-no-time", lambda: hf.move_arm(0.0, 1.0, 0.0), "duration", "0.0"),
    case("move-backwards-in-time", lambda: hf.move_arm(0.0, 1.0, -1.0), "duration", "-1.0"),
    case("move-to-infinity", lambda: hf.move_arm(0.0, INF, 1.0), "end", "inf"),
    case("move-from-NaN", lambda: hf.move_arm(NAN, 1.0, 1.0), "start", "nan"),
    case("move-unknown-profile", lambda: hf.move_arm(0.0, 1.0, 1.0, "sine"), "profile", "'sine'", "'bang-bang'"),
    case("move-long-ramp", lambda: hf.move_arm(0.0, 1.0, 1.0, "ramp", ramp=0.7), "ramp", "0.7"),
    case("move-no-ramp", lambda: hf.move_arm(0.0, 1.0, 1.0, "ramp", ramp=0.0), "ramp", "0.0"),
    case("swings-no-move", lambda: hf.arm_swings(t_move=0.0), "t_move", "0.0"),
    case("swings-negative-rest", lambda: hf.arm_swings(t_rest=-0.1), "t_rest", "-0.1"),
    case("swings-NaN-rest", lambda: hf.arm_swings(t_rest=NAN), "t_rest", "nan"),
    case("swings-unknown-profile", lambda: hf.arm_swings(profile="trapezoid"), "profile", "'trapezoid'", "'ramp'"),
    case("swings-unknown-path", lambda: hf.arm_swings(path="through"), "path", "'through'", "'over'"),
    case("swings-profile-not-text", lambda: hf.arm_swings(profile=3), "profile", "3"),
    case("sampled-unsorted", lambda: hf.sampled_motion([0.0, 2.0, 1.0], [0.0, 1.0, 2.0]), "t goes back", "[2.0, 1.0]"),
    case("sampled-repeated", lambda: hf.sampled_motion([0.0, 1.0, 1.0], [0.0, 1.0, 2.0]), "t repeats", "[1.0, 1.0]"),
    case("sampled-NaN-time", lambda: hf.sampled_motion([0.0, NAN, 1.0], [0.0, 1.0, 2.0]), "t[1]", "nan"),
    case("sampled-NaN-angle", lambda: hf.sampled_motion([0.0, 1.0], [0.0, NAN]), "angle[1]", "nan"),
    case("sampled-other-size", lambda: hf.sampled_motion([0.0, 1.0, 2.0], [0.0, 1.0]), "angle", "(2,)", "shape 3"),
    case("sampled-one-sample", lambda: hf.sampled_motion([0.0], [0.0]), "t has too few samples", "1", "at least 2"),
    case("sampled-empty", lambda: hf.sampled_motion([], []), "t has too few samples", "0"),
    case("sampled-matrix", lambda: hf.sampled_motion([[0.0, 1.0]], [[0.0, 1.0]]), "t has the wrong shape", "(1, 2)"),
    case("point-infinite-x", lambda: hf.moving_pivot([0.0, 1.0], [0.0, INF], [0.0, 0.0]), "x[1]", "inf"),
    case("point-other-size", lambda: hf.moving_pivot([0.0, 1.0], [0.0, 1.0], [0.0]), "y", "(1,)"),
    case("torque-NaN", lambda: hf.torque_profile([0.0, 1.0], [NAN, 0.0]), "torque[0]", "nan"),
    case("shift-NaN", lambda: hf.arm_swings().shifted(NAN), "delay", "nan"),
    case(
        "then-jumps", lambda: hf.hold_arm(0.0).then(hf.hold_arm(1.0), at=0.5), "arm angle jumps", "0.5 s", "[0.0, 1.0]"
    ),
    case("then-at-NaN", lambda: hf.hold_arm(0.0).then(hf.hold_arm(0.0), at=NAN), "nan"),
]

SETUPS = [
    case("no-duration", lambda: hf.Setup(rope=cable(), duration=0.0), "duration", "0.0"),
    case("NaN-duration", lambda: hf.Setup(rope=cable(), duration=NAN), "duration", "nan"),
    case("q0-of-another-rope", lambda: hf.Setup(rope=cable(), q0=np.zeros(4)), "q0", "(4,)", "shape 5"),
    case("infinite-qd0", lambda: hf.Setup(rope=cable(), qd0=[0, 0, INF, 0, 0]), "qd0[2]", "inf"),
    case("zero-tol", lambda: hf.Setup(rope=cable(), tol=0.0), "tol", "0.0"),
    case("unknown-method", lambda: hf.Setup(rope=cable(), method="euler"), "method", "'euler'", "'rk4'"),
    case("rk4-without-step", lambda: hf.Setup(rope=cable(), method="rk4"), "step", "rk4"),
    case("step-without-rk4", lambda: hf.Setup(rope=cable(), step=1e-4), "step", "0.0001"),
    case("arm-motion-without-arm", lambda: hf.Setup(rope=cable(), motion=hf.arm_swings()), "motion", "arm"),
    case("not-a-rope", lambda: hf.Setup(rope=2.0), "rope", "2.0"),
    case("not-a-motion", lambda: hf.Setup(rope=cable(), motion=[0.0, 1.0]), "motion", "[0.0, 1.0]"),
    case("not-an-arm", lambda: hf.Setup(rope=cable(), arm=0.105), "arm", "0.105"),
    case("motion-and-torque", lambda: hf.Setup(rope=cable(), arm=hf.Arm(), motion=hf.hold_arm(), torque=PUSH), "both"),
    case("torque-without-arm", lambda: hf.Setup(rope=cable(), torque=PUSH), "torque", "arm"),
]

RUNS = [
    case("no-duration", lambda: run(duration=0.0), "duration", "0.0"),
    case("negative-duration", lambda: run(duration=-1.0), "duration", "-1.0"),
    case("NaN-duration", lambda: run(duration=NAN), "duration", "nan"),
    case("infinite-duration", lambda: run(duration=INF), "duration", "inf"),
    case("text-duration", lambda: run(duration="10 s"), "duration", "'10 s'"),
    case("endless-outputs", lambda: run(duration=1e6), "1e+08", "t_eval"),
    case("times-before-the-start", lambda: run(t_eval=[-0.1, 0.05]), "t_eval", "-0.1"),
    case("times-after-the-end", lambda: run(t_eval=[0.0, 0.2]), "t_eval", "0.2"),
    case("unsorted-times", lambda: run(t_eval=[0.0, 0.05, 0.02]), "t_eval goes back", "[0.05, 0.02]"),
    case("repeated-times", lambda: run(t_eval=[0.0, 0.05, 0.05]), "t_eval repeats", "[0.05, 0.05]"),
    case("NaN-times", lambda: run(t_eval=[0.0, NAN]), "t_eval[1]", "nan"),
    case("no-times", lambda: run(t_eval=[]), "t_eval", "0"),
    case("q0-of-another-rope", lambda: run(q0=np.zeros(6)), "q0", "(6,)", "shape 5"),
    case("NaN-q0", lambda: run(q0=[0.0, 0.0, NAN, 0.0, 0.0]), "q0[2]", "nan"),
    case("infinite-qd0", lambda: run(qd0=[0.0, 0.0, 0.0, -INF, 0.0]), "qd0[3]", "-inf"),
    case("zero-tol", lambda: run(tol=0.0), "tol", "0.0"),
    case("NaN-tol", lambda: run(tol=NAN), "tol", "nan"),
    case("unknown-method", lambda: run(method="leapfrog"), "method", "'leapfrog'", "'extrapolation'"),
    case("rk4-without-step", lambda: run(method="rk4"), "step", "rk4"),
    case("negative-step", lambda: run(method="rk4", step=-1e-4), "step", "-0.0001"),
    case("arm-motion-without-arm", lambda: run(motion=hf.arm_swings()), "motion", "arm"),
    case("not-a-rope", lambda: run(rope=None), "rope"),
    case("not-a-motion", lambda: run(motion="swings"), "motion", "'swings'"),
    case("not-an-arm", lambda: run(arm=0.105), "arm", "0.105"),
    case("not-a-state", lambda: run(state=0.0), "state", "0.0"),
    case("torque-without-arm", lambda: run(torque=PUSH), "torque", "arm"),
]


def refuses(call: Callable[[], object], words: tuple[str, ...]) -> None:
    with pytest.raises(InvalidInput) as caught:
        call()
    text = str(caught.value)
    assert isinstance(caught.value, HyperflexError)
    assert isinstance(caught.value, ValueError)
    for word in words:
        assert word in text, f"{word!r} is not in: {text}"


@pytest.mark.parametrize(("call", "words"), ROPES)
def test_rope_refuses(call, words):
    refuses(call, words)


@pytest.mark.parametrize(("call", "words"), ARMS)
def test_arm_refuses(call, words):
    refuses(call, words)


@pytest.mark.parametrize(("call", "words"), MOTIONS)
def test_motion_refuses(call, words):
    refuses(call, words)


@pytest.mark.parametrize(("call", "words"), SETUPS)
def test_setup_refuses(call, words):
    refuses(call, words)


@pytest.mark.parametrize(("call", "words"), RUNS)
def test_simulate_refuses(call, words):
    refuses(call, words)


BAD_TABLES = {
    "other-columns": ("time,angle\n0,0\n1,1\n", "t,angle"),
    "third-column": ("t,angle,x\n0,0,0\n1,1,0\n", "t,angle"),
    "text": ("t,angle\n0,0\n1,one\n", "one"),
    "gap": ("t,angle\n0,0\n1,\n2,1\n", "angle"),
    "NaN": ("t,angle\n0,0\n1,nan\n2,1\n", "nan"),
    "unsorted": ("t,angle\n0,0\n2,1\n1,0\n", "goes back"),
    "repeated": ("t,angle\n0,0\n1,1\n1,0\n", "repeats"),
    "truncated-row": ("t,angle\n0,0\n1,1\n2\n", ""),
    "header-alone": ("t,angle\n", ""),
    "empty": ("", ""),
}


@pytest.mark.parametrize(("text", "word"), BAD_TABLES.values(), ids=BAD_TABLES.keys())
def test_motion_file_is_refused(tmp_path, text, word):
    path = tmp_path / "arm.csv"
    path.write_text(text)
    with pytest.raises(HyperflexError) as caught:
        hf.read_motion(path)
    assert word in str(caught.value)
    assert path.read_text() == text


BAD_SETUPS = {
    "no-rope": ("duration = 1.0\n", "rope"),
    "broken": ("[rope\nlength = 2.0\n", ""),
    "empty": ("", "empty"),
    "truncated": ("[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = ", ""),
    "unknown-key": ("durations = 1.0\n[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = 0.1\n", "durations"),
    "unknown-rope-key": ("[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = 0.1\ncolour = 3\n", "colour"),
    "rope-is-no-table": ("rope = 3\n", "rope"),
    "negative-mass": ("[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = -0.1\n", "-0.1"),
    "text-for-links": ('[rope]\nn_links = "five"\nlink_length = 0.4\nlink_mass = 0.1\n', "five"),
    "no-links": ("[rope]\nlink_length = 0.4\nlink_mass = 0.1\n", "n_links"),
    "unknown-motion": ('[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = 0.1\n[motion]\nkind = "shake"\n', "shake"),
    "motion-without-kind": ("[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = 0.1\n[motion]\nangle = 1.0\n", "kind"),
    "motion-with-other-keys": (
        '[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = 0.1\n[motion]\nkind = "hold"\nangel = 1.0\n',
        "angel",
    ),
    "unknown-arm-key": ("[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = 0.1\n[arm]\nlengths = 1.0\n", "lengths"),
    "NaN-duration": ("duration = nan\n[rope]\nn_links = 5\nlink_length = 0.4\nlink_mass = 0.1\n", "nan"),
}


@pytest.mark.parametrize(("text", "word"), BAD_SETUPS.values(), ids=BAD_SETUPS.keys())
def test_setup_file_is_refused(tmp_path, text, word):
    path = tmp_path / "setup.toml"
    path.write_text(text)
    with pytest.raises(HyperflexError) as caught:
        hf.Setup.from_toml(path)
    assert word in str(caught.value)


@pytest.mark.parametrize("read", [hf.read_motion, hf.Setup.from_toml, hf.Rope.from_toml])
def test_missing_file_is_named(tmp_path, read):
    path = tmp_path / "nowhere.x"
    with pytest.raises(FileProblem, match=r"nowhere\.x"):
        read(path)


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
    with pytest.raises(InvalidInput, match=words):
        call()


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
