"""Joints of the contact stepper in one step or impact, against dense matrices and one joint at a time projected."""

import numpy as np
import pytest
from scipy.optimize import brentq

import hyperflex as hf
from hyperflex.core.chain.drive import segment
from hyperflex.core.contact.arrays import AFTER, CREEP, IMPULSE, RUBBED, UPPER
from hyperflex.core.contact.joints import ANY, BEND_RATE
from hyperflex.core.contact.memory import new_contact_memory, save_memory
from hyperflex.core.contact.run import ContactWorkspace, new_contact_workspace, try_step
from tests.core.helpers import scene_of
from tests.reference import dense
from tests.reference.joint_impulses import rates_after

STEP = 2e-4  # s


def step(
    rope: hf.Rope, q: dense.Real, w: dense.Real, h: float, again: int = 0, force: float = 0.0
) -> tuple[ContactWorkspace, int]:
    """Take a step h from q, w, and the same step `again` from its own impulses; return its workspace and the rounds.

    `force` acts across a hanging rope's tip, N.
    """
    scene = scene_of(hf.Setup(rope))._replace(pull=np.array([force, 0.0]))
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
    expected, impulses = rates_after(mass_matrix(rope, q), w, lower, upper)
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
def test_a_step_with_dry_friction_obeys_the_dense_equations(n, seed):
    """From rest or in motion, without gravity and slow, so that centrifugal terms are below the compared ones."""
    rng = np.random.default_rng([n, seed, 1])
    q = np.cumsum(rng.normal(0.0, 0.5, n))
    moving = rng.random(n) < 0.5
    w = np.cumsum(np.where(moving, rng.normal(0.0, 1e-3, n), 0.0))
    rope = hf.Rope(
        rng.uniform(0.05, 0.2, n),
        rng.uniform(0.01, 0.1, n),
        dry_friction=rng.uniform(0.0, 2e-2, n) * (rng.random(n) < 0.9),
        friction=1e-3,
        gravity=(0.0, 0.0),
    )
    relative, bound = np.eye(n) - np.eye(n, k=-1), STEP * rope.dry_friction
    found, rounds, account = taken(rope, q, w, STEP)
    assert rounds > 0
    rates, mean = relative @ found, 0.5 * relative @ (w + found)
    # M (w1 - w) = S^T (L - h friction at the mean rate): the impulses of dry friction follow from the rates after it.
    matrix = mass_matrix(rope, q + 0.5 * STEP * w)
    moment = matrix @ (found - w)
    impulses = np.linalg.solve(relative.T, moment) + STEP * rope.friction * mean
    law = -bound * rates / np.hypot(rates, BEND_RATE * rope.length)
    centrifugal = STEP * np.abs(w).max() ** 2 * np.abs(matrix).sum()
    assert (np.abs(impulses - law) <= 2e-3 * bound + centrifugal + 1e-10).all()  # friction misses its law by 1e-3
    assert account[0] == pytest.approx(-law @ mean + STEP * (rope.friction * mean) @ mean, rel=3e-3, abs=1e-12)


@pytest.mark.parametrize("load", [0.5, 0.99, 1.5, 10.0])
def test_friction_breaks_loose_in_one_step(load):
    """With the coefficient of the rate before the step friction was nearly the load, 10 times the dry friction."""
    dry, rod = 5e-4, {"length": [0.01], "mass": [0.03], "gravity": (0.0, 0.0)}
    rope = hf.Rope(dry_friction=dry, **rod)
    workspace, rounds = step(rope, np.zeros(1), np.zeros(1), STEP, force=load * dry / 0.01)
    row, inertia = workspace.joints.of[:, 0], 0.03 * 0.01**2 / 3.0
    creep = row[CREEP]
    want = brentq(lambda w: inertia * w + STEP * dry * (w / np.hypot(w, creep) - load), 0.0, 1e4, xtol=1e-16)
    assert rounds > 0
    # friction misses its law by 1e-3 at most
    assert row[AFTER] == pytest.approx(want, rel=1e-3 * dry * STEP / (inertia * want) + 5e-3, abs=0.0)
    assert -1.001 * STEP * dry < row[RUBBED] < 0.0
    assert workspace.account[0] == pytest.approx(-0.5 * row[RUBBED] * row[AFTER], rel=1e-12)


@pytest.mark.parametrize("gap", [0.0, 1e-4], ids=["at its limit", "near it"])
def test_a_joint_at_its_limit_has_friction_beside(gap):
    """It turns as fast as the gap allows; friction has its own impulse, and each its own loss."""
    dry, rope = 1e-3, {"length": [0.1], "mass": [0.03], "gravity": (0.0, 0.0), "max_bend": 0.3}
    inertia, before, force = 0.03 * 0.1**2 / 3.0, 0.5 * gap / STEP, 50.0
    q = np.array([0.3 - 0.5 * STEP * before - gap])
    workspace, rounds = step(hf.Rope(dry_friction=dry, **rope), q, np.array([before]), STEP, force=force)
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


def test_a_pressed_rope_with_friction_starts_from_the_impulses_of_its_limits():
    """Only the sum of both impulses is kept: with a part of it as friction, each step took 7 rounds."""
    n = 8
    rope = hf.Rope.uniform(0.8, 0.1, n, friction=1e-3, dry_friction=1.0).replace(max_bend=np.full(n, 0.2))
    q = 0.2 * np.arange(1.0, n + 1.0)
    workspace, rounds = step(rope, q, np.zeros(n), STEP, again=7, force=3.0)
    assert (workspace.joints.mode == UPPER).sum() >= 3
    assert 0 < rounds <= 2
