"""The camera: metres in the swing plane to pixels and back, with derivatives, and when each row was exposed."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike

FORMAT = "hyperflex camera 1"
DIRECTIONS = ("down", "up", "right", "left")  # in which rows or columns are read out one after the other
TIMING = ("exposure", "readout", "readout_direction", "delay")
LARGEST_MISFIT = 0.003  # rms reprojection error of the points that define the plane, of the picture's longer side
SIDEWAYS = 45.0  # degrees: from there y does not point up in the picture
_FLATTEST = 5.0  # degrees between the plane and the line of sight to its origin: the plane is seen edge-on
_WIDTHS = (0.01, 100.0)  # m, limits of the picture's width in the plane: any swing lies between them
_MISSED = 1e-6  # px between a pixel and its place in the plane projected back: with more it shows no place of the plane
_FACING = np.diag([1.0, -1.0, -1.0])  # plane: x right, y up, z to the viewer; camera: x right, y down, z forward


class PlaneView(NamedTuple):
    """How a camera sees the swing plane.

    Attributes
    ----------
    x_direction, y_direction : float
        Where x and y point in the picture at the plane's origin, degrees counterclockwise from the right, -180 to 180;
        0 and 90 if x points right and y up.
    tilt : float
        Angle between the plane's normal and the camera's axis, degrees, 0 to 90.
    roll : float
        Angle of y, counterclockwise from upwards in the picture, degrees, -180 to 180.
    mirrored : bool
        Whether the plane is seen from behind: x points left if y points up.
    """

    x_direction: float
    y_direction: float
    tilt: float
    roll: float
    mirrored: bool

    @property
    def notes(self) -> tuple[str, ...]:
        """Unusual directions: y not upwards, x to the left."""
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
        """Direction of x in one word."""
        return _direction(self.x_direction)

    @property
    def y_words(self) -> str:
        """Direction of y in one word."""
        return _direction(self.y_direction)


def _direction(angle: float) -> str:
    return ("right", "up", "left", "down")[round(angle / 90.0) % 4]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with OpenCV's intrinsics and distortion, and the pose of the swing plane in front of it.

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
        Of the rows in the picture as it is viewed: "down" unless the picture was rotated.
    delay : float
        How much later a frame's time stamp is than the middle of the exposure of the row read first, s.

    Raises
    ------
    InvalidInput
        If a value is not finite, has the wrong shape or sign, or the matrix is not a camera matrix.

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
        others = matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]].tolist()
        if not (np.diag(matrix)[:2] > 0.0).all() or others != [0, 0, 0, 0, 1]:
            allowed = "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]], fx, fy > 0"
            raise InvalidInput("camera matrix is invalid", got=matrix.tolist(), allowed=allowed)
        distortion = checks.array("distortion", self.distortion, (-1,))
        if distortion.size not in (4, 5, 8):
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
            "readout_direction": checks.choice("readout_direction", self.readout_direction, DIRECTIONS),
            "delay": checks.number("delay", self.delay, unit="s"),
        }
        for name in ("exposure", "readout"):
            checked[name] = checks.number(name, getattr(self, name), sign="nonnegative", unit="s")
        for name, unit in (("rotation", "rad"), ("translation", "m")) if self.rotation is not None else ():
            checked[name] = checks.array(name, getattr(self, name), (3,), unit=unit)
        vars(self).update(checked)

    @classmethod
    def pinhole(cls, image_size: tuple[int, int], focal: float | None = None, **timing: Any) -> "Camera":
        """Return a camera without distortion that looks along the middle of its picture, not calibrated.

        Parameters
        ----------
        image_size : (int, int)
            Width and height, px.
        focal : float, optional
            Focal length, px; by default 1.2 times the longer side (a phone's main camera, about 45 degrees wide).
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
        origin: ArrayLike,
        roll: float = 0.0,
        focal: float | None = None,
        **timing: Any,
    ) -> "Camera":
        """Return a camera that faces the swing plane at a right angle.

        Parameters
        ----------
        image_size : (int, int)
            Width and height, px.
        pixels_per_metre : float
            Scale in the plane, px/m.
        origin : (2,) array_like
            Where the plane's origin is seen, px.
        roll : float
            Counterclockwise rotation of the plane in the picture, rad.
        focal : float, optional
            See :meth:`pinhole`; it defines the distance, which matters for motion off the plane.
        **timing
            exposure, readout, readout_direction, delay.
        """
        camera = cls.pinhole(image_size, focal, **timing)
        scale = checks.number("pixels_per_metre", pixels_per_metre, sign="positive", unit="px/m")
        place = checks.array("origin", origin, (2,), unit="px")
        translation = np.array([*(place - camera.matrix[:2, 2]) / scale, camera.matrix[0, 0] / scale])
        return replace(camera, rotation=_rolled(_FACING, roll), translation=translation)

    def with_plane(self, points: ArrayLike, pixels: ArrayLike) -> "Camera":
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
            With fewer than four points, points on one line, an impossible scale, or if no pose fits (the rms error in
            px is reported): the points may be in another order or unit, or belong to another camera.
        """
        import cv2

        known = checks.array("points", points, (-1, 2), unit="m")
        seen = checks.array("pixels", pixels, (known.shape[0], 2), unit="px")
        if known.shape[0] < 4:
            raise InvalidInput("too few points for the plane's pose", got=known.shape[0], allowed="at least 4")
        spread = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)
        if spread[1] < 0.02 * spread[0]:
            raise InvalidInput("points lie on one line", got=known.tolist(), fix="Take points that span an area")

        def misfit(camera: Camera) -> float:
            off = camera.project(known) - seen
            return float(np.nan_to_num(np.sqrt(np.mean(np.sum(off**2, axis=1))), nan=np.inf))

        # two poses fit points of a plane nearly (Collins, Bartoli 2014): both are refined by Levenberg-Marquardt
        view = np.column_stack([known, np.zeros(len(known))]), seen, self.matrix, self.distortion
        _, rotations, translations, _ = cv2.solvePnPGeneric(*view, flags=cv2.SOLVEPNP_IPPE)
        refined = [cv2.solvePnPRefineLM(*view, *pose) for pose in zip(rotations, translations, strict=True)]
        found = min((replace(self, rotation=r.ravel(), translation=t.ravel()) for r, t in refined), key=misfit)
        limit = LARGEST_MISFIT * max(self.image_size)
        if not misfit(found) <= limit:
            raise InvalidInput(
                "no pose of the swing plane fits the points: rms error in px",
                got=round(misfit(found), 2),
                allowed=f"at most {limit:.1f} px",
                fix="Check the order of the points (x right, y up, in m; u right, v down) and the camera",
            )
        found.check_visible()
        width, (least, most) = self.image_size[0] / found.pixels_per_metre, _WIDTHS
        if not least <= width <= most:
            raise InvalidInput(
                "the scale of the swing plane is impossible",
                got=f"{found.pixels_per_metre:.3g} px/m: the picture is {width:.3g} m wide there",
                allowed=f"a width of {least:g} to {most:g} m",
                fix="Give squares and points in metres, not in millimetres",
            )
        return found

    def with_origin(self, pixel: ArrayLike) -> "Camera":
        """Return this camera with the swing plane's origin moved to where it is seen at a pixel (2,)."""
        place = self.locate(checks.array("origin", pixel, (2,), unit="px")[None])[0]
        if not np.isfinite(place).all():
            raise InvalidInput("origin is not a point of the swing plane", got=pixel, allowed="a pixel of the plane")
        return self.adjusted(offset=place)

    def adjusted(self, scale: float = 1.0, roll: float = 0.0, offset: ArrayLike = (0.0, 0.0)) -> "Camera":
        """Return this camera with another swing plane: a place p in it is at offset + scale R(roll) p in the old one.

        Parameters
        ----------
        scale : float
            Ratio of lengths in the old plane to lengths in the new one.
        roll : float
            Counterclockwise in the plane, rad.
        offset : (2,) array_like
            The new origin in the old plane, m.
        """
        rotation, translation = self.axes
        moved = (translation + rotation[:, :2] @ np.asarray(offset)) / scale  # a picture does not depend on the size
        return replace(self, rotation=_rolled(rotation, roll), translation=moved)

    @cached_property
    def axes(self) -> tuple[Array, Array]:
        """Rotation matrix (3, 3) and translation (3,), m, from the plane to the camera; InvalidInput without a pose."""
        if self.rotation is None or self.translation is None:
            raise InvalidInput(
                "the camera does not know the swing plane",
                fix="Use with_plane with four points, or calibrate with a picture of the board in the plane",
            )
        import cv2

        return np.asarray(cv2.Rodrigues(self.rotation)[0], dtype=np.float64), self.translation

    @cached_property
    def _to_plane(self) -> Array:
        """Matrix (3, 3) that leads from a picture without distortion to the swing plane, homogeneous coordinates."""
        rotation, translation = self.axes
        return np.linalg.inv(np.column_stack([rotation[:, :2], translation]))

    @property
    def pixels_per_metre(self) -> float:
        """Scale at the plane's origin, px/m: the square root of the area of a square metre there."""
        return math.sqrt(abs(float(np.linalg.det(self._slopes_at_origin))))

    @property
    def _slopes_at_origin(self) -> Array:
        return np.asarray(self.linearize(np.zeros((1, 2)))[1][0])

    @property
    def plane_view(self) -> PlaneView:
        """Directions of x and y of the swing plane in the picture, and its tilt."""
        slopes = self._slopes_at_origin
        x, y = (np.degrees(np.arctan2(-slopes[1], slopes[0])) + 0.0).tolist()  # no -0
        tilt = math.degrees(math.acos(min(1.0, abs(float(self.axes[0][2, 2])))))
        return PlaneView(x, y, tilt, (y + 90.0) % 360.0 - 180.0, bool(np.linalg.det(slopes) > 0.0))

    def check_visible(self) -> None:
        """Raise InvalidInput if the swing plane is seen edge-on or lies behind the camera."""
        rotation, translation = self.axes
        away = float(np.linalg.norm(translation))
        flat = math.degrees(math.asin(min(1.0, abs(float(rotation[:, 2] @ translation)) / away))) if away else 0.0
        if translation[2] <= 0.0 or flat < _FLATTEST:
            wrong = "is behind the camera" if translation[2] <= 0.0 else "is seen edge-on"
            raise InvalidInput(
                f"the swing plane {wrong}",
                got=f"translation {np.round(translation, 4).tolist()} m, {flat:.1f} degrees to the line of sight",
                allowed=f"an origin in front of the camera, at {_FLATTEST:g} degrees or more to the line of sight",
                fix="Calibrate the plane again",
            )

    def check_size(self, size: tuple[int, ...]) -> None:
        """Raise InvalidInput if a picture of a size (width, height), px, is not this camera's."""
        if size != self.image_size:
            got, allowed = ("x".join(map(str, each)) for each in (size, self.image_size))
            raise InvalidInput("the picture has another size than the camera's", got=got, allowed=allowed)

    def project(self, points: ArrayLike) -> Array:
        """Return pixels (K, 2) of points (K, 2) in the plane, or (K, 3) off it, m; see :meth:`linearize`."""
        return self.linearize(points)[0]

    def linearize(self, points: ArrayLike) -> tuple[Array, Array]:
        """Return pixels (K, 2) of points, and their derivatives (K, 2, D) with respect to the points, px/m.

        Parameters
        ----------
        points : (K, 2) or (K, 3) array_like
            Places, m; the third coordinate is off the plane, towards the viewer. NaN, and points behind the camera,
            give NaN.
        """
        given = np.asarray(points, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] not in (2, 3):
            raise InvalidInput("points have the wrong shape", got=given.shape, allowed="shape (K, 2) or (K, 3), m")
        rotation, translation = self.axes
        if not given.size:
            return np.empty((0, 2)), np.empty((0, 2, given.shape[1]))
        import cv2

        places = np.pad(given, ((0, 0), (0, 3 - given.shape[1])))
        places[~(places @ rotation[2] + translation[2] > 0.0)] = np.nan  # behind the camera
        pixels, slopes = cv2.projectPoints(places, self.rotation, translation, self.matrix, self.distortion)
        by_place = (slopes[:, 3:6] @ rotation).reshape(-1, 2, 3)  # from those by the translation
        return pixels[:, 0], by_place[:, :, : given.shape[1]]

    def locate(self, pixels: ArrayLike) -> Array:
        """Return places (K, 2) in the swing plane, m, of pixels (K, 2); NaN if a pixel shows no point of the plane."""
        seen = np.array(pixels, dtype=np.float64).reshape(-1, 2)
        if not len(seen):
            return seen
        ideal = (seen - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]
        if self.distortion.any():
            import cv2

            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
            ideal = cv2.undistortPoints(seen[:, None], self.matrix, self.distortion, criteria=criteria)[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            across = ideal @ self._to_plane[:, :2].T + self._to_plane[:, 2]
            places = across[:, :2] / across[:, 2:]
            places[~(np.abs(self.project(places) - seen).max(axis=1) <= _MISSED)] = np.nan
        return places

    def locate_with_covariance(self, pixels: Array, covariances: Array) -> tuple[Array, Array]:
        """Return places (K, 2), m, and their covariances (K, 2, 2), m^2, from pixels and covariances, px^2."""
        places = self.locate(pixels)
        slopes = np.linalg.inv(self.linearize(np.nan_to_num(places))[1])
        return places, slopes @ covariances @ slopes.transpose(0, 2, 1)

    def middle_of(self, stamp: float) -> float:
        """Return the middle of the exposure in the middle of a frame with a time stamp, s."""
        return stamp - self.delay + 0.5 * self.readout

    def exposure_times(self, stamp: float, pixels: ArrayLike) -> Array:
        """Return when pixels (K, 2) were exposed (the middle of it), s, in a frame with a time stamp, s."""
        return stamp - self.delay + self.readout * self.readout_share(pixels)

    def readout_share(self, pixels: ArrayLike) -> Array:
        """Return the part of the readout (K,) that has passed at pixels (K, 2): 0 in the row read first, 1 in the last.

        It is extrapolated beyond the picture.
        """
        seen = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        axis = 1 if self.readout_direction in ("down", "up") else 0
        share = seen[:, axis] / max(self.image_size[axis] - 1, 1)
        return share if self.readout_direction in ("down", "right") else 1.0 - share

    def write(self, path: PathLike) -> None:
        """Write the camera to a TOML file, complete or not at all; it reads back equal to the bit."""
        names = ("image_size", "matrix", "distortion", *TIMING)
        content: dict[str, Any] = {"format": FORMAT, "camera": {name: getattr(self, name) for name in names}}
        content["camera"]["image_size"] = list(self.image_size)
        if self.rotation is not None:
            content["plane"] = {"rotation": self.rotation, "translation": self.translation}
        files.write_toml(path, content)


def read_camera(path: PathLike) -> Camera:
    """Return the camera of a TOML file that :meth:`Camera.write` or ``hyperflex calibrate`` wrote.

    Raises
    ------
    FileProblem
        If it cannot be read.
    InvalidInput
        If it is not a camera's file, or its swing plane is behind the camera or seen edge-on; names what is wrong.
    """
    content = files.read_toml(path)
    table, plane = content.get("camera"), content.get("plane", {})
    if not isinstance(table, dict) or not isinstance(plane, dict) or content.get("format", FORMAT) != FORMAT:
        allowed = "a table [camera], and [plane]"
        raise InvalidInput(f"{path} is not a camera's file", got=sorted(content), allowed=allowed)
    needed = ("image_size", "matrix", "distortion")
    checks.keys(f"{path}: [camera]", table, (*needed, *TIMING), needed=needed)
    checks.keys(f"{path}: [plane]", plane, ("rotation", "translation"))
    camera = Camera(**table, **plane)
    if camera.rotation is not None:
        try:
            camera.check_visible()
        except InvalidInput as error:
            error.args = (f"{path}: {error}",)
            raise
    return camera


def _rolled(rotation: Array, angle: float) -> Array:
    """Return the rotation vector (3,) of a rotation (3, 3) about z by an angle, rad, followed by another one (3, 3)."""
    import cv2

    about_z = cv2.Rodrigues(np.array([0.0, 0.0, angle]))[0]
    return np.asarray(cv2.Rodrigues(rotation @ about_z)[0], dtype=np.float64).ravel()
