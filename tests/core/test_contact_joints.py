"""Joints of the contact stepper in one step or impact, against dense matrices and one joint at a time projected."""

import numpy as np
import pytest
from scipy.optimize import brentq

import hyperflex as hf
from hyperflex.core.chain.drive import segment
from hyperflex.core.contact.arrays import AFTER, CREEP, IMPULSE, RUBBED, UPPER
from hyperflex.core.contact.joints import ANY, regularize_joints
from hyperflex.core.contact.memory import new_contact_memory, save_memory
from hyperflex.core.contact.run import (
    ContactWorkspace,
    account_step,
    begin_step,
    new_contact_workspace,
    try_step,
)
from hyperflex.core.contact.solver import climb, store
from tests.core.helpers import scene_of
from tests.reference import dense
from tests.reference.joint_impulses import rates_after

STEP = 2e-4  # s


def step(rope: hf.Rope, q: dense.Real, w: dense.Real, h: float, again: int = 0) -> tuple[ContactWorkspace, int]:
    """Take a step h from q, w, and the same step `again` from its own impulses; return its workspace and the rounds."""
    scene = scene_of(hf.Setup(rope))
    workspace = new_contact_workspace(scene, 1e-6, STEP, 1e-5)
    y, memory = np.concatenate([q, w]), new_contact_memory(rope.n_links, 0)
    call = scene, segment(scene.drive, 0.0), 0.0, h, y, memory, workspace, True, 0.0, True
    _, rounds = try_step(*call)
    for _ in range(again):
        save_memory(memory, workspace.contacts, workspace.impulses, workspace.joints, h)
        _, rounds = try_step(*call)
    return workspace, rounds


def taken(rope: hf.Rope, q: dense.Real, w: dense.Real, h: float) -> tuple[dense.Real, int, dense.Real]:
    """Rates (n,) after a step h from q, w, whether it was solved, and its account of energies."""
    workspace, rounds = step(rope, q, w, h, again=5 if h > 0.0 else 0)  # what is left dies out
    return workspace.out[rope.n_links :].copy(), rounds, workspace.account.copy()


def mass_matrix(rope: hf.Rope, q: dense.Real) -> dense.Real:
    """By virtual work of every body (n, n)."""
    mass, reach = dense.bodies(rope.chain())
    across = dense.directions(q)[1]
    moves = reach[:, :, None] * across[None]
    return np.diag(rope.inertia) + np.einsum("k,kia,kja->ij", mass, moves, moves)


@pytest.mark.parametrize("n", [1, 2, 3, 6, 12])
@pytest.mark.parametrize("seed", range(6))
def test_an_impact_on_limits_is_that_of_the_dense_complementarity_problem(n, seed):
    rng = np.random.default_rng([n, seed])
    q, w = np.cumsum(rng.normal(0.0, 0.5, n)), np.cumsum(rng.normal(0.0, 4.0, n))
    rest = rng.normal(0.0, 0.1, n)
    bend = np.diff(q, prepend=0.0) - rest
    there = rng.random(n) < 0.7
    limit = np.where(there, np.abs(bend), np.abs(bend) + 1.0)
    rope = hf.Rope(
        rng.uniform(0.05, 0.2, n), rng.uniform(0.01, 0.1, n), rest_angle=rest, max_bend=limit, dry_friction=0.1
    )
    upper, lower = np.where(there & (bend > 0), 0.0, ANY), np.where(there & (bend < 0), 0.0, -ANY)
    expected, impulses = rates_after(mass_matrix(rope, q), np.zeros(n), w, (lower, upper, np.zeros(n)))
    found, rounds, account = taken(rope, q, w, 0.0)
    assert rounds > 0
    # The proximal method leaves 1e-5 m/s at most at the lever of the chain beyond a joint, 5 cm or more.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-4)
    lost = 0.5 * (w @ mass_matrix(rope, q) @ w - expected @ mass_matrix(rope, q) @ expected)
    assert lost >= 0.0
    assert account[1] == pytest.approx(lost, rel=1e-4, abs=1e-7)
    assert account[0] == 0.0  # dry friction is finite, and an impact has no time
    assert (impulses[~there] == 0.0).all()


@pytest.mark.parametrize("n", [1, 2, 3, 6, 12])
@pytest.mark.parametrize("seed", range(6))
def test_a_step_with_dry_friction_is_that_of_dense_projections(n, seed):
    """From rest or in motion, without gravity and slow, so that centrifugal terms are below the compared ones."""
    rng = np.random.default_rng([n, seed, 1])
    q = np.cumsum(rng.normal(0.0, 0.5, n))
    moving = rng.random(n) < 0.5
    w = np.cumsum(np.where(moving, rng.normal(0.0, 1e-2, n), 0.0))
    rope = hf.Rope(
        rng.uniform(0.05, 0.2, n),
        rng.uniform(0.01, 0.1, n),
        dry_friction=rng.uniform(0.0, 2e-2, n) * (rng.random(n) < 0.9),
        friction=1e-3,
        gravity=(0.0, 0.0),
    )
    middle = q + 0.5 * STEP * w
    relative = np.eye(n) - np.eye(n, k=-1)
    matrix = mass_matrix(rope, middle)
    viscous = STEP * relative.T @ np.diag(rope.friction) @ relative
    # w1 = w + (M + h R / 2)^-1 (-h R w + S^T L): friction at the mean of the rates.
    free = (np.full(n, -ANY), np.full(n, ANY), STEP * rope.dry_friction)
    expected, impulses = rates_after(matrix + 0.5 * viscous, -viscous @ w, w, free)
    found, rounds, account = taken(rope, q, w, STEP)
    assert rounds > 0
    # Centrifugal terms: (3e-2 rad/s)^2 * 2e-4 s = 2e-7, some ten times that where a light link hangs on a heavy one.
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-6)
    sticks = np.abs(impulses) < STEP * rope.dry_friction * (1.0 - 1e-9)
    assert np.abs((relative @ found)[sticks]).max(initial=0.0) < 1e-6
    mean = 0.5 * relative @ (w + expected)
    assert account[0] == pytest.approx(-impulses @ mean + STEP * (rope.friction * mean) @ mean, rel=1e-3, abs=1e-12)


def regularized_step(rope: hf.Rope, q: dense.Real, w: dense.Real, force: float) -> tuple[ContactWorkspace, int]:
    """As ``step``, of STEP, with a force across a hanging rope's tip, N, as where no modes of friction are found."""
    scene = scene_of(hf.Setup(rope))._replace(pull=np.array([force, 0.0]))
    workspace, memory = new_contact_workspace(scene, 1e-6, STEP, 1e-5), new_contact_memory(rope.n_links, 0)
    given = segment(scene.drive, 0.0), 0.0, STEP, np.concatenate([q, w]), memory, workspace, True, 0.0, True
    _, torque = begin_step(scene, *given)
    regularize_joints(scene.chain, workspace.joints)
    parts = workspace.contacts, workspace.impulses, workspace.motion, workspace.joints, workspace.spin
    store(workspace.impulses, workspace.joints)
    _, rounds, *_ = climb(scene.chain, *parts, STEP, workspace.whole, True)
    account_step(scene.chain, workspace, torque, STEP)
    return workspace, rounds


@pytest.mark.parametrize("load", [0.5, 0.99, 1.5, 10.0])
def test_regularized_friction_breaks_loose_in_one_step(load):
    """With the coefficient of the rate before the step friction was nearly the load, 10 times the dry friction."""
    dry, rod = 5e-4, {"length": [0.01], "mass": [0.03], "gravity": (0.0, 0.0)}
    workspace, rounds = regularized_step(hf.Rope(dry_friction=dry, **rod), np.zeros(1), np.zeros(1), load * dry / 0.01)
    row, inertia = workspace.joints.of[:, 0], 0.03 * 0.01**2 / 3.0
    creep = row[CREEP]
    want = brentq(lambda w: inertia * w + STEP * dry * (w / np.hypot(w, creep) - load), 0.0, 1e4, xtol=1e-16)
    assert rounds > 0
    # friction misses its law by 1e-3 at most
    assert row[AFTER] == pytest.approx(want, rel=1e-3 * dry * STEP / (inertia * want) + 5e-3, abs=0.0)
    assert -1.001 * STEP * dry < row[RUBBED] < 0.0
    assert workspace.account[0] == pytest.approx(-0.5 * row[RUBBED] * row[AFTER], rel=1e-12)


@pytest.mark.parametrize("gap", [0.0, 1e-4], ids=["at its limit", "near it"])
def test_a_joint_at_its_limit_has_regularized_friction_beside(gap):
    """It turns as fast as the gap allows; friction has its own impulse, and each its own loss."""
    dry, rope = 1e-3, {"length": [0.1], "mass": [0.03], "gravity": (0.0, 0.0), "max_bend": 0.3}
    inertia, before, force = 0.03 * 0.1**2 / 3.0, 0.5 * gap / STEP, 50.0
    q = np.array([0.3 - 0.5 * STEP * before - gap])
    workspace, rounds = regularized_step(hf.Rope(dry_friction=dry, **rope), q, np.array([before]), force)
    row, middle = workspace.joints.of[:, 0], q[0] + 0.5 * STEP * before
    assert rounds > 0
    assert workspace.joints.mode[0] == UPPER
    rate = gap / STEP
    assert row[AFTER] == pytest.approx(rate, abs=2e-4)  # 1e-5 m/s at a lever of 0.1 m
    rubbed = -STEP * dry * rate / np.hypot(rate, row[CREEP])
    assert row[RUBBED] == pytest.approx(rubbed, rel=1e-6, abs=1e-3 * STEP * dry)
    pushed = STEP * force * 0.1 * np.cos(middle)
    assert row[IMPULSE] == pytest.approx(inertia * (rate - before) - rubbed - pushed, rel=5e-3)
    mean = 0.5 * (before + row[AFTER])
    assert workspace.account[:2] == pytest.approx([-row[RUBBED] * mean, -row[IMPULSE] * mean], rel=1e-9, abs=1e-15)
