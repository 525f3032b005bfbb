"""The swing plane before the camera: its pose from known points, and how it may deviate from the calibrated one."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput


class PlaneAdjustment(NamedTuple):
    """A similarity of the swing plane before it is seen: p' = offset + scale R(roll) p.

    Attributes
    ----------
    scale : float
        1 if lengths are as calibrated.
    roll : float
        Counterclockwise in the plane, rad.
    offset : (2,) array_like
        Of the origin, m.
    """

    scale: float = 1.0
    roll: float = 0.0
    offset: npt.ArrayLike = (0.0, 0.0)


AS_CALIBRATED = PlaneAdjustment()


def plane_pose(
    points: Array, pixels: Array, matrix: Array, distortion: Array
) -> tuple[tuple[Array, Array] | None, float]:
    """Return the pose (rvec, tvec) of the swing plane that fits best, or None, and its rms error, px.

    Parameters
    ----------
    points, pixels : (K, 2) float64
        Known places in the plane, m, and where they are seen, px.
    matrix, distortion
        OpenCV's intrinsics.

    Raises
    ------
    InvalidInput
        With fewer than four points, or points on one line.

    Notes
    -----
    OpenCV's solvePnP for planes (Collins, Bartoli 2014) gives two poses; both are refined by Levenberg-Marquardt.
    """
    import cv2

    if points.shape[0] < 4:
        raise InvalidInput("too few points for the plane's pose", got=points.shape[0], allowed="at least 4")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 0.02 * spread[0]:
        raise InvalidInput("points lie on one line", got=points.tolist(), fix="Take points that span an area")
    space = np.column_stack([points, np.zeros(len(points))])
    ok, rotations, translations, _ = cv2.solvePnPGeneric(space, pixels, matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
    best, least = None, math.inf
    for r, t in zip(rotations, translations, strict=True) if ok else ():
        r, t = cv2.solvePnPRefineLM(space, pixels, matrix, distortion, r, t)
        seen = cv2.projectPoints(space, r, t, matrix, distortion)[0].reshape(-1, 2)
        error = float(np.sqrt(np.mean(np.sum((seen - pixels) ** 2, axis=1))))
        if error < least:
            best, least = (r.ravel(), t.ravel()), error
    return best, least


def adjusted(places: Array, adjustment: PlaneAdjustment) -> Array:
    """Return points as (K, 3), their part in the plane adjusted."""
    if places.ndim != 2 or places.shape[1] not in (2, 3):
        raise InvalidInput("points have the wrong shape", got=places.shape, allowed="shape (K, 2) or (K, 3), m")
    result = np.zeros((len(places), 3))
    result[:, : places.shape[1]] = places
    if adjustment is not AS_CALIBRATED:
        result = adjustment.scale * result @ turn(adjustment.roll).T
        result[:, :2] += np.asarray(adjustment.offset, dtype=np.float64)
    return result


def turn(angle: float) -> Array:
    """Return the rotation (3, 3) about z by an angle, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rodrigues(rotation: Array) -> Array:
    """Return the matrix of a rotation vector, or the vector (3,) of a matrix."""
    import cv2

    other = np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64)
    return other.ravel() if rotation.shape == (3, 3) else other
