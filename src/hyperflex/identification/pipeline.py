"""identify: from a recording and a first guess to an Identification."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.excitation import check_motion, check_times
from hyperflex.identification.fit.loss import LOSSES, Loss, LossName
from hyperflex.identification.fit.multiple_shooting import Report, one_thread
from hyperflex.identification.fit.stages import Measurements, fit_in_stages, search_delay, with_delay
from hyperflex.identification.fit.windows import usual_length, with_enough_frames
from hyperflex.identification.measurements import (
    checked_arc_lengths,
    first_joint,
    measure,
    refuse_still_markers,
    with_torque,
)
from hyperflex.identification.model.names import parse
from hyperflex.identification.model.parameters import Parameters
from hyperflex.identification.model.plant import Plant, pivot_places
from hyperflex.identification.prediction import predict, prediction_uncertainty
from hyperflex.identification.result import Identification, assemble_result
from hyperflex.identification.uncertainty.covariance import Basis, estimate_covariance
from hyperflex.identification.uncertainty.interval_method import HOWS, How, all_intervals
from hyperflex.identification.verdict import other_lengths
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.recording import Recording
from hyperflex.sensors import Angles, Markers

TRAIN = 0.8  # part of a recording that is fitted when nothing is said


@one_thread()
def identify(
    recording: Recording,
    rope_guess: Rope,
    free: Sequence[str] = ("inertia", "friction"),
    *,
    window: float | None = None,
    train: float | None = None,
    motion: Motion | None = None,
    arm: Arm | None = None,
    arc_lengths: npt.ArrayLike | None = None,
    origin: npt.ArrayLike | None = None,
    torque: npt.ArrayLike | None = None,
    torque_noise: npt.ArrayLike | None = None,
    loss: LossName = "squares",
    lead: float = 0.5,
    ahead: float = 1.0,
    intervals: How | None = "auto",
    progress: bool | Report = False,
) -> Identification:
    """Identify a rope from its recorded motion by output-error shooting with exact derivatives.

    The recording is cut into windows. In each, the simulated motion starts from a state of its own; the parameters are
    common. All are fitted to what was measured together, shorter windows first.

    Parameters
    ----------
    recording : Recording
        Angles, or markers at the joints (their angles are fitted), as many links as the rope; or, with `arc_lengths`,
        markers anywhere along the rope (their places are fitted), also fewer than links.
    rope_guess : Rope
        Everything that is not free is taken from it; the free ones start from it.
    free : sequence of str
        ``inertia``, ``com``, ``mass``, ``length``, ``friction``, ``dry_friction``, ``stiffness``, ``rest_angle``,
        ``drag`` (each link's own),
        ``tip_mass``, ``gravity_angle`` (rad; turns gravity, for a camera that is not level), ``delay`` (s; by how much
        `motion` comes later in the recording's time; looked for within a window's length), ``arc`` (m; each marker's
        place, or ``arc[2]``). ``friction[2]`` frees one link only, ``friction:shared`` one value for all links,
        ``friction:factor`` one factor on the guess of all, ``friction:taper`` the logarithm by which it grows along the
        rope, pivoted at its middle. Of a link that the guess has uniform (com in its middle), com and inertia go with
        a free length unless they are free too.
        ``arm_inertia`` and ``arm_friction`` (of the shaft) with a measured torque.
    window : float, s, optional
        Length of the windows. By default 1.2 periods of a small swing of a straight rod as long as the rope, or less
        where links turn fast, and more where frames are few; it does not depend on the guess of what is free.
    train : float, s, optional
        Fit the samples with t < train and predict the rest; ``inf`` fits all. By default the first 80 % is fitted if
        the rest is long enough for a prediction, else all.
    motion, arm : Motion, Arm, optional
        What the first joint does, in the recording's time; by default it hangs from a fixed point.
    arc_lengths : (K,) array_like, m, optional
        Distance along the rope of each marker from the first joint. A marker alone needs `origin` as well.
    origin : (2,) array_like, m, optional
        Where the camera sees the origin of the motion (the first joint, if it is fixed). Where it is not given with
        `arc_lengths`, it is fitted as ``origin_x`` and ``origin_y``.
    torque : (T,) array_like, N m, optional
        Torque of the motor at the recording's times, NaN in gaps; it fixes the absolute scale. It needs `motion` and
        `arm`.
    torque_noise : float or (T,) array_like, N m, optional
        Its standard deviation; given with a torque, beside the noise of the recording.
    loss : {"squares", "huber", "cauchy"}
        ``cauchy`` keeps gross outliers from ruling the fit; ``huber`` counts them less than their squares.
    lead, ahead : float, s
        Held-out part: states are fitted on `lead` and angles predicted `ahead`.
    intervals : {"auto", "covariance", "profile", None}
        How 95 % intervals are found: from standard deviations; by profile likelihood (some six short fits a
        parameter); ``auto`` profiles where the covariance is skewed, as that of a parameter near 0; None finds none.
    progress : bool or callable
        True prints a line a round on standard error; a callable gets a dict with window, stage, stages, round, cost,
        gain, damping, and of a profile its parameter and ``phase="profile"``.

    Returns
    -------
    Identification

    Raises
    ------
    InvalidInput
        For unknown names in `free`, recordings with too few samples or without motion, links or lengths that do not
        fit the rope.
    IdentificationError
        When no window can be simulated at all.
    KeyboardInterrupt
        When Ctrl-C comes before anything was fitted. Later it ends the fit, and the best so far is returned with
        ``message == "interrupted"``.

    Notes
    -----
    Without a known force or torque a common factor of masses, inertias and frictions cannot be known; `verdict` says
    so, `std` is inf there, and `ratios` hold what is known. Samples denser than 200 a window are thinned (picked); the
    step is in ``settings["decimation"]``. Samples without given noise count alike. With fewer markers than links,
    a prior keeps neighbouring links about in line (0.5 rad over the root of their number): what no marker sees is
    taken from there.

    Examples
    --------
    >>> import numpy as np
    >>> import hyperflex as hf
    >>> true = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)
    >>> t = np.linspace(0.0, 6.0, 301)
    >>> swing = hf.simulate(true, duration=6.0, t_eval=t, q0=[0.8], qd0=[0.0])
    >>> result = hf.identify(hf.Recording(t, swing.q), true.replace(friction=1e-3), ["inertia", "friction"])
    >>> bool(abs(result.rope.friction[0] / 2e-4 - 1.0) < 1e-3)
    True
    """
    began = time.monotonic()
    checks.choice("loss", loss, LOSSES)
    if intervals is not None:
        checks.choice("intervals", intervals, HOWS)
    measured, places = _checked(recording, rope_guess, arc_lengths, origin, motion, arm)
    if arm is not None and motion is None:
        raise InvalidInput("arm is given without its motion", fix="Pass motion=... as well, or leave arm out")
    if torque is not None and arm is None:
        raise InvalidInput("torque is given without the arm it turns", fix="Pass arm=... and motion=... as well")
    plant = build_plant(recording, rope_guess, free, places, origin, motion, arm, torque=torque is not None)
    foretold = plant.without_torque()  # what is held out is predicted without force or torque
    fitted, rest = _split(measured, train, lead, ahead)
    check_times(fitted.channels, rope_guess)
    check_motion(fitted.shape, fitted.channels)
    delay = {}
    usual = with_enough_frames(usual_length(fitted.shape, rope_guess), fitted.shape)
    if "delay" in free:
        delay["delay_from"] = search_delay(foretold, fitted, usual, Loss(loss))
        plant = with_delay(plant, delay["delay_from"])
        foretold = plant.without_torque()
    if torque is not None:
        fitted, _ = _split(with_torque(measured, torque, torque_noise), train, lead, ahead)
    length = usual if window is None else checks.number("window", window, sign="positive", infinite=True)
    length = min(length, 1.001 * fitted.channels.duration)
    found, windows, settings = fit_in_stages(plant, fitted, length, usual, _reporter(progress), Loss(loss))
    basis = Basis(plant, windows, found, estimate_covariance(plant, windows, found))
    how = intervals if found.converged or intervals is None else "covariance"
    ranges = None if how is None else all_intervals(basis, how, report=_reporter(progress))
    held_out = None
    try:
        if rest is not None and not found.interrupted:  # who stops a fit waits for nothing more
            spread = prediction_uncertainty(basis.information, windows, found).of(measured.channels.data.shape[1])
            held_out = predict(foretold, found.x, rest, lead, ahead, Loss(loss), spread)
    except KeyboardInterrupt:  # what was fitted is worth more than its trial
        found.interrupted = True
    settings |= {"fitted_from": float(fitted.channels.t[0]), "fitted_to": float(fitted.channels.t[-1])}
    settings |= {"autocorrelation": basis.information.correlation, "seconds": time.monotonic() - began}
    settings |= delay | _fit_settings(free, loss, places, origin, motion, arm)
    remarks = [] if arc_lengths is not None else other_lengths(recording, rope_guess)
    return assemble_result(basis, held_out, settings, remarks, ranges)


def _checked(
    recording: Recording,
    rope: Rope,
    arc_lengths: npt.ArrayLike | None,
    origin: npt.ArrayLike | None,
    motion: Motion | None,
    arm: Arm | None,
) -> tuple[Measurements, Array | None]:
    """Return what is fitted, if it fits the rope, and where its markers sit if not at the joints."""
    if not isinstance(recording, Recording) or not isinstance(rope, Rope):
        raise InvalidInput(
            "identify takes a Recording and a Rope",
            got=[type(recording).__name__, type(rope).__name__],
            fix="Read the file with read_recording first",
        )
    if arc_lengths is not None:
        places = checked_arc_lengths(recording, rope, arc_lengths)
        refuse_still_markers(recording, places)
        joint = None
        if places.size == 1:
            if origin is None:
                raise InvalidInput(
                    "one marker alone does not show where the rope hangs from",
                    fix="Say where the camera sees that: origin=(x, y), in m; or track a second marker",
                )
            joint = checks.array("origin", origin, (2,), unit="m") + pivot_places(motion, arm, recording.t)
        return measure(recording, rope, places, joint), places
    if recording.n_links != rope.n_links:
        raise InvalidInput(
            "the recording and the rope have different numbers of links",
            got=[recording.n_links, rope.n_links],
            fix="Give a guess with as many links as the recording has angles (markers less one), or say where along "
            "the rope the markers sit, arc_lengths=[...]",
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
    refuse_still_markers(recording, np.append(0.0, np.cumsum(rope.length)))
    return measure(recording, rope, None), None


def build_plant(
    recording: Recording,
    guess: Rope,
    free: Sequence[str],
    arc_lengths: Array | None,
    origin: npt.ArrayLike | None,
    motion: Motion | None,
    arm: Arm | None,
    *,
    torque: bool = False,
) -> Plant:
    """Return what predicts the measurements, with all that is free."""
    chosen = parse(guess, free, arc_lengths, moved=motion is not None, arm=arm if torque else None)
    if arc_lengths is None:
        if origin is not None:
            raise InvalidInput(
                "origin is given, but angles are fitted", fix="Give arc_lengths=... as well, or leave it out"
            )
        return Plant(Parameters(guess, chosen), Angles(), motion, arm, torque=torque)
    if origin is None:
        words = [word for word in ("origin_x", "origin_y") if word not in free]
        chosen += parse(guess, words, arc_lengths) if words else []
        place = first_joint(recording, arc_lengths, pivot_places(motion, arm, recording.t))
    else:
        place = checks.array("origin", origin, (2,), unit="m")
    starts = {"origin_x": float(place[0]), "origin_y": float(place[1])}
    chosen = [replace(each, start=starts.get(each.name, each.start)) for each in chosen]
    return Plant(Parameters(guess, chosen), Markers(arc_lengths, place), motion, arm, torque=torque)


def _split(
    measured: Measurements, train: float | None, lead: float, ahead: float
) -> tuple[Measurements, Measurements | None]:
    """Return what is fitted and what is held out."""
    every = measured.channels
    for name, value in (("lead", lead), ("ahead", ahead)):
        checks.number(name, value, sign="positive", unit="s")
    if train is None:
        time = float(every.t[0] + TRAIN * every.duration)
        if every.t[-1] - time < lead + ahead:
            return measured, None
    else:
        time = checks.number("train", train, unit="s", infinite=True)
        if time > every.t[-1]:
            return measured, None
        if time <= every.t[0]:
            raise InvalidInput("train leaves nothing to fit", got=time, allowed=f"a time after {every.t[0]:g} s")
    fitted = measured.between(-np.inf, time)
    rest = every.t >= time
    return fitted, measured.between(time, np.inf) if rest.sum() > 1 else None


def _fit_settings(
    free: Sequence[str],
    loss: LossName,
    arc_lengths: Array | None,
    origin: npt.ArrayLike | None,
    motion: Motion | None,
    arm: Arm | None,
) -> dict[str, Any]:
    """Return how the fit was set up, in plain words and numbers."""
    base = "fixed" if motion is None else "moved" if arm is None else f"moved by an arm of {arm.length:g} m"
    result: dict[str, Any] = {"free": list(free), "loss": loss, "base": base}
    if arc_lengths is not None:
        result["arc_lengths"] = arc_lengths.tolist()
    if origin is not None:
        result["origin"] = np.asarray(origin, dtype=np.float64).tolist()
    return result


def _reporter(progress: bool | Report) -> Report:
    """Return what hears of each round."""
    if callable(progress):
        return progress

    def line(entry: dict[str, float]) -> None:
        if progress:
            about = f"profile of {entry['parameter']}, " if "parameter" in entry else ""
            sys.stderr.write(
                f"{about}windows of {entry['window']:.3g} s, round {entry['round']:.0f}: cost {entry['cost']:.6g}, "
                f"down by {100.0 * entry['gain']:.3g} %\n"
            )

    return line
