"""Motor torque as a measured channel, with its derivatives."""

from dataclasses import replace

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import ANGLE, Drive
from hyperflex.core.integrate.observation import observe, senses
from hyperflex.core.read_only import read_only
from hyperflex.model import LINK_PROPERTIES, PROPERTIES, Arm, Rope, Setup
from hyperflex.sensors.sensor import Measurement, angles_and_rates
from hyperflex.simulation import Interval, ParameterChange, arm_polynomials
from hyperflex.trajectory import State

ANGLE_STEP = 1e-5  # rad, and relative: differences of a smooth function then have relative errors of 1e-10
RATE_STEP = 1e-3  # rad/s: torque is quadratic in the rates, so that the only error is rounding


class MotorTorque:
    """Torque (m,) of the motor of a prescribed `arm`, N m, as ``Trajectory.motor_torque`` defines it.

    It follows from the state at a sample without integration; its derivatives are central differences, at the slip or
    stick of each joint as it is there, chained with the exact derivatives of the state. Its values, (3,), are the arm's
    inertia, kg m^2, and viscous friction, N m s/rad, and `factor`.

    Parameters
    ----------
    arm : Arm
    factor : float
        Measured torque over torque: 1 for a calibrated sensor.
    """

    def __init__(self, arm: Arm, factor: float = 1.0) -> None:
        self.arm = arm
        self.values = np.array([arm.inertia, arm.friction, checks.number("factor", factor, sign="positive")])

    def with_values(self, values: Array) -> "MotorTorque":
        """Return the same sensor with other values (3,)."""
        inertia, friction, factor = (float(each) for each in values)
        return MotorTorque(replace(self.arm, inertia=inertia, friction=friction), factor)

    def measure(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Measurement:
        """Return the torque in one state, y (1,), with derivatives; see :class:`Sensor`.

        Inertia and friction are the sensor's own values, not those of `arm`.
        """
        angles, rates = angles_and_rates(rope, arm, state)
        motor = MotorTorque(arm).with_values(self.values)
        n, interval = rope.n_links, Interval(Setup(rope, None, arm).drive())
        u = checks.number("acceleration", acceleration, unit="rad/s^2")
        rows, _ = arm_polynomials("acceleration", 1.0)
        interval.set(0.0, 1.0, ANGLE, np.array([angles[0], rates[0], u]) @ rows)
        y = np.concatenate([angles[1:], rates[1:]])[None]
        parts = tuple({"coef": np.pad(row[None, None], ((0, 0), (ANGLE, 3 - ANGLE), (0, 0)))} for row in rows)
        t, chain, moved = np.zeros(1), rope.chain(), np.eye(2 * n, 2 * n + 3)[None]
        slopes = motor.jacobian(chain, interval.drive, parts, t, y, moved)
        order = [2 * n, *range(n), 2 * n + 1, *range(n, 2 * n)]
        return Measurement(motor.predict(chain, interval.drive, t, y), slopes[:, order], slopes[:, 2 * n + 2 :])

    def predict(self, chain: Chain, drive: Drive, t: Array, y: Array) -> Array:
        """Return the torque (m,), N m, at times t (m,) and states y (m, 2n or more)."""
        return self._torque(chain, drive, t, y, senses(chain, drive, t, y))

    def jacobian(
        self, chain: Chain, drive: Drive, parts: tuple[ParameterChange, ...], t: Array, y: Array, dy: Array
    ) -> Array:
        """Return its derivatives (m, 2n + P): by the start's state, and by the parameters whose changes are `parts`.

        `parts` are P changes of the chain, or of the drive's ``breaks`` and ``coef``; y is (m, 2n or more), dy
        (m, 2n, 2n + P) the derivatives of angles and rates along the same directions.
        """
        slip = senses(chain, drive, t, y)
        n = chain.length.size
        by_state = np.empty((t.size, 2 * n))
        for i in range(2 * n):
            step = ANGLE_STEP if i < n else RATE_STEP
            up, down = y.copy(), y.copy()
            up[:, i] += step
            down[:, i] -= step
            change = self._torque(chain, drive, t, up, slip) - self._torque(chain, drive, t, down, slip)
            by_state[:, i] = change / (2.0 * step)
        result: Array = np.einsum("mi,mid->md", by_state, dy)
        for k, part in enumerate(parts):
            up, down = (
                self._torque(_moved(chain, part, step), _shifted(drive, part, step), t, y, slip)
                for step in (ANGLE_STEP, -ANGLE_STEP)
            )
            result[:, 2 * n + k] += (up - down) / (2.0 * ANGLE_STEP)
        return result

    def value_jacobian(self, chain: Chain, drive: Drive, t: Array, y: Array) -> Array:
        """Return its derivatives (m, 3) with respect to its values."""
        seen = self._seen(chain, drive, t, y, np.ones((t.size, chain.length.size)))
        factor = self.values[2]
        return np.stack([factor * seen[:, 3], factor * seen[:, 2], self.predict(chain, drive, t, y) / factor], axis=1)

    def _torque(self, chain: Chain, drive: Drive, t: Array, y: Array, slip: Array) -> Array:
        rope, angle, rate, acceleration = self._seen(chain, drive, t, y, slip).T
        shaft = self.arm.shaft_torque(np.array([chain.gx, chain.gy]), angle, rate, acceleration)
        return np.asarray(self.values[2] * (rope + shaft))

    @staticmethod
    def _seen(chain: Chain, drive: Drive, t: Array, y: Array, slip: Array) -> Array:
        """Load of the rope on the shaft, N m, and angle, rate and acceleration of the arm (m, 4)."""
        base, scalars = np.empty((t.size, 9)), np.empty((t.size, 5))
        observe(chain, drive, t, y, slip, np.empty((t.size, chain.length.size)), base, scalars)
        acceleration, rate, angle = base[:, 2:5].T
        pull = np.cos(angle) * scalars[:, 2] + np.sin(angle) * scalars[:, 3]
        return np.stack([scalars[:, 4] + drive.arm_length * pull, angle, rate, acceleration], axis=1)


def _moved(chain: Chain, part: ParameterChange, step: float) -> Chain:
    """Return the chain with the properties in `part` changed by `step` times as much."""
    changes: dict[str, object] = {}
    for name, change in part.items():
        if name == "gravity":
            changes |= {"gx": chain.gx + step * float(change[0]), "gy": chain.gy + step * float(change[1])}
        elif name in PROPERTIES and (field := PROPERTIES[name].field):
            changes[field] = getattr(chain, field) + step * (
                change if PROPERTIES[name] in LINK_PROPERTIES else float(change[0])
            )
    return read_only(chain._replace(**changes))  # type: ignore[arg-type]


def _shifted(drive: Drive, part: ParameterChange, step: float) -> Drive:
    """Return the drive with its breaks, pieces and arm changed by `step` times as much as `part` says."""
    names = ("breaks", "coef")
    changes: dict[str, object] = {name: getattr(drive, name) + step * part[name] for name in names if name in part}
    if "arm_length" in part:
        changes["arm_length"] = drive.arm_length + step * float(part["arm_length"][0])
    return read_only(drive._replace(**changes))  # type: ignore[arg-type]
