"""Figures of an identification: fit and data, residuals, prediction with its band, history of the cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import BAND, HeldOut, Identification, correlogram
from hyperflex.model import Rope
from hyperflex.report.identification.fitted import FittedChannels
from hyperflex.report.identification.parameters import Number, numbers
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, legend, new_figure
from hyperflex.report.units import Unit, readable_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH = 10.0  # inches, of every figure on the page
_LAGS = 40
_COLUMNS = 4  # of small multiples
_SHAPES = 5  # instants
_FEW_WINDOWS = 3  # so few are seen well enough on the whole
_LEAST_LINKS = 6  # with values of their own; fewer are read in a table
_SPARSE, _DENSE = 120, 4000  # samples: below, each is drawn as a ring; above, as a speck


def broken(axis: Any, t: Array, values: Array, number: Array | None = None, **style: Any) -> None:
    """Draw a line that breaks where samples are missing, and between parts of different `number` (m,)."""
    step = np.diff(t)
    ends = step > 3.0 * np.median(step)
    if number is not None:
        ends |= np.diff(number) != 0
    breaks = np.flatnonzero(ends) + 1
    axis.plot(np.insert(t, breaks, np.nan), np.insert(values, breaks, np.nan), **style)


def samples(axis: Any, t: Array, values: Array) -> None:
    """Draw measured samples: rings if they are few, dots if they are many."""
    if t.size < _SPARSE:
        axis.plot(t, values, "o", ms=4.0, mfc="none", mec=INK, mew=0.7, label="measured")
    else:
        axis.plot(t, values, ".", ms=3.0 if t.size < _DENSE else 2.0, color=GREY, label="measured")


def fit_figure(view: FittedChannels) -> Figure:
    """Draw the chosen channels over the whole time, and the window with the worst fit of each."""
    zoomed = np.unique(view.window).size > _FEW_WINDOWS
    with new_figure(_WIDTH, 0.9 + 1.75 * len(view.chosen)) as figure:
        axes = figure.subplots(
            len(view.chosen), 2 if zoomed else 1, squeeze=False, width_ratios=(2.6, 1.0) if zoomed else None
        )
        for row, channel in zip(axes, view.chosen, strict=True):
            _draw_fit(row[0], view, channel)
            rms = view.found.residual_rms[channel]
            unit = readable_unit(view.found.unit, rms)
            row[0].set_title(f"{view.names[channel]}: {rms / unit.size:.3g} {unit.name} rms")
            row[0].set(ylabel=_label(view, channel), xlim=(view.t[0], view.t[-1]))
            if zoomed:
                _draw_worst(row[1], view, channel)
        for axis in axes[-1]:
            axis.set_xlabel("time, s")
        legend(figure, axes[0, 0])
    return figure


def _draw_fit(axis: Any, view: FittedChannels, channel: int) -> None:
    samples(axis, view.t, view.measured[:, channel])
    broken(axis, view.fit_t, view.fitted[:, channel], view.window, color=BLUE, label="fitted")
    held = view.found.held_out
    if held is not None:
        axis.axvspan(view.end, view.t[-1], color=RED, alpha=0.06, lw=0, label="held out")
        _draw_predicted(axis, held, channel, label="predicted without data")


def _draw_predicted(axis: Any, held: HeldOut, channel: int, **style: Any) -> None:
    value = np.where(np.isfinite(held.predicted[:, channel]), held.predicted[:, channel], np.nan)
    broken(axis, held.t, value, _stretch(held), color=RED, **style)


def _stretch(held: HeldOut) -> Array:
    """Return the number (m,) of the prediction of each sample."""
    return np.asarray(np.searchsorted(held.starts, held.t, side="left"), dtype=np.float64)


def _draw_worst(axis: Any, view: FittedChannels, channel: int) -> None:
    """Draw the worst window with its neighbours' nearest parts."""
    number, start, end = view.worst_window(channel)
    margin = 0.25 * (end - start)
    near = (view.t >= start - margin) & (view.t <= end + margin)
    fit_near = (view.fit_t >= start - margin) & (view.fit_t <= end + margin)
    axis.axvspan(start, end, color=BLUE, alpha=0.06, lw=0)
    samples(axis, view.t[near], view.measured[near, channel])
    broken(axis, view.fit_t[fit_near], view.fitted[fit_near, channel], view.window[fit_near], color=BLUE)
    worst = float(np.sqrt(np.nanmean(view.found.residuals[fit_near & (view.window == number), channel] ** 2)))
    unit = readable_unit(view.found.unit, worst)
    axis.set_title(f"its worst window: {worst / unit.size:.3g} {unit.name}")
    axis.locator_params(axis="x", nbins=4)


def _label(view: FittedChannels, channel: int) -> str:
    return "angle, rad" if view.found.unit == "rad" else f"{view.names[channel][-1]}, m"


def prediction_figure(view: FittedChannels, held: HeldOut) -> Figure:
    """Draw the held-out part and its prediction, and the error with its expected band."""
    with new_figure(_WIDTH, 0.9 + 1.75 * len(view.chosen)) as figure:
        axes = figure.subplots(len(view.chosen), 2, squeeze=False, sharex=True)
        for row, channel in zip(axes, view.chosen, strict=True):
            inside = view.t >= view.end
            samples(row[0], view.t[inside], view.measured[inside, channel])
            _draw_predicted(row[0], held, channel, label="predicted without data")
            row[0].set(ylabel=_label(view, channel), title=view.names[channel])
            _draw_error(row[1], view, held, channel)
        for axis in axes[-1]:
            axis.set_xlabel("time, s")
        legend(figure, *axes[0])
    return figure


def _draw_error(axis: Any, view: FittedChannels, held: HeldOut, channel: int) -> None:
    predicted = held.predicted[:, channel]
    error = held.measured[:, channel] - np.where(np.isfinite(predicted), predicted, np.nan)
    band = BAND * held.std[:, channel]
    rms = held.rms[channel]
    unit = readable_unit(view.found.unit, rms if np.isfinite(rms) else np.nanmax(np.abs(error), initial=0.0))
    for number in np.unique(_stretch(held)):
        part = _stretch(held) == number
        label = "expected for 95 %" if number == 1 else None
        low, high = -band[part] / unit.size, band[part] / unit.size
        axis.fill_between(held.t[part], low, high, color=RED, alpha=0.18, lw=0, label=label)
    axis.plot(held.t, error / unit.size, ".", ms=2.5, color=INK, label="error")
    for start in held.failed:
        axis.axvspan(start, start + held.ahead, color=RED, alpha=0.3, lw=0)
    told = f"{rms / unit.size:.3g} {unit.name} rms" if np.isfinite(rms) else "failed where dark"
    axis.set(ylabel=f"error, {unit.name}", title=f"measured minus predicted: {told}")
    tallest = max(1.1 * np.nanmax(np.abs(error), initial=0.0), np.nanquantile(np.append(band, 0.0), 0.97))
    axis.set_ylim(-tallest / unit.size, tallest / unit.size) if tallest > 0.0 else None


def residual_figure(view: FittedChannels) -> Figure:
    """Draw the residuals of the chosen channels: over time, histogram, and autocorrelation."""
    found = view.found
    lag, correlation, band = correlogram(view.fit_t, found.residuals, _LAGS)
    with new_figure(_WIDTH, 0.6 + 1.75 * len(view.chosen)) as figure:
        axes = figure.subplots(len(view.chosen), 3, squeeze=False, width_ratios=(2.2, 1.0, 1.3))
        for row, channel in zip(axes, view.chosen, strict=True):
            unit = readable_unit(found.unit, found.residual_rms[channel])
            values = found.residuals[:, channel] / unit.size
            row[0].plot(view.fit_t, values, ".", ms=2.0, color=BLUE)
            row[0].axhline(0.0, color=GREY, lw=0.8)
            row[0].set(ylabel=f"residual, {unit.name}", title=view.names[channel])
            _draw_histogram(row[1], values[~np.isnan(values)], unit)
            _draw_correlogram(row[2], lag, correlation[:, channel], band[:, channel])
        axes[0, 1].set_title("how often; line: normal")
        axes[0, 2].set_title("autocorrelation; shaded: white")
        for axis, text in zip(axes[-1], ("time, s", f"residual, {unit.name}", "lag, s"), strict=True):
            axis.set_xlabel(text)
    return figure


def _draw_histogram(axis: Any, values: Array, unit: Unit) -> None:
    std = float(np.sqrt(np.mean(values**2)))
    edge = 4.0 * std if std > 0.0 else 1.0
    bins = int(np.clip(np.sqrt(values.size), 8, 41))
    axis.hist(np.clip(values, -edge, edge), bins=bins, range=(-edge, edge), density=True, color=BLUE, alpha=0.35)
    if std > 0.0:
        grid = np.linspace(-edge, edge, 161)
        axis.plot(grid, np.exp(-0.5 * (grid / std) ** 2) / (std * np.sqrt(2.0 * np.pi)), color=INK, lw=1.0)
    axis.set_yticks([])
    axis.set_xlabel(f"residual, {unit.name}")


def _draw_correlogram(axis: Any, lag: Array, correlation: Array, band: Array) -> None:
    axis.fill_between(lag, -band, band, color=GREEN, alpha=0.2, lw=0)
    axis.vlines(lag, 0.0, correlation, color=BLUE, lw=1.4)
    axis.axhline(0.0, color=GREY, lw=0.8)
    axis.set_ylim(-1.0, 1.0)


def multiples_figure(view: FittedChannels) -> Figure:
    """Draw small multiples of all channels: measured, fitted, predicted."""
    count = len(view.names)
    rows = -(-count // _COLUMNS)
    with new_figure(_WIDTH, 0.5 + 1.15 * rows) as figure:
        axes = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True)
        for channel, axis in enumerate(axes.ravel()):
            if channel >= count:
                axis.set_axis_off()
                continue
            _draw_fit(axis, view, channel)
            rms = view.found.residual_rms[channel]
            unit = readable_unit(view.found.unit, rms)
            axis.set_title(f"{view.names[channel]}: {rms / unit.size:.2g} {unit.name}", fontsize=8.0)
            axis.tick_params(labelsize=7.0)
            axis.locator_params(nbins=4)
    return figure


def shapes_figure(view: FittedChannels) -> Figure:
    """Draw markers and fit in the plane at several instants of the fitted time."""
    fitted = view.fitted.reshape(view.fit_t.size, -1, 2)
    measured = fitted + view.found.residuals.reshape(fitted.shape)
    whole = np.flatnonzero(~np.isnan(fitted).any(axis=(1, 2)))
    rows = whole if whole.size else np.arange(view.fit_t.size)
    picked = rows[np.unique(np.linspace(0, rows.size - 1, _SHAPES).round().astype(int))]
    low, high = np.nanmin(fitted, axis=(0, 1)), np.nanmax(fitted, axis=(0, 1))
    margin = 0.05 * float((high - low).max())
    tall = float(np.clip((high - low)[1] / max((high - low)[0], 1e-9), 0.6, 2.2)) * (_WIDTH / picked.size)
    with new_figure(_WIDTH, 0.7 + tall) as figure:
        axes = figure.subplots(1, picked.size, squeeze=False, sharex=True, sharey=True)[0]
        for axis, row in zip(axes, picked, strict=True):
            axis.plot(*fitted[row].T, "-", color=BLUE, lw=1.2)
            axis.plot(*measured[row].T, "o", ms=4.0, mfc="none", mec=INK, mew=0.8)
            axis.set(aspect="equal", title=f"{view.fit_t[row]:.3g} s", xlabel="x, m")
            axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
            axis.locator_params(nbins=4)
        axes[0].set_ylabel("y, m")
    return figure


def history_figure(found: Identification) -> Figure:
    """Draw the cost over the iterations of each stage, relative to the smallest of the stage."""
    with new_figure(_WIDTH, 2.4) as figure:
        axis: Any = figure.subplots()
        first = 0
        for stage in dict.fromkeys(entry["stage"] for entry in found.history):
            own = [entry for entry in found.history if entry["stage"] == stage]
            cost, length = np.array([entry["cost"] for entry in own]), own[0]["window"]
            rounds = first + np.arange(cost.size)
            axis.plot(rounds, cost / max(float(cost.min()), 1e-300), "o-", ms=3.5, color=BLUE)
            axis.axvline(first - 0.5, color=GREY, lw=0.8, ls=(0, (3.0, 2.0)))
            place = {"transform": axis.get_xaxis_transform(), "va": "bottom"}
            axis.text(first - 0.4, 1.02, f"windows of {length:.3g} s", fontsize=8.0, color=INK, **place)
            first += cost.size
        axis.set(yscale="log", xlabel="round", ylabel="cost over its stage's least", xlim=(-0.5, first - 0.5))
        axis.locator_params(axis="x", integer=True)
    return figure


def along_figure(found: Identification, guess: Rope | None = None) -> Figure | None:
    """Draw each property with separate values for many links, with 95 % intervals; None if there is none."""
    own: dict[str, list[Number]] = {}
    for each in numbers(found):
        if each.place is not None and each.name != "arc":
            own.setdefault(each.name, []).append(each)
    shown = {name: each for name, each in own.items() if len(each) >= _LEAST_LINKS}
    if not shown:
        return None
    with new_figure(10.0, 0.5 + 2.0 * len(shown)) as figure:
        axes = figure.subplots(len(shown), 1, squeeze=False, sharex=True)[:, 0]
        for axis, (name, every) in zip(axes, shown.items(), strict=True):
            places = np.array([each.place for each in every])
            values, low, high = (np.array([getattr(each, key) for each in every]) for key in ("value", "low", "high"))
            unit = readable_unit(name, values)
            axis.vlines(places, low / unit.size, high / unit.size, color=BLUE, lw=2.0, alpha=0.45)
            axis.plot(places, values / unit.size, "o", ms=4.0, color=BLUE, label="identified, 95 % interval")
            if guess is not None:
                start = getattr(guess, name)[places] / unit.size
                axis.plot(places, start, "x", ms=4.0, color=GREY, label="first guess")
            axis.set(ylabel=unit.name, title=name.replace("_", " "))
        axes[-1].set_xlabel("link, from the first joint to the tip")
        axes[-1].locator_params(axis="x", integer=True)
        legend(figure, axes[0], columns=2)
    return figure
