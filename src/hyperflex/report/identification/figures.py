"""Figures of an identification: fit and data, residuals, prediction with its band, values along the rope."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import BAND, HeldOut, Identification
from hyperflex.model import PROPERTIES, Rope
from hyperflex.recording import Recording
from hyperflex.report.identification.tables import numbers
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, Axes, Figure, legend, new_figure, style_context
from hyperflex.report.units import amount, readable_unit

_WIDTH = 10.0  # inches, of every figure on the page
FEW = 4  # channels that are all shown large


class FittedChannels:
    """A recording and its fit in the same channels.

    All measured angles or positions, and the fit at the fitted samples. The `chosen` channels are the most informative:
    first, middle and last link, or middle and last marker (both places), and the one with the worst fit; all of a few.

    Attributes
    ----------
    t, measured : (T,) s, (T, C) rad or m
        NaN in gaps.
    fit_t, fitted, window : (m,) s, (m, C) rad or m, (m,) int
        The fit, NaN in gaps, and the number of the window of each sample.
    names : tuple of str
        Of the channels, counted from 0 as in the assessment.
    chosen : tuple of int
    end : float
        End of the fitted samples, s.
    """

    def __init__(self, recording: Recording, found: Identification, chosen: tuple[int, ...] = ()) -> None:
        angles, rms = found.unit == "rad", found.residual_rms
        channels = recording.angles() if angles else recording
        self.found, self.t, self.measured, self.fit_t = found, channels.t, channels.data, found.residual_t
        self.fitted = found.fitted
        step, length = float(np.median(np.diff(self.t))), float(found.settings["window"])
        length = min(length, 2.0 * (self.t[-1] - self.t[0]))
        self.window = np.floor((self.fit_t - self.fit_t[0]) / length + 1e-6 * step / length).astype(int)
        self.end = float(found.settings["fitted_to"])
        sizes = rms[:, None] if angles else rms.reshape(-1, 2)  # of each link, or each marker's x and y
        count, wide = sizes.shape
        some = {count - 1, int(np.argmax(np.linalg.norm(sizes, axis=1)))}
        some |= {0, count // 2} if angles else {(count - 1) // 2}
        picked = sorted(some) if rms.size > FEW else range(count)
        self.chosen = chosen or tuple(wide * k + side for k in picked for side in range(wide))
        every = [f"link {k}" for k in range(count)], [f"marker {k}, {axis}" for k in range(count) for axis in "xy"]
        self.names = tuple(every[0 if angles else 1])

    def rms_title(self, channel: int, digits: int = 3) -> str:
        """Return a channel's name and residual."""
        return f"{self.names[channel]}: {amount(self.found.residual_rms[channel], self.found.unit, digits)}"

    def worst_window(self, channel: int) -> tuple[int, float, float]:
        """Return the number, and first and last time, s, of the window in which a channel fits worst."""
        squares = self.found.residuals[:, channel] ** 2
        sums, counts = (np.bincount(self.window, each) for each in (np.nan_to_num(squares), ~np.isnan(squares)))
        worst = int(np.argmax(sums / np.maximum(counts, 1.0)))
        inside = self.fit_t[self.window == worst]
        return worst, float(inside[0]), float(inside[-1])


def broken(axis: Any, t: Array, values: Array, number: Any = None, **style: Any) -> None:
    """Draw a line that breaks where samples are missing, and between parts of different `number` (m,)."""
    step = np.diff(t)
    ends = step > 3.0 * np.median(step)
    if number is not None:
        ends |= np.diff(number) != 0
    breaks = np.flatnonzero(ends) + 1
    axis.plot(np.insert(t, breaks, np.nan), np.insert(values, breaks, np.nan), **style)


def samples(axis: Any, t: Array, values: Array, many: int = 120) -> None:
    """Draw measured samples: rings if they are few, dots if they are `many`."""
    if t.size < many:
        axis.plot(t, values, "o", ms=4.0, mfc="none", mec=INK, mew=0.7, label="measured")
    else:
        axis.plot(t, values, ".", ms=2.0, color=GREY, label="measured")


def fit_figure(view: FittedChannels, ax: Axes | None = None) -> Figure:
    """Draw the chosen channels over the whole time, and the window with the worst fit of each.

    With axes `ax`, draw the channel that fits worst into them.
    """
    if ax is not None:
        with style_context():
            _draw_titled(ax, view, int(np.argmax(view.found.residual_rms)))
            ax.set_xlabel("time, s")
            ax.legend(loc="upper right", frameon=True)
        return ax.figure  # type: ignore[return-value] # or the subfigure
    zoomed = np.unique(view.window).size > 3  # so few are seen well enough on the whole
    with _rows(view, 2 if zoomed else 1, (2.6, 1.0) if zoomed else None) as (figure, axes):
        for row, channel in zip(axes, view.chosen, strict=True):
            _draw_titled(row[0], view, channel)
            if zoomed:
                _draw_worst(row[1], view, channel)
        legend(figure, axes[0, 0])
    return figure


@contextmanager
def _rows(view: FittedChannels, columns: int, widths: tuple[float, ...] | None = None) -> Iterator[tuple[Figure, Any]]:
    """Yield a figure with a row of axes for each chosen channel, over time."""
    with new_figure(_WIDTH, 0.9 + 1.75 * len(view.chosen)) as figure:
        axes = figure.subplots(len(view.chosen), columns, squeeze=False, width_ratios=widths)
        for axis in axes[-1]:
            axis.set_xlabel("time, s")
        yield figure, axes


def _draw_titled(axis: Any, view: FittedChannels, channel: int) -> None:
    """Draw a channel over the whole time, with its residual in the title."""
    _draw_fit(axis, view, channel)
    axis.set(title=f"{view.rms_title(channel)} rms", ylabel=_label(view, channel), xlim=view.t[[0, -1]])


def _draw_fit(axis: Any, view: FittedChannels, channel: int) -> None:
    samples(axis, view.t, view.measured[:, channel])
    broken(axis, view.fit_t, view.fitted[:, channel], view.window, color=BLUE, label="fitted")
    held = view.found.held_out
    if held is not None:
        axis.axvspan(view.end, view.t[-1], color=RED, alpha=0.06, lw=0, label="held out")
        _draw_predicted(axis, held, channel)


def _draw_predicted(axis: Any, held: HeldOut, channel: int) -> None:
    value = np.where(np.isfinite(held.predicted[:, channel]), held.predicted[:, channel], np.nan)
    broken(axis, held.t, value, held.began, color=RED, label="predicted without data")


def _draw_worst(axis: Any, view: FittedChannels, channel: int) -> None:
    """Draw the worst window with its neighbours' nearest parts."""
    number, start, end = view.worst_window(channel)
    reach = 0.75 * (end - start)
    near, fit_near = (np.abs(t - 0.5 * (start + end)) <= reach for t in (view.t, view.fit_t))
    axis.axvspan(start, end, color=BLUE, alpha=0.06, lw=0)
    samples(axis, view.t[near], view.measured[near, channel])
    broken(axis, view.fit_t[fit_near], view.fitted[fit_near, channel], view.window[fit_near], color=BLUE)
    worst = float(np.sqrt(np.nanmean(view.found.residuals[view.window == number, channel] ** 2)))
    axis.set_title(f"its worst window: {amount(worst, view.found.unit)}")
    axis.locator_params(axis="x", nbins=4)


def _label(view: FittedChannels, channel: int) -> str:
    return "angle, rad" if view.found.unit == "rad" else f"{view.names[channel][-1]}, m"


def prediction_figure(view: FittedChannels, held: HeldOut) -> Figure:
    """Draw the held-out part and its prediction, and the error with its expected band."""
    with _rows(view, 2) as (figure, axes):
        for row, channel in zip(axes, view.chosen, strict=True):
            inside = view.t >= view.end
            samples(row[0], view.t[inside], view.measured[inside, channel])
            _draw_predicted(row[0], held, channel)
            row[0].set(ylabel=_label(view, channel), title=view.names[channel])
            _draw_error(row[1], view, held, channel)
        legend(figure, *axes[0])
    return figure


def _draw_error(axis: Any, view: FittedChannels, held: HeldOut, channel: int) -> None:
    predicted, rms, number = held.predicted[:, channel], held.rms[channel], held.began
    error = held.measured[:, channel] - np.where(np.isfinite(predicted), predicted, np.nan)
    greatest = float(np.nanmax(np.abs(error), initial=0.0))
    unit = readable_unit(view.found.unit, rms if np.isfinite(rms) else greatest)
    error, band = error / unit.size, BAND * held.std[:, channel] / unit.size
    for k in np.unique(number):
        part = number == k
        label = "expected for 95 %" if k == 0 else None
        axis.fill_between(held.t[part], -band[part], band[part], color=RED, alpha=0.18, lw=0, label=label)
    axis.plot(held.t, error, ".", ms=2.5, color=INK, label="error")
    for start in held.failed:
        axis.axvspan(start, start + held.ahead, color=RED, alpha=0.3, lw=0)
    size = f"{amount(rms, view.found.unit)} rms" if np.isfinite(rms) else "failed where dark"
    tallest = max(1.1 * greatest / unit.size, np.nanquantile(np.append(band, 0.0), 0.97)) or 1.0
    axis.set(ylabel=f"error, {unit.name}", title=f"measured minus predicted: {size}", ylim=(-tallest, tallest))


def residual_figure(view: FittedChannels) -> Figure:
    """Draw the residuals of the chosen channels: over time, and their autocorrelation."""
    found = view.found
    with _rows(view, 2, (2.2, 1.3)) as (figure, axes):
        for row, channel in zip(axes, view.chosen, strict=True):
            unit = readable_unit(found.unit, found.residual_rms[channel])
            values = found.residuals[:, channel] / unit.size
            row[0].plot(view.fit_t, values, ".", ms=2.0, color=BLUE)
            row[0].axhline(0.0, color=GREY, lw=0.8)
            row[0].set(ylabel=f"residual, {unit.name}", title=view.names[channel])
            correlation, band = correlations(values)
            lag = 1 + np.arange(band.size)
            row[1].fill_between(lag, -band, band, color=GREEN, alpha=0.2, lw=0)
            row[1].vlines(lag, 0.0, correlation, color=BLUE, lw=1.4)
            row[1].axhline(0.0, color=GREY, lw=0.8)
            row[1].set(ylim=(-1.0, 1.0), xlabel="lag, samples" if channel == view.chosen[-1] else "")
        axes[0, 1].set_title("autocorrelation; shaded: white")
    return figure


def correlations(values: Array, lags: int = 40) -> tuple[Array, Array]:
    """Return the autocorrelations of a channel (m,), NaN in gaps, at 1 to `lags` samples, and 95 % of white noise."""
    from scipy.signal import correlate

    known = np.isfinite(values)
    both = (known.astype(np.float64), np.nan_to_num(values - np.nanmean(values)))
    pairs, products = (correlate(each, each)[values.size - 1 :][: lags + 1] for each in both)
    pairs = np.maximum(pairs, 0.5)  # where no two samples are so far apart
    return (products / pairs)[1:] * pairs[0] / max(products[0], 1e-300), 1.96 / np.sqrt(pairs[1:])


def multiples_figure(view: FittedChannels, columns: int = 4) -> Figure:
    """Draw small multiples of all channels: measured, fitted, predicted."""
    rows = -(-len(view.names) // columns)
    with new_figure(_WIDTH, 0.5 + 1.15 * rows) as figure:
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
        for channel, axis in enumerate(axes[: len(view.names)]):
            _draw_fit(axis, view, channel)
            axis.set_title(view.rms_title(channel, 2), fontsize=8.0)
            axis.tick_params(labelsize=7.0)
            axis.locator_params(nbins=4)
        for axis in axes[len(view.names) :]:
            axis.set_axis_off()
    return figure


def shapes_figure(view: FittedChannels, instants: int = 5) -> Figure:
    """Draw markers and fit in the plane at several instants of the fitted time."""
    fitted = view.fitted.reshape(view.fit_t.size, -1, 2)
    measured = fitted + view.found.residuals.reshape(fitted.shape)
    whole = np.flatnonzero(~np.isnan(fitted).any(axis=(1, 2)))
    rows = whole if whole.size else np.arange(view.fit_t.size)
    picked = rows[np.unique(np.linspace(0, rows.size - 1, instants).round().astype(int))]
    low, high = np.nanmin(fitted, axis=(0, 1)), np.nanmax(fitted, axis=(0, 1))
    wide, tall = high - low
    ends = np.stack([low, high], axis=1) + 0.05 * float(max(wide, tall)) * np.array([-1.0, 1.0])
    height = float(np.clip(tall / max(wide, 1e-9), 0.6, 2.2)) * (_WIDTH / picked.size)
    with new_figure(_WIDTH, 0.7 + height) as figure:
        axes = figure.subplots(1, picked.size, squeeze=False, sharex=True, sharey=True)[0]
        for axis, row in zip(axes, picked, strict=True):
            axis.plot(*fitted[row].T, "-", color=BLUE, lw=1.2)
            axis.plot(*measured[row].T, "o", ms=4.0, mfc="none", mec=INK, mew=0.8)
            axis.set(aspect="equal", title=f"{view.fit_t[row]:.3g} s", xlabel="x, m", xlim=ends[0], ylim=ends[1])
            axis.locator_params(nbins=4)
        axes[0].set_ylabel("y, m")
    return figure


def along_figure(found: Identification, guess: Rope | None = None, least: int = 6) -> Figure | None:
    """Draw each property with values of their own for so many links, with 95 % intervals; None if there is none.

    Fewer are read in a table.
    """
    own: dict[str, list[tuple[float, ...]]] = {}
    for each in numbers(found):
        if each.place is not None and PROPERTIES[each.name].owner == "link":
            own.setdefault(each.name, []).append((each.place, each.value, each.low, each.high, each.start))
    shown = {name: np.array(rows).T for name, rows in own.items() if len(rows) >= least}
    if not shown:
        return None
    with new_figure(_WIDTH, 0.5 + 2.0 * len(shown)) as figure:
        axes = figure.subplots(len(shown), 1, squeeze=False, sharex=True)[:, 0]
        for axis, (name, (places, values, low, high, start)) in zip(axes, shown.items(), strict=True):
            unit = readable_unit(name, values)
            axis.vlines(places, low / unit.size, high / unit.size, color=BLUE, lw=2.0, alpha=0.45)
            axis.plot(places, values / unit.size, "o", ms=4.0, color=BLUE, label="identified, 95 % interval")
            if guess is not None:
                axis.plot(places, start / unit.size, "x", ms=4.0, color=GREY, label="first guess")
            axis.set(ylabel=unit.name, title=name.replace("_", " "))
        axes[-1].set_xlabel("link, from the first joint to the tip")
        axes[-1].locator_params(axis="x", integer=True)
        legend(figure, axes[0], columns=2)
    return figure
