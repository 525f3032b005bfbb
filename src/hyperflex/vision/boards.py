"""Calibration boards: chessboards, and ChArUco boards of the new and the legacy pattern."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.vision.video import Image

MISMATCH = 0.15  # of a marker's side: least rms error of the markers' places that means another board
RATIO_TOLERANCE = 0.05  # of the ratio of marker to square
_LEAST_CORNERS = 8
_LARGEST = 1.0  # m, side of a square: a larger one is meant in another unit
_FLAT = 0.02  # of the longer extent: corners nearly on one line do not define a view


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

    def __post_init__(self) -> None:
        import cv2

        width, height = self.squares
        for name, size in (("squares to the right", width), ("squares down", height)):
            checks.count(name, size, least=3)
        square = checks.number("square", self.square, sign="positive", unit="m")
        if square > _LARGEST:
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
        if found is None or len(found.points) < _LEAST_CORNERS:
            return None
        spread = np.linalg.svd(found.points - found.points.mean(axis=0), compute_uv=False)
        return found if spread[1] > _FLAT * spread[0] else None

    def is_mirrored(self, image: Image) -> bool:
        """Whether the board is seen in the mirror image of this picture; a chessboard is alike in both."""
        return self.marker is not None and self.find(np.ascontiguousarray(image[:, ::-1])) is not None

    def other_dictionary(self, image: Image) -> str | None:
        """Return the dictionary of most of the markers seen if it is not the declared one; else None."""
        import cv2

        best, most = None, 3
        for name in sorted({name for name in dir(cv2.aruco) if name.startswith(("DICT_4X4", "DICT_5X5", "DICT_6X6"))}):
            dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
            _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(image)
            if ids is not None and len(ids) > most:
                best, most = name, len(ids)
        return best if best != self.dictionary else None

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
            return np.asarray(self._layouts[int(legacy)].generateImage((width * side, height * side)), dtype=np.uint8)
        rows, columns = np.indices((height, width))
        return np.kron(255 * ((rows + columns) % 2), np.ones((side, side))).astype(np.uint8)

    @cached_property
    def _dictionary(self) -> Any:
        import cv2

        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @cached_property
    def _layouts(self) -> tuple[Any, Any]:
        """The new and the legacy board, as OpenCV has them."""
        import cv2

        both = []
        for legacy in (False, True):
            board = cv2.aruco.CharucoBoard(self.squares, self.square, float(self.marker or 0.0), self._dictionary)
            board.setLegacyPattern(legacy)
            both.append(board)
        return both[0], both[1]

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
        numbers = ids.ravel()
        misses = [self._marker_misfit(layout, corners, numbers) for layout in self._layouts]
        legacy = misses[1] < misses[0]
        if not min(misses) < MISMATCH:
            raise InvalidInput(
                "the board seen is not the declared one: its markers lie elsewhere",
                got=f"markers {np.sort(numbers)[:12].tolist()}",
                allowed=f"a ChArUco board of {self.squares[0]} by {self.squares[1]} squares",
                fix="Check the numbers of squares (to the right, down)",
            )
        layout = self._layouts[int(legacy)]
        detector = cv2.aruco.CharucoDetector(layout)
        seen, names, *_ = detector.detectBoard(gray, markerCorners=corners, markerIds=ids)
        if seen is None or names is None or len(seen) < 4:
            return None
        points = np.asarray(layout.getChessboardCorners(), dtype=np.float64)[names.ravel(), :2] * [1.0, -1.0]
        pixels = np.asarray(seen, dtype=np.float64).reshape(-1, 2)
        self._check_ratio(points, pixels, corners)
        return BoardView(points, self._refined(gray, points, pixels), legacy)

    def _refined(self, gray: Image, points: Array, pixels: Array) -> Array:
        """Return corners refined in windows that stay clear of the markers (OpenCV's own are off by 0.2 px rms)."""
        import cv2

        design = np.column_stack([points, np.ones(len(points))])
        affine = np.linalg.lstsq(design, pixels, rcond=None)[0][:2]
        narrow = float(np.linalg.svd(affine, compute_uv=False)[1])  # px/m, where it is foreshortened most
        half = int(np.clip(0.4 * (self.square - float(self.marker or 0.0)) * narrow, 2, 11))
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
        start = np.ascontiguousarray(pixels[:, None], dtype=np.float32)
        return np.asarray(cv2.cornerSubPix(gray, start, (half, half), (-1, -1), stop), dtype=np.float64)[:, 0]

    def _marker_misfit(self, layout: Any, corners: Any, ids: npt.NDArray[np.int32]) -> float:
        """Return the rms error of the markers' places on a board under the best homography, over their side."""
        places = {
            int(name): np.asarray(place)[:, :2]
            for name, place in zip(layout.getIds(), layout.getObjPoints(), strict=True)
        }
        known = [k for k, name in enumerate(ids) if int(name) in places]
        if len(known) < max(4, 0.8 * len(ids)):
            return float("inf")
        board = np.concatenate([places[int(ids[k])] for k in known]).astype(np.float64)
        seen = np.concatenate([np.reshape(corners[k], (4, 2)) for k in known]).astype(np.float64)
        error = _mapped(seen, seen, board) - board
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) / float(self.marker or self.square)

    def _check_ratio(self, points: Array, pixels: Array, corners: Any) -> None:
        """Refuse markers that are larger or smaller in their squares than declared."""
        seen = np.concatenate([np.reshape(c, (4, 2)) for c in corners]).astype(np.float64)
        placed = _mapped(seen, pixels, points).reshape(-1, 4, 2)
        ratio = float(np.median(np.linalg.norm(placed - np.roll(placed, 1, axis=1), axis=2))) / self.square
        declared = float(self.marker or 0.0) / self.square
        if abs(ratio - declared) > RATIO_TOLERANCE:
            raise InvalidInput(
                "markers have another size in their squares than declared: marker over square",
                got=round(ratio, 3),
                allowed=f"{declared:.3f}, as declared",
                fix="Measure squares and markers on the print (the marker with its black border)",
            )


def _mapped(places: Array, before: Array, after: Array) -> Array:
    """Return places (M, 2) under the best homography from points before to after; inf if there is none."""
    import cv2

    homography, _ = cv2.findHomography(before, after)
    if homography is None:
        return np.full(places.shape, np.inf)
    return np.asarray(cv2.perspectiveTransform(places[:, None], homography)[:, 0])
