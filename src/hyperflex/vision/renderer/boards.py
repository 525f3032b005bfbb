"""Pictures of a calibration board by a synthetic camera, to rehearse and test calibration."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.files import PathLike, as_path, write_bytes
from hyperflex.vision.calibration import Board
from hyperflex.vision.camera import Camera
from hyperflex.vision.video import Image, VideoWriter

SIZE = (768, 432)  # px, of the synthetic camera
MATRIX = np.array([[720.0, 0.0, 400.0], [0.0, 724.0, 208.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.12, 0.06, 0.001, -0.0008, 0.0])
BEFORE = np.array([-0.12, -0.09, 0.6])  # m, from the camera to the board's top left corner, as it lies in the plane
_SIDE = 48  # px, of a square in the board's own picture


def film_board(board: Board, video: PathLike, plane: PathLike, *, views: int = 15) -> None:
    """Write a video and a picture of a board, to rehearse a calibration without a camera.

    Parameters
    ----------
    board : Board
        Squares of 2 to 4 cm, eight or so to the right, fill the pictures.
    video : path-like
        MP4 to write: the board at many places and angles.
    plane : path-like
        PNG to write: the board upright in the plane of the swing, 0.6 m before the camera.
    views : int
        Frames of the video.

    Notes
    -----
    The camera is the same in all of them: ``camera.matrix`` of a calibration is close to :data:`MATRIX`.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from hyperflex.vision import Board, film_board, read_image
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> board = Board((8, 6), square=0.03, marker=0.022)
    >>> film_board(board, folder / "board.mp4", folder / "plane.png", views=3)
    >>> seen = board.find(read_image(folder / "plane.png"))
    >>> len(seen.points)  # all inner corners
    35
    """
    import cv2

    checks.instance("board", board, Board, "hyperflex.vision")
    count = checks.count("views", views, least=3)
    with VideoWriter(video, SIZE) as writer:
        for k, pose in enumerate(board_poses(board, count)):
            writer.write(render_board(board, *pose, seed=k), 0.5 * k)
    write_bytes(as_path(plane, "picture"), cv2.imencode(".png", render_board(board, np.zeros(3), BEFORE))[1].tobytes())


def render_board(
    board: Board,
    rotation: ArrayLike,
    translation: Array,
    *,
    legacy: bool = False,
    noise: float = 2.0,
    seed: int = 0,
) -> Image:
    """Return a picture (height, width, 3) of a board whose frame (x right, y down, z into it) has this pose, rad and m.

    `legacy` as of :meth:`Board.draw`; `noise` is the standard deviation of gray levels, drawn by `seed`.
    """
    import cv2

    width, height = SIZE
    pixels = np.indices((height, width))[::-1].reshape(2, -1).T
    camera = Camera(SIZE, MATRIX, DISTORTION, rotation=np.asarray(rotation), translation=translation)
    drawn = cv2.copyMakeBorder(board.draw(_SIDE, legacy=legacy), *(_SIDE,) * 4, cv2.BORDER_CONSTANT, value=255)
    where = (camera.locate(pixels) / board.square * _SIDE + _SIDE - 0.5).astype(np.float32)
    texture, where = cv2.GaussianBlur(drawn, (0, 0), 0.5), where.reshape(height, width, 2)
    seen = cv2.remap(texture, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
    seen = cv2.GaussianBlur(30.0 + 0.75 * seen.astype(np.float32), (0, 0), 0.6)
    seen += np.random.default_rng(seed).normal(0.0, noise, seen.shape)
    levels = np.clip(np.rint(seen), 0, 255).astype(np.uint8)
    return np.repeat(levels[..., None], 3, axis=2)


def board_poses(board: Board, count: int, *, tilt: float = 0.6, seed: int = 1) -> Iterator[tuple[Array, Array]]:
    """Yield rotation vectors and translations (3,), m, of boards about the middle of the picture, tilted to all sides.

    `tilt` in rad; small changes of angle, and places, are drawn by `seed`.
    """
    import cv2

    rng = np.random.default_rng(seed)
    middle = 0.5 * board.square * np.array([*board.squares, 0.0])
    for k in range(count):
        direction = 2.0 * np.pi * k / count
        rotation = tilt * np.array([np.cos(direction), np.sin(direction), 0.0]) + rng.normal(0.0, 0.05, 3) * (tilt > 0)
        place = np.array([rng.uniform(-0.09, 0.09), rng.uniform(-0.05, 0.05), rng.uniform(0.42, 0.6)])
        yield rotation, place - cv2.Rodrigues(rotation)[0] @ middle
