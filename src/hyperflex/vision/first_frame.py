"""The rope in a first frame, without a prediction: the curve from its pivot to its free end, or why there is none."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.vision.camera import Camera
from hyperflex.vision.look import Cover, RopeLook, at_parts, rope_along
from hyperflex.vision.ridges import BLUR, CLICKED, SHADOW, STEP, Mixture, Path, Ridges
from hyperflex.vision.video import Image

LENGTH = 0.1  # relative difference of a curve's length from the rope's that is allowed
LEAST_SCORE = 20.0  # evidence of a rope, decimal orders over a wall's


class Reason(StrEnum):
    """Why no rope is found in a frame."""

    NOTHING = "no rope is seen at the pivot"
    TWO = "two ropes are seen, or one in two ways"
    OUTSIDE = "the rope leaves the view"
    BLURRED = "the rope is too blurred"
    HIDDEN = "a part of the rope is hidden"
    END = "it is not clear where the rope ends"
    LENGTH = "the curve has another length than the rope"
    CLICK = "no rope is seen up to the clicked free end"


_FIXES = {
    Reason.NOTHING: f"Give the pixel that the rope hangs from, to {CLICKED:g} px; take more light, or another wall",
    Reason.TWO: "Take the other rope away, or click the free end",
    Reason.OUTSIDE: "Move the camera back, until the whole rope is in view",
    Reason.BLURRED: "Take a frame in which the rope is slow, or a shorter exposure",
    Reason.HIDDEN: "Take away what is before the rope, or looks like it behind it; click its end, if any, on it",
    Reason.END: "Click the free end, or take a frame in which it is slow and before a plain wall",
    Reason.LENGTH: "Check the length, the scale of the camera and the pivot; nothing may hide the free end",
    Reason.CLICK: "Click the free end on the rope, or take a frame in which it is seen better",
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
    tip: npt.ArrayLike | None = None,
    look: RopeLook | None = None,
    length: float | None = None,
    width: float | None = None,
    tone: Array | None = None,
) -> FoundRope:
    """Find the rope that begins at a pivot, an open curve, in one frame.

    Parameters
    ----------
    image : (height, width, 3) uint8
    pivot : (2,) array_like
        Where the rope begins, px, as clicked: the search begins in a disc about it. Along the rope the pivot is where
        the curve begins, if it is a click's error from what is seen.
    tip : (2,) array_like, optional
        The free end, px, if it is clicked: the curve ends there, or is refused if it shows wall before; other ropes may
        be in the picture.
    look : RopeLook, optional
        If it is known; else a path keeps its own contrast.
    length : float, optional
        Of the rope, px, if it is known: no longer path is searched, and a curve of another length is refused.
    width : float, optional
        Of the rope at rest, px, if it is known.
    tone : (256,) float64, optional
        Of the camera, as of :class:`RopeLook`, if no `look` is given.

    Raises
    ------
    NoRope
        With its reason: no rope, two, one that leaves the view, is too blurred, has another length, or ends elsewhere.
    """
    start = checks.array("pivot", pivot, (2,), unit="px")
    end = None if tip is None else checks.array("tip", tip, (2,), unit="px")
    told = look is not None or length is not None
    length = None if length is None else checks.number("length", length, sign="positive", unit="px")
    longest, shortest = (np.inf, None) if length is None else ((1.0 + LENGTH) * length, (1.0 - LENGTH) * length)
    ridges = Ridges(image)
    try:
        if look is None:
            early = _best(ridges.paths(start, None, longest)).seen
            early = early[: 2 + min(len(early) // 2, 40)]  # a rope is slowest at its pivot, and a path goes astray late
            curve, look, _ = rope_along(image, early, width, longest, tone)
            rope = Mixture(image, look.levels, look.width)
            rope.learn(curve)
        else:
            rope, width = Mixture(image, look.levels, look.width), look.width
        path = _best(ridges.paths(start, rope, longest), end)
        curve, look, seen = rope_along(image, path.seen, width, longest, look.tone, end)
    except InvalidInput as error:
        if isinstance(error, NoRope):
            raise
        raise NoRope(Reason.NOTHING, error.got, error.allowed) from None
    ahead = curve[: min(9, len(curve))][-1] - curve[0]
    ahead /= np.hypot(*ahead)
    late = round(float(np.clip((curve[0] - start) @ ahead, -CLICKED, CLICKED)))  # px: the rope begins beside the click
    curve = np.concatenate([curve[0] - np.arange(late, 0, -1)[:, None] * ahead, curve[max(-late, 0) :]])
    found, apart = FoundRope(curve, look), 2.0 * look.width + 8.0
    if end is not None:
        _check_click(seen.rope[-round(apart) :])
        _check_seen(seen, len(seen.rope))
        if shortest is not None and not shortest <= found.length <= longest:
            raise NoRope(Reason.LENGTH, f"{found.length:.0f} px", f"{shortest:.0f} to {longest:.0f} px")
        return found
    rope.leave_out(path.places, apart)
    _check_alone(rope, path, ridges.paths(start, rope, longest)[0], apart)
    last = np.array(image.shape[1::-1]) - 1.0
    if np.minimum(curve[-1], last - curve[-1]).min() < look.width + 4.0:
        raise NoRope(Reason.OUTSIDE, np.round(curve[-1]).tolist(), "a free end in the picture")
    _check_seen(seen, seen.end(longest) + 1)
    _check_end(seen, found.length, shortest, longest)
    if not told:
        _check_beyond(seen)
    return found


def _check_seen(seen: Cover, size: int) -> None:
    """Refuse a rope, `size` px long, of which a part is wall."""
    off, wide = seen.rope[:size] < -0.5, seen.wider[:size] > BLUR
    if off.mean() > 0.1:
        reason = Reason.BLURRED if (wide & ~off).sum() > 0.1 * (~off).sum() else Reason.HIDDEN
        raise NoRope(reason, f"{100.0 * off.mean():.0f} % of the curve is no rope", "at most 10 %")


def _check_click(last: Array) -> None:
    """Refuse a click before which wall is seen, though the last pixels of the curve, `last`, lead there."""
    if (wall := -np.cumsum(last[::-1]).min()) > CLICKED:
        raise NoRope(Reason.CLICK, f"{wall:.0f} px of wall before it", f"at most {CLICKED:g} px")


def _check_end(seen: Cover, size: float, shortest: float | None, longest: float) -> None:
    """Refuse a rope, `size` px long, whose end may as well be elsewhere."""
    last = seen.end(longest)
    blurred, unsure = seen.wider[last] > BLUR, 6.0  # px of rope or wall by which ends are told apart
    if shortest is not None and (size < shortest or seen.gained.max() > seen.gained[last] + unsure):
        reason = Reason.BLURRED if blurred else Reason.LENGTH
        raise NoRope(reason, f"{size:.0f} px", f"{shortest:.0f} to {longest:.0f} px")
    ends = np.flatnonzero(np.append(seen.gained, seen.gained[-1]) >= seen.gained[last] - unsure)  # it may go on
    first, final, near = max(ends[0], shortest or 0.0), min(ends[-1], longest), max(12, round(0.04 * size))
    if max(final - last, last - first) > near or final == seen.rope.size:
        reason = Reason.BLURRED if blurred else Reason.END
        raise NoRope(reason, f"an end {first:.0f} to {final:.0f} px from the pivot", "4 % of its length to both sides")


def _check_beyond(seen: Cover) -> None:
    """Refuse a rope beyond whose end is a wall that it is not before elsewhere: a thing may hide the rest."""
    from scipy.ndimage import uniform_filter1d

    at, near = seen.end() + 1, 20  # px
    walls = uniform_filter1d(seen.contrast[: max(at - 2 * near, 1)], near, axis=0)
    off = np.linalg.norm(walls - seen.contrast[at:][:near].mean(axis=0), axis=1).min()
    other = float(off / np.linalg.norm(walls, axis=1).mean())
    if other > 0.3:
        raise NoRope(Reason.END, f"the wall changes there by {other:.2f} of the rope's contrast", "at most 0.3")


def _best(paths: list[Path], tip: Array | None = None) -> Path:
    """Return the best path, if it may be a rope; of those that pass a free end, if there are any."""
    if tip is not None:
        near = [np.hypot(*(each.places - tip).T).min() < CLICKED + STEP for each in paths]
        paths = paths[near.index(True) if any(near) else 0 :]
    if paths[0].scores[-1] < LEAST_SCORE:
        got = f"evidence {max(paths[0].scores[-1], 0.0):.0f}"
        raise NoRope(Reason.NOTHING, got, f"{LEAST_SCORE:g} or more, powers of ten for a rope against bare wall")
    return paths[0]


def _check_alone(rope: Mixture, best: Path, other: Path, apart: float) -> None:
    """Refuse a rope if another path, found where it is left out, is half as likely from where it leaves it on."""
    gaps = np.linalg.norm(other.places[:, None] - best.places, axis=2)
    away = gaps.min(axis=1) > apart
    rest = float(best.scores[-1] - best.scores[int(gaps[int(np.argmax(away))].argmin())])
    if other.scores[-1] < max(0.5 * rest, LEAST_SCORE):
        return
    seen = [float(np.median(rope.share(each))) for each in (best.places, other.places[away])]
    if seen[1] > SHADOW * seen[0]:
        got = np.round([best.places[-1], other.places[-1]]).tolist()
        raise NoRope(Reason.TWO, f"free ends at {got}", "one rope")
