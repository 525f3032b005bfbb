"""Derivatives of rollouts whose arm is driven by a torque, with dry friction in the shaft and in the rope."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.core.integrate.rollout import JOINT, MODES
from tests.frozen import check
from tests.refusals import refuses

TIMES, TORQUES = np.array([0.0, 0.2, 0.5, 0.7, 1.0]), np.array([0.0, 0.06, -0.05, -0.04, 0.05])
ARM = {"length": 0.2, "inertia": 2e-4, "mass": 0.04, "com": 0.08, "friction": 1e-3, "dry_friction": 0.01}


def rope(**changes: Any) -> hf.Rope:
    fields: dict[str, Any] = {
        "length": [0.15, 0.2],
        "mass": [0.02, 0.015],
        "friction": [2e-4, 1e-4],
        "dry_friction": [1.5e-3, 5e-4],
        "radius": 0.01,
    }
    return hf.Rope(**{**fields, **changes})


def setup(**changes: Any) -> hf.Setup:
    start = {"q0": np.array([0.1, -0.2]), "qd0": np.array([0.4, -0.3]), "arm_angle0": 0.2, "arm_rate0": 0.0}
    made = hf.Setup(rope(), None, hf.Arm(**ARM), hf.torque_profile(TIMES, TORQUES), duration=1.4, tol=1e-4, **start)
    return replace(made, **changes)


def raised(values: Any, x: float, at: int) -> Any:
    return np.asarray(values) + x * np.eye(len(values))[at]


WAYS: dict[str, tuple[Callable[[float], hf.Setup], float]] = {
    "arm_angle0": (lambda x: setup(arm_angle0=0.2 + x), 1e-4),
    "q0[1]": (lambda x: setup(q0=raised([0.1, -0.2], x, 1)), 1e-4),
    "qd0[1]": (lambda x: setup(qd0=raised([0.4, -0.3], x, 1)), 1e-3),
    "friction[1]": (lambda x: setup(rope=rope(friction=raised([2e-4, 1e-4], x, 1))), 3e-7),
    "dry_friction[0]": (lambda x: setup(rope=rope(dry_friction=raised([1.5e-3, 5e-4], x, 0))), 5e-7),
    "tip_mass": (lambda x: setup(rope=rope(tip_mass=0.001 + x)), 3e-6),
    "torque.torque[2]": (lambda x: setup(torque=hf.torque_profile(TIMES, raised(TORQUES, x, 2))), 1e-5),
    "torque.delay": (lambda x: setup(torque=hf.torque_profile(TIMES, TORQUES).shifted(0.05 + x)), 3e-5),
    **{
        f"arm.{name}": (lambda x, name=name: setup(arm=hf.Arm(**{**ARM, name: ARM[name] + x})), 3e-3 * ARM[name])
        for name in ARM
    },
}


@pytest.mark.parametrize("name", WAYS)
def test_each_name(name):
    log = check(*WAYS[name][:1], name, WAYS[name][1]).log
    joints = log[log[:, JOINT] >= 0.0]
    modes = np.array([row[MODES + int(row[JOINT])] for row in joints])
    assert (modes == 0.0).sum() >= 2
    assert (modes != 0.0).sum() >= 4
    assert (joints[:, JOINT] == 0.0).any()  # the shaft, too


def test_arm_and_tip():
    """A free pendulum of arm and rope that never move against each other: the arm's derivatives are the rope's."""
    stuck = setup(rope=rope(dry_friction=1.0), torque=hf.torque_profile([0.0, 1.0], [0.0, 0.0]), arm_rate0=0.3)
    stuck = replace(stuck, q0=[0.2, 0.2], qd0=[0.3, 0.3], arm=hf.Arm(**{**ARM, "dry_friction": 0.0}))
    got = hf.sensitivities(stuck, t_eval=[0.3, 0.9, 1.4], wrt=["arm.friction", "arm.length"])
    assert got.arm_angle is not None
    assert got.arm_rate is not None
    assert got.darm_angle is not None
    assert got.darm_rate is not None
    # sums of the same numbers
    np.testing.assert_allclose(got.q, np.stack([got.arm_angle] * 2, axis=1), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(got.dq, np.stack([got.darm_angle] * 2, axis=1), rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(got.dqd, np.stack([got.darm_rate] * 2, axis=1), rtol=0.0, atol=1e-10)
    reach = 0.2 + 0.35
    across = np.stack([np.cos(got.arm_angle), np.sin(got.arm_angle)], axis=1)
    along = np.stack([np.sin(got.arm_angle), -np.cos(got.arm_angle)], axis=1)
    np.testing.assert_allclose(got.tip, reach * along, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(got.dtip[..., 0], reach * across * got.darm_angle[:, :1], rtol=0.0, atol=1e-9)
    want = reach * across * got.darm_angle[:, 1:] + along
    np.testing.assert_allclose(got.dtip[..., 1], want, rtol=0.0, atol=1e-9)
    assert dict(got.dataset.sizes) == {"time": 3, "link": 2, "axis": 2, "parameter": 2}
    np.testing.assert_array_equal(got.dataset.darm_angle.sel(parameter="arm.length"), got.darm_angle[:, 1])


@pytest.mark.parametrize("name", ["motion.delay", "arm.stiffness", "torque.torque[9]"])
def test_what_a_torque_driven_arm_has_not(name):
    refuses(r"arm_angle0|no parameter", hf.sensitivities, setup(), wrt=name)


def test_names_of_a_torque_driven_arm_are_refused_where_a_motion_turns_it():
    prescribed = replace(setup(), torque=None, motion=hf.arm_swings())
    refuses(r"arm\.length", hf.sensitivities, prescribed, wrt="arm.inertia")
