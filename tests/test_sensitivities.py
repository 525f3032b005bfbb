"""Derivatives of whole rollouts: against differences along a frozen step sequence, closed forms, and refusals."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.motion import motion_derivatives
from hyperflex.simulation import AngleJacobian
from tests import test_dry_sensitivities, test_torque_sensitivities
from tests.frozen import check
from tests.refusals import refuses

N, DURATION = 6, 1.6
# none at a switch, where the derivative is one-sided; some within the step behind one, which is sampled in its own way
TIMES = np.array([0.0, 0.05, 0.31, 0.366, 0.368, 0.5, 0.74, 0.9, 1.0, 1.2605, 1.3, 1.5, 1.6])


def rope(**changes: Any) -> hf.Rope:
    rng = np.random.default_rng(1)
    fields: dict[str, Any] = {
        "length": 1.0 / N * rng.uniform(0.6, 1.4, N),
        "mass": 0.06 / N * rng.uniform(0.6, 1.4, N),
        "friction": 1e-3 * rng.uniform(0.3, 2.0, N),
        "stiffness": 1e-2 * rng.uniform(0.1, 2.0, N),
        "rest_angle": rng.normal(0.0, 0.2, N),
        "tip_mass": 0.01,
        "gravity": (0.5, -9.81),
        "radius": 0.01,
    }
    made = hf.Rope(**fields)
    return made.replace(**changes) if changes else made


def setup(**changes: Any) -> hf.Setup:
    rng = np.random.default_rng(2)
    start = {"q0": rng.normal(0.0, 0.3, N), "qd0": rng.normal(0.0, 1.0, N)}
    swings = hf.arm_swings(profile="ramp", ramp=0.2)
    return replace(hf.Setup(rope(), swings, hf.Arm(), duration=DURATION, tol=1e-4, **start), **changes)


UNITS, T, X = np.eye(N), np.linspace(0.0, 1.1, 6), np.array([0.0, 0.1, 0.3, 0.2, 0.0, 0.1])
LINKS = ("length", "mass", "com", "inertia", "friction", "stiffness", "rest_angle")
RAMP: dict[str, Any] = {"profile": "ramp", "t_move": 0.73, "t_rest": 0.53, "ramp": 0.2}
BANG: dict[str, Any] = {"t_move": 0.33, "t_rest": 0.11}
JERK: dict[str, Any] = {"start": -0.5, "end": 1.0, "duration": 0.8, "profile": "minimum-jerk"}
Varied = Callable[[float], hf.Setup]


def started(name: str, link: int) -> Varied:
    return lambda x: setup(**{name: getattr(setup(), name) + x * UNITS[link]})


def roped(name: str, unit: Array, **others: Any) -> Varied:
    return lambda x: setup(rope=rope(**{name: getattr(rope(), name) + x * unit}), **others)


def moved(maker: Callable[..., hf.Motion], values: dict[str, Any], name: str) -> Varied:
    return lambda x: setup(motion=maker(**{**values, name: values[name] + x}))


# The varied quantity, its set-ups, and a spacing; a switch moves by some tens of spacings, and must stay
# far from outputs and neighbours.
WAYS: list[tuple[str, Varied, float]] = [
    *((f"{name}[{link}]", started(name, link), 1e-3) for name in ("q0", "qd0") for link in (0, N - 1)),
    *((f"{name}[2]", roped(name, UNITS[2]), 0.02 * abs(getattr(rope(), name)[2])) for name in LINKS[:-1]),
    ("rest_angle[2]", roped("rest_angle", UNITS[2]), 0.02),
    ("tip_mass", lambda x: setup(rope=rope(tip_mass=0.01 + x)), 2e-4),
    *((f"gravity[{k}]", roped("gravity", np.eye(2)[k]), 0.02) for k in range(2)),
    *((f"gravity[{k}]", roped("gravity", np.eye(2)[k], q0=None), 0.02) for k in range(2)),  # turns the rest
    ("arm.length", lambda x: setup(arm=hf.Arm(length=0.105 + x)), 1e-3),
    *((f"motion.{name}", moved(hf.arm_swings, RAMP, name), 2e-5) for name in ("t_move", "t_rest", "ramp")),
    *((f"motion.{name}", moved(hf.arm_swings, BANG, name), 2e-5) for name in BANG),
    *((f"motion.{name}", moved(hf.move_arm, JERK, name), 1e-3) for name in ("start", "end")),
    ("motion.duration", moved(hf.move_arm, JERK, "duration"), 2e-5),
    ("motion.delay", lambda x: setup(motion=hf.arm_swings().shifted(0.1 + x)), 2e-5),
    ("motion.y[2]", lambda x: setup(motion=hf.moving_pivot(T, X, X + x * UNITS[2]), arm=None), 1e-3),
]


@pytest.mark.parametrize(("name", "make", "size"), WAYS, ids=[name for name, *_ in WAYS])
def test_each_name(name, make, size):
    check(make, name, size)


def test_a_longer_rest_after_the_last_move_ends_the_motion_later():
    breaks, coef = motion_derivatives(hf.arm_moves([0.0, 1.0], [0.1, 0.4], [0.5]), "rests[1]")
    assert breaks.tolist() == [0.0, 0.0, 0.0, 0.0, 1.0]
    assert not coef.any()


def test_own_direction():
    def cable(radius):
        return rope(inertia=rope().mass * (3.0 * radius**2 + rope().length ** 2) / 12.0)

    way = {"radius": {"inertia": 0.5 * rope().mass * 0.05}}
    check(lambda x: setup(rope=cable(0.05 + x)), way, 1e-3)


def test_rope_parameter_of_all_links_is_the_sum_over_links():
    it = hf.sensitivities(setup(), t_eval=TIMES, wrt=["friction", "friction[:]", "length", "length[:]"])
    assert it.names == (
        "friction",
        *(f"friction[{i}]" for i in range(N)),
        "length",
        *(f"length[{i}]" for i in range(N)),
    )
    for shared, first in ((0, 1), (N + 1, N + 2)):
        for values in (it.dq, it.dqd, it.dtip):
            total = values[:, :, first : first + N].sum(axis=2)
            # sums of N numbers, each to rounding over some hundred steps
            np.testing.assert_allclose(values[:, :, shared], total, rtol=1e-9, atol=1e-9 * np.abs(total).max())


DRY, DRIVEN = test_dry_sensitivities.setup(5), test_torque_sensitivities.setup()
PREPARED: dict[str, tuple[hf.Setup, list[str], list[hf.Rope]]] = {  # of each set-up: what is varied, and other ropes
    "a led arm": (setup(), ["friction", "q0[0]", "motion.t_rest"], [rope(friction=2e-3)]),
    "joints that stick": (
        DRY,
        ["dry_friction", "friction[2]", "q0[0]"],
        [DRY.rope.replace(dry_friction=part * DRY.rope.dry_friction) for part in (0.3, 0.0)],
    ),
    "a driven arm": (DRIVEN, ["arm.inertia", "dry_friction"], []),
}


@pytest.mark.parametrize(("it", "names", "others"), PREPARED.values(), ids=PREPARED.keys())
def test_states_are_those_of_the_run_and_prepared_slopes_take_another_rope(it, names, others):
    times, arm = np.linspace(0.0, it.duration, 57), int(it.torque_driven)
    whole, run = hf.sensitivities(it, t_eval=times, wrt=names), hf.simulate(it, t_eval=times)
    for name in ("q", "qd", "tip", *(("arm_angle", "arm_rate") * arm)):
        # the same steps; between them accelerations come from the lanes: rounding
        np.testing.assert_allclose(getattr(whole, name), getattr(run, name), rtol=0.0, atol=1e-11)
    slopes = AngleJacobian(it, names)
    for cable in (*others, it.rope):
        whole = hf.sensitivities(replace(it, rope=cable), t_eval=times, wrt=names)
        found = slopes(times, *it.start(), cable)
        for one, two in zip(found, (whole.q, whole.qd, whole.dq, whole.dqd), strict=True):
            np.testing.assert_array_equal(one[:, arm:], two)  # an arm that a torque drives comes first
        assert np.abs(found[2]).max() > 0.0
    if arm:
        np.testing.assert_array_equal(found[0][:, 0], whole.arm_angle)
        np.testing.assert_array_equal(found[1][:, 0], whole.arm_rate)
        np.testing.assert_array_equal(found[3][:, 0], whole.darm_rate)


@pytest.mark.parametrize("name", ["length[1]", "motion.t_move", "arm.length", "q0[0]"])
def test_tip(name):
    def make(x):
        base, unit = rope(), np.eye(N)[1]
        if name == "length[1]":
            return setup(rope=base.replace(length=base.length + x * unit))
        if name == "arm.length":
            return setup(arm=hf.Arm(length=0.105 + x))
        if name == "q0[0]":
            return setup(q0=setup().q0 + x * np.eye(N)[0])
        return setup(motion=hf.arm_swings(t_move=0.73 + x, profile="ramp", ramp=0.2))

    tips = [hf.simulate(replace(make(x), tol=1e-11), t_eval=TIMES).tip for x in (1e-4, -1e-4)]
    want = (tips[0] - tips[1]) / 2e-4
    got = hf.sensitivities(replace(make(0.0), tol=1e-11), t_eval=TIMES, wrt=name).dtip[:, :, 0]
    # runs that choose their own steps: their errors, some 1e-10 m, over the spacing, and its square times a third
    # derivative of some hundreds
    np.testing.assert_allclose(got, want, rtol=0.0, atol=2e-5 * np.abs(want).max())


BAD: dict[str, tuple[Any, str]] = {
    "unknown": ("frict", "friction"),
    "link too far": (f"friction[{N}]", "friction"),
    "parameter of the motion": ("motion.speed", "t_rest"),
    "nothing": ([], "q0"),
    "a number": ([3.0], "q0"),
    "twice": (["friction", "friction"], "once"),
    "own": ({"a": {"weight": 1.0}}, "mass"),
    "own shape": ({"a": {"mass": [1.0, 2.0]}}, "shape 6"),
}


@pytest.mark.parametrize(("wrt", "word"), BAD.values(), ids=BAD.keys())
def test_what_cannot_be_used_is_refused_with_what_can(wrt, word):
    refuses(word, hf.sensitivities, setup(), wrt=wrt)


def test_what_has_no_derivative_is_refused():
    refuses(r"wrt is empty.*Say what.*wrt='friction'", hf.sensitivities, setup(), wrt=[])
    refuses("extrapolation", hf.sensitivities, setup(step=1e-5), wrt="q0")
    joined = hf.arm_swings().then(hf.arm_swings(), at=2.52)
    refuses("breaks and coef", hf.sensitivities, setup(motion=joined), wrt="motion.t_rest")
    refuses("without a rest", hf.sensitivities, setup(motion=hf.arm_swings(t_rest=0.0)), wrt="motion.t_rest")
