"""Postures that a fast vibration of the base holds against gravity, and their stiffness.

The first joint moves by A cos(w t) along a line. For fast vibrations the mean angles of a rope without friction move in
the potential V + v^2/4 g^T M^-1 g, with v = A w and g the coupling of the base's acceleration to the angles
(docs/theory/vibration.md). It draws each link to the line of the vibration.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, Flags
from hyperflex.dynamics import mass_matrix
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, MotorLimits, Rope, swing_rate, unit_across, unit_along
from hyperflex.motion import Motion, vibrate_arm, vibrating_pivot
from hyperflex.simulation import first_moment, simulate
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Of = Literal["chain", "tip"]
LEAST_RATIO = 6.0  # of the vibration's frequency to what it makes of a slow one, where averaging is said to hold
MOST_RIPPLE = 0.1  # rad, greatest amplitude of the links' fast motion there; of the arm's, half of it
RESOLVED = 0.02  # growth of a slow motion over sqrt(g / length) below which averaging does not tell it from none


@dataclass(frozen=True, eq=False)
class VibrationPosture:
    """An equilibrium of a rope whose first joint vibrates along a line, and small motion about it.

    Parameters
    ----------
    rope : Rope
    amplitude : float
        Amplitude of the first joint, m.
    frequency : float
        Of the vibration, Hz.
    direction : float
        Of the line, rad, as the angle of a link that lies along it.
    arm : Arm or None
        Arm whose tip vibrates perpendicular to it; None: the pivot itself moves.
    q : (n,) float64
        Mean link angles, rad.
    hessian : (n, n) float64
        Hessian of the averaged potential, N m/rad. If friction in the joints resists the fast motion, it is the
        derivative of the averaged torques, and not exactly symmetric.
    ripple : (n,) complex128
        Fast motion of the links, rad, with the phase relative to the base: q + Re(ripple exp(i w t)).
    """

    rope: Rope
    amplitude: float
    frequency: float
    direction: float
    arm: Arm | None
    q: Array
    hessian: Array
    ripple: npt.NDArray[np.complex128]

    @property
    def velocity(self) -> float:
        """Amplitude of the first joint's velocity, m/s."""
        return self.amplitude * math.tau * self.frequency

    @property
    def tilt(self) -> float:
        """Direction from the first joint to the tip, rad, as the angle of a link: 0 hangs, pi is upright."""
        return tilt_of(self.rope, self.q, "chain")

    @cached_property
    def _model(self) -> "Averaged":
        return Averaged(self.rope, self.arm, self.direction, self.frequency)

    @cached_property
    def eigenvalues(self) -> npt.NDArray[np.complex128]:
        """Of small slow motion about the posture (2 n,), 1/s: M z'' + D z' + H z = 0, D of the joints' friction."""
        n, loads = self.q.size, np.hstack([self.hessian, self._model.damping])
        slopes = -np.linalg.solve(mass_matrix(self.rope, self.q), loads)
        return np.asarray(np.linalg.eigvals(np.vstack([np.eye(n, 2 * n, n), slopes])), dtype=np.complex128)

    @property
    def stable(self) -> bool:
        """Whether, according to the averaged equations, no small slow motion grows."""
        least = RESOLVED * swing_rate(self.rope) + 1e-8 * np.abs(self.eigenvalues).max()
        return bool(self.eigenvalues.real.max() < least)

    @property
    def frequencies(self) -> Array:
        """Frequencies of the slow motions that oscillate, ascending, Hz."""
        return np.sort(self.eigenvalues.imag[self.eigenvalues.imag > 0.0]) / math.tau

    @property
    def least_frequency(self) -> float:
        """Frequency, Hz, from which averaging applies, at the same velocity of the base.

        It is LEAST_RATIO times that of the fastest slow oscillation, or that at which no link turns by more than
        MOST_RIPPLE, and the arm by no more than half of it. Averaging neglects about U (M w^2)^-1 U of the Hessian,
        where U is its part due to the vibration. If gravity cancels most of U, as near the threshold of an upright
        rope, the neglected part must be small relative to the remainder (docs/theory/vibration.md).
        """
        own = self.hessian - self._model.at(self.q, 0.0)[1]
        omitted = own @ np.linalg.solve(mass_matrix(self.rope, self.q) + self._model.resistance, own)
        square = float(np.abs(np.linalg.eigvals(np.linalg.solve(self.hessian, omitted))).max())
        fastest = max(float(np.abs(self.eigenvalues.imag).max()), math.sqrt(square)) / math.tau
        turn = 0.0 if self.arm is None else 2.0 * self.amplitude / self.arm.length
        most = max(float(np.abs(self.ripple).max()), turn)
        return max(LEAST_RATIO * fastest, self.frequency * most / MOST_RIPPLE)

    @property
    def holds(self) -> bool:
        """Whether the vibration is fast enough for averaging: the tilt is then accurate to 2 % (benchmarks)."""
        return self.frequency >= self.least_frequency

    @property
    def compliance(self) -> Array:
        """Mean displacement of the tip per constant force on it (2, 2), m/N: J H^-1 J^T.

        Its inverse is the stiffness; along a straight rope the compliance is 0.
        """
        jacobian = (self.rope.length[:, None] * unit_across(self.q)).T
        return jacobian @ np.linalg.solve(self.hessian, jacobian.T)

    def stiffness(self, direction: float) -> float:
        """Stiffness of the tip, N/m, in a `direction`, rad, as the angle of a link; inf along a straight rope."""
        push, yielding = unit_along(checks.number("direction", direction, unit="rad")), self.compliance
        along = float(push @ yielding @ push)
        return math.inf if abs(along) <= np.finfo(float).eps * float(np.trace(yielding)) else 1.0 / along

    @property
    def motion(self) -> Motion:
        """The vibration, for :func:`hyperflex.simulate`."""
        if self.arm is None:
            return vibrating_pivot(self.amplitude, self.frequency, self.direction)
        return vibrate_arm(self.amplitude / self.arm.length, self.frequency, self.direction - 0.5 * math.pi)

    def simulate(self, duration: float, **setup: Any) -> Trajectory:
        """Simulate the vibrated rope from the posture on, without averaging, for a whole number of its periods.

        `duration`, s, is rounded up to such a number. There are 32 samples a period, the last one not included, so that
        a mean over the samples is one over whole periods. `setup` are other fields of :class:`hyperflex.Setup`.
        """
        periods = math.ceil(checks.positive("duration", duration, "s") * self.frequency)
        rates = -math.tau * self.frequency * self.ripple.imag
        start = {"q0": self.q + self.ripple.real, "qd0": rates, "motion": self.motion, "arm": self.arm}
        t = np.arange(32 * periods) / (32.0 * self.frequency)
        return simulate(self.rope, t_eval=t, **{"duration": periods / self.frequency, **start, **setup})

    def __repr__(self) -> str:
        kind = "stable" if self.stable else "unstable"
        doubt = "" if self.holds else f", averaging needs {self.least_frequency:.3g} Hz"
        what = f"{1e3 * self.amplitude:.3g} mm at {self.frequency:.3g} Hz along {self.direction:.3g} rad"
        return f"VibrationPosture({kind}, tilt {self.tilt:.4g} rad, {what}{doubt})"


def tilt_of(rope: Rope, q: Array, of: Of) -> float:
    """Return the direction of the chain from end to end, or of the last link, rad."""
    if of == "tip":
        return float(q[-1])
    x, y = rope.length @ unit_along(q)
    return float(q.mean() + math.remainder(math.atan2(x, -y) - q.mean(), math.tau))


class Averaged:
    """Averaged torques of a rope whose base vibrates along a line, see docs/theory/vibration.md."""

    def __init__(self, rope: Rope, arm: Arm | None, direction: float, frequency: float) -> None:
        chain = checks.instance("rope", rope, Rope).chain()
        found = [kind for kind in ("dry_friction", "drag") if getattr(rope, kind).any()] + ["max_bend"] * rope.limited
        found += ["friction_model"] * (rope.friction_model != "relative")
        if found:
            raise InvalidInput(
                "averaging knows viscous friction and springs in the joints alone",
                got=found,
                fix="rope.replace(...) without them",
            )
        self.rope, self.arm, self.direction, self.frequency = rope, arm, direction, frequency
        n, omega = rope.n_links, math.tau * frequency
        bend = np.eye(n) - np.eye(n, k=-1)  # from link angles to the relative angles of their joints
        self.coupling, self.lever = mass_matrix(rope, np.zeros(n)), first_moment(chain)
        joint = rope.friction / (1j * omega) - rope.stiffness / omega**2
        self.resistance = bend.T @ (joint[:, None] * bend)
        self.spring, self.damping = -(omega**2) * self.resistance.real, -omega * self.resistance.imag
        base = 0.0 if arm is None else direction - 0.5 * math.pi
        self.rest = np.cumsum(rope.rest_angle) + base  # link angles at which all springs are at rest
        self.hinge = 0.0 if arm is None else joint[0] / arm.length  # the arm turns as it moves the joint

    def at(self, q: Array, v: float) -> tuple[Array, Array, npt.NDArray[np.complex128]]:
        """Return mean torques (n,), N m, minus their derivatives (n, n), and link rates (n,) as complex amplitudes.

        Of a base with the velocity v cos(w t), m/s, about the mean angles q (n,), rad.
        """
        difference = q[:, None] - q
        cosines, sines = self.coupling * np.cos(difference), self.coupling * np.sin(difference)
        along, across = (v * self.lever * each(self.direction - q) for each in (np.cos, np.sin))
        matrix, forcing = cosines + self.resistance, (-across).astype(np.complex128)
        forcing[0] += self.hinge * v
        x = np.linalg.solve(matrix, forcing)
        turned = sines @ x + along
        by_q = np.linalg.solve(matrix, np.diag(turned) - sines * x)
        turned_by_q = np.diag(cosines @ x + across) - cosines * x + sines @ by_q
        gx, gy = self.rope.gravity
        torques = self.lever * (gx * np.cos(q) + gy * np.sin(q)) - self.spring @ (q - self.rest)
        torques = torques - 0.5 * (x.conj() * turned).real
        slopes = 0.5 * (turned[:, None] * by_q.conj() + x.conj()[:, None] * turned_by_q).real
        weight = np.diag(self.lever * (gx * np.sin(q) - gy * np.cos(q)))
        return torques, np.asarray(weight + self.spring + slopes), np.asarray(x)

    def settle(self, q: Array, v: float) -> Array | None:
        """Return the equilibrium (n,) near mean angles q, rad, at the base's velocity v, m/s; None if there is none."""
        for _ in range(20):
            torques, hessian, _ = self.at(q, v)
            try:
                change = np.linalg.solve(hessian, torques)
            except np.linalg.LinAlgError:
                return None
            if (most := float(np.abs(change).max())) > 0.5:
                return None
            q = q + change
            if most < 1e-11:
                return q
        return None

    def follow(self, q: Array, velocities: Sequence[float] | Array) -> Iterator[tuple[float, Array]]:
        """Continue an equilibrium from mean angles q, rad, through velocities, m/s, until there is none."""
        for v in velocities:
            if (found := self.settle(q, v)) is None:
                return
            q = found
            yield float(v), q

    @property
    def top(self) -> float:
        """Velocity, m/s, at which gravity barely bends the rope away from the line of the vibration."""
        return 10.0 * swing_rate(self.rope) * self.rope.total_length

    def from_top(self, v: float) -> Array:
        """Return velocities from the greatest down to v, m/s."""
        top = max(self.top, v)
        return np.geomspace(top, v, 2 + int(math.log(top / v, 1.12)))  # so near that they continue each other

    def posture(self, q: Array, v: float) -> VibrationPosture:
        """Return the posture of an equilibrium q (n,), rad, at a velocity v, m/s, of the base."""
        omega = math.tau * self.frequency
        _, hessian, x = self.at(q, v)
        return VibrationPosture(self.rope, v / omega, self.frequency, self.direction, self.arm, q, hessian, x / omega)


@interruptible()
def vibration_posture(
    rope: Rope, amplitude: float, frequency: float, direction: float, *, arm: Arm | None = None
) -> list[VibrationPosture]:
    """Return the postures of a rope whose base vibrates, stable and unstable ones.

    Parameters
    ----------
    rope : Rope
        Without dry friction, drag and joint limits.
    amplitude : float
        Amplitude of the rope's first joint, m.
    frequency : float
        Hz.
    direction : float
        Line along which the joint moves, rad, as the angle of a link that lies along it: 0 is vertical, pi/2
        horizontal.
    arm : Arm, optional
        The joint is at the tip of an arm, which turns by small angles about direction - pi/2. By default the point from
        which the rope hangs moves along the line.

    Returns
    -------
    list of VibrationPosture
        Stable ones first. They continue the hanging and the upright rope from no vibration to this one, and the
        straight ropes along the line, in both directions, from a very strong vibration to this one. Postures with a
        fold also exist, but are not searched.

    Raises
    ------
    InvalidInput
        If an argument cannot be used, or the rope has properties that averaging does not include.

    Notes
    -----
    Stephenson, Phil. Mag. (6) 15, 233 (1908); Kapitza, Zh. Eksp. Teor. Fiz. 21, 588 (1951); for systems of many degrees
    of freedom Bullo, SIAM J. Control Optim. 41, 542 (2002). A few ms for ten links, O(n^3).

    Examples
    --------
    A rod of 0.3 m that is held 31 degrees above the horizontal:

    >>> import math
    >>> import hyperflex as hf
    >>> rod = hf.Rope(length=[0.3], mass=[0.05], friction=1e-4)
    >>> held = hf.vibration_posture(rod, amplitude=0.01, frequency=60.0, direction=math.radians(135.0))[0]
    >>> held.stable, held.holds, round(math.degrees(held.tilt), 1)
    (True, True, 120.9)
    """
    model, v = _checked(rope, amplitude, frequency, direction, arm)
    rest, n = rope.hanging_angle, rope.n_links
    rising, falling = v * np.sqrt(np.linspace(0.0, 1.0, 41)), model.from_top(max(v, 1e-9))
    found: list[Array] = []
    for line, velocities in ((model.direction, falling), (rest, rising)):
        for start in (line, line + (math.pi if line <= 0.0 else -math.pi)):
            path = list(model.follow(np.full(n, start), velocities))
            if len(path) == len(velocities):
                found.append(path[-1][1])
    turns = np.exp(1j * np.array(found))
    different = [k for k in range(len(found)) if (np.abs(turns[:k] - turns[k]).max(axis=1) > 1e-6).all()]
    return sorted((model.posture(found[k], v) for k in different), key=lambda each: not each.stable)


def _checked(
    rope: Rope, amplitude: float, frequency: float, direction: float, arm: Arm | None
) -> tuple[Averaged, float]:
    """Return the averaged rope, and the amplitude, m/s, of its base's velocity."""
    line = checks.number("direction", direction, unit="rad")
    checks.meant("direction", line, "rad")
    rate = checks.positive("frequency", frequency, "Hz")
    way = checks.number("amplitude", amplitude, sign="nonnegative", unit="m")
    if arm is not None and checks.instance("arm", arm, Arm).length <= way:
        raise InvalidInput("amplitude is no small angle of the arm", got=way, allowed=f"less than {arm.length:g} m")
    return Averaged(rope, arm, line, rate), way * math.tau * rate


@dataclass(frozen=True, eq=False)
class VibrationMap:
    """Tilt over amplitude and frequency of a vibration along one line (made by :func:`vibration_map`).

    Parameters
    ----------
    amplitude : (A,) float64
        m.
    frequency : (F,) float64
        Hz.
    tilt : (F, A) float64
        Tilt of the posture that continues the straight rope along the line, rad; NaN where it is not held.
    holds : (F, A) bool
        Whether averaging holds.
    direction : float
        rad.
    arm : Arm or None
    rope : Rope
    """

    amplitude: Array
    frequency: Array
    tilt: Array
    holds: Flags
    direction: float
    arm: Arm | None
    rope: Rope

    def plot(self, limits: MotorLimits | None = None) -> "Figure":
        """Draw the map, with the reach of a motor with these `limits`; return a Matplotlib figure."""
        from hyperflex.report import vibration_figure

        return vibration_figure(self, limits)


@interruptible()
def vibration_map(
    rope: Rope, amplitudes: ArrayLike, frequencies: ArrayLike, direction: float, *, arm: Arm | None = None
) -> VibrationMap:
    """Return the tilt at which vibrations along one line hold a rope.

    Parameters
    ----------
    rope, direction, arm
        As for :func:`vibration_posture`.
    amplitudes : (A,) array_like
        m; those of the map ascend.
    frequencies : (F,) array_like
        Hz; those of the map ascend.
    """
    ways, rates = (
        np.unique(checks.array(name, np.atleast_1d(values), (-1,), sign="positive", unit=unit))
        for name, values, unit in (("amplitudes", amplitudes, "m"), ("frequencies", frequencies, "Hz"))
    )
    checks.count("number of amplitudes", ways.size)
    tilt, holds = np.full((rates.size, ways.size), np.nan), np.zeros((rates.size, ways.size), dtype=np.bool_)
    for row, rate in enumerate(rates):
        model, _ = _checked(rope, ways[-1], rate, direction, arm)
        velocities = ways[::-1] * math.tau * rate
        path = np.concatenate([model.from_top(velocities[0])[:-1], velocities])
        held = list(model.follow(np.full(rope.n_links, model.direction), path))[path.size - ways.size :]
        for column, (v, q) in enumerate(held, 1):
            posture = model.posture(q, v)
            if not posture.stable:
                break
            tilt[row, -column], holds[row, -column] = posture.tilt, posture.holds
    return VibrationMap(ways, rates, tilt, holds, model.direction, arm, rope)
