"""Calibration of a camera from pictures of a board, and what makes it refuse them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.vision.boards import Board, BoardView
from hyperflex.vision.camera import Camera
from hyperflex.vision.video import Image

MIN_VIEWS = 4
LEAST_TILT = 10.0  # degrees, between the boards of two views
MAX_RMS = 2.0  # px, beyond which no board was calibrated
MAX_FOCAL_STD = 0.01  # of the focal length
_MANY = 30  # views that are used: more tell little more
_OUTLIER = 3.0  # times the median rms of a view


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated camera, and how well it is known.

    Attributes
    ----------
    camera : Camera
        Its intrinsics and distortion; the pose of the swing plane is found by :meth:`place_plane`.
    rms : float
        Reprojection error of all corners, px.
    view_rms : (V,) float64
        Of each view used, px.
    focal_std, centre_std : float
        Standard deviations of focal length and centre, px, from the fit's covariance.
    tilt : float
        Greatest angle between the boards of two views, degrees.
    images, views : int
        Pictures looked at, and views of the board used.
    board : Board
        The board.
    legacy : bool
        Whether it is a legacy ChArUco pattern.
    notes : tuple of str
        What was left out, and what a better calibration needs.
    """

    camera: Camera
    rms: float
    view_rms: Array
    focal_std: float
    centre_std: float
    tilt: float
    images: int
    views: int
    board: Board
    legacy: bool
    notes: tuple[str, ...] = ()

    def plane_points(self, image: Image) -> tuple[Array, Array]:
        """Return points (K, 2) of the board in a picture of it in the swing plane, m, and their pixels (K, 2).

        Raises
        ------
        InvalidInput
            If the board is not seen, or the picture has another size.
        """
        check_size(image, self.camera.image_size)
        view = self.board.find(image)
        if view is None:
            raise InvalidInput("the board is not seen in the picture of the swing plane", fix="Take another picture")
        points = view.points
        if self.board.marker is None:  # a chessboard looks the same from its other end: the one with x to the right
            right = np.linalg.lstsq(points - points.mean(axis=0), view.pixels - view.pixels.mean(axis=0), rcond=None)[0]
            points = points if right[0, 0] > 0.0 else points[::-1]
        return points, view.pixels

    def place_plane(self, image: Image, origin: npt.ArrayLike | None = None) -> Camera:
        """Return the camera with the swing plane where the board lies in a picture.

        Parameters
        ----------
        image : (height, width, 3) uint8
            The board held in the swing plane, its squares to the right and down as declared.
        origin : (2,) array_like, optional
            Where the plane's origin (the arm's axis) is seen, px; the board's top left corner if left out.

        Raises
        ------
        InvalidInput
            If the board is not seen, or the origin lies on no point of the plane.
        """
        camera = self.camera.with_plane(*self.plane_points(image))
        return camera if origin is None else camera.with_origin(origin)


@interruptible()
def calibrate_camera(images: Iterable[Image], board: Board, *, progress: Any = None, **timing: Any) -> Calibration:
    """Calibrate a camera from pictures of a board held at different angles and places.

    Parameters
    ----------
    images : iterable of (height, width, 3) uint8
        All of one size; frames of a video too (:class:`VideoReader` gives them). Blurred ones and such without the
        board are left out; the 30 that differ most are used.
    board : Board
        What is seen in them.
    progress : callable, optional
        Called with the number of pictures looked at and of views found.
    **timing
        exposure, readout, readout_direction and delay of the camera.

    Returns
    -------
    Calibration

    Raises
    ------
    InvalidInput
        With fewer than four views of the board; for a mirrored picture, another board than declared, markers of another
        size in their squares; for views that are all parallel, or do not tell the focal length; where nothing fits. A
        wrong size of squares and markers alike cannot be told: it shows in the scale only.

    Notes
    -----
    OpenCV's calibrateCamera (Zhang 2000): fx, fy, cx, cy, k1, k2, p1, p2, and k3 where BIC wants it. Cost: some tens of
    milliseconds a picture.
    """
    views, size, looked_at = _collect(images, board, progress)
    legacy = 2 * sum(view.legacy for view in views) > len(views)
    views = [view for view in views if view.legacy == legacy]
    if len(views) < MIN_VIEWS:
        raise InvalidInput(
            "too few views of the board",
            got=f"{len(views)} in {looked_at} pictures",
            allowed=f"at least {MIN_VIEWS}, better 15",
            fix="Show the whole board, sharp and well lit, at different angles and places; check --squares",
        )
    found = len(views)
    views = _spread_out(views, _MANY)
    fit = _fit(views, size)
    good = fit.view_rms <= np.maximum(_OUTLIER * np.median(fit.view_rms), 0.3)
    notes = []
    if not good.all() and good.sum() >= MIN_VIEWS:
        notes.append(f"{int((~good).sum())} views with much greater errors (blurred, bent board) were left out")
        views = [view for view, keep in zip(views, good, strict=True) if keep]
        fit = _fit(views, size)
    _check(fit)
    if fit.rms > 0.5:
        notes.append(f"the reprojection error of {fit.rms:.2f} px is large: sharper pictures, a flatter board")
    if found < 10:
        notes.append(f"only {found} views: 15 would tell more")
    camera = Camera(size, fit.matrix, fit.distortion, **timing)
    figures = (fit.rms, fit.view_rms, fit.focal_std, fit.centre_std, fit.tilt, looked_at, len(views))
    return Calibration(camera, *figures, board, legacy, tuple(notes))


def check_size(image: Image, size: tuple[int, int]) -> None:
    """Raise InvalidInput if a picture is not of the required size (width, height), px."""
    if image.shape[1::-1] != size:
        raise InvalidInput("pictures differ in size", got=image.shape[1::-1], allowed=f"{size} px, as the others")


@dataclass(frozen=True, eq=False)
class _Fit:
    """What OpenCV found."""

    rms: float
    matrix: Array
    distortion: Array
    rotations: Array
    view_rms: Array
    focal_std: float
    centre_std: float

    @property
    def tilt(self) -> float:
        """Greatest angle between the normals of two boards, degrees."""
        import cv2

        normals = np.array([cv2.Rodrigues(r)[0][:, 2] for r in self.rotations])
        return float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0))))


def _collect(images: Iterable[Image], board: Board, progress: Any) -> tuple[list[BoardView], tuple[int, int], int]:
    """Return the views of the board, the pictures' size and their number."""
    views: list[BoardView] = []
    size: tuple[int, int] | None = None
    first: list[Image] = []
    looked_at = 0
    for image in images:
        size = size or (image.shape[1], image.shape[0])
        check_size(image, size)
        looked_at += 1
        view = board.find(image)
        if view is not None:
            views.append(view)
        elif not views and len(first) < 5:
            first.append(image)
        if progress is not None:
            progress(looked_at, len(views))
    if size is None:
        raise InvalidInput("there is no picture to calibrate from", fix="Give pictures or a video of the board")
    if not views:
        _explain(first, board)
    return views, size, looked_at


def _explain(images: Sequence[Image], board: Board) -> None:
    """Raise InvalidInput if pictures without the board show why it is not seen."""
    for image in images:
        if board.is_mirrored(image):
            raise InvalidInput(
                "the pictures are mirrored: the board is seen in their mirror image only",
                fix="Switch the camera's mirroring off (selfie mode), or take a board that is not printed reversed",
            )
        other = board.other_dictionary(image) if board.marker is not None else None
        if other is not None:
            raise InvalidInput(
                "the board has markers of another dictionary", got=board.dictionary, allowed=other, fix="Give that one"
            )


def _spread_out(views: list[BoardView], many: int) -> list[BoardView]:
    """Return at most so many views that differ most in how the board lies in the picture (farthest point first)."""
    if len(views) <= many:
        return views
    outlines = []
    for view in views:  # the affine map from board to picture
        design = np.column_stack([view.points, np.ones(len(view.points))])
        affine = np.linalg.lstsq(design, view.pixels, rcond=None)[0]
        extent = np.ptp(view.points, axis=0).max()
        outlines.append(np.concatenate([extent * affine[:2].ravel(), affine[2]]))
    shapes = np.array(outlines)
    chosen = [int(np.argmax([len(view.points) for view in views]))]
    distance = np.full(len(views), np.inf)
    while len(chosen) < many:
        distance = np.minimum(distance, np.linalg.norm(shapes - shapes[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    return [views[k] for k in sorted(chosen)]


def _fit(views: Sequence[BoardView], size: tuple[int, int]) -> _Fit:
    """Fit the camera, with k3 where it lowers BIC."""
    import cv2

    plain = _calibrate(views, size, cv2.CALIB_FIX_K3)
    more = _calibrate(views, size, 0)
    count = 2 * sum(len(view.points) for view in views)
    wins = count * np.log(max(more.rms, 1e-9) / max(plain.rms, 1e-9)) * 2.0 + np.log(count) < 0.0
    return more if wins and more.focal_std < 2.0 * plain.focal_std else plain


def _calibrate(views: Sequence[BoardView], size: tuple[int, int], flags: int) -> _Fit:
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
    deviations = np.asarray(std, dtype=np.float64).ravel()
    return _Fit(
        float(rms),
        np.asarray(matrix, dtype=np.float64),
        np.asarray(distortion, dtype=np.float64).ravel()[:5],
        np.array([np.ravel(r) for r in rotations]),
        np.asarray(view_rms, dtype=np.float64).ravel(),
        float(deviations[:2].max()),
        float(deviations[2:4].max()),
    )


def _check(fit: _Fit) -> None:
    """Refuse a fit that means nothing."""
    focal = float(fit.matrix[0, 0])
    if not np.isfinite([fit.rms, focal]).all():
        raise _degenerate("no camera fits")
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
            "the views do not tell the focal length: its standard deviation in px",
            got=round(fit.focal_std, 1),
            allowed=f"at most {MAX_FOCAL_STD * focal:.1f} px, 1 % of it",
            fix="Add views with the board tilted by 30 to 45 degrees to each side, in all corners of the picture",
        )


def _degenerate(what: str) -> InvalidInput:
    return InvalidInput(
        "the views are degenerate (all parallel): they do not tell the focal length",
        got=what,
        allowed=f"boards tilted against each other by at least {LEAST_TILT:g} degrees",
        fix="Tilt the board by 30 to 45 degrees to each side",
    )
