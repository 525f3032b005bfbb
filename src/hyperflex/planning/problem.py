"""What is planned for: a rope on an arm, the motor's limits, what must not be touched, the start, and the criteria."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array, Integers
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, MotorLimits, Obstacle, Peg, Rope, divided, gap_of, named
from hyperflex.planning.options import Conditions, WindCriteria
from hyperflex.simulation import refuse_rope

PERIODS = 5.0  # default time until the strike, in periods of a small swing
MIN_LINKS, MIN_TIME = 4, 0.1  # links, s
MAX_PERIODS = 100.0  # time until the strike at most: a search through as many strokes takes hours


@dataclass(frozen=True)
class Problem:
    """A rope on an arm, with the motor's limits and the time until the strike.

    Parameters
    ----------
    rope, arm : Rope, Arm
        The rope hangs at rest from the arm, which points to one side.
    limits : MotorLimits
        Its torque is at most the arm's ``torque_limit``.
    time : float
        Time within which the rope must strike, s, at least MIN_TIME; 0 (the default) means PERIODS periods of the
        rope's swing.
    clearance : float
        Minimum distance of the rope from its own arm and shaft in verified runs, m, >= 0; -inf allows it to swing in
        front of both.
    criteria : WindCriteria
        When a rope counts as wound round a target. The arm must not reach the pegs that the rope is to run behind.
    side : {-1, 0, 1}
        Side of the arm at the start, left or right; 0 lets the planner choose.
    obstacles : sequence of Peg, Wall, Ground
        Obstacles from which the rope keeps `clearance` in verified runs. The arm must not reach them.
    q0, qd0 : (n,) tuples of float
        Link angles, rad, and rates, rad/s, of a rope that swings at first; then `side` is -1 or 1. Empty: it hangs.

    Raises
    ------
    InvalidInput
        If a part is not of its class, the rope has fewer than MIN_LINKS links or no weight, the arm has no length, the
        time is too short or too long, clearance is below 0, the arm reaches an obstacle or a peg, or side or start are
        not as above.
    """

    rope: Rope
    arm: Arm
    limits: MotorLimits = field(default_factory=MotorLimits)
    time: float = 0.0
    clearance: float = 0.0
    criteria: WindCriteria = field(default_factory=WindCriteria)
    side: int = 0
    obstacles: tuple[Obstacle, ...] = ()
    q0: tuple[float, ...] = ()
    qd0: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, kind in (("rope", Rope), ("arm", Arm), ("limits", MotorLimits), ("criteria", WindCriteria)):
            checks.instance(name, getattr(self, name), kind)
        if self.rope.n_links < MIN_LINKS:
            raise InvalidInput(
                "rope has too few links to be cast",
                got=self.rope.n_links,
                allowed=f"at least {MIN_LINKS}; 25 to 60 are usual",
                fix="Give the rope more, shorter links",
            )
        if self.arm.length == 0.0:
            raise InvalidInput(
                "the arm has no length, so that the motor cannot move the rope",
                got=self.arm.length,
                allowed="more than 0 m",
                fix="Give the distance from the shaft to the rope's first joint",
            )
        if math.isfinite(self.criteria.max_sideways):
            refuse_rope(self.rope)
        time = checks.number("time", self.time, sign="nonnegative", unit="s")
        if 0.0 < time < MIN_TIME:
            raise InvalidInput("time is too short for any cast", got=time, allowed=f"{MIN_TIME:g} s or more, or 0")
        if time > MAX_PERIODS * self.period:
            allowed = f"up to {MAX_PERIODS:g} periods of its swing, {MAX_PERIODS * self.period:.4g} s"
            raise InvalidInput("time is longer than anybody swings a rope before a cast", got=time, allowed=allowed)
        object.__setattr__(self, "time", time or PERIODS * self.period)
        start = RopeState(0.0, np.array(self.q0), np.array(self.qd0)) if self.q0 else None
        given = Conditions(clearance=self.clearance, obstacles=self.obstacles, side=self.side, state0=start)
        for name in ("clearance", "obstacles"):
            object.__setattr__(self, name, getattr(given, name))
        torque = min(self.limits.torque, self.arm.torque_limit)
        object.__setattr__(self, "limits", replace(self.limits, torque=torque))
        shape = (self.rope.n_links if self.q0 else 0,)
        for name, unit in (("q0", "rad"), ("qd0", "rad/s")):
            value = checks.array(name, getattr(self, name), shape, unit=unit)
            object.__setattr__(self, name, tuple(value.tolist()))
        self._check_obstacles()

    def _check_obstacles(self) -> None:
        """Refuse what the turning arm would hit, and pegs that are to be touched and not to be touched."""
        for k, peg in enumerate(self.criteria.behind):
            if peg in self.obstacles or peg in self.criteria.behind[:k]:
                how = "given twice" if peg in self.criteria.behind[:k] else "an obstacle, too"
                fix = "Give it once, in behind alone"
                raise InvalidInput(f"a peg that the rope is to run behind is {how}", got=peg, fix=fix)
        for each in (*self.criteria.behind, *self.obstacles):
            room = gap_of(each, self.arm.pivot) - self.arm.length - self.arm.radius
            if room <= 0.0:
                what = f"the turning arm hits {named(each)}"
                raise InvalidInput(what, got=f"{-room:.3g} m too near the shaft", fix="Move it, or give a shorter arm")

    @cached_property
    def period(self) -> float:
        """Period of a small swing of the rope, s; see :func:`hyperflex.control.swing_period`."""
        return swing_period(self.rope)

    @property
    def start(self) -> tuple[Array, Array]:
        """Link angles (n,), rad, and rates, rad/s, at the start."""
        if self.q0:
            return np.array(self.q0), np.array(self.qd0)
        return np.full(self.rope.n_links, self.rope.hanging_angle), np.zeros(self.rope.n_links)

    def beside(self, target: Peg) -> tuple[Obstacle, ...]:
        """Return all that the rope may come upon: the target, pegs that it is to run behind, and obstacles."""
        return (target, *self.criteria.behind, *self.obstacles)

    def cut(self, pieces: int | Integers) -> "Problem":
        """Return the same with each link of the rope cut into pieces, as many of each or (n,)."""
        q0, qd0 = (tuple(np.repeat(each, pieces)) if each else () for each in (self.q0, self.qd0))
        return replace(self, rope=divided(self.rope, pieces), q0=q0, qd0=qd0)
