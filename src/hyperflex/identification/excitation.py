"""Checks before a fit: sampling times that suit the rope, and motion beyond the noise."""

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.declarations.evidence import unlike_lengths
from hyperflex.identification.fit.windows import CUT, rms_rate
from hyperflex.identification.texts import text
from hyperflex.model import Rope
from hyperflex.recording import Recording


@dataclass(frozen=True)
class ExcitationLimits:
    """What a recording must show at least."""

    # probability with which mere white noise passes for motion
    rare: float = 0.001
    # values of a channel that its smoothness can be judged by
    fewest: int = 4
    # lags of the autocorrelation, and values that it takes at least
    lags: int = 10
    many: int = 20
    # standard deviations of the declared noise: an rms that large is motion, smooth or not
    beyond: float = 5.0
    # rad, the same of link angles where no noise is declared: no camera errs so much
    large: float = 0.1
    # of the rope's period: what a recording lasts at least, its samples lie apart at most
    shortest: float = 0.1
    sparsest: float = 1.0
    # times the rate of a small swing: ten somersaults in the time of one
    wildest: float = 8.0
    # of the ratio of variances below: samples that jump up and down in turn
    roughest: float = 8.0 / 3.0
    # variance of that ratio for white noise, times the number of values
    spread: float = 17.0 / 9.0


LEAST_MOTION = ExcitationLimits()


def check_excitation(channels: Recording, shape: Recording, rope: Rope, *, moved: bool) -> None:
    """Refuse measured `channels`, and the link angles `shape` that they show, that can tell nothing of the rope.

    `moved` tells whether the first joint moves: then links may turn as fast as it makes them.
    """
    check_times(channels, rope)
    check_motion(shape, channels)
    if not moved:
        check_speed(shape, rope)


def check_times(recording: Recording, rope: Rope) -> None:
    """Refuse recordings far shorter, or sampled far sparser, than a small swing of a straight rod of the rope's length.

    Springs make the period shorter: ropes with stiffness may be short.
    """
    gravity = float(np.hypot(*rope.gravity))
    if gravity == 0.0:
        return
    period = 2.0 * np.pi * float(np.sqrt(2.0 * rope.total_length / (3.0 * gravity)))
    least = 0.0 if rope.stiffness.any() else LEAST_MOTION.shortest * period
    spacing = float(np.median(np.diff(recording.t)))
    if recording.duration < least:
        raise InvalidInput(
            "the recording is too short to tell anything of the rope",
            got=f"{recording.t.size} samples in {recording.duration:.3g} s",
            allowed=f"at least {least:.2g} s; a rope so long swings once in {period:.2g} s",
            fix="Record longer. Are the times in another unit (time_unit='s'), or the lengths?",
        )
    if spacing > LEAST_MOTION.sparsest * period:
        raise InvalidInput(
            "the samples lie further apart than a swing of the rope lasts",
            got=f"{spacing:.3g} s from sample to sample",
            allowed=f"at most {LEAST_MOTION.sparsest * period:.2g} s; a rope so long swings once in {period:.2g} s",
            fix="Are the times in another unit (time_unit='ms'), or the lengths? Else record more frames a second",
        )


def check_speed(shape: Recording, rope: Rope) -> None:
    """Refuse link angles `shape` of a free swing that turn faster than gravity can make them."""
    gravity = float(np.hypot(*rope.gravity))
    if gravity == 0.0 or rope.stiffness.any():
        return
    natural = float(np.sqrt(1.5 * gravity / rope.total_length))
    slowest = min(rms_rate(shape.t, column) for column in shape.data.T)
    if slowest > LEAST_MOTION.wildest * natural:
        raise InvalidInput(
            "all links turn far faster than a swing of this rope",
            got=f"{slowest:.3g} rad/s (rms) at least",
            allowed=f"at most {LEAST_MOTION.wildest * natural:.3g} rad/s; a small swing has {natural:.3g} rad/s",
            fix=" ".join(text(each) for each in unlike_lengths(rope))
            or "Are the angles in degrees (unit='deg'), the times in another unit, or the lengths? Does an arm move "
            "the rope (motion=...)?",
        )


def check_motion(shape: Recording, channels: Recording | None = None) -> None:
    """Refuse link angles `shape` without motion, or not told from noise in the measured `channels` (or the angles).

    White noise scatters about its neighbours as much as about its mean, and has no autocorrelation; both tests use
    ranks, so outliers and the noise's distribution do not matter. Motion beyond the declared noise passes at once.
    """
    swing = np.nanmax(shape.data, axis=0) - np.nanmin(shape.data, axis=0)
    if not (swing > CUT.still).any():
        raise InvalidInput(
            "nothing moves in the recording",
            got=f"largest swing {swing.max():.3g} rad",
            allowed=f"more than {CUT.still:g} rad",
            fix="Record a free swing, or check the unit of the angles",
        )
    channels = channels or shape
    _refuse_constant(channels)
    if _size(shape.data).max() > LEAST_MOTION.large:
        return
    if (
        channels.noise is not None
        and (_size(channels.data) > LEAST_MOTION.beyond * np.median(channels.noise, axis=0)).any()
    ):
        return
    if _whiteness(channels) < LEAST_MOTION.rare:
        return
    raise InvalidInput(
        "no motion beyond noise in the recording",
        got=f"values that scatter from sample to sample as much as over all {channels.t.size}",
        allowed="a swing that is clearly larger than the noise",
        fix="Record a wider swing, or more samples; if it is sampled slowly, say how large the noise is (noise=...)",
    )


def _refuse_constant(channels: Recording) -> None:
    """Refuse a link's angle that is one number all the time: no link hangs still while others swing."""
    if channels.kind != "angles":
        return
    for link, column in enumerate(channels.data.T):
        values = column[~np.isnan(column)]
        if values.size > LEAST_MOTION.fewest and np.ptp(values) == 0.0:
            raise InvalidInput(
                f"link {link} never moves while others do",
                got=f"{values[0]:.6g} rad in all {values.size} samples",
                fix="See what the sensor or tracker holds there; a link without a sensor is a gap (empty or nan)",
            )


def _size(values: Array) -> Array:
    """Return the standard deviation (C,) of each channel, by its interquartile range."""
    low, high = np.nanquantile(values, [0.25, 0.75], axis=0)
    return np.asarray((high - low) / 1.349)


def _whiteness(recording: Recording) -> float:
    """Return about the p-value of white noise, by roughness and autocorrelation; 1 if values are too few."""
    ratios, counts, returns = [], [], []
    for column in recording.data.T:
        known = ~np.isnan(column)
        if known.sum() >= LEAST_MOTION.fewest and np.ptp(column[known]) > 0.0:
            ratios.append(_roughness(recording.t[known], column[known]))
            counts.append(int(known.sum()))
            returns.append(_returning(column[known]) if known.sum() >= LEAST_MOTION.many else 0.0)
    if not ratios:
        return 1.0
    from scipy.special import gammaincc

    swinging = float(gammaincc(0.5 * LEAST_MOTION.lags * len(returns), 0.5 * sum(returns)))
    together = _chance(float(np.average(ratios, weights=counts)), sum(counts))
    alone = min(_chance(ratio, count) for ratio, count in zip(ratios, counts, strict=True))
    return min(1.0, 3.0 * min(together, len(ratios) * alone, swinging))


def _roughness(t: Array, values: Array) -> float:
    """Return the variance about the line between neighbours over that about the mean, of ranks; 1 for white noise."""
    from scipy.stats import rankdata

    rank = rankdata(values)
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    off = rank[1:-1] - (1.0 - share) * rank[:-2] - share * rank[2:]
    result = (off**2 / (1.0 + share**2 + (1.0 - share) ** 2)).mean() / rank.var(ddof=1)
    return float(result)


def _returning(values: Array) -> float:
    """Return the Ljung-Box statistic of the ranks, chi-squared (1978, doi:10.1093/biomet/65.2.297)."""
    from scipy.stats import rankdata

    rank = rankdata(values)
    rank -= rank.mean()
    lags = np.arange(1, LEAST_MOTION.lags + 1)
    found = np.array([rank[lag:] @ rank[:-lag] for lag in lags]) / (rank @ rank)
    result = (found**2 * rank.size * (rank.size + 2.0) / (rank.size - lags)).sum()
    return float(result)


def _chance(ratio: float, count: int) -> float:
    """Return the p-value of a roughness ratio of `count` values of white noise, by a beta distribution."""
    from scipy.special import betainc

    mean = 1.0 / LEAST_MOTION.roughest
    total = mean * (1.0 - mean) * count / LEAST_MOTION.spread * LEAST_MOTION.roughest**2 - 1.0
    first, second = max(mean * total, 0.5), max((1.0 - mean) * total, 0.5)
    below = float(betainc(first, second, min(max(ratio / LEAST_MOTION.roughest, 0.0), 1.0)))
    return below if ratio < 1.0 else 1.0 - below
