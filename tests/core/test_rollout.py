"""Short rollouts and batches through every kernel of the run loop; without the compiler too, to check bounds."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import checks
from hyperflex.core.chain.drive import TORQUE
from hyperflex.simulation import rollouts

ROPE = hf.Rope(length=[0.1, 0.2, 0.15], mass=[0.03, 0.02, 0.01], friction=1e-3, stiffness=1e-3, tip_mass=0.01)
DRY = ROPE.replace(dry_friction=1e-3)
ARM = hf.Arm(length=0.1)
MOTION = hf.arm_swings(0.2, 0.05)
T = np.array([0.01, 0.1004, 0.15, 0.2, 0.23, 0.3])


@pytest.mark.parametrize("rope", [ROPE, DRY, ROPE.replace(friction_model="printed")], ids=["viscous", "dry", "printed"])
def test_both_integrators_agree(rope):
    kept = {"arm": ARM, "duration": 0.3, "t_eval": T}
    run = hf.simulate(rope, MOTION, tol=1e-8, **kept)
    check = hf.simulate(rope, MOTION, step=1e-4, **kept)
    # some thirty steps of 1e-8 m in links of 0.1 m, in a motion that doubles small errors; RK4 errs less
    np.testing.assert_allclose(run.q, check.q, rtol=0, atol=1e-6)
    np.testing.assert_allclose(run.motor_work, check.motor_work, rtol=0, atol=1e-7)
    assert np.abs(run.energy_error).max() < 1e-7


def test_members_agree_with_the_single_run():
    batch = hf.simulate_batch([ROPE] * 3, MOTION, arm=ARM, duration=0.3, t_eval=T, tol=1e-8, keep=("q",))
    run = hf.simulate(ROPE, MOTION, arm=ARM, duration=0.3, t_eval=T, tol=1e-8)
    assert batch.failed == []
    for q in batch.q:
        np.testing.assert_allclose(q, run.q, rtol=0, atol=1e-6)  # as above


def test_the_kernels_are_compiled_for_one_kind_of_arrays():
    """Whether an array may be written to is part of its type; each new type would cost half a minute of compiling."""
    rope, arm = hf.Rope.uniform(length=1.0, mass=0.1, n_links=3, friction=0.0), hf.Arm(0.1, 1e-3, pivot=(0.1, 0.0))
    torque = hf.torque_profile([0.0, 1.0], [1.0, 0.0])
    kinds = set()
    for setup in (hf.Setup(rope), hf.Setup(rope, hf.arm_swings(), arm), hf.Setup(rope, arm=arm, torque=torque)):
        for t in (np.array([0.0, 0.1]), checks.times("t_eval", [0.0, 0.1])):
            run = rollouts.Rollout(setup, t)
            if setup.torque_driven:
                interval = rollouts.Interval(run.drive)
                interval.set(0.0, 0.1, TORQUE, np.zeros(6))
                run.drive = interval.drive
            parts = (*run.chain, *run.drive, *run.progress, run.t, run.y)
            arrays = [part for part in parts if isinstance(part, np.ndarray)]
            kinds.add(tuple((a.flags.writeable, a.flags.c_contiguous, a.dtype, a.ndim) for a in arrays))
    assert len(kinds) == 1
