"""A writer that fails: the k-th call to the system that writing makes raises an error, once or from then on."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CODES = (errno.ENOSPC, errno.EIO, errno.EROFS, errno.EDQUOT, errno.EMFILE, errno.ENOMEM)
CALLS = ("fsync", "replace", "rename")  # of os, as pathlib calls them, too


class Faults:
    """Counts the calls of a writer; the one numbered `at`, and with `on` all after it, raise `code`."""

    def __init__(self, at: int, code: int, *, on: bool = False) -> None:
        self.at, self.code, self.on, self.calls = at, code, on, 0

    def step(self) -> None:
        self.calls += 1
        if self.calls == self.at or (self.on and self.calls > self.at):
            raise OSError(self.code, os.strerror(self.code))

    def wrapped(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*given: Any, **named: Any) -> Any:
            self.step()
            return call(*given, **named)

        return counted


class _File:
    """A file opened for writing whose writes and whose closing are counted."""

    def __init__(self, file: Any, faults: Faults) -> None:
        self._file, self._faults = file, faults

    def write(self, content: Any) -> Any:
        self._faults.step()
        return self._file.write(content)

    def close(self) -> None:
        try:
            self._faults.step()
        finally:
            self._file.close()

    def __enter__(self) -> "_File":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@contextmanager
def injected(faults: Faults) -> Iterator[None]:
    """Let calls of the block count and fail."""
    opened, opened_low, made = Path.open, os.open, os.mkdir

    def open_counted(path: Path, mode: str = "r", *given: Any, **named: Any) -> Any:
        if not set(mode) & set("wax+"):
            return opened(path, mode, *given, **named)
        faults.step()
        return _File(opened(path, mode, *given, **named), faults)

    def mkdir_counted(path: Any, *given: Any, **named: Any) -> None:
        if not Path(path).is_dir():  # a request for an existing one gets no other answer
            faults.step()
        made(path, *given, **named)

    def open_low_counted(path: Any, flags: int, *given: Any, **named: Any) -> int:
        if flags & (os.O_WRONLY | os.O_RDWR):
            faults.step()
        return opened_low(path, flags, *given, **named)

    with pytest.MonkeyPatch.context() as patch:
        for name in CALLS:
            patch.setattr(os, name, faults.wrapped(getattr(os, name)))
        patch.setattr(os, "open", open_low_counted)
        patch.setattr(os, "mkdir", mkdir_counted)
        patch.setattr(Path, "open", open_counted)
        yield
