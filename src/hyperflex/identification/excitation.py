"""Checks before a fit: sampling times that suit the rope, and motion beyond the noise."""

from functools import partial

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.declarations.evidence import unlike_lengths
from hyperflex.identification.findings import text
from hyperflex.identification.measurements import LEAST_VALUES, STILL, rms_rate, swing_period
from hyperflex.identification.uncertainty.noise import CHANCE, LAGS
from hyperflex.model import Rope
from hyperflex.recording import Recording

SHORTEST = 0.1  # of the rope's period, which a recording lasts at least
WILDEST = 8.0  # times the rate of a small swing: ten somersaults in the time of one
BEYOND = 5.0  # standard deviations of the declared noise: a spread that large is motion, smooth or not
LARGE = 0.1  # rad, the same of link angles: no camera errs so much


def check_excitation(channels: Recording, shape: Recording, rope: Rope, *, moved: bool) -> None:
    """Refuse measured `channels`, and the link angles `shape` that they show, that can tell nothing of the rope.

    `moved` tells whether the first joint moves: then links may turn as fast as it makes them.
    """
    check_times(channels, rope)
    check_motion(shape, channels)
    natural = 2.0 * np.pi / swing_period(rope)
    slowest = min(rms_rate(shape.t, column) for column in shape.data.T)
    if not moved and not rope.stiffness.any() and slowest > WILDEST * natural > 0.0:
        raise InvalidInput(
            "all links turn far faster than a swing of this rope",
            got=f"{slowest:.3g} rad/s (rms) at least",
            allowed=f"at most {WILDEST * natural:.3g} rad/s; a small swing has {natural:.3g} rad/s",
            fix=" ".join(text(each) for each in unlike_lengths(rope))
            or "Are the angles in degrees (unit='deg'), the times in another unit, or the lengths? Does an arm move "
            "the rope (motion=...)?",
        )


def check_times(recording: Recording, rope: Rope) -> None:
    """Refuse recordings far shorter, or sampled far sparser, than a small swing of a straight rod of the rope's length.

    Springs make the period shorter: ropes with stiffness may be short.
    """
    period = swing_period(rope)
    if not np.isfinite(period):
        return
    least = 0.0 if rope.stiffness.any() else SHORTEST * period
    spacing = float(np.median(np.diff(recording.t)))
    if recording.duration < least:
        raise InvalidInput(
            "the recording is too short to tell anything of the rope",
            got=f"{recording.t.size} samples in {recording.duration:.3g} s",
            allowed=f"at least {least:.2g} s; a rope so long swings once in {period:.2g} s",
            fix="Record longer. Are the times in another unit (time_unit='s'), or the lengths?",
        )
    if spacing > period:
        raise InvalidInput(
            "the samples lie further apart than a swing of the rope lasts",
            got=f"{spacing:.3g} s from sample to sample",
            allowed=f"at most {period:.2g} s; a rope so long swings once in {period:.2g} s",
            fix="Are the times in another unit (time_unit='ms'), or the lengths? Else record more frames a second",
        )


def check_motion(shape: Recording, channels: Recording | None = None) -> None:
    """Refuse link angles `shape` without motion, or not told from noise in the measured `channels` (or the angles).

    Motion beyond the declared noise passes, and smooth motion: it is more autocorrelated than the same values shuffled.
    """
    from scipy.stats import iqr

    swing = np.nanmax(shape.data, axis=0) - np.nanmin(shape.data, axis=0)
    if not (swing > STILL).any():
        raise InvalidInput(
            "nothing moves in the recording",
            got=f"largest swing {swing.max():.3g} rad",
            allowed=f"more than {STILL:g} rad",
            fix="Record a free swing, or check the unit of the angles",
        )
    channels = channels or shape
    for link, column in enumerate(channels.data.T if channels.kind == "angles" else ()):
        values = column[~np.isnan(column)]
        if values.size > LEAST_VALUES and np.ptp(values) == 0.0:  # no link hangs still while others swing
            raise InvalidInput(
                f"link {link} never moves while others do",
                got=f"{values[0]:.6g} rad in all {values.size} samples",
                fix="See what the sensor or tracker holds there; a link without a sensor is a gap (empty or nan)",
            )
    noise = np.inf if channels.noise is None else np.median(channels.noise, axis=0)
    spread = partial(iqr, axis=0, scale="normal", nan_policy="omit")  # outliers do not matter
    large = (spread(shape.data) > LARGE).any() or (spread(channels.data) > BEYOND * noise).any()
    if not large and _is_noise(channels.data):
        raise InvalidInput(
            "no motion beyond noise in the recording",
            got=f"values that scatter from sample to sample as much as over all {channels.t.size}",
            allowed="a swing that is clearly larger than the noise",
            fix="Record a wider swing, or more samples; if it is sampled slowly, state how large the noise is "
            "(noise=...)",
        )


def _is_noise(values: Array) -> bool:
    """Whether values (T, C), shuffled, may be as autocorrelated, by chance of CHANCE; by ranks, for outliers."""
    from scipy.stats import rankdata

    ranks = rankdata(values, axis=0, nan_policy="omit")
    ranks = np.nan_to_num(ranks - np.nanmean(ranks, axis=0))

    def returning(rows: Array) -> float:
        lags = range(1, min(LAGS, len(rows) - 1) + 1)
        return float(sum(((rows[lag:] * rows[:-lag]).sum(axis=0) ** 2).sum() for lag in lags))

    shuffle, found = np.random.default_rng(0), returning(ranks)
    return any(returning(shuffle.permuted(ranks, axis=0)) >= found for _ in range(round(1.0 / CHANCE)))
