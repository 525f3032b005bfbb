"""Usual slips in what was declared of a recording, each tried by a short fit."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import HARDLY, fit
from hyperflex.identification.fit.stages import Measurements, search_delay, with_delay
from hyperflex.identification.fit.windows import decimation_step, part_left, usual_length, with_enough_frames
from hyperflex.identification.model.parameters import lumped
from hyperflex.identification.model.plant import ANGLES, Plant
from hyperflex.identification.problem import build_plant, checked_measurements
from hyperflex.model import FREE_PROPERTIES, Arm, Rope
from hyperflex.motion import Motion
from hyperflex.recording import Recording

# Chosen on the recordings of docs/wrong-input.md, and on IBM 06 and 16 and the triple pendulum as they are
SWAPS = 4  # links or markers up to which each is tried by itself: the cost of as many short fits
BETTER = 0.5  # part of the residual that a slip leaves at most: right ones left 0.01 to 0.2, others 0.6 and more
FITS = 0.05  # part of the motion: right slips leave 0.0015 to 0.008
SHORTER, WINDOWS, ROUNDS = 4.0, 6, 12  # of a short fit: its first windows, how many, and rounds at most, for some 0.1 s
SMALL, LARGE = 0.06, 2.0  # rad: half a turn read as degrees, and degrees read as radians that are hardly a swing
TURNS = 0.7  # rad: six turns read as degrees, the farthest that a free double pendulum was seen to wind up (IBM 16)
GAIN, LEAST_GAIN = 0.3, 0.005  # logarithms of factors of angles, or of the arm's length: tried, and told
AS_GOOD = 1.1  # times the residual of another explanation: one that leaves no more explains as well
SPRING = 1.25  # the same of a spring's: a real pendulum read 10 % too large left 1.16, a double one with springs 1.5
RIGHT_ANGLE = 10.0  # degrees by which a gravity may miss one that was turned by 90 or 180
ZERO = 0.09  # rad, 5 degrees: between what is no slip and the 10 degrees that were tried
STRAIGHT, LEAST_SCALE = 0.95, 0.02  # quantile of distances that is a straight rope's; part by which scales may be off
SKEWED = ("gravity_scale", "gravity_angle")  # a wrong clock or scale, a camera that is not level

Slip = tuple[str, Recording]


def suspicious(recording: Recording) -> bool:
    """Tell whether angles are so small that they may be radians read as degrees."""
    return recording.kind == "angles" and float(np.nanmax(np.abs(recording.data))) < SMALL


def slips(recording: Recording, pivot: npt.ArrayLike | None) -> Iterator[Slip]:
    """Yield what may have been meant, in words, with the recording as it would be then.

    `pivot` (2,), m, is the place about which markers are mirrored; by default the first marker's.
    """
    yield from _of_angles(recording) if recording.kind == "angles" else _of_markers(recording, pivot)


def _of_angles(recording: Recording) -> Iterator[Slip]:
    data, n = recording.data, recording.data.shape[1]

    def changed(values: Array, factor: float = 1.0) -> Recording:
        noise = None if recording.noise is None else recording.noise * factor
        return replace(recording, data=values, noise=noise, rates=None)

    if n > 1:
        yield "the angles are relative to the link before (angles='relative')", changed(np.cumsum(data, axis=1))
        yield "the angles are absolute (angles='absolute')", changed(np.diff(data, axis=1, prepend=0.0))
        yield "the links are counted from the free end: reverse their order", changed(data[:, ::-1])
    if 2 < n <= SWAPS:
        for k in range(n - 1):
            yield f"links {k} and {k + 1} are swapped", changed(data[:, _swapped(n, k)])
    if 1 < n < SWAPS:
        for k in range(n):
            yield f"link {k} grows to the other side (sense)", changed(data * np.where(np.arange(n) == k, -1.0, 1.0))
    yield "the angles are 0 pointing up (zero='up')", changed(data + np.pi)
    yield "the angles are 0 level, along +x", changed(data + 0.5 * np.pi)
    yield "the angles are 0 level, along -x", changed(data - 0.5 * np.pi)
    if np.nanmax(np.abs(data)) > LARGE:
        yield "the angles are in degrees (unit='deg')", changed(np.radians(data), np.pi / 180.0)
    if np.nanmax(np.abs(data)) < TURNS:
        yield "the angles are in radians (unit='rad')", changed(np.degrees(data), 180.0 / np.pi)


def _of_markers(recording: Recording, pivot: npt.ArrayLike | None) -> Iterator[Slip]:
    places = recording.data.reshape(recording.t.size, -1, 2)
    n = places.shape[1]
    middle = np.nanmedian(places[:, 0], axis=0) if pivot is None else np.asarray(pivot, dtype=np.float64)
    away = places - middle

    def changed(values: Array) -> Recording:
        return replace(recording, data=values.reshape(recording.data.shape))

    yield "y points the other way (y_axis)", changed(middle + away * np.array([1.0, -1.0]))
    yield "x and y are swapped", changed(middle + away[:, :, ::-1])
    if n > 1:
        yield "the markers are counted from the free end: reverse their order", changed(places[:, ::-1])
    if 2 < n <= SWAPS + 1:
        for k in range(n - 1):
            yield f"markers {k} and {k + 1} are swapped", changed(places[:, _swapped(n, k)])


def _swapped(n: int, k: int) -> list[int]:
    order = list(range(n))
    order[k], order[k + 1] = order[k + 1], order[k]
    return order


@dataclass(frozen=True)
class ShortFit:
    """A cheap fit of the first windows of a recording; the fields are those of :func:`hyperflex.identify`."""

    rope: Rope
    free: Sequence[str]
    arc_lengths: npt.ArrayLike | None
    origin: npt.ArrayLike | None
    motion: Motion | None
    arm: Arm | None
    loss: Loss

    def __call__(self, recording: Recording, more: Sequence[str] = ()) -> tuple[float, list[float]]:
        """Return the residual, rms, as a part of the motion (inf: nothing fits), and values of `more`, also free."""
        words = [*self.free, *(each for each in more if each not in self.free)]
        words = [word for word in words if FREE_PROPERTIES[word.partition("[")[0].partition(":")[0]].owner != "arm"]
        try:
            measured, places = checked_measurements(
                recording, self.rope, self.arc_lengths, self.origin, self.motion, self.arm
            )
            plant = build_plant(recording, self.rope, words, places, self.origin, self.motion, self.arm)
            part, x = self._left(plant, measured)
        except (InvalidInput, IdentificationError):
            return np.inf, [np.nan] * len(more)
        return part, [plant.parameters.single(name, x) for name in more]

    def _left(self, plant: Plant, measured: Measurements) -> tuple[float, Array]:
        usual = with_enough_frames(usual_length(measured.shape, self.rope), measured.shape)
        if "delay" in plant.parameters.names:
            plant = with_delay(plant, search_delay(plant, measured, usual, self.loss))
        x, fitted = plant.parameters.start, None
        for length in (usual / SHORTER, usual):
            windows, _ = measured.windows(length, decimation_step(measured.channels, length))
            windows = windows[:WINDOWS]
            if sum(each.values - each.unknowns for each in windows) <= x.size:
                continue
            states = [each.guess for each in windows]
            found = fit(plant, windows, x, states, loss=self.loss, rounds=ROUNDS, enough=HARDLY)
            x, fitted = found.x, (windows, found.residuals)
        if fitted is None or lumped(plant.parameters.rope(x))[0][0] <= 0.0:
            return np.inf, x
        return part_left(*fitted), x


def scaled_angles(recording: Recording, left: ShortFit) -> str:
    """Return in words that angles read too large or too small explain as much as a stiffness that was freed.

    A pendulum whose angles are read 10 % too large seems to swing faster with its amplitude than gravity makes it. So
    does one with a spring. Nothing is said where the guess has a stiffness, or where one explains clearly more.
    """
    words = [word for word in left.free if word.partition("[")[0].partition(":")[0] != "stiffness"]
    if recording.kind != "angles" or len(words) == len(left.free) or left.rope.stiffness.any():
        return ""
    plain = replace(left, free=words)

    least, factor = _best_factor(lambda factor: plain(_multiplied(recording, factor))[0])
    if abs(np.log(factor)) < LEAST_GAIN or least > SPRING * left(recording)[0]:
        return ""
    return (
        f"stiffness was freed, but angles multiplied by {factor:.3g} explain the recording as well without any: check "
        "what an angle of the sensor is in radians, or name what is free."
    )


def _multiplied(recording: Recording, factor: float) -> Recording:
    """Return a recording of angles with all of them multiplied by a factor."""
    noise = None if recording.noise is None else recording.noise * factor
    return replace(recording, data=recording.data * factor, noise=noise, rates=None)


def _best_factor(part: Callable[[float], float]) -> tuple[float, float]:
    """Return the least part of the motion that a factor leaves, and that factor."""
    from scipy.optimize import minimize_scalar

    def by_log(log: float) -> float:
        return part(float(np.exp(log)))

    found = minimize_scalar(by_log, bounds=(-GAIN, GAIN), method="bounded", options={"xatol": 2e-3, "maxiter": 12})
    return float(found.fun), float(np.exp(found.x))


def explained(
    recording: Recording, pivot: npt.ArrayLike | None, left: ShortFit, *, named: str, gain: float = 0.0
) -> str:
    """Return in words the slip that explains a fit that is not good, or nothing.

    A slip is named if it leaves half of what the recording as declared leaves at most, and that is little. A wrong
    clock or scale and a camera that is not level come before a slip that explains less, and beside one that explains as
    much; the zero of one link comes where nothing else explains. What score tests have `named` already, with a
    `gain` of the sum of squares, has to leave twice as much.
    """
    declared, _ = left(recording)
    skewed, (scale, angle) = left(recording, SKEWED)
    most = declared
    if named.partition(":")[0] in FREE_PROPERTIES and named not in (*SKEWED, "delay"):
        most = min(most, left(recording, (named,))[0])
    if named in (ANGLES, "delay"):  # a short fit does not free the one, and takes the other from a grid
        most = min(most, declared * float(np.sqrt(1.0 - gain)))
    tried = [(_upright(other, left), words) for words, other in (*slips(recording, pivot), *_rescaled(recording, left))]
    tried += _driven(recording, left)
    least, words = min(tried, default=(np.inf, ""))
    if named in SKEWED:
        most = min(most, skewed)
    elif least > BETTER * min(most, skewed):
        skew = _skew(float(np.sqrt(scale)), float(np.degrees(angle)))
        words = f"{words}, or {skew}" if least <= AS_GOOD * skewed < np.inf else skew
        least = min(least, skewed)
    if least > min(BETTER * most, FITS):
        most = min(most, skewed)
        least, words = min(_zeros(recording, left, declared), default=(np.inf, ""))
    if least > min(BETTER * most, FITS):
        return ""
    before = f"{100.0 * declared:.2g} % of the motion" if declared < 0.995 else "all of the motion"
    part = f"{100.0 * least:.2g} % of the motion"
    return f"it fits as if {words}: a short fit leaves {part} then, and {before} as declared."


def _upright(recording: Recording, left: ShortFit) -> float:
    """Return what a short fit leaves; inf if a free direction of gravity turns by more than 45 degrees.

    It makes all zeros of the angles explain as much, each with another direction.
    """
    if "gravity_angle" not in left.free:
        return left(recording)[0]
    part, (angle,) = left(recording, ("gravity_angle",))
    return part if np.cos(angle) > np.sqrt(0.5) else np.inf


def _zeros(recording: Recording, left: ShortFit, declared: float) -> Iterator[tuple[float, str]]:
    """Yield what a short fit leaves with the zero of each link moved to where the sum of squares is least, in words.

    About quadratic in the zero: its least value follows from what is left at -ZERO, 0 and ZERO.
    """
    n = recording.data.shape[1]
    if recording.kind != "angles" or not 1 < n <= SWAPS:
        return

    def moved(k: int, zero: float) -> float:
        return left(replace(recording, data=recording.data - zero * np.eye(n)[k], rates=None))[0]

    for k in range(n):
        below, above = moved(k, -ZERO) ** 2, moved(k, ZERO) ** 2
        bend = below - 2.0 * declared**2 + above
        if 0.0 < bend < np.inf:
            zero = 0.5 * ZERO * (below - above) / bend
            yield moved(k, zero), f"the zero of link {k} is off by {np.degrees(zero):.3g} degrees"


def _driven(recording: Recording, left: ShortFit) -> Iterator[tuple[float, str]]:
    """Yield what a short fit leaves with another length of the arm, and with stamps that come late, in words."""
    if left.motion is None or left.arm is None:
        return
    arm = left.arm
    part, factor = _best_factor(
        lambda factor: replace(left, arm=replace(arm, length=factor * arm.length))(recording)[0]
    )
    yield part, f"the arm were {factor * arm.length:.3g} m long"
    if "delay" not in left.free:
        part, (delay,) = left(recording, ("delay",))
        yield part, f"the motion were {delay:.3g} s late in the recording's time (put 'delay' into free)"


def _rescaled(recording: Recording, left: ShortFit) -> Iterator[Slip]:
    """Yield markers whose greatest distances are those along the rope, if they differ as declared."""
    if recording.kind != "markers" or left.arc_lengths is None or recording.data.shape[1] < 4:
        return
    places = recording.data.reshape(recording.t.size, -1, 2)
    apart = np.nanquantile(np.hypot(*np.diff(places, axis=1).T).T, STRAIGHT, axis=0)
    factor = float(np.median(apart / np.diff(np.asarray(left.arc_lengths, dtype=np.float64))))
    if abs(factor - 1.0) > LEAST_SCALE:
        noise = None if recording.noise is None else recording.noise / factor
        words = f"the places of the markers were to be divided by {factor:.3g} (their scale)"
        yield words, replace(recording, data=recording.data / factor, noise=noise)


def _skew(clock: float, angle: float) -> str:
    """Return in words a clock that is off by a factor, and a gravity that is turned by an angle, degrees."""
    turned = f"gravity were turned by {angle:.3g} degrees"
    if abs(abs(angle) - 90.0) < RIGHT_ANGLE:
        turned += " (0 level, or x and y swapped)"
    elif abs(abs(angle) - 180.0) < RIGHT_ANGLE:
        turned += " (0 pointing up, or y the other way)"
    timed = f"times were to be multiplied by {clock:.3g} (or lengths divided by {clock**2:.3g})"
    words = [turned] * (abs(angle) > 1.0) + [timed] * (abs(clock - 1.0) > 0.01)
    return " and ".join(words or [turned])
