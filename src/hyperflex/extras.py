"""Packages that an extra brings: loaded when they are needed, or refused with the command that installs them."""

import importlib
from typing import Any

from hyperflex.errors import MissingPackage


def load(module: str, extra: str, what: str) -> Any:
    """Return a module of an optional package.

    Parameters
    ----------
    module : str
        Its full name.
    extra : str
        The extra of hyperflex that brings it.
    what : str
        What needs it, as the beginning of a sentence ("MCAP files").

    Raises
    ------
    MissingPackage
        If the package is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        command = f"pip install 'hyperflex[{extra}]'"
        raise MissingPackage(
            f"{what} need the package {package}, which is not installed. Install it: {command}"
        ) from None
