"""Calls that must be refused."""

from collections.abc import Callable
from typing import Any

import pytest

from hyperflex.errors import InvalidInput


def refuses(words: str, call: Callable[..., object], *given: Any, **named: Any) -> None:
    """Call with these arguments, which must be refused by an InvalidInput that matches the words."""
    with pytest.raises(InvalidInput, match=words):
        call(*given, **named)
