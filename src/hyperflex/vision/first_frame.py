"""The rope in a first frame, without a prediction: the curve from its pivot to its free end, or why there is none."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.vision.camera import Camera
from hyperflex.vision.look import RopeLook, places_across
from hyperflex.vision.ridges import Mixture, Path, Ridges
from hyperflex.vision.video import Image

LEAST_SCORE = 20.0  # evidence of a rope, decimal orders over a wall's
MISFIT = 0.1  # by which the length of a curve may differ from the rope's


class Reason(StrEnum):
    """Why no rope is found in a frame."""

    NOTHING = "no rope is seen at the pivot"
    TWO = "two ropes are seen, or one in two ways"
    OUTSIDE = "the rope leaves the view"
    BLURRED = "the rope is too blurred"
    LENGTH = "the curve has another length than the rope"


_FIXES = {
    Reason.NOTHING: "Show the pivot to a few pixels; take more light, or another wall",
    Reason.TWO: "Take the other rope away, or click the free end",
    Reason.OUTSIDE: "Move the camera back, until the whole rope is in view",
    Reason.BLURRED: "Take a frame in which the rope is slow, or a shorter exposure",
    Reason.LENGTH: "Check the length, the scale of the camera and the pivot; nothing may hide the free end",
}


class NoRope(InvalidInput):
    """No rope is found in a frame.

    Attributes
    ----------
    reason : Reason
    """

    def __init__(self, reason: Reason, got: object, allowed: str) -> None:
        super().__init__(reason.value, got=got, allowed=allowed, fix=_FIXES[reason])
        self.reason = reason


@dataclass(frozen=True, eq=False)
class FoundRope:
    """A rope in a frame.

    Attributes
    ----------
    curve : (P, 2) float64
        Its middle, px, from the pivot to the free end, a pixel apart.
    look : RopeLook
    """

    curve: Array
    look: RopeLook

    @property
    def length(self) -> float:
        """Of the curve, px."""
        return float(np.hypot(*np.diff(self.curve, axis=0).T).sum())

    def angles(self, camera: Camera, lengths: npt.ArrayLike) -> Array:
        """Return the angles (n,), rad, of links of lengths (n,), m, along the curve in the swing plane.

        The curve is taken to be as long as the links together: each joint lies at its part of it.
        """
        ends = np.concatenate([[0.0], np.cumsum(checks.array("lengths", lengths, (-1,), sign="positive", unit="m"))])
        along = np.diff(_at_parts(camera.locate(self.curve), ends / ends[-1]), axis=0)
        return np.unwrap(np.arctan2(along[:, 0], -along[:, 1]))


def find_rope(
    image: Image,
    pivot: npt.ArrayLike,
    *,
    look: RopeLook | None = None,
    length: float | None = None,
    width: float | None = None,
    radius: float = 6.0,
) -> FoundRope:
    """Find the rope that begins at a pivot, an open curve, in one frame.

    Parameters
    ----------
    image : (height, width, 3) uint8
    pivot : (2,) array_like
        Where the rope begins, px.
    look : RopeLook, optional
        If it is known; else a path keeps its own contrast.
    length : float, optional
        Of the rope, px, if it is known: a curve whose length differs by more than 10 % is refused.
    width : float, optional
        Of the rope at rest, px, if it is known.
    radius : float
        Of the disc about `pivot` in which the rope may begin, px.

    Raises
    ------
    NoRope
        With its reason: no rope, two, one that leaves the view, is too blurred, or has another length.
    """
    start = checks.array("pivot", pivot, (2,), unit="px")
    ridges = Ridges(image)
    curve, look = _measured(image, _best(ridges.paths(start, radius)).places, width)
    rope = Mixture(image, look.bgr, look.width)
    rope.learn(curve)
    paths = ridges.paths(start, radius, rope)
    curve, look = _measured(image, _best(paths).places, width)
    _check_alone(paths, 2.0 * look.width + 8.0)
    last = np.array(image.shape[1::-1]) - 1.0
    if np.minimum(curve[-1], last - curve[-1]).min() < look.width + 4.0:
        raise NoRope(Reason.OUTSIDE, np.round(curve[-1]).tolist(), "a free end in the picture")
    found = FoundRope(curve, look)
    if length is not None and abs(found.length / length - 1.0) > MISFIT:
        raise NoRope(Reason.LENGTH, f"{found.length:.0f} px", f"{length:.0f} px within {100.0 * MISFIT:g} %")
    return found


def _check_alone(paths: list[Path], apart: float) -> None:
    """Refuse a rope if another path, further apart than some px for a while, is half as likely from there on."""
    best = paths[0]
    for other in paths[1:]:
        gaps = np.linalg.norm(other.places[:, None] - best.places, axis=2)
        away = gaps.min(axis=1) > apart
        if away.any():
            leaves = int(np.argmax(away))
            gained = float(other.scores[-1] - other.scores[leaves])
            rest = float(best.scores[-1] - best.scores[int(gaps[leaves].argmin())])
            if gained > max(0.5 * rest, LEAST_SCORE):
                got = np.round([best.places[-1], other.places[-1]]).tolist()
                raise NoRope(Reason.TWO, f"free ends at {got}", "one rope")


def _best(paths: list[Path]) -> Path:
    """Return the best path, if it may be a rope."""
    if paths[0].scores[-1] < LEAST_SCORE:
        got = round(float(paths[0].scores[-1]), 1)
        raise NoRope(Reason.NOTHING, got, f"evidence of at least {LEAST_SCORE:g}, in decimal orders over the wall's")
    return paths[0]


def _measured(image: Image, path: Array, width: float | None) -> tuple[Array, RopeLook]:
    """Return the middle of the rope along a path (P, 2), px, up to where it ends, and its look."""
    curve, known = _equal_steps(path, 1.0), width
    for extend in (0.0, 20.0, 20.0):
        try:
            look = RopeLook.from_curve(image, curve, known)
        except InvalidInput as error:
            raise NoRope(Reason.NOTHING, error.got, error.allowed) from None
        if extend:
            last = curve[-1] - curve[-min(12, len(curve))]
            ahead = curve[-1] + np.arange(1.0, extend)[:, None] * last / max(float(np.hypot(*last)), 1e-9)
            curve = np.concatenate([curve, ahead])
        across = np.arange(-0.5 * look.width - 6.0, 0.5 * look.width + 6.1, 0.5)
        places = places_across(curve, across)
        shares = look.shares(image, places, np.abs(across) > 0.5 * look.width + 2.0, across)
        values = np.nan_to_num(shares.values)
        clear = np.nan_to_num(np.median(shares.std, axis=1), nan=1.0) < 0.3
        mass = np.where(clear, values.sum(axis=1) * 0.5 / look.width, 0.5)
        # the end: where what is seen until there, less half of a rope, is most
        last = int(np.argmax(np.cumsum(np.clip(mass, 0.0, 1.0) - 0.5)))
        weights = np.clip(values, 0.0, 1.0) * clear[:, None]
        aside = (weights @ across)[: last + 1] / np.maximum(weights.sum(axis=1)[: last + 1], 1.0)
        curve = _smooth(
            curve[: last + 1] + (places[: last + 1, -1] - places[: last + 1, 0]) / np.ptp(across) * aside[:, None]
        )
    return _equal_steps(curve, 1.0), look


def _smooth(curve: Array, std: float = 4.0) -> Array:
    """Return a curve (P, 2), a pixel apart, smoothed over some pixels; its ends stay straight."""
    from scipy.ndimage import gaussian_filter1d

    reach = min(round(3.0 * std), len(curve) - 1)
    padded = np.pad(curve, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(padded, std, axis=0)[reach : reach + len(curve)])


def _equal_steps(curve: Array, step: float) -> Array:
    """Return points about a step apart along a curve (P, 2), both ends among them."""
    length = float(np.hypot(*np.diff(curve, axis=0).T).sum())
    return _at_parts(curve, np.linspace(0.0, 1.0, max(2, round(length / step) + 1)))


def _at_parts(curve: Array, parts: Array) -> Array:
    """Return the points (M, 2) at parts (M,), 0 to 1, of the length of a curve (P, 2)."""
    arcs = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    return np.stack([np.interp(parts * arcs[-1], arcs, each) for each in curve.T], axis=1)
