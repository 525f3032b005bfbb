"""Reasons to doubt a track: how its measurements and the possible motions of its rope disagree."""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Rope, swing_rate

LARGE = 2.0  # errors over those of detection from which the set-up is doubted
DISTURBED = 0.25  # (g / L)^(3/4), density of disturbances of the whole rope from which it is doubted
SHAKING = 0.6  # px, shift of whole pictures from which the camera is doubted: three times a detection error
CORRELATION_TIME = 1.0  # sqrt(L / g), time over which residuals are alike from which they are no noise
MOVED = 0.02  # of the rope's length, rms, from which a first joint moves
SWING = 2.0  # px, rms, from which a rope swings: ten detection errors, which tell its period to about 1 %
LONGER = 0.03  # of the rope's length, from which an estimated one contradicts it: a tape errs by a tenth of that


class DoubtKind(StrEnum):
    """What is wrong, and its text with a number."""

    SHAKE = "the whole picture moves by {:.1f} px rms: the camera moves, shakes or stabilises its pictures"
    IMPOSSIBLE = (
        "the places move as those of no hanging rope: off by {:.1f} times the detection errors, alike from frame to "
        "frame, as with a swing out of the plane"
    )
    NOISE = (
        "distances of places from possible ones are {:.1f} times as large as detection errors, as with strong "
        "compression or little light"
    )
    DISTURBED = "the rope moves as if disturbed all along, by {:.2g} rad/s^2 per root of Hz"
    BASE_MOVES = "the rope's first joint moves, by {:.2g} m rms, and its motion is not declared: errors are overstated"
    END = "the rope's free end is seen in {:.0%} of the frames: the rope may be longer or shorter than given"
    BASE_ELSEWHERE = "the rope's first joint is {:.2g} m from the camera's origin"
    STILL = "the rope hangs still (it moves by {:.1f} px rms): only its place is known"
    LENGTH = "the rope swings as one whose length differs from the given one by {:+.1%}"
    OTHER_LENGTH = (
        "the rope swings as one of another length than given, by how much is not known: check the length, and what "
        "tells the size of the picture (--size)"
    )


class Doubt(NamedTuple):
    """A reason to doubt a track, and how large it is (in its text)."""

    kind: DoubtKind
    size: float

    def __str__(self) -> str:
        return self.kind.format(self.size)


SET_UP = (
    "check the camera's scale, swing plane and origin (--estimate scale=0.01 or offset_x=0.02,offset_y=0.02), the time "
    "stamps (slow motion stored at a usual rate), the arc lengths, and the rope (more links if it swings fast)"
)
ADVICE = {
    DoubtKind.SHAKE: "fix the camera, and switch its stabilisation off",
    DoubtKind.NOISE: "take more light, larger markers, or less compression",
    DoubtKind.BASE_MOVES: "film a rope that hangs from a fixed point, give the arm's motion (in Python "
    "RopeFilter(motion=, arm=)), or check the camera's scale: a wrong one has the same effect",
    DoubtKind.END: "check the rope's length, and that nothing hides its end",
    DoubtKind.STILL: "film a swing: pull the rope to the side, and release it",
    DoubtKind.LENGTH: "measure the rope's length again, and check the time stamps (slow motion stored at a usual rate)",
    DoubtKind.BASE_ELSEWHERE: "calibrate with the hook's pixel (--origin-pixel)",
}
PLAIN_SET_UP = (
    "check what tells the size of the picture (--size), the rope's length, the time stamps (slow motion stored at a "
    "usual rate), and that the rope swings in one plane"
)
PLAIN_ADVICE = ADVICE | {
    DoubtKind.NOISE: "take more light, a wall that differs more from the rope, or less compression",
    DoubtKind.BASE_MOVES: "check the pixel that the rope hangs from (--pivot) and what tells the size of the "
    "picture (--size), or film a rope that hangs from a fixed point with a fixed camera",
    DoubtKind.BASE_ELSEWHERE: "give the pixel that the rope hangs from (--pivot)",
}


def doubts(
    rope: Rope,
    level: float,
    density: Array,
    *,
    shift: float = 0.0,
    alike: float = 0.0,
    base: Array | None = None,
    end: float = 1.0,
    longer: tuple[float, float] = (0.0, 0.0),
    swing: float = math.inf,
) -> list[Doubt]:
    """Return why a track is doubted.

    Parameters
    ----------
    rope : Rope
    level : float
        Errors of the places that are seen over those of detection.
    density : (2,) float64
        Of disturbances, as of :meth:`Process.noise`.
    shift : float
        Of whole pictures, px.
    alike : float
        Time over which residuals are alike, s.
    base : (T, 2) float64, optional
        Where the first joint was found, if it was not known, m from its declared place.
    end : float
        Part of the frames in which the free end of a rope without markers is seen.
    longer : (float, float)
        By which part of itself the rope's length was found longer than given, and its standard deviation.
    swing : float
        Of the rope's places about their means, px, rms.
    """
    rate, found = swing_rate(rope), []
    if base is not None:
        moved = float(np.sqrt(base.var(axis=0).sum()))
        if moved >= MOVED * rope.total_length:
            return [Doubt(DoubtKind.BASE_MOVES, moved)]
        found.append(Doubt(DoubtKind.BASE_ELSEWHERE, float(np.linalg.norm(base.mean(axis=0)))))
    if end < 0.3:  # of the frames: else it may be elsewhere
        found.append(Doubt(DoubtKind.END, end))
    if swing < SWING:
        found.append(Doubt(DoubtKind.STILL, swing))
    if abs(longer[0]) - 3.0 * longer[1] >= LONGER:  # three standard deviations are left to chance
        found.append(Doubt(DoubtKind.LENGTH, longer[0]))
    if shift >= SHAKING:
        found.append(Doubt(DoubtKind.SHAKE, shift))
    if level >= LARGE:
        found.append(Doubt(DoubtKind.IMPOSSIBLE if alike * rate >= CORRELATION_TIME else DoubtKind.NOISE, level))
    if rate > 0.0 and swing >= SWING and float(density[0]) >= DISTURBED * rate**1.5:
        found.append(Doubt(DoubtKind.DISTURBED, float(density[0])))
    return found


def advice(found: Sequence[Doubt], *, plain: bool = False) -> str:
    """Return what to do about doubts, of a rope without markers if it is `plain`; empty if there are none."""
    known, other = (PLAIN_ADVICE, PLAIN_SET_UP) if plain else (ADVICE, SET_UP)
    return "; ".join(dict.fromkeys(known.get(each.kind, other) for each in found))


def explained(found: Sequence[Doubt], *, plain: bool = False) -> str:
    """Return doubts as a text with what to do, see :func:`advice`; empty if there are none."""
    return f"{'; '.join(map(str, found))}: {advice(found, plain=plain)}" if found else ""
