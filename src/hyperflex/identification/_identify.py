"""The one door: a recording and a guess in, an Identification out."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification._parameters import SCALARS, Parameters
from hyperflex.identification._prediction import predict
from hyperflex.identification._result import Identification
from hyperflex.identification._shooting import Fit, Plant, Report
from hyperflex.identification._stages import fit_in_stages
from hyperflex.identification._uncertainty import Information, judge, ratio_spread, ratios
from hyperflex.identification._verdict import failed_predictions, not_arrived, not_noise, other_lengths, verdict
from hyperflex.identification._windows import Window, check_motion, usual_length
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.recording import Recording

TRAIN = 0.8  # part of a recording that is fitted when nothing is said
POOR = 0.2  # part of the motion that may stay unexplained before the verdict calls the fit poor


def identify(
    recording: Recording,
    rope_guess: Rope,
    free: Sequence[str] = ("inertia", "friction"),
    *,
    window: float | None = None,
    train: float | None = None,
    motion: Motion | None = None,
    arm: Arm | None = None,
    lead: float = 0.5,
    ahead: float = 1.0,
    progress: bool | Report = False,
) -> Identification:
    """Identify a rope from its recorded motion by output-error shooting.

    The recording is cut into short windows. In each, the simulated angles start from a state of their own; the
    parameters are common. All are fitted to the measured angles together, shorter windows first.

    Parameters
    ----------
    recording : Recording
        Angles, or markers at the joints (their angles are fitted). As many links as the rope.
    rope_guess : Rope
        Everything that is not free is taken from it; the free ones start from it.
    free : sequence of str
        ``inertia``, ``com``, ``mass``, ``length``, ``friction``, ``dry_friction``, ``stiffness`` (each link's own),
        ``tip_mass``, ``gravity_angle`` (rad; turns gravity, for a camera that is not level). ``friction[2]`` frees one
        link only, ``friction:shared`` one value for all links.
    window : float, s, optional
        Length of the windows. By default 1.2 periods of a small swing of a straight rod as long as the rope, or less
        where links turn fast; it does not depend on the guess of what is free.
    train : float, s, optional
        Fit the samples with t < train and predict the rest; ``inf`` fits all. By default the first 80 % is fitted if
        the rest is long enough for a prediction, else all.
    motion, arm : Motion, Arm, optional
        What the first joint does, in the recording's time; by default it hangs from a fixed point.
    lead, ahead : float, s
        Held-out part: states are fitted on `lead` and angles predicted `ahead`.
    progress : bool or callable
        True prints a line a round on standard error; a callable gets a dict with window, round, cost, gain, damping.

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
        ``status == "interrupted"``.

    Notes
    -----
    Without a known force or torque a common factor of masses, inertias and frictions cannot be known; `verdict` says
    so, `sd` is inf there, and `ratios` hold what is known. Samples denser than 200 a window are thinned (picked); the
    step is in ``settings["decimation"]``. Samples without given noise count alike.

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
    angles = _checked(recording, rope_guess)
    if arm is not None and motion is None:
        raise InvalidInput("arm is given without its motion", fix="Pass motion=... as well, or leave arm out")
    plant = Plant(motion, arm)
    fitted, rest = _split(angles, train, lead, ahead)
    check_motion(fitted)
    parameters = Parameters(rope_guess, free)
    length = usual_length(fitted, rope_guess) if window is None else checks.number("window", window, sign="positive")
    found, windows, settings = fit_in_stages(plant, parameters, fitted, length, _reporter(progress))
    information = judge(plant, parameters, windows, found)
    rope = parameters.rope(found.x)
    held_out = None if rest is None else predict(plant, rope, rest, lead, ahead)
    settings |= {"fitted_from": float(fitted.t[0]), "fitted_to": float(fitted.t[-1])}
    settings |= {"autocorrelation": information.correlation, "seconds": time.monotonic() - began}
    return _result(parameters, information, found, windows, held_out, settings, other_lengths(recording, rope_guess))


def _checked(recording: Recording, rope: Rope) -> Recording:
    """Return the recording's angles, if they fit the rope."""
    if not isinstance(recording, Recording) or not isinstance(rope, Rope):
        raise InvalidInput(
            "identify takes a Recording and a Rope",
            got=[type(recording).__name__, type(rope).__name__],
            fix="Read the file with read_recording first",
        )
    if recording.n_links != rope.n_links:
        raise InvalidInput(
            "the recording and the rope have different numbers of links",
            got=[recording.n_links, rope.n_links],
            fix="Give a guess with as many links as the recording has angles (markers less one)",
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
    return recording.angles()


def _split(angles: Recording, train: float | None, lead: float, ahead: float) -> tuple[Recording, Recording | None]:
    """Return what is fitted and what is held out."""
    for name, value in (("lead", lead), ("ahead", ahead)):
        checks.number(name, value, sign="positive", unit="s")
    if train is None:
        time = float(angles.t[0] + TRAIN * angles.duration)
        if angles.t[-1] - time < lead + ahead:
            return angles, None
        return angles.split(time)
    time = checks.number("train", train, unit="s", infinite=True)
    if time > angles.t[-1]:
        return angles, None
    if time <= angles.t[0]:
        raise InvalidInput("train leaves nothing to fit", got=time, allowed=f"a time after {angles.t[0]:g} s")
    fitted = angles.window(-np.inf, time)
    rest = angles.t >= time
    return fitted, angles.window(time, np.inf) if rest.sum() > 1 else None


def _reporter(progress: bool | Report) -> Report:
    """Return what hears of each round."""
    if callable(progress):
        return progress

    def line(entry: dict[str, float]) -> None:
        if progress:
            sys.stderr.write(
                f"windows of {entry['window']:.3g} s, round {entry['round']:.0f}: cost {entry['cost']:.6g}, "
                f"down by {100.0 * entry['gain']:.3g} %\n"
            )

    return line


def _result(
    parameters: Parameters,
    information: Information,
    found: Fit,
    windows: list[Window],
    held_out: Any,
    settings: dict[str, Any],
    remarks: list[str],
) -> Identification:
    """Put everything together; `remarks` join the verdict."""
    rope, slopes = parameters.rope(found.x), parameters.slopes(found.x)
    spreads = information.spread(np.diag(slopes))
    weights = np.concatenate([w.weight for w in windows])
    flat = np.concatenate([r.reshape(w.y.shape) for r, w in zip(found.residuals, windows, strict=True)])
    with np.errstate(divide="ignore", invalid="ignore"):
        residuals = np.where(weights > 0.0, -flat / weights, np.nan)
    rms = np.sqrt(np.nanmean(residuals**2, axis=0))
    ratio_sd = ratio_spread(parameters, information)
    status = "interrupted" if found.interrupted else "converged" if found.converged else "not converged"
    words = not_arrived(status) + verdict(parameters, information, rope, ratio_sd)
    words += _poor(windows, rms) + not_noise(information.correlation) + failed_predictions(held_out) + remarks
    return Identification(
        rope=rope,
        values=_by_name(parameters, rope, parameters.values(found.x)),
        sd=_by_name(parameters, None, spreads),
        ratios=ratios(rope),
        ratio_sd=ratio_sd,
        verdict=tuple(words),
        identifiable=information.unknown.shape[1] == 0,
        residual_rms=rms,
        residual_t=np.concatenate([w.t for w in windows]),
        residuals=residuals,
        held_out=held_out,
        parameters=parameters.labels,
        covariance=information.covariance * np.outer(slopes, slopes),
        singular_values=information.singular,
        settings=settings,
        status=status,
        history=tuple(found.history),
    )


def _by_name(parameters: Parameters, rope: Rope | None, numbers: Array) -> dict[str, Array]:
    """Return numbers (P,) by property: (n,) with the rope's own (or 0) where a link is not free, or single."""
    n = parameters.guess.n_links
    result: dict[str, Array] = {}
    for parameter, number in zip(parameters.all, numbers, strict=True):
        if parameter.name in SCALARS:
            result[parameter.name] = np.array(number)
        else:
            held = np.zeros(n) if rope is None else getattr(rope, parameter.name).copy()
            result.setdefault(parameter.name, held)[list(parameter.links)] = number
    return result


def _poor(windows: list[Window], rms: Array) -> list[str]:
    """Return a warning where the model leaves much of the motion unexplained."""
    known = [np.where(w.weight > 0.0, w.y, np.nan) for w in windows]
    spread = np.sqrt(np.mean([np.nanvar(y, axis=0) for y in known], axis=0))
    worst = int(np.argmax(rms / np.maximum(spread, 1e-12)))
    if rms[worst] <= POOR * spread[worst]:
        return []
    text = (
        f"The fit is poor: link {worst} is {rms[worst]:.3g} rad off, and moves by {spread[worst]:.3g} rad (rms) within "
        "the windows. Check the recording's units, zero and sense, the link lengths, the base's motion and the guess."
    )
    return [text]
