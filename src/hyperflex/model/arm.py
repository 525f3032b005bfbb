"""The arm: its inertia and friction, and its link in the chain under a given torque."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, options
from hyperflex.checks import Array
from hyperflex.core import joint_law
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput
from hyperflex.model.properties import LINK_PROPERTIES
from hyperflex.model.rope import Rope, unit_across, unit_along
from hyperflex.motion import Motion
from hyperflex.options import option

LONGEST = 10.0  # m, of an arm without a warning


@dataclass(frozen=True)
class Arm:
    """A rigid arm on the motor's shaft; the rope hangs from its tip.

    A torque-driven arm is a link of the chain. With a prescribed motion only `length` and `pivot` affect the rope;
    inertia, mass and friction then contribute only to the reported motor torque, not to work and energies, which are
    those of the rope.

    Parameters
    ----------
    length : float
        From the shaft to the rope's first joint, m.
    inertia : float
        Moment of inertia of arm and rotor about the arm's centre of mass, kg m^2.
    mass, com : float
        Mass, kg, and distance of its centre from the shaft, m.
    friction, dry_friction : float
        Viscous, N m s/rad, and Coulomb friction, N m, of the shaft.
    torque_limit : float
        Maximum torque of the motor, N m.
    pivot : (float, float)
        Position of the shaft, m.
    shaft_radius : float
        Radius about the pivot that a planned rope keeps clear of, m: of the shaft, or of the motor's body if the rope
        could hit it; 0 for the axis of the shaft only.
    radius : float
        Half the width of the arm, m; a planned rope keeps clear of it.

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign.
    """

    length: float = option(0.105, "from the shaft to the rope", unit="m", sign="nonnegative")
    inertia: float = option(
        0.0, "moment of inertia of arm and rotor about the arm's centre of mass", unit="kg m^2", sign="nonnegative"
    )
    mass: float = option(0.0, "mass", unit="kg", sign="nonnegative")
    com: float = option(0.0, "distance of the centre of mass from the shaft", unit="m")
    friction: float = option(0.0, "viscous friction of the shaft", unit="N m s/rad", sign="nonnegative")
    dry_friction: float = option(0.0, "Coulomb friction of the shaft", unit="N m", sign="nonnegative")
    torque_limit: float = option(
        math.inf, "greatest torque of the motor", unit="N m", sign="positive", infinite=True, shown="not limited"
    )
    pivot: tuple[float, float] = (0.0, 0.0)
    shaft_radius: float = option(
        0.0, "radius about the shaft that a planned rope keeps clear of", unit="m", sign="nonnegative"
    )
    radius: float = option(0.0, "half the width of the arm", unit="m", sign="nonnegative")

    def __post_init__(self) -> None:
        options.check(self, "arm")
        checks.meant("arm length", self.length, "m", most=LONGEST)
        object.__setattr__(self, "pivot", tuple(checks.array("arm pivot", self.pivot, (2,), unit="m").tolist()))

    def tip(self, angle: ArrayLike) -> Array:
        """Return the position of the rope's first joint (..., 2), m, at each `angle` (...) of the arm, rad."""
        return np.array(self.pivot) + self.length * unit_along(angle)

    def tip_velocity(self, angle: ArrayLike, rate: ArrayLike) -> Array:
        """Return the velocity (..., 2), m/s, of the first joint at each `angle`, rad, and `rate` (...), rad/s."""
        return (self.length * np.asarray(rate))[..., None] * unit_across(angle)

    def tip_motion(self, motion: Motion, t: Array) -> tuple[Array, Array]:
        """Return position, m, and velocity, m/s, of the rope's first joint (T, 2) at times t (T,), s, of a motion."""
        angle = motion.angle(t)
        return self.tip(angle), self.tip_velocity(angle, motion.rate(t))

    def rope_tip(self, length: Array, angle: ArrayLike, rate: ArrayLike, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return position (..., 2), m, and velocity (..., 2), m/s, of the tip of a rope.

        Parameters
        ----------
        length : (n,) or (..., n) array
            Of its links, m.
        angle, rate : (...) array_like
            Of the arm, rad and rad/s.
        q, qd : (..., n) arrays
            Link angles, rad, and rates, rad/s.
        """
        place, velocity = unit_along(q, -2) @ length[..., None], unit_across(q, -2) @ (length * qd)[..., None]
        return self.tip(angle) + place[..., 0], self.tip_velocity(angle, rate) + velocity[..., 0]

    def table(self) -> dict[str, Any]:
        """Return the ``[arm]`` table of a TOML file."""
        return {**asdict(self), "pivot": list(self.pivot)}

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "Arm":
        """Build an arm from an ``[arm]`` table."""
        checks.keys("the arm table", checks.mapping("the arm table", table), [f.name for f in fields(cls)])
        return cls(**table)

    def rope_torque(self, angle: ArrayLike, loads: Array) -> Array:
        """Return the torque (T,), N m, that moves the rope.

        Parameters
        ----------
        angle : (T,) array, rad
        loads : (T, 3) array
            Force x and y on the rope, N, and torque through its first joint, N m.
        """
        fx, fy, moment = loads.T
        return np.asarray(moment + self.length * (np.cos(angle) * fx + np.sin(angle) * fy))

    def shaft_torque(self, gravity: Array, angle: Array, rate: Array, acceleration: Array) -> Array:
        """Return the torque (T,), N m, that the arm alone requires: for its inertia, weight and friction.

        Parameters
        ----------
        gravity : (2,) array, m/s^2
        angle, rate, acceleration : (T,) arrays, rad, rad/s, rad/s^2
            At rest, dry friction opposes the impending motion.
        """
        gx, gy = gravity
        sense = np.sign(np.where(rate != 0.0, rate, acceleration))
        torque = (self.inertia + self.mass * self.com**2) * acceleration
        torque = torque - joint_law.friction((self.friction, self.dry_friction, 0.0, 0.0), rate, sense)
        return np.asarray(torque - self.mass * self.com * (gx * np.cos(angle) + gy * np.sin(angle)))

    def weight_torque(self, rope: Rope, angle: ArrayLike) -> Array:
        """Return the torque (T,), N m, that holds the arm at each `angle` (T,), rad, while a rope hangs from it."""
        still, weight = np.zeros(()), np.append(-rope.total_mass * rope.gravity, 0.0)
        return self.shaft_torque(rope.gravity, np.asarray(angle), still, still) + self.rope_torque(angle, weight)

    def chain(self, rope: Rope) -> Chain:
        """Return arm and rope as one chain of n + 1 links, for a torque-driven arm.

        Raises
        ------
        InvalidInput
            If the arm has no length.
        """
        if self.length <= 0.0:
            raise InvalidInput("a torque-driven arm needs a length", got=self.length, allowed="length > 0, in m")

        both: dict[str, Any] = {}
        for each in LINK_PROPERTIES:
            own = getattr(self, each.name, each.default)
            both[each.field] = np.concatenate([[own], getattr(rope, each.name)])
        return read_only(rope.chain()._replace(**both))
