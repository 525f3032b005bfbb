"""What is fitted: measurements that fit the rope, and the model that predicts them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit.stages import Measurements
from hyperflex.identification.measurements import checked_arc_lengths, first_joint, measure, refuse_still_markers
from hyperflex.identification.model.names import parse
from hyperflex.identification.model.parameters import Parameters
from hyperflex.identification.model.plant import Plant, pivot_places
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.recording import Recording
from hyperflex.sensors import Angles, Markers

TRAIN = 0.8  # part of a recording that is fitted when nothing is said


def checked_measurements(
    recording: Recording,
    rope: Rope,
    arc_lengths: npt.ArrayLike | None,
    origin: npt.ArrayLike | None,
    motion: Motion | None,
    arm: Arm | None,
) -> tuple[Measurements, Array | None]:
    """Return the measurements, if they fit the rope, and the arc lengths of markers that are not at the joints."""
    if not isinstance(recording, Recording):
        fix = "Read the file with read_recording first"
        raise InvalidInput("recording is not a Recording", got=recording, allowed="hyperflex.Recording", fix=fix)
    checks.instance("rope_guess", rope, Rope)
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
            joint = checks.array("origin", origin, (2,), unit="m") + pivot_places(motion, arm, recording.t)
        return measure(recording, rope, places, joint), places
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
    """Return the model that predicts the measurements, with its free parameters."""
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


def split(
    measured: Measurements, train: float | None, lead: float, ahead: float
) -> tuple[Measurements, Measurements | None]:
    """Return the part to fit and the part held out."""
    every = measured.channels
    if train is None:
        time = float(every.t[0] + TRAIN * every.duration)
        if every.t[-1] - time < lead + ahead:
            return measured, None
    else:
        time = train
        if time > every.t[-1]:
            return measured, None
        if time <= every.t[0]:
            raise InvalidInput("train leaves nothing to fit", got=time, allowed=f"a time after {every.t[0]:g} s")
    fitted = measured.between(-np.inf, time)
    rest = every.t >= time
    return fitted, measured.between(time, np.inf) if rest.sum() > 1 else None
