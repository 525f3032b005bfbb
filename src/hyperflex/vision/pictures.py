"""Pictures from files: single ones, and those of a video at some distance in time."""

from collections.abc import Iterable, Iterator

import numpy as np

from hyperflex import files
from hyperflex.errors import FileProblem
from hyperflex.files import PathLike, as_path
from hyperflex.vision.video import Image, VideoReader

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"})  # of pictures; others are videos


def read_image(path: PathLike) -> Image:
    """Return a picture (height, width, 3), uint8, blue, green, red; turned as its file says.

    Raises
    ------
    FileProblem
        If there is no such file, or it is no picture, empty or cut off.
    """
    import cv2

    content = np.frombuffer(files.read_bytes(path, "picture"), dtype=np.uint8)
    try:
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise FileProblem(f"{path} cannot be read as a picture. It is none, or was cut off; get it again.")
    return np.asarray(image, dtype=np.uint8)


def read_pictures(paths: Iterable[PathLike], interval: float = 0.2) -> Iterator[Image]:
    """Yield the pictures of files one after the other: of a video, those at least `interval` (s) apart.

    Raises
    ------
    FileProblem
        As :func:`read_image` and :class:`VideoReader`.
    """
    for path in paths:
        if as_path(path, "picture").suffix.lower() in SUFFIXES:
            yield read_image(path)
            continue
        last = -np.inf
        with VideoReader(path) as video:
            for frame in video:
                if frame.time - last >= interval - 1e-9:
                    last = frame.time
                    yield frame.image
