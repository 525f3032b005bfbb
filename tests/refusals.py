"""Calls that must fail with a message, or be interrupted."""

from collections.abc import Callable
from typing import Any

import pytest

from hyperflex.errors import Interrupted, InvalidInput


def fails(error: type[Exception], words: str, call: Callable[..., object], *given: Any, **named: Any) -> None:
    """Call with these arguments, which must raise the error with a message that matches the words."""
    with pytest.raises(error, match=words):
        call(*given, **named)


def refuses(words: str, call: Callable[..., object], *given: Any, **named: Any) -> None:
    """Call with these arguments, which must be refused by an InvalidInput that matches the words."""
    fails(InvalidInput, words, call, *given, **named)


def left_by(work: Callable[[], Any]) -> Any:
    """Return the partial result of a call that must be interrupted."""
    with pytest.raises(Interrupted) as stop:
        work()
    return stop.value.partial
