"""Packages of an extra: imported when needed, with the install command in the error if they are missing."""

import importlib
import importlib.util
from typing import Any

from hyperflex.errors import MissingPackage

_NAMES = {"cv2": "opencv-python-headless (cv2)"}  # of packages whose install name differs from the import name


def require(packages: tuple[str, ...], extra: str, what: str) -> None:
    """Raise an error if packages are missing; none is loaded.

    Parameters
    ----------
    packages : tuple of str
        Their import names.
    extra : str
        The extra of hyperflex that contains them.
    what : str
        The feature that needs them, as the beginning of a sentence ("MCAP files").

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
    """Return a module of a package of an extra; arguments and errors are those of :func:`require`."""
    require((module.partition(".")[0],), extra, what)
    return importlib.import_module(module)
