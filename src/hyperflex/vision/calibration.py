"""Calibration of a camera from pictures of a chessboard or ChArUco board, and the reasons to refuse them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.vision.camera import Camera
from hyperflex.vision.video import Image


class BoardView(NamedTuple):
    """A board seen in a picture.

    Attributes
    ----------
    points : (K, 2) float64
        Inner corners on the board, m: x right, y up, (0, 0) in the board's top left corner.
    pixels : (K, 2) float64
        Where they are seen, px.
    legacy : bool
        Whether it is a legacy ChArUco pattern.
    """

    points: Array
    pixels: Array
    legacy: bool = False

    @property
    def affine(self) -> Array:
        """The affine map (3, 2) from points and 1 to pixels that fits best."""
        design = np.column_stack([self.points, np.ones(len(self.points))])
        return np.asarray(np.linalg.lstsq(design, self.pixels, rcond=None)[0])


@dataclass(frozen=True)
class Board:
    """A flat board with a chessboard, and ArUco markers in its white squares if it is a ChArUco board.

    Parameters
    ----------
    squares : (int, int)
        Number of squares to the right and down.
    square : float
        Side of a square, m, measured on the print.
    marker : float or None
        Side of an ArUco marker, m; None for a plain chessboard.
    dictionary : str
        OpenCV's name of the markers' dictionary, such as "DICT_5X5_100".

    Raises
    ------
    InvalidInput
        If a value has the wrong sign, markers are no smaller than squares, or the dictionary is not known or too small.

    Notes
    -----
    ChArUco boards with an even number of rows are printed in two ways: OpenCV changed its own in version 4.6. Both are
    tried, and the one that the markers fit is taken.
    """

    squares: tuple[int, int]
    square: float
    marker: float | None = None
    dictionary: str = "DICT_4X4_50"

    MISMATCH = 0.15  # of a marker's side: least rms error of the markers' places that means another board
    RATIO_TOLERANCE = 0.05  # of the ratio of marker to square
    LEAST_CORNERS = 8
    LARGEST = 1.0  # m, side of a square: a larger one is meant in another unit
    FLAT = 0.02  # of the longer extent: corners nearly on one line do not define a view

    def __post_init__(self) -> None:
        import cv2

        width, height = self.squares
        for name, size in (("squares to the right", width), ("squares down", height)):
            checks.count(name, size, least=3)
        square = checks.number("square", self.square, sign="positive", unit="m")
        if square > self.LARGEST:
            fix = "Give it in metres: 30 mm is 0.03"
            raise InvalidInput("squares are too large for a board", got=square, allowed="at most 1 m", fix=fix)
        if self.marker is None:
            return
        if checks.number("marker", self.marker, sign="positive", unit="m") >= square:
            raise InvalidInput("marker is no smaller than square", got=self.marker, allowed=f"less than {square:g} m")
        names = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
        checks.choice("dictionary", self.dictionary, names)
        held = self._dictionary.bytesList.shape[0]
        if width * height // 2 > held:
            raise InvalidInput("dictionary has too few markers", got=held, allowed=f"at least {width * height // 2}")

    def find(self, image: Image) -> BoardView | None:
        """Return the board as seen in a picture, or None if fewer than 8 of its corners are seen.

        Parameters
        ----------
        image : (height, width[, 3]) uint8

        Raises
        ------
        InvalidInput
            If a ChArUco board is seen that is not this one: markers where it has others (other numbers of squares), or
            of another size in their squares.
        """
        import cv2

        gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        found = self._find_chessboard(gray) if self.marker is None else self._find_charuco(gray)
        if found is None or len(found.points) < self.LEAST_CORNERS:
            return None
        spread = np.linalg.svd(found.points - found.points.mean(axis=0), compute_uv=False)
        return found if spread[1] > self.FLAT * spread[0] else None

    def draw(self, pixels_per_square: int = 60, *, legacy: bool = False) -> Image:
        """Return a picture of the board (height, width), for printing and for tests.

        Parameters
        ----------
        pixels_per_square : int
            Side of a square in the picture, px.
        legacy : bool
            Draw a ChArUco board as OpenCV did before version 4.6.
        """
        side = checks.count("pixels_per_square", pixels_per_square, least=8)
        width, height = self.squares
        if self.marker is not None:
            return np.asarray(self._layout(legacy).generateImage((width * side, height * side)), dtype=np.uint8)
        rows, columns = np.indices((height, width))
        return np.kron(255 * ((rows + columns) % 2), np.ones((side, side))).astype(np.uint8)

    @cached_property
    def _dictionary(self) -> Any:
        import cv2

        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    def _layout(self, legacy: bool) -> Any:
        """Return the new or the legacy board, as OpenCV has them."""
        import cv2

        board = cv2.aruco.CharucoBoard(self.squares, self.square, float(self.marker or 0.0), self._dictionary)
        board.setLegacyPattern(legacy)
        return board

    def _find_chessboard(self, gray: Image) -> BoardView | None:
        import cv2

        width, height = self.squares[0] - 1, self.squares[1] - 1
        flags = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
        ok, corners = cv2.findChessboardCornersSB(gray, (width, height), flags=flags)
        if not ok:
            return None
        rows, columns = np.divmod(np.arange(width * height), width)
        points = self.square * np.column_stack([columns + 1.0, -(rows + 1.0)])
        return BoardView(points, corners.reshape(-1, 2).astype(np.float64))

    def _find_charuco(self, gray: Image) -> BoardView | None:
        import cv2

        corners, ids, _ = cv2.aruco.ArucoDetector(self._dictionary).detectMarkers(gray)
        if ids is None or len(ids) < 4:
            return None
        fits = [self._marker_fit(self._layout(legacy), corners, ids) for legacy in (False, True)]
        legacy = fits[1] < fits[0]
        misfit, ratio = fits[legacy]
        if not misfit < self.MISMATCH:
            raise InvalidInput(
                "the board seen is not the declared one: its markers lie elsewhere",
                got=f"markers {np.sort(ids.ravel())[:12].tolist()}",
                allowed=f"a ChArUco board of {self.squares[0]} by {self.squares[1]} squares",
                fix="Check the numbers of squares (to the right, down)",
            )
        marker = float(self.marker or 0.0)
        if abs(ratio - marker / self.square) > self.RATIO_TOLERANCE:
            raise InvalidInput(
                "markers have another size in their squares than declared: marker over square",
                got=round(ratio, 3),
                allowed=f"{marker / self.square:.3f}, as declared",
                fix="Measure squares and markers on the print (the marker with its black border)",
            )
        layout = self._layout(legacy)
        seen, names, *_ = cv2.aruco.CharucoDetector(layout).detectBoard(gray, markerCorners=corners, markerIds=ids)
        if seen is None or names is None or len(seen) < 4:
            return None
        points = np.asarray(layout.getChessboardCorners(), dtype=np.float64)[names.ravel(), :2] * [1.0, -1.0]
        view = BoardView(points, np.asarray(seen, dtype=np.float64).reshape(-1, 2), legacy)
        # corners are refined in windows that stay clear of the markers (OpenCV's own are off by 0.2 px rms)
        narrow = float(np.linalg.svd(view.affine[:2], compute_uv=False)[1])  # px/m, where it is foreshortened most
        half = int(np.clip(0.4 * (self.square - marker) * narrow, 2, 11))
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
        start = np.ascontiguousarray(view.pixels[:, None], dtype=np.float32)
        refined = cv2.cornerSubPix(gray, start, (half, half), (-1, -1), stop)
        return view._replace(pixels=np.asarray(refined, dtype=np.float64)[:, 0])

    def _marker_fit(self, layout: Any, corners: Any, ids: npt.NDArray[np.int32]) -> tuple[float, float]:
        """Return how well markers fit a board under the best homography: rms error and side, over marker and square."""
        import cv2

        known = cv2.aruco.Board(layout.getObjPoints(), self._dictionary, layout.getIds())
        board, seen = known.matchImagePoints(corners, ids)
        if board is None or len(board) < 4 * max(4, 0.8 * len(ids)):
            return np.inf, 0.0
        homography, _ = cv2.findHomography(seen, board[..., :2])
        if homography is None:
            return np.inf, 0.0
        placed = cv2.perspectiveTransform(seen.reshape(-1, 1, 2).astype(np.float64), homography)
        error = np.sqrt(np.mean(np.sum((placed - board[..., :2].reshape(-1, 1, 2)) ** 2, axis=-1)))
        markers = placed.reshape(-1, 4, 2)
        side = np.median(np.linalg.norm(markers - np.roll(markers, 1, axis=1), axis=2))
        return float(error) / float(self.marker or self.square), float(side) / self.square


MIN_VIEWS = 4
LEAST_TILT = 10.0  # degrees, between the boards of two views: with less the focal length is poorly determined
MAX_RMS = 2.0  # px: a larger reprojection error means that the board is not the declared one
MAX_FOCAL_STD = 0.01  # of the focal length
_OUTLIER = 3.0  # times the median rms of a view, beyond which it is dropped


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated camera, and its accuracy.

    Attributes
    ----------
    camera : Camera
        Its intrinsics and distortion; for the swing plane: ``camera.with_plane(*calibration.plane_points(picture))``.
    rms : float
        Reprojection error of all corners, px.
    view_rms : (V,) float64
        Of each view used, px.
    focal_std, centre_std : float
        Standard deviations of focal length and centre, px, from the fit's covariance.
    tilt : float
        Greatest angle between the boards of two views, degrees.
    views : int
        Views of the board used.
    board : Board
    legacy : bool
        Whether it is a legacy ChArUco pattern.
    images : int
        Pictures read.
    notes : tuple of str
        Dropped pictures, and requirements of a better calibration.
    """

    camera: Camera
    rms: float
    view_rms: Array
    focal_std: float
    centre_std: float
    tilt: float
    views: int
    board: Board
    legacy: bool
    images: int = 0
    notes: tuple[str, ...] = ()

    def plane_points(self, image: Image) -> tuple[Array, Array]:
        """Return points (K, 2) of the board in a picture of it in the swing plane, m, and their pixels (K, 2).

        Raises
        ------
        InvalidInput
            If the board is not seen, or the picture has another size.
        """
        self.camera.check_size(image.shape[1::-1])
        view = self.board.find(image)
        if view is None:
            raise InvalidInput("the board is not seen in the picture of the swing plane", fix="Take another picture")
        points = view.points
        if self.board.marker is None:  # a chessboard looks the same from its other end: the one with x to the right
            right = np.linalg.lstsq(points - points.mean(axis=0), view.pixels - view.pixels.mean(axis=0), rcond=None)[0]
            points = points if right[0, 0] > 0.0 else points[::-1]
        return points, view.pixels


@interruptible()
def calibrate_camera(images: Iterable[Image], board: Board, *, progress: Any = None, **timing: Any) -> Calibration:
    """Calibrate a camera from pictures of a board held at different angles and places.

    Parameters
    ----------
    images : iterable of (height, width, 3) uint8
        All of one size; frames of a video too. Blurred ones and those without the board are skipped; the 30 that differ
        most are used.
    board : Board
        The board in them.
    progress : callable, optional
        Called with the number of pictures read and of views found.
    **timing
        exposure, readout, readout_direction and delay of the camera.

    Returns
    -------
    Calibration

    Raises
    ------
    InvalidInput
        With fewer than four views of the board; for a mirrored picture, another board than declared, markers of another
        size in their squares; for views that are all parallel, or do not determine the focal length; if nothing fits. A
        wrong size of both squares and markers cannot be detected: it affects the scale only.

    Notes
    -----
    OpenCV's calibrateCamera (Zhang 2000): fx, fy, cx, cy, k1, k2, p1, p2, and k3 if it lowers BIC. Cost: tens of
    milliseconds per picture.
    """
    views, size, count = _collect(images, board, progress)
    legacy = 2 * sum(view.legacy for view in views) > len(views)
    views = [view for view in views if view.legacy == legacy]
    found = len(views)
    if found < MIN_VIEWS:
        raise InvalidInput(
            "too few views of the board",
            got=f"{found} in {count} pictures",
            allowed=f"at least {MIN_VIEWS}, better 15",
            fix="Show the whole board, sharp and well lit, at different angles and places; check --squares",
        )
    views, notes = _spread_out(views), []
    fit = _fit(views, size, board, timing)
    good = fit.view_rms <= np.maximum(_OUTLIER * np.median(fit.view_rms), 0.3)
    if not good.all() and good.sum() >= MIN_VIEWS:
        notes.append(f"{int((~good).sum())} views with much greater errors (blurred, bent board) were dropped")
        fit = _fit([view for view, keep in zip(views, good, strict=True) if keep], size, board, timing)
    _check(fit)
    if fit.rms > 0.5:
        notes.append(f"the reprojection error of {fit.rms:.2f} px is large: take sharper pictures, a flatter board")
    if found < 10:
        notes.append(f"only {found} views: 15 would be more accurate")
    return replace(fit, images=count, notes=tuple(notes))


def _collect(images: Iterable[Image], board: Board, progress: Any) -> tuple[list[BoardView], tuple[int, int], int]:
    """Return the views of the board, the pictures' size and their number."""
    views: list[BoardView] = []
    first: list[Image] = []
    size: tuple[int, int] | None = None
    count = 0
    for count, image in enumerate(images, start=1):
        size = size or (image.shape[1], image.shape[0])
        if image.shape[1::-1] != size:
            raise InvalidInput("pictures differ in size", got=image.shape[1::-1], allowed=f"{size} px, as the others")
        view = board.find(image)
        if view is not None:
            views.append(view)
        elif not views and len(first) < 5:
            first.append(image)
        if progress is not None:
            progress(count, len(views))
    if size is None:
        raise InvalidInput("there is no picture to calibrate from", fix="Give pictures or a video of the board")
    if not views:
        _explain(first, board)
    return views, size, count


def _explain(images: Sequence[Image], board: Board) -> None:
    """Raise InvalidInput if pictures without the board show why it is not seen; a chessboard has no sides."""
    import cv2

    names = [name for name in dir(cv2.aruco) if name.startswith(("DICT_4X4", "DICT_5X5", "DICT_6X6"))]
    detectors = {
        name: cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))) for name in names
    }
    for image in [] if board.marker is None else images:
        if board.find(np.ascontiguousarray(image[:, ::-1])) is not None:
            raise InvalidInput(
                "the pictures are mirrored: the board is seen in their mirror image only",
                fix="Switch the camera's mirroring off (selfie mode), or take a board that is not printed reversed",
            )
        counts = {name: len(each.detectMarkers(image)[0]) for name, each in detectors.items()}
        other = max(names, key=counts.__getitem__)
        if other != board.dictionary and counts[other] >= 4:
            raise InvalidInput(
                "the board has markers of another dictionary", got=board.dictionary, allowed=other, fix="Give that one"
            )


def _spread_out(views: list[BoardView], most: int = 30) -> list[BoardView]:
    """Return the views that differ most in how the board lies in the picture (farthest point first).

    More than `most` barely improve the fit.
    """
    if len(views) <= most:
        return views
    extents = [np.array([*np.full(2, np.ptp(view.points, axis=0).max()), 1.0]) for view in views]
    shapes = np.array([(extent[:, None] * view.affine).ravel() for extent, view in zip(extents, views, strict=True)])
    chosen = [int(np.argmax([len(view.points) for view in views]))]
    distance = np.full(len(views), np.inf)
    while len(chosen) < most:
        distance = np.minimum(distance, np.linalg.norm(shapes - shapes[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    return [views[k] for k in sorted(chosen)]


def _fit(views: Sequence[BoardView], size: tuple[int, int], board: Board, timing: dict[str, Any]) -> Calibration:
    """Fit the camera, with k3 if it lowers BIC."""
    import cv2

    plain, more = (_calibrate(views, size, board, timing, flags) for flags in (cv2.CALIB_FIX_K3, 0))
    count = 2 * sum(len(view.points) for view in views)
    better = count * np.log(max(more.rms, 1e-9) / max(plain.rms, 1e-9)) * 2.0 + np.log(count) < 0.0
    return more if better and more.focal_std < 2.0 * plain.focal_std else plain


def _calibrate(
    views: Sequence[BoardView], size: tuple[int, int], board: Board, timing: dict[str, Any], flags: int
) -> Calibration:
    import cv2

    points = [np.column_stack([v.points, np.zeros(len(v.points))]).astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32)[:, None] for v in views]
    start: Any = None
    try:
        rms, matrix, distortion, rotations, _, std, _, view_rms = cv2.calibrateCameraExtended(
            points, pixels, size, start, start, flags=flags
        )
    except cv2.error:
        raise _degenerate("no camera fits") from None
    if not np.isfinite([rms, matrix[0, 0]]).all():
        raise _degenerate("no camera fits")
    normals = np.array([cv2.Rodrigues(r)[0][:, 2] for r in rotations])
    return Calibration(
        Camera(size, matrix, np.ravel(distortion)[:5], **timing),
        float(rms),
        np.asarray(view_rms, dtype=np.float64).ravel(),
        focal_std=float(np.ravel(std)[:2].max()),
        centre_std=float(np.ravel(std)[2:4].max()),
        tilt=float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0)))),
        views=len(views),
        board=board,
        legacy=views[0].legacy,
    )


def _check(fit: Calibration) -> None:
    """Refuse a fit that is not meaningful."""
    focal = float(fit.camera.matrix[0, 0])
    if fit.tilt < LEAST_TILT:
        raise _degenerate(f"greatest angle between two of them {fit.tilt:.1f} degrees")
    if fit.rms > MAX_RMS:
        raise InvalidInput(
            "the board does not fit any camera: reprojection error in px",
            got=round(fit.rms, 2),
            allowed=f"at most {MAX_RMS:g} px",
            fix="Check that the board is flat and declared as it is (--squares), and the pictures sharp",
        )
    if fit.focal_std > MAX_FOCAL_STD * focal:
        raise InvalidInput(
            "the views do not determine the focal length: its standard deviation in px",
            got=round(fit.focal_std, 1),
            allowed=f"at most {MAX_FOCAL_STD * focal:.1f} px, 1 % of it",
            fix="Add views with the board tilted by 30 to 45 degrees to each side, in all corners of the picture",
        )


def _degenerate(what: str) -> InvalidInput:
    return InvalidInput(
        "the views are degenerate (all parallel): they do not determine the focal length",
        got=what,
        allowed=f"boards tilted against each other by at least {LEAST_TILT:g} degrees",
        fix="Tilt the board by 30 to 45 degrees to each side",
    )
