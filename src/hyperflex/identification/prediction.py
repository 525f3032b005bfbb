"""Prediction of the held-out part of a recording, with its standard deviation."""

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array, Integers
from hyperflex.identification.fit import NORMAL, Loss, Window, averaged, fit_state, linearise, residuals_of
from hyperflex.identification.measurements import LEAST_VALUES, Measurements, first_state
from hyperflex.identification.model import Plant
from hyperflex.identification.options import FitOptions
from hyperflex.identification.uncertainty.covariance import LEVEL, Basis, Information

BAND = NormalDist().inv_cdf(0.5 * (1.0 + LEVEL))  # standard deviations on either side that hold 95 %
# part of the values within the 95 % band: fewer are there where deviations are 2.9 times too small
INSIDE = 0.5
WIDE = 0.2  # part of what keeping still would err by: where the band of a prediction is wider, chaos has begun


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Predictions from states that were fitted on the time just before them, parameters fixed.

    Attributes
    ----------
    rms : (C,) rad or m
        Prediction error of each channel (each link's angle, or each marker's x and y) over all predicted samples.
    window_rms : (W, C) rad or m
        The same for each prediction.
    starts (W,), lead, ahead : s
        Start times of the predictions, time on which each state was fitted, and time predicted without data.
    t (m,), measured (m, C), predicted (m, C)
        All predicted samples; measured is NaN in gaps. A prediction that fails is inf throughout, and so is its rms.
    std (m, C) : rad or m
        Expected standard deviation of measured less predicted, from the parameters' covariance, the fitted state and
        the noise, to first order; NaN where it is not known.
    """

    rms: Array
    window_rms: Array
    starts: Array
    lead: float
    ahead: float
    t: Array
    measured: Array
    predicted: Array
    std: Array

    @property
    def inside(self) -> float:
        """Share of the predicted values within 1.96 standard deviations; NaN where none is known."""
        known = ~np.isnan(self.measured) & ~np.isnan(self.std)
        away = np.abs(self.measured - self.predicted)[known]
        return float((away <= BAND * self.std[known]).mean()) if known.any() else float("nan")

    @property
    def understated(self) -> float:
        """How many times as large as stated the errors are, if less than half of the values are where 95 % should be.

        The median of the errors over their standard deviations tells; 1 where more are inside. As far as foreseeable.
        """
        seen = self.foreseeable
        known = ~np.isnan(seen.measured) & (seen.std > 0.0)
        if not known.any() or not seen.inside < INSIDE:
            return 1.0
        return NORMAL * float(np.median(np.abs(seen.measured - seen.predicted)[known] / seen.std[known]))

    @property
    def persistence(self) -> float:
        """Error of predicting that all stays as it was when the prediction began, rms over all values, rad or m."""
        columns = [column for k in range(self.starts.size) for column in self.measured[self.began == k].T]
        known = [column[~np.isnan(column)] for column in columns]
        off = np.concatenate([each - each[:1] for each in known])
        return float(np.sqrt(np.mean(off**2))) if off.size else 0.0

    @property
    def began(self) -> Integers:
        """Which prediction each sample (m,) belongs to."""
        return np.searchsorted(self.starts, self.t, side="left") - 1

    @property
    def foreseeable(self) -> "HeldOut":
        """The same without what lies, in each prediction, behind the first value whose band is WIDE.

        In a chaotic motion the errors of state and parameters grow there as fast as those that a wrong model makes.
        """
        wide = np.where(np.isnan(self.std), 0.0, BAND * self.std).max(axis=1) > WIDE * self.persistence
        keep = ~np.concatenate([np.logical_or.accumulate(wide[self.began == k]) for k in range(self.starts.size)])
        seen, predicted = self.measured[keep], self.predicted[keep]
        return replace(
            self, rms=_rms(predicted - seen), t=self.t[keep], measured=seen, predicted=predicted, std=self.std[keep]
        )

    @property
    def error(self) -> float:
        """Prediction error, rms over all channels, rad or m, as far as predictions are foreseeable, if they are at all.

        Terminal and page report it, with that of all samples (`error_of_all`) where these are more; inf if one failed.
        """
        return (self if self.failed.size or self.foreseen == 0.0 else self.foreseeable).error_of_all

    @property
    def error_of_all(self) -> float:
        """Prediction error, rms over all channels and samples, rad or m; inf if a prediction failed."""
        return float(np.sqrt(np.mean(self.rms**2)))

    @property
    def foreseen(self) -> float:
        """Part of the predicted samples that is foreseeable."""
        return self.foreseeable.t.size / max(self.t.size, 1)

    @property
    def failed(self) -> Array:
        """Start times of the predictions that failed, s."""
        return self.starts[np.isinf(self.window_rms).any(axis=1)]


def predict(basis: Basis, measured: Measurements, options: FitOptions, budget: Budget, step: int = 1) -> HeldOut | None:
    """Predict the measurements piece by piece, without force or torque; None if too short for one prediction.

    The first prediction starts ``options.lead`` after the first sample, each next one ``options.ahead`` later, its
    state fitted to the measurements on the time `lead` before it. Each `step` samples become one, as in the fit, whose
    noise that of the values is. All have equal weights, compared with a prior of the state those of the noise.
    """
    plant, x, lead, ahead = replace(basis.plant, torque=False), basis.fit.x, options.lead, options.ahead
    begin, end, measured = measured.channels.t[0], measured.channels.t[-1], measured.merged(step)
    recording, angles = measured.channels, measured.shape.data
    t, data, slack = recording.t, recording.data, 1e-9 + 1e-6 * ahead
    noise = channel_noise(basis, data.shape[1])
    size = max(float(np.sqrt(np.mean(noise**2))), float(np.finfo(float).eps))
    predictions = []
    for start in np.arange(begin + lead, end - ahead + slack, ahead):
        budget.check()
        before = (t >= start - lead - slack) & (t < start + slack)
        after = (t > start + slack) & (t <= start + ahead + slack)
        seen = data[before]
        if not after.any() or (~np.isnan(angles[before])).sum(axis=0).min() < LEAST_VALUES:
            continue
        guess = first_state(t[before], angles[before])
        spreads = [None if measured.spread is None else measured.spread[rows] for rows in (before, after)]
        window = Window(t[before], np.nan_to_num(seen), ~np.isnan(seen) / size, guess, measured.prior, (), spreads[0])
        found = fit_state(plant, x, window, guess, loss=Loss(options.loss))
        y = None if found is None else plant.predict(x, np.append(window.t[0], t[after]), found[0])
        if found is None or y is None:
            y, std = np.full_like(data[after], np.inf), np.full_like(data[after], np.nan)
        else:
            y = averaged(y[1:], t[after], spreads[1])
            std = prediction_std(plant, basis.information, window, found, t[after], noise)
        predictions.append((t[after], data[after], y, std, _rms(y - data[after]), float(start)))
    if not predictions:
        return None
    *pieces, window_rms, starts = zip(*predictions, strict=True)
    times, seen, predicted, std = (np.concatenate(each) for each in pieces)
    rms = _rms(predicted - seen)
    return HeldOut(rms, np.array(window_rms), np.array(starts), lead, ahead, times, seen, predicted, std)


def _rms(error: Array) -> Array:
    """Return the root mean square (C,) of errors (m, C), gaps (NaN) left out; NaN where there is nothing."""
    known = ~np.isnan(error)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt((np.where(known, error, 0.0) ** 2).sum(axis=0) / known.sum(axis=0)))


def channel_noise(basis: Basis, channels: int) -> Array:
    """Return the standard deviation (C,) of the residuals of the first `channels`, weighted by the loss of the fit."""
    errors = residuals_of(basis.windows, basis.fit)
    counts = basis.fit.loss.weight(np.concatenate(basis.fit.residuals)).reshape(errors.shape) ** 2
    counted = np.sum(counts * ~np.isnan(errors), axis=0)
    return np.asarray(np.sqrt(np.nansum(counts * errors**2, axis=0) / np.maximum(counted, 1e-300))[:channels])


def prediction_std(
    plant: Plant, about: Information, window: Window, found: tuple[Array, Array], t: Array, noise: Array
) -> Array:
    """Return the standard deviation (m, C) of measured less predicted samples at times t (m,), s, to first order.

    `found` is the state (2n,) fitted at ``window.t[0]`` and its residual (k C,), `noise` (C,) that of the values. An
    error of the parameters acts directly and by the fitted state; the noise of the window acts by the state, its
    variance times the autocorrelation time. Chaotic motion soon leaves the first order. NaN where derivatives fail.
    """
    x, (state, residual) = about.x, found
    linear = linearise(plant, window, x, state, residual, Loss())
    ahead = plant.jacobian(x, np.append(window.t[0], t), state)
    if ahead is None or not linear.known:
        return np.full((t.size, noise.size), np.nan)
    absorb = np.linalg.pinv(linear.state)
    rows = (noise * window.weight).ravel() * np.sqrt(about.correlation)
    rows = np.append(rows, np.ones(linear.residual.size - rows.size))  # those of the prior are in standard deviations
    by_state, shared = ahead.state[1:], ahead.shared[1:]
    by_noise = by_state @ (absorb * rows)
    by_parameters = shared - by_state @ (absorb @ linear.shared)
    variance = (by_noise**2).sum(axis=2) + np.einsum("mci,ij,mcj->mc", by_parameters, about.total, by_parameters)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) + noise**2))
