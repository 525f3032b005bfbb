"""Measurements to fit: angles, places of markers, and motor torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit.stages import Measurements
from hyperflex.identification.fit.windows import STILL
from hyperflex.model import Rope
from hyperflex.recording import Recording, unwrap

BEND = 0.5  # rad, standard deviation of the turn from the middle of a link to that of the next, over sqrt(n links)
STUCK = 0.02  # of the swing of the marker that swings most, per distance from the first joint
SWAY = 5.0  # rad/s, the same of its rate
UNTOLD = 2e-3  # of the rope's length: noise of a marker where none is given and it must be weighed against these


def checked_arc_lengths(recording: Recording, rope: Rope, arc_lengths: npt.ArrayLike) -> Array:
    """Return where the markers sit, m from the first joint, if they can sit there."""
    count = recording.data.shape[1] // 2
    if recording.kind != "markers":
        raise InvalidInput(
            "arc_lengths are given, but the recording holds angles", got=recording.kind, allowed="markers"
        )
    places = checks.array("arc_lengths", arc_lengths, (count,), unit="m")
    if count == 1 and places[0] <= 0.0:
        raise InvalidInput("the marker sits on the first joint", got=places.tolist(), allowed="more than 0 m from it")
    length = rope.total_length
    if (np.diff(places) <= 0.0).any() or places[0] < 0.0 or places[-1] > 1.001 * length:
        raise InvalidInput(
            "arc_lengths are not where markers can be",
            got=places.tolist(),
            allowed=f"increasing distances from the first joint, 0 to {length:g} m",
        )
    return places


def refuse_still_markers(recording: Recording, arc_lengths: Array) -> None:
    """Refuse markers that stay where they are while the rope swings: the tracker holds something else there."""
    if recording.kind != "markers":
        return
    places = recording.data.reshape(recording.t.size, -1, 2)
    reach = np.hypot(*(np.nanmax(places, axis=0) - np.nanmin(places, axis=0)).T)
    beyond = arc_lengths > 1e-9 * arc_lengths.max()
    swing = reach[beyond] / arc_lengths[beyond]
    if swing.max() > STILL and (swing < STUCK * swing.max()).any():
        marker = int(np.flatnonzero(beyond)[np.argmin(swing)])
        raise InvalidInput(
            f"marker {marker} never moves while others do",
            got=f"{reach[marker]:.3g} m over the recording, marker {int(np.argmax(reach))} {reach.max():.3g} m",
            fix="See what the tracker holds there, and leave that marker out (and give arc_lengths=... of the others)",
        )


def measure(recording: Recording, rope: Rope, arc_lengths: Array | None, joint: Array | None = None) -> Measurements:
    """Return what is fitted.

    Parameters
    ----------
    recording : Recording
        Angles, markers at the joints (`arc_lengths` None; their angles are fitted), or markers at `arc_lengths`.
    rope : Rope
        The guess; its lengths say which link a marker sits on.
    arc_lengths : (K,) array, optional
        See :func:`checked_arc_lengths`.
    joint : (T, 2) array, m, optional
        Where the first joint is seen, if it is known; a marker alone needs it for the line from there.

    Notes
    -----
    Fewer markers than links leave bends between them unseen. Then a prior keeps neighbouring links about in
    line: a turn of BEND / sqrt(n), growing at SWAY / sqrt(n), as standard deviations. It is an assumption, weak beside
    any marker that sees the bend. To be weighed against it, markers without given noise count as if theirs were 0.2 %
    of the rope's length.
    """
    if arc_lengths is None:
        angles = recording.angles()
        return Measurements(angles, angles)
    if arc_lengths.size == 1 and joint is not None:
        along = replace(recording, data=np.column_stack([joint, recording.data]), noise=None)
        shape = _shape(along, rope, np.append(0.0, arc_lengths))
    else:
        shape = _shape(recording, rope, arc_lengths)
    n = rope.n_links
    prior = None
    if arc_lengths.size - 1 < n and n > 1:
        turn = (np.eye(n, k=1) - np.eye(n))[:-1] * np.sqrt(n)
        none = np.zeros_like(turn)
        prior = np.block([[turn / BEND, none], [none, turn / SWAY]])
        if recording.noise is None:
            recording = replace(recording, noise=np.array(UNTOLD * rope.total_length))
    return Measurements(recording, shape, prior)


def with_torque(measured: Measurements, torque: npt.ArrayLike, noise: npt.ArrayLike | None) -> Measurements:
    """Return what is fitted with the motor's torque (T,), N m, NaN in gaps, as the last channel.

    `noise` (T,), or one number, is its standard deviation. Torque and angles are different things, so how they count
    can only follow from the noise of both.
    """
    channels = measured.channels
    values = checks.array("torque", torque, (channels.t.size,), unit="N m", gaps=True)
    if np.isnan(values).all():
        raise InvalidInput("torque has no value at all, only gaps", allowed="at least one value, in N m")
    if noise is None or channels.noise is None:
        missing = "torque_noise" if noise is None else "the noise of the recording"
        raise InvalidInput(
            f"a torque is measured, but {missing} is not given",
            fix="Give both: Recording(..., noise=...) and torque_noise=...; only then is it known how they count",
        )
    spread = checks.array("torque_noise", noise, (values.size,), sign="positive", unit="N m", scalar=True)
    joined = Recording(  # of any channels: those who fit them ask for no kind
        channels.t,
        np.column_stack([channels.data, values]),
        noise=np.column_stack([channels.noise, spread]),
    )
    return replace(measured, channels=joined)


def _shape(recording: Recording, rope: Rope, arc_lengths: Array) -> Recording:
    """Return each link's angle (T, n): that of the line between the markers on either side of its middle."""
    places = recording.data.reshape(recording.t.size, -1, 2)
    middle = np.cumsum(rope.length) - 0.5 * rope.length
    angles = np.full((recording.t.size, rope.n_links), np.nan)
    for row, frame in enumerate(places):
        known = np.flatnonzero(~np.isnan(frame).any(axis=1))
        if known.size > 1:
            step = np.diff(frame[known], axis=0)
            after = np.clip(np.searchsorted(arc_lengths[known], middle) - 1, 0, known.size - 2)
            angles[row] = np.arctan2(step[after, 0], -step[after, 1])
    angles = unwrap(angles)
    first = np.array([column[np.flatnonzero(~np.isnan(column))[0]] for column in angles.T])
    angles += np.unwrap(first) - first  # whole turns: neighbours begin within half a turn of each other
    return replace(recording, data=angles, kind="angles", noise=None, rates=None, convention="")


def first_joint(recording: Recording, arc_lengths: Array, pivot: Array) -> Array:
    """Return where the camera seems to see the origin (2,), m: the first two markers' line, back to the first joint.

    `pivot` (T, 2) is where the first joint is, m, in the frame of its motion.
    """
    places = recording.data.reshape(recording.t.size, -1, 2)
    back = places[:, 0] - (places[:, 1] - places[:, 0]) * arc_lengths[0] / (arc_lengths[1] - arc_lengths[0])
    result: Array = np.nanmedian(back - pivot, axis=0)
    return result
