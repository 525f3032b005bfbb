"""Plan a vibration that holds a required posture, with a required stiffness, and say what motor it takes."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control.vibration import Averaged, Of, VibrationPosture, tilt_of
from hyperflex.dynamics import mass_matrix
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, MotorLimits, Rope, swing_rate


class MotorDemand(NamedTuple):
    """Requirements on an arm's motor: rad/s, rad/s^2, N m, and least and greatest angle, rad."""

    speed: float
    acceleration: float
    torque: float
    angles: tuple[float, float]


@dataclass(frozen=True, eq=False)
class VibrationPlan:
    """A vibration that holds a required posture (made by :func:`plan_vibration`), and the motor that it requires.

    Parameters
    ----------
    posture : VibrationPosture or None
        None if no vibration meets the requirements.
    motor : MotorDemand or None
        Requirements of the arm's motor; None without an arm.
    missing : dict of str to (float, float)
        Limits that the given motor does not meet, by the names of `MotorLimits`: required and possible value.
    """

    posture: VibrationPosture | None
    motor: MotorDemand | None = None
    missing: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        """Whether averaging applies, and the posture can be held, by the given motor if there is one."""
        return not self.message

    @property
    def message(self) -> str:
        """Why the plan fails; empty on success."""
        if self.posture is None:
            return "no vibration holds this posture stably; allow another direction, or a smaller tilt or stiffness"
        if not self.posture.holds:
            now, least = self.posture.frequency, self.posture.least_frequency
            return f"averaging does not apply at {now:.3g} Hz; from {least:.3g} Hz on at the same velocity of the base"
        limits, lacks = MotorLimits.__dataclass_fields__, self.missing.items()
        words = (f"{name} of {need:.3g} {limits[name].metadata['unit']}, has {has:.3g}" for name, (need, has) in lacks)
        return f"the motor lacks the required {'; '.join(words)}" if self.missing else ""


@interruptible()
def plan_vibration(
    rope: Rope,
    tilt: float,
    limits: MotorLimits | None = None,
    *,
    arm: Arm | None = None,
    of: Of = "chain",
    stiffness: float | None = None,
    push: float | None = None,
    frequency: float | None = None,
    direction: float | None = None,
) -> VibrationPlan:
    """Find the weakest vibration that holds a rope stably at a tilt, and the motor that it requires.

    Parameters
    ----------
    rope : Rope
        As for :func:`vibration_posture`.
    tilt : float
        Required angle, rad, as that of a link: 0 hangs, pi is upright.
    limits : MotorLimits, optional
        Of the arm's motor.
    arm : Arm, optional
        Its tip vibrates perpendicular to it; the rope hangs from the tip. By default a pivot moves along a line,
        without a motor.
    of : {"chain", "tip"}
        Whether the tilt is that of the line from the first joint to the tip, or that of the last link.
    stiffness : float, optional
        Least stiffness of the tip, N/m, in the direction `push`.
    push : float, optional
        Direction of the stiffness, rad, as the angle of a link; by default perpendicular to the tilt.
    frequency : float, optional
        Hz; by default the lowest at which averaging applies.
    direction : float, optional
        Line of the vibration, rad; by default the one with the lowest velocity of the base.

    Returns
    -------
    VibrationPlan
        It fails if the motor is too weak, and states what is missing. Contact of the rope with the arm is not checked.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.

    Notes
    -----
    A posture counts as held if it returns from small displacements at least half as fast as a pendulum of the rope's
    length would, and if it is at least as stiff as required.

    Examples
    --------
    >>> import hyperflex as hf
    >>> rod = hf.Rope(length=[0.3], mass=[0.05], friction=1e-4)
    >>> plan = hf.plan_vibration(rod, 1.9, hf.MotorLimits(), arm=hf.Arm(length=0.1))
    >>> plan.success, sorted(plan.missing)
    (False, ['acceleration', 'speed'])
    """
    checks.choice("of", of, ("chain", "tip"))
    wanted = 1e-300 if stiffness is None else checks.positive("stiffness", stiffness, "N/m")
    if limits is not None and arm is None:
        raise InvalidInput("limits are those of an arm's motor", got="no arm", fix="Give arm=Arm(length=...)")
    if limits is not None:
        checks.instance("limits", limits, MotorLimits)
    if not np.any(checks.instance("rope", rope, Rope).gravity):
        raise InvalidInput("without gravity any vibration along the tilt holds it", got="gravity 0", allowed="not 0")
    tilt = checks.number("tilt", tilt, unit="rad")
    if direction is not None:
        checks.meant("direction", checks.number("direction", direction, unit="rad"), "rad")
    across = tilt + 0.5 * math.pi if push is None else checks.number("push", push, unit="rad")
    checks.meant("tilt", tilt, "rad")
    family = _Family(rope, arm, tilt, of, direction, wanted, across)
    given = 20.0 * swing_rate(rope) / math.tau if frequency is None else frequency
    now = checks.positive("frequency", given, "Hz")
    found = family.weakest(now)
    for _ in range(7):  # friction in the joints makes the posture depend on the frequency
        if frequency is not None or found is None or 1.0 <= now / found.least_frequency <= 1.2:
            break
        now = 1.1 * found.least_frequency
        found = family.weakest(now)
    if found is not None and stiffness is not None and math.isinf(found.stiffness(across)):
        raise InvalidInput("a straight rope does not yield along itself", got=f"push={across:g}", fix="Give another")
    if found is None or arm is None:
        return VibrationPlan(found)
    turn, mean = found.amplitude / arm.length, found.direction - 0.5 * math.pi
    omega, torque = math.tau * found.frequency, found.simulate(2.0 / found.frequency).motor_torque
    motor = MotorDemand(turn * omega, turn * omega**2, float(np.abs(torque).max()), (mean - turn, mean + turn))
    missing = {}
    if limits is not None:
        pairs = {name: (getattr(motor, name), getattr(limits, name)) for name in ("speed", "acceleration", "torque")}
        missing = {name: (need, has) for name, (need, has) in pairs.items() if need > has}
        for need, has, sense in zip(motor.angles, limits.angles, (-1, 1), strict=True):
            if sense * (need - has) > 0.0:
                missing["angles"] = (need, has)
    return VibrationPlan(found, motor, missing)


@dataclass
class _Family:
    """Vibrations that hold a rope at a tilt, from the strongest (0) to the weakest (1)."""

    rope: Rope
    arm: Arm | None
    tilt: float
    of: Of
    direction: float | None
    wanted: float
    push: float

    def __post_init__(self) -> None:
        if self.arm is not None and checks.instance("arm", self.arm, Arm).length == 0.0:
            fix = "Give its length, or no arm: then the rope's first joint itself vibrates"
            raise InvalidInput("the arm has no length", got=0.0, allowed="more than 0 m", fix=fix)
        pull = math.sin(self.tilt - self.rope.hanging_angle)
        self.upright = abs(pull) < 1e-6  # or hanging: there any strength does, and below the tilt depends on it
        self.away = 0.0 if self.upright else math.copysign(1.0, pull)

    def member(self, u: float, frequency: float) -> VibrationPosture | None:
        """Return a member; None if the rope does not come to the tilt there."""
        above = math.pi - abs(math.remainder(self.tilt - self.rope.hanging_angle, math.tau))  # to the upright rope
        least, most = min(0.05, 0.2 * above, 0.2 * (math.pi - above)), min(1.4, above)
        line = self.tilt + self.away * (least + (most - least) * u) if self.direction is None else self.direction
        line = self.tilt + math.remainder(line - self.tilt, math.pi)
        model = Averaged(self.rope, self.arm, line % math.pi if self.arm else line, frequency)
        weakest = 0.03 * model.top
        last = weakest**u * model.top ** (1.0 - u) if self.upright else weakest
        before: tuple[float, Array] | None = None
        for v, q in model.follow(np.full(self.rope.n_links, line), model.from_top(last)):
            if not self.upright and self.away * (tilt_of(self.rope, q, self.of) - self.tilt) <= 0.0:
                return None if before is None else self._between(model, *before, v)
            before = v, q
        return model.posture(before[1], before[0]) if self.upright and before and before[0] == last else None

    def _between(self, model: Averaged, v: float, q: Array, lower: float) -> VibrationPosture | None:
        """Return the posture at the tilt between two velocities, m/s, of which the greater has the angles q."""
        from scipy.optimize import brentq

        def beyond(speed: float) -> float:
            found = model.settle(q, speed)
            return math.nan if found is None else tilt_of(self.rope, found, self.of) - self.tilt

        try:
            exact = brentq(beyond, lower, v, xtol=1e-14 * v)
        except ValueError:  # somewhere there is no posture
            return None
        found = model.settle(q, exact)
        return None if found is None else model.posture(found, exact)

    def margin(self, held: VibrationPosture | None) -> float:
        """Return the logarithm of the ratio of a posture's value to the required one; -inf if it is not held."""
        if held is None or not held.stable:
            return -math.inf
        squares = np.linalg.eigvals(np.linalg.solve(mass_matrix(self.rope, held.q), held.hessian))
        over = held.stiffness(self.push) / self.wanted, float(squares.real.min()) / (0.5 * swing_rate(self.rope)) ** 2
        return math.log(max(min(over), 1e-300))

    def weakest(self, frequency: float) -> VibrationPosture | None:
        """Return the member of the least velocity that is stable and stiff enough; None if there is none."""
        from scipy.optimize import brentq

        grid = np.linspace(0.0, 1.0, 13 if self.upright or self.direction is None else 1).tolist()
        held = [self.member(u, frequency) for u in grid]
        margins = list(map(self.margin, held))
        good = [(each.velocity, k) for k, each in enumerate(held) if each is not None and margins[k] >= 0.0]
        if not good:
            return None
        _, k = min(good)
        if k + 1 == len(grid) or not -math.inf < margins[k + 1] < 0.0:
            return held[k]
        exact = brentq(lambda u: self.margin(self.member(u, frequency)), *grid[k : k + 2], xtol=1e-9)
        return self.member(float(exact), frequency)
