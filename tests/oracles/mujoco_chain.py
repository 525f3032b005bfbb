"""MuJoCo's rigid-body dynamics as an oracle: a chain of plain hinges, written as MJCF text.

Hinge angles are relative, so damping in a hinge is friction between neighbours with reaction. MuJoCo's world is x
right, z up; a hinge about -y turns a link that hangs along -z towards +x, as our angles do. Where only MuJoCo's
accelerations are used, its integrators' errors stay out of the comparison: an eighth-order method integrates them. A
prescribed arm is exact: its acceleration is put into the equations of motion, and the others are solved for.
"""

from typing import Any

import mujoco
import numpy as np

from tests.reference.dense import Real


class HingeChain:
    """Links that hang from the tip of an arm at the origin; without an arm, from the origin itself.

    Parameters
    ----------
    rope : object with length, mass, com, inertia, friction, stiffness (n,) and tip_mass
    arm : None or (length, mass, com, inertia, friction)
    timestep : s, for MuJoCo's own integrators
    """

    def __init__(self, rope: Any, arm: tuple[float, ...] | None = None, timestep: float = 1e-3) -> None:
        rows = list(zip(*columns(rope), strict=True))
        if arm is not None:
            rows.insert(0, (*arm, 0.0))
        self.armed = arm is not None
        self.model = mujoco.MjModel.from_xml_string(_mjcf(rows, rope.tip_mass, timestep))
        self.data = mujoco.MjData(self.model)
        self.n = self.model.nv

    def put(self, q: Real, w: Real) -> None:
        """Set absolute angles and rates (n,), the arm's first, and compute all that follows from them."""
        self.data.qpos[:] = np.diff(q, prepend=0.0)
        self.data.qvel[:] = np.diff(w, prepend=0.0)
        mujoco.mj_forward(self.model, self.data)

    def tip(self) -> Real:
        """Position of the tip (2,), of the state that was put last."""
        return self.data.site("tip").xpos[[0, 2]].copy()

    def joints(self) -> Real:
        """Positions of the rope's joints, the tip last: (links + 1, 2)."""
        first = 2 if self.armed else 1  # the world and, with an arm, the arm itself come before the first link
        count = self.n - 1 if self.armed else self.n
        return np.vstack([self.data.xpos[first : first + count][:, [0, 2]], self.tip()])

    def acceleration(self, q: Real, w: Real, *, arm: float | None = None, torque: float = 0.0) -> Real:
        """Absolute accelerations (n,) under a torque on the first body, or with that body's acceleration given."""
        self.put(q, w)
        matrix = np.zeros((self.n, self.n))
        mujoco.mj_fullM(self.model, self.data, matrix)
        force = self.data.qfrc_passive - self.data.qfrc_bias
        if arm is None:
            force = force.copy()
            force[0] += torque
            return np.cumsum(np.linalg.solve(matrix, force))
        rest = np.linalg.solve(matrix[1:, 1:], force[1:] - matrix[1:, 0] * arm)
        return np.cumsum(np.append(arm, rest))


def columns(rope: Any) -> list[list[float]]:
    """Length, mass, centre of mass, inertia, friction and stiffness of the links as plain floats."""
    names = ("length", "mass", "com", "inertia", "friction", "stiffness")
    return [[float(value) for value in getattr(rope, name)] for name in names]


def _mjcf(rows: list[tuple[float, ...]], tip_mass: float, timestep: float) -> str:
    """The chain as nested bodies. Out-of-plane inertias do not matter; three equal ones pass MuJoCo's checks."""
    at_tip = f'pos="0 0 {-rows[-1][0]!r}"'
    inner = f'<site name="tip" {at_tip}/>'
    if tip_mass > 0.0:
        # Not quite a point: its own inertia is a billionth of a light link's.
        inner += f"<body {at_tip}>{_inertial(0.0, tip_mass, 1e-14)}</body>"
    for k, (_, mass, com, inertia, friction, stiffness) in reversed(list(enumerate(rows))):
        above = rows[k - 1][0] if k else 0.0
        hinge = f'<joint type="hinge" axis="0 -1 0" damping="{friction!r}" stiffness="{stiffness!r}"/>'
        inner = f'<body pos="0 0 {-above!r}">{hinge}{_inertial(com, mass, inertia)}{inner}</body>'
    option = f'<option gravity="0 0 -9.81" timestep="{timestep!r}" integrator="RK4"/>'
    return f"<mujoco>{option}<worldbody>{inner}</worldbody></mujoco>"


def _inertial(com: float, mass: float, inertia: float) -> str:
    return f'<inertial pos="0 0 {-com!r}" mass="{mass!r}" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
