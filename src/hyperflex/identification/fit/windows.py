"""Windows: short parts of a recording, each with an initial state of its own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.model import Rope
from hyperflex.recording import Recording

# samples a window; more of them repeat what their neighbours say and only cost time
DENSEST = 200
# samples a window, where the recording allows it
FEWEST_SAMPLES = 8
# values of each link's angle in a window, ten for each unknown of its state, where the recording allows it
FEWEST_SEEN = 20
# periods
PERIODS = 1.2
# rad a link may turn within a window, as rms rate times time: beyond it fits find false minima
MOST_TURN = 8.0
# part of a window for which a link may be out of sight
BLIND = 0.5
# values of a link's angle in a window
LEAST_VALUES = 4
# rad by which a shape must differ from another to be a start of its own
ASIDE = 0.3
# of weighted least squares that come near to least absolute errors
ABSOLUTE_ROUNDS = 8
# rad, a recording that moves less holds no dynamics
STILL = 0.001
WEIGHTLESS = 1.0  # s, taken for the period of a swing where nothing pulls


@dataclass(frozen=True)
class Window:
    """Measurements over a short time, with a first guess of the state.

    t (m,) s; y (m, C) rad or m, with 0 in gaps; weight (m, C), 1 / rad or 1 / m, 0 in gaps; guess (2n,) of the state at
    t[0]; prior (r, 2n): linear combinations of the state that are 0, in units of their standard deviations. others:
    further guesses, of shapes that look alike.
    """

    t: Array
    y: Array
    weight: Array
    guess: Array
    prior: Array
    others: tuple[Array, ...] = ()

    @property
    def values(self) -> int:
        """Number of measured values, gaps left out."""
        return int(np.count_nonzero(self.weight))

    @property
    def unknowns(self) -> int:
        """Size of the state, less the rows of the prior."""
        return int(self.guess.size - self.prior.shape[0])

    def prior_cost(self, state: Array) -> float:
        """Return the sum of squares of a state's residuals under the prior."""
        residual = self.prior @ state
        return float(residual @ residual)


def part_left(windows: Sequence[Window], residuals: Sequence[Array]) -> float:
    """Return the residuals [(m C,), ..] as a part of the motion about each window's mean, rms of both; inf without."""
    left, moved = 0.0, 0.0
    for window, residual in zip(windows, residuals, strict=True):
        known = window.weight > 0.0
        left += float((residual**2).sum())
        mean = (window.weight * window.y).sum(axis=0) / np.maximum(window.weight.sum(axis=0), 1e-300)
        moved += float(((np.where(known, window.y - mean, 0.0) * window.weight) ** 2).sum())
    return float(np.sqrt(left / moved)) if moved > 0.0 else np.inf


def swing_period(rope: Rope) -> float:
    """Return the period, s, of a small swing of a straight rod as long as the rope; inf without gravity."""
    gravity = float(np.hypot(*rope.gravity))
    return 2.0 * np.pi * float(np.sqrt(2.0 * rope.total_length / (3.0 * gravity))) if gravity > 0.0 else np.inf


def usual_length(recording: Recording, rope: Rope, fewest: int = FEWEST_SEEN) -> float:
    """Return a window length (s): some periods of a small swing of a rod as long as the rope, less for fast links.

    It is doubled until it holds ``FEWEST_SEEN`` values of each link.
    """
    period = swing_period(rope) if rope.gravity.any() else WEIGHTLESS
    fastest = max(rms_rate(recording.t, column) for column in recording.data.T)
    spacing = float(np.median(np.diff(recording.t)))
    length = max(min(PERIODS * period, MOST_TURN / max(fastest, 1e-300)), FEWEST_SAMPLES * spacing)
    seen = float((~np.isnan(recording.data)).mean(axis=0).min()) * length / spacing
    return float(length * 2.0 ** np.ceil(np.log2(fewest / seen))) if 0.0 < seen < fewest else length


def rms_rate(t: Array, angle: Array) -> float:
    """Return the rms rate (rad/s) over steps of at least a two-hundredth of the recording or 10 ms, noise left out."""
    known = ~np.isnan(angle)
    t, angle = t[known], angle[known]
    if angle.size > 2:  # a single sample that is far off is no motion
        angle = np.median([angle[:-2], angle[1:-1], angle[2:]], axis=0)
        t = t[1:-1]
    least = min(0.01, (t[-1] - t[0]) / 200.0)
    picked = [0]
    for k in range(1, t.size):
        if t[k] - t[picked[-1]] >= least:
            picked.append(k)
    turned, taken = np.diff(angle[picked]), np.diff(t[picked])
    return float(np.sqrt((turned**2 / taken).sum() / taken.sum())) if taken.size else 0.0


def decimation_step(recording: Recording, length: float) -> int:
    """Return the step of the decimation that leaves at most ``DENSEST`` samples a window."""
    spacing = float(np.median(np.diff(recording.t)))
    return max(1, int(length / (spacing * DENSEST)))


def cut_windows(
    recording: Recording,
    length: float,
    shape: Recording | None = None,
    prior: Array | None = None,
    sides: Sequence[Array] = (),
) -> tuple[list[Window], int]:
    """Cut a recording into windows of `length` (s), [start, start + length); return them and the number left out.

    Windows are left out where some link has too few values, or too long a gap, to tell its angle and rate. `shape`
    holds link angles for first states, by default the recording itself, `sides` others (T, n); prior (r, 2n): see
    :class:`Window`.
    """
    t, data, noise = recording.t, recording.data, recording.noise
    weight = np.where(np.isnan(data), 0.0, 1.0 if noise is None else 1.0 / noise)
    y = np.where(np.isnan(data), 0.0, data)
    angles = (shape or recording).data
    prior = np.zeros((0, 2 * angles.shape[1])) if prior is None else prior
    spacing = float(np.median(np.diff(t)))
    number = np.floor((t - t[0]) / length + 1e-6 * spacing / length).astype(int)
    windows, dropped = [], 0
    for k in np.unique(number):
        rows = number == k
        known = ~np.isnan(angles[rows])
        span = t[rows][-1] - t[rows][0]
        if known.sum(axis=0).min() < LEAST_VALUES or span < 0.5 * length or _longest_gap(t[rows], known) > BLIND * span:
            dropped += 1
            continue
        guess, *others = (first_state(t[rows], each[rows]) for each in (angles, *sides))
        others = [each for each in others if np.abs(each - guess)[: angles.shape[1]].max() > ASIDE]
        windows.append(Window(t[rows], y[rows], weight[rows], guess, prior, tuple(others)))
    return windows, dropped


def _longest_gap(t: Array, known: npt.NDArray[np.bool_]) -> float:
    return max(float(np.diff(np.concatenate([t[:1], t[column], t[-1:]])).max()) for column in known.T)


def first_state(t: Array, angles: Array) -> Array:
    """Return a guess of the state (2n,) at t[0]: a cubic through each link's first angles (m, n), NaN in gaps."""
    n = angles.shape[1]
    state = np.zeros(2 * n)
    for k in range(n):
        known = np.flatnonzero(~np.isnan(angles[:, k]))
        few = known[: max(6, known.size // 5)]
        tau = t[few] - t[0]
        state[k], state[n + k] = _value_and_slope(tau / max(tau[-1], 1e-9), angles[few, k])
        state[n + k] /= max(tau[-1], 1e-9)
    return state


def nearest_turn(state: Array, guess: Array) -> Array:
    """Return a state (2n,) with whole turns added to its angles, so that they come near to those of a guess (2n,)."""
    n = state.size // 2
    return np.append(state[:n] + 2.0 * np.pi * np.round((guess[:n] - state[:n]) / (2.0 * np.pi)), state[n:])


def _value_and_slope(tau: Array, y: Array) -> tuple[float, float]:
    """Return value and slope at 0 of the cubic nearest to y (m,), by least absolute errors: no outlier tilts it."""
    powers = np.vander(tau, min(3, tau.size - 2) + 1, increasing=True)
    weight = np.ones(tau.size)
    for _ in range(ABSOLUTE_ROUNDS):
        found = np.linalg.lstsq(powers * weight[:, None], y * weight, rcond=None)[0]
        away = np.abs(powers @ found - y)
        weight = 1.0 / np.sqrt(np.maximum(away, 0.1 * away.mean() + 1e-12))
    return float(found[0]), float(found[1])
