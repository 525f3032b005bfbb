"""Two cameras: where in space the markers are that both see, and how planar the swing is."""

import numpy as np

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.recording import FASTEST, Declarations, Raw, Recording, to_recording
from hyperflex.vision.camera import LARGEST_MISFIT, Camera


def stereo_recording(
    first: Recording, second: Recording, camera: Camera, other: Camera, *, plane: str = "fit"
) -> Recording:
    """Return the recording of a swing that two cameras saw, with its motion out of the plane and its tilt.

    Parameters
    ----------
    first, second : Recording
        Of the same markers by the same clock, as `camera` and the `other` one see them in their swing plane, m: of
        ``hyperflex track`` if it does not estimate that plane, or :meth:`Camera.locate` of pixels from another program.
        The second one is interpolated to the times of the first.
    camera, other : Camera
        Calibrated, with the pose of one and the same plane: of a board that lay still for a picture of each.
    plane : {"fit", "xy"}
        Plane of the recording: that of the motion, in which a rope that is let go askew from rest may swing almost
        flat, or the cameras' swing plane.

    Returns
    -------
    Recording
        As of markers in space. Gaps where one camera does not see.

    Raises
    ------
    InvalidInput
        If the recordings do not fit each other, if lines of sight miss each other by more than a calibration may, or if
        the cameras look from within 5 degrees of each other.

    Notes
    -----
    A place in a camera's plane is a line of sight; a marker is in the middle between two (Hartley and Zisserman,
    Multiple View Geometry, 12.2). Towards the cameras it is the less certain the nearer these are to each other: 1 /
    tan of half of the angle between them.
    """
    if first.kind != "markers" or first.data.shape[1:] != second.data.shape[1:]:
        allowed = "the same markers, at least two"
        raise InvalidInput("the recordings of two cameras do not fit each other", got=[first, second], allowed=allowed)
    late = np.stack([np.interp(first.t, second.t, each, np.nan, np.nan) for each in second.data.T], axis=1)
    views = []
    for each, data in ((camera, first.data), (other, late)):
        rotation, translation = checks.instance("camera", each, Camera).axes
        centre = -translation @ rotation
        line = np.pad(data.reshape(-1, 2), ((0, 0), (0, 1))) - centre
        views.append((centre, line / np.linalg.norm(line, axis=1, keepdims=True)))
    (c, a), (d, b) = views
    cosine, along, back = (a * b).sum(axis=1), a @ (d - c), b @ (d - c)
    square = np.maximum(1.0 - cosine**2, 1e-12)
    s, u = (along - cosine * back) / square, (cosine * along - back) / square  # to where the lines are nearest
    near, far = c + s[:, None] * a, d + u[:, None] * b
    missed = float(np.sqrt(np.nanmean(((near - far) ** 2).sum(axis=1) / (s * u))))
    angle = float(np.degrees(np.arcsin(np.sqrt(np.nanmedian(square)))))
    if not (missed <= LARGEST_MISFIT and angle >= 5.0):
        raise InvalidInput(
            "the lines of sight of two cameras do not meet",
            got=f"{missed:.2g} m apart at 1 m, {angle:.3g} degrees between the cameras",
            allowed=f"up to {LARGEST_MISFIT:g} m, from 5 degrees on",
            fix="Check the clocks, the order of markers, and that the board lay still between its two pictures",
        )
    places = 0.5 * (near + far).reshape(first.t.size, -1)
    raw = Raw(t=first.t, data=places, kind="markers", in_space=True, source="two cameras")
    up = "y" if plane == "fit" else None
    return to_recording(raw, Declarations("s", "m", y_axis="up", plane=plane, up=up), None, FASTEST)
