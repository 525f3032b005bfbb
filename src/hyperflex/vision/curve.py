"""Measures a rope without markers: how far it is, across itself, from where it is expected, and where its end is."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hyperflex.checks import Array
from hyperflex.core.image import profiles
from hyperflex.vision.look import RopeLook
from hyperflex.vision.tone import light_per_level
from hyperflex.vision.video import Image


class CurveView(NamedTuple):
    """Expected position of a rope in a picture: K pieces, each crossed by M lines, and its free end.

    Attributes
    ----------
    points, normals : (K, M, 2) float64
        Where the lines cross the rope in the middle of the exposure, px, and their directions.
    sweeps : (K, 2) float64
        Movement of the rope along the middle line of each piece during the exposure, ``sweeps . (u, u^2 / 2)``, px, for
        -1/2 <= u <= 1/2.
    covariance : (K, K) float64
        Of the expected offsets of the pieces along their middle lines, px^2.
    likeness : (K, K) float64
        Correlation of errors that the covariance omits.
    sagittas : (K,) float64
        By how much straight links differ from a curve like the rope's, px.
    end, end_tangent : (2,) float64
        Where the free end is expected, px, and the direction in which the rope ends there.
    end_sweep : (2,) float64
        Movement of the end in that direction, as of `sweeps`.
    end_variance : float
        Of its expected place in that direction, px^2.
    """

    points: Array
    normals: Array
    sweeps: Array
    covariance: Array
    likeness: Array
    sagittas: Array
    end: Array
    end_tangent: Array
    end_sweep: Array
    end_variance: float

    @property
    def middles(self) -> tuple[Array, Array]:
        """Points and normals (K, 2) of the middle lines."""
        middle = self.points.shape[1] // 2
        return self.points[:, middle], self.normals[:, middle]


class CurveOffsets(NamedTuple):
    """Observed position of a rope, relative to a :class:`CurveView`.

    Attributes
    ----------
    offsets, variances : (K,) float64
        Along the middle line of each piece, px and px^2; NaN: not seen. Variances are `CurveDetector.CORRELATED` times
        those of single errors, the number of correlated errors of neighbours and frames.
    end, end_variance : float
        Of the free end along its direction; NaN: not seen.
    """

    offsets: Array
    variances: Array
    end: float
    end_variance: float


def view_curve(
    moving: Array, pieces: int, covariance: Array, spacing: float, links: int, row_slope: ArrayLike = (0.0, 0.0)
) -> CurveView:
    """Return the view of a rope from where its points are expected.

    Parameters
    ----------
    moving : (3, K M + 1, 2) float64
        Points along the rope at the begin, in the middle and at the end of the exposure, px, M (odd) of each piece; the
        free end last.
    pieces : int
        K.
    covariance : (2 K + 2, 2 K + 2) float64
        Of the middle of each piece and of the free end, px^2.
    spacing : float
        Number of pieces over which errors that the covariance omits are correlated.
    links : int
        Of the rope that is expected.
    row_slope : (2,) array_like
        By how many exposures pixels are read later per px along u and v.

    Notes
    -----
    A curve that moves with velocity L per exposure, acceleration A, turns by w and has the curvature k crosses a line
    along its normal n, across its tangent t, at ``L.n u + (A.n - 2 w L.t + k (L.t)^2) u^2 / 2`` to second order.
    """
    before, now, after = moving
    lines = (len(now) - 1) // pieces
    reach, last = lines // 2, len(now) - 1
    low, high = np.maximum(np.arange(last + 1) - reach, 0), np.minimum(np.arange(last + 1) + reach, last)
    chords = now[high] - now[low]
    lengths = np.maximum(np.linalg.norm(chords, axis=1, keepdims=True), 1e-9)
    tangents = chords / lengths
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    velocity, acceleration = after - before, 4.0 * (before + after - 2.0 * now)
    turning = ((velocity[high] - velocity[low]) / lengths * normals).sum(axis=1)
    curvature = ((tangents[high] - tangents[low]) / lengths * normals).sum(axis=1)
    own = np.append(np.arange(reach, last, lines), last)
    along, across = (np.einsum("kc,kc->k", velocity[own], each[own]) for each in (tangents, normals))
    bend = np.einsum("kc,kc->k", acceleration[own], normals[own]) - 2.0 * turning[own] * along
    bend = bend + curvature[own] * along**2
    slope = normals[own] @ np.asarray(row_slope)
    stretch = 1.0 / np.maximum(1.0 - across * slope, 0.1)
    sweeps = np.stack([across * stretch, bend * stretch], axis=1)
    ways = np.concatenate([normals[own[:-1]], tangents[-1:]])
    blocks = covariance.reshape(pieces + 1, 2, pieces + 1, 2)
    wide = np.einsum("kc,kcld,ld->kl", ways, blocks, ways, optimize=True)
    link = np.linalg.norm(np.diff(now, axis=0), axis=1).sum() / links
    apart = np.subtract.outer(np.arange(pieces), np.arange(pieces)) / spacing
    return CurveView(
        now[:-1].reshape(pieces, lines, 2),
        normals[:-1].reshape(pieces, lines, 2),
        sweeps[:-1],
        wide[:-1, :-1],
        np.exp(-0.5 * apart**2),
        np.abs(curvature[own[:-1]]) * link**2 / 8.0,
        now[-1],
        tangents[-1],
        np.array([along[-1], acceleration[-1] @ tangents[-1]]),
        float(wide[-1, -1]),
    )


class CurveDetector:
    """Finds a rope across where it is expected.

    Notes
    -----
    Several places of a piece may look like the rope (other edges, shadows, things of its colour). Which of them is the
    rope, if any, is found for all pieces together, by sums over all choices along the rope (forward and backward): the
    rope is as bent as its expected covariance allows, and hidden pieces are neighbours of hidden ones.
    """

    STEP = 0.5  # px between samples of a profile
    BLUR = 0.7  # px, standard deviation of the blur of a still edge
    CANDIDATES = 4
    GATE = 4.0  # standard deviations of an offset
    DOUBT = 2.0  # px, standard deviation of an expected place in addition to what the estimator states
    WIDEST = 60.0  # px, largest offset
    STREAK = 0.08  # error of a streak's middle by compression, texture and shadows, over its half width
    CORRELATED = 8.0  # pieces and frames over which errors by compression, texture and straight links are alike
    CONTRAST_STD = 0.1  # of a contrast, relative: ropes have 0.73 to 1.21; SURE and CLEAR allow 3.7 of it
    CLEAR, SURE = 3.0, 10.0  # log-likelihood ratio to "nothing" of what may be the rope, and most that a profile proves
    HIDDEN = 3.0  # log-likelihood ratio at which a piece begins or ends to be hidden

    def find(self, image: Image, look: RopeLook, view: CurveView) -> CurveOffsets:
        """Return the observations of the rope in a frame (height, width, 3)."""
        prior = view.covariance + self.DOUBT**2 * view.likeness
        reach = np.minimum(self.GATE * np.sqrt(np.diag(prior)), self.WIDEST)
        inner = reach + half_sweep(view.sweeps) + 0.5 * look.width + 3.0 * self.BLUR
        far = inner + profiles.MARGIN + 2.0
        seen = np.empty((len(reach), 2 * int(far.max() / self.STEP) + 1, 3))
        profiles.sample_lines(image, look.tone, view.points, view.normals, self.STEP, far, seen)
        across = self.STEP * (np.arange(seen.shape[1]) - 0.5 * (seen.shape[1] - 1))
        outside = (np.abs(across) > inner[:, None]) & np.isfinite(seen[:, :, 0])
        beyond = ~outside.any(axis=1)  # of the picture
        seen[beyond], outside[beyond] = 0.0, True
        walls = np.nanmedian(np.where(outside[:, :, None], seen, np.nan), axis=1, keepdims=True)
        contrast = look.bgr - walls[:, 0]
        least = (light_per_level(walls[:, 0], look.tone) ** 2).mean(axis=1, keepdims=True)
        weights = contrast / np.maximum((contrast**2).sum(axis=1, keepdims=True), least)
        shares = np.einsum("kxc,kc->kx", seen - walls, weights)
        found = np.empty((len(reach), self.CANDIDATES, profiles.COLUMNS))
        widths = np.full(len(reach), look.width)
        profiles.match_lines(shares, view.sweeps, widths, self.BLUR, self.STEP, reach, found)
        offsets, ratios, variances = self._rated(found)
        streaks = self.STREAK * half_sweep(view.sweeps)
        variances = self.CORRELATED * (variances + (streaks**2 + view.sagittas**2)[:, None])
        chances = marginals(offsets, ratios, variances, prior, self.HIDDEN)
        offsets, variances = np.nan_to_num(offsets), np.nan_to_num(variances, nan=1.0)
        total = np.maximum(chances.sum(axis=1), 1e-9)
        mean = (chances * offsets).sum(axis=1) / total
        wide = (chances * (variances + (offsets - mean[:, None]) ** 2)).sum(axis=1) / total**2
        sure = chances.max(axis=1) > np.maximum(0.5, 0.9 * total)  # neither hidden nor one of two
        mean, wide = (np.where(sure, each, np.nan) for each in (mean, wide))
        end = (np.nan, np.nan)
        if np.isfinite(mean[-1]):
            end = self._end(image, look, view, float(mean[-1]), weights[-1])
        return CurveOffsets(mean, wide, *end)

    def _rated(self, found: Array) -> tuple[Array, Array, Array]:
        """Return offsets of candidates (K, C), px, log-likelihood ratios to nothing, and variances, px^2."""
        best = found[:, 0, profiles.RESIDUAL]
        common = np.nanmedian(best) if np.isfinite(best).any() else 1.0
        noise = np.maximum(found[:, :, profiles.RESIDUAL], common) / self.STEP  # samples are correlated
        contrast = found[:, :, profiles.AMPLITUDE]
        with np.errstate(invalid="ignore", divide="ignore"):
            unlike = (contrast - 1.0) ** 2 / (self.CONTRAST_STD**2 + noise / found[:, :, profiles.CERTAINTY])
            ratios = np.minimum(0.5 * found[:, :, profiles.GAIN] / noise, self.SURE) - 0.5 * unlike
            variances = noise / (contrast**2 * found[:, :, profiles.ENERGY])
        ratios = np.where(ratios > self.CLEAR, ratios, -np.inf)
        return found[:, :, profiles.OFFSET], ratios, variances

    def _end(self, image: Image, look: RopeLook, view: CurveView, offset: float, weights: Array) -> tuple[float, float]:
        """Return the offset of the free end along its direction, px, and its variance; NaN if it is not seen."""
        reach = min(self.GATE * float(np.sqrt(view.end_variance + self.DOUBT**2)), self.WIDEST)
        half = reach + float(half_sweep(view.end_sweep)) + 3.0 * self.BLUR + profiles.MARGIN + 2.0
        side = float(half_sweep(view.sweeps[-1])) + 0.5 * look.width + 3.0 * self.BLUR
        along = view.end_tangent
        seen, found = np.empty((2 * int(half / self.STEP) + 1, 3)), np.empty(profiles.COLUMNS)
        beside = view.end + offset * np.array([-along[1], along[0]])
        profiles.sum_across(image, look.tone, beside, along, self.STEP, side, seen)
        profiles.match_end(seen @ weights, view.end_sweep, self.BLUR, self.STEP, reach, found)
        noise, contrast = found[profiles.RESIDUAL] / self.STEP, found[profiles.AMPLITUDE] / look.width
        if not (found[profiles.GAIN] > 2.0 * self.SURE * noise and abs(contrast - 1.0) < 4.0 * self.CONTRAST_STD):
            return np.nan, np.nan
        variance = noise / (found[profiles.AMPLITUDE] ** 2 * found[profiles.ENERGY])
        variance = self.CORRELATED * variance + (0.5 * look.width) ** 2  # an end may be cut or round
        return float(found[profiles.OFFSET]), float(variance)


def half_sweep(sweeps: Array) -> Array:
    """Return how far (...) a sweep (..., 2) reaches from its middle at most, px."""
    return np.asarray(0.5 * np.abs(sweeps[..., 0]) + 0.125 * np.abs(sweeps[..., 1]))


def marginals(offsets: Array, ratios: Array, variances: Array, prior: Array, hidden: float) -> Array:
    """Return the probabilities (K, C) that candidates are the rope, of all choices along it together.

    Parameters
    ----------
    offsets, ratios, variances : (K, C) float64
        px, log-likelihood ratios to nothing, and px^2; a ratio of -inf: no candidate.
    prior : (K, K) float64
        Covariance of the expected offsets, px^2.
    hidden : float
        Log-likelihood ratio at which a piece begins or ends to be hidden.

    Notes
    -----
    The first visible piece is expected at `prior`, and each next one relative to the one before it: a common offset of
    all pieces counts once. The likelihood of a candidate is a Gaussian with its own variance, so the best of many
    offsets has less weight if the expectation is wide. Sums and products along a chain of pieces (forward-backward,
    Rabiner 1989, Proceedings of the IEEE 77(2), 257).
    """
    count, each = offsets.shape
    places, wide = np.nan_to_num(offsets), np.nan_to_num(variances, nan=1.0)
    along, total = np.diag(prior, 1)[:, None], np.diag(prior)[:, None] + wide
    first = np.sqrt(wide / total) * np.exp(-0.5 * places**2 / total)
    unary = np.exp(np.column_stack([ratios, np.full(count, hidden)]))
    pairs = np.full((count - 1, each + 1, each + 1), np.exp(-hidden))
    pairs[:, each, each] = 1.0
    pairs[:, each, :each] *= first[1:]
    share = along / total[:-1]  # of a piece's offset, expected of the next
    apart = places[1:, None, :] - (share * places[:-1])[:, :, None]
    spread = total[1:, None, :] - (share * along)[:, :, None]
    pairs[:, :each, :each] = np.sqrt(wide[1:, None, :] / spread) * np.exp(-0.5 * apart**2 / spread)
    forward, backward = unary.copy(), np.ones_like(unary)
    forward[0, :each] *= first[0]
    forward[0] /= forward[0].sum()
    for k in range(1, count):
        forward[k] *= forward[k - 1] @ pairs[k - 1]
        forward[k] /= forward[k].sum()
    for k in range(count - 2, -1, -1):
        backward[k] = pairs[k] @ (unary[k + 1] * backward[k + 1])
        backward[k] /= backward[k].sum()
    both = forward * backward
    return np.asarray((both / both.sum(axis=1, keepdims=True))[:, :each])
