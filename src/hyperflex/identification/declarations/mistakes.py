"""Usual mistakes in what was declared of a recording: what may have been meant, tried by short fits.

To add one, yield its finding and the data as they would be then from `_variants`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput
from hyperflex.identification.declarations.faults import neighbours_swapped
from hyperflex.identification.declarations.held import CLOCK, base
from hyperflex.identification.declarations.score_tests import ScoreTest
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.fit import HARDLY, Loss, fit, part_left
from hyperflex.identification.measurements import Measurements, build_plant, checked_measurements, usual_length
from hyperflex.identification.model import ANGLES, ARM_LENGTH, Plant, extended, lumped
from hyperflex.identification.multi_start import search_delay, with_delay
from hyperflex.identification.options import RecordingSetup
from hyperflex.model import FREE_PROPERTIES, Rope
from hyperflex.recording import Recording


@dataclass(frozen=True)
class MistakeOptions:
    """Which mistakes are tried, by how short a fit, and when one explains a poor fit."""

    # links or markers up to which each is tried separately: the cost of as many short fits
    swaps: int = 4
    # rad: degrees read as radians reach farther, except for a tiny swing
    large: float = 2.0
    # rad: six turns read as degrees, the farthest that a free double pendulum was seen to wind up
    turns: float = 0.7
    # quantile of distances that is a straight rope's; part by which scales may be off
    straight: float = 0.95
    least_scale: float = 0.02
    # Thresholds from the recordings of benchmarks/wrong_input.py, and IBM 06 and 16 and the triple pendulum as they
    # are: part of the residual that a mistake leaves at most; right ones left 0.01 to 0.2, others 0.6 and more
    better: float = 0.5
    # part of the motion: right ones leave 0.0015 to 0.008
    fits: float = 0.05
    # of a short fit: its first windows, how many, and rounds at most, for some 0.1 s
    shorter: float = 4.0
    windows: int = 6
    rounds: int = 12
    # logarithms of factors of angles, or of the arm's length: the largest believed, and the least reported
    farthest: float = 0.3
    least_gain: float = 0.005
    # times the residual of another explanation: one that leaves no more explains as well
    as_good: float = 1.1
    # times the residual of a spring: angles that leave no more explain as well; a real pendulum read 10 % too large
    # left 1.16, a double one with springs 1.5
    spring: float = 1.25
    # rad, and part: the least rotated gravity and wrong clock that are reported
    least_angle: float = float(np.radians(1.0))
    least_clock: float = 0.01


SHORT_FIT = MistakeOptions()
SKEWED = (CLOCK, "gravity_angle")  # a wrong clock or scale, a camera that is not level

Variant = tuple[Finding, Array, float]  # a mistake; the data as they would be then; the factor on their noise
Tried = tuple[float, list[Finding]]  # part of the motion that is left, and what that means


def _variants(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    """Yield the usual mistakes: another order of links or markers, and what is wrong in angles or in markers alone."""
    markers = recording.kind == "markers"
    what, data = "markers" if markers else "links", recording.data.reshape(recording.t.size, -1, 1 + markers)
    n, reach = data.shape[1], np.linalg.norm(np.nanmax(data, axis=0) - np.nanmin(data, axis=0), axis=1)
    if n > 1 and (not markers or reach[-1] < reach[0]):  # what the rope hangs from moves least
        yield Finding(Kind.REVERSED, values={"what": f"the {what}"}), data[:, ::-1], 1.0
    for k in range(n - 1) if 2 < n <= SHORT_FIT.swaps + markers else ():
        values = {"what": what, "first": k, "second": k + 1}
        yield Finding(Kind.SWAPPED, values=values), data[:, neighbours_swapped(n, k)], 1.0
    yield from _of_markers(data, setup) if markers else _of_angles(recording.data)


def _of_angles(q: Array) -> Iterator[Variant]:
    n, largest = q.shape[1], np.nanmax(np.abs(q))
    if n > 1:
        yield Finding(Kind.RELATIVE), np.cumsum(q, axis=1), 1.0
        yield Finding(Kind.ABSOLUTE), np.diff(q, axis=1, prepend=0.0), 1.0
    for k in range(n) if 1 < n < SHORT_FIT.swaps else ():
        yield Finding(Kind.SENSE, values={"link": k}), q * np.where(np.arange(n) == k, -1.0, 1.0), 1.0
    for where, angle in (("pointing up", np.pi), ("level, along +x", 0.5 * np.pi), ("level, along -x", -0.5 * np.pi)):
        yield Finding(Kind.ZERO_DIRECTION, values={"where": where, "turn": angle}), q + angle, 1.0
    if largest > SHORT_FIT.large:
        yield Finding(Kind.DEGREES), np.radians(q), np.pi / 180.0
    if largest < SHORT_FIT.turns:
        yield Finding(Kind.RADIANS), np.degrees(q), 180.0 / np.pi


def _of_markers(places: Array, setup: RecordingSetup) -> Iterator[Variant]:
    """Yield other axes, and another scale if distances differ from those along the rope."""
    middle = np.nanmedian(places[:, 0], axis=0) if setup.origin is None else np.asarray(setup.origin, dtype=np.float64)
    away = places - middle
    yield Finding(Kind.Y_AXIS, values={"turn": np.pi}), middle + away * np.array([1.0, -1.0]), 1.0
    for down, sign in ((False, 1.0), (True, -1.0)):  # a mirror image moves alike
        values = {"down": down, "turn": 0.5 * sign * np.pi}
        yield Finding(Kind.AXES_SWAPPED, values=values), middle + away[:, :, ::-1] * np.array([1.0, sign]), 1.0
    if setup.arc_lengths is not None and places.shape[1] > 1:
        apart = np.nanquantile(np.hypot(*np.diff(places, axis=1).T).T, SHORT_FIT.straight, axis=0)
        factor = float(np.median(apart / np.diff(np.asarray(setup.arc_lengths, dtype=np.float64))))
        if abs(factor - 1.0) > SHORT_FIT.least_scale:
            yield Finding(Kind.MARKER_SCALE, values={"factor": factor}), places / factor, 1.0 / factor


@dataclass(frozen=True)
class ShortFit:
    """A cheap fit of the first windows of a recording."""

    rope: Rope
    free: Sequence[str]
    setup: RecordingSetup
    loss: Loss
    budget: Budget

    def __call__(self, recording: Recording, more: Sequence[str] = ()) -> tuple[float, list[float]]:
        """Return the residual, rms, as a part of the motion (inf: nothing fits), and values of `more`, also free."""
        self.budget.check()
        words = [word for word in self.free if FREE_PROPERTIES[base(word)].owner != "arm"]
        try:
            measured = checked_measurements(recording, self.rope, self.setup)
            setup = self.setup if self.setup.drives else replace(self.setup, torque=None)
            plant = build_plant(recording, self.rope, words, setup)
            added = [word for word in more if word not in words]
            plant, x, _ = extended(plant, plant.parameters.start, added)
            part, x = self._left(plant, measured, x)
        except (InvalidInput, IdentificationError):
            return np.inf, [np.nan] * len(more)
        return part, [plant.parameters.single(name, x) for name in more]

    def _left(self, plant: Plant, measured: Measurements, x: Array) -> tuple[float, Array]:
        usual, fitted = usual_length(measured.shape, self.rope), None
        if "delay" in plant.parameters.names:
            plant = with_delay(plant, search_delay(plant, measured, usual, self.loss, self.budget))
            x = plant.parameters.start
        for length in (usual / SHORT_FIT.shorter, usual):
            windows, _ = measured.windows(length)
            windows = windows[: SHORT_FIT.windows]
            if sum(each.values - each.unknowns for each in windows) <= x.size:
                continue
            states = [each.guess for each in windows]
            found = fit(plant, windows, x, states, loss=self.loss, rounds=SHORT_FIT.rounds, enough=HARDLY)
            x, fitted = found.x, (windows, found.residuals, found.loss)
        if fitted is None or lumped(plant.parameters.rope(x))[0][0] <= 0.0:
            return np.inf, x
        return part_left(*fitted), x


def spring_or_angles(recording: Recording, left: ShortFit) -> list[Finding]:
    """Return that angles read too large or too small explain as much as a stiffness that was freed.

    A pendulum whose angles are read 10 % too large seems to swing faster with its amplitude than gravity makes it. So
    does one with a spring. Nothing is reported where the guess has a stiffness, or where one explains clearly more.
    """
    words = [word for word in left.free if base(word) != "stiffness"]
    if recording.kind != "angles" or len(words) == len(left.free) or left.rope.stiffness.any():
        return []
    part, (read,) = replace(left, free=words)(recording, (ANGLES,))
    believed = SHORT_FIT.least_gain <= abs(np.log(read)) <= SHORT_FIT.farthest
    if not believed or part > SHORT_FIT.spring * left(recording)[0]:
        return []
    return [Finding(Kind.SPRING_OR_ANGLES, Severity.WRONG, {"factor": 1.0 / read})]


def mistakes(recording: Recording, left: ShortFit, named: ScoreTest | None) -> list[Finding]:
    """Return the mistake that explains a fit that is not good, or nothing.

    A mistake is named if it leaves half of what the recording as declared leaves at most, and that is little. It has to
    leave half of what a wrong clock or scale and a camera that is not level leave, and of what a fit with the quantity
    of the score test `named` freed leaves, too; one that explains as much as the former is named with them.
    """
    declared, _ = left(recording)
    skewed, (scale, angle) = left(recording, SKEWED)
    name = "" if named is None else named.name
    most = min(declared, left(recording, (name,))[0]) if name not in ("", *SKEWED) else declared
    if named is not None and name == "delay":  # what a short fit leaves depends on its search for the delay
        most = min(most, declared * float(np.sqrt(1.0 - named.gain)))
    tried = [*_meant(recording, left), *_driven(recording, left)]
    least, found = min(tried, key=lambda each: each[0], default=(np.inf, []))
    # Gravity does not only have to turn by a quarter or half, but turns so where its direction is free: no camera does
    turned = least <= SHORT_FIT.better * most and any(
        np.cos(angle + each.values["turn"]) > np.sqrt(0.5) for each in found if "turn" in each.values
    )
    if least > SHORT_FIT.better * skewed and not turned:
        as_well = found if least <= SHORT_FIT.as_good * skewed else []
        found = [] if name in SKEWED else [*as_well, *_skew(float(np.sqrt(scale)), float(angle))]
        least = min(least, skewed)
    if not turned and least > min(SHORT_FIT.better * most, SHORT_FIT.fits):
        return []
    gain = 1.0 - min(1.0, least / min(declared, 1.0)) ** 2
    shown = {"left": least, "before": min(declared, 1.0)}
    return [replace(each, severity=Severity.WRONG, gain=gain, values=each.values | shown) for each in found]


def _meant(recording: Recording, left: ShortFit) -> Iterator[Tried]:
    """Yield what a short fit leaves with each mistake mended.

    Not where a free direction of gravity then turns by more than 45 degrees: it makes all zeros of the angles explain
    as much, each with another direction.
    """
    free = [word for word in left.free if word == "gravity_angle"]
    for finding, data, factor in _variants(recording, left.setup):
        noise = None if recording.noise is None else recording.noise * factor
        meant = replace(recording, data=data.reshape(recording.data.shape), noise=noise, rates=None)
        part, angles = left(meant, free)
        yield part if all(np.cos(angle) > np.sqrt(0.5) for angle in angles) else np.inf, [finding]


def _driven(recording: Recording, left: ShortFit) -> Iterator[Tried]:
    """Yield what a short fit leaves with another length of the arm, and with stamps that come late."""
    if left.setup.arm is None:
        return
    part, (factor,) = left(recording, (ARM_LENGTH,))
    if part < np.inf and abs(np.log(factor)) <= SHORT_FIT.farthest:
        yield part, [Finding(Kind.ARM_LENGTH, values={"length": factor * left.setup.arm.length})]
    if "delay" not in left.free:
        part, (delay,) = left(recording, ("delay",))
        yield part, [Finding(Kind.DELAY, values={"delay": delay})]


def _skew(clock: float, angle: float) -> list[Finding]:
    """Return a clock that is off by a factor, and a gravity that is rotated by an angle, rad."""
    turned = [Finding(Kind.ZERO, values={"angle": angle})] if abs(angle) > SHORT_FIT.least_angle else []
    values = {"clock": clock, "scale": clock**2, "moved": abs(clock**2 - 1.0)}
    return turned + [Finding(Kind.CLOCK, values=values)] * (abs(clock - 1.0) > SHORT_FIT.least_clock)
