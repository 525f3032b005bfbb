"""Calibration of a camera from pictures of a board, and the reasons to refuse them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
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
LEAST_TILT = 10.0  # degrees, between the boards of two views: with less the focal length is poorly determined
MAX_RMS = 2.0  # px: a larger reprojection error means that the board is not the declared one
MAX_FOCAL_STD = 0.01  # of the focal length
_MANY = 30  # views that are used: more hardly improve the fit
_OUTLIER = 3.0  # times the median rms of a view, beyond which it is dropped


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated camera, and its accuracy.

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
    views : int
        Views of the board used.
    board : Board
    legacy : bool
        Whether it is a legacy ChArUco pattern.
    images : int
        Pictures read.
    notes : tuple of str
        What was dropped, and what a better calibration needs.
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
            The board in the swing plane, its squares to the right and down as declared.
        origin : (2,) array_like, optional
            Where the plane's origin (the arm's axis) is seen, px; by default the board's top left corner.

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
        wrong size of squares and markers alike cannot be detected: it affects the scale only.

    Notes
    -----
    OpenCV's calibrateCamera (Zhang 2000): fx, fy, cx, cy, k1, k2, p1, p2, and k3 if it lowers BIC. Cost: some tens of
    milliseconds a picture.
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


def check_size(image: Image, size: tuple[int, int]) -> None:
    """Raise InvalidInput if a picture is not of the required size (width, height), px."""
    if image.shape[1::-1] != size:
        raise InvalidInput("pictures differ in size", got=image.shape[1::-1], allowed=f"{size} px, as the others")


def _collect(images: Iterable[Image], board: Board, progress: Any) -> tuple[list[BoardView], tuple[int, int], int]:
    """Return the views of the board, the pictures' size and their number."""
    views: list[BoardView] = []
    first: list[Image] = []
    size: tuple[int, int] | None = None
    count = 0
    for count, image in enumerate(images, start=1):
        size = size or (image.shape[1], image.shape[0])
        check_size(image, size)
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


def _spread_out(views: list[BoardView]) -> list[BoardView]:
    """Return the views that differ most in how the board lies in the picture (farthest point first)."""
    if len(views) <= _MANY:
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
    while len(chosen) < _MANY:
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
