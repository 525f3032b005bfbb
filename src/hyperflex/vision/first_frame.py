"""The rope in a first frame, without a prediction: the curve from its pivot to its free end, or why there is none."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.vision.camera import Camera
from hyperflex.vision.look import CLICKED, Cover, RopeLook, at_parts, rope_along
from hyperflex.vision.ridges import Mixture, Path, Ridges
from hyperflex.vision.video import Image

LEAST_SCORE = 20.0  # evidence of a rope, decimal orders over a wall's


class Reason(StrEnum):
    """Why no rope is found in a frame."""

    NOTHING = "no rope is seen at the pivot"
    TWO = "two ropes are seen, or one in two ways"
    OUTSIDE = "the rope leaves the view"
    BLURRED = "the rope is too blurred"
    END = "it is not clear where the rope ends"
    LENGTH = "the curve has another length than the rope"


_FIXES = {
    Reason.NOTHING: "Show the pivot to a few pixels; take more light, or another wall",
    Reason.TWO: "Take the other rope away, or click the free end",
    Reason.OUTSIDE: "Move the camera back, until the whole rope is in view",
    Reason.BLURRED: "Take a frame in which the rope is slow, or a shorter exposure",
    Reason.END: "Take a frame in which the free end is slow and before a plain wall",
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
        along = np.diff(at_parts(camera.locate(self.curve), ends / ends[-1]), axis=0)
        return np.unwrap(np.arctan2(along[:, 0], -along[:, 1]))


def find_rope(
    image: Image,
    pivot: npt.ArrayLike,
    *,
    look: RopeLook | None = None,
    length: float | None = None,
    tolerance: float = 0.1,
    width: float | None = None,
    radius: float = CLICKED,
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
        Of the rope, px, if it is known: a curve of another length is refused.
    tolerance : float
        By which the length of a curve may differ from the rope's, as a part of it.
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
    try:
        if look is None:
            curve = rope_along(image, _best(ridges.paths(start, radius)).places, width)[0]
            sure = curve[: max(2, len(curve) // 2)]  # a rope is slowest at its pivot, and a path goes astray late
            look = RopeLook.from_curve(image, sure, width)
            rope = Mixture(image, look.bgr, look.width)
            rope.learn(sure)
        else:
            rope, width = Mixture(image, look.bgr, look.width), look.width
        path = _best(ridges.paths(start, radius, rope))
        curve, look, seen = rope_along(image, path.places, width)
    except InvalidInput as error:
        if isinstance(error, NoRope):
            raise
        raise NoRope(Reason.NOTHING, error.got, error.allowed) from None
    found, apart = FoundRope(curve, look), 2.0 * look.width + 8.0
    rope.leave_out(path.places, apart)
    _check_alone(rope, path, ridges.paths(start, radius, rope)[0], apart)
    last = np.array(image.shape[1::-1]) - 1.0
    if np.minimum(curve[-1], last - curve[-1]).min() < look.width + 4.0:
        raise NoRope(Reason.OUTSIDE, np.round(curve[-1]).tolist(), "a free end in the picture")
    if length is not None and abs(found.length / length - 1.0) <= tolerance:
        return found
    _check_end(seen, max(5, round(0.03 * found.length)))
    if length is not None:
        raise NoRope(Reason.LENGTH, f"{found.length:.0f} px", f"{length:.0f} px within {100.0 * tolerance:g} %")
    return found


def _check_end(seen: Cover, near: int) -> None:
    """Refuse a rope that is not seen as one, no more and no less, until its end, some px before it, or is so beyond."""
    from scipy.ndimage import uniform_filter1d

    last = int(np.argmax(seen.gained))
    mass = uniform_filter1d(seen.mass[:last], near)
    off = (np.abs(mass - 1.0) > 0.35) & (seen.wider[:last] > 0.0)
    if off.mean() > 0.1:
        reason = Reason.BLURRED if mass[off].mean() < 1.0 else Reason.END
        raise NoRope(reason, f"{100.0 * off.mean():.0f} % of the curve is no rope", "at most 10 %")
    beyond = np.append(seen.mass[last + 1 :], 1.0)[:near]  # where nothing was looked at, the rope may go on
    before, after = float(seen.mass[last - near : last].mean()), float(beyond.mean())
    if abs(before - 1.0) > 0.35 or before - after < 0.5:
        got = f"{before:.2f} of its width before it, {after:.2f} beyond"
        raise NoRope(Reason.END, got, "1 within 0.35, and 0.5 less beyond")


def _best(paths: list[Path]) -> Path:
    """Return the best path, if it may be a rope."""
    if paths[0].scores[-1] < LEAST_SCORE:
        got = round(float(paths[0].scores[-1]), 1)
        raise NoRope(Reason.NOTHING, got, f"evidence of at least {LEAST_SCORE:g}, in decimal orders over the wall's")
    return paths[0]


def _check_alone(rope: Mixture, best: Path, other: Path, apart: float) -> None:
    """Refuse a rope if another path, found where it is left out, is half as likely from where it leaves it on."""
    gaps = np.linalg.norm(other.places[:, None] - best.places, axis=2)
    away = gaps.min(axis=1) > apart
    rest = float(best.scores[-1] - best.scores[int(gaps[int(np.argmax(away))].argmin())])
    if other.scores[-1] < max(0.5 * rest, LEAST_SCORE):
        return
    seen = [float(np.median(rope.share(each))) for each in (best.places, other.places[away])]
    if seen[1] > 0.65 * seen[0]:  # a shadow is less
        got = np.round([best.places[-1], other.places[-1]]).tolist()
        raise NoRope(Reason.TWO, f"free ends at {got}", "one rope")
