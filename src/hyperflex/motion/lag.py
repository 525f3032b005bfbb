"""A motion behind a motor with lag: a first-order filter of the arm angle."""

import math

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import CHANNELS, POWERS, Motion

# Time constants after a break at which a piece ends: what fades there is no polynomial, and is drawn through these.
NODES = np.geomspace(0.5, 20.0, 9)
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
        Value, rate and acceleration are exact where pieces meet; between them it is right to some 1e-4 of what fades
        (1e-6 rad for a lag of 10 ms at 24 rad/s^2).

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
    breaks, still = motion.breaks, np.zeros(POWERS)
    still[0] = float(motion.angle(breaks[-1]))
    answers = _answers(np.vstack([motion.coef[:, ANGLE], still]), lag)
    spans = np.append(np.diff(breaks), lag * FADED)
    behind, ends = np.zeros(spans.size), _polynomials(answers, spans, 0)
    value = float(motion.coef[0, ANGLE, 0])
    for k, (start, end, fade) in enumerate(zip(answers[:, 0], ends, np.exp(-spans / lag), strict=True)):
        behind[k] = value - start
        value = end + behind[k] * fade
    nodes = lag * np.array([0.0, *NODES, np.inf])
    begins = np.append(np.ones((spans.size, 1), dtype=bool), nodes[1:-1] < 0.99 * spans[:, None], axis=1)
    piece, node = np.nonzero(begins)
    last = np.append(piece[1:] != piece[:-1], True)
    since, until = nodes[node], np.where(last, spans[piece], nodes[node + 1])
    one, two = (_states(answers[piece], behind[piece], lag, s) for s in (since, until))
    two[-1] = still[:3]
    coef = np.zeros((piece.size, CHANNELS, POWERS))
    coef[:] = motion.coef[0] * (np.arange(POWERS) == 0)
    coef[:, ANGLE] = _hermite(one, two, until - since)
    at = np.concatenate([breaks[:1], breaks[piece] + until])
    return Motion(at, coef, np.append(node == 0, True))


def _answers(pieces: Array, lag: float) -> Array:
    """Coefficients (P, POWERS) of the polynomials that solve the filter's equation for those of the input."""
    answers, change = np.zeros(pieces.shape), pieces
    for k in range(POWERS):
        answers += (-lag) ** k * change
        change = np.append(change[:, 1:] * np.arange(1, POWERS), np.zeros((len(pieces), 1)), axis=1)
    return answers


def _polynomials(coef: Array, s: Array, derivative: int) -> Array:
    """Derivatives (P,) of polynomials with coefficients (P, POWERS) at times s (P,)."""
    some = np.arange(derivative, POWERS)
    factors = np.array([math.perm(k, derivative) for k in some.tolist()])
    return np.asarray((factors * coef[:, some] * s[:, None] ** (some - derivative)).sum(axis=1))


def _states(answers: Array, behind: Array, lag: float, s: Array) -> Array:
    """Angles, rates and accelerations (P, 3) at times s (P,) into pieces; `behind` (P,): angles less answers at 0."""
    fading = behind * np.exp(-s / lag)
    return np.stack([fading * (-1.0 / lag) ** d + _polynomials(answers, s, d) for d in range(3)], axis=1)


def _hermite(one: Array, two: Array, span: Array) -> Array:
    """Coefficients (P, POWERS) of the fifth-order polynomials between states (P, 3) that lie `span` (P,) apart."""
    a, b, c = one[:, 0], one[:, 1] * span, 0.5 * one[:, 2] * span**2
    p = two[:, 0] - a - b - c
    v = two[:, 1] * span - b - 2.0 * c
    w = two[:, 2] * span**2 - 2.0 * c
    top = [10.0 * p - 4.0 * v + 0.5 * w, -15.0 * p + 7.0 * v - w, 6.0 * p - 3.0 * v + 0.5 * w]
    return np.asarray(np.stack([a, b, c, *top], axis=1) / span[:, None] ** np.arange(POWERS))
