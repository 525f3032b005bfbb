"""Prediction on the part of a recording that the fit has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification._shooting import Plant, fit_state
from hyperflex.identification._windows import Window, first_state, thin
from hyperflex.model import Rope
from hyperflex.recording import Recording


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Predictions from states that were fitted on the time just before them, parameters fixed.

    Attributes
    ----------
    rms : (n,) rad
        Prediction error of each link's angle over all predicted samples.
    window_rms : (W, n) rad
        The same for each predicted stretch.
    starts : (W,) s
        Where each prediction starts.
    lead, ahead : float, s
        Time on which each state was fitted, and time predicted without data.
    t (m,), measured (m, n), predicted (m, n)
        All predicted samples, for drawing; measured is NaN in gaps. A stretch that could not be predicted, or whose
        prediction does not stay finite, is inf throughout, and so is its rms and that of all.
    """

    rms: Array
    window_rms: Array
    starts: Array
    lead: float
    ahead: float
    t: Array
    measured: Array
    predicted: Array

    @property
    def failed(self) -> Array:
        """Where predictions start that failed, s."""
        return self.starts[np.isinf(self.window_rms).any(axis=1)]


def predict(plant: Plant, rope: Rope, recording: Recording, lead: float = 0.5, ahead: float = 1.0) -> HeldOut | None:
    """Predict a recording of angles piece by piece.

    The first prediction starts `lead` after the first sample; each next one `ahead` later, its state fitted on the
    `lead` before it (measured data again, not the prediction).

    Returns
    -------
    HeldOut, or None where the recording is too short for one prediction.

    Notes
    -----
    Recordings with more than 200 samples in `lead` are decimated first (every k-th sample is picked): the states are
    fitted to, and the rms taken over, what is left. All samples count alike in both: the recording's noise is not used
    as a weight.
    """
    recording = recording.decimate(thin(recording, lead))
    t, slack = recording.t, 1e-9 + 1e-6 * ahead
    starts, times, measured, predicted = [], [], [], []
    for start in np.arange(t[0] + lead, t[-1] - ahead + slack, ahead):
        before = (t >= start - lead - slack) & (t < start + slack)
        after = (t > start + slack) & (t <= start + ahead + slack)
        known = ~np.isnan(recording.data[before])
        if not after.any() or known.sum(axis=0).min() < 4:
            continue
        window = Window(t[before], np.where(known, recording.data[before], 0.0), known.astype(np.float64))
        found = fit_state(plant, rope, window, first_state(window))
        every = np.append(window.t[0], t[after])
        q = None if found is None else plant.predict(rope, every, found[0])
        starts.append(float(start))
        times.append(t[after])
        measured.append(recording.data[after])
        predicted.append(q[1:] if q is not None and np.isfinite(q).all() else np.full(measured[-1].shape, np.inf))
    if not starts:
        return None
    errors = [p - m for p, m in zip(predicted, measured, strict=True)]
    return HeldOut(
        _rms(np.concatenate(errors)),
        np.array([_rms(e) for e in errors]),
        np.array(starts),
        lead,
        ahead,
        np.concatenate(times),
        np.concatenate(measured),
        np.concatenate(predicted),
    )


def _rms(error: Array) -> Array:
    """Return the root mean square (n,) of errors (m, n), gaps (NaN) left out; NaN where there is nothing."""
    known = ~np.isnan(error)
    with np.errstate(invalid="ignore", divide="ignore"):
        result: Array = np.sqrt((np.where(known, error, 0.0) ** 2).sum(axis=0) / known.sum(axis=0))
    return result
