"""Dry joint friction in the contact stepper: statics, free flight as its limit, energy with pegs."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.core.chain.drive import segment
from hyperflex.core.contact.arrays import AFTER, IMPULSE, OPEN, RUBBED
from hyperflex.core.contact.joints import BEND_RATE
from hyperflex.core.contact.memory import new_contact_memory, save_memory, save_trend
from hyperflex.core.contact.run import new_contact_workspace, try_step
from hyperflex.model import DEFAULT_TOL
from hyperflex.simulation.contact import COARSE_TOL
from tests.core.helpers import rise, scene_of
from tests.reference.random_throws import draw

FAR = hf.Peg(50.0, 50.0, 0.05)


@pytest.mark.parametrize("n", [1, 8])
def test_a_rope_whose_joints_stick_holds_a_load_up_to_the_torque_of_its_first_joint(n):
    """It hangs straight; a force F across its tip gives a moment F times the length beyond a joint, largest at the
    first one."""
    rope = hf.Rope.uniform(0.8, 0.05, n, friction=0.0, dry_friction=4e-3)
    limit, link = 4e-3 / 0.8, 0.8 / n

    def creep(load):  # rad/s, of regularized friction
        return BEND_RATE * link * load / np.sqrt(1.0 - load**2)

    held = hf.simulate(rope, duration=2.0, pegs=[FAR], tip_force=(0.98 * limit, 0.0), refine=False)
    back = 0.05 * 9.81 * 0.4 * held.q[-1, 0] / 4e-3  # gravity's moment over the friction
    # Friction misses its law by 1e-3 at most, and the rate by 20 times as much, so near to the limit.
    assert held.qd[-1, 0] == pytest.approx(creep(0.98 - back), rel=0.05)
    assert np.abs(held.q[:, 0]).max() < 1.1 * 2.0 * creep(0.98)
    assert held.attrs["contact_unsolved"] == 0
    moved = hf.simulate(rope, duration=2.0, pegs=[FAR], tip_force=(1.1 * limit, 0.0), refine=False)
    # 10 % of the torque swings it about the angle at which it would hang so, once, and then friction holds it there.
    swung = 2.0 * 0.1 * 4e-3 / (0.05 * 9.81 * 0.4)
    assert 0.99 * swung < moved.q[-1, 0] < 1.01 * swung + 2.0 * creep(0.91)
    # The first joint alone comes loose: the others bear less.
    bends = np.abs(np.diff(moved.q, axis=1))
    assert bends.max(initial=0.0) < 1.1 * 2.0 * creep(1.1 * 0.7 / 0.8)


def test_far_from_pegs_the_contact_stepper_converges_to_free_flight():
    """A force too small to be felt keeps the rope in the contact stepper; its error halves with the step, at least."""
    rope = hf.Rope.uniform(1.0, 0.06, 6, friction=1e-3, dry_friction=3e-3)
    how = {"duration": 0.8, "q0": np.full(6, 1.2), "t_eval": np.linspace(0.1, 0.8, 8)}
    free = hf.simulate(rope, tol=1e-8, **how)
    errors = []
    for step in (2e-3, 1e-3, 5e-4):
        run = hf.simulate(rope, pegs=[FAR], refine=False, contact_step=step, tip_force=(1e-15, 0.0), tol=1e-4, **how)
        assert run.attrs["free_flights"] == 0
        errors.append(float(np.abs(run.tip - free.tip).max()))
        assert run.dissipated_energy[-1] == pytest.approx(free.dissipated_energy[-1], rel=0.1 * step)
    assert errors[0] < 1e-4
    assert errors[1] < 0.65 * errors[0]
    assert errors[2] < 0.65 * errors[1]


def test_a_joint_that_sticks_flies_on_as_stuck():
    """A rope as stiff as a stick is swung against a peg and off it: impacts bend it, and nothing else does."""
    rope = hf.Rope.uniform(0.6, 0.04, 6, 0.0025, friction=1e-4, dry_friction=np.append(0.0, np.full(5, 5.0)))
    run = hf.simulate(
        rope,
        hf.arm_swings(t_move=0.3, t_rest=0.4),
        arm=hf.Arm(length=0.1),
        duration=1.5,
        pegs=[hf.Peg(0.15, -0.4, 0.02, 0.2)],
        refine=False,
    )
    assert run.attrs["free_flights"] > 1
    assert run.contact_loss[-1] > 0.0
    bends = np.diff(run.q, axis=1)
    assert np.abs(bends).max() < 1e-2  # friction is finite, and an impact has no time
    still = np.abs(np.diff(bends, axis=0)).max(axis=1) < 1e-13  # as free flight holds them, to rounding
    assert still[run.t[1:] > 0.9].mean() > 0.5
    assert rise(run.energy_error) < 1e-5


def test_in_a_coarse_run_near_pegs_a_rope_with_dry_friction_takes_contact_steps_everywhere():
    rope = hf.Rope.uniform(1.0, 0.05, 20, 0.003, friction=2e-4, dry_friction=5e-5)
    swings = hf.arm_swings(t_move=0.4, t_rest=0.1)
    how = {"arm": hf.Arm(length=0.15), "duration": 1.0, "t_eval": np.linspace(0.0, 1.0, 21), "refine": False}
    exact = hf.simulate(rope, swings, tol=1e-8, **how)
    near = how | {"pegs": [FAR]}
    assert hf.simulate(rope, swings, tol=COARSE_TOL, **near).attrs["free_time"] > 0.8
    errors = []
    for step in (1e-3, 2.5e-4):
        coarse = hf.simulate(rope, swings, tol=10.0 * COARSE_TOL, contact_step=step, **near)
        assert coarse.attrs["free_time"] == 0.0
        assert coarse.attrs["contact_steps"] >= 1.0 / step
        errors.append(float(np.abs(coarse.joints - exact.joints).max()))
    assert errors[1] < 0.5 * errors[0] < 5e-3
    smooth, limited = rope.replace(dry_friction=0.0), rope.replace(max_bend=2.0)
    assert hf.simulate(smooth, swings, tol=10.0 * COARSE_TOL, **near).attrs["free_time"] > 0.8
    assert hf.simulate(limited, swings, tol=10.0 * COARSE_TOL, **how).attrs["free_time"] > 0.5


@pytest.mark.parametrize(("index", "dry"), [(2, 1e-3), (6, 1e-4), (8, 1e-2)])
def test_energy_never_grows_in_throws_with_dry_friction(index, dry):
    _, rope, how = draw(index, 1.0)
    run = hf.simulate(rope.replace(dry_friction=dry), refine=False, **how)
    # The goals of the project for joints with friction, as without dry friction.
    assert rise(run.energy_error) < 1e-5
    assert rise(-run.contact_loss) < 1e-5
    assert run.attrs["contact_deepest"] < 2e-4
    assert run.attrs["contact_steps"] > 0
    assert run.attrs["contact_unsolved"] <= 0.005 * run.attrs["contact_steps"]


def draped(n: int, dry: float, h: float, count: int, tol: float = DEFAULT_TOL) -> tuple[np.ndarray, float]:
    """Let a level rope fall over a peg in steps h, s, at a tolerance of positions, m.

    Returns its joints in the end (n, 2), m, and by how much the impulse of a joint misses the law of friction at most,
    over its bound. Each step is solved.
    """
    rope = hf.Rope.uniform(0.8, 0.05, n, 0.003, friction=1e-4, dry_friction=dry)
    scene = scene_of(hf.Setup(rope, pegs=[hf.Peg(0.25, -0.04, 0.03, 0.3)]))
    workspace, memory = new_contact_workspace(scene, 1e-6, h, tol), new_contact_memory(n, 1)
    y, most = np.repeat([1.5, 0.0], n), 0.0
    for k in range(count):
        begin = segment(scene.drive, 0.0), k * h, h, y, memory, workspace, True, 0.0, True
        assert try_step(scene, *begin)[1] > 0
        of = workspace.joints.of
        law = -h * dry * of[AFTER] / np.hypot(of[AFTER], tol / DEFAULT_TOL * BEND_RATE * rope.length)
        most = max(most, float(np.abs(of[IMPULSE] + of[RUBBED] - law).max()) / (h * dry))
        save_memory(memory, workspace.contacts, workspace.impulses, workspace.joints, h)
        save_trend(memory, workspace, h)
        y = workspace.out.copy()
    assert (workspace.impulses.mode[: workspace.contacts.total[0]] != OPEN).any()
    return rope.joints(y[:n], np.zeros(2)), most


def test_friction_obeys_its_law_in_every_step_of_a_draped_rope():
    coarse, most = draped(48, 2e-3, 1e-3, 600)
    assert most < 1.1e-3
    fine, most = draped(48, 2e-3, 1e-4, 6000)
    assert most < 1.1e-3
    # 0.17 mm; 0.02 mm are left with the short steps
    assert np.abs(coarse - fine).max() < 4e-4
    loose, most = draped(48, 2e-3, 1e-3, 600, 30.0 * DEFAULT_TOL)
    assert 1.1e-3 < most < 30.0 * 1.1e-3
    assert np.abs(loose - coarse).max() < 30.0 * 4e-4


def test_samples_of_a_draped_rope_do_not_depend_on_other_samples():
    """Steps to a sample begin with what the run knows, not with what the last sample found."""
    rope = hf.Rope.uniform(0.8, 0.05, 48, 0.003, friction=1e-4, dry_friction=1e-3)
    setup = hf.Setup(rope, pegs=[hf.Peg(0.25, -0.07, 0.03, 0.3)], q0=np.full(48, 1.5), duration=0.6)
    few = np.linspace(0.005, 0.6, 200)
    many = np.union1d(few, np.linspace(0.0013, 0.5987, 1501))
    one, other = (hf.simulate(setup, t_eval=t, refine=False) for t in (few, many))
    np.testing.assert_array_equal(one.qd, other.qd[np.isin(other.t, few)])
