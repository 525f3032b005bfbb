"""A run taken interval by interval: the same as in one go, its derivatives those of dense algebra, no hidden state."""

import copy
import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE, TORQUE
from hyperflex.errors import InvalidInput, SimulationError
from tests.reference import dense, stick
from tests.reference.arm import Stretch, cast, integrate, links_of
from tests.refusals import refuses

ARM = hf.Arm(length=0.1, inertia=1e-3, mass=0.2, com=0.05, friction=2e-3, pivot=(0.05, -0.1))
DT = 1 / 30  # s
COMMANDS = ("acceleration", "angle", "torque")
EACH = pytest.mark.parametrize("command", COMMANDS)


def rope(n: int = 6, **changes: Any) -> hf.Rope:
    values: dict[str, Any] = {"length": 0.8, "mass": 0.06, "n_links": n, "radius": 0.003, "friction": 4e-4}
    return hf.Rope.uniform(**values | changes)


def commands(command: str, count: int, seed: int = 0) -> Array:
    """Commands that turn the arm by a radian or two in a second."""
    rng = np.random.default_rng(seed)
    if command == "angle":
        return np.cumsum(rng.uniform(-0.15, 0.25, count))
    return rng.uniform(-1.0, 1.0, count) * {"acceleration": 25.0, "torque": 0.3}[command]


def motion(command: str, given: Array, angle: float = 0.0, rate: float = 0.0) -> dict[str, hf.Motion]:
    """The commands as one motion, or one torque, derived independently from their documentation."""
    coef = np.zeros((given.size, 4, 6))
    for piece, u in zip(coef, given, strict=True):
        if command == "torque":
            piece[TORQUE, 0] = u
        elif command == "acceleration":
            piece[ANGLE, :3] = angle, rate, 0.5 * u
            angle, rate = angle + DT * (rate + 0.5 * DT * u), rate + DT * u
        else:  # the cubic through both ends, by its four conditions
            mean = (u - angle) / DT
            s = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1, DT, DT**2, DT**3], [0, 1, 2 * DT, 3 * DT**2]])
            piece[ANGLE, :4] = np.linalg.solve(s, [angle, rate, u, mean])
            angle, rate = u, mean
    whole = hf.Motion(DT * np.arange(given.size + 1), coef, np.ones(given.size + 1, dtype=np.bool_))
    return {"torque" if command == "torque" else "motion": whole}


def walk(stepper: hf.Stepper, state: hf.State, given: Array) -> list[hf.State]:
    states = []
    for u in given:
        state = stepper.step(state, u, DT)
        states.append(state)
    return states


def vector(state: hf.State) -> Array:
    return np.concatenate([[state.arm_angle], state.q, [state.arm_rate], state.qd])


@EACH
@pytest.mark.parametrize("dry", [0.0, 2e-3], ids=["viscous", "dry"])
def test_steps_are_those_of_a_single_run(command, dry):
    """It takes the very steps that a run with these switches takes: only rounding differs."""
    cable, given = rope(dry_friction=dry), commands(command, 30)
    states = walk(stepper := hf.Stepper(cable, arm=ARM, command=command), stepper.start(), given)
    times = DT * np.arange(1, given.size + 1)
    run = hf.simulate(cable, arm=ARM, duration=times[-1], t_eval=times, **motion(command, given))
    np.testing.assert_allclose([s.t for s in states], times, rtol=0, atol=1e-12)
    for name, tol in (("q", 1e-9), ("qd", 1e-7)):
        np.testing.assert_allclose([getattr(s, name) for s in states], getattr(run, name), rtol=0, atol=tol)
    np.testing.assert_allclose([s.arm_angle for s in states], run.arm_angle, rtol=0, atol=1e-9)
    np.testing.assert_allclose([s.arm_rate for s in states[:-1]], run.arm_rate[:-1], rtol=0, atol=1e-7)
    np.testing.assert_allclose([s.work for s in states], run.motor_work, rtol=0, atol=1e-9)
    np.testing.assert_allclose([s.dissipated for s in states], run.dissipated_energy, rtol=0, atol=1e-9)
    if dry:
        assert any((np.diff(s.qd) == 0.0).any() for s in states), "no joint ever stuck"


@pytest.mark.parametrize("command", ["acceleration", "torque"])
def test_near_a_peg_a_run_in_steps_is_a_run(command):
    """Contact steps are cut elsewhere: the two agree far within the accuracy of such steps, here 0.02 and 3 mm."""
    cable = rope(12, friction=2e-3)
    peg = hf.Peg(0.05, -0.5, 0.03, mu=0.3)
    given = np.repeat({"acceleration": [12.0, -6.0], "torque": [0.25, 0.1]}[command], 8)
    q0 = np.full(12, 0.6)
    stepper = hf.Stepper(cable, arm=ARM, command=command, pegs=[peg], refine=False)
    states = walk(stepper, stepper.start(q0), given)
    times = DT * np.arange(1, given.size + 1)
    run = hf.simulate(
        cable, arm=ARM, duration=times[-1], t_eval=times, q0=q0, pegs=[peg], refine=False, **motion(command, given)
    )
    assert np.abs(run.contact_force).max() > 0.1, "it never touched"
    assert "contact_mode" in states[-1].checkpoint
    places = np.array([hf.forward_kinematics(cable, s.q, arm=ARM, arm_angle=s.arm_angle) for s in states])
    np.testing.assert_allclose(places, run.joints, rtol=0, atol=2e-4)
    for k in (7, 9, 13):  # forces of contacts are in the state, too
        for copied in (pickled, copy.deepcopy):
            again = walk(*copied((stepper, states[k])), given[k + 1 :])
            np.testing.assert_array_equal(vector(again[-1]), vector(states[-1]))


@pytest.mark.parametrize("pegs", [(), (hf.Peg(0.05, -0.5, 0.03, mu=0.3),)], ids=["free", "peg"])
def test_a_torque_callback_is_a_stepper(pegs):
    cable, q0 = rope(12, friction=2e-3), np.full(12, 0.6)

    def control(t, angle, rate, q, qd):
        return 0.3 - 0.1 * angle - 0.02 * rate + 0.05 * q[-1]

    run = hf.simulate(
        cable, arm=ARM, torque=control, control_rate=30.0, duration=0.5, q0=q0, t_eval=[0.5], pegs=pegs, refine=False
    )
    stepper = hf.Stepper(cable, arm=ARM, command="torque", pegs=pegs, refine=False)
    state = stepper.start(q0)
    for _ in range(15):
        u = control(state.t, state.arm_angle or 0.0, state.arm_rate or 0.0, state.q, state.qd)
        state = stepper.step(state, u, DT)
    np.testing.assert_allclose(state.q, run.q[-1], rtol=0, atol=1e-8 if not pegs else 1e-5)
    assert state.arm_angle == pytest.approx(run.arm_angle[-1], abs=1e-8 if not pegs else 1e-5)


def reference(command: str, cable: hf.Rope) -> Callable[[Array, float], Array]:
    """An interval by dense algebra and scipy: from x = (arm angle, q, arm rate, qd) and u to x."""
    links, n = links_of(cable), cable.n_links

    def by_acceleration(x: Array, u: float) -> Array:
        stretch = Stretch(0.0, DT, x[0], x[n + 1], u)
        y = cast(links, ARM.length, [stretch], x[1 : n + 1], x[n + 2 :])[-1]
        angle, rate, _ = stretch.at(DT)
        return np.concatenate([[angle], y[:n], [rate], y[n:]])

    own = {"length": ARM.length, "mass": ARM.mass, "com": ARM.com, "inertia": ARM.inertia, "viscous": ARM.friction}
    own |= {"dry": 0.0, "stiffness": 0.0, "rest": 0.0}
    both = links._replace(**{name: np.append(value, getattr(links, name)) for name, value in own.items()})

    def by_torque(x: Array, u: float) -> Array:
        def rate(_: float, y: Array) -> Array:
            alpha = dense.accelerations(both, y[: n + 1], y[n + 1 :], np.zeros(7), torque=u, dtype=float).alpha
            return np.concatenate([y[n + 1 :], alpha])

        return integrate(rate, x, 0.0, DT, 1e-12, 1e-12)

    return by_torque if command == "torque" else by_acceleration


def differences(step: Callable[[Array, float], Array], x: Array, u: float, size: float = 1e-4) -> tuple[Array, Array]:
    by_x = [(step(x + size * e, u) - step(x - size * e, u)) / (2.0 * size) for e in np.eye(x.size)]
    return np.stack(by_x, axis=1), ((step(x, u + size) - step(x, u - size)) / (2.0 * size))[:, None]


@pytest.mark.parametrize(("command", "dry"), [("acceleration", 0.0), ("acceleration", 1e-3), ("torque", 0.0)])
def test_derivatives_are_those_of_dense_algebra(command, dry):
    """Central differences of 1e-4 err by some 1e-8 of third derivatives that are a hundred times as large."""
    cable = rope(3, dry_friction=dry, stiffness=2e-3)
    rng = np.random.default_rng(1)
    x, u = np.concatenate([rng.uniform(-1.0, 1.0, 4), rng.uniform(-4.0, 4.0, 4)]), 0.2
    stepper = hf.Stepper(cable, arm=ARM, command=command, tol=1e-11)
    state = stepper.start(x[1:4], x[5:], arm_angle=x[0], arm_rate=x[4])
    found = stepper.linearize(state, u, DT)
    a, b = differences(reference(command, cable), x, u)
    np.testing.assert_allclose(vector(found.state), reference(command, cable)(x, u), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.A, a, rtol=0, atol=2e-6 * np.abs(a).max())
    np.testing.assert_allclose(found.B, b, rtol=0, atol=2e-6 * max(1.0, np.abs(b).max()))
    np.testing.assert_array_equal(found.state.q, stepper.step(state, u, DT).q)


@pytest.mark.parametrize(("rate", "dry"), [(1.2, 0.01), (0.5, 0.05)], ids=["it comes to rest", "it sticks already"])
def test_derivatives_go_through_a_joint_that_sticks(rate, dry):
    """A little rate given to a joint that sticks is stopped at once, and momentum is kept."""
    cable, u = rope(3, dry_friction=[0.0, dry, 0.0], friction=1e-3), 3.0
    q, qd = np.array([0.3, 0.5, 0.4]), np.array([0.5, rate, 0.2])
    x = np.concatenate([[0.2], q, [0.4], qd])
    stepper = hf.Stepper(cable, arm=ARM, tol=1e-11)
    found = stepper.linearize(stepper.start(q, qd, arm_angle=0.2, arm_rate=0.4), u, DT)
    assert found.state.qd[1] == found.state.qd[0], "joint 1 does not stick at the end"
    end = stick.integrate(  # the reference agrees that it sticks there
        links_of(cable), lambda t: Stretch(0.0, DT, 0.2, 0.4, u).base(t, ARM.length), 0.0, DT, q, qd, 1e-12
    )[0]
    assert end[4] == pytest.approx(end[3], abs=1e-12)
    a, b = differences(reference("acceleration", cable), x, u, 1e-5)
    # what a rate of 1e-5 rad/s still turns a joint by before it stops goes with its square
    np.testing.assert_allclose(found.A, a, rtol=0, atol=1e-5 * np.abs(a).max())
    np.testing.assert_allclose(found.B, b, rtol=0, atol=1e-5)


def test_derivatives_of_an_angle_command_are_those_of_differences():
    stepper = hf.Stepper(rope(4), arm=ARM, command="angle", tol=1e-11)
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.uniform(-1.0, 1.0, 5), rng.uniform(-4.0, 4.0, 5)])

    def step(x, u):
        return vector(stepper.step(stepper.start(x[1:5], x[6:], arm_angle=x[0], arm_rate=x[5]), u, DT))

    found = stepper.linearize(stepper.start(x[1:5], x[6:], arm_angle=x[0], arm_rate=x[5]), x[0] + 0.1, DT)
    a, b = differences(step, x, x[0] + 0.1)
    np.testing.assert_allclose(found.A, a, rtol=0, atol=1e-5 * np.abs(a).max())
    np.testing.assert_allclose(found.B, b, rtol=0, atol=1e-5 * np.abs(b).max())


@EACH
@pytest.mark.parametrize("dry", [0.0, 2e-3], ids=["viscous", "dry"])
def test_a_step_depends_on_its_arguments_alone(command, dry):
    cable, given = rope(dry_friction=dry), commands(command, 12)
    stepper = hf.Stepper(cable, arm=ARM, command=command)
    states = walk(stepper, stepper.start(), given)
    stepper.step(states[2], 3.0 * given[5], 0.7 * DT)  # a branch
    stepper.linearize(states[8], given[1], 0.1)
    saved = pickled(states[5])
    for other in (stepper, hf.Stepper(cable, arm=ARM, command=command), pickled(stepper), copy.deepcopy(stepper)):
        again = walk(other, saved, given[6:])
        assert all(np.array_equal(vector(a), vector(b)) for a, b in zip(again, states[6:], strict=True))
        assert all(
            np.array_equal(a.checkpoint["clock"], s.checkpoint["clock"]) for a, s in zip(again, states[6:], strict=True)
        )


def test_a_run_continues_in_steps_and_steps_in_a_run():
    cable, given = rope(), commands("acceleration", 12)
    whole = motion("acceleration", given)["motion"]
    run = hf.simulate(cable, whole, arm=ARM, duration=6 * DT, t_eval=[6 * DT])
    state = run.state
    assert (state.arm_angle, state.arm_rate) == (whole.angle(state.t), whole.rate(state.t))
    stepper = hf.Stepper(cable, arm=ARM)
    state = walk(stepper, state, given[6:9])[-1]
    end = hf.simulate(cable, whole, arm=ARM, duration=12 * DT - state.t, state=state, t_eval=[12 * DT])
    want = hf.simulate(cable, whole, arm=ARM, duration=12 * DT, t_eval=[12 * DT], tol=1e-9)
    # the default tolerance: 1e-5 m a step, over a link of 0.13 m
    np.testing.assert_allclose(end.q[-1], want.q[-1], rtol=0, atol=1e-3)
    assert np.abs(end.q[-1] - run.q[-1]).max() > 0.05


@EACH
def test_a_state_that_was_changed_counts_as_it_is(command):
    """A filter corrects angles and rates: what was saved with the old ones is forgotten."""
    stepper = hf.Stepper(rope(), arm=ARM, command=command)
    state = walk(stepper, stepper.start(), commands(command, 5))[-1]
    for change in ({"q": state.q + 0.1}, {"qd": state.qd + 1.0}, {"arm_angle": 0.3, "arm_rate": 0.1}, {"t": 7.0}):
        changed = replace(state, **change)
        plain = replace(changed, checkpoint={})
        one, two = stepper.step(changed, 0.1, DT), stepper.step(plain, 0.1, DT)
        np.testing.assert_allclose(vector(one), vector(two), rtol=0, atol=1e-4)  # another step may be tried first
        assert one.t == changed.t + DT
        assert "t" in change or np.abs(vector(one) - vector(stepper.step(state, 0.1, DT))).max() > 1e-3


def test_bad_input_is_refused():
    cable = rope()
    refuses("command is not known", hf.Stepper, cable, arm=ARM, command="speed")
    refuses("needs an arm", hf.Stepper, cable)
    stepper = hf.Stepper(cable, arm=ARM)
    state = stepper.start()
    for arguments, words in (
        ((state, np.nan, DT), "command is not finite"),
        ((state, "fast", DT), "command is not a number"),
        ((state, 1.0, 0.0), "dt has the wrong sign"),
        ((vector(state), 1.0, DT), "state is no State"),
        ((replace(state, q=np.zeros(3)), 1.0, DT), "state q has the wrong shape"),
        ((replace(state, qd=np.full(6, np.nan)), 1.0, DT), "state qd"),
    ):
        refuses(words, stepper.step, *arguments)
    with pytest.raises(InvalidInput, match="state q has the wrong shape"):
        stepper.step(hf.Stepper(rope(4), arm=ARM).step(hf.Stepper(rope(4), arm=ARM).start(), 0.0, DT), 0.0, DT)
    beside = hf.Stepper(cable, arm=ARM, pegs=[hf.Peg(0.05, -0.5, 0.03)], refine=False)
    refuses("inside an obstacle", beside.step, beside.start(), 0.0, DT)
    refuses("free flight", beside.linearize, beside.start(np.full(6, 1.2)), 0.0, DT)


def test_a_step_that_fails_reports_it_and_leaves_nothing_behind():
    stepper = hf.Stepper(rope(), arm=ARM)
    state = stepper.step(stepper.start(), 5.0, DT)
    want = stepper.step(state, 5.0, DT)
    with np.errstate(all="ignore"), pytest.raises(SimulationError, match="stopped at"):
        stepper.step(state, 1e99, DT)
    np.testing.assert_array_equal(vector(stepper.step(state, 5.0, DT)), vector(want))


def test_a_state_changed_by_hand_is_checked_like_a_start():
    """Inside a peg or past a limit: refused, although the state comes from a step; its gap is still reported."""
    cable = rope()
    stepper = hf.Stepper(cable, arm=ARM, pegs=[hf.Peg(0.267, -0.65, 0.03)], refine=False)
    state = stepper.step(stepper.start(), 0.0, DT)
    inside = replace(state, q=np.full(6, 0.45))
    assert stepper.gap(inside) < -0.01 < 0.0 < stepper.gap(state)
    assert stepper.gap(replace(stepper.start(), q=np.full(6, 0.45))) < -0.01
    refuses("starts inside an obstacle", stepper.step, inside, 0.0, DT)
    limited = hf.Stepper(cable.replace(max_bend=0.2), arm=ARM)
    state = limited.step(limited.start(), 0.0, DT)
    refuses("past a limit", limited.step, replace(state, q=np.array([0.0, 0.0, 0.8, 0.8, 0.8, 0.8])), 0.0, DT)


def test_energies_and_steps_of_a_state_count_when_they_are_replaced():
    stepper = hf.Stepper(rope(), arm=ARM)
    state = stepper.step(stepper.start(), 1.0, DT)
    after = stepper.step(state, 0.0, DT)
    assert stepper.step(replace(state, work=100.0), 0.0, DT).work == pytest.approx(100.0 + after.work - state.work)
    for name, value in (("step", math.nan), ("step", -1.0), ("work", math.nan), ("arm_angle", math.nan), ("t", "a")):
        refuses(f"state {name}", stepper.step, replace(state, **{name: value}), 0.0, DT)
    refuses("state is no State", stepper.tip, None)
    with pytest.raises(ValueError, match="read-only"):
        state.q[0] = 1.0


@pytest.mark.parametrize("command", ["torque", "acceleration", "angle"])
def test_a_state_goes_from_one_kind_of_command_to_another(command):
    """Angles, rates and the arm's state are kept; the integrator's memory of the other chain is not."""
    run = hf.simulate(rope(), hf.hold_arm(0.3), arm=ARM, duration=0.2, q0=np.full(6, 0.3))
    stepper = hf.Stepper(rope(), arm=ARM, command=command)
    begin = run.state
    for _ in range(2):
        after = stepper.step(begin, 0.3 if command == "angle" else 0.0, 1e-3)
        assert after.arm_angle == pytest.approx(0.3, abs=1e-3)
        np.testing.assert_allclose(after.q, begin.q + 1e-3 * begin.qd, atol=2e-4)
        begin = hf.Stepper(rope(), arm=ARM, command="torque").step(run.state, 0.0, 1e-9)


def pickled(given: Any) -> Any:
    return pickle.loads(pickle.dumps(given))
