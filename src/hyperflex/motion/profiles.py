"""Ready-made motions: hold, moves with rests in between, the paper's swings, measured samples; and their files."""

import inspect
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE, TORQUE, X, Y
from hyperflex.errors import InvalidInput, located
from hyperflex.motion.piecewise import CHANNELS, MEET, POWERS, Motion, quintics

Profile = Literal["bang-bang", "ramp", "minimum-jerk"]
PROFILES = ("bang-bang", "ramp", "minimum-jerk")
Pieces = tuple[list[float], list[list[float]]]  # durations, s, and ascending coefficients
PATHS = ("under", "over")
MOVES = "moves"  # key of the note with the arguments of ``arm_moves`` as JSON
BANG_BANG = 0.5 - 1e-6  # ramp beyond which no way at full speed is left


def motion_of_pieces(durations: list[float], rows: list[list[float]], spec: dict[str, Any], loop: int = -1) -> Motion:
    """Motion of the arm angle alone, from t = 0, from the duration of each piece, s, and ascending coefficients."""
    coef = np.zeros((len(rows), CHANNELS, POWERS))
    for piece, row in zip(coef, rows, strict=True):
        piece[ANGLE, : len(row)] = row
    return Motion(np.append(0.0, np.cumsum(durations)), coef, np.ones(len(rows) + 1, dtype=np.bool_), loop, spec)


def move_pieces(start: float, end: float, duration: float, profile: str, ramp: float) -> Pieces:
    """Durations and coefficients of one move from `start` to `end`; takes complex numbers too."""
    way = end - start
    if profile == "bang-bang":
        half = 0.5 * duration
        a = way / half**2
        return [half, half], [[start, 0.0, 0.5 * a], [start + 0.5 * way, a * half, -0.5 * a]]
    if profile == "ramp":
        t_ramp = ramp * duration
        speed = way / (duration - t_ramp)
        a = speed / t_ramp
        rise = 0.5 * speed * t_ramp
        return [t_ramp, duration - 2.0 * t_ramp, t_ramp], [
            [start, 0.0, 0.5 * a],
            [start + rise, speed],
            [end - rise, speed, -0.5 * a],
        ]
    return [duration], [[start, 0.0, 0.0, 10 * way / duration**3, -15 * way / duration**4, 6 * way / duration**5]]


def hold_arm(angle: float = 0.0) -> Motion:
    """Return a motion that keeps the arm at one angle for ever.

    Parameters
    ----------
    angle : float
        Arm angle, rad; 0 hangs down, pi/2 points along +x.
    """
    angle = checks.number("angle", angle, unit="rad")
    checks.meant("angle", angle, "rad")
    return replace(motion_of_pieces([1.0], [[angle]], {"kind": "hold", "angle": angle}), switch=np.zeros(2, np.bool_))


def move_arm(start: float, end: float, duration: float, profile: Profile = "bang-bang", *, ramp: float = 0.1) -> Motion:
    """Return one move of the arm, from t = 0, after which it rests.

    Parameters
    ----------
    start, end : float
        Arm angles, rad; the arm turns through the angles between them.
    duration : float
        Time that the move takes, s.
    profile : {"bang-bang", "ramp", "minimum-jerk"}
        Full acceleration then full deceleration; constant speed with short ramps; the quintic of minimum jerk
        (Flash and Hogan 1985, doi:10.1523/JNEUROSCI.05-07-01688.1985).
    ramp : float
        Fraction of the duration of each ramp of ``"ramp"``, above 0 and at most 0.5.
    """
    start, end = checks.number("start", start, unit="rad"), checks.number("end", end, unit="rad")
    duration = checks.number("duration", duration, sign="positive", unit="s")
    checks.meant("arm angle", [start, end], "rad")
    checks.meant("duration", duration, "s")
    profile = checks.choice("profile", profile, PROFILES)  # type: ignore[assignment]
    given: dict[str, Any] = {"start": start, "end": end, "duration": duration, "profile": profile, "ramp": _ramp(ramp)}
    return motion_of_pieces(*move_pieces(**given), {"kind": "move", **given})


def _ramp(value: float) -> float:
    ramp = checks.number("ramp", value, sign="positive")
    if ramp >= 0.5:
        raise InvalidInput("ramp is too long", got=ramp, allowed="above 0 and below 0.5, as a part of the duration")
    return ramp


def arm_swings(
    t_move: float = 0.73,
    t_rest: float = 0.53,
    profile: Profile = "bang-bang",
    path: Literal["under", "over"] = "under",
    *,
    ramp: float = 0.1,
) -> Motion:
    """Return the paper's casting motion (Fig. 9): half a turn, rest, half a turn back, rest, for ever.

    Parameters
    ----------
    t_move, t_rest : float
        Time of a move (t_a in the paper) and of the rest after it (t_c), s; the rest may be 0.
    profile : {"bang-bang", "ramp", "minimum-jerk"}
        See :func:`move_arm`.
    path : {"under", "over"}
        The arm starts at -pi/2 at t = 0 and goes to +pi/2 through the bottom, or over the top to -3 pi/2.
    ramp : float
        See :func:`move_arm`.
    """
    given = checked_half_turn(t_move, profile, path, ramp)
    given["t_rest"] = checks.number("t_rest", t_rest, sign="nonnegative", unit="s")
    checks.meant("t_rest", given["t_rest"], "s")
    return motion_of_pieces(*swing_pieces(**given), {"kind": "swings", **given}, loop=0)


def checked_half_turn(t_move: float, profile: str, path: str, ramp: float) -> dict[str, Any]:
    """Return the checked arguments of a half turn by name."""
    t_move = checks.number("t_move", t_move, sign="positive", unit="s")
    checks.meant("t_move", t_move, "s")
    return {
        "t_move": t_move,
        "profile": checks.choice("profile", profile, PROFILES),
        "path": checks.choice("path", path, PATHS),
        "ramp": _ramp(ramp),
    }


def half_turn_ends(path: str) -> tuple[float, float]:
    """Arm angles at the start and after a half turn, rad."""
    return -0.5 * math.pi, (0.5 if path == "under" else -1.5) * math.pi


def swing_pieces(t_move: float, t_rest: float, profile: str, path: str, ramp: float) -> Pieces:
    """Durations and coefficients of one cycle of :func:`arm_swings`; takes complex numbers too."""
    start, end = half_turn_ends(path)
    return sequence_pieces([start, end, start], [0.0, t_rest, t_rest], 2 * [t_move], 2 * [(profile, ramp)])


def sequence_pieces(
    angles: list[float], rests: list[float], durations: list[float], shapes: list[tuple[str, float]]
) -> Pieces:
    """Durations and coefficients of moves through angles, of which each has a duration and a shape: profile and ramp.

    There is a rest before each move and one after the last; those of 0.0 have no piece. Takes complex numbers too.
    """
    times: list[float] = []
    rows: list[list[float]] = []
    for k, rest in enumerate(rests):
        if rest != 0.0:
            times.append(rest)
            rows.append([angles[k]])
        if k < len(durations):
            moved = move_pieces(angles[k], angles[k + 1], durations[k], *shapes[k])
            times += moved[0]
            rows += moved[1]
    return times, rows


def arm_moves(angles: ArrayLike, rests: ArrayLike, durations: ArrayLike, ramps: ArrayLike = 0.5) -> Motion:
    """Return moves of the arm through given angles, each with its own rest before it and its own duration.

    It ends with the last move, or the rest after it; the arm stays there.

    Parameters
    ----------
    angles : (k + 1,) array_like
        Arm angle at the start and after each move, rad.
    rests : (k,) or (k + 1,) array_like
        Rest before each move, and after the last one, s, >= 0.
    durations : (k,) array_like
        Time of each move, s, > 0.
    ramps : float or (k,) array_like
        Fraction of its time in which a move accelerates, and in which it decelerates, above 0 and at most 0.5; at 0.5
        there is no constant speed ("bang-bang").

    Raises
    ------
    InvalidInput
        If the numbers do not fit each other or their ranges.

    Examples
    --------
    >>> motion = arm_moves([-1.5, 1.5, 0.0], rests=[0.0, 0.4], durations=[0.7, 0.5])
    >>> [round(float(angle), 3) for angle in motion.angle([0.35, 1.0, 2.0])]
    [0.0, 1.5, 0.0]
    """
    way = checks.array("angles", angles, (-1,), unit="rad")
    count = way.size - 1
    if count < 1:
        raise InvalidInput("there is no move", got=way.tolist(), allowed="at least two angles")
    rest = checks.array("rests", rests, (-1,), sign="nonnegative", unit="s")
    checks.array("rests", rest, (count + (rest.size > count),))
    time = checks.array("durations", durations, (count,), sign="positive", unit="s")
    checks.meant("angles", way, "rad")
    checks.meant("durations", time, "s")  # rests may be long, as of a live arm that waits
    ramp = checks.array("ramps", ramps, (count,), scalar=True)
    if (ramp <= 0.0).any() or (ramp > 0.5).any():
        raise InvalidInput("ramps leave their range", got=ramp.tolist(), allowed="above 0 and at most 0.5")
    given = {"angles": way.tolist(), "rests": rest.tolist(), "durations": time.tolist(), "ramps": ramp.tolist()}
    return motion_of_pieces(*move_rows(**given), {"kind": "moves", **given})


def move_rows(angles: list[float], rests: list[float], durations: list[float], ramps: list[float]) -> Pieces:
    """Durations and coefficients of the pieces of :func:`arm_moves`; takes complex numbers too."""
    shapes = [("bang-bang" if np.real(ramp) > BANG_BANG else "ramp", ramp) for ramp in ramps]
    return sequence_pieces(angles, [*rests, 0.0][: len(angles)], durations, shapes)


def arm_strokes(
    starts: ArrayLike,
    t_move: float = 0.73,
    profile: Profile = "bang-bang",
    path: Literal["under", "over"] = "under",
    *,
    ramp: float = 0.1,
    made: int = 0,
) -> Motion:
    """Return half turns of the arm, alternately there and back, that start at given instants; the arm rests in between.

    It ends with the last half turn; the arm stays there.

    Parameters
    ----------
    starts : (k,) array_like
        When each half turn starts, s, from 0 on, at least `t_move` apart. None at all: the arm stays where it is.
    t_move : float
        Time of a half turn (t_a in the paper), s.
    profile, path, ramp
        As for :func:`hyperflex.arm_swings`, which is the same motion with equal rests.
    made : int
        Number of half turns made before; after an even number the arm is at -pi/2, after an odd one at the other end.

    Raises
    ------
    InvalidInput
        A half turn that starts before the last one ends, or before 0.

    Examples
    --------
    >>> motion = arm_strokes([0.0, 1.26, 2.4])
    >>> [round(float(angle), 3) for angle in motion.angle([0.0, 1.0, 2.2, 9.0])]
    [-1.571, 1.571, -1.571, 1.571]
    """
    begin = checks.array("starts", starts, (-1,), sign="nonnegative", unit="s")
    turn = checked_half_turn(t_move, profile, path, ramp)
    number, t_move = checks.count("made", made, least=0), turn["t_move"]
    rests = np.diff(begin, prepend=0.0) - np.append(0.0, np.full(begin.size, t_move))[: begin.size]
    if (rests < -MEET).any():
        k = int(np.argmax(rests < -MEET))
        raise InvalidInput(
            f"half turn {k} starts before half turn {k - 1} ends",
            got=begin[k - 1 : k + 1].tolist(),
            allowed=f"starts at least {t_move:g} s apart",
        )
    count, ends = begin.size, half_turn_ends(turn["path"])
    angles = [ends[(number + k) % 2] for k in range(count + 1)]
    gaps = [*np.where(rests > MEET, rests, 0.0).tolist(), 0.0 if count else 1.0]
    pieces = sequence_pieces(angles, gaps, count * [t_move], count * [(turn["profile"], turn["ramp"])])
    return motion_of_pieces(*pieces, {"kind": "strokes", "starts": begin.tolist(), **turn, "made": number})


def sampled_motion(t: ArrayLike, angle: ArrayLike) -> Motion:
    """Return a motion through measured arm angles: a cubic spline that starts and ends at rest.

    Parameters
    ----------
    t : (T,) array_like
        Increasing times, s, at least two.
    angle : (T,) array_like
        Arm angles, rad.
    """
    motion = _spline(t, {ANGLE: ("angle", angle)}, "sampled")
    checks.meant("angle", np.asarray(angle, dtype=np.float64), "rad")
    return motion


def moving_pivot(t: ArrayLike, x: ArrayLike, y: ArrayLike) -> Motion:
    """Return a motion of the pivot itself, as cubic splines that start and end at rest.

    Parameters
    ----------
    t : (T,) array_like
        As of :func:`sampled_motion`.
    x, y : (T,) array_like
        Displacement of the pivot, m.
    """
    return _spline(t, {X: ("x", x), Y: ("y", y)}, "moving point")


def vibrating_pivot(amplitude: float, frequency: float, direction: float = 0.0) -> Motion:
    """Return an endless sinusoidal vibration of the pivot along a line; it starts at rest at one extreme.

    Parameters
    ----------
    amplitude : float
        Amplitude of the displacement, m.
    frequency : float
        Hz.
    direction : float
        Of the line, rad, as the angle of a link that lies along it: 0 is vertical, pi/2 horizontal.
    """
    angle = checks.number("direction", direction, unit="rad")
    spec = {"kind": "vibrating point", "amplitude": amplitude, "frequency": frequency, "direction": angle}
    return _sinusoid(spec, "m", {X: math.sin(angle), Y: -math.cos(angle)}, 0.0)


def vibrate_arm(amplitude: float, frequency: float, mean: float = 0.0) -> Motion:
    """Return an endless sinusoidal vibration of the arm about an angle; it starts at rest at one extreme.

    Parameters
    ----------
    amplitude : float
        Amplitude of the angle, rad.
    frequency : float
        Hz.
    mean : float
        Angle about which the arm vibrates, rad.
    """
    angle = checks.number("mean", mean, unit="rad")
    checks.meant("arm angle", angle, "rad")
    spec = {"kind": "vibration", "amplitude": amplitude, "frequency": frequency, "mean": angle}
    return _sinusoid(spec, "rad", {ANGLE: 1.0}, angle)


def _sinusoid(spec: dict[str, Any], unit: str, channels: dict[int, float], mean: float) -> Motion:
    """Return the vibration that `spec` describes, in channels in proportion, as quintics through its derivatives.

    A piece of a twelfth of a period is accurate to 5e-7 of the amplitude, its acceleration to 4e-5 of its amplitude.
    Each sixth counts as a switch: longer steps of a rope that hangs still would not see the work.
    """
    spec["amplitude"] = checks.number("amplitude", spec["amplitude"], sign="nonnegative", unit=unit)
    spec["frequency"] = checks.number("frequency", spec["frequency"], sign="positive", unit="Hz")
    phase = np.linspace(0.0, math.tau, 13)
    wave = np.stack([np.cos(phase), -np.sin(phase), -np.cos(phase)])
    pieces = quintics(wave[:, :-1], wave[:, 1:], np.diff(phase))
    rate = math.tau * spec["frequency"]
    coef = np.zeros((len(pieces), CHANNELS, POWERS))
    for channel, part in channels.items():
        coef[:, channel] = part * spec["amplitude"] * pieces * rate ** np.arange(POWERS)
    coef[:, ANGLE, 0] += mean
    return Motion(phase / rate, coef, np.arange(phase.size) % 2 == 0, 0, spec)


def torque_profile(t: ArrayLike, torque: ArrayLike) -> Motion:
    """Return the torque of one or several motors, linear between its samples and 0 outside.

    The first joint is the arm's shaft or, without an arm, the joint that the rope hangs from.

    Parameters
    ----------
    t : (T,) array_like
        Increasing times, s, at least two.
    torque : (T,) or (T, k) array_like
        Torque of the first joint's motor, or of the motors in the first k joints, N m; 0 for a joint without one. A
        motor acts on the link after its joint, and with the opposite sign on the link before it.
    """
    time = checks.times("t", t, least=2)
    values = checks.array("torque", torque, (time.size, -1) if np.ndim(torque) == 2 else (time.size,), unit="N m")
    columns = values.reshape(time.size, -1)
    coef = np.zeros((time.size - 1, TORQUE + columns.shape[1], POWERS))
    coef[:, TORQUE:, 0] = columns[:-1]
    coef[:, TORQUE:, 1] = np.diff(columns, axis=0) / np.diff(time)[:, None]
    spec = {"kind": "torque", "t": time.tolist(), "torque": values.tolist()}
    return Motion(time, coef, np.ones(time.size, dtype=np.bool_), -1, spec)


def _spline(t: ArrayLike, channels: dict[int, tuple[str, ArrayLike]], kind: str) -> Motion:
    from scipy.interpolate import CubicSpline

    time = checks.times("t", t, least=2)
    coef = np.zeros((time.size - 1, CHANNELS, POWERS))
    spec: dict[str, Any] = {"kind": kind, "t": time.tolist()}
    for channel, (name, samples) in channels.items():
        values = checks.array(name, samples, (time.size,))
        spline = CubicSpline(time, values, bc_type="clamped")
        coef[:, channel, :4] = spline.c[::-1].T
        spec[name] = values.tolist()
    # The third derivative jumps at every sample, and no error estimate of a step across such a jump can be believed.
    return Motion(time, coef, np.ones(time.size, dtype=np.bool_), -1, spec)


def read_motion(path: str | Path) -> Motion:
    """Read a sampled arm motion from a CSV file with the columns ``t`` (s) and ``angle`` (rad).

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Motion
        A spline through the samples (:func:`sampled_motion`). For a file written by a plan, the exact moves from the
        note MOVES in its header, if they agree with the samples within MEET: a spline needs up to 1.4 times the
        acceleration next to each of its jumps.

    Raises
    ------
    InvalidInput
        If the columns are others, or a value is missing or not a number.
    """
    table = files.read_table(path)
    if table.names != ["t", "angle"]:
        raise InvalidInput(f"columns of {path} are not those of a motion", got=table.names, allowed="t,angle (s, rad)")
    with located(str(path)):
        sampled = sampled_motion(t := table.times("t"), angle := table.values[:, 1])
    try:
        exact = arm_moves(**json.loads(table.notes[MOVES]))
    except (InvalidInput, KeyError, TypeError, ValueError):  # not what a plan wrote
        return sampled
    return exact if np.abs(exact.angle(t) - angle).max() <= MEET else sampled


def from_spec(spec: Mapping[str, Any], folder: Path | None = None) -> Motion:
    """Build the motion that a ``[motion]`` table describes; a file that it names lies in `folder` (or where one is)."""
    kind = checks.choice("motion kind", spec.get("kind"), tuple(MOTIONS))
    maker = MOTIONS[kind].maker
    arguments = inspect.signature(maker).parameters.values()
    needed = [each.name for each in arguments if each.default is each.empty]
    checks.keys(f"the motion table of kind {kind!r}", spec, motion_keys(kind), needed=needed)
    rest = {key: value for key, value in spec.items() if key not in ("kind", "delay")}
    if folder is not None and kind == "file" and isinstance(rest.get("path"), str):
        rest["path"] = folder / rest["path"]
    motion = maker(**rest)
    return motion.shifted(spec["delay"]) if "delay" in spec else motion


def motion_keys(kind: object) -> list[str]:
    """Return the keys of a motion table of this kind, or of all kinds where it is none."""
    kinds = [MOTIONS[kind]] if isinstance(kind, str) and kind in MOTIONS else MOTIONS.values()
    return ["kind", "delay", *(key for each in kinds for key in inspect.signature(each.maker).parameters)]


def to_spec(motion: Motion) -> dict[str, Any]:
    """Return a table for a TOML file from which :func:`from_spec` builds the same motion again."""
    if motion.spec:
        return dict(motion.spec)
    return {
        "kind": "pieces",
        "breaks": motion.breaks.tolist(),
        "coef": motion.coef.ravel().tolist(),
        "switch": motion.switch.tolist(),
        "loop": motion.loop,
    }


def _from_pieces(breaks: list[float], coef: list[float], switch: list[bool], loop: int) -> Motion:
    flat = checks.array("coef", coef, (-1,))
    channels, rest = divmod(flat.size, max(np.size(breaks) - 1, 1) * POWERS)
    if rest or channels < CHANNELS:
        allowed = f"{CHANNELS * POWERS} numbers a piece, {POWERS} more for each further joint with a motor"
        raise InvalidInput("coef has the wrong size", got=flat.size, allowed=allowed)
    return Motion(np.array(breaks), flat.reshape(-1, channels, POWERS), np.array(switch), loop)


TINY = 1e-40  # of a complex step: no difference is formed, so nothing is lost


class Kind(NamedTuple):
    """A kind of motion in the table of a file."""

    maker: Callable[..., Motion]
    varies: tuple[str, ...] = ()  # the parameters that may vary; of a list each number
    pieces: Callable[..., Any] | None = None  # their durations and coefficients; None: linear in its samples


MOTIONS = {
    "hold": Kind(hold_arm, ("angle",), lambda angle: ([1.0], [[angle]])),
    "move": Kind(move_arm, ("start", "end", "duration", "ramp"), move_pieces),
    "swings": Kind(arm_swings, ("t_move", "t_rest", "ramp"), swing_pieces),
    "strokes": Kind(arm_strokes),
    "moves": Kind(arm_moves, ("angles", "rests", "durations", "ramps"), move_rows),
    "sampled": Kind(sampled_motion, ("angle",)),
    "moving point": Kind(moving_pivot, ("x", "y")),
    "vibrating point": Kind(vibrating_pivot),
    "vibration": Kind(vibrate_arm),
    "torque": Kind(torque_profile, ("torque",)),
    "pieces": Kind(_from_pieces),
    "file": Kind(read_motion),
}


def motion_parameters(motion: Motion) -> list[str]:
    """Return the names by which a motion can vary: its times and angles, each of its samples, and its delay."""
    names = ["delay"]
    for name in MOTIONS[kind].varies if (kind := motion.spec.get("kind")) in MOTIONS else ():
        value = motion.spec[name]
        if not isinstance(value, list):
            names.append(name)
        elif np.ndim(value) == 1:  # not the torques of several joints
            names += [f"{name}[{i}]" for i in range(len(value))]
    return names


def motion_derivatives(motion: Motion, name: str) -> tuple[Array, Array]:
    """Return the derivatives of a motion's breaks (k + 1,) and coefficients (k, 4 or more, 6) by a parameter.

    Parameters
    ----------
    motion : Motion
    name : str
        One of :func:`motion_parameters`.

    Raises
    ------
    InvalidInput
        If the motion has no such parameter, or was not made from parameters (joined, read from pieces).
    """
    if name not in motion_parameters(motion):
        raise InvalidInput(
            f"motion of kind {motion.spec.get('kind', 'pieces')!r} has no parameter of that name",
            got=name,
            allowed=", ".join(motion_parameters(motion)),
            fix="For any other change give the derivatives of breaks and coef themselves",
        )
    if name == "delay":
        return np.ones_like(motion.breaks), np.zeros_like(motion.coef)
    kind = MOTIONS[motion.spec["kind"]]
    if kind.pieces is None:
        return _of_sample(motion, kind, name)
    durations, rows = kind.pieces(**_complex_step(motion, name))
    breaks = np.concatenate([[0.0], np.cumsum(np.imag(durations))]) / TINY
    coef = np.zeros_like(motion.coef)
    for piece, row in zip(coef, rows, strict=True):
        piece[ANGLE, : len(row)] = np.imag(row) / TINY
    return breaks, coef


def _of_sample(motion: Motion, kind: Kind, name: str) -> tuple[Array, Array]:
    """A spline through samples depends linearly on them: its derivative is the spline through a unit sample."""
    channel, _, index = name.rstrip("]").partition("[")
    t = motion.spec["t"]
    samples = {key: np.zeros(len(t)) for key in kind.varies}
    samples[channel][int(index)] = 1.0
    return np.zeros_like(motion.breaks), np.array(kind.maker(t, **samples).coef)


def _complex_step(motion: Motion, name: str) -> dict[str, Any]:
    """Return the parameters of a motion, of which one, such as ``rests[2]``, has a tiny imaginary part."""
    key, _, index = name.rstrip("]").partition("[")
    values = {key: value for key, value in motion.spec.items() if key not in ("kind", "delay")}
    value = values[key][int(index)] if index else values[key]
    if (key in ("rests", "t_rest") and value == 0.0) or (key == "ramps" and value > BANG_BANG):
        raise InvalidInput(
            f"motion without a rest or a ramp cannot vary {name}", got=value, allowed="a rest > 0, in s, a ramp < 0.5"
        )
    value = value + 1j * TINY
    if index:
        value = [*values[key][: int(index)], value, *values[key][int(index) + 1 :]]
    return values | {key: value}
