"""Ready-made motions: hold, move, the paper's swings, and measured samples."""

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE, TORQUE, X, Y
from hyperflex.errors import InvalidInput
from hyperflex.motion.piecewise import CHANNELS, POWERS, Motion

Profile = Literal["bang-bang", "ramp", "minimum-jerk"]
PROFILES = ("bang-bang", "ramp", "minimum-jerk")
PATHS = ("under", "over")


def arm_motion(breaks: Array, rows: list[list[float]], spec: dict[str, Any], loop: int = -1) -> Motion:
    """Motion of the arm angle alone from breaks (k + 1,), s, and ascending coefficients of each piece."""
    coef = np.zeros((len(rows), CHANNELS, POWERS))
    for piece, row in zip(coef, rows, strict=True):
        piece[ANGLE, : len(row)] = row
    return Motion(breaks, coef, np.ones(breaks.size, dtype=np.bool_), loop, spec)


def motion_of_pieces(durations: list[float], rows: list[list[float]], spec: dict[str, Any], loop: int = -1) -> Motion:
    """As :func:`arm_motion`, from t = 0, from the duration of each piece, s."""
    return arm_motion(np.concatenate([[0.0], np.cumsum(durations)]), rows, spec, loop)


def move_pieces(
    start: float, end: float, duration: float, profile: str, ramp: float
) -> tuple[list[float], list[list[float]]]:
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
    """Return a motion that keeps the arm where it is for ever.

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
        Part of the duration that each ramp of ``"ramp"`` takes, above 0 and at most 0.5.
    """
    start, end = checks.number("start", start, unit="rad"), checks.number("end", end, unit="rad")
    duration = checks.number("duration", duration, sign="positive", unit="s")
    checks.meant("arm angle", [start, end], "rad")
    checks.meant("duration", duration, "s")
    profile = checks.choice("profile", profile, PROFILES)  # type: ignore[assignment]
    ramp = _ramp(ramp)
    spec = {"kind": "move", "start": start, "end": end, "duration": duration, "profile": profile, "ramp": ramp}
    return motion_of_pieces(*move_pieces(start, end, duration, profile, ramp), spec)


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


def swing_pieces(
    t_move: float, t_rest: float, profile: str, path: str, ramp: float
) -> tuple[list[float], list[list[float]]]:
    """Durations and coefficients of one cycle of :func:`arm_swings`; takes complex numbers too."""
    start, end = half_turn_ends(path)
    durations: list[float] = []
    rows: list[list[float]] = []
    for here, there in ((start, end), (end, start)):
        stroke = move_pieces(here, there, t_move, profile, ramp)
        durations += stroke[0] + ([t_rest] if t_rest != 0.0 else [])
        rows += stroke[1] + ([[there]] if t_rest != 0.0 else [])
    return durations, rows


def sampled_motion(t: npt.ArrayLike, angle: npt.ArrayLike) -> Motion:
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


def moving_pivot(t: npt.ArrayLike, x: npt.ArrayLike, y: npt.ArrayLike) -> Motion:
    """Return a motion of the pivot itself, as cubic splines that start and end at rest.

    Parameters
    ----------
    t : (T,) array_like
        As of :func:`sampled_motion`.
    x, y : (T,) array_like
        Displacement of the pivot, m.
    """
    return _spline(t, {X: ("x", x), Y: ("y", y)}, "moving point")


def torque_profile(t: npt.ArrayLike, torque: npt.ArrayLike) -> Motion:
    """Return a motor torque that runs straight between its samples and is 0 outside.

    Parameters
    ----------
    t : (T,) array_like
        Increasing times, s, at least two.
    torque : (T,) array_like
        Motor torque, N m.
    """
    time = checks.times("t", t, least=2)
    values = checks.array("torque", torque, (time.size,), unit="N m")
    coef = np.zeros((time.size - 1, CHANNELS, POWERS))
    coef[:, TORQUE, 0] = values[:-1]
    coef[:, TORQUE, 1] = np.diff(values) / np.diff(time)
    spec = {"kind": "torque", "t": time.tolist(), "torque": values.tolist()}
    return Motion(time, coef, np.ones(time.size, dtype=np.bool_), -1, spec)


def _spline(t: npt.ArrayLike, channels: dict[int, tuple[str, npt.ArrayLike]], kind: str) -> Motion:
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
