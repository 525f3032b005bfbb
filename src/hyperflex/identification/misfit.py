"""What a fit leaves of each channel, beside how much that moves and beside the noise that was declared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.fit.loss import NORMAL, Loss
from hyperflex.identification.fit.windows import Window

POOR = 0.2  # part of the motion that may stay unexplained before the verdict calls the fit poor
NOISY = 1.5  # times the declared noise: what stays below is as good as the recording, however little moves


def poor(windows: Sequence[Window], residuals: Array, unit: str, loss: Loss) -> list[str]:
    """Return a warning where the model leaves much of the motion unexplained.

    Parameters
    ----------
    windows : sequence of Window
    residuals : (m, C) array, rad or m
        Of all windows, NaN in gaps; further channels of the windows, a torque, are not looked at.
    unit : str
    loss : Loss
        Under a robust one outliers do not count: it is the usual size of residuals that must be small.
    """
    rms, spread, noise = _sizes(windows, residuals, 0, loss)
    worst = int(np.argmax(np.where(rms > NOISY * noise, rms / np.maximum(spread, 1e-12), 0.0)))
    if rms[worst] <= max(POOR * spread[worst], NOISY * noise[worst]):
        return []
    what = f"link {worst}" if unit == "rad" else f"marker {worst // 2}"
    text = (
        f"The fit is poor: {what} is {rms[worst]:.3g} {unit} off, and moves by {spread[worst]:.3g} {unit} (rms) within "
        "the windows. Check the recording's units, zero and sense, the link lengths, the base's motion and the guess."
    )
    return [text]


def poor_torque(windows: Sequence[Window], residuals: Array | None, loss: Loss) -> list[str]:
    """Return a warning where the model leaves much of the motor's torque unexplained; `residuals` (m,) in N m."""
    if residuals is None:
        return []
    (rms,), (spread,), (noise,) = _sizes(windows, residuals[:, None], windows[0].y.shape[1] - 1, loss)
    if rms <= max(POOR * spread, NOISY * noise):
        return []
    text = (
        f"The torque does not fit: it is {rms:.3g} N m off, and moves by {spread:.3g} N m (rms) within the windows. "
        "Check its sign (positive turns the arm the way in which its angle grows) and its unit, N m; until it fits, "
        "masses, inertias and frictions mean nothing."
    )
    return [text]


def _sizes(windows: Sequence[Window], residuals: Array, first: int, loss: Loss) -> tuple[Array, Array, Array]:
    """Return sizes (C,) of residuals, motion and declared noise, of the windows' channels from `first` on."""
    part = slice(first, first + residuals.shape[1])
    known = [np.where(w.weight > 0.0, w.y, np.nan)[:, part] for w in windows]
    weights = np.concatenate([w.weight for w in windows])[:, part]
    with np.errstate(divide="ignore"):
        noise = np.sqrt(np.nanmean(np.where(weights > 0.0, 1.0 / weights**2, np.nan), axis=0))
    noise = np.where(((weights == 0.0) | (weights == 1.0)).all(axis=0), 0.0, noise)  # not declared
    spread = np.sqrt(np.mean([np.nanvar(y, axis=0) for y in known], axis=0))
    if loss.name == "squares":
        return np.sqrt(np.nanmean(residuals**2, axis=0)), spread, noise
    return NORMAL * np.nanmedian(np.abs(residuals), axis=0), spread, noise
