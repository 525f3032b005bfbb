"""Results as JSON: plain numbers, lists and strings."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hyperflex.files.writing import PathLike, write_text


def plain(value: Any) -> Any:
    """Turn arrays, paths and mappings into what JSON knows; NaN and infinity become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def dumps_json(content: Mapping[str, Any], *, one_line: bool = False) -> str:
    """Return a mapping as JSON text, indented or in one line."""
    return json.dumps(plain(content), indent=None if one_line else 2, allow_nan=False) + "\n"


def write_json(path: PathLike, content: Mapping[str, Any]) -> None:
    """Write a mapping to `path` as JSON, wholly or not at all; FileProblem when it cannot be written."""
    write_text(path, dumps_json(content))
