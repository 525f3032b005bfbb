"""Cutting a recording into the short windows that are shot through one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope
from hyperflex.recording import Recording

DENSEST = 200  # samples a window; more of them repeat what their neighbours say and only cost time
FEWEST = 8  # samples a window, where the recording allows it
PART = 1.2  # periods
TURN = 8.0  # rad a link may turn within a window, as rms rate times time: beyond it fits find false minima
STILL = 1e-3  # rad, a recording that moves less holds no dynamics


@dataclass(frozen=True)
class Window:
    """Measured angles over a short time.

    t (m,) s; y (m, n) rad with 0 in gaps; weight (m, n), 1 / rad, 0 in gaps.
    """

    t: Array
    y: Array
    weight: Array

    @property
    def values(self) -> int:
        """How many values it holds, gaps left out."""
        return int(np.count_nonzero(self.weight))


def usual_length(recording: Recording, rope: Rope) -> float:
    """Return a window length (s): a small swing of a rod as long as the rope, or less where links turn fast.

    It depends on what is known (lengths, gravity), not on the guess of what is not: nor does the fit, then.
    """
    gravity = float(np.hypot(*rope.gravity))
    period = 2.0 * np.pi * float(np.sqrt(2.0 * rope.total_length / (3.0 * gravity))) if gravity > 0.0 else 1.0
    fastest = float(rms_rates(recording).max())
    spacing = float(np.median(np.diff(recording.t)))
    return max(min(PART * period, TURN / fastest if fastest > 0.0 else np.inf), FEWEST * spacing)


def rms_rates(recording: Recording) -> Array:
    """Return the rms angular rate (n,) of each link, rad/s."""
    return np.array([_rms_rate(recording.t, column) for column in recording.data.T])


def _rms_rate(t: Array, angle: Array) -> float:
    """Return the rms rate (rad/s) over steps of at least a two-hundredth of the recording or 10 ms, noise left out."""
    known = ~np.isnan(angle)
    t, angle = t[known], angle[known]
    least = min(0.01, (t[-1] - t[0]) / 200.0)
    picked = [0]
    for k in range(1, t.size):
        if t[k] - t[picked[-1]] >= least:
            picked.append(k)
    turned, taken = np.diff(angle[picked]), np.diff(t[picked])
    return float(np.sqrt((turned**2 / taken).sum() / taken.sum())) if taken.size else 0.0


def thin(recording: Recording, length: float) -> int:
    """Return the step of the decimation that leaves at most DENSEST samples a window."""
    spacing = float(np.median(np.diff(recording.t)))
    return max(1, int(length / (spacing * DENSEST)))


def cut(recording: Recording, length: float, noise: Array | None = None) -> tuple[list[Window], int]:
    """Cut a recording of angles into windows side by side.

    Parameters
    ----------
    recording : Recording
        Of angles.
    length : float, s
        Of each window; its samples lie in [start, start + length).
    noise : (T, n), optional
        Standard deviations; equal weights without them.

    Returns
    -------
    windows : list of Window
    dropped : int
        Windows left out because some link has too few values in them to tell its angle and rate.
    """
    t, data = recording.t, recording.data
    weight = np.where(np.isnan(data), 0.0, 1.0 if noise is None else 1.0 / noise)
    y = np.where(np.isnan(data), 0.0, data)
    spacing = float(np.median(np.diff(t)))
    number = np.floor((t - t[0]) / length + 1e-6 * spacing / length).astype(int)
    windows, dropped = [], 0
    for k in np.unique(number):
        rows = number == k
        counts = np.count_nonzero(weight[rows], axis=0)
        span = t[rows][-1] - t[rows][0]
        if counts.min() < 4 or span < 0.5 * length:
            dropped += 1
            continue
        windows.append(Window(t[rows], y[rows], weight[rows]))
    return windows, dropped


def first_state(window: Window) -> Array:
    """Return a guess of the state (2n,) at the window's start: a cubic through each link's first samples."""
    n = window.y.shape[1]
    state = np.zeros(2 * n)
    for k in range(n):
        known = np.flatnonzero(window.weight[:, k] > 0.0)
        few = known[: max(6, known.size // 5)]
        degree = min(3, few.size - 2)
        tau = window.t[few] - window.t[0]
        fit = np.polynomial.Polynomial.fit(tau, window.y[few, k], degree, domain=[0.0, max(tau[-1], 1e-9)])
        state[k], state[n + k] = fit(0.0), fit.deriv()(0.0)
    return state


def check_motion(recording: Recording) -> None:
    """Refuse recordings in which nothing moves."""
    swing = np.nanmax(recording.data, axis=0) - np.nanmin(recording.data, axis=0)
    if not (swing > STILL).any():
        raise InvalidInput(
            "nothing moves in the recording",
            got=f"largest swing {swing.max():.3g} rad",
            allowed=f"more than {STILL:g} rad",
            fix="Record a free swing, or check the unit of the angles",
        )
