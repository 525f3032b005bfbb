"""One step with a peg, by a reference that shares no line with the kernels: where the rope turns, gaps bend."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.chain.drive import segment
from hyperflex.core.chain.torque_peaks import COLUMNS, WINDOWS
from hyperflex.core.contact import run as at
from hyperflex.core.contact.memory import ContactMemory, new_contact_memory
from hyperflex.core.contact.run import (
    ContactWorkspace,
    Scene,
    branch_off,
    choose_step,
    complete_step,
    new_branch,
    new_contact_workspace,
    try_step,
)
from tests.core.helpers import scene_of
from tests.reference.wrapping import laid

RADIUS, TOP, STEP = 0.05, 0.4, 1e-4  # m, m, s
PART = 0.05  # of a step: 51 of the shortest steps


def gaps(rope: hf.Rope, radius: float, base: Array, q: Array) -> tuple[Array, Array]:
    """Gaps (n,), m, of the links' lines to a peg at the origin, and how they change with the angles (n, n), m/rad."""
    along, across = np.stack([np.sin(q), -np.cos(q)], axis=1), np.stack([np.cos(q), np.sin(q)], axis=1)
    joints = base + np.concatenate([np.zeros((1, 2)), np.cumsum(rope.length[:, None] * along, axis=0)])
    found, change = np.full(q.size, np.inf), np.zeros((q.size, q.size))
    for i in range(q.size):
        reach = -joints[i] @ along[i]
        if 0.0 < reach < rope.length[i]:
            normal = (joints[i] + reach * along[i]) / np.linalg.norm(joints[i] + reach * along[i])
            found[i] = (joints[i] + reach * along[i]) @ normal - radius
            change[i, :i] = rope.length[:i] * (across[:i] @ normal)
            change[i, i] = reach * (across[i] @ normal)
    return found, change


def wound(depth: float = 0.0, **axle: float) -> tuple[hf.Rope, Array, Scene]:
    """A rope half round a peg, `depth` inside it, m; down is +y. Rope, angles, and what its runs know."""
    length = TOP + math.pi * RADIUS + 0.15
    rope = hf.Rope.uniform(length, 0.05, round(length / 0.01), friction=1e-5, gravity=(0.0, 9.81))
    q = laid(rope.length, (depth - RADIUS, TOP), RADIUS - depth, math.pi)
    still = hf.moving_pivot([0.0, 1.0], [depth - RADIUS] * 2, [TOP] * 2)
    return rope, q, scene_of(hf.Setup(rope, still, q0=q, pegs=[hf.Peg(0.0, 0.0, RADIUS, 0.3, **axle)]))


def stepped(
    scene: Scene, q: Array, w: Array, *, push: bool = True, memory: ContactMemory | None = None
) -> ContactWorkspace:
    """Take one step from angles and rates; return its workspace."""
    workspace = new_contact_workspace(scene, 1e-6, 1e-4, 1e-5)
    given = np.concatenate([q, w, np.zeros(2)]), memory or new_contact_memory(q.size, 1), workspace
    try_step(scene, segment(scene.drive, 0.0), 0.0, STEP, *given, push, 0.0, True)
    return workspace


@pytest.mark.parametrize(("depth", "push", "out"), [(5e-5, True, 1e-3), (5e-5, False, 0.0), (1e-6, True, 0.0)])
def test_what_is_inside_a_peg_sinks_no_further_while_the_rope_turns(depth, push, out):
    """It is pushed out, or stays as deep: also what lies inside by little.

    Without the second-order term it would sink by 0.1 mm a second.
    """
    (rope, q, scene), base = wound(depth), np.array([depth - RADIUS, TOP])
    deep, change = gaps(rope, RADIUS, base, q)
    inside = deep < -0.5 * depth
    assert inside.sum() > 10
    w = np.random.default_rng(5).normal(0.0, 3.0, rope.n_links)
    w -= np.linalg.pinv(change[inside]) @ (change[inside] @ w)  # along the peg
    workspace = stepped(scene, q, w, push=push)
    after, change = gaps(rope, RADIUS, base, workspace.out[: rope.n_links])
    leaving = (change @ workspace.out[rope.n_links :])[inside & np.isfinite(after)]
    bend = 0.5 * STEP * np.abs(w).max() ** 2 * rope.total_length  # m/s, of that order is what the step allows for
    assert bend > 1e-3
    assert leaving.min() > out - 0.01 * bend
    assert np.median(leaving) < out + 0.05 * bend  # a tenth of what it is pushed out with


def test_a_sample_near_a_peg_does_not_depend_on_the_others():
    rope = hf.Rope.uniform(0.6, 0.04, 24, 0.0025, friction=5e-4)
    how = {"q0": np.full(24, 1.2), "pegs": [hf.Peg(0.0, -0.2, 0.03, 0.3)], "duration": 0.8, "contact_step": 1e-3}
    many = hf.simulate(rope, t_eval=np.linspace(0.0, 0.8, 81), **how)
    few = hf.simulate(rope, t_eval=many.t[::8], **how)
    assert many.contact_loss[-1] > 0.0
    np.testing.assert_array_equal(few.q, many.q[::8])
    np.testing.assert_array_equal(few.contact_force, many.contact_force[::8])


@pytest.mark.parametrize(("rate", "kept"), [(1e-4, True), (-1.0, False)])
def test_the_way_to_a_sample_leaves_a_run_as_it_is(rate, kept):
    """A cable slides over a peg that turns. Where energy must vanish no step will do: none is forced."""
    rope, q, scene = wound(inertia=1e-5)
    n, part, clock, spin = rope.n_links, segment(scene.drive, 0.0), np.zeros(at.CLOCK), np.array([[0.0], [3.0]])
    clock[at.STEP] = STEP
    y, torque = np.concatenate([q, np.zeros(n + 2)]), np.zeros((len(WINDOWS), COLUMNS))
    state = at.ContactState(y, clock, spin, new_contact_memory(n, 1), torque)
    workspace, aside = (new_contact_workspace(scene, 1e-4, STEP, 1e-5) for _ in range(2))
    workspace.spin.before[:] = spin[1]
    bounds, nothing = at.Bounds(1.0, STEP, 1e-5, 1e-4, np.inf, np.inf, 100), new_contact_memory(n, 1)
    for _ in range(50):
        chosen = choose_step(scene, part, bounds, state, workspace, nothing, 1.0, False, math.nan)
        complete_step(scene.drive, bounds, state, workspace, chosen, 1.0)
    chosen = choose_step(scene, part, bounds, state, workspace, nothing, 1.0, False, math.nan)
    assert chosen.good
    assert spin[1, 0] != 3.0
    before, branch, end = copied((state, workspace)), new_branch(state), clock[at.T] + PART * chosen.h
    branched = branch_off(scene, part, bounds._replace(rate=rate), workspace, aside, branch, nothing, chosen, end)
    assert branched == kept
    for one, other in zip(copied((state, workspace)), before, strict=True):
        np.testing.assert_array_equal(one, other)
    if kept:
        assert branch.clock[at.T] == end
        way, moved = PART * chosen.h * spin[1, 0], PART * (workspace.out[:n] - y[:n])
        assert branch.spin[0, 0] - spin[0, 0] == pytest.approx(way, rel=0.1)
        np.testing.assert_allclose(branch.y[:n] - y[:n], moved, rtol=0.0, atol=0.2 * np.abs(moved).max())


def copied(value: object) -> list[Array]:
    """Copies of all arrays in nested tuples."""
    if isinstance(value, tuple):
        return [array for each in value for array in copied(each)]
    return [np.array(value)]
