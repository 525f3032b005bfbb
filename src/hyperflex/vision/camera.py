"""The camera: metres in the swing plane to pixels and back, with derivatives, and when each row was exposed."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.core.image import projection
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.vision.plane import (
    AS_CALIBRATED,
    PlaneAdjustment,
    PlaneView,
    Projection,
    adjusted,
    check_scale,
    check_visible,
    plane_pose,
    plane_view,
    rodrigues,
    turn,
)

FORMAT = "hyperflex camera 1"
DIRECTIONS = ("down", "up", "right", "left")  # in which rows or columns are read out one after the other
TIMING = ("exposure", "readout", "readout_direction", "delay")
_DISTORTION_SIZES = (4, 5, 8)
_FACING = np.diag([1.0, -1.0, -1.0])  # plane: x right, y up, z to the viewer; camera: x right, y down, z forward


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with OpenCV's intrinsics and distortion, and the pose of the swing plane before it.

    Parameters
    ----------
    image_size : (int, int)
        Width and height, px.
    matrix : (3, 3) array_like
        OpenCV's camera matrix: focal lengths fx, fy and centre cx, cy, px; no skew.
    distortion : (4,), (5,) or (8,) array_like
        OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]].
    rotation, translation : (3,) array_like or None
        OpenCV's rvec, rad, and tvec, m: from the swing plane (x right, y up, z to the viewer) to the camera. None until
        the plane is known, see :meth:`with_plane`.
    exposure : float
        Of each row, s.
    readout : float
        From the middle of the exposure of the first row to that of the last one, s; 0 for a global shutter.
    readout_direction : {"down", "up", "right", "left"}
        Of the rows in the picture as it is looked at: "down" unless the picture was rotated.
    delay : float
        How much later a frame's time stamp is than the middle of the exposure of the row read first, s.

    Raises
    ------
    InvalidInput
        If a value is not finite, has the wrong shape or sign, or the matrix is none of a camera.

    Notes
    -----
    Pixels as in OpenCV: (0, 0) is the middle of the top left pixel, u to the right, v down. The distortion model is
    OpenCV's (its documentation, "Camera Calibration and 3D Reconstruction").

    Examples
    --------
    >>> camera = Camera.facing((640, 480), pixels_per_metre=200.0, origin=(320.0, 100.0))
    >>> camera.project([[0.5, -1.0]]).tolist()
    [[420.0, 300.0]]
    >>> camera.locate([[420.0, 300.0]]).round(9).tolist()
    [[0.5, -1.0]]
    """

    image_size: tuple[int, int]
    matrix: Array
    distortion: Array
    rotation: Array | None = None
    translation: Array | None = None
    exposure: float = 0.0
    readout: float = 0.0
    readout_direction: str = "down"
    delay: float = 0.0

    def __post_init__(self) -> None:
        matrix = checks.array("camera matrix", self.matrix, (3, 3), unit="px")
        if (
            matrix[0, 0] <= 0.0
            or matrix[1, 1] <= 0.0
            or any(matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] != [0, 0, 0, 0, 1])
        ):
            raise InvalidInput(
                "camera matrix is none",
                got=matrix.tolist(),
                allowed="[[fx, 0, cx], [0, fy, cy], [0, 0, 1]], fx, fy > 0",
            )
        distortion = checks.array("distortion", self.distortion, (-1,))
        if distortion.size not in _DISTORTION_SIZES:
            raise InvalidInput("distortion has the wrong size", got=distortion.size, allowed="4, 5 or 8 coefficients")
        if (self.rotation is None) != (self.translation is None):
            raise InvalidInput("one of rotation and translation is missing", fix="Give both or none")
        try:
            width, height = self.image_size
        except (TypeError, ValueError):
            raise InvalidInput("image_size is not a pair", got=self.image_size, allowed="(width, height), px") from None
        checked: dict[str, Any] = {
            "image_size": (checks.count("image width", width), checks.count("image height", height)),
            "matrix": matrix,
            "distortion": distortion,
            "exposure": checks.number("exposure", self.exposure, sign="nonnegative", unit="s"),
            "readout": checks.number("readout", self.readout, sign="nonnegative", unit="s"),
            "readout_direction": checks.choice("readout_direction", self.readout_direction, DIRECTIONS),
            "delay": checks.number("delay", self.delay, unit="s"),
        }
        if self.rotation is not None:
            checked["rotation"] = checks.array("rotation", self.rotation, (3,), unit="rad")
            checked["translation"] = checks.array("translation", self.translation, (3,), unit="m")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @classmethod
    def pinhole(cls, image_size: tuple[int, int], focal: float | None = None, **timing: Any) -> "Camera":
        """Return a camera without distortion that looks along the middle of its picture, not calibrated.

        Parameters
        ----------
        image_size : (int, int)
            Width and height, px.
        focal : float, optional
            Focal length, px; 1.2 times the longer side (a phone's main camera, about 45 degrees wide) if left out.
        **timing
            exposure, readout, readout_direction, delay.
        """
        width, height = image_size
        f = 1.2 * max(width, height) if focal is None else checks.number("focal", focal, sign="positive", unit="px")
        matrix = np.array([[f, 0.0, 0.5 * (width - 1)], [0.0, f, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
        return cls(image_size, matrix, np.zeros(5), **timing)

    @classmethod
    def facing(
        cls,
        image_size: tuple[int, int],
        *,
        pixels_per_metre: float,
        origin: npt.ArrayLike,
        roll: float = 0.0,
        focal: float | None = None,
        **timing: Any,
    ) -> "Camera":
        """Return a camera that looks straight at the swing plane.

        Parameters
        ----------
        image_size : (int, int)
            Width and height, px.
        pixels_per_metre : float
            Scale in the plane, px/m.
        origin : (2,) array_like
            Where the plane's origin is seen, px.
        roll : float
            By which the plane looks turned counterclockwise, rad.
        focal : float, optional
            See :meth:`pinhole`; it tells the distance, which matters for what moves off the plane.
        **timing
            exposure, readout, readout_direction, delay.
        """
        camera = cls.pinhole(image_size, focal, **timing)
        scale = checks.number("pixels_per_metre", pixels_per_metre, sign="positive", unit="px/m")
        place = checks.array("origin", origin, (2,), unit="px")
        f = camera.matrix[0, 0]
        translation = np.array([*(place - camera.matrix[:2, 2]) / scale, f / scale])
        return replace(camera, rotation=rodrigues(_FACING @ turn(roll)), translation=translation)

    def with_plane(self, points: npt.ArrayLike, pixels: npt.ArrayLike) -> "Camera":
        """Return this camera with the swing plane's pose found from known points of it (OpenCV's solvePnP).

        Parameters
        ----------
        points : (K, 2) array_like
            Places in the swing plane, m; at least four, not on one line.
        pixels : (K, 2) array_like
            Where they are seen, px.

        Raises
        ------
        InvalidInput
            With fewer than four points, points on one line, or where no pose fits (the rms error in px is named): the
            points may be in another order, in another unit, or the camera another one; for a scale that cannot be.
        """
        known = checks.array("points", points, (-1, 2), unit="m")
        seen = checks.array("pixels", pixels, (known.shape[0], 2), unit="px")
        pose = plane_pose(known, seen, self.matrix, self.distortion, self.image_size)
        found = replace(self, rotation=pose[0], translation=pose[1])
        check_visible(*found.axes)
        check_scale(found.pixels_per_metre, self.image_size)
        return found

    def with_origin(self, pixel: npt.ArrayLike) -> "Camera":
        """Return this camera with the swing plane's origin moved to where it shows a pixel (2,)."""
        place = self.locate(checks.array("origin", pixel, (2,), unit="px")[None])[0]
        if not np.isfinite(place).all():
            raise InvalidInput("origin shows no point of the swing plane", got=pixel, allowed="a pixel of it")
        rotation, translation = self.axes
        return replace(self, translation=translation + rotation[:, :2] @ place)

    @cached_property
    def axes(self) -> tuple[Array, Array]:
        """Rotation matrix (3, 3) and translation (3,), m, from the plane to the camera; InvalidInput without a pose."""
        if self.rotation is None or self.translation is None:
            raise InvalidInput(
                "the camera does not know the swing plane",
                fix="Use with_plane with four points, or calibrate with a picture of the board in the plane",
            )
        return rodrigues(self.rotation), self.translation

    @cached_property
    def _to_plane(self) -> Array:
        """Homography (3, 3) from the ideal picture to the plane."""
        rotation, translation = self.axes
        return np.linalg.inv(np.column_stack([rotation[:, :2], translation]))

    @cached_property
    def _lens(self) -> Array:
        """Pose, matrix and distortion (24,) as kernels take them."""
        lens, (rotation, translation) = np.zeros(projection.LENS), self.axes
        lens[:9], lens[9:12], lens[12:16] = rotation.ravel(), translation, self.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
        lens[16 : 16 + self.distortion.size] = self.distortion
        return lens

    @property
    def pixels_per_metre(self) -> float:
        """Scale at the plane's origin, px/m: the root of the area that a square metre has there."""
        by_point = self.linearize(np.zeros((1, 2))).by_point[0]
        return math.sqrt(abs(float(np.linalg.det(by_point))))

    @property
    def plane_view(self) -> PlaneView:
        """Where x and y of the swing plane point in the picture, and how it is tilted."""
        return plane_view(self.axes[0], self.linearize(np.zeros((1, 2))).by_point[0])

    def project(self, points: npt.ArrayLike, adjustment: PlaneAdjustment = AS_CALIBRATED) -> Array:
        """Return pixels (K, 2) of points (K, 2) in the plane, or (K, 3) beside it, m; see :meth:`linearize`."""
        return self._project(adjusted(np.asarray(points, dtype=np.float64), adjustment))[0]

    def linearize(self, points: npt.ArrayLike, adjustment: PlaneAdjustment = AS_CALIBRATED) -> Projection:
        """Return pixels of points in the swing plane, with derivatives.

        Parameters
        ----------
        points : (K, 2) or (K, 3) array_like
            Places, m; the third coordinate is off the plane, towards the viewer.
        adjustment : PlaneAdjustment
            How the plane deviates from the calibrated one.

        Returns
        -------
        Projection
            NaN for points that are NaN or behind the camera.
        """
        places = np.asarray(points, dtype=np.float64)
        pixels, slopes = self._project(adjusted(places, adjustment))
        size = places.shape[1]
        turned_axes = np.eye(size)
        turned_axes[:2, :2] = turn(adjustment.roll)[:2, :2]
        by_point = adjustment.scale * slopes[:, :, :size] @ turned_axes
        turned = places @ turned_axes.T
        across = turned[:, :2] @ np.array([[0.0, 1.0], [-1.0, 0.0]])  # turned by a quarter
        by_adjustment = np.empty((len(places), 2, 4))
        by_adjustment[:, :, 0] = np.einsum("kij,kj->ki", slopes[:, :, :size], turned)
        by_adjustment[:, :, 1] = adjustment.scale * np.einsum("kij,kj->ki", slopes[:, :, :2], across)
        by_adjustment[:, :, 2:] = slopes[:, :, :2]
        return Projection(pixels, by_point, by_adjustment)

    def place_slopes(self, places: Array, adjustment: PlaneAdjustment = AS_CALIBRATED) -> tuple[Array, Array]:
        """Return the pixels (K, 2) of places (K, 2) in the swing plane, m, and the derivatives (K, 2, 2), px/m."""
        pixels, slopes = self._project(adjusted(places, adjustment))
        if adjustment is AS_CALIBRATED:
            return pixels, slopes[:, :, :2]
        return pixels, slopes[:, :, :2] @ (adjustment.scale * turn(adjustment.roll)[:2, :2])

    def locate(self, pixels: npt.ArrayLike, adjustment: PlaneAdjustment = AS_CALIBRATED) -> Array:
        """Return places (K, 2) in the swing plane, m, of pixels (K, 2); NaN where a pixel shows no point of it.

        The derivative is the inverse of ``by_point`` of :meth:`linearize`.
        """
        seen = np.array(pixels, dtype=np.float64, order="C").reshape(-1, 2)
        places = np.empty_like(seen)
        projection.locate(seen, self._lens, self._to_plane, places)
        if adjustment is AS_CALIBRATED:
            return places
        offset = np.asarray(adjustment.offset, dtype=np.float64)
        return (places - offset) @ turn(adjustment.roll)[:2, :2] / adjustment.scale

    def exposure_times(self, stamp: float, pixels: npt.ArrayLike) -> Array:
        """Return when pixels (K, 2) were exposed (the middle of it), s, in a frame with a time stamp, s."""
        return stamp - self.delay + self.readout * self.readout_share(pixels)

    def readout_share(self, pixels: npt.ArrayLike) -> Array:
        """Return which part of the readout (K,) has passed at pixels (K, 2): 0 in the row read first, 1 in the last.

        It is not cut: rows beyond the picture go on as they would.
        """
        seen = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        axis = 1 if self.readout_direction in ("down", "up") else 0
        share = seen[:, axis] / max(self.image_size[axis] - 1, 1)
        return share if self.readout_direction in ("down", "right") else 1.0 - share

    def write(self, path: PathLike) -> None:
        """Write the camera to a TOML file, wholly or not at all; it reads back equal to the bit."""
        content: dict[str, Any] = {
            "format": FORMAT,
            "camera": {
                "image_size": list(self.image_size),
                "matrix": self.matrix,
                "distortion": self.distortion,
                **{name: getattr(self, name) for name in TIMING},
            },
        }
        if self.rotation is not None:
            content["plane"] = {"rotation": self.rotation, "translation": self.translation}
        files.write_toml(path, content)

    def _project(self, places: Array) -> tuple[Array, Array]:
        """Return pixels (K, 2) of places (K, 3), and their derivatives by these (K, 2, 3)."""
        pixels, slopes = np.empty((len(places), 2)), np.empty((len(places), 2, 3))
        projection.project(places, self._lens, pixels, slopes)
        return pixels, slopes
