"""Packages that an extra brings: looked for when they are needed, and refused with the command that installs them."""

import importlib
import importlib.util
from typing import Any

from hyperflex.errors import MissingPackage

_NAMES = {"cv2": "opencv-python-headless (cv2)"}  # of packages that are installed by another name than imported


def require(packages: tuple[str, ...], extra: str, what: str) -> None:
    """Refuse to go on without packages; none is loaded.

    Parameters
    ----------
    packages : tuple of str
        As they are imported.
    extra : str
        The extra of hyperflex that brings them.
    what : str
        What needs them, as the beginning of a sentence ("MCAP files").

    Raises
    ------
    MissingPackage
        If one of them is not installed.
    """
    lacking = [name for name in packages if importlib.util.find_spec(name) is None]
    if lacking:
        named = ", ".join(_NAMES.get(name, name) for name in lacking)
        fix = f"Install them: pip install 'hyperflex[{extra}]'"
        raise MissingPackage(f"{what} need {named}, not installed here. {fix}.")


def load(module: str, extra: str, what: str) -> Any:
    """Return a module of a package that an extra brings; arguments and errors are those of :func:`require`."""
    require((module.partition(".")[0],), extra, what)
    return importlib.import_module(module)
