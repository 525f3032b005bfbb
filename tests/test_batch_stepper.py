"""Members in lanes, step by step: each equals a single stepper, independent of its neighbours."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from tests.refusals import refuses

ARM = hf.Arm(length=0.1, inertia=1e-3, friction=2e-3)
DT, COUNT, N = 0.02, 20, 6
SIZES = {"acceleration": 20.0, "angle": 0.3, "torque": 0.2}


def ropes(dry: float = 0.0) -> list[hf.Rope]:
    sizes = np.linspace(0.6, 1.0, COUNT)
    return [hf.Rope.uniform(size, 0.06, N, radius=0.003, friction=3e-4, dry_friction=dry) for size in sizes]


def given(command: str, steps: int = 12) -> Array:
    return SIZES[command] * np.random.default_rng(0).uniform(-1.0, 1.0, (steps, COUNT))


def walk(stepper: hf.BatchStepper, state: hf.BatchState, commands: Array) -> hf.BatchState:
    for row in commands:
        state = stepper.step(state, row, DT)
    return state


@pytest.mark.parametrize("command", SIZES)
@pytest.mark.parametrize("dry", [0.0, 1e-3], ids=["viscous", "dry"])
def test_each_member_is_a_stepper(command, dry):
    """Two tolerances, and two methods: 1e-5 m a step, so some 1e-4 m after a dozen; the reference is at 1e-9 m."""
    each, commands = ropes(dry), given(command)
    batch = hf.BatchStepper(each, arm=ARM, command=command)
    start = batch.start(np.full(N, 0.4), arm_angle=0.1, arm_rate=np.linspace(-1.0, 1.0, COUNT))
    end = walk(batch, start, commands)
    assert set(end.status) == {"success"}
    for m in range(0, COUNT, 7):
        alone = hf.Stepper(each[m], arm=ARM, command=command, tol=1e-9)
        state = alone.start(np.full(N, 0.4), arm_angle=0.1, arm_rate=float(start.arm_rate[m]))
        for u in commands[:, m]:
            state = alone.step(state, u, DT)
        rope = {"arm": ARM, "arm_angle": state.arm_angle}
        places = hf.forward_kinematics(each[m], state.q, **rope)
        np.testing.assert_allclose(hf.forward_kinematics(each[m], end.q[m], **rope), places, rtol=0, atol=2e-4)
        assert end.arm_angle[m] == pytest.approx(state.arm_angle, abs=1e-4)
        assert end.arm_rate[m] == pytest.approx(state.arm_rate, abs=1e-2)
        assert end.work[m] == pytest.approx(state.work, abs=1e-3)
        assert end.t == pytest.approx(state.t)


@pytest.mark.parametrize("command", SIZES)
def test_a_step_depends_on_nothing_but_the_member(command):
    """Not on threads, neighbours, what was stepped in between, or a stay in a file."""
    each, commands = ropes(1e-3), given(command)
    batch = hf.BatchStepper(each, arm=ARM, command=command, threads=2)
    half = walk(batch, batch.start(), commands[:6])
    end = walk(batch, half, commands[6:])
    assert (half.memory != batch.start().memory).any(axis=1).all()
    batch.step(half, 0.3, 2.0 * DT)  # a branch
    again = walk(hf.BatchStepper(each, arm=ARM, command=command, threads=1), half, commands[6:])
    copied = walk(*pickle.loads(pickle.dumps((batch, half))), commands[6:])
    few = hf.BatchStepper(each[3:5], arm=ARM, command=command)
    part = walk(few, few.start(), commands[:, 3:5])
    for name in ("q", "qd", "arm_angle", "arm_rate", "work", "dissipated", "memory"):
        np.testing.assert_array_equal(getattr(again, name), getattr(end, name))
        np.testing.assert_array_equal(getattr(copied, name), getattr(end, name))
        np.testing.assert_array_equal(getattr(part, name), getattr(end, name)[3:5])


def test_a_member_that_fails_fails_alone():
    batch = hf.BatchStepper(ropes(), arm=ARM, threads=1)  # so that errstate holds in it
    start = walk(batch, batch.start(), given("acceleration", 2))
    wild = np.full(COUNT, 1.0)
    wild[4] = 1e99
    with np.errstate(all="ignore"):
        end, want = batch.step(start, wild, DT), batch.step(start, 1.0, DT)
        later = batch.step(end, 1.0, DT)
    others = np.arange(COUNT) != 4
    for state in (end, later):
        assert [m for m, word in enumerate(state.status) if word != "success"] == [4]
        assert np.isnan(state.q[4]).all()
    np.testing.assert_array_equal(end.q[others], want.q[others])
    np.testing.assert_array_equal(later.q[others], batch.step(want, 1.0, DT).q[others])


def test_bad_input_is_refused():
    each = ropes()
    refuses("members and ropes", hf.BatchStepper, each, members=3, arm=ARM)
    refuses("needs an arm", hf.BatchStepper, each)
    refuses("differ in links", hf.BatchStepper, [each[0], hf.Rope.uniform(1.0, 0.1, 3, friction=0.0)], arm=ARM)
    refuses("free flight", hf.BatchStepper, each[0].replace(max_bend=0.25), members=2, arm=ARM)
    batch = hf.BatchStepper(each[0], members=3, arm=ARM)
    refuses("commands has the wrong shape", batch.step, batch.start(), [1.0, 2.0], DT)
    refuses(r"commands\[1\]", batch.step, batch.start(), [1.0, np.nan, 2.0], DT)
    refuses("dt has the wrong sign", batch.step, batch.start(), 1.0, -DT)
    refuses("state q is not of this batch", batch.step, hf.BatchStepper(each, arm=ARM).start(), 1.0, DT)
    refuses("do not fit together", batch.start, np.zeros((2, N)))


def test_restarted_members_are_as_in_a_batch_of_their_own():
    each, others = ropes(1e-3), [rope.replace(friction=6e-4) for rope in ropes(1e-3)]
    batch = hf.BatchStepper(each, arm=ARM)
    state = walk(batch, batch.start(), given("acceleration", 4))
    wild = np.full(COUNT, 1.0)
    wild[2] = 1e99
    with np.errstate(all="ignore"):
        state = batch.step(state, wild, DT)
    which = np.isin(np.arange(COUNT), [2, 5])
    state = batch.restart(state, which, [others[2], others[5]], np.full(N, 0.3), arm_angle=[0.1, 0.2])
    assert set(state.status) == {"success"}
    end = batch.step(state, 1.0, DT)
    few = hf.BatchStepper([others[2], others[5]], arm=ARM)
    alone = few.step(few.start(np.full(N, 0.3), arm_angle=[0.1, 0.2], t=state.t), 1.0, DT)
    for name in ("q", "qd", "arm_angle", "work", "memory"):
        np.testing.assert_array_equal(getattr(end, name)[which], getattr(alone, name))
    rest = hf.BatchStepper(each, arm=ARM)
    np.testing.assert_array_equal(end.q[~which], rest.step(state, 1.0, DT).q[~which])
    refuses(
        "do not fit the members",
        batch.restart,
        state,
        [1],
        hf.Rope.uniform(1.0, 0.06, N + 1, radius=0.003, friction=0.0),
    )


def test_tips_are_those_of_steppers():
    each = ropes()
    batch = hf.BatchStepper(each, arm=ARM)
    state = walk(batch, batch.start(np.full(N, 0.4)), given("acceleration", 5))
    places, velocities = batch.tips(state)
    after = batch.tips(batch.step(state, 0.0, 1e-5))[0]
    np.testing.assert_allclose((after - places) / 1e-5, velocities, atol=1e-3)  # accelerations of some 100 m/s^2
    alone = hf.Stepper(each[3], arm=ARM)
    one = hf.State(state.t, state.q[3], state.qd[3], arm_angle=state.arm_angle[3], arm_rate=state.arm_rate[3])
    for found, want in zip(alone.tip(one), (places[3], velocities[3]), strict=True):
        np.testing.assert_allclose(found, want, rtol=0, atol=1e-12)


def test_states_that_no_member_can_begin_with_are_refused():
    stepper = hf.BatchStepper(ropes()[0], members=3, arm=ARM)
    state = stepper.step(stepper.start(), 1.0, 0.02)
    for name, value in (
        ("memory", np.zeros((3, 3))),
        ("memory", np.zeros(3)),
        ("codes", np.zeros(7, dtype=np.int64)),
        ("q", state.q.tolist()[:2]),
        ("arm_angle", np.array(["a", "b", "c"])),
        ("work", np.full(3, np.nan)),
        ("t", "a"),
    ):
        refuses(f"state {name}", stepper.step, replace(state, **{name: value}), 0.0, 0.02)
    refuses("state is no BatchState", stepper.tips, None)
    with pytest.raises(ValueError, match="read-only"):
        state.q[0] = 0.0


def test_a_restart_that_is_refused_changes_nothing():
    first, other = ropes()[0], ropes()[1]
    stepper = hf.BatchStepper(first, members=3, arm=ARM)
    state = stepper.start()
    with pytest.raises(InvalidInput):
        stepper.restart(state, [0], ropes=other, q0=np.zeros(first.n_links + 1))
    assert stepper.setups[0].rope is first
    for which in ([0.5], [9], [-1], [1, 1], 1, [True, False]):
        refuses("no members of the batch", stepper.restart, state, which)
    assert stepper.restart(state, []) is state
    assert stepper.restart(state, np.zeros(3, dtype=bool)) is state
    assert stepper.restart(state, np.array([True, False, True])).q.shape == state.q.shape
