"""A motion behind a motor with lag: a first-order filter of the arm angle."""

import math
from itertools import pairwise

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import CHANNELS, POWERS, Motion

# Time constants after a break at which a piece ends: what fades there is no polynomial, and is drawn through these.
NODES = (0.5, 1.0, 1.75, 2.75, 4.0, 6.0, 9.0, 13.0, 20.0)
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
    still = np.zeros(POWERS)
    still[0] = float(motion.angle(motion.breaks[-1]))
    breaks, rows, switch = [float(motion.breaks[0])], [], []
    value = float(motion.coef[0, ANGLE, 0])
    spans = [*np.diff(motion.breaks).tolist(), lag * FADED]
    for begin, span, piece in zip(motion.breaks.tolist(), spans, [*motion.coef[:, ANGLE], still], strict=True):
        answer = _answer(piece, lag)
        edges = [0.0, *(lag * node for node in NODES if lag * node < 0.99 * span), span]
        states = [_state(answer, value - answer[0], lag, s) for s in edges]
        if piece is still:
            states[-1] = still[:3]
        pairs = zip(pairwise(states), pairwise(edges), strict=True)
        rows += [_hermite(one, two, b - a) for (one, two), (a, b) in pairs]
        breaks += [begin + s for s in edges[1:]]
        switch += [True] + [False] * (len(edges) - 2)
        value = float(states[-1][0])
    coef = np.zeros((len(rows), CHANNELS, POWERS))
    coef[:] = motion.coef[0] * (np.arange(POWERS) == 0)
    coef[:, ANGLE] = rows
    return Motion(np.array(breaks), coef, np.array([*switch, True]))


def _answer(piece: Array, lag: float) -> Array:
    """Coefficients (POWERS,) of the polynomial that solves the filter's equation for a polynomial input."""
    answer, change = np.zeros(POWERS), np.array(piece)
    for k in range(POWERS):
        answer += (-lag) ** k * change
        change = np.append(change[1:] * np.arange(1, POWERS), 0.0)
    return answer


def _state(answer: Array, behind: float, lag: float, s: float) -> Array:
    """Angle, rate and acceleration (3,) at a time `s` into a piece."""
    fading = behind * math.exp(-s / lag)
    found = [fading, -fading / lag, fading / lag**2]
    for d in range(3):
        found[d] += sum(math.perm(k, d) * float(answer[k]) * s ** (k - d) for k in range(d, POWERS))
    return np.array(found)


def _hermite(one: Array, two: Array, span: float) -> Array:
    """Coefficients (POWERS,) of the fifth-order polynomial between two states (3,) that lie `span` apart."""
    a, b, c = one[0], one[1] * span, 0.5 * one[2] * span**2
    p = two[0] - a - b - c
    v = two[1] * span - b - 2.0 * c
    w = two[2] * span**2 - 2.0 * c
    top = [10.0 * p - 4.0 * v + 0.5 * w, -15.0 * p + 7.0 * v - w, 6.0 * p - 3.0 * v + 0.5 * w]
    return np.asarray(np.array([a, b, c, *top]) / span ** np.arange(POWERS))
