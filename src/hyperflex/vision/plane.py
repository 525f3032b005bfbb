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
LARGEST_MISFIT = 0.003  # rms of the points that tell a plane, of the picture's longer side
SIDEWAYS = 45.0  # degrees, from which y does not point up in the picture
_FLATTEST = 5.0  # degrees between the plane and the line of sight to its origin
_WIDTHS = (0.01, 100.0)  # m, between which the picture's width lies in the plane


class Projection(NamedTuple):
    """Pixels of K points with their derivatives.

    Attributes
    ----------
    pixels : (K, 2) float64
        px; NaN where a point is NaN or behind the camera.
    by_point : (K, 2, D) float64
        With respect to the point's D = 2 or 3 coordinates, px/m.
    by_adjustment : (K, 2, 4) float64
        With respect to scale (px), roll (px/rad) and offset x, y (px/m).
    """

    pixels: Array
    by_point: Array
    by_adjustment: Array


class PlaneView(NamedTuple):
    """How a camera sees the swing plane.

    Attributes
    ----------
    x_direction, y_direction : float
        Where x and y point in the picture at the plane's origin, degrees counterclockwise from the right, -180 to 180;
        0 and 90 where x runs to the right and y up.
    tilt : float
        Between the plane's normal and the camera's axis, degrees, 0 to 90.
    roll : float
        By which y is turned counterclockwise from upwards in the picture, degrees, -180 to 180.
    mirrored : bool
        Whether the plane is seen from behind: x to the left where y is up.
    """

    x_direction: float
    y_direction: float
    tilt: float
    roll: float
    mirrored: bool

    @property
    def notes(self) -> tuple[str, ...]:
        """What is unusual of it: y not upwards, x to the left."""
        found = []
        if abs(self.roll) > SIDEWAYS:
            found.append(
                f"y of the swing plane points {self.y_words} in the picture, not up: is the board upside down or on "
                "its side, or are y of the points positive downwards? A rope hangs to -y"
            )
        if self.mirrored:
            found.append(
                f"the swing plane is seen from behind: x points {self.x_words} where y points {self.y_words}. "
                "Are x or y of the points in another direction than right and up?"
            )
        return tuple(found)

    @property
    def x_words(self) -> str:
        """Where x points, in a word."""
        return _direction(self.x_direction)

    @property
    def y_words(self) -> str:
        """Where y points, in a word."""
        return _direction(self.y_direction)


def _direction(angle: float) -> str:
    return ("right", "up", "left", "down")[round(angle / 90.0) % 4]


def plane_view(rotation: Array, by_place: Array) -> PlaneView:
    """Return how a plane is seen.

    Parameters
    ----------
    rotation : (3, 3) float64
        From the plane to the camera.
    by_place : (2, 2) float64
        Derivative of pixels by places at its origin, px/m.
    """
    x, y = (np.degrees(np.arctan2(-by_place[1], by_place[0])) + 0.0).tolist()  # no -0
    tilt = math.degrees(math.acos(min(1.0, abs(float(rotation[2, 2])))))
    roll = (y - 90.0 + 180.0) % 360.0 - 180.0
    return PlaneView(x, y, tilt, roll, bool(np.linalg.det(by_place) > 0.0))


def check_visible(rotation: Array, translation: Array) -> None:
    """Refuse a pose from the plane to the camera, (3, 3) and (3,), m, that shows the plane's edge or lies behind."""
    away = float(np.linalg.norm(translation))
    flat = math.degrees(math.asin(min(1.0, abs(float(rotation[:, 2] @ translation)) / away))) if away else 0.0
    if translation[2] <= 0.0 or flat < _FLATTEST:
        wrong = "is behind the camera" if translation[2] <= 0.0 else "is seen edge-on"
        raise InvalidInput(
            f"the swing plane {wrong}",
            got=f"translation {np.round(translation, 4).tolist()} m, {flat:.1f} degrees to the line of sight",
            allowed=f"an origin before the camera, at {_FLATTEST:g} degrees or more to the line of sight",
            fix="Calibrate the plane again",
        )


def check_scale(scale: float, image_size: tuple[int, int]) -> None:
    """Refuse a scale, px/m, by which the picture shows less or more than any swing takes."""
    width, (least, most) = image_size[0] / scale, _WIDTHS
    if not least <= width <= most:
        raise InvalidInput(
            "the scale of the swing plane cannot be",
            got=f"{scale:.3g} px/m: the picture is {width:.3g} m wide there",
            allowed=f"a width of {least:g} to {most:g} m",
            fix="Give squares and points in metres, not in millimetres",
        )


def plane_pose(
    points: Array, pixels: Array, matrix: Array, distortion: Array, image_size: tuple[int, int]
) -> tuple[Array, Array]:
    """Return the pose (rvec, tvec) of the swing plane that fits best.

    Parameters
    ----------
    points, pixels : (K, 2) float64
        Known places in the plane, m, and where they are seen, px.
    matrix, distortion
        OpenCV's intrinsics.
    image_size : (int, int)
        Width and height, px.

    Raises
    ------
    InvalidInput
        With fewer than four points, points on one line, or where no pose fits.

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
    limit = LARGEST_MISFIT * max(image_size)
    if best is None or not least <= limit:
        raise InvalidInput(
            "no pose of the swing plane fits the points: rms error in px",
            got=round(least, 2),
            allowed=f"at most {limit:.1f} px",
            fix="Check the order of the points (x right, y up, in m; u right, v down) and the camera",
        )
    return best


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
