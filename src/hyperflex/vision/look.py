"""The look of a rope without markers: its colour against what is behind it, its width, and the light as it changes."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.image.profiles import cover, sample_places
from hyperflex.errors import InvalidInput
from hyperflex.vision.colour import NOISE
from hyperflex.vision.ridges import BLUR, SHADOW
from hyperflex.vision.tone import light_per_level, linear_tone
from hyperflex.vision.video import Image


class Cover(NamedTuple):
    """What K lines across a curve, a pixel apart, show of a rope.

    Attributes
    ----------
    rope : (K,) float64
        1 where the colour, averaged over the rope's width, however blurred, and nine pixels along it, is the rope's, -1
        where it is the wall's, or that of a shadow on it, and 0 where neither explains it, or both. No likelihood.
    aside : (K,) float64
        Where its middle is, px.
    wider : (K,) float64
        By how much it is wider than at rest, px.
    contrast : (K, 3) float64
        Light of the rope less that of the wall beside it; 0 outside of the picture.
    """

    rope: Array
    aside: Array
    wider: Array
    contrast: Array

    @property
    def gained(self) -> Array:
        """Pixels of rope until there (K,), less those of wall: most where the rope ends. They depend on each other."""
        return np.cumsum(self.rope)

    def end(self, longest: float = np.inf) -> int:
        """Return where a rope ends that can be `longest` px long."""
        return int(np.argmax(self.gained[: int(min(longest, self.rope.size))]))


@dataclass(frozen=True, eq=False)
class RopeLook:
    """How a rope looks against any wall.

    Parameters
    ----------
    bgr : (3,) array_like
        Mean light over the rope's width, blue, green, red, 0 to 255.
    width : float
        Of the rope at rest, px.
    tone : (256,) array_like, optional
        Light of the levels of its pictures, 0 to 255, as of :func:`srgb_tone`; by default proportional to them.
    light : (h, w, 3) uint8, optional
        Some pixels of the picture whose light `bgr` has; see :meth:`in_light_of`.
    first : RopeLook, optional
        The look that this one is of, in its own light: changes from frame to frame would be rounded away.

    Notes
    -----
    The light of a pixel that the rope covers in part is a mixture of rope and wall. Colours are told apart, as by
    Fisher's linear discriminant, by the covariance of the wall beside the rope. So one rule serves bright ropes on dark
    walls, dark ones on bright walls, and coloured ones on textures: what varies over the wall (grain, shadow, shade)
    counts little.
    """

    bgr: Array
    width: float
    tone: Array = field(default_factory=linear_tone)
    light: Image | None = None
    first: "RopeLook | None" = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "bgr", checks.array("bgr", self.bgr, (3,), sign="nonnegative"))
        object.__setattr__(self, "width", checks.number("width", self.width, sign="positive", unit="px"))
        object.__setattr__(self, "tone", checks.array("tone", self.tone, (256,), sign="nonnegative"))

    @classmethod
    def from_curve(
        cls, image: Image, curve: npt.ArrayLike, width: float | None = None, tone: Array | None = None
    ) -> "RopeLook":
        """Return the look of the rope that lies along a curve in a picture.

        Parameters
        ----------
        image : (height, width, 3) uint8
        curve : (P, 2) array_like
            Middle of the rope, px.
        width : float, optional
            If it is known, px; else it is found. A rope thinner than two pixels has about the same picture as a thinner
            one of more contrast, so there the calibrated width is better.
        tone : (256,) float64, optional
            As of the look.

        Raises
        ------
        InvalidInput
            If the rope does not stand out against the wall.

        Notes
        -----
        The third of the curve that stands out most is used: where the rope moves, blur makes it wider and fainter.
        """
        line = checks.array("curve", curve, (-1, 2), unit="px")
        if len(line) < 2:
            raise InvalidInput("the curve is no line", got=line.tolist(), allowed="two points or more")
        reach = 8.0 + 3.0 * (6.0 if width is None else width)
        across = np.arange(-reach, reach + 0.25, 0.5)
        outside = np.broadcast_to(np.abs(across) > 0.5 * reach, (len(line), across.size))
        tone = linear_tone() if tone is None else tone
        samples = sample(image, places_across(line, across), tone)
        inside = np.isfinite(samples).all(axis=(1, 2))
        if not inside.any():
            raise InvalidInput("the curve is not in the picture", got=line[[0, -1]].tolist(), allowed="a rope in sight")
        samples, outside = samples[inside], outside[inside]
        wall = _wall(samples, outside, across)
        sharp = _sharpest(samples - wall, across)
        samples, wall, outside = samples[sharp], wall[sharp], outside[sharp]
        off = _covariance(samples - wall, outside, wall, tone)
        fits = []
        for each in np.geomspace(1.0, reach, 40) if width is None else (width,):
            share = profile(across, each)[:, None]
            colours = (share * (samples - (1.0 - share) * wall)).sum(axis=1) / (share**2).sum()
            bgr = np.median(colours, axis=0)
            misfit = np.square(samples - wall - share * (bgr - wall)).sum(axis=(1, 2))
            beyond = np.abs(bgr - np.clip(bgr, 0.0, 255.0)).sum()  # thinner than it can be
            fits.append((float(np.median(misfit) + len(across) * beyond**2), each, bgr))
        _, found, bgr = min(fits, key=lambda fit: fit[0])
        contrast = bgr - wall.mean(axis=1)
        clear = float(np.median(np.einsum("ki,kij,kj->k", contrast, np.linalg.inv(off), contrast) ** 0.5))
        if clear < 3.0:
            raise InvalidInput(
                "the rope does not stand out against the wall: contrast in standard deviations of the wall",
                got=round(clear, 1),
                allowed="at least 3",
                fix="Take another wall or more light, or put markers on the rope",
            )
        return cls(np.clip(bgr, 0.0, 255.0), float(found), tone, _sparse(image))

    def before_wall(
        self, image: Image, places: Array, outside: npt.NDArray[np.bool_], across: Array
    ) -> tuple[Array, Array, Array]:
        """Return by how much colours, and the rope's, differ from the wall's at places on lines across the rope.

        Parameters
        ----------
        image : (height, width, 3) uint8
        places : (K, M, 2) float64
            px, of M places on each of K lines; see :func:`places_across`.
        outside : (M,) or (K, M) bool
            Which of them are expected to show the wall, on both sides of the rope.
        across : (M,) float64
            Of the places along the lines, px.

        Returns
        -------
        (K, M, 3), (K, M, 3) float64
            Differences of the colours seen, NaN outside of the picture, and of the rope's.
        (K, 3, 3) float64
            Inverse covariance of the wall.
        """
        samples, outside = sample(image, places, self.tone), np.broadcast_to(outside, places.shape[:2])
        wall = _wall(samples, outside, across)
        off = samples - wall
        precision = np.asarray(np.linalg.inv(_covariance(off, outside, wall, self.tone)), np.float64)
        return off, self.bgr - wall, precision

    @property
    def levels(self) -> Array:
        """Of its colour in a picture (3,), blue, green, red."""
        return np.asarray(np.interp(self.bgr, self.tone, linear_tone()))

    def in_light_of(self, image: Image) -> "RopeLook":
        """Return this look in the light of another picture by the same camera: exposure, white balance, dusk."""
        now, first = _sparse(image), self.first or self
        if first.light is None or first.light.shape != now.shape:
            return replace(self, light=now, first=None)
        gain = _gain_between(first.light, now, self.tone)
        return replace(self, bgr=np.clip(first.bgr * gain, 0.0, 255.0), light=now, first=first)


def places_across(curve: Array, across: Array) -> Array:
    """Return places (P, M, 2) at distances (M,), px, to the left of a curve (P, 2), px, whose sense is its order's."""
    along = np.gradient(curve, axis=0)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    return np.asarray(curve[:, None] + across[:, None] * normal[:, None])


def sample(image: Image, places: Array, tone: Array) -> Array:
    """Return the light (K, M, 3) of a picture at places (K, M, 2), px, interpolated; NaN outside of it."""
    seen, last = np.empty((*places.shape[:2], 3)), np.array(image.shape[1::-1]) - 1.0
    sample_places(image, tone, np.clip(places, 0.0, last), seen)
    seen[((places < -0.5) | (places > last + 0.5)).any(axis=2)] = np.nan
    return seen


def rope_along(
    image: Image,
    path: Array,
    width: float | None = None,
    longest: float = np.inf,
    tone: Array | None = None,
    tip: Array | None = None,
) -> tuple[Array, RopeLook, Cover]:
    """Measure the rope along a path that is some pixels off.

    Parameters
    ----------
    image : (height, width, 3) uint8
    path : (P, 2) float64
        px.
    width : float, optional
        Of the rope, px, if it is known.
    longest : float
        That the rope can be, px.
    tone : (256,) float64, optional
        As of the look.
    tip : (2,) float64, optional
        Its free end, px: the path is taken to go straight there from where it is next to it.

    Returns
    -------
    (M, 2) float64
        The middle of the rope, px, a pixel apart, from the path's beginning up to where the rope ends.
    RopeLook
        Its look.
    Cover
        What is seen of it along this curve and beyond it, a pixel apart.

    Raises
    ------
    InvalidInput
        If no rope stands out along the path.
    """
    if tip is not None:
        path = np.concatenate([path[: int(np.hypot(*(path - tip).T).argmin()) + 1], [tip]])
    curve, last, extend = equal_steps(path), 0, 0
    for _ in range(8):  # a path that ends too early is followed further
        look = RopeLook.from_curve(image, curve, width, tone)
        ahead = curve[-1] - curve[-min(12, len(curve))]
        ahead = np.arange(1.0, extend)[:, None] * ahead / max(float(np.hypot(*ahead)), 1e-9)
        curve = np.concatenate([curve, curve[-1] + ahead])
        seen = _covered(image, curve, look)
        before, last = last, seen.end(longest) if extend else len(curve) - 1
        if last < 2.0 * look.width + 8.0:  # px
            raise InvalidInput("no rope is seen along the path", got=f"{last} px of {len(curve)}")
        shifted = places_across(curve, np.array([0.0, 1.0]))[: last + 1]
        curve = _smooth(shifted[:, 0] + (shifted[:, 1] - shifted[:, 0]) * seen.aside[: last + 1, None])
        if tip is not None or (extend and abs(last - before) < 3):
            break
        extend = 20  # px
    return equal_steps(curve), look, seen


def equal_steps(curve: Array) -> Array:
    """Return points about a pixel apart along a curve (P, 2), both ends among them."""
    length = float(np.hypot(*np.diff(curve, axis=0).T).sum())
    return at_parts(curve, np.linspace(0.0, 1.0, max(2, round(length) + 1)))


def at_parts(curve: Array, parts: Array) -> Array:
    """Return the points (M, 2) at parts (M,), 0 to 1, of the length of a curve (P, 2)."""
    arcs = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    return np.stack([np.interp(parts * arcs[-1], arcs, each) for each in curve.T], axis=1)


def profile(across: Array, width: float) -> Array:
    """Return which share (M,) of points across a rope, px, it covers, blurred by lens, pixel and compression."""
    return np.asarray(cover(across, width, 0.6))


def _sharpest(off: Array, across: Array) -> npt.NDArray[np.bool_]:
    """Return in which third of K lines (K, M, 3) the rope stands out most from the wall, averaged over an eighth."""
    middle = off[:, np.abs(across) <= 1.0].mean(axis=1)
    window = np.ones(max(1, len(off) // 8))
    count = np.convolve(np.ones(len(off)), window, "same")
    clear = sum(np.convolve(channel, window, "same") ** 2 for channel in middle.T) / count**2
    return np.asarray(clear >= np.quantile(clear, 2.0 / 3.0))


def _wall(samples: Array, outside: npt.NDArray[np.bool_], across: Array) -> Array:
    """Return the wall (K, M, 3) behind places on lines across a rope: medians of both sides, linear between them."""
    left, right = (_median(samples, outside & side) for side in (across < 0.0, across > 0.0))
    left, right = np.where(np.isnan(left), right, left), np.where(np.isnan(right), left, right)
    middle = np.abs(across[outside.any(axis=0)]).mean()
    share = np.clip(0.5 + 0.5 * across / middle, 0.0, 1.0)[:, None]
    return np.asarray((1.0 - share) * left[:, None] + share * right[:, None])


def _median(samples: Array, used: npt.NDArray[np.bool_]) -> Array:
    """Return the (lower) median (K, 3) of those of M samples (K, M, 3) that are used (K, M); NaN if there are none."""
    used = used & np.isfinite(samples).all(axis=2)
    ordered = np.sort(np.where(used[:, :, None], samples, np.inf), axis=1)
    middle = np.maximum(used.sum(axis=1) - 1, 0) // 2
    found = np.take_along_axis(ordered, middle[:, None, None], axis=1)[:, 0]
    return np.where(used.sum(axis=1, keepdims=True) > 0, found, np.nan)


def _covariance(off: Array, outside: npt.NDArray[np.bool_], wall: Array, tone: Array) -> Array:
    """Return the covariances (K, 3, 3) of samples (K, M, 3) less the wall's, without the few that are no wall."""
    size = np.where(outside, np.abs(off).sum(axis=2), np.nan)[:, :, None]
    used = size <= 4.0 * _median(size, outside)[:, None]
    off = np.where(used, off, 0.0)
    total = np.einsum("kmi,kmj->kij", off, off) / np.maximum(used.sum(axis=1), 1)[:, :, None]
    noise = NOISE * light_per_level(np.nan_to_num(wall.mean(axis=1)), tone)
    return np.asarray(total + noise[:, :, None] ** 2 * np.eye(3))


def _sparse(image: Image) -> Image:
    """Return the pixels, 16 apart, by which the light of two pictures is compared."""
    return image[::16, ::16].copy()


def _gain_between(before: Image, after: Image, tone: Array) -> Array:
    """Return by which factors (3,) a picture became brighter, from some pixels of it."""
    exposed = ((before > 10) & (before < 240) & (after < 240)).all(axis=2)  # levels
    if not exposed.any():
        return np.ones(3)
    return np.asarray(np.median(tone[after[exposed]] / tone[before[exposed]], axis=0))


def _covered(image: Image, curve: Array, look: RopeLook) -> Cover:
    """Return what is seen of a rope across a curve (K, 2), a pixel apart; of some blurs, that which fits best there.

    A blurred rope is as wide as its streak and as much fainter: so its colour is known, and tells it from others.
    Rope and wall are told apart with one covariance: that of single places of the wall beside the rope, as if averaging
    reduced no grain, and that of the rope's own texture as it is averaged.
    """
    from scipy.ndimage import uniform_filter1d

    found = []
    for wider in (0.0, 4.0, 9.0, 18.0, 2.0 * BLUR + 2.0):
        width = look.width + wider
        across = np.arange(-0.5 * width - 6.0, 0.5 * width + 6.1, 0.5)
        outside = np.abs(across) > 0.5 * width + 2.0
        seen = look.before_wall(image, places_across(curve, across), outside, across)
        off, contrast, metric = (np.nan_to_num(each) for each in seen)
        expected = look.width / width * profile(across, width)
        power = expected @ expected
        colour = np.einsum("kmc,m->kc", off, expected) / power
        own = np.einsum("kmc,m->kc", contrast, expected**2) / power
        along = np.einsum("kij,kj->ki", metric, own)
        size = np.maximum((along * own).sum(axis=1), 1.0)
        weights = np.clip(np.einsum("kmc,kc->km", off, along) / size[:, None], 0.0, 1.0)
        aside = (weights @ across) / np.maximum(weights.sum(axis=1), 1.0)
        colour, own, metric = (uniform_filter1d(each, 9, axis=0, mode="nearest") for each in (colour, own, metric))
        fit = uniform_filter1d(
            power * _nearness(colour, own, metric), 61, origin=20
        )  # it varies slowly, none beyond the end
        found.append((fit, aside, np.full(len(curve), wider), colour, own, metric, contrast.mean(axis=1)))
    best = np.argmax([each[0] for each in found], axis=0), np.arange(len(curve))
    aside, wider, colour, own, metric, contrast = (np.array(each)[best] for each in list(zip(*found, strict=True))[1:])
    off, like = (colour - own)[None], _nearness(colour, own, metric)[None] > 0.0
    like[:, len(curve) // 2 + 1 :] = False  # a path goes astray late
    texture = _covariance(off, like, look.bgr[None, None], look.tone)
    metric = np.asarray(np.linalg.inv(np.linalg.inv(metric) + texture), np.float64)
    return Cover(_nearness(colour, own, metric), aside, wider, contrast)


def _nearness(colour: Array, own: Array, metric: Array) -> Array:
    """Return how much nearer colours (K, 3), less the wall's, are to the rope's, `own` (K, 3), than to the wall's (K,).

    The difference of the squared distances, with the inverse covariance `metric` (K, 3, 3), as a part of their sum and
    1: from -1 to 1, as :attr:`Cover.rope`. So little of the rope's contrast as a shadow may have is no rope.
    """
    part = np.einsum("ki,kij->kj", own, metric)
    part = (part * colour).sum(axis=1) / np.maximum((part * own).sum(axis=1), 1e-9)
    shadow = np.clip(part, 0.0, 2.0 * SHADOW - 1.0)[:, None] * own
    wall, rope = (np.einsum("ki,kij,kj->k", each, metric, each) for each in (colour - shadow, colour - own))
    return np.asarray((wall - rope) / (wall + rope + 1.0))


def _smooth(curve: Array, std: float = 4.0) -> Array:
    """Return a curve (P, 2), a pixel apart, smoothed over some pixels; its ends stay straight."""
    from scipy.ndimage import gaussian_filter1d

    reach = min(round(3.0 * std), len(curve) - 1)
    padded = np.pad(curve, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(padded, std, axis=0)[reach : reach + len(curve)])
