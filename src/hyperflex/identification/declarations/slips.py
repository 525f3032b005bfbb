"""Usual mistakes in what was declared of a recording: what may have been meant, tried by short fits.

To add one, write a function that yields recordings as they would be then, and list it in MISTAKES.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.findings import Kind
from hyperflex.identification.options import RecordingSetup
from hyperflex.recording import Recording


@dataclass(frozen=True)
class SlipLimits:
    """Which mistakes are tried."""

    # links or markers up to which each is tried by itself: the cost of as many short fits
    swaps: int = 4
    # rad: degrees read as radians reach farther, but for a tiny swing
    large: float = 2.0
    # rad: six turns read as degrees, the farthest that a free double pendulum was seen to wind up
    turns: float = 0.7
    # quantile of distances that is a straight rope's; part by which scales may be off
    straight: float = 0.95
    least_scale: float = 0.02


TRIED = SlipLimits()

Variant = tuple[dict[str, Any], Recording]


@dataclass(frozen=True)
class Mistake:
    """A usual mistake: the kind of its finding, whether it is of angles or markers, and what may have been meant.

    `variants` yields the values of the finding with the recording as it would be then.
    """

    kind: Kind
    of: str  # "angles" or "markers"
    variants: Callable[[Recording, RecordingSetup], Iterator[Variant]]


def angles_as(recording: Recording, data: Array, factor: float = 1.0) -> Recording:
    """Return a recording with other angles (T, n), its noise multiplied by a factor."""
    noise = None if recording.noise is None else recording.noise * factor
    return replace(recording, data=data, noise=noise, rates=None)


def _relative(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    if recording.data.shape[1] > 1:
        yield {}, angles_as(recording, np.cumsum(recording.data, axis=1))


def _absolute(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    if recording.data.shape[1] > 1:
        yield {}, angles_as(recording, np.diff(recording.data, axis=1, prepend=0.0))


def _reversed(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    if recording.data.shape[1] > 1:
        yield {"what": "the links"}, angles_as(recording, recording.data[:, ::-1])


def _swapped(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    n = recording.data.shape[1]
    for k in range(n - 1) if 2 < n <= TRIED.swaps else ():
        values = {"what": "links", "first": k, "second": k + 1}
        yield values, angles_as(recording, recording.data[:, neighbours_swapped(n, k)])


def _sense(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    n = recording.data.shape[1]
    for k in range(n) if 1 < n < TRIED.swaps else ():
        yield {"link": k}, angles_as(recording, recording.data * np.where(np.arange(n) == k, -1.0, 1.0))


def _zero(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    for where, angle in (("pointing up", np.pi), ("level, along +x", 0.5 * np.pi), ("level, along -x", -0.5 * np.pi)):
        yield {"where": where}, angles_as(recording, recording.data + angle)


def _degrees(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    if np.nanmax(np.abs(recording.data)) > TRIED.large:
        yield {}, angles_as(recording, np.radians(recording.data), np.pi / 180.0)


def _radians(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    if np.nanmax(np.abs(recording.data)) < TRIED.turns:
        yield {}, angles_as(recording, np.degrees(recording.data), 180.0 / np.pi)


def _places(recording: Recording) -> Array:
    return np.asarray(recording.data.reshape(recording.t.size, -1, 2))


def _mirrored(recording: Recording, setup: RecordingSetup, turn: Callable[[Array], Array]) -> Recording:
    """Return markers with their places about the first joint, or the first marker, changed."""
    places = _places(recording)
    middle = np.nanmedian(places[:, 0], axis=0) if setup.origin is None else np.asarray(setup.origin, dtype=np.float64)
    return replace(recording, data=(middle + turn(places - middle)).reshape(recording.data.shape))


def _y_axis(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    yield {}, _mirrored(recording, setup, lambda away: away * np.array([1.0, -1.0]))


def _axes(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    yield {}, _mirrored(recording, setup, lambda away: away[:, :, ::-1])


def _markers_reversed(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    places = _places(recording)
    if places.shape[1] > 1:
        yield {"what": "the markers"}, replace(recording, data=places[:, ::-1].reshape(recording.data.shape))


def _markers_swapped(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    places = _places(recording)
    n = places.shape[1]
    for k in range(n - 1) if 2 < n <= TRIED.swaps + 1 else ():
        data = places[:, neighbours_swapped(n, k)].reshape(recording.data.shape)
        yield {"what": "markers", "first": k, "second": k + 1}, replace(recording, data=data)


def _rescaled(recording: Recording, setup: RecordingSetup) -> Iterator[Variant]:
    """Yield markers whose greatest distances are those along the rope, if they differ as declared."""
    if setup.arc_lengths is None or recording.data.shape[1] < 4:
        return
    apart = np.nanquantile(np.hypot(*np.diff(_places(recording), axis=1).T).T, TRIED.straight, axis=0)
    factor = float(np.median(apart / np.diff(np.asarray(setup.arc_lengths, dtype=np.float64))))
    if abs(factor - 1.0) > TRIED.least_scale:
        noise = None if recording.noise is None else recording.noise / factor
        yield {"factor": factor}, replace(recording, data=recording.data / factor, noise=noise)


def neighbours_swapped(n: int, k: int) -> list[int]:
    """Return 0 to n - 1 with k and k + 1 swapped."""
    return [*range(k), k + 1, k, *range(k + 2, n)]


MISTAKES = (
    Mistake(Kind.RELATIVE, "angles", _relative),
    Mistake(Kind.ABSOLUTE, "angles", _absolute),
    Mistake(Kind.REVERSED, "angles", _reversed),
    Mistake(Kind.SWAPPED, "angles", _swapped),
    Mistake(Kind.SENSE, "angles", _sense),
    Mistake(Kind.ZERO_DIRECTION, "angles", _zero),
    Mistake(Kind.DEGREES, "angles", _degrees),
    Mistake(Kind.RADIANS, "angles", _radians),
    Mistake(Kind.Y_AXIS, "markers", _y_axis),
    Mistake(Kind.AXES_SWAPPED, "markers", _axes),
    Mistake(Kind.REVERSED, "markers", _markers_reversed),
    Mistake(Kind.SWAPPED, "markers", _markers_swapped),
    Mistake(Kind.MARKER_SCALE, "markers", _rescaled),
)
