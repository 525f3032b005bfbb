"""Measured and fitted channels, for figures and tables."""

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import Identification
from hyperflex.recording import Recording

FEW = 4  # channels that are all shown large


@dataclass(frozen=True, eq=False)
class FittedChannels:
    """A recording and its fit in the same channels.

    All measured angles or positions, and the fit at the fitted samples. The `chosen` channels are the most informative:
    first, middle and last link, or middle and last marker, and the one with the worst fit.
    """

    found: Identification
    t: Array  # (T,) s
    measured: Array  # (T, C) rad or m; NaN in gaps
    fit_t: Array  # (m,) s
    fitted: Array  # (m, C) rad or m; NaN in gaps
    names: tuple[str, ...]  # of the channels, counted from 0 as in the verdict
    chosen: tuple[int, ...]

    @property
    def end(self) -> float:
        """End of the fitted samples, s."""
        return float(self.found.settings["fitted_to"])

    @property
    def window(self) -> Array:
        """Number (m,) of the window of each fitted sample."""
        step = float(np.median(np.diff(self.t)))
        length = min(float(self.found.settings["window"]), 2.0 * (self.t[-1] - self.t[0]))
        return np.asarray(np.floor((self.fit_t - self.fit_t[0]) / length + 1e-6 * step / length))

    def worst_window(self, channel: int) -> tuple[float, float, float]:
        """Return the number, and first and last time, s, of the window in which a channel fits worst."""
        number = self.window
        squares = self.found.residuals[:, channel] ** 2
        means = {k: float(np.nanmean(s)) for k in np.unique(number) if not np.isnan(s := squares[number == k]).all()}
        worst = max(means, key=lambda k: means[k])
        inside = self.fit_t[number == worst]
        return float(worst), float(inside[0]), float(inside[-1])


def fitted_channels(recording: Recording, found: Identification) -> FittedChannels:
    """Return a recording and its fit in the same channels."""
    channels = recording.angles() if found.unit == "rad" else recording
    rows = np.searchsorted(channels.t, found.residual_t)
    fitted = np.asarray(channels.data[rows] - found.residuals)
    names, chosen = _names(channels, found), _chosen(found)
    return FittedChannels(found, channels.t, channels.data, found.residual_t, fitted, names, chosen)


def _names(channels: Recording, found: Identification) -> tuple[str, ...]:
    if found.unit == "rad":
        return tuple(f"link {k}" for k in range(channels.n_links))
    return tuple(f"marker {k}, {axis}" for k in range(channels.data.shape[1] // 2) for axis in "xy")


def _chosen(found: Identification) -> tuple[int, ...]:
    """Return the channels to show: all of a few, see :class:`FittedChannels`; of a marker both places."""
    rms = found.residual_rms
    if rms.size <= FEW:
        return tuple(range(rms.size))
    if found.unit == "rad":
        return tuple(sorted({0, rms.size // 2, rms.size - 1, int(np.argmax(rms))}))
    last, worst = rms.size // 2 - 1, int(np.argmax(np.hypot(rms[::2], rms[1::2])))
    return tuple(c for k in sorted({last // 2, last, worst}) for c in (2 * k, 2 * k + 1))
