"""Cameras read back from TOML files."""

from hyperflex import files
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.vision.camera import FORMAT, TIMING, Camera
from hyperflex.vision.plane import check_visible


def read_camera(path: PathLike) -> Camera:
    """Return the camera of a TOML file that :meth:`Camera.write` or ``hyperflex calibrate`` wrote.

    Raises
    ------
    FileProblem
        If it cannot be read.
    InvalidInput
        If it is no camera's file, or its swing plane is behind the camera or seen edge-on; names what is wrong.
    """
    content = files.read_toml(path)
    table, plane = content.get("camera"), content.get("plane", {})
    if not isinstance(table, dict) or not isinstance(plane, dict) or content.get("format", FORMAT) != FORMAT:
        raise InvalidInput(f"{path} is no camera's file", got=sorted(content), allowed="a table [camera], and [plane]")
    known = {"image_size", "matrix", "distortion", *TIMING}
    missing, unknown = {"image_size", "matrix", "distortion"} - set(table), set(table) - known
    unknown |= set(plane) - {"rotation", "translation"}
    if missing or unknown:
        raise InvalidInput(
            f"{path}: the camera's keys do not fit", got=sorted(missing | unknown), allowed=", ".join(sorted(known))
        )
    camera = Camera(**table, **plane)
    if camera.rotation is not None:
        try:
            check_visible(*camera.axes)
        except InvalidInput as error:
            error.args = (f"{path}: {error}",)
            raise
    return camera
