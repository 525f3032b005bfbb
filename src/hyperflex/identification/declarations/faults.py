"""What a recording and a rope show by themselves, before any fit: lost markers, jumps, frames; lengths and scales.

To add one, write a function of a recording that yields findings, and list it in FAULTS, or one of a recording and a
rope, and list it in CHECKS. Nothing is repaired here, and what is not sure is left to the fit.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.model import lumped
from hyperflex.model import Rope
from hyperflex.recording import UNIT, Recording, unwrap


@dataclass(frozen=True)
class FaultLimits:
    """Limits beyond which samples are no motion of a rope with noise."""

    # times what a sample usually is off from its neighbours: a tumbling rope at 30 frames/s makes 2
    far: float = 4.0
    # times the resolution, the least step: a channel that moves so much between frames is not at rest
    moving: float = 4.0
    # part of the steps: fewer repeated frames do no harm
    several: float = 0.01
    # rad: a step longer than three quarters of a turn is a wrapped one
    wrapped: float = 1.5 * np.pi
    # part of a frame time by which frames are early or late; the least number of samples that show it
    uneven: float = 0.15
    many: int = 20
    # times what noise, and the motion across, make of it
    clear: float = 2.0
    # part of the motion's reach: smaller jumps change little
    matters: float = 0.01
    # standard deviations of a jump: tumbling links with noise make 7 in a million samples. Where polynomials do not
    # follow the motion to noise, so many times as large: a whip of the tip at 25 frames/s makes 8
    jump: float = 8.0
    sharp: float = 6.0
    # samples on either side of a jump, through which polynomials go, and by how much more variance they may leave than
    # fewer samples do, to be used; standard deviations by which jumps of fewer samples, and what is left, may differ
    sides: tuple[int, ...] = (5, 6, 8, 12, 20)
    alike: float = 1.5
    agree: float = 3.0
    # frames that are missing at a time at most, and by how much their number may seem to be no whole one
    missing: int = 3
    whole: float = 0.4
    # parts of the motion's reach: what a hand that holds a rope trembles by at most, and a rope that moves for certain;
    # time of rest over that in which it moves so far: the turn of a swing has 1.5, one that is flat for long has 4
    rests: float = 0.05
    moves: float = 0.2
    longer: float = 5.0
    # instants at which a rest is searched at most
    instants: int = 1024
    # markers are glued on and tracked to about this part of a link
    lengths_agree: float = 0.03
    # logarithm of a distance over a length: far beyond `scales`, and less than swaps of links of a rope make
    swapped: float = 0.2
    # relative difference of two scales; as the distances of markers
    scales: float = 0.03
    # times the median deviation: a distance that a lost marker makes
    outlying: float = 6.0
    # standard errors at least
    beyond: float = 5.0
    # of the longest link over the shortest: one in cm makes 100, but for what links differ by
    apart: float = 30.0


LIMITS = FaultLimits()
TERMS = 6  # of a polynomial of fifth degree: twice as many samples as a cubic follows
BAND = 0.95  # part of the windows from which the deviation of jumps is taken: those about a true one are fewer


def lost(recording: Recording) -> Iterator[Finding]:
    """Yield that a marker or an angle falls to exactly one place, as programs write what they lost.

    Not where that place is near the samples before and after, as at the turn of a swing or for a marker at rest. A
    place other than 0 in half of the samples is the motion's own, and the first of several markers may be a hook that
    stands at the origin.
    """
    markers = recording.kind == "markers"
    found: dict[str, list[tuple[int, float]]] = {}
    for number, place in enumerate(np.moveaxis(recording.data.reshape(recording.t.size, -1, 1 + markers), 1, 0)):
        place = place[np.isfinite(place).all(axis=1)]
        if len(place) < LIMITS.many:
            continue
        places, which, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
        at, same = which.ravel() == np.argmax(count), places[np.argmax(count)]
        hook = number == 0 and recording.data.shape[1] > 1 + markers
        if not 1 < at.sum() < (0.5 if hook or same.any() else 1.0) * at.size:
            continue
        here, there = np.flatnonzero(at), np.flatnonzero(~at)
        around = np.column_stack([np.interp(here, there, column) for column in place[there].T])
        away = float(np.median(np.linalg.norm(around - same, axis=1)))
        apart = ~(at[1:] | at[:-1])
        step, bend = (np.linalg.norm(np.diff(place, order, axis=0), axis=1) for order in (1, 2))
        step, bend = step[apart], bend[apart[1:] & apart[:-1]]
        if bend.size and away > max(  # a repeated frame is a step away
            0.5 * LIMITS.far * np.quantile(bend, 0.9), np.quantile(step, 0.9), LIMITS.matters * np.ptp(place)
        ):
            shown = f"({same[0]:.4g}, {same[-1]:.4g})" if markers else f"{same[0]:.4g} rad"
            found.setdefault(shown, []).append((number, float(at.mean())))
    for shown, each in found.items():
        where = ", ".join(recording.label(number) for number, _ in each)
        part = max(part for _, part in each)
        yield Finding(Kind.LOST, values={"where": where[0].upper() + where[1:], "place": shown, "part": part})


def wrapped(recording: Recording) -> Iterator[Finding]:
    """Yield that an angle jumps by about a whole turn, and not there and back at once as an outlier does."""
    for link, column in enumerate(recording.data.T if recording.kind == "angles" else ()):
        known = np.flatnonzero(~np.isnan(column))
        step = np.diff(column[known], prepend=column[known[0]], append=column[known[-1]])
        turned = np.abs(np.abs(step) - 2.0 * np.pi) < 2.0 * np.pi - LIMITS.wrapped
        back = np.abs(step[1:] + step[:-1]) < np.pi
        turned &= ~(np.append(back, False) | np.append(False, back))
        if turned.any():
            first = float(recording.t[known[min(int(np.argmax(turned)), known.size - 1)]])
            where = recording.label(link)
            yield Finding(
                Kind.WRAPPED, values={"link": link, "where": where, "count": int(turned.sum()), "time": first}
            )


def repeated(recording: Recording) -> Iterator[Finding]:
    """Yield that frames repeat the frame before while the rope moves: a slower camera, stored faster.

    Steps of at most the resolution are counted between motion on both sides. Those that are not exactly 0 tell how
    often noise of a coarse sensor makes such steps by chance.
    """
    size = np.abs(np.diff(recording.data, axis=0))
    resolution = np.where(size > 0.0, size, np.inf).min(axis=0, initial=np.inf)
    moves = (size >= LIMITS.moving * resolution).any(axis=1)
    still = (size <= 1.5 * resolution).all(axis=1)
    number, count = np.arange(len(size)), len(size)
    before = np.maximum.accumulate(np.where(still, -1, number))
    after = np.minimum.accumulate(np.where(still, count, number)[::-1])[::-1]
    between = still & np.append(moves, False)[before] & np.append(moves, False)[after]
    exact = between & (size == 0.0).all(axis=1)
    if exact.sum() > max(LIMITS.several * count, (between & ~exact).sum()):
        yield Finding(Kind.REPEATED_FRAMES, values={"part": float(exact.sum() / count)})


def _even(recording: Recording, longest: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return whether times are even (T - longest + 1,) in windows of so many samples: uneven ones know of gaps."""
    dt = np.diff(recording.t)
    odd = np.abs(dt / np.median(dt) - 1.0) > 0.1
    return np.asarray(np.convolve(odd, np.ones(longest - 1), "valid") == 0.0, dtype=np.bool_)


def uneven_frames(recording: Recording) -> Iterator[Finding]:
    """Yield that frames are early or late, while their times are even: frames are missing, and times count on.

    A sample is compared with a cubic through its four neighbours. Frames at wrong times are off along the motion of all
    channels together, more where it is fast. Noise is off in all directions and at all speeds alike.
    """
    data, around = recording.data, 3
    if recording.t.size < 2 * around + 4 + LIMITS.many:
        return
    off = (data[2:-2] - (4.0 * (data[1:-3] + data[3:-1]) - data[:-4] - data[4:]) / 6.0)[around:-around]
    speed = ((data[2 * around :] - data[: -2 * around]) / (2.0 * around))[2:-2]
    rows = np.isfinite(off).all(axis=1) & np.isfinite(speed).all(axis=1) & _even(recording, 2 * around + 5)
    reach = np.nanmax(data, axis=0) - np.nanmin(data, axis=0)
    moving = reach > 0.1 * reach.max()
    off, speed = off[rows][:, moving], speed[rows][:, moving]
    fast = np.linalg.norm(speed, axis=1)
    if fast.size < LIMITS.many or not np.median(fast) > 0.0:
        return
    along = (off * speed).sum(axis=1) / np.maximum(fast, 1e-300)
    upper, lower = fast >= np.median(fast), fast <= np.quantile(fast, 0.25)
    seen = float(np.median(np.abs(along[upper])))
    noise = float(np.median(np.abs(along[lower])))
    if moving.sum() > 1:
        across = np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0.0) / (moving.sum() - 1))
        noise = max(noise, float(np.median(across[upper])))
    part = float(np.median(np.abs(along[upper]) / fast[upper]))
    if part > LIMITS.uneven and seen > LIMITS.clear * noise:
        yield Finding(Kind.UNEVEN_FRAMES, values={"part": part})


def missing_frames(recording: Recording) -> Iterator[Finding]:
    """Yield that the motion skips whole frames, while times are even: all channels together step two to four times.

    A step is compared with the mean of the two steps on either side of it, over all channels, where these four agree.
    Other jumps go back as often as ahead, and by no whole steps.
    """
    data = recording.data
    if recording.t.size < 6 + LIMITS.many:
        return
    step = np.diff(data, axis=0)
    around = np.stack([step[:-4], step[1:-3], step[3:-1], step[4:]])
    usual = around.mean(axis=0)
    more, fast = step[2:-2] - usual, np.linalg.norm(usual, axis=1)
    alike = np.linalg.norm(around - usual, axis=2).max(axis=0) < LIMITS.whole * fast
    known = np.isfinite(more).all(axis=1) & _even(recording, 6)
    if not known.any():
        return
    resolution = np.abs(step).min(initial=np.inf, where=np.abs(step) > 0.0)
    noise = max(float(np.median(np.abs(more[known]))) / NormalDist().inv_cdf(0.75), resolution)
    odd = known & alike & (np.sqrt((more**2).mean(axis=1)) > LIMITS.jump * noise)
    count = np.divide((more * usual).sum(axis=1), fast**2, out=np.zeros(fast.size), where=odd)
    ahead = odd & (np.abs(count - np.round(count).clip(1.0, LIMITS.missing)) < LIMITS.whole)
    if ahead.sum() > 1 and ahead.sum() > 0.5 * odd.sum():
        yield Finding(Kind.MISSING_FRAMES, values={"times": recording.t[np.flatnonzero(ahead) + 2].tolist()})


class _Jump(NamedTuple):
    """A jump between the sample `before` and the next: how large, and in standard deviations."""

    channel: int
    before: int
    size: float
    certain: float


def _jumps(column: Array, channel: int, recording: Recording, reach: float, apart: int) -> Iterator[_Jump]:
    """Yield jumps of a channel: where polynomials with a jump in the middle leave no more than usual.

    As many samples are used as leave no more variance than fewer ones, so that it is noise; those must see it as well.
    `apart` is as of _Polynomials.
    """
    fits = list[_Polynomials]()
    for side in LIMITS.sides:
        if 4 * side > column.size:
            break
        if side <= apart:
            continue
        fit = _Polynomials.of(np.where(_even(recording, 2 * side), 1.0, np.nan), column, side, apart)
        if not np.isfinite(fit.usual) or (fits and fit.usual > LIMITS.alike * fits[0].usual):
            break
        fits.append(fit)
    if not fits or not fits[-1].usual > 0.0:
        return
    best = fits[-1]
    certain = np.abs(best.size) / best.std
    certain[~(best.variance <= best.usual * (1.0 + LIMITS.agree * np.sqrt(2.0 / (2 * best.side - TERMS - apart))))] = (
        0.0
    )
    certain[np.abs(best.size) < LIMITS.matters * reach] = 0.0
    for fit in fits[:-1]:
        inner = slice(best.side - fit.side, best.side - fit.side + certain.size)
        certain[~(np.abs(fit.size[inner] - best.size) <= LIMITS.agree * fit.std)] = 0.0
    limit = LIMITS.jump * (LIMITS.sharp if len(fits) == 1 else 1.0)
    while certain.max(initial=0.0) > limit:
        k = int(np.argmax(certain))
        yield _Jump(channel, k + best.side - 1, float(best.size[k]), float(certain[k]))
        certain[max(0, k - best.side) : k + best.side + 1] = 0.0


class _Polynomials(NamedTuple):
    """Polynomials of fifth degree with a jump in the middle, through each window of 2 `side` samples (W,); NaN in gaps.

    The jump, the variance left, its median, and the standard deviation of jumps that are none.
    With `apart` = 1 the value alone jumps, with TERMS all derivatives: each side is followed by itself.
    """

    side: int
    size: Array
    variance: Array
    usual: float
    std: float

    @classmethod
    def of(cls, known: Array, column: Array, side: int, apart: int) -> "_Polynomials":
        """Return those of the windows that are `known` (W,): 1, or NaN."""
        u = (np.arange(2 * side) - side + 0.5) / side
        powers = np.vander(u, TERMS, increasing=True)
        model = np.column_stack([(u > 0.0)[:, None] * powers[:, :apart], powers])
        column = column - np.nanmedian(column)
        rows = [np.linalg.pinv(model)[0], *np.linalg.qr(model)[0].T]
        size, *along = (np.correlate(column, row, "valid") * known for row in rows)
        left = np.correlate(column**2, np.ones(2 * side), "valid") - np.sum(np.square(along), axis=0)
        variance = np.maximum(left, 0.0) / (2 * side - TERMS - apart)
        largest = np.nanargmax(np.append(np.abs(size), 0.0))
        others = np.abs(size[np.abs(np.arange(size.size) - largest) >= side])
        if not np.isfinite(others).any():
            return cls(side, size, variance, np.inf, np.inf)
        std = float(np.nanquantile(others, BAND)) / NormalDist().inv_cdf(0.5 + 0.5 * BAND)
        return cls(side, size, variance, float(np.nanmedian(variance)), std)


def jumps(recording: Recording) -> Iterator[Finding]:
    """Yield that a channel jumps by a constant and stays there, or that frames are missing.

    Where frames are missing several links or markers jump at once, or one jumps more than once. Where many are missing,
    half of the channels that move jump at once and move on differently.
    """
    reaches = np.nanmax(recording.data, axis=0) - np.nanmin(recording.data, axis=0)
    reach = min(float(reaches.max()), 2.0 * np.pi) if recording.kind == "angles" else float(reaches.max())
    each, moving = 1 + (recording.kind == "markers"), float((reaches > 0.1 * reaches.max()).sum())
    for apart in (1, TERMS):
        every = enumerate(recording.data.T)
        found = [jump for k, column in every for jump in _jumps(column, k, recording, reach, apart)]
        if not found:
            continue
        before = np.array([jump.before for jump in found])
        times = np.unique(before)
        most = max(found, key=lambda jump: jump.certain)
        if apart > 1:
            times = times[[(np.abs(before - k) <= 1).sum() >= 0.5 * moving for k in times]]
            missing = times.size > 0
        else:
            alike = {jump.channel for jump in found if _together(jump, most)}
            camera = recording.kind == "markers" and len(alike) == recording.data.shape[1] // 2 > 1
            links = {jump.channel // each for jump in found if abs(jump.before - most.before) <= 1}
            missing = not camera and (np.ptp(before) > 1 or len(links) > 1)
        if missing:
            yield Finding(Kind.MISSING_FRAMES, values={"times": recording.t[times].tolist()})
        elif apart == 1:
            channel = f"{'xy'[most.channel % 2]} of all markers" if camera else recording.channel(most.channel)
            values = {"channel": channel, "size": most.size, "unit": UNIT[recording.kind]}
            yield Finding(Kind.JUMP, values=values | {"time": float(recording.t[most.before])})
        return


def _together(one: _Jump, other: _Jump) -> bool:
    """Whether two jumps are of one axis, at one time and of about one size: those of a camera that was moved."""
    same = one.channel % 2 == other.channel % 2 and abs(one.before - other.before) <= 1
    return same and abs(one.size - other.size) < 0.5 * abs(other.size)


def held(recording: Recording) -> Iterator[Finding]:
    """Yield that a rope rests and then moves at once, as one that a hand holds and releases, or pushes.

    Friction takes energy, so a rope that nothing drives rests in equilibrium alone, and for good. At the turn of a
    swing it pauses for hardly longer than it takes to move on.
    """
    from scipy.ndimage import median_filter

    rows = np.isfinite(recording.data).any(axis=1)
    t, data = recording.t[rows], recording.data[rows]
    if t.size < LIMITS.many:
        return
    filled = np.column_stack([np.interp(t, t[np.isfinite(c)], c[np.isfinite(c)]) for c in data.T])
    filled = median_filter(filled, size=(5, 1), mode="nearest")  # without outliers
    reach = float(np.ptp(filled, axis=0).max())
    reach = min(reach, 2.0 * np.pi) if recording.kind == "angles" else reach
    if np.nanmedian(np.abs(data - filled)) > LIMITS.rests * reach:  # noise alone
        return
    even = np.linspace(t[0], t[-1], min(t.size, LIMITS.instants))
    places = (np.interp(even, t, column) for column in filled.T)
    away = reduce(np.maximum, (np.abs(np.subtract.outer(each, each)) for each in places))
    # instants before one since when the rope has been near, and after one until it is far
    left = np.pad(np.tril(away > LIMITS.rests * reach), ((0, 0), (1, 0)), constant_values=True)
    rested = np.argmax(left[:, ::-1], axis=1) - np.arange(even.size)[::-1]
    ahead = np.triu(away >= LIMITS.moves * reach)
    moving = np.where(ahead.any(axis=1), np.argmax(ahead, axis=1) - np.arange(even.size), even.size)
    at = np.flatnonzero(rested >= LIMITS.longer * np.maximum(moving, 2))  # one step does not tell how long it took
    if at.size:
        yield Finding(Kind.HELD_STILL, values={"time": float(t[np.searchsorted(t, even[at[-1]])])})


FAULTS = (lost, wrapped, repeated, uneven_frames, missing_frames, jumps, held)


def faults(recording: Recording, *, driven: bool = False) -> list[Finding]:
    """Return what the first of them finds that finds anything: others may follow from it.

    A rope that is `driven` may well rest and then move.
    """
    tried = (check for check in FAULTS if not (driven and check is held))
    return next((found for check in tried if (found := list(check(recording)))), [])


def neighbours_swapped(n: int, k: int) -> list[int]:
    """Return 0 to n - 1 with k and k + 1 swapped."""
    return [*range(k), k + 1, k, *range(k + 2, n)]


def unlike_lengths(rope: Rope) -> list[Finding]:
    """Return that the length of one link may be in another unit than that of another."""
    longest, shortest = int(np.argmax(rope.length)), int(np.argmin(rope.length))
    times = float(rope.length[longest] / rope.length[shortest])
    values = {"longest": longest, "shortest": shortest, "times": times}
    return [Finding(Kind.UNLIKE_LENGTHS, Severity.DOUBT, values)] if times > LIMITS.apart else []


def hangs_upwards(rope: Rope) -> list[Finding]:
    """Return that gravity would hold a rope up."""
    wrong = bool(np.any(rope.gravity)) and lumped(rope)[0][0] <= 0.0
    return [Finding(Kind.HANGS_UPWARDS, Severity.WRONG)] if wrong else []


def other_lengths(recording: Recording, rope: Rope) -> list[Finding]:
    """Return that the distances of the markers are not the link lengths that the rope was given."""
    measured = recording.link_lengths()
    if (np.abs(measured / rope.length - 1.0) <= LIMITS.lengths_agree).all():
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
        there = (fits > LIMITS.swapped) & (off(neighbours_swapped(rope.n_links + 1, k)) < LIMITS.scales)
        if there.sum() >= LIMITS.many:
            before = np.cumsum(fits <= LIMITS.swapped)[there]  # frames in order, which part one interval from the next
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
    along = along[:, np.count_nonzero(np.hypot(*along.T) > 0.0, axis=1) >= LIMITS.many]
    with np.errstate(divide="ignore"):
        size, double = np.log(np.hypot(*along.T)), 2.0 * np.arctan2(along[..., 1], along[..., 0]).T
    size[np.isinf(size)] = np.nan
    off = size - np.nanmedian(size, axis=1, keepdims=True)
    limit = LIMITS.outlying * np.maximum(np.nanmedian(np.abs(off), axis=1, keepdims=True), 1e-12)
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
    if factor - 1.0 <= LIMITS.scales or seen * off.size <= max(LIMITS.beyond**2 * variance, smoothed):
        return []
    values = {"angle": 0.5 * float(np.arctan2(step[1], step[0])), "factor": factor}
    return [Finding(Kind.PICTURE_SCALE, Severity.WRONG, values)]


CHECKS = (other_lengths, uneven_scale, swapped)  # of markers at the joints


def evidence(recording: Recording, rope: Rope) -> list[Finding]:
    """Return what all checks find."""
    return [] if recording.kind != "markers" else [each for check in CHECKS for each in check(recording, rope)]
