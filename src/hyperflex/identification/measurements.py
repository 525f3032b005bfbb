"""Measurements to fit, checked against the rope and for motion, and the model that predicts them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.declarations.faults import unlike_lengths
from hyperflex.identification.findings import text
from hyperflex.identification.fit import Window
from hyperflex.identification.model import CONSTANT, PRECISION, Motors, Parameters, Plant, parse, pivot_places
from hyperflex.identification.options import FitOptions, RecordingSetup
from hyperflex.identification.uncertainty.noise import CHANCE, LAGS
from hyperflex.model import Rope
from hyperflex.recording import Recording, unwrap
from hyperflex.sensors import Angles, Markers

BEND = 0.5  # rad, standard deviation of the turn from the middle of a link to that of the next, over sqrt(n links)
SWAY = 5.0  # rad/s, the same of its rate
BENDS = 256  # numbers of bends of a link that are compared
STILL = 0.001  # rad, a recording that moves less holds no dynamics
STUCK = 0.02  # of the swing of the marker that swings most, per distance from the first joint
UNTOLD = 2e-3  # of the rope's length: noise of a marker where none is given and it must be weighed against these
TRAIN = 0.8  # part of a recording that is fitted when nothing is said
# samples a window; of more, neighbours become one, between which a swing is a parabola to a millionth of itself
DENSEST = 200
# samples a window, where the recording allows it
FEWEST_SAMPLES = 8
# values of each link's angle in a window, ten for each unknown of its state, where the recording allows it
FEWEST_SEEN = 20
# values of a link's angle in a window that is used
LEAST_VALUES = 4
# part of a window that it lasts at least, and for which a link may be out of sight at most
HALF = 0.5
# periods of a swing that a window lasts; the period, s, where nothing pulls
PERIODS, WEIGHTLESS = 1.2, 1.0
# rad a link may turn within a window, as rms rate times time: beyond it fits find false minima
MOST_TURN = 8.0
# rad by which a shape must differ from another to be a start of its own
ASIDE = 0.3
# of weighted least squares that come near to least absolute errors
ABSOLUTE_ROUNDS = 8
SHORTEST = 0.1  # of the rope's period, which a recording lasts at least
WILDEST = 8.0  # times the rate of a small swing: ten somersaults in the time of one
BEYOND = 5.0  # standard deviations of the declared noise: a spread that large is motion, smooth or not
LARGE = 0.1  # rad, the same of link angles: no camera errs so much


Merging = Literal["mean", "median", "first"]


@dataclass(frozen=True)
class Measurements:
    """What is fitted: channels, the angles that they show, and the prior (r, 2n) of a state (see Window).

    sides: other angles that would show as the same channels. merging: how neighbouring samples become one. precision:
    of the values (T, C), over that of the best, where their noise is not known: a marker that errs turns a short link
    farther, and samples may miss in values that several have become. spread (T,): of the times of these, see Window.
    """

    channels: Recording
    shape: Recording
    prior: Array
    sides: tuple[Recording, ...] = ()
    merging: Merging = "mean"
    precision: Array | float = 1.0
    spread: Array | None = None

    def step(self, length: float) -> int:
        """Return how many samples become one, so that a window of `length` (s) holds at most ``DENSEST``."""
        count = length / float(np.median(np.diff(self.channels.t)))
        return max(1, math.ceil(count / DENSEST - 1e-6))

    def merged(self, step: int) -> "Measurements":
        """Return the same with each `step` neighbouring samples as one value; see :func:`merged`."""
        if step == 1 or self.channels.t.size < 3 * step:  # too short for differences between groups
            return self
        every = (self.channels, self.shape, *self.sides)
        (channels, share, spread), *angles = (merged(each, step, self.merging) for each in every)
        shape, *sides = (each for each, *_ in angles)
        precision = self.precision * (share if channels.noise is None else 1.0)
        return replace(self, channels=channels, shape=shape, sides=tuple(sides), precision=precision, spread=spread)

    def windows(self, length: float, step: int | None = None) -> tuple[list[Window], int]:
        """Cut the samples into windows [start, start + `length`), s; return them and the number left out.

        Each `step` samples become one, by default so many that a window holds DENSEST at most. Windows are left out
        where some link has too few values, or too long a gap, to tell its angle and rate.
        """
        whole = self.merged(step or self.step(length))
        channels, angles, sides = whole.channels, whole.shape.data, [each.data for each in whole.sides]
        t, y = channels.t, np.nan_to_num(channels.data)
        weight = np.where(np.isnan(channels.data), 0.0, 1.0 if channels.noise is None else 1.0 / channels.noise)
        weight = weight * np.sqrt(whole.precision)
        number = np.floor((t - t[0]) / length + 1e-6 * np.median(np.diff(t)) / length)
        windows, cuts = [], [number == k for k in np.unique(number)]
        for rows in cuts:
            own, known = t[rows], ~np.isnan(angles[rows])
            span = own[-1] - own[0]
            gaps = (np.diff(np.concatenate([own[:1], own[column], own[-1:]])).max() for column in known.T)
            if known.sum(axis=0).min() < LEAST_VALUES or span < HALF * length or max(gaps) > HALF * span:
                continue
            guess, *others = (first_state(own, each[rows]) for each in (angles, *sides))
            others = [each for each in others if np.abs(each - guess)[: angles.shape[1]].max() > ASIDE]
            spread = None if whole.spread is None else whole.spread[rows]
            windows.append(Window(own, y[rows], weight[rows], guess, self.prior, tuple(others), spread))
        return windows, len(cuts) - len(windows)

    def between(self, start: float, end: float) -> "Measurements":
        """Return the samples with ``start <= t < end``, s."""
        channels, shape, *sides = (each.window(start, end) for each in (self.channels, self.shape, *self.sides))
        return replace(self, channels=channels, shape=shape, sides=tuple(sides))


def merged(recording: Recording, step: int, merging: Merging = "mean") -> tuple[Recording, Array, Array | None]:
    """Return a recording with each `step` neighbouring samples as one, and the part of them (m, C) that is there.

    Its times (m,) are the means of theirs. Its values are the means, weighted by the noise, or the medians, of the
    samples less what moves within the group about its mean: a line and a parabola, by differences between groups. So a
    sample that is missing shifts no value. A mean is off the motion at its time by the second derivative times half the
    mean square of the samples' times about it, the third that is returned (m,), s^2. Values are not corrected by that:
    differences of noisy values would make their noise coloured. What may jump, as a torque does where a motion
    switches, is not merged: the ``first`` sample stands for all, and the third is None.
    """
    if merging == "first":
        return recording.decimate(step), np.ones((-(-recording.t.size // step), recording.data.shape[1])), None
    t, data = recording.t, recording.data
    group = np.floor((t - t[0]) / float(np.median(np.diff(t))) + 0.5) // step  # no longer than that where frames miss
    first = np.flatnonzero(np.diff(group, prepend=-1.0))
    which = np.repeat(np.arange(first.size), np.diff(np.append(first, t.size)))
    place = np.arange(t.size) - first[which]

    def grouped(values: Array) -> Array:
        """Return values (T, ...) by group (m, samples, ...), NaN beyond its end."""
        table = np.full((first.size, place.max() + 1, *values.shape[1:]), np.nan)
        table[which, place] = values
        return table

    times, samples = grouped(t), grouped(data)
    time = np.nanmean(times, axis=1)
    off = (times - time[:, None])[:, :, None]
    spread = 0.5 * np.nanmean(off**2, axis=1)
    weight = np.where(np.isnan(samples), 0.0, 1.0 if recording.noise is None else grouped(recording.noise) ** -2.0)
    total = weight.sum(axis=1)
    inside: Array | float = 0.0
    for _ in range(4):  # each lessens what missing samples shift tenfold
        if merging == "median":
            left = np.ma.masked_invalid(samples - inside)
            values = np.ma.median(left, axis=1).filled(np.nan)  # type: ignore[no-untyped-call]
        else:
            values = np.nansum(weight * (samples - inside), axis=1) / np.where(total > 0.0, total, np.nan)
        smooth = np.column_stack([np.interp(time, time[~np.isnan(x)], x[~np.isnan(x)]) for x in values.T])
        slope = np.gradient(smooth, time, axis=0)
        bend = np.gradient(slope, time, axis=0)
        inside = off * slope[:, None] + (0.5 * off**2 - spread[:, None]) * bend[:, None]
    noise = None if recording.noise is None else np.where(total > 0.0, total, 1.0) ** -0.5
    whole = replace(recording, t=time, data=values, noise=noise, rates=None)
    return whole, np.minimum(np.count_nonzero(weight, axis=1) / step, 1.0), spread[:, 0]


def swing_period(rope: Rope) -> float:
    """Return the period, s, of a small swing of a straight rod as long as the rope; inf without gravity."""
    gravity = float(np.hypot(*rope.gravity))
    return 2.0 * np.pi * float(np.sqrt(2.0 * rope.total_length / (3.0 * gravity))) if gravity > 0.0 else np.inf


def usual_length(recording: Recording, rope: Rope, fewest: int = FEWEST_SEEN) -> float:
    """Return a window length (s): some periods of a small swing of a rod as long as the rope, less for fast links.

    It is doubled until it holds ``FEWEST_SEEN`` values of each link.
    """
    period = swing_period(rope) if rope.gravity.any() else WEIGHTLESS
    fastest = max(rms_rate(recording.t, column) for column in recording.data.T)
    spacing = float(np.median(np.diff(recording.t)))
    length = max(min(PERIODS * period, MOST_TURN / max(fastest, 1e-300)), FEWEST_SAMPLES * spacing)
    seen = float((~np.isnan(recording.data)).mean(axis=0).min()) * length / spacing
    return float(length * 2.0 ** np.ceil(np.log2(fewest / seen))) if 0.0 < seen < fewest else length


def rms_rate(t: Array, angle: Array) -> float:
    """Return the rms rate (rad/s) over steps of at least a two-hundredth of the recording or 10 ms, noise left out."""
    known = ~np.isnan(angle)
    t, angle = t[known], angle[known]
    if angle.size > 2:  # a single sample that is far off is no motion
        t, angle = t[1:-1], np.median([angle[:-2], angle[1:-1], angle[2:]], axis=0)
    least = min(0.01, (t[-1] - t[0]) / 200.0)
    picked = [0]
    for k in range(1, t.size):
        if t[k] - t[picked[-1]] >= least:
            picked.append(k)
    turned, taken = np.diff(angle[picked]), np.diff(t[picked])
    return float(np.sqrt((turned**2 / taken).sum() / taken.sum())) if taken.size else 0.0


def first_state(t: Array, angles: Array) -> Array:
    """Return a guess of the state (2n,) at t[0]: a cubic through each link's first angles (m, n), NaN in gaps.

    Least absolute errors, by weighted least squares: no outlier tilts it.
    """
    found = []
    for angle in angles.T:
        known = np.flatnonzero(~np.isnan(angle))
        few = known[: max(6, known.size // 5)]
        span, y = max(float(t[few[-1]] - t[0]), 1e-9), angle[few]
        powers, weight = (
            np.vander((t[few] - t[0]) / span, min(4, few.size - 1), increasing=True),
            np.ones((few.size, 1)),
        )
        for _ in range(ABSOLUTE_ROUNDS):
            line = np.linalg.lstsq(powers * weight, y * weight[:, 0], rcond=None)[0]
            away = np.abs(powers @ line - y)[:, None]
            weight = 1.0 / np.sqrt(np.maximum(away, 0.1 * away.mean() + 1e-12))
        found.append((line[0], line[1] / span))
    return np.array(found).T.ravel()


def checked_arc_lengths(recording: Recording, rope: Rope, arc_lengths: ArrayLike) -> Array:
    """Return arc lengths of the markers (K,), m from the first joint, checked."""
    count = recording.data.shape[1] // 2
    if recording.kind != "markers":
        raise InvalidInput(
            "arc_lengths are given, but the recording contains angles", got=recording.kind, allowed="markers"
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
    """Refuse markers that stand still while the rope swings: a tracker's fault, another order, or a rope held there."""
    if recording.kind != "markers":
        return
    places = recording.data.reshape(recording.t.size, -1, 2)
    reach = np.hypot(*(np.nanmax(places, axis=0) - np.nanmin(places, axis=0)).T)
    beyond = arc_lengths > 1e-9 * arc_lengths.max()
    swing = reach[beyond] / arc_lengths[beyond]
    if swing.max() > STILL and (swing < STUCK * swing.max()).any():
        marker, last = int(np.flatnonzero(beyond)[np.argmin(swing)]), len(reach) - 1
        fix = "Check the tracker's data there, and omit that marker (and give arc_lengths=... of the others)"
        if marker == last > 0 and reach[0] > max(STUCK * reach.max(), 2.0 * reach[marker]):  # whose reach is noise
            fix = "The first marker moves: count them from where the rope hangs to its free end"
        elif marker == last > 0:
            fix = "The last marker is to be at a free end. A rope or cable held at both ends cannot be identified"
        raise InvalidInput(
            f"marker {marker} never moves while others do",
            got=f"{reach[marker]:.3g} m over the recording, marker {int(np.argmax(reach))} {reach.max():.3g} m",
            fix=fix,
        )


def measure(recording: Recording, rope: Rope, arc_lengths: Array | None, joint: Array | None = None) -> Measurements:
    """Return the measurements: angles, markers at the joints (their angles), or markers at `arc_lengths` (K,), m.

    A marker alone needs the places of the first joint, `joint` (T, 2), m. With fewer markers than links a prior keeps
    neighbouring links about in line: a turn of BEND / sqrt(n), growing at SWAY / sqrt(n), as standard deviations, weak
    beside any marker that sees the bend. Markers without given noise then count with 0.2 % of the rope's length.
    """
    if arc_lengths is None:
        angles, precision = recording.angles(), 1.0
        if recording.kind == "markers" and recording.noise is None:
            precision = (recording.link_lengths() / recording.link_lengths().max()) ** 2
        return Measurements(angles, angles, np.zeros((0, 2 * rope.n_links)), precision=precision)
    along, places = recording, arc_lengths
    if arc_lengths[0] > 0.0 and joint is not None:
        along = replace(recording, data=np.column_stack([joint, recording.data]), noise=None)
        places = np.append(0.0, arc_lengths)
    shape = _shape(along, rope, places)
    n, prior = rope.n_links, np.zeros((0, 2 * rope.n_links))
    sides: tuple[Recording, ...] = ()
    if places.size - 1 < n and n > 1:
        turn = (np.eye(n, k=1) - np.eye(n))[:-1] * np.sqrt(n)
        none = np.zeros_like(turn)
        prior = np.block([[turn / BEND, none], [none, turn / SWAY]])
        if recording.noise is None:
            recording = replace(recording, noise=np.array(UNTOLD * rope.total_length))
        sides = tuple(_shape(along, rope, places, side) for side in (1.0, -1.0))
    return Measurements(recording, shape, prior, sides)


def torque_readings(setup: RecordingSetup, t: Array) -> Array:
    """Return the readings (T, k) of the motors at times t (T,), NaN in gaps, checked."""
    columns = len(setup.joints)
    shape = (t.size, columns) if np.asarray(setup.torque, dtype=object).ndim > 1 else (t.size,)
    readings = checks.array("torque", setup.torque, shape, gaps=True).reshape(t.size, columns)
    if np.isnan(readings).all(axis=0).any():
        raise InvalidInput("torque has no value at all, only gaps", allowed="at least one value of each motor")
    return readings


def with_torque(measured: Measurements, setup: RecordingSetup) -> Measurements:
    """Return the measurements with the motor's torque, N m, as the last channel.

    The weights of torque and angles follow from the noise of both, so that of the torque is needed.
    """
    channels, noise = measured.channels, setup.torque_noise
    values = torque_readings(setup, channels.t)
    if noise is None or channels.noise is None:
        missing = "torque_noise" if noise is None else "the noise of the recording"
        raise InvalidInput(
            f"a torque is measured, but {missing} is not given",
            fix="Give both: Recording(..., noise=...) and torque_noise=...; only then is it known how they count",
        )
    spread = checks.array("torque_noise", noise, (len(values),), sign="positive", unit="N m", scalar=True)
    joined = Recording(  # of any channels: those who fit them ask for no kind
        channels.t,
        np.column_stack([channels.data, values]),
        noise=np.column_stack([channels.noise, spread]),
    )
    return replace(measured, channels=joined, merging="first")


def _shape(recording: Recording, rope: Rope, arc_lengths: Array, side: float = 0.0) -> Recording:
    """Return each link's angle (T, n): that of the line between the markers on either side of its middle.

    With `side` 1.0 or -1.0 links between two markers are bent evenly to that side, as far as their distance asks.
    """
    places = recording.data.reshape(recording.t.size, -1, 2)
    middle = rope.link_middles
    angles = np.full((recording.t.size, rope.n_links), np.nan)
    patterns, which = np.unique(~np.isnan(places).any(axis=2), axis=0, return_inverse=True)
    for number, seen in enumerate(patterns):  # frames in which the same markers are seen, together
        known, rows = np.flatnonzero(seen), np.flatnonzero(which.ravel() == number)
        if known.size < 2:
            continue
        step, arcs = np.diff(places[np.ix_(rows, known)], axis=1), arc_lengths[known]
        after = np.clip(np.searchsorted(arcs, middle) - 1, 0, known.size - 2)
        angles[rows] = np.arctan2(step[:, after, 0], -step[:, after, 1])
        for k in np.unique(after) if side else ():
            distance, turns = _bends(rope, float(arcs[k]), float(arcs[k + 1]))
            least = np.minimum(np.searchsorted(-distance, -np.hypot(*step[:, k].T)), BENDS - 1)
            angles[rows] += side * np.where(after == k, turns[least], 0.0)
    angles = unwrap(angles)
    first = np.array([column[np.flatnonzero(~np.isnan(column))[0]] for column in angles.T])
    if not side:
        angles += np.unwrap(first) - first  # whole turns: neighbours begin within half a turn of each other
    return replace(recording, data=angles, kind="angles", noise=None, rates=None, convention="", columns=())


def _bends(rope: Rope, begin: float, end: float) -> tuple[Array, Array]:
    """Return distances (BENDS,), m, of two places (m along the rope) if it is bent evenly between them, more and more.

    And the links' angles (BENDS, n) from the line between them.
    """
    ends = rope.link_ends
    share = np.clip(np.minimum(ends, end) - np.maximum(ends - rope.length, begin), 0.0, None)
    along_rope = (rope.link_middles - 0.5 * (begin + end)) / (end - begin)
    bend = np.linspace(0.0, 2.0 * np.pi, BENDS)[:, None] * along_rope
    across, along = (share * np.sin(bend)).sum(axis=1), (share * np.cos(bend)).sum(axis=1)
    return np.hypot(across, along), bend - np.arctan2(across, along)[:, None]


def checked_measurements(recording: Recording, rope: Rope, setup: RecordingSetup) -> Measurements:
    """Return the measurements, if they fit the rope."""
    checks.instance("recording", recording, Recording)
    checks.instance("rope_guess", rope, Rope)
    arc_lengths, origin = setup.arc_lengths, setup.origin
    if arc_lengths is not None:
        places = checked_arc_lengths(recording, rope, arc_lengths)
        refuse_still_markers(recording, places)
        joint = None
        if places.size == 1 and origin is None:
            raise InvalidInput(
                "one marker alone does not show where the rope hangs from",
                fix="Say where the camera sees that: origin=(x, y), in m; or track a second marker",
            )
        if origin is not None:
            joint = checks.array("origin", origin, (2,), unit="m") + pivot_places(setup.motion, setup.arm, recording.t)
        return measure(recording, rope, places, joint)
    if recording.n_links != rope.n_links:
        raise InvalidInput(
            "the recording and the rope have different numbers of links",
            got=[recording.n_links, rope.n_links],
            fix="Give a guess with as many links as the recording has angles (markers less one), or arc_lengths=[...]",
        )
    if recording.kind == "markers":
        factor = recording.link_lengths() / rope.length
        if (factor > 2.0).any() or (factor < 0.5).any():
            raise InvalidInput(
                "the distances of the markers do not fit the rope's link lengths",
                got=[recording.link_lengths().tolist(), rope.length.tolist()],
                allowed="within a factor of two, in m",
                fix="Check the unit or scale of the markers, or the lengths of the guess",
            )
    refuse_still_markers(recording, np.append(0.0, rope.link_ends))
    return measure(recording, rope, None)


def build_plant(
    recording: Recording,
    guess: Rope,
    free: Sequence[str],
    setup: RecordingSetup,
    torque_std: float = np.inf,
) -> Plant:
    """Return the model that predicts the measurements, with its free parameters.

    `torque_std` is the relative standard deviation of what is known of a motor's constant.
    """
    motion, arm, origin, torque = setup.motion, setup.arm, setup.origin, setup.torque is not None and not setup.drives
    arc_lengths = None if setup.arc_lengths is None else np.asarray(setup.arc_lengths, dtype=np.float64)
    motors, constants = None, None
    if setup.torque is not None:
        constants = checks.array(CONSTANT, setup.torque_constant, (len(setup.joints),), sign="positive", scalar=True)
        if setup.drives:
            motors = motors_of(recording.t, guess, setup, constants)
    of_arm, moved = arm if torque else None, motion is not None or motors is not None
    chosen = parse(guess, free, arc_lengths, moved=moved, arm=of_arm, constants=constants)
    chosen = [replace(each, prior=torque_std) if each.name == CONSTANT else each for each in chosen]
    if torque_std == 0.0 and any(each.name == CONSTANT for each in chosen):
        raise InvalidInput(f"{CONSTANT} is free, but torque_std is 0", fix="Say how well it is known: torque_std=0.1")
    how: dict[str, Any] = {"motion": motion, "arm": arm, "torque": torque, "motors": motors}
    how |= {"constant": 1.0 if constants is None else float(constants[0]), "angles": recording.kind == "angles"}
    if arc_lengths is None:
        if origin is not None:
            raise InvalidInput(
                "origin is given, but angles are fitted", fix="Give arc_lengths=... as well, or leave it out"
            )
        return Plant(Parameters(guess, chosen), Angles(), **how)
    if origin is None:
        words = [word for word in ("origin_x", "origin_y") if word not in free]
        chosen += parse(guess, words, arc_lengths) if words else []
        first, second = recording.data[:, :2], recording.data[:, 2:4]  # their line, back to the first joint
        back = first - (second - first) * arc_lengths[0] / (arc_lengths[1] - arc_lengths[0])
        place = np.nanmedian(back - pivot_places(motion, arm, recording.t), axis=0)
    else:
        place = checks.array("origin", origin, (2,), unit="m")
    parameters = Parameters(guess, chosen).starting({"origin_x": float(place[0]), "origin_y": float(place[1])})
    if recording.noise is not None:  # of a rollout that is rougher the squares have no clear minimum
        how["precision"] = float(np.clip(1e-4 * np.median(recording.noise) / guess.total_length, 1e-9, PRECISION))
    return Plant(parameters, Markers(arc_lengths, place), **how)


def motors_of(t: Array, guess: Rope, setup: RecordingSetup, constants: Array) -> Motors:
    """Return the motors whose readings at times t (T,), s, drive the rope, checked."""
    readings = torque_readings(setup, t)
    if max(setup.joints) >= guess.n_links:
        allowed = f"0 to {guess.n_links - 1}, or fewer columns"
        raise InvalidInput("torque_joints names a joint that the rope does not have", got=setup.joints, allowed=allowed)
    return Motors.of(t, readings, setup.joints, constants)


def split(
    measured: Measurements, options: FitOptions, arc_lengths: ArrayLike | None
) -> tuple[Measurements, Measurements | None]:
    """Return the part to fit and the part held out; a marker without values in one is named by its arc length."""
    t, time = measured.channels.t, options.train
    if time is None:
        time = float(t[0] + TRAIN * measured.channels.duration)
        time = time if t[-1] - time >= options.lead + options.ahead else np.inf
    if time <= t[0]:
        raise InvalidInput("train leaves nothing to fit", got=time, allowed=f"a time after {t[0]:g} s")
    for rows, part in ((t < time, "fitted"), (t >= time, "held out")):
        empty = np.isnan(measured.channels.data[rows]).all(axis=0)
        if arc_lengths is not None and rows.any() and empty.any():
            what = f"the marker at {np.ravel(arc_lengths)[empty.argmax() // 2]:g} m has no value in the part {part}"
            raise InvalidInput(
                what, fix=f"Omit it, from arc_lengths as well, or let train end elsewhere than at {time:.4g} s"
            )
    if options.loss != "squares" and measured.merging == "mean":
        measured = replace(measured, merging="median")  # of which an outlier is no part
    rest = measured.between(time, np.inf) if (t >= time).sum() > 1 else None
    return (measured if time > t[-1] else measured.between(-np.inf, time)), rest


def check_excitation(channels: Recording, shape: Recording, rope: Rope, *, moved: bool) -> None:
    """Refuse measured `channels`, and the link angles `shape` that they show, that can tell nothing of the rope.

    `moved` tells whether the first joint moves: then links may turn as fast as it makes them.
    """
    check_times(channels, rope)
    check_motion(shape, channels)
    natural = 2.0 * np.pi / swing_period(rope)
    slowest = min(rms_rate(shape.t, column) for column in shape.data.T)
    if not moved and not rope.stiffness.any() and slowest > WILDEST * natural > 0.0:
        raise InvalidInput(
            "all links turn far faster than a swing of this rope",
            got=f"{slowest:.3g} rad/s (rms) at least",
            allowed=f"at most {WILDEST * natural:.3g} rad/s; a small swing has {natural:.3g} rad/s",
            fix=" ".join(text(each) for each in unlike_lengths(rope))
            or "Are the angles in degrees (unit='deg'), the times in another unit, or the lengths? Does an arm move "
            "the rope (motion=...)?",
        )


def check_times(recording: Recording, rope: Rope) -> None:
    """Refuse recordings far shorter, or sampled far sparser, than a small swing of a straight rod of the rope's length.

    Springs make the period shorter: ropes with stiffness may be short.
    """
    period = swing_period(rope)
    if not np.isfinite(period):
        return
    least = 0.0 if rope.stiffness.any() else SHORTEST * period
    spacing = float(np.median(np.diff(recording.t)))
    if recording.duration < least:
        raise InvalidInput(
            "the recording is too short to identify anything",
            got=f"{recording.t.size} samples in {recording.duration:.3g} s",
            allowed=f"at least {least:.2g} s; a rope so long swings once in {period:.2g} s",
            fix="Record longer. Are the times in another unit (time_unit='s'), or the lengths?",
        )
    if spacing > period:
        raise InvalidInput(
            "the samples lie further apart than a swing of the rope lasts",
            got=f"{spacing:.3g} s from sample to sample",
            allowed=f"at most {period:.2g} s; a rope so long swings once in {period:.2g} s",
            fix="Are the times in another unit (time_unit='ms'), or the lengths? Else record more frames a second",
        )


def check_motion(shape: Recording, channels: Recording | None = None) -> None:
    """Refuse link angles `shape` without motion, or not told from noise in the measured `channels` (or the angles).

    Motion beyond the declared noise passes, and smooth motion: it is more autocorrelated than the same values shuffled.
    """
    from scipy.stats import iqr

    swing = np.nanmax(shape.data, axis=0) - np.nanmin(shape.data, axis=0)
    if not (swing > STILL).any():
        raise InvalidInput(
            "nothing moves in the recording",
            got=f"largest swing {swing.max():.3g} rad",
            allowed=f"more than {STILL:g} rad",
            fix="Record a free swing, or check the unit of the angles",
        )
    channels = channels or shape
    for link, column in enumerate(channels.data.T if channels.kind == "angles" else ()):
        values = column[~np.isnan(column)]
        if values.size > LEAST_VALUES and np.ptp(values) == 0.0:  # no link hangs still while others swing
            raise InvalidInput(
                f"link {link} never moves while others do",
                got=f"{values[0]:.6g} rad in all {values.size} samples",
                fix="Check the data of the sensor or tracker there; a link without a sensor is a gap (empty or nan)",
            )
    noise = np.inf if channels.noise is None else np.median(channels.noise, axis=0)
    spread = partial(iqr, axis=0, scale="normal", nan_policy="omit")  # outliers do not matter
    large = (spread(shape.data) > LARGE).any() or (spread(channels.data) > BEYOND * noise).any()
    if not large and _is_noise(channels.data):
        raise InvalidInput(
            "no motion beyond noise in the recording",
            got=f"values that scatter from sample to sample as much as over all {channels.t.size}",
            allowed="a swing that is clearly larger than the noise",
            fix="Record a wider swing, or more samples; if it is sampled slowly, state how large the noise is "
            "(noise=...)",
        )


def _is_noise(values: Array) -> bool:
    """Whether values (T, C), shuffled, may be as autocorrelated, by chance of CHANCE; by ranks, for outliers."""
    from scipy.stats import rankdata

    ranks = rankdata(values, axis=0, nan_policy="omit")
    ranks = np.nan_to_num(ranks - np.nanmean(ranks, axis=0))

    def returning(rows: Array) -> float:
        lags = range(1, min(LAGS, len(rows) - 1) + 1)
        return float(sum(((rows[lag:] * rows[:-lag]).sum(axis=0) ** 2).sum() for lag in lags))

    shuffle, found = np.random.default_rng(0), returning(ranks)
    return any(returning(shuffle.permuted(ranks, axis=0)) >= found for _ in range(round(1.0 / CHANCE)))
