"""Lazy loading of a package's names on first use (PEP 562)."""

from __future__ import annotations

import functools
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def loader(package: str, file: str) -> Callable[[str], Any]:
    """Return a ``__getattr__`` for a package: its names come from the imports under its ``if TYPE_CHECKING:``.

    Parameters
    ----------
    package, file : str
        Its ``__name__`` and ``__file__``.
    """

    @functools.cache
    def modules() -> dict[str, str]:
        import ast

        blocks = (node.body for node in ast.parse(Path(file).read_text("utf-8")).body if isinstance(node, ast.If))
        imports = [node for block in blocks for node in block if isinstance(node, ast.ImportFrom)]
        return {name.name: str(node.module) for node in imports for name in node.names}

    def load(name: str) -> Any:
        if name.startswith("__") or name not in modules():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(modules()[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return load
