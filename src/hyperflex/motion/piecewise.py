"""A motion: arm angle, pivot position and motor torque as piecewise polynomials."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, Flags
from hyperflex.core.chain.drive import ANGLE, TORQUE, X, Y
from hyperflex.errors import InvalidInput

CHANNELS = 4  # arm angle, pivot x, pivot y, torque of the first joint; then those of the joints beyond it
POWERS = 6  # coefficients of a piece: up to the fifth power, which minimum jerk needs
MEET = 1e-9  # rad, m or s: greatest difference of two values that are meant to be equal


@dataclass(frozen=True, eq=False)
class Motion:
    """Commanded motion: arm angle (rad), pivot position (m) and motor torque (N m) as functions of time.

    Build one with :func:`hold_arm`, :func:`move_arm`, :func:`arm_swings`, :func:`sampled_motion`, :func:`moving_pivot`
    or :func:`torque_profile`; join two with :meth:`then`. A motion is at rest before its first break, and after its
    last one unless it repeats.

    Parameters
    ----------
    breaks : (k + 1,) array
        Times at which the pieces begin and end, s.
    coef : (k, 4 or more, 6) array
        Coefficients of the pieces for angle, x, y and torque, ascending powers of the time since the piece began; of
        motors in several joints one torque for each joint from the first.
    switch : (k + 1,) array of bool
        Whether the acceleration (or torque), or its rate of change, jumps at a break; the integration restarts there.
    loop : int
        The pieces from this one on repeat for ever after the last break; -1 if none do.
    spec : mapping
        How the motion was made, as in a TOML file; empty for a motion joined from others.

    Raises
    ------
    InvalidInput
        If shapes do not fit, a number is not finite, or the breaks do not increase.
    """

    breaks: Array
    coef: Array
    switch: Flags
    loop: int = -1
    spec: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        breaks = checks.times("motion breaks", self.breaks, least=2)
        coef = checks.array("motion coefficients", self.coef, (breaks.size - 1, -1, POWERS))
        if coef.shape[1] < CHANNELS:
            raise InvalidInput("motion coefficients lack channels", got=coef.shape[1], allowed=f"at least {CHANNELS}")
        switch = checks.array("motion switch", np.asarray(self.switch, object), breaks.shape).astype(np.bool_)
        loop = checks.count("motion loop", self.loop, least=-1)
        if loop >= breaks.size - 1:
            raise InvalidInput("motion loop is beyond the last piece", got=loop, allowed=f"-1 to {breaks.size - 2}")
        switch.setflags(write=False)
        for name, value in (("breaks", breaks), ("coef", coef), ("switch", switch), ("loop", loop)):
            object.__setattr__(self, name, value)

    def __eq__(self, other: object) -> bool:
        """Whether two motions are the same function of time, piece by piece and bit for bit."""
        names = ("breaks", "coef", "switch", "loop")
        return isinstance(other, Motion) and all(np.array_equal(getattr(self, n), getattr(other, n)) for n in names)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        kind = f"{self.spec['kind']}, " if "kind" in self.spec else ""
        again = f", repeats from {self.breaks[self.loop]:g} s on" if self.loop >= 0 else ""
        pieces = f"{len(self.coef)} piece{'' if len(self.coef) == 1 else 's'}"
        return f"Motion({kind}{self.breaks[0]:g} to {self.breaks[-1]:g} s, {pieces}{again})"

    @property
    def end(self) -> float:
        """Last break, s: afterwards the motion is at rest or repeats."""
        return float(self.breaks[-1])

    @property
    def period(self) -> float:
        """Time after which the motion repeats, s; inf if it does not."""
        return math.inf if self.loop < 0 else float(self.breaks[-1] - self.breaks[self.loop])

    def angle(self, t: ArrayLike) -> Array:
        """Arm angle at times t (T,), rad."""
        return self._evaluate(t, ANGLE, 0)

    def rate(self, t: ArrayLike) -> Array:
        """Arm rate at times t (T,), rad/s."""
        return self._evaluate(t, ANGLE, 1)

    def acceleration(self, t: ArrayLike) -> Array:
        """Angular acceleration of the arm at times t (T,), rad/s^2; at a switch, that of the later piece."""
        return self._evaluate(t, ANGLE, 2)

    def point(self, t: ArrayLike) -> Array:
        """Displacement of the pivot at times t (T,): (T, 2), m."""
        return np.stack([self._evaluate(t, X, 0), self._evaluate(t, Y, 0)], axis=-1)

    @property
    def joints(self) -> int:
        """Number of joints, from the first, that have a torque."""
        return int(self.coef.shape[1]) - TORQUE

    def torque(self, t: ArrayLike, joint: int = 0) -> Array:
        """Torque of the motor in a `joint`, by default the first, at times t (T,), N m."""
        return self._evaluate(t, TORQUE + checks.count("joint", joint, least=0, most=self.joints - 1), 0)

    def extrema(self, derivative: int = 0) -> tuple[Array, Array]:
        """Return times (m,), s, and values (m,) among which the arm's exact extreme angles lie, of each piece.

        `derivative` 1 and 2 are for the rate, rad/s, and the acceleration, rad/s^2.
        """
        times, values = [], []
        for begin, end, coef in zip(self.breaks[:-1], self.breaks[1:], self.coef[:, ANGLE], strict=True):
            piece = Polynomial(coef).deriv(derivative)
            s = np.append(piece.deriv().roots().real.clip(0.0, end - begin), [0.0, end - begin])
            times.append(begin + s)
            values.append(piece(s))
        return np.concatenate(times), np.concatenate(values)

    def jumps(self, derivative: int = 0) -> tuple[Array, Array]:
        """Return the breaks (k + 1,), s, and the jumps (k + 1,) of the arm's angle there, rad.

        `derivative` 1 is for those of the rate, rad/s.
        At the last break of a motion that repeats it is the jump to the piece that follows.
        """
        coef = _derived(self.coef[:, ANGLE], derivative)
        ends = polyval(np.diff(self.breaks), coef.T, tensor=False)
        still = [0.0] if derivative else self.coef[:1, ANGLE, 0]
        after = coef[self.loop, :1] if self.loop >= 0 else [0.0] if derivative else ends[-1:]
        return self.breaks, np.concatenate([coef[:, 0], after]) - np.concatenate([still, ends])

    def _evaluate(self, t: ArrayLike, channel: int, derivative: int) -> Array:
        time = checks.array("t", t, None, unit="s", infinite=True)
        begin, end = self.breaks[0], self.breaks[-1]
        before, after, inside = time < begin, time >= end, np.clip(time, begin, end)
        if self.loop >= 0:
            anchor = self.breaks[self.loop]
            inside = np.where(after, anchor + np.mod(time - anchor, self.period), inside)
        piece = np.minimum(np.searchsorted(self.breaks, inside, side="right"), len(self.coef)) - 1
        coef = np.moveaxis(_derived(self.coef[:, channel], derivative)[piece], -1, 0)
        value = polyval(inside - self.breaks[piece], coef, tensor=False)
        still = before | (after & (self.loop < 0))
        return np.where(still & (derivative > 0 or channel >= TORQUE), 0.0, value)

    def switches(self, start: float, end: float) -> Array:
        """Instants in start..end (s) at which the acceleration or torque jumps, increasing, (m,)."""
        breaks, _, switch = self._unrolled(end)
        found = breaks[switch]
        return found[(found >= start) & (found <= end)]

    def shifted(self, delay: float) -> "Motion":
        """Return the same motion, `delay` seconds later."""
        delay = checks.number("delay", delay, unit="s")
        spec = {**self.spec, "delay": self.spec.get("delay", 0.0) + delay} if self.spec else {}
        return Motion(self.breaks + delay, self.coef, self.switch, self.loop, spec)

    def then(self, other: "Motion", at: float) -> "Motion":
        """Return this motion until time `at` (s) and `other`, on its own time axis, from there on.

        The integration restarts at `at`; a jump of the arm angle or of the pivot is refused.
        """
        at = checks.number("time of the change", at, unit="s")
        if not isinstance(other, Motion):
            raise InvalidInput("what follows is not a motion", got=other, allowed="a Motion, such as hold(angle)")
        for name, channel in (("arm angle", ANGLE), ("pivot x", X), ("pivot y", Y)):
            one, two = (float(each._evaluate(at, channel, 0)) for each in (self, other))
            if abs(one - two) > MEET:
                raise InvalidInput(
                    f"{name} jumps at t = {at:g} s",
                    got=[one, two],
                    allowed=f"motions that meet within {MEET:g}",
                    fix="Shift the second motion or move to its start first",
                )
        breaks, coef, switch = self._unrolled(at)
        keep, second = int(np.searchsorted(breaks, at, side="left")), other._since(at)
        channels = max(coef.shape[1], second.coef.shape[1])
        pieces = [np.pad(each, ((0, 0), (0, channels - each.shape[1]), (0, 0))) for each in (coef[:keep], second.coef)]
        return Motion(
            np.concatenate([breaks[:keep], second.breaks]),
            np.concatenate(pieces),
            np.concatenate([switch[:keep], second.switch]),
            second.loop + keep if second.loop >= 0 else -1,
        )

    def _since(self, at: float) -> "Motion":
        """Pieces from `at` on, with a switch there."""
        if at < self.breaks[0]:
            held = np.concatenate([_standing(self.coef[:1], 0.0), self.coef])
            first = self.loop + 1 if self.loop >= 0 else -1
            return Motion(np.append(at, self.breaks), held, np.append(True, self.switch), first)
        again = self.loop >= 0  # then the last cycle repeats, which begins after `at`
        breaks, coef, switch = self._unrolled(at + self.period if again else at)
        keep = int(np.searchsorted(breaks, at, side="right")) - 1
        return Motion(
            np.append(at, breaks[keep + 1 :]),
            np.concatenate([_advanced(coef[keep : keep + 1], at - breaks[keep]), coef[keep + 1 :]]),
            np.append(True, switch[keep + 1 :]),
            len(coef) - len(self.coef) + self.loop - keep if again else -1,
        )

    def _unrolled(self, until: float) -> tuple[Array, Array, Flags]:
        """Breaks, coefficients and switches that reach beyond `until`, cycles and standing still written out."""
        breaks, coef, switch = self.breaks, self.coef, self.switch
        if breaks[-1] > until:
            return breaks, coef, switch
        if self.loop < 0:
            still = _standing(coef[-1:], breaks[-1] - breaks[-2])
            return np.append(breaks, until + 1.0), np.concatenate([coef, still]), np.append(switch, False)
        cycles = math.floor((until - breaks[-1]) / self.period) + 1
        offsets = np.arange(1, cycles + 1)[:, None] * self.period
        return (
            np.append(breaks, (offsets + breaks[None, self.loop + 1 :]).ravel()),
            np.concatenate([coef, np.tile(coef[self.loop :], (cycles, 1, 1))]),
            np.append(switch, np.tile(switch[self.loop + 1 :], cycles)),
        )


def _standing(coef: Array, at: float) -> Array:
    """A constant piece (1, channels, powers) with the value of `coef` (1, channels, powers) after a time `at`."""
    still = np.zeros_like(coef)
    still[:, :TORQUE, 0] = _advanced(coef, at)[:, :TORQUE, 0]
    return still


def _advanced(coef: Array, by: float) -> Array:
    """Coefficients (..., powers) of the same polynomials in a time that starts `by` later: their Taylor series."""
    terms = [by**k / math.factorial(k) * _derived(coef, k) for k in range(POWERS)]
    return np.asarray(np.sum(terms, axis=0))


DERIVATIVE = np.diag(np.arange(1.0, POWERS), 1)  # of a polynomial's coefficients, ascending


def _derived(coef: Array, derivative: int) -> Array:
    """Coefficients (..., powers) of a derivative of polynomials."""
    return np.asarray(coef @ np.linalg.matrix_power(DERIVATIVE, derivative).T)


# Coefficients of a quintic on 0..1 from its value, first and second derivative at 0, and then at 1: multiples of 1/2
_QUINTIC = np.linalg.inv(
    [_derived(np.eye(POWERS), k) @ ends for ends in (np.eye(POWERS)[0], np.ones(POWERS)) for k in range(3)]
).round(6)


def quintics(begin: Array, end: Array, span: Array) -> Array:
    """Coefficients (P, POWERS) of the fifth-order polynomials between states (3, P) that lie `span` (P,) apart.

    A state consists of value, rate and acceleration.
    """
    scale = span ** np.arange(3)[:, None]
    return np.asarray((_QUINTIC @ np.concatenate([begin * scale, end * scale])).T / span[:, None] ** np.arange(POWERS))


# Time constants after a break at which a piece begins: what fades there is no polynomial, and is drawn through these.
NODES = np.append(0.0, np.geomspace(0.5, 20.0, 9))
NEAR = 0.99  # of a piece, beyond which a node is not worth a piece of its own
FADED = 25.0  # time constants after the end at which the arm stands still


def lagged(motion: Motion, lag: float) -> Motion:
    """Return a motion as a motor with a first-order lag makes it: lag * y' + y = u, with y = u at the start.

    Parameters
    ----------
    motion : Motion
        Of the arm alone, from rest to rest; it does not repeat.
    lag : float
        Time constant, s, >= 0; 0 returns the motion itself.

    Returns
    -------
    Motion
        Value, rate and acceleration are exact where pieces meet; between them it is accurate to about 1e-4 of the
        decaying part (1e-6 rad for a lag of 10 ms at 24 rad/s^2).

    Raises
    ------
    InvalidInput
        A motion that repeats, or that moves the pivot or gives a torque.

    Examples
    --------
    >>> from hyperflex.motion import move_arm
    >>> slow = lagged(move_arm(0.0, 1.0, duration=0.5), 0.05)
    >>> [round(float(angle), 3) for angle in slow.angle([0.25, 0.5, 1.0])]
    [0.34, 0.961, 1.0]
    """
    lag = checks.number("lag", lag, sign="nonnegative", unit="s")
    others = np.delete(motion.coef, ANGLE, axis=1)
    if motion.loop >= 0 or others[..., 1:].any() or np.ptp(others[..., 0], axis=0).any():
        raise InvalidInput(
            "only the arm's angle lags", got=motion.spec or "pieces", allowed="a motion of the arm, once"
        )
    if lag == 0.0:
        return motion
    rest = np.append(motion.angle(motion.end), np.zeros(POWERS - 1))  # after the last break
    spans = np.append(np.diff(motion.breaks), FADED * lag)
    value, starts, ends = float(motion.coef[0, ANGLE, 0]), [], []
    for begin, span, asked in zip(motion.breaks, spans, [*motion.coef[:, ANGLE], rest], strict=True):
        s = np.append(NODES[NODES * lag < NEAR * span] * lag, span)
        steady = np.linalg.solve(np.eye(POWERS) + lag * DERIVATIVE, asked)  # a polynomial that solves the equation
        fading = (value - steady[0]) * np.exp(-s / lag)
        states = np.array([polyval(s, _derived(steady, k)) + fading * (-1.0 / lag) ** k for k in range(3)])
        value = states[0, -1]
        starts.append(begin + s[:-1])
        ends.append(states)
    states[:, -1] = rest[:3]
    breaks = np.append(np.concatenate(starts), motion.end + spans[-1])
    coef = np.zeros((breaks.size - 1, CHANNELS, POWERS))
    coef[:, :, 0] = motion.coef[0, :, 0]
    befores, afters = (np.concatenate([each[:, part] for each in ends], axis=1) for part in (slice(-1), slice(1, None)))
    coef[:, ANGLE] = quintics(befores, afters, np.diff(breaks))
    return Motion(breaks, coef, np.isin(breaks, [*motion.breaks, breaks[-1]]))
