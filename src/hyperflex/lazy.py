"""Packages whose names are loaded on first use (PEP 562) and listed once: in their imports for type checkers."""

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package: the imports under its ``if TYPE_CHECKING:``.

    Parameters
    ----------
    package, file : str
        Its ``__name__`` and ``__file__``.
    """
    blocks = (node.body for node in ast.parse(Path(file).read_text("utf-8")).body if isinstance(node, ast.If))
    imports = [node for block in blocks for node in block if isinstance(node, ast.ImportFrom)]
    modules = {name.name: str(node.module) for node in imports for name in node.names}
    names = sorted([*modules, *(["__version__"] if hasattr(sys.modules[package], "__version__") else [])])

    def load(name: str) -> Any:
        if name not in modules:
            if Path(file).with_name(name).is_dir() and not name.startswith("_"):
                return importlib.import_module(f"{package}.{name}")
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(modules[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return load, lambda: names, names
