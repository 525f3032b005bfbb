"""What a recording or a rope shows by itself, without a fit: direct checks of what was declared.

To add one, write a function of a recording and a rope that returns findings, and list it in CHECKS.
"""

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.model import lumped
from hyperflex.model import Rope
from hyperflex.recording import Recording, unwrap


@dataclass(frozen=True)
class EvidenceLimits:
    """Limits from which a recording contradicts its declaration by itself."""

    # markers are glued on and tracked to about this part of a link
    lengths_agree: float = 0.03
    # logarithm of a distance over a length: far beyond UNEVEN, and less than swaps of links of a rope make
    swapped: float = 0.2
    # relative difference of two scales; as the distances of markers
    uneven: float = 0.03
    # times the median deviation: a distance that a lost marker makes
    outlying: float = 6.0
    # standard errors, and distances at least
    beyond: float = 5.0
    many: int = 20
    # of the longest link over the shortest: one in cm makes 100, but for what links differ by
    apart: float = 30.0


EVIDENT = EvidenceLimits()


def neighbours_swapped(n: int, k: int) -> list[int]:
    """Return 0 to n - 1 with k and k + 1 swapped."""
    return [*range(k), k + 1, k, *range(k + 2, n)]


def unlike_lengths(rope: Rope) -> list[Finding]:
    """Return that the length of one link may be in another unit than that of another."""
    longest, shortest = int(np.argmax(rope.length)), int(np.argmin(rope.length))
    times = float(rope.length[longest] / rope.length[shortest])
    values = {"longest": longest, "shortest": shortest, "times": times}
    return [Finding(Kind.UNLIKE_LENGTHS, Severity.DOUBT, values)] if times > EVIDENT.apart else []


def hangs_upwards(rope: Rope) -> list[Finding]:
    """Return that gravity would hold a rope up."""
    wrong = bool(np.any(rope.gravity)) and lumped(rope)[0][0] <= 0.0
    return [Finding(Kind.HANGS_UPWARDS, Severity.WRONG)] if wrong else []


def other_lengths(recording: Recording, rope: Rope) -> list[Finding]:
    """Return that the distances of the markers are not the link lengths that the rope was given."""
    measured = recording.link_lengths()
    if (np.abs(measured / rope.length - 1.0) <= EVIDENT.lengths_agree).all():
        return []
    values = {"measured": measured.tolist(), "declared": rope.length.tolist()}
    return [Finding(Kind.MARKER_DISTANCES, Severity.DOUBT, values)]


def swapped(recording: Recording, rope: Rope) -> list[Finding]:
    """Return that neighbouring markers are swapped in a part of the frames: there the lengths fit the other order."""
    places = recording.data.reshape(recording.t.size, -1, 2)

    def off(order: list[int]) -> Array:
        apart = np.hypot(*np.diff(places[:, order], axis=1).T).T
        return np.asarray(np.abs(np.log(np.maximum(apart, 1e-12) / rope.length)).max(axis=1))

    fits = off(list(range(rope.n_links + 1)))
    for k in range(rope.n_links if rope.n_links > 1 else 0):
        there = (fits > EVIDENT.swapped) & (off(neighbours_swapped(rope.n_links + 1, k)) < EVIDENT.uneven)
        if there.sum() >= EVIDENT.many:
            before = np.cumsum(fits <= EVIDENT.swapped)[there]  # frames in order, which part one interval from the next
            times = [recording.t[there][before == count][[0, -1]].tolist() for count in np.unique(before)]
            return [Finding(Kind.MARKERS_SWAPPED, Severity.WRONG, {"first": k, "second": k + 1, "times": times})]
    return []


def uneven_scale(recording: Recording, rope: Rope) -> list[Finding]:
    """Return that links are longer in one direction of the picture than across it.

    With theta the direction of a link in the picture, log d = c + p cos(2 theta) + q sin(2 theta) to first order, with
    the same p and q for all links; exp(2 hypot(p, q)) is the ratio of the scales. A mean over some time makes a link
    shorter as well, the faster it turns: log d = c - s (d theta/dt)^2; what that explains better is no scale.
    """
    along = np.diff(recording.data.reshape(recording.t.size, -1, 2), axis=1)
    along = along[:, np.count_nonzero(np.hypot(*along.T) > 0.0, axis=1) >= EVIDENT.many]
    with np.errstate(divide="ignore"):
        size, double = np.log(np.hypot(*along.T)), 2.0 * np.arctan2(along[..., 1], along[..., 0]).T
    size[np.isinf(size)] = np.nan
    off = size - np.nanmedian(size, axis=1, keepdims=True)
    limit = EVIDENT.outlying * np.maximum(np.nanmedian(np.abs(off), axis=1, keepdims=True), 1e-12)
    fast = np.gradient(unwrap(0.5 * double.T), recording.t, axis=0).T ** 2
    table = np.where(np.abs(off) <= limit, [off, np.cos(double), np.sin(double), fast], np.nan)
    off, *columns, fast = (table - np.nanmean(table, axis=2, keepdims=True))[:, ~np.isnan(table[0])]
    if not off.size:
        return []
    matrix = np.transpose(columns)
    step = np.linalg.pinv(matrix, rcond=1e-3) @ off
    seen = float(np.mean((matrix @ step) ** 2))
    variance = float(np.mean((off - matrix @ step) ** 2))
    fast = np.nan_to_num(fast)  # beside gaps
    smoothed = min(float(fast @ off), 0.0) ** 2 / max(float(fast @ fast), 1e-300)
    factor = float(np.exp(2.0 * np.hypot(*step)))
    if factor - 1.0 <= EVIDENT.uneven or seen * off.size <= max(EVIDENT.beyond**2 * variance, smoothed):
        return []
    values = {"angle": 0.5 * float(np.arctan2(step[1], step[0])), "factor": factor}
    return [Finding(Kind.PICTURE_SCALE, Severity.WRONG, values)]


CHECKS = (other_lengths, uneven_scale, swapped)  # of markers at the joints


def evidence(recording: Recording, rope: Rope) -> list[Finding]:
    """Return what all checks find."""
    return [] if recording.kind != "markers" else [each for check in CHECKS for each in check(recording, rope)]
