"""Settings as TOML: read by the standard library, written by a small writer of our own."""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.files.reading import read_text
from hyperflex.files.writing import PathLike, write_text

_PARTS = 50
_LONG_KEY = re.compile(rf"(?<![\w\"'-])(?:[\w\"'-]++\s*+\.\s*+){{{_PARTS}}}")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+\Z")


def read_toml(path: PathLike) -> dict[str, Any]:
    """Return the content of a TOML file. Raises FileProblem (missing, empty) or InvalidInput (place named)."""
    return loads_toml(read_text(path, "TOML file"), str(path))


def loads_toml(text: str, name: str = "the text") -> dict[str, Any]:
    """Return the content of a TOML text; `name` names it in the message of InvalidInput."""
    checks.text(f"{name}, as TOML,", text)
    if deep := _LONG_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise InvalidInput(f"{name}, line {line}: a key has too many parts", got=deep[0], allowed=f"up to {_PARTS}")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InvalidInput(
            f"{name} is not valid TOML ({error})", fix="Correct that place; see https://toml.io"
        ) from None
    except RecursionError:
        raise InvalidInput(
            f"{name} nests arrays or tables too deep", allowed="a few levels", fix="Correct it"
        ) from None
    except ValueError as error:  # of a date that does not exist, or a number with thousands of digits
        raise InvalidInput(
            f"{name} contains a value that cannot be read ({str(error).partition(';')[0]})", fix="Correct that value"
        ) from None


def toml_words(advice: str) -> str:
    """Return advice on arguments as advice on a TOML file: ``arm=Arm(length=...)`` is a table [arm] with length."""

    def table(found: re.Match[str]) -> str:
        keys = ", ".join(re.findall(r"(\w+)=", found[2]))
        return f"a table [{found[1]}]" + (f" with {keys}" if keys else "")

    advice = re.sub(r"\b(\w+)=\[?[A-Z]\w+\(([^)]*)\)\]?", table, advice)
    return re.sub(r"\b(\w+)='([^']*)'", r'\1 = "\2"', advice)


def write_toml(path: PathLike, content: Mapping[str, Any]) -> None:
    """Write nested tables to a TOML file, wholly or not at all; see :func:`dumps_toml` for their contents."""
    write_text(path, dumps_toml(content))


def dumps_toml(content: Mapping[str, Any]) -> str:
    """Return nested tables as TOML text that reads back equal, floats bit for bit.

    Parameters
    ----------
    content : mapping
        Values are str, bool, int, float, arrays of these (lists, tuples, numpy arrays) or again mappings.

    Raises
    ------
    InvalidInput
        For a value of another type (TOML has no None: leave the key out).

    Examples
    --------
    >>> print(dumps_toml({"name": "cable", "rope": {"mass": 0.125, "com": [0.02, 0.02]}}), end="")
    name = "cable"
    <BLANKLINE>
    [rope]
    mass = 0.125
    com = [0.02, 0.02]
    """
    return "".join(_toml_table(content, ())).lstrip("\n")


def _toml_table(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    """Yield the lines of one table: its own values first, then its sub-tables."""
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    if path and (len(inner) < len(table) or not table):
        yield f"\n[{'.'.join(map(_toml_key, path))}]\n"
    for key, value in table.items():
        if key not in inner:
            yield f"{_toml_key(key)} = {_toml_value('.'.join((*path, key)), value)}\n"
    for key, value in inner.items():
        yield from _toml_table(value, (*path, key))


def _toml_key(key: str) -> str:
    return key if _BARE_KEY.match(key) else _toml_string(key)


def _toml_string(text: str) -> str:
    """Return a basic string: JSON's, in which TOML wants one more character escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _toml_value(name: str, value: Any) -> str:
    """Return one value as TOML text."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return _toml_string(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml_value(name, item) for item in value) + "]"
    if isinstance(value, Mapping):  # in an array: an inline table
        pairs = (f"{_toml_key(key)} = {_toml_value(f'{name}.{key}', item)}" for key, item in value.items())
        return "{" + ", ".join(pairs) + "}"
    raise InvalidInput(
        f"{name} cannot be written as TOML", got=value, allowed="text, numbers, booleans, arrays, tables"
    )
